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

    fn is_live(&self) -> bool {
        self.frames.is_live()
    }

    fn take_notice(&mut self) -> Option<String> {
        self.frames.take_notice()
    }

    fn lost_frames(&self) -> u64 {
        self.frames.lost_frames()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Pose;

    /// Three frames at 0, 1 and 2 s, the last of which knows its pose.
    struct Frames(i64);

    fn pose(x: f64) -> Pose {
        Pose { position_metres: [x, 0.0, 0.0], orientation: [0.0, 0.0, 0.0, 1.0] }
    }

    impl FrameSource for Frames {
        fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
            let second = self.0;
            self.0 += 1;
            let known = (second == 2).then(|| pose(99.0));
            let capture_nanos = second * 1_000_000_000;
            (second < 3).then(|| Ok(Frame { capture_nanos, pose: known, ..Frame::numbered(second as u64) }))
        }

        fn frame_count(&self) -> Option<u64> {
            Some(3)
        }
    }

    #[test]
    fn frames_get_the_pose_of_their_time_unless_they_know_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("poses.txt");
        std::fs::write(&path, "0.5 5 0 0 0 0 0 1\n2.5 25 0 0 0 0 0 1\n").unwrap();
        let mut source = PosedSource::open(Box::new(Frames(0)), &path).unwrap();
        assert_eq!(source.frame_count(), Some(3));
        let poses: Vec<Option<Pose>> =
            std::iter::from_fn(|| source.next_frame()).map(|frame| frame.unwrap().pose).collect();
        assert_eq!(poses, [None, Some(pose(10.0)), Some(pose(99.0))]);
    }
}
