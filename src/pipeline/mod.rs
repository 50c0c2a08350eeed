//! The stream: its threads and the queues between them.
//!
//! ```text
//! capture ─┬─> features ─┐
//!          └─> cnn ──────┴─> recognition ──> sinks
//! ```
//!
//! Queues are bounded, and a full one holds up the stage before it, so memory does not grow; files
//! lose no frame. Whatever ends one stage (the last frame, a failure, the stop flag) closes its queue,
//! and the others follow.

mod stages;
mod summary;

pub use summary::{RunSummary, StageStatistics};

use std::sync::atomic::AtomicBool;
use std::thread;

use crossbeam_channel::bounded;

use crate::cnn::{CnnError, DescriptorModel};
use crate::feature::OrbExtractor;
use crate::place_map::MapError;
use crate::recognition::Recogniser;
use crate::source::{FrameSource, SourceError};
use crate::telemetry::{FrameRecord, RecognitionSink, TelemetryError};

/// Frames that wait between two stages at most.
const QUEUE_FRAMES: usize = 4;

/// Why a stream ended early.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PipelineError {
    /// What was learnt cannot be stored.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A recognition cannot be delivered.
    #[error(transparent)]
    Telemetry(#[from] TelemetryError),
    /// The system has no thread left.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// Hears what happens while a stream runs.
pub trait Watcher: Sync {
    /// A frame could not be read and was skipped.
    fn skipped(&self, error: &SourceError);
    /// The CNN failed on a frame, which BoW+HV then decided alone.
    fn cnn_failed(&self, frame_name: &str, error: &CnnError);
    /// A frame was decided.
    fn decided(&self, record: &FrameRecord);
}

/// The parts of a stream, ready to run.
pub struct Pipeline {
    /// Where frames come from.
    pub source: Box<dyn FrameSource>,
    /// Finds features.
    pub extractor: OrbExtractor,
    /// The CNN, if there is one.
    pub model: Option<DescriptorModel>,
    /// Decides.
    pub recogniser: Recogniser,
    /// Where recognitions go.
    pub sinks: Vec<Box<dyn RecognitionSink>>,
}

impl Pipeline {
    /// Runs the stream to its end or until `stop` is set; then everything learnt is on the medium.
    ///
    /// # Errors
    /// If the map cannot be written or a sink refuses a record.
    pub fn run(self, stop: &AtomicBool, watcher: &dyn Watcher) -> Result<RunSummary, PipelineError> {
        let Self { source, extractor, model, recogniser, sinks } = self;
        let (to_features, captured) = bounded(QUEUE_FRAMES);
        let (to_recognition, featured) = bounded(QUEUE_FRAMES);
        let (to_sinks, records) = bounded(QUEUE_FRAMES);
        let vocabulary = recogniser.vocabulary().clone();
        let shows_matched = sinks.iter().any(|sink| sink.shows_matched_keyframe());
        thread::scope(|scope| {
            let spawn = |name: &str| thread::Builder::new().name(format!("loci-{name}"));
            let (to_cnn, described) = match model {
                None => (None, None),
                Some(model) => {
                    let (to_cnn, captured) = bounded(QUEUE_FRAMES);
                    let (to_recognition, described) = bounded(QUEUE_FRAMES);
                    spawn("cnn").spawn_scoped(scope, || stages::describe(model, captured, to_recognition))?;
                    (Some(to_cnn), Some(described))
                }
            };
            let capture = spawn("capture")
                .spawn_scoped(scope, || stages::capture(source, stop, watcher, (to_features, to_cnn)))?;
            spawn("features").spawn_scoped(scope, move || {
                stages::extract(&extractor, &vocabulary, captured, to_recognition);
            })?;
            let delivery = spawn("sinks").spawn_scoped(scope, || stages::deliver(sinks, records))?;
            let inputs = stages::Inputs { featured, described };
            let recognised = stages::recognise(recogniser, inputs, (to_sinks, shows_matched), watcher);
            let delivered = stages::joined(delivery);
            let skipped = stages::joined(capture);
            let mut summary = recognised?;
            summary.skipped = skipped;
            match delivered {
                Err(TelemetryError::ReaderGone) | Ok(()) => Ok(summary),
                Err(error) => Err(error.into()),
            }
        })
    }
}
