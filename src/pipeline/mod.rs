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

mod perception;
mod stages;
mod summary;

pub use perception::{Perception, PerceptionLatency, Seen};
pub use summary::{RunSummary, StageStatistics};

use std::sync::atomic::AtomicBool;
use std::thread;

use crossbeam_channel::{Sender, bounded};

use crate::cnn::{CnnError, DescriptorModel};
use crate::feature::OrbExtractor;
use crate::place_map::{Durability, MapError};
use crate::recognition::Recogniser;
use crate::source::{FrameSource, SourceError};
use crate::telemetry::{FrameRecord, RecognitionSink, TelemetryError};

/// Frames that wait between two stages at most.
const QUEUE_FRAMES: usize = 4;

/// Why a stream ended early.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PipelineError {
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
    /// The map could not be read or changed; unless the robot `goes_on_learning`, it is only read from here on.
    fn map_failed(&self, failure: &MapError, goes_on_learning: bool);
    /// A frame was looked at.
    fn seen(&self, _seen: &Seen) {}
    /// A frame was decided.
    fn decided(&self, _record: &FrameRecord) {}
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
    /// If a sink refuses a record or no thread can be had. A map that fails ends nothing: the watcher hears of it.
    pub fn run(self, stop: &AtomicBool, watcher: &dyn Watcher) -> Result<RunSummary, PipelineError> {
        let Self { source, extractor, mut model, recogniser, sinks } = self;
        let vocabularies = recogniser.vocabularies().clone();
        let (to_sinks, records) = bounded(QUEUE_FRAMES);
        let upkeep = match recogniser.map().options().durability {
            Durability::Interval(interval) => Some((recogniser.map().syncer(), interval)),
            Durability::Every | Durability::None => None,
        };
        let shows_matched = sinks.iter().any(|sink| sink.shows_matched_keyframe());
        thread::scope(|scope| {
            let delivery = stages::named("sinks").spawn_scoped(scope, || stages::deliver(sinks, records))?;
            let perception =
                Perception { extractor: &extractor, vocabularies: &vocabularies, model: model.as_mut() };
            let perceive = |visit: stages::Visit<'_>| perception.run(source, stop, watcher, visit);
            let (keeping, ended) = bounded(0);
            if let Some((syncer, interval)) = upkeep {
                stages::named("map").spawn_scoped(scope, move || stages::keep(&syncer, interval, &ended))?;
            }
            let recognised = stages::recognise(recogniser, perceive, (to_sinks, shows_matched), watcher);
            drop::<Sender<()>>(keeping);
            let delivered = stages::joined(delivery);
            let summary = recognised?;
            match delivered {
                Err(TelemetryError::ReaderGone) | Ok(()) => Ok(summary),
                Err(error) => Err(error.into()),
            }
        })
    }
}
