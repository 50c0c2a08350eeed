//! The picture of how like each keyframe each frame was: a column a frame, a row a keyframe, both in the order in which
//! they came. Where the robot goes a way again, a line runs beside the diagonal.
//!
//! The picture has a size that it never exceeds. What does not fit any more is folded, two columns or rows into one, of
//! which the greater value stays; so the whole run is always in sight.

use std::collections::HashMap;

use ::rerun::components::Colormap;
use ::rerun::datatypes::ChannelDatatype;
use ::rerun::{Clear, DepthImage, Points2D, Radius, RecordingStream, RecordingStreamResult};

use super::style;
use crate::place_map::ExperienceId;
use crate::recognition::{Decision, Recognition};

const MOST_ROWS: usize = 256;
const MOST_COLUMNS: usize = 512;
/// So many columns are shown as soon as they are there, later ones in groups: every picture is logged whole.
const SHOWN_AT_ONCE: usize = 64;
const GROUP: usize = 8;
/// Frames after which the picture is shown in any case.
const PATIENCE_FRAMES: u64 = 300;

/// The picture so far.
#[derive(Default)]
pub(super) struct SimilarityPicture {
    /// The row of every keyframe, were no rows folded.
    rows: HashMap<ExperienceId, u32>,
    columns: Vec<Column>,
    /// Binary logarithms of how many keyframes share a row, and frames a column.
    row_folds: u32,
    column_folds: u32,
    /// Frames in the last column.
    in_last: usize,
    /// Frames since the picture was shown.
    unshown: u64,
}

/// What frames that share a column have in common.
#[derive(Clone)]
struct Column {
    /// 0 where there was nothing to compare, else 1 to 255.
    values: [u8; MOST_ROWS],
    /// The last answer, with the row of its keyframe, were no rows folded.
    answer: Option<(u32, Decision)>,
}

impl Default for Column {
    fn default() -> Self {
        Self { values: [0; MOST_ROWS], answer: None }
    }
}

impl Column {
    fn join(&mut self, later: &Self) {
        for (value, other) in self.values.iter_mut().zip(later.values) {
            *value = other.max(*value);
        }
        self.answer = later.answer.or(self.answer);
    }

    fn fold(&mut self) {
        for row in 0..MOST_ROWS {
            let both = self.values.get(2 * row..2 * row + 2).unwrap_or(&[0]);
            self.values[row] = both.iter().copied().max().unwrap_or_default();
        }
    }
}

impl SimilarityPicture {
    /// Adds a frame that was as like these keyframes; answers whether it is time to show the picture.
    pub(super) fn add(&mut self, similarities: &[(ExperienceId, f32)], answer: &Recognition) -> bool {
        // First of all rows, for one too many folds them all.
        let keyframe = answer.keyframe.filter(|_| answer.decision != Decision::Unknown);
        let row = keyframe.map(|keyframe| self.row(keyframe));
        similarities.iter().for_each(|(keyframe, _)| _ = self.row(*keyframe));
        let mut frame = Column { answer: row.map(|row| (row, answer.decision)), ..Column::default() };
        for (keyframe, similarity) in similarities {
            let row = self.row(*keyframe) >> self.row_folds;
            let value = &mut frame.values[row as usize];
            *value = level(*similarity).max(*value);
        }
        self.push(frame);
        self.unshown += 1;
        let is_whole = self.in_last == 1 << self.column_folds
            && (self.columns.len() <= SHOWN_AT_ONCE || self.columns.len().is_multiple_of(GROUP));
        let is_due = is_whole || self.unshown >= PATIENCE_FRAMES;
        if is_due {
            self.unshown = 0;
        }
        is_due
    }

    /// Nothing of the picture is on show any more.
    pub(super) fn begin_anew(&mut self) {
        self.unshown = PATIENCE_FRAMES;
    }

    /// The row of a keyframe, were no rows folded; then there is room for it.
    fn row(&mut self, keyframe: ExperienceId) -> u32 {
        let next = self.rows.len() as u32;
        let row = *self.rows.entry(keyframe).or_insert(next);
        while (row >> self.row_folds) as usize >= MOST_ROWS {
            self.row_folds += 1;
            self.columns.iter_mut().for_each(Column::fold);
        }
        row
    }

    fn push(&mut self, frame: Column) {
        if let Some(last) = self.columns.last_mut().filter(|_| self.in_last < 1 << self.column_folds) {
            last.join(&frame);
            self.in_last += 1;
            return;
        }
        if self.columns.len() == MOST_COLUMNS {
            for column in 0..MOST_COLUMNS / 2 {
                let mut both = self.columns[2 * column].clone();
                both.join(&self.columns[2 * column + 1]);
                self.columns[column] = both;
            }
            self.columns.truncate(MOST_COLUMNS / 2);
            self.column_folds += 1;
        }
        self.columns.push(frame);
        self.in_last = 1;
    }

    /// Width and height in pixels.
    fn size_px(&self) -> [usize; 2] {
        [self.columns.len(), self.rows.len().div_ceil(1 << self.row_folds)]
    }

