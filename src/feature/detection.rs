//! FAST corners of one pyramid level, spread over the image.
//!
//! The level is cut into cells. A cell takes corners at the threshold of plain FAST; where that
//! leaves it empty, at a lower one. Cells then give up their corners in turn, best first, so that no
//! textured corner of the image uses up the whole budget.

use std::cmp::Reverse;

use super::OrbOptions;
use super::brief::BORDER_PX;
use crate::kernel;
use crate::raster::GreyImage;

/// Side of a detection cell in pixels.
const CELL_PX: usize = 35;

/// A corner at column `x`, row `y` of its level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Corner {
    pub(super) x: usize,
    pub(super) y: usize,
    pub(super) response: u8,
}

/// At most `budget` corners of `level`, all ≥ 19 px inside it.
pub(super) fn detect(level: &GreyImage, options: &OrbOptions, budget: usize) -> Vec<Corner> {
    let scores = kernel::corner_scores(level, options.fallback_threshold);
    let mut cells = corners_by_cell(level, &scores);
    for cell in &mut cells {
        keep_strong_or_all(cell, options.threshold);
    }
    take_in_turn(cells, budget)
}

fn corners_by_cell(level: &GreyImage, scores: &[u8]) -> Vec<Vec<Corner>> {
    let columns = level.width().div_ceil(CELL_PX);
    let rows = level.height().div_ceil(CELL_PX);
    let mut cells = vec![Vec::new(); columns * rows];
    for y in BORDER_PX..level.height().saturating_sub(BORDER_PX) {
        for x in BORDER_PX..level.width().saturating_sub(BORDER_PX) {
            if is_local_maximum(scores, level.width(), x, y) {
                let response = scores[y * level.width() + x];
                cells[y / CELL_PX * columns + x / CELL_PX].push(Corner { x, y, response });
            }
        }
    }
    cells
}

/// Whether the score is positive and beats its eight neighbours; of equal ones the first wins.
fn is_local_maximum(scores: &[u8], width: usize, x: usize, y: usize) -> bool {
    let centre = y * width + x;
    let score = scores[centre];
    let before = [centre - width - 1, centre - width, centre - width + 1, centre - 1];
    let after = [centre + 1, centre + width - 1, centre + width, centre + width + 1];
    score > 0 && before.iter().all(|&i| scores[i] < score) && after.iter().all(|&i| scores[i] <= score)
}

fn keep_strong_or_all(cell: &mut Vec<Corner>, threshold: u8) {
    if cell.iter().any(|corner| corner.response >= threshold) {
        cell.retain(|corner| corner.response >= threshold);
    }
    cell.sort_by_key(|corner| (Reverse(corner.response), corner.y, corner.x));
}

/// The best corner of every cell, then every second-best, … until the budget is used up.
fn take_in_turn(cells: Vec<Vec<Corner>>, budget: usize) -> Vec<Corner> {
    let mut ranked: Vec<(usize, Corner)> =
        cells.into_iter().flat_map(|cell| cell.into_iter().enumerate()).collect();
    ranked.sort_by_key(|&(rank, corner)| (rank, Reverse(corner.response), corner.y, corner.x));
    ranked.truncate(budget);
    ranked.into_iter().map(|(_, corner)| corner).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dark image with bright squares whose corners are what FAST looks for.
    fn squares(size: usize, at: &[(usize, usize, u8)]) -> GreyImage {
        let mut image = GreyImage::new(size, size);
        for &(left, top, brightness) in at {
            for y in top..top + 8 {
                image.row_mut(y)[left..left + 8].fill(brightness);
            }
        }
        image
    }

    #[test]
    fn a_cell_without_strong_corners_falls_back_to_the_lower_threshold() {
        let image = squares(140, &[(40, 40, 12), (80, 80, 200)]);
        let corners = detect(&image, &OrbOptions::default(), 100);
        assert!(corners.iter().any(|corner| corner.response < 20 && corner.x < 60));
        assert!(corners.iter().any(|corner| corner.response >= 20 && corner.x > 60));
    }

    #[test]
    fn weak_corners_are_dropped_where_strong_ones_exist() {
        let image = squares(140, &[(72, 72, 12), (88, 88, 200)]);
        let corners = detect(&image, &OrbOptions::default(), 100);
        let same_cell = corners.iter().filter(|corner| (70..105).contains(&corner.x));
        assert!(same_cell.clone().count() > 0);
        assert!(same_cell.into_iter().all(|corner| corner.response >= 20));
    }

    #[test]
    fn a_small_budget_is_spread_over_the_cells() {
        let image =
            squares(160, &[(40, 40, 255), (56, 56, 255), (110, 40, 60), (40, 110, 60), (110, 110, 60)]);
        let corners = detect(&image, &OrbOptions::default(), 4);
        assert_eq!(corners.len(), 4);
        let mut cells: Vec<_> =
            corners.iter().map(|corner| (corner.x / CELL_PX, corner.y / CELL_PX)).collect();
        cells.dedup();
        assert_eq!(cells.len(), 4, "{corners:?}");
    }

    #[test]
    fn tiny_levels_have_no_corners() {
        assert!(detect(&GreyImage::new(10, 10), &OrbOptions::default(), 50).is_empty());
        assert!(detect(&GreyImage::new(39, 20), &OrbOptions::default(), 50).is_empty());
    }
}
