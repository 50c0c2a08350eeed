//! Where the robot was, told beside the frames (the paper's section III.C.2): by a file, a track of poses; or while it
//! drives, by gpsd or over a socket. Frames get the pose of their time.

mod gpsd;
mod lines;
mod live;
mod position;
mod reading;
mod socket;
mod track;

use std::fmt::{self, Display};
use std::path::PathBuf;

use serde::Deserialize;

pub use track::PoseTrack;

use self::gpsd::Gpsd;
use self::live::{LivePoses, Teller};
use self::socket::PoseSocket;
use super::{FrameSource, SourceError};
use crate::frame::{Frame, Pose};

/// Who tells where the robot is.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(from = "String")]
pub enum PoseAddress {
    /// A file: `PATH`.
    File(PathBuf),
    /// gpsd at `HOST:PORT`: `gpsd`, `gpsd:HOST` or `gpsd:HOST:PORT`.
    Gpsd(String),
    /// Whoever writes lines to a Unix socket at this path: `unix:PATH`.
    Socket(PathBuf),
}

impl PoseAddress {
    /// Whether poses come while the robot drives.
    #[must_use]
    pub fn is_live(&self) -> bool {
        !matches!(self, Self::File(_))
    }
}

impl From<String> for PoseAddress {
    fn from(text: String) -> Self {
        let port = gpsd::PORT;
        match text.split_once(':') {
            None if text == "gpsd" => Self::Gpsd(format!("127.0.0.1:{port}")),
            Some(("gpsd", host)) if host.contains(':') => Self::Gpsd(host.to_owned()),
            Some(("gpsd", host)) => Self::Gpsd(format!("{host}:{port}")),
            Some(("unix", path)) => Self::Socket(path.into()),
            _ => Self::File(text.into()),
        }
    }
}

impl Display for PoseAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(formatter),
            Self::Gpsd(address) => write!(formatter, "gpsd:{address}"),
            Self::Socket(path) => write!(formatter, "unix:{}", path.display()),
        }
    }
}

/// A source whose frames know their pose where somebody tells it.
pub struct PosedSource {
    frames: Box<dyn FrameSource>,
    poses: Poses,
    notice: Option<String>,
}

enum Poses {
    Track(PoseTrack),
    Live(LivePoses),
}

impl Poses {
    fn at(&self, nanos: i64) -> Option<Pose> {
        match self {
            Self::Track(track) => track.at(nanos),
            Self::Live(poses) => poses.at(nanos),
        }
    }
}

impl PosedSource {
    /// The frames of a source, with poses from `address`. A file has TUM's `time tx ty tz qx qy qz qw` (s, m), or CSV
    /// of time, latitude and longitude (s, degrees); the same lines may be written to a socket.
    ///
    /// # Errors
    /// If the file cannot be read or is neither, or the socket cannot be listened on. gpsd need not run yet.
    pub fn open(frames: Box<dyn FrameSource>, address: &PoseAddress) -> Result<Self, SourceError> {
        let poses = match address {
            PoseAddress::File(path) => Poses::Track(PoseTrack::read(path)?),
            PoseAddress::Gpsd(address) => {
                Poses::Live(LivePoses::of(Teller::Gpsd(Gpsd::watch(address.clone())?)))
            }
            PoseAddress::Socket(path) => {
                Poses::Live(LivePoses::of(Teller::Socket(PoseSocket::listen(path)?)))
            }
        };
        Ok(Self { frames, poses, notice: None })
    }
}

impl FrameSource for PosedSource {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        self.next_frame_in(None)
    }

    fn next_frame_in(&mut self, spare: Option<Frame>) -> Option<Result<Frame, SourceError>> {
        let frame = self.frames.next_frame_in(spare)?;
        if let Poses::Live(poses) = &mut self.poses {
            self.notice = poses.listen().or(self.notice.take());
        }
        Some(frame.map(|frame| {
            let pose = frame.pose.or_else(|| self.poses.at(frame.capture_nanos));
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
        self.frames.take_notice().or_else(|| self.notice.take())
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
    fn an_address_reads_back_as_it_is_written() {
        for text in ["poses.txt", "/data/gpsd.csv", "gpsd:10.0.0.7:3000", "unix:/run/pose.sock"] {
            assert_eq!(PoseAddress::from(text.to_owned()).to_string(), text);
        }
        for text in ["gpsd", "gpsd:127.0.0.1"] {
            assert_eq!(PoseAddress::from(text.to_owned()), PoseAddress::Gpsd("127.0.0.1:2947".to_owned()));
        }
    }

    #[test]
    fn frames_get_the_pose_of_their_time_unless_they_know_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("poses.txt");
        std::fs::write(&path, "0.5 5 0 0 0 0 0 1\n2.5 25 0 0 0 0 0 1\n").unwrap();
        let mut source = PosedSource::open(Box::new(Frames(0)), &PoseAddress::File(path)).unwrap();
        assert_eq!(source.frame_count(), Some(3));
        let poses: Vec<Option<Pose>> =
            std::iter::from_fn(|| source.next_frame()).map(|frame| frame.unwrap().pose).collect();
        assert_eq!(poses, [None, Some(pose(10.0)), Some(pose(99.0))]);
    }
}
