//! A frame: one image of the stream, with the time at which it was captured.

use crate::raster::{GreyImage, RgbImage};

/// Where the robot was when a frame was captured, in metres and a unit quaternion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position x, y, z in metres.
    pub position_metres: [f64; 3],
    /// Orientation as a unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
}

impl Pose {
    /// The orientation of one who is not turned, or of whom nobody knows.
    pub const UPRIGHT: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
}

/// One image of a stream.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Position in the stream, from 0; sampling leaves gaps.
    pub index: u64,
    /// Time of capture in nanoseconds since the Unix epoch; sources without a clock count from 0.
    pub capture_nanos: i64,
    /// What a person would call it: a file name, or the source and the index.
    pub name: String,
    /// Colour pixels, as the CNN and people see them.
    pub colour: RgbImage,
    /// Luma pixels, as the feature extractor sees them.
    pub grey: GreyImage,
    /// The JPEG bytes the frame was decoded from, if it was a JPEG.
    pub jpeg: Option<Vec<u8>>,
    /// Where the robot was, if something told us.
    pub pose: Option<Pose>,
    /// The place that the frame truly shows, where the source knows it (synthetic worlds).
    pub true_place: Option<u32>,
}

/// The memory of a frame, for the next one.
#[derive(Default)]
pub(crate) struct FrameMemory {
    pub(crate) name: String,
    pub(crate) colour: Vec<u8>,
    pub(crate) grey: Vec<u8>,
    pub(crate) jpeg: Vec<u8>,
}

impl FrameMemory {
    /// That of a frame which nobody needs any more, if there is one.
    pub(crate) fn of(spare: Option<Frame>) -> Self {
        let taken = |Frame { name, colour, grey, jpeg, .. }: Frame| Self {
            name,
            colour: colour.into_pixels(),
            grey: grey.into_pixels(),
            jpeg: jpeg.unwrap_or_default(),
        };
        spare.map(taken).unwrap_or_default()
    }
}

#[cfg(test)]
impl Frame {
    /// A frame of which nothing but its number matters.
    pub(crate) fn numbered(index: u64) -> Self {
        Self {
            index,
            capture_nanos: 0,
            name: String::new(),
            colour: RgbImage::new(1, 1),
            grey: GreyImage::new(1, 1),
            jpeg: None,
            pose: None,
            true_place: None,
        }
    }
}
