//! Where the robot was, told by a file beside the frames (the paper's section III.C.2): a track of poses, looked up
//! at the time of every frame.

mod position;
mod reading;
mod track;

use std::path::Path;

pub use track::PoseTrack;

use super::{FrameSource, SourceError};
use crate::frame::Frame;

/// A source whose frames know their pose where a track tells it.
pub struct PosedSource {
    frames: Box<dyn FrameSource>,
    track: PoseTrack,
}

impl PosedSource {
    /// The frames of a source, with the poses of the file at `path`: TUM's `time tx ty tz qx qy qz qw` (s, m), or CSV
    /// of time, latitude and longitude (s, degrees).
    ///
    /// # Errors
    /// If the file cannot be read or is neither.
    pub fn open(frames: Box<dyn FrameSource>, path: &Path) -> Result<Self, SourceError> {
        Ok(Self { frames, track: PoseTrack::read(path)? })
    }
}

impl FrameSource for PosedSource {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        let frame = self.frames.next_frame()?;
        Some(frame.map(|frame| {
            let pose = frame.pose.or_else(|| self.track.at(frame.capture_nanos));
            Frame { pose, ..frame }
        }))
    }

    fn frame_count(&self) -> Option<u64> {
        self.frames.frame_count()
    }
}