    /// Row by row.
    fn pixels(&self) -> Vec<u8> {
        let [_, height] = self.size_px();
        (0..height).flat_map(|row| self.columns.iter().map(move |column| column.values[row])).collect()
    }

    /// Logs the picture, with a dot for every answer at the keyframe that it names.
    pub(super) fn show(&self, stream: &RecordingStream) -> RecordingStreamResult<()> {
        let [width, height] = self.size_px();
        if height == 0 {
            return Ok(());
        }
        let pixels = self.pixels();
        let range = shown_range(&pixels);
        let size = [width as u32, height as u32];
        let image = DepthImage::from_data_type_and_bytes(pixels, size, ChannelDatatype::U8)
            .with_colormap(Colormap::Grayscale)
            .with_depth_range(range);
        stream.log(style::SIMILARITY, &image)?;
        for decision in style::DECISIONS {
            self.show_answers(stream, decision)?;
        }
        Ok(())
    }

    fn show_answers(&self, stream: &RecordingStream, decision: Decision) -> RecordingStreamResult<()> {
        let answers = self.columns.iter().enumerate().filter_map(|(column, of)| {
            let (row, _) = of.answer.filter(|(_, is)| *is == decision)?;
            Some([column as f32 + 0.5, (row >> self.row_folds) as f32 + 0.5])
        });
        let answers: Vec<[f32; 2]> = answers.collect();
        let path = style::similarity_path(decision);
        if answers.is_empty() {
            return stream.log(path, &Clear::flat());
        }
        let dots = Points2D::new(answers)
            .with_radii([Radius::new_ui_points(1.5)])
            .with_colors([style::colour(decision)]);
        stream.log(path, &dots)
    }
}

/// 1 to 255 for 0 to 1.
fn level(similarity: f32) -> u8 {
    1 + (similarity.clamp(0.0, 1.0) * 254.0) as u8
}

/// What is black and what is white: half of what was compared is no more like than chance has it.
fn shown_range(pixels: &[u8]) -> [f64; 2] {
    let mut counts = [0_usize; 256];
    pixels.iter().for_each(|value| counts[usize::from(*value)] += 1);
    let compared = counts[1..].iter().sum::<usize>();
    let mut below = 0;
    let black = (1..256).find(|value| {
        below += counts[*value];
        2 * below >= compared
    });
    let white = (1..256).rev().find(|value| counts[*value] > 0).unwrap_or(255);
    // Nothing is black where nothing was compared.
    let black = black.filter(|_| compared > 0).unwrap_or(0).min(white - 1);
    [black as f64, white as f64]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::recognition::{Candidates, Grounds};

    fn answer(keyframe: Option<u32>) -> Recognition {
        Recognition {
            decision: Decision::Recognised,
            by: None,
            place: None,
            name: None,
            keyframe: keyframe.map(ExperienceId),
            experience: None,
            confidence: 1.0,
            inliers: None,
            candidates: Candidates::new(),
            verification: None,
            grounds: Grounds::default(),
        }
    }

    #[test]
    fn a_frame_is_a_column_and_a_keyframe_a_row_in_the_order_in_which_they_come() {
        let mut picture = SimilarityPicture::default();
        let [a, b] = [40, 7].map(ExperienceId);
        assert!(picture.add(&[(a, 1.0)], &answer(Some(40))));
        assert!(picture.add(&[(a, 0.0), (b, 0.5)], &answer(Some(7))));
        assert_eq!(picture.size_px(), [2, 2]);
        assert_eq!(picture.pixels(), [255, 1, 0, 128]);
        assert_eq!(picture.columns[1].answer, Some((1, Decision::Recognised)));
    }

    #[test]
    fn half_of_what_was_compared_is_black_and_the_likest_white() {
        assert_eq!(shown_range(&[0, 0, 10, 10, 20, 30]), [10.0, 30.0]);
        assert_eq!(shown_range(&[9]), [8.0, 9.0]);
        assert_eq!(shown_range(&[0]), [0.0, 255.0]);
    }

    proptest! {
        #[test]
        fn whatever_comes_the_picture_keeps_its_size_and_the_likest_of_all(
            frames in 1..1500_usize,
            keyframes in 1..1200_u32,
            best in any::<proptest::sample::Index>(),
        ) {
            let mut picture = SimilarityPicture::default();
            let best = best.index(frames);
            for frame in 0..frames {
                let seen = keyframes.min(frame as u32 + 1);
                let score = if frame == best { 1.0 } else { 0.25 };
                let similarities = [(ExperienceId(seen - 1), score)];
                picture.add(&similarities, &answer(None));
            }
            let [width, height] = picture.size_px();
            prop_assert!(width <= MOST_COLUMNS && height <= MOST_ROWS);
            prop_assert!(width * 2 > MOST_COLUMNS.min(frames));
            prop_assert!(height * 2 > MOST_ROWS.min(frames).min(keyframes as usize));
            let row = (keyframes as usize).min(best + 1) - 1;
            let at = (best >> picture.column_folds, row >> picture.row_folds);
            let pixels = picture.pixels();
            prop_assert_eq!(pixels[at.1 * width + at.0], 255);
        }
    }
}
