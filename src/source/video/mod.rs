//! Video files: whatever the installed `ffmpeg` decodes, with each frame's own presentation time.
//!
//! ffmpeg runs as a plain child process. The crate `ffmpeg-sidecar` reads it in threads of its own, which
//! here only the pipeline starts, and counts a frame's time from its number, which is wrong where the
//! rate varies. Frames count as decoded: one that is hidden or lost has no number. The picture is turned
//! as the file says. A file is only ever read as one of the usual containers, never as a playlist that
//! names other files, and never over a network.

mod decoder;
mod probe;
mod process;
mod selection;

use std::ffi::OsString;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use self::decoder::{Decoder, Stamp};
use self::probe::VideoInfo;
use self::selection::Selection;
use super::{FrameSource, SourceError};
use crate::frame::Frame;
use crate::kernel::luma;

/// Frames a second that are handed out unless another interval is asked for.
const DEFAULT_RATE_HZ: f64 = 3.0;
/// How long ffmpeg may take for one frame.
const PATIENCE: Duration = Duration::from_secs(30);
/// How many frame times earlier than announced a video may end before it counts as cut off.
const MAX_LACK_FRAMES: f64 = 2.0;
const NANOS_PER_SECOND: f64 = 1e9;
/// Formats that hold a video by themselves.
const CONTAINERS: &str = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,h264,hevc,\
                          mjpeg,ivf,obu,ogg,flv,asf,nut,mxf,dv,gif";

/// What ffmpeg's programs are called.
#[derive(Clone, Copy, Debug)]
struct Programs {
    ffmpeg: &'static str,
    ffprobe: &'static str,
}

const INSTALLED: Programs = Programs { ffmpeg: "ffmpeg", ffprobe: "ffprobe" };

/// The version of the installed ffmpeg, if there is one.
#[must_use]
pub fn ffmpeg_version() -> Option<String> {
    probe::version(INSTALLED)
}

/// Frames of a video file, in order.
///
/// A frame's index is its number in the video, its time of capture the presentation time from the
/// start of the video, and its name `FILE#INDEX`. A video that is cut off or damaged gives the frames
/// that can be decoded and then one error.
#[derive(Debug)]
pub struct VideoSource {
    path: PathBuf,
    info: VideoInfo,
    selection: Selection,
    /// `None` after the last frame.
    decoder: Option<Decoder>,
    /// Presentation time of the frame decoded last, in nanoseconds.
    latest_nanos: Option<i64>,
}

impl VideoSource {
    /// Hands out every `sample_interval`-th frame, by default about three a second.
    ///
    /// # Errors
    /// If there is no ffmpeg, or the file cannot be read or is no video.
    pub fn open(path: &Path, sample_interval: Option<u64>) -> Result<Self, SourceError> {
        Self::open_with(path, INSTALLED, |info| {
            let default = || (info.fps / DEFAULT_RATE_HZ).round() as u64;
            Selection::every(sample_interval.unwrap_or_else(default))
        })
    }

    /// Hands out exactly the frames with these indices, which must ascend. An error follows those that
    /// could be read if the video has fewer. The frames between are decoded and dropped: seeking is only
    /// as exact as the container.
    ///
    /// # Errors
    /// If the indices do not ascend, there is no ffmpeg, or the file cannot be read or is no video.
    pub fn with_frames(path: &Path, frames: Vec<u64>) -> Result<Self, SourceError> {
        let Some(selection) = Selection::exactly(frames) else {
            let reason = "frames must be asked for in ascending order, each once; sort them".to_owned();
            return Err(SourceError::BadVideo { path: path.to_owned(), reason });
        };
        Self::open_with(path, INSTALLED, |_| selection)
    }

    fn open_with(
        path: &Path,
        programs: Programs,
        select: impl FnOnce(VideoInfo) -> Selection,
    ) -> Result<Self, SourceError> {
        check_file(path)?;
        let start = || {
            let info = probe::probe(path, programs)?;
            let selection = select(info);
            let decoder =
                if selection.is_over(0) { None } else { Some(Decoder::start(path, &selection, programs)?) };
            Ok(Self { path: path.to_owned(), info, selection, decoder, latest_nanos: None })
        };
        start().map_err(|reason| SourceError::BadVideo { path: path.to_owned(), reason })
    }

