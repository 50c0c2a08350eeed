//! FAST corners of one pyramid level, spread over the image.
//!
//! The level is cut into cells. A cell takes corners at the threshold of plain FAST; where that
//! leaves it empty, at a lower one. Half of what is kept the cells give up in turn, best first, so that no textured
//! corner of the image uses up the whole budget; the other half are the best of the rest, which are found again surest.

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

impl Corner {
    /// Sorts the best first, of equally good ones that which is farther up, then farther left.
    fn order(&self) -> (Reverse<u8>, usize, usize) {
        (Reverse(self.response), self.y, self.x)
    }
}

/// Finds corners level by level, in memory that it keeps.
#[derive(Debug, Default)]
pub(super) struct CornerDetector {
    /// Scores of three rows in a row.
    scores: [Vec<u8>; 3],
    /// Columns of corners in one row.
    maxima: Vec<usize>,
    cells: Vec<Vec<Corner>>,
    left_over: Vec<Corner>,
}

impl CornerDetector {
    /// Replaces `corners` by at most `budget` of `level`, all ≥ 19 px inside it.
    pub(super) fn detect(
        &mut self,
        level: &GreyImage,
        options: &OrbOptions,
        budget: usize,
        corners: &mut Vec<Corner>,
    ) {
        self.fill_cells(level, options);
        corners.clear();
        self.choose(budget, corners);
    }

    fn fill_cells(&mut self, level: &GreyImage, options: &OrbOptions) {
        let (width, height) = (level.width(), level.height());
        self.scores.iter_mut().for_each(|row| row.resize(width, 0));
        let columns = width.div_ceil(CELL_PX);
        self.cells.iter_mut().for_each(Vec::clear);
        let count = columns * height.div_ceil(CELL_PX);
        self.cells.resize_with(count.max(self.cells.len()), Vec::new);
        let inside = BORDER_PX..width.saturating_sub(BORDER_PX);
        if inside.is_empty() {
            return;
        }
        let around = inside.start - 1..inside.end + 1;
        for y in BORDER_PX - 1..(height + 1).saturating_sub(BORDER_PX) {
            self.scores.rotate_left(1);
            kernel::corner_scores(level, y, options.fallback_threshold, around.clone(), &mut self.scores[2]);
            // Whether a score is the largest around is known one row later.
            if y > BORDER_PX {
                let [above, row, below] = &self.scores;
                kernel::local_maxima([above, row, below], inside.clone(), &mut self.maxima);
                let y = y - 1;
                let cells = &mut self.cells[y / CELL_PX * columns..][..columns];
                for &x in &self.maxima {
                    add(&mut cells[x / CELL_PX], Corner { x, y, response: row[x] }, options.threshold);
                }
            }
        }
    }

    /// Half of the budget is for the best corner of every cell, then every second-best, and so on; the other half for
    /// the best of those that are left, wherever they are.
    fn choose(&mut self, budget: usize, corners: &mut Vec<Corner>) {
        let spread = budget.div_ceil(2);
        let turns = self.turns(spread);
        for cell in &mut self.cells {
            let known = turns.min(cell.len());
            if known < cell.len() {
                cell.select_nth_unstable_by_key(known, Corner::order);
            }
            cell[..known].sort_unstable_by_key(Corner::order);
        }
        for turn in 0..turns {
            let first = corners.len();
            corners.extend(self.cells.iter().filter_map(|cell| cell.get(turn)));
            corners[first..].sort_unstable_by_key(Corner::order);
        }
        self.left_over.clear();
        self.left_over.extend(corners.drain(spread.min(corners.len())..));
        self.left_over.extend(self.cells.iter().filter_map(|cell| cell.get(turns..)).flatten());
        let room = budget - corners.len();
        if self.left_over.len() > room {
            self.left_over.select_nth_unstable_by_key(room, Corner::order);
            self.left_over.truncate(room);
        }
        self.left_over.sort_unstable_by_key(Corner::order);
        corners.append(&mut self.left_over);
    }

    /// After how many turns so many corners are taken, or no cell has any more.
    fn turns(&self, count: usize) -> usize {
        let most = self.cells.iter().map(Vec::len).max().unwrap_or_default();
        let taken_after = |turns| self.cells.iter().map(|cell| cell.len().min(turns)).sum::<usize>();
        (0..most).find(|&turns| taken_after(turns) >= count).unwrap_or(most)
    }
}

