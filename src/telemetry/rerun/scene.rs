//! The pictures: the frame with its keypoints, and beside it the keyframe it was matched with.
//!
//! Both share one plane, the frame at its origin and the keyframe to its right at the same height, so
//! that lines can join what corresponds.

use ::rerun::{
    Boxes2D, Clear, Color, Image, LineStrips2D, PixelFormat, Points2D, Radius, RecordingStream,
    RecordingStreamResult, Transform3D,
};

use super::pictures::{Area, Pictures};
use super::{RerunDetail, blueprint, jpeg, style};
use crate::codec;
use crate::frame::Frame;
use crate::geometry::Point;
use crate::raster::{GreyImage, RgbImage};
use crate::recognition::MatchedKeyframe;
use crate::telemetry::FrameRecord;
use crate::verification::{Correspondence, Verification};

/// Space between frame and keyframe, as a share of the frame's width.
const GAP: f32 = 0.03;

const OVER: f32 = 30.0;

/// What of the pictures is on show already.
pub(super) struct Scene {
    detail: RerunDetail,
    /// Width and height of the frames.
    size_px: Option<(usize, usize)>,
    shows_match: bool,
    camera: Pictures,
    keyframe: Pictures,
}

impl Scene {
    /// A scene of which nothing is on show.
    pub(super) fn new(detail: RerunDetail) -> Self {
        let (camera, keyframe) = (Pictures::new(style::CAMERA_IMAGE), Pictures::new(style::KEYFRAME_IMAGE));
        Self { detail, size_px: None, shows_match: false, camera, keyframe }
    }

    /// Shows the pictures of `record`.
    pub(super) fn show(
        &mut self,
        stream: &RecordingStream,
        record: &FrameRecord,
    ) -> RecordingStreamResult<()> {
        let frame = &*record.frame;
        self.outline(stream, frame)?;
        self.show_camera(stream, frame)?;
        if !self.detail.shows_evidence() {
            return Ok(());
        }
        let keypoints = &record.look.features.keypoints;
        let places = keypoints.iter().map(|keypoint| xy(keypoint.point));
        let radii = keypoints.iter().map(|keypoint| Radius::new_scene_units(0.8 * keypoint.scale.sqrt()));
        stream.log(style::KEYPOINTS, &Points2D::new(places).with_radii(radii).with_colors([style::BLUE]))?;
        match record.matched.as_ref().and_then(|matched| Placement::new(frame, matched)) {
            Some(placement) => {
                self.shows_match = true;
                placement.show(stream, record, &mut self.keyframe)
            }
            None if std::mem::take(&mut self.shows_match) => {
                for drawn in [style::LINES, style::FRAME_INLIERS, style::KEYFRAME_INLIERS] {
                    stream.log(drawn, &Clear::flat())?;
                }
                self.keyframe.hide(stream)
            }
            None => Ok(()),
        }
    }

    fn show_camera(&mut self, stream: &RecordingStream, frame: &Frame) -> RecordingStreamResult<()> {
        match (self.detail, &frame.jpeg) {
            (RerunDetail::Lean, _) => self.show_small(stream, frame),
            (_, Some(bytes)) if jpeg::kind(bytes).is_some() => {
                self.camera.show_jpeg(stream, bytes, Area::PLAIN)
            }
            (RerunDetail::Normal, _) => {
                self.camera.show_jpeg(stream, &codec::jpeg(&frame.colour), Area::PLAIN)
            }
            (RerunDetail::Full, _) => {
                let size_px = [frame.colour.width() as f32, frame.colour.height() as f32];
                self.camera.show_raw(stream, raw(&frame.colour, &frame.grey), size_px)
            }
        }
    }

