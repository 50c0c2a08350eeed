//! Where frames come from: a folder of images, a synthetic world, and later a camera or a video.
//!
//! A [`FrameSource`] hands out frames in order and never ends the stream because of one bad
//! image: that one is reported and the next call goes on.

pub mod synthetic;

use crate::frame::Frame;

/// A stream of frames.
pub trait FrameSource: Send {
    /// The next frame, an error about one frame that could not be read, or `None` at the end.
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>>;

    /// How many calls of [`next_frame`](Self::next_frame) will answer, if that is known beforehand.
    fn frame_count(&self) -> Option<u64>;
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
}