/// Adds a corner to those of its cell; weak ones count only as long as there is no strong one.
fn add(cell: &mut Vec<Corner>, corner: Corner, threshold: u8) {
    let is_strong = |corner: &Corner| corner.response >= threshold;
    let has_strong = cell.first().is_some_and(is_strong);
    if is_strong(&corner) && !has_strong {
        cell.clear();
    }
    if is_strong(&corner) || !has_strong {
        cell.push(corner);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn detect(level: &GreyImage, options: &OrbOptions, budget: usize) -> Vec<Corner> {
        let mut corners = Vec::new();
        CornerDetector::default().detect(level, options, budget, &mut corners);
        corners
    }

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
    fn half_of_a_budget_is_spread_over_the_cells_and_half_goes_to_the_best_of_the_rest() {
        let image =
            squares(160, &[(40, 40, 255), (56, 56, 255), (110, 40, 60), (40, 110, 60), (110, 110, 60)]);
        let corners = detect(&image, &OrbOptions::default(), 8);
        let cell = |corner: &Corner| (corner.x / CELL_PX, corner.y / CELL_PX);
        let mut spread: Vec<_> = corners[..4].iter().map(cell).collect();
        spread.sort_unstable();
        assert_eq!(spread, [(1, 1), (1, 3), (3, 1), (3, 3)], "{corners:?}");
        assert!(corners[4..].iter().all(|corner| cell(corner) == (1, 1)), "{corners:?}");
        assert_eq!(corners.len(), 8);
    }

    /// All corners that there are, cell by cell: by the scores of the whole level.
    fn by_definition(level: &GreyImage, options: &OrbOptions) -> Vec<Corner> {
        let (width, height) = (level.width() as isize, level.height() as isize);
        let mut scores = vec![0; level.pixels().len()];
        for (y, row) in scores.chunks_mut(level.width()).enumerate() {
            kernel::corner_scores(level, y, options.fallback_threshold, 0..level.width(), row);
        }
        let score = |x: isize, y: isize| scores[(y * width + x) as usize];
        let border = BORDER_PX as isize;
        let mut corners: Vec<Corner> = Vec::new();
        for (y, x) in (border..height - border).flat_map(|y| (border..width - border).map(move |x| (y, x))) {
            let around = (0..9).map(|i| (score(x + i % 3 - 1, y + i / 3 - 1), i < 4)).enumerate();
            let mut others = around.filter(|(i, _)| *i != 4).map(|(_, other)| other);
            let here = score(x, y);
            if here > 0 && others.all(|(other, is_before)| other < here || other == here && !is_before) {
                corners.push(Corner { x: x as usize, y: y as usize, response: here });
            }
        }
        let cell = |corner: &Corner| (corner.x / CELL_PX, corner.y / CELL_PX);
        let strong: Vec<_> =
            corners.iter().filter(|corner| corner.response >= options.threshold).map(cell).collect();
        corners.retain(|corner| corner.response >= options.threshold || !strong.contains(&cell(corner)));
        corners
    }

    proptest! {
        // Each looks at every pixel of a level or two.
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn corners_are_the_local_maxima_of_the_scores_and_only_strong_ones_where_there_are_any(
            sizes in proptest::collection::vec((1..120_usize, 1..90_usize), 1..3), seed in any::<[u8; 64]>(),
        ) {
            let mut detector = CornerDetector::default();
            for (width, height) in sizes {
                let pixels = (0..width * height).map(|i| seed[i * 7 % 64] / if i / 40 % 3 == 0 { 20 } else { 2 });
                let level = GreyImage::from_pixels(width, height, pixels.collect()).unwrap();
                let mut expected = by_definition(&level, &OrbOptions::default());
                expected.sort_by_key(Corner::order);
                let mut found = Vec::new();
                detector.detect(&level, &OrbOptions::default(), 1 << 20, &mut found);
                found.sort_by_key(Corner::order);
                prop_assert_eq!(found, expected);
            }
        }

        #[test]
        fn what_is_chosen_is_what_sorting_everything_chooses(
            found in proptest::collection::hash_set((0..9_usize, 0..40_usize, 1..60_u8), 0..200),
            budget in 0..150_usize,
        ) {
            let mut detector = CornerDetector { cells: vec![Vec::new(); 9], ..CornerDetector::default() };
            for (cell, x, response) in found {
                detector.cells[cell].push(Corner { x, y: cell, response });
            }
            let mut cells = detector.cells.clone();
            cells.iter_mut().for_each(|cell| cell.sort_by_key(Corner::order));
            let ranked = cells.iter().flat_map(|cell| cell.iter().enumerate());
            let mut all: Vec<(usize, Corner)> = ranked.map(|(rank, &corner)| (rank, corner)).collect();
            all.sort_by_key(|(rank, corner)| (*rank, corner.order()));
            let mut rest = all.split_off(budget.div_ceil(2).min(all.len()));
            rest.sort_by_key(|(_, corner)| corner.order());
            rest.truncate(budget - all.len());
            let expected: Vec<Corner> = all.into_iter().chain(rest).map(|(_, corner)| corner).collect();
            let mut chosen = Vec::new();
            detector.choose(budget, &mut chosen);
            prop_assert_eq!(chosen, expected);
        }
    }

    #[test]
    fn tiny_levels_have_no_corners() {
        assert!(detect(&GreyImage::new(10, 10), &OrbOptions::default(), 50).is_empty());
        assert!(detect(&GreyImage::new(39, 20), &OrbOptions::default(), 50).is_empty());
    }
}
