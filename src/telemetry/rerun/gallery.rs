//! The pictures of a place on one sheet, the keyframes framed.

use ::rerun::{Boxes2D, Points2D, Radius, RecordingStream, RecordingStreamResult};

use super::pictures::{Area, Pictures};
use super::{jpeg, style};

const COLUMNS: usize = 6;
const ROWS: usize = 4;
/// Pictures that a sheet has room for.
pub(super) const MOST: usize = COLUMNS * ROWS;
/// From the corner of a picture to that of the next one.
const CELL: [f32; 2] = [312.0, 276.0];
/// What a picture takes of that at most; the rest is for what is written below it.
const PICTURE: [f32; 2] = [300.0, 225.0];

/// Width and height of a sheet.
pub(super) const SHEET: [f32; 2] = [COLUMNS as f32 * CELL[0], ROWS as f32 * CELL[1]];

/// A picture with what is written below it.
pub(super) struct Picture {
    pub(super) jpeg: Vec<u8>,
    pub(super) label: String,
    pub(super) is_keyframe: bool,
}

/// Which of `count` things are shown where there is room for `room`: the first, the last, and evenly between.
pub(super) fn evenly(count: usize, room: usize) -> impl Iterator<Item = usize> {
    let shown = count.min(room);
    (0..shown).map(move |index| if shown < 2 { 0 } else { index * (count - 1) / (shown - 1) })
}

/// A sheet with its cells.
pub(super) struct Gallery {
    cells: Vec<Pictures>,
}

impl Gallery {
    /// An empty one.
    pub(super) fn new() -> Self {
        let cells = (0..MOST).map(|index| Pictures::new(format!("{}/{index:02}/image", style::GALLERY)));
        Self { cells: cells.collect() }
    }

    /// Shows the pictures, of which there are [`MOST`] at most, instead of those before.
    pub(super) fn show(
        &mut self,
        stream: &RecordingStream,
        pictures: &[Picture],
    ) -> RecordingStreamResult<()> {
        let (mut frames, mut labels) = (Vec::new(), Vec::new());
        for cell in self.cells.iter_mut().skip(pictures.len()) {
            cell.hide(stream)?;
        }
        for (index, (picture, cell)) in pictures.iter().zip(&mut self.cells).enumerate() {
            let corner = [(index % COLUMNS) as f32 * CELL[0], (index / COLUMNS) as f32 * CELL[1]];
            let Some((width, height)) = jpeg::size_px(&picture.jpeg) else {
                cell.hide(stream)?;
                continue;
            };
            let scale = (PICTURE[0] / f32::from(width)).min(PICTURE[1] / f32::from(height));
            cell.show_jpeg(stream, &picture.jpeg, Area { corner, scale: [scale; 2] })?;
            let size = [scale * f32::from(width), scale * f32::from(height)];
            labels.push(([corner[0] + 0.5 * size[0], corner[1] + size[1] + 6.0], picture.label.as_str()));
            if picture.is_keyframe {
                frames.push((corner, size));
            }
        }
        let corners = frames.iter().map(|frame| frame.0);
        let boxes = Boxes2D::from_mins_and_sizes(corners, frames.iter().map(|frame| frame.1))
            .with_colors([style::BLUE])
            .with_radii([Radius::new_ui_points(1.5)]);
        stream.log(format!("{}/keyframes", style::GALLERY), &boxes)?;
        let written = Points2D::new(labels.iter().map(|label| label.0))
            .with_labels(labels.iter().map(|label| label.1))
            .with_show_labels(true)
            .with_colors([style::WHITE])
            .with_radii([Radius::new_ui_points(0.1)]);
        stream.log(format!("{}/labels", style::GALLERY), &written)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_and_the_last_are_shown_and_evenly_what_is_between() {
        let shown = |count, room| evenly(count, room).collect::<Vec<_>>();
        assert_eq!(shown(3, 5), [0, 1, 2]);
        assert_eq!(shown(9, 3), [0, 4, 8]);
        assert_eq!(shown(7, 1), [0]);
        assert!(shown(0, 4).is_empty() && shown(4, 0).is_empty());
        assert_eq!(shown(1000, 24).last(), Some(&999));
    }
}