    /// The next frame that is wanted; `None` at the end of the video.
    fn advance(&mut self, decoder: &mut Decoder) -> Result<Option<Frame>, String> {
        while let Some(stamp) = decoder.next_stamp()? {
            let capture_nanos = self.capture_nanos(stamp);
            if self.selection.is_sent(stamp.index) {
                let colour = decoder.picture()?;
                if self.selection.is_wanted(stamp.index) {
                    let file = self.path.file_name().unwrap_or_default().to_string_lossy();
                    return Ok(Some(Frame {
                        index: stamp.index,
                        capture_nanos,
                        name: format!("{file}#{}", stamp.index),
                        grey: luma(&colour),
                        colour,
                        jpeg: None,
                        pose: None,
                        true_place: None,
                    }));
                }
            }
        }
        Ok(None)
    }

    /// The presentation time; of a frame without one, the usual distance from the frame before.
    fn capture_nanos(&mut self, stamp: Stamp) -> i64 {
        let usual = (NANOS_PER_SECOND / self.info.fps) as i64;
        let nanos = match (stamp.nanos, self.latest_nanos) {
            (Some(nanos), _) => nanos,
            (None, Some(latest)) => latest.saturating_add(usual),
            (None, None) => 0,
        };
        self.latest_nanos = Some(nanos);
        nanos
    }

    /// Whether the video was read as far as it goes; ffmpeg ends a file that is cut off like any other.
    fn check_end(&self, decoder: &mut Decoder) -> Result<(), String> {
        let complaint = decoder.finish().err();
        let (decoded, announced) = (decoder.decoded(), self.info.frame_count);
        let announced_count = announced.map(|count| format!(" of {count}")).unwrap_or_default();
        let fix = "copy or convert the video again";
        if let Some(complaint) = complaint {
            Err(format!(
                "damaged or cut off; {decoded}{announced_count} frames were read ({complaint}); {fix}"
            ))
        } else if decoded == 0 {
            Err(format!("it has no frame; {fix}"))
        } else if announced.is_some_and(|count| self.is_cut_off(decoded, count)) {
            Err(format!("cut off; {decoded}{announced_count} frames were read; {fix}"))
        } else if let Some(frame) = self.selection.first_missing(decoded) {
            Err(format!("there is no frame {frame}; the last is {}", decoded - 1))
        } else {
            Ok(())
        }
    }

    /// Whether too few frames came and they ended too early. AVI files count frames that are only
    /// repetitions, which hold no picture: too few frames alone mean nothing.
    fn is_cut_off(&self, decoded: u64, announced: u64) -> bool {
        let latest_frame = self.latest_nanos.unwrap_or_default() as f64 / NANOS_PER_SECOND * self.info.fps;
        decoded < announced && latest_frame + 1.0 + MAX_LACK_FRAMES < announced as f64
    }
}

impl FrameSource for VideoSource {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        // Whatever does not put the decoder back ends the stream.
        let mut decoder = self.decoder.take()?;
        let read = match self.advance(&mut decoder) {
            Ok(None) => self.check_end(&mut decoder).map(|()| None),
            read => read,
        };
        match read.transpose()? {
            Ok(frame) => {
                if !self.selection.is_over(frame.index + 1) {
                    self.decoder = Some(decoder);
                }
                Some(Ok(frame))
            }
            Err(reason) => Some(Err(SourceError::BadVideo { path: self.path.clone(), reason })),
        }
    }

    fn frame_count(&self) -> Option<u64> {
        self.selection.count(self.info.frame_count)
    }
}

/// Refuses what is not a file with something in it; a pipe would block.
fn check_file(path: &Path) -> Result<(), SourceError> {
    let io = |source| SourceError::Io { path: path.to_owned(), source };
    let metadata = path.metadata().map_err(io)?;
    let refused =
        |reason: &str| Err(SourceError::BadVideo { path: path.to_owned(), reason: reason.to_owned() });
    if metadata.is_dir() {
        refused("it is a folder; name a video file in it")
    } else if !metadata.is_file() {
        refused("it is not a regular file; copy the video into one")
    } else if metadata.len() == 0 {
        refused("the file is empty; copy it again")
    } else {
        File::open(path).map(|_| ()).map_err(io)
    }
}

/// Names `path` to ffmpeg as a file and nothing else, whatever characters it has.
fn add_input(command: &mut Command, path: &Path) {
    let mut input = OsString::from("file:");
    input.push(path);
    command.args(["-protocol_whitelist", "file", "-format_whitelist", CONTAINERS, "-i"]).arg(input);
}

#[cfg(test)]
mod tests;
