//! Where recognitions go: JSON Lines for machines, rerun for people.

mod json_lines;
mod log_line;
#[cfg(feature = "rerun")]
mod rerun;

pub use json_lines::JsonLines;
#[cfg(feature = "rerun")]
pub use rerun::{
    Finding, RerunDetail, RerunSink, RerunTarget, ReviewError, Reviewed, ReviewedRun, Rotation, open_viewer,
    review_map, review_run,
};

use std::io;
use std::sync::Arc;

use crate::frame::Frame;
use crate::recognition::{Insight, Look, MatchedKeyframe, Recognition};

/// Everything that is known about a processed frame.
#[derive(Clone, Debug)]
pub struct FrameRecord {
    /// The frame.
    pub frame: Arc<Frame>,
    /// What was seen in it.
    pub look: Look,
    /// What was decided.
    pub recognition: Recognition,
    /// The keyframe that was matched, if a sink looks on.
    pub matched: Option<MatchedKeyframe>,
    /// What the answer went by, likewise.
    pub insight: Option<Box<Insight>>,
    /// Whether the CNN took part.
    pub cnn: CnnStatus,
    /// Hash of the CNN's model, if it is another one from this frame on.
    pub model: Option<String>,
    /// How long each stage took.
    pub latency: StageLatency,
    /// How the stream keeps pace with its source.
    pub flow: Flow,
}

/// Whether the CNN took part in a decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CnnStatus {
    /// It gave a descriptor.
    Available,
    /// There is no ONNX Runtime or no model: BoW+HV decided alone.
    Unavailable,
    /// It failed on this frame.
    Failed,
}

impl CnnStatus {
    /// The word for it in records; none where all is well.
    #[must_use]
    pub fn as_str(self) -> Option<&'static str> {
        match self {
            Self::Available => None,
            Self::Unavailable => Some("unavailable"),
            Self::Failed => Some("failed"),
        }
    }
}

/// How long each stage took for one frame, in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StageLatency {
    /// Reading and decoding, or rendering, the frame; of a live source everything since it was captured.
    pub decode_us: u64,
    /// ORB features and their words.
    pub features_us: u64,
    /// The CNN descriptor.
    pub cnn_us: u64,
    /// Finding candidates.
    pub retrieval_us: u64,
    /// Verifying them.
    pub verification_us: u64,
    /// The longest way through: decoding, then features or CNN, whichever takes longer, then the
    /// decision with its storing, and a few keyframes described anew where a model is replaced. Waiting in queues is
    /// left out.
    pub total_us: u64,
    /// From capture to the answer, waiting included: of a live source from when the frame was taken, else from when
    /// reading it began.
    pub answer_us: u64,
}

/// How a stream keeps pace with its source, as of one frame; losses are counted from the beginning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flow {
    /// Depths of the queues.
    pub waiting: Waiting,
    /// Frames that did not come through.
    pub losses: Losses,
    /// Records of a live stream that a sink was too slow to take.
    pub missed_records: u64,
}

/// Frames that did not come through so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// That could not be read.
    pub unreadable: u64,
    /// That nobody fetched from the device in time.
    pub lost: u64,
    /// Of a live source, that gave way to newer ones.
    pub dropped: u64,
    /// That were left out to stay within the CPU budget.
    pub spared: u64,
}

/// How much waited behind a frame when its turn came.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Waiting {
    /// Frames, to have their features found.
    pub features: usize,
    /// Frames, to be described by the CNN.
    pub cnn: usize,
    /// Frames, to be decided.
    pub recognition: usize,
    /// Records, to be taken by the slowest sink.
    pub sinks: usize,
}

/// Somewhere that recognitions go.
pub trait RecognitionSink: Send {
    /// Takes one record.
    ///
    /// # Errors
    /// If the record cannot be delivered; the stream then ends, or, if it is live, goes on without this sink.
    fn record(&mut self, record: &FrameRecord) -> Result<(), TelemetryError>;

    /// Delivers what is still held back.
    ///
    /// # Errors
    /// If that fails.
    fn finish(&mut self) -> Result<(), TelemetryError>;

    /// Whether the sink looks on: it shows what answers go by.
    fn looks_on(&self) -> bool {
        false
    }

    /// Whether it shows the matched keyframe, too, which costs a read from the map.
    fn shows_matched_keyframe(&self) -> bool {
        false
    }
}

/// Why a record could not be delivered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TelemetryError {
    /// Whoever read the output has gone; nothing is wrong.
    #[error("the reader of the output has gone")]
    ReaderGone,
    /// The output cannot be written.
    #[error("cannot write the output: {0}")]
    Write(io::Error),
    /// At the end, somebody did not take what was left.
    #[error("an output took nothing any more; its last records are lost")]
    Stuck,
    /// rerun said no.
    #[error("rerun {target}: {reason}")]
    Rerun {
        /// Where recordings were to go.
        target: String,
        /// What rerun said, and what to do.
        reason: String,
    },
}

impl TelemetryError {
    /// Nothing where whoever read the output has gone.
    ///
    /// # Errors
    /// Any other one.
    pub(crate) fn unless_reader_gone(self) -> Result<(), Self> {
        if matches!(self, Self::ReaderGone) { Ok(()) } else { Err(self) }
    }
}

impl From<io::Error> for TelemetryError {
    fn from(error: io::Error) -> Self {
        if error.kind() == io::ErrorKind::BrokenPipe { Self::ReaderGone } else { Self::Write(error) }
    }
}
