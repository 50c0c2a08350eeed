//! Which true place was taken for which, as a heat map: rows are the true places of the queries, columns
//! those of the matched keyframes. Right answers lie on the diagonal; answers to frames of unknown places
//! have no row, and the caption counts them.

use plotters::prelude::*;

use super::canvas::{Area, Axes, Drawn, Frame, draw, draw_axes};
use super::palette::label;
use super::{ReportError, cells};
use crate::evaluation::results::{Confusion, MethodResult};

const SIZE: (u32, u32) = (520, 520);
/// Rows and columns at most; more places share one.
pub(super) const LARGEST: u32 = 60;
const RIGHT: RGBColor = RGBColor(0x00, 0x45, 0x7d);
const WRONG: RGBColor = RGBColor(0xc2, 0x4a, 0x00);

/// A matrix small enough to be seen.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Binned {
    /// Rows and columns.
    pub(super) size: u32,
    /// True places that share a row.
    pub(super) places_per_row: u32,
    /// Answers, row by row.
    counts: Vec<u64>,
    /// Answers of the right place.
    pub(super) right: u64,
    /// All answers.
    pub(super) answers: u64,
}

impl Binned {
    /// Puts places into at most [`LARGEST`] rows and columns; cells outside the matrix do not count.
    pub(super) fn new(confusion: &Confusion) -> Self {
        let places_per_row = confusion.true_places.div_ceil(LARGEST).max(1);
        let size = confusion.true_places.div_ceil(places_per_row);
        let mut counts = vec![0_u64; (size * size) as usize];
        let (mut right, mut answers) = (0_u64, 0_u64);
        for &(row, column, count) in &confusion.cells {
            if row.max(column) >= confusion.true_places {
                continue;
            }
            let cell = &mut counts[((row / places_per_row) * size + column / places_per_row) as usize];
            *cell = cell.saturating_add(count);
            answers = answers.saturating_add(count);
            if row == column {
                right = right.saturating_add(count);
            }
        }
        Self { size, places_per_row, counts, right, answers }
    }
}

/// The heat map of one method with a caption, or `None` where nothing was answered.
pub(super) fn plot(result: &MethodResult) -> Result<Option<(String, String)>, ReportError> {
    let Some(confusion) = &result.confusion else { return Ok(None) };
    let binned = Binned::new(confusion);
    if binned.answers == 0 {
        return Ok(None);
    }
    let caption = caption(confusion, &binned);
    let description = format!("Confusion of places of {}. {caption}", label(result));
    let frame = Frame { plot: "confusion of places", description: &description, size: SIZE };
    let svg = draw(&frame, |area| paint(area, &binned))?;
    Ok(Some((svg, caption)))
}

fn caption(confusion: &Confusion, binned: &Binned) -> String {
    let mut caption = format!(
        "{} to frames of known places, over {}: {} of another place.",
        cells::counted(binned.answers, "answer", "answers"),
        cells::counted(confusion.true_places.into(), "true place", "true places"),
        cells::thousands(binned.answers - binned.right)
    );
    if confusion.of_unknown > 0 {
        let more = cells::counted(confusion.of_unknown, "more answer was", "more answers were");
        caption += &format!(" {more} given to frames of unknown places, which have no row.");
    }
    if confusion.near_misses > 0 {
        let more = cells::counted(confusion.near_misses, "more was", "more were");
        caption += &format!(" {more} wrong within one label: too far off along the same place.");
    }
    if binned.places_per_row > 1 {
        caption += &format!(" Binned: {} places share a row and a column.", binned.places_per_row);
    }
    caption
}

fn paint(area: &Area<'_>, binned: &Binned) -> Drawn {
    let side = f64::from(binned.size);
    let scale = f64::from(binned.places_per_row);
    let mut chart = ChartBuilder::on(area)
        .margin(14)
        .x_label_area_size(50)
        .y_label_area_size(62)
        .build_cartesian_2d(0.0..side * scale, side * scale..0.0)?;
    let axes = Axes {
        x: "True place of the matched keyframe",
        y: "True place of the query",
        x_labels: 6,
        y_labels: 6,
        decimals: 0,
    };
    draw_axes(&mut chart, &axes)?;
    let most = binned.counts.iter().copied().max().unwrap_or(1).max(1) as f64;
    for (index, &count) in (0_u32..).zip(&binned.counts) {
        if count == 0 {
            continue;
        }
        let (row, column) = (f64::from(index / binned.size), f64::from(index % binned.size));
        let color = if row == column { RIGHT } else { WRONG };
        // The square root lets a single answer be seen beside hundreds.
        let shade = 0.25 + 0.75 * (count as f64 / most).sqrt();
        let corners = [(column * scale, row * scale), ((column + 1.0) * scale, (row + 1.0) * scale)];
        chart.draw_series([Rectangle::new(corners, color.mix(shade).filled())])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_places_than_rows_share_them() {
        let confusion = Confusion {
            true_places: 121,
            cells: vec![(0, 2, 3), (120, 120, 5), (121, 0, 9)],
            of_unknown: 0,
            near_misses: 0,
        };
        let binned = Binned::new(&confusion);
        assert_eq!((binned.size, binned.places_per_row), (41, 3));
        assert_eq!((binned.counts[0], binned.counts[41 * 41 - 1]), (3, 5));
        assert_eq!((binned.right, binned.answers), (5, 8));
    }

    #[test]
    fn sixty_places_keep_a_row_each() {
        let binned =
            Binned::new(&Confusion { true_places: 60, cells: vec![], of_unknown: 0, near_misses: 0 });
        assert_eq!((binned.size, binned.places_per_row), (60, 1));
        let huge = Binned::new(&Confusion {
            true_places: u32::MAX,
            cells: vec![(u32::MAX, 0, 1), (7, 7, u64::MAX)],
            of_unknown: 0,
            near_misses: 0,
        });
        assert!(huge.size <= LARGEST);
        assert_eq!(huge.answers, u64::MAX);
        assert_eq!(
            Binned::new(&Confusion { true_places: 0, cells: vec![(0, 0, 1)], of_unknown: 0, near_misses: 0 })
                .answers,
            0
        );
    }
}