    /// The picture, small, in the place of the large one.
    fn show_small(&mut self, stream: &RecordingStream, frame: &Frame) -> RecordingStreamResult<()> {
        let small = codec::thumbnail_jpeg(&frame.colour);
        let Some((width, height)) = jpeg::size_px(&small) else { return Ok(()) };
        let (full_width, full_height) = (frame.colour.width() as f32, frame.colour.height() as f32);
        let scale = [full_width / f32::from(width), full_height / f32::from(height)];
        self.camera.show_jpeg(stream, &small, Area { scale, ..Area::PLAIN })
    }

    /// Sends the layout when the first frame tells its size, and outlines frame and keyframe for good.
    fn outline(&mut self, stream: &RecordingStream, frame: &Frame) -> RecordingStreamResult<()> {
        let size_px = (frame.colour.width(), frame.colour.height());
        let is_first = self.size_px.is_none();
        if self.size_px.replace(size_px) == Some(size_px) {
            return Ok(());
        }
        let (width, height) = (size_px.0 as f32, size_px.1 as f32);
        if is_first {
            let widths = [width, offset_px(width) + width];
            blueprint::send(stream, |layout| layout.run(self.detail, widths, height))?;
        }
        let boxes = Boxes2D::from_mins_and_sizes([[0.0, 0.0], [offset_px(width), 0.0]], [[width, height]; 2])
            .with_colors([style::FAINT])
            .with_radii([Radius::new_ui_points(0.5)])
            .with_draw_order(style::OUTLINES_ORDER);
        stream.log_static(style::OUTLINES, &boxes)
    }
}

/// Where the keyframe lies beside the frame.
struct Placement<'a> {
    matched: &'a MatchedKeyframe,
    offset_px: f32,
    /// Pixels of the frame that a pixel of the keyframe covers.
    scale: f32,
    /// The same for a pixel of the thumbnail, along x and y.
    thumbnail_scale: [f32; 2],
}

impl<'a> Placement<'a> {
    /// `None` if the keyframe has no size or its thumbnail is no JPEG.
    fn new(frame: &Frame, matched: &'a MatchedKeyframe) -> Option<Self> {
        let (thumbnail_width, thumbnail_height) = jpeg::size_px(&matched.thumbnail_jpeg)?;
        let (width, height) = (matched.width_px as f32, matched.height_px as f32);
        let frame_size = (frame.colour.width() as f32, frame.colour.height() as f32);
        let scale = (frame_size.0 / width).min(frame_size.1 / height);
        (scale.is_finite() && scale > 0.0).then(|| Self {
            matched,
            offset_px: offset_px(frame_size.0),
            scale,
            thumbnail_scale: [width / f32::from(thumbnail_width), height / f32::from(thumbnail_height)],
        })
    }

    fn show(
        &self,
        stream: &RecordingStream,
        record: &FrameRecord,
        keyframe: &mut Pictures,
    ) -> RecordingStreamResult<()> {
        let space = Transform3D::from_translation([self.offset_px, 0.0, 0.0])
            .with_scale([self.scale, self.scale, 1.0]);
        stream.log(style::KEYFRAME, &space)?;
        let area = Area { scale: self.thumbnail_scale, ..Area::PLAIN };
        keyframe.show_jpeg(stream, &self.matched.thumbnail_jpeg, area)?;
        let none = Verification::default();
        let verification = record.recognition.verification.as_ref().unwrap_or(&none);
        let inliers: Vec<&Correspondence> = inliers(verification).collect();
        let lines = inliers.iter().map(|pair| self.line(pair));
        let lines =
            LineStrips2D::new(lines).with_radii([Radius::new_ui_points(0.6)]).with_colors([style::GREEN]);
        stream.log(style::LINES, &lines.with_draw_order(OVER))?;
        let in_frame = inliers.iter().map(|pair| xy(pair.query_point.point));
        stream.log(style::FRAME_INLIERS, &dots(in_frame, style::YELLOW))?;
        let in_keyframe = inliers.iter().map(|pair| xy(pair.keyframe_point.point));
        stream.log(style::KEYFRAME_INLIERS, &dots(in_keyframe, style::YELLOW))
    }

