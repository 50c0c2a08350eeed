//! Where frames come from: a folder of images, a video file, a synthetic world or a camera.
//!
//! A [`FrameSource`] hands out frames in order and never ends the stream because of one bad image:
//! that one is reported and the next call goes on.

#[cfg(feature = "v4l")]
mod camera;
mod directory;
mod paced;
mod poses;
pub mod synthetic;
mod video;

pub use crate::codec::{jpeg, thumbnail_jpeg};
#[cfg(feature = "v4l")]
pub use camera::{Camera, CameraControl, CameraFormat, ControlItem, FrameRates, FrameSize, cameras};
pub use directory::{DirectorySource, image_files, is_image, sort_naturally};
pub use paced::PacedSource;
pub use poses::{PoseAddress, PoseTrack, PosedSource};
pub use video::{VideoSource, ffmpeg_version};

use std::io;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::codec::{self, CodecError};
use crate::frame::Frame;
use crate::raster::RgbImage;

/// A stream of frames.
pub trait FrameSource: Send {
    /// The next frame, an error about one frame that could not be read, or `None` at the end. A live source answers
    /// within two seconds or so, with [`SourceError::NotYet`] if it has to.
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>>;

    /// The same; the frame may be made in the memory of `spare`, one that nobody needs any more.
    fn next_frame_in(&mut self, spare: Option<Frame>) -> Option<Result<Frame, SourceError>> {
        drop(spare);
        self.next_frame()
    }

    /// How many calls of [`next_frame`](Self::next_frame) will answer, if that is known beforehand.
    fn frame_count(&self) -> Option<u64>;

    /// Whether frames come when they come, as those of a camera do, so that whoever is slow misses some.
    fn is_live(&self) -> bool {
        false
    }

    /// What people should know and is no failure, told once: what a camera gives, that it is back.
    fn take_notice(&mut self) -> Option<String> {
        None
    }

    /// Frames that were lost so far before anybody could fetch them.
    fn lost_frames(&self) -> u64 {
        0
    }
}

/// Why a source could not be opened, or one of its frames not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The text after `synthetic:` makes no sense.
    #[error("synthetic world '{given}': {reason}; example: synthetic:street?laps=2&light=noon,dusk&seed=7")]
    Synthetic {
        /// What was asked for.
        given: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The operating system said no.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The folder holds no images.
    #[error("no images in {}: name a folder with .jpg or .png files", path.display())]
    NoImages {
        /// The folder.
        path: PathBuf,
    },
    /// A file of poses makes no sense.
    #[error("poses {}, line {line}: {reason}", path.display())]
    BadPoses {
        /// The file.
        path: PathBuf,
        /// The line, from 1 on.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A video file could not be read, or not to its end.
    #[error("video {}: {reason}", path.display())]
    BadVideo {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// A camera could not be opened, or gave no usable frame.
    #[error("camera {device}: {reason}")]
    Camera {
        /// The device.
        device: String,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// A frame of a camera is damaged; the next one may be whole.
    #[error("camera {device}: {reason}")]
    DamagedFrame {
        /// The device.
        device: String,
        /// Which frame, what is wrong with it, and what to do.
        reason: String,
    },
    /// Nothing has come, which was told before; another call may have a frame.
    #[error("no frame yet; wait")]
    NotYet,
    /// An image could not be decoded.
    #[error("bad image {name}: {reason}")]
    BadImage {
        /// The file.
        name: String,
        /// What is wrong with it, and what to do.
        reason: String,
    },
}

/// What the address of a source names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Address<'a> {
    /// A camera: `v4l2:DEVICE`.
    Camera(&'a str),
    /// A synthetic world: `synthetic:WORLD`.
    Synthetic(&'a str),
    /// A folder of images, an image or a video file.
    Path(&'a Path),
}

impl<'a> From<&'a str> for Address<'a> {
    fn from(text: &'a str) -> Self {
        match text.split_once(':') {
            Some(("v4l2", device)) => Self::Camera(device),
            Some(("synthetic", world)) => Self::Synthetic(world),
            _ => Self::Path(Path::new(text)),
        }
    }
}

/// Decodes a JPEG or PNG; `name` is what errors call it.
///
/// # Errors
/// Those of [`codec::decode`].
pub fn decode(bytes: &[u8], name: &str) -> Result<RgbImage, SourceError> {
    decode_in(bytes, name, Vec::new())
}

/// The same; of a JPEG the pixels are made in the memory of `spare`.
fn decode_in(bytes: &[u8], name: &str, spare: Vec<u8>) -> Result<RgbImage, SourceError> {
    let named = |CodecError { reason }| SourceError::BadImage { name: name.to_owned(), reason };
    codec::decode(bytes, spare).map_err(named)
}

/// The wall clock in nanoseconds since the Unix epoch.
pub(crate) fn wall_nanos() -> i64 {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since_epoch.as_nanos()).unwrap_or(i64::MAX)
}

/// Opens `source` (a folder, an image, a video file, `synthetic:…` or `v4l2:…`) and hands out every
/// `sample_interval`-th frame; by default every one, of a camera or video about three a second.
///
/// # Errors
/// If there is no such source or it holds no frames.
pub fn open(source: &str, sample_interval: Option<u64>) -> Result<Box<dyn FrameSource>, SourceError> {
    let path = match Address::from(source) {
        Address::Camera(device) => return open_camera(device, sample_interval),
        Address::Synthetic(world) => {
            let interval = sample_interval.unwrap_or(1);
            return Ok(Box::new(synthetic::SyntheticSource::open(world.parse()?, interval)));
        }
        Address::Path(path) => path,
    };
    let metadata = path.metadata().map_err(|source| SourceError::Io { path: path.to_owned(), source })?;
    if metadata.is_dir() {
        return Ok(Box::new(DirectorySource::open(path, sample_interval.unwrap_or(1))?));
    }
    if is_image(path) {
        return Ok(Box::new(DirectorySource::of_files(vec![path.to_owned()])));
    }
    Ok(Box::new(VideoSource::open(path, sample_interval)?))
}

/// How many frames `source` announces, none of them sampled out, without reading any.
///
/// # Errors
/// As those of [`open`].
pub fn announced_frames(source: &str) -> Result<Option<u64>, SourceError> {
    match Address::from(source) {
        // A world takes longer to build than its drive to count.
        Address::Synthetic(world) => Ok(Some(world.parse::<synthetic::SyntheticSpec>()?.drive_length())),
        _ => Ok(open(source, Some(1))?.frame_count()),
    }
}

#[cfg(feature = "v4l")]
fn open_camera(camera: &str, sample_interval: Option<u64>) -> Result<Box<dyn FrameSource>, SourceError> {
    camera::open(camera, sample_interval)
}

#[cfg(not(feature = "v4l"))]
fn open_camera(camera: &str, _: Option<u64>) -> Result<Box<dyn FrameSource>, SourceError> {
    let reason = "this build has no cameras; build with `--features v4l`".to_owned();
    Err(SourceError::Camera { device: camera.to_owned(), reason })
}