    fn line(&self, pair: &Correspondence) -> [[f32; 2]; 2] {
        let [x, y] = xy(pair.keyframe_point.point);
        [xy(pair.query_point.point), [self.offset_px + self.scale * x, self.scale * y]]
    }
}

fn inliers(verification: &Verification) -> impl Iterator<Item = &Correspondence> {
    verification.inliers.iter().filter_map(|&index| verification.correspondences.get(index as usize))
}

fn offset_px(frame_width_px: f32) -> f32 {
    frame_width_px * (1.0 + GAP)
}

fn xy(point: Point) -> [f32; 2] {
    [point.x, point.y]
}

fn dots(places: impl Iterator<Item = [f32; 2]>, colour: Color) -> Points2D {
    Points2D::new(places)
        .with_radii([Radius::new_ui_points(1.8)])
        .with_colors([colour])
        .with_draw_order(OVER + 1.0)
}

/// A picture without a JPEG, in half the bytes of its pixels: luma, and chroma of every second pixel of
/// every second row (NV12, ITU-R BT.601). An odd side keeps it as it is.
fn raw(colour: &RgbImage, grey: &GreyImage) -> Image {
    let (width, height) = (colour.width(), colour.height());
    let size = [width as u32, height as u32];
    let is_even = width.is_multiple_of(2) && height.is_multiple_of(2);
    if is_even && (grey.width(), grey.height()) == (width, height) {
        Image::from_pixel_format(size, PixelFormat::NV12, nv12(colour, grey))
    } else {
        Image::from_rgb24(colour.pixels(), size)
    }
}

/// 4:2:0 chroma, interleaved, after full luma.
fn nv12(colour: &RgbImage, grey: &GreyImage) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(colour.pixels().len() / 2);
    // Luma keeps to 16 … 235, chroma to 16 … 240.
    bytes.extend(grey.pixels().iter().map(|&luma| (16 + ((u32::from(luma) * 220) >> 8)) as u8));
    for y in (0..colour.height()).step_by(2) {
        for pixel in colour.row(y).chunks_exact(6) {
            let [red, green, blue] = [0, 1, 2].map(|channel| i32::from(pixel[channel]));
            let chroma = |weighted: i32| ((weighted + (128 << 8) + 128) >> 8).clamp(16, 240) as u8;
            bytes.push(chroma(-38 * red - 74 * green + 112 * blue));
            bytes.push(chroma(112 * red - 94 * green - 18 * blue));
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::luma;

    #[test]
    fn pixels_take_half_their_bytes_unless_a_side_is_odd() {
        for (width, bytes) in [(64, 64 * 48 * 3 / 2), (63, 63 * 48 * 3)] {
            let colour = RgbImage::new(width, 48);
            let buffer = raw(&colour, &luma(&colour)).buffer.unwrap();
            assert_eq!(buffer.array.to_data().child_data()[0].len(), bytes);
        }
    }

    #[test]
    fn pixels_keep_their_colours() {
        let pixels = |rgb: [u8; 3]| RgbImage::from_pixels(2, 2, rgb.repeat(4)).unwrap();
        // Luma and chroma of BT.601 in its limited range.
        for (rgb, yuv) in [
            ([0, 0, 0], [16, 128, 128]),
            ([255, 255, 255], [235, 128, 128]),
            ([255, 0, 0], [82, 90, 240]),
            ([0, 255, 0], [145, 54, 34]),
            ([0, 0, 255], [41, 240, 110]),
        ] {
            let colour = pixels(rgb);
            let bytes = nv12(&colour, &luma(&colour));
            let found = [bytes[0], bytes[4], bytes[5]];
            assert!(
                found.iter().zip(yuv).all(|(&found, expected): (&u8, u8)| found.abs_diff(expected) <= 1),
                "{rgb:?}: {found:?}"
            );
        }
    }
}
