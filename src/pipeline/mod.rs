//! The stream: its threads and the queues between them.
//!
//! ```text
//! capture ─┬─> features ─┐
//!          └─> cnn ──────┴─> recognition ──> sinks
//!               ▲               ▲
//!               └─── models ────┘
//! ```
//!
//! Queues are bounded, and a full one holds up the stage before it, so memory does not grow; files
//! lose no frame. Whatever ends one stage (the last frame, a failure, the stop flag) closes its queue,
//! and the others follow.

mod desk;
mod exchange;
mod folder_watch;
mod model_keeper;
#[cfg(all(test, feature = "cnn"))]
mod model_tests;
mod perception;
mod self_test;
mod stages;
mod summary;
mod watcher;

pub use exchange::ModelInUse;
pub use model_keeper::ModelFolder;
pub use perception::{Perception, PerceptionLatency, Seen};
pub use summary::{RunSummary, StageStatistics};
pub use watcher::Watcher;

use std::sync::atomic::AtomicBool;
use std::thread;

use crossbeam_channel::{Sender, bounded};

use crate::cnn::DescriptorModel;
use crate::feature::OrbExtractor;
use crate::place_map::Durability;
use crate::recognition::Recogniser;
use crate::source::FrameSource;
use crate::telemetry::{RecognitionSink, TelemetryError};
use model_keeper::ModelKeeper;

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

/// The parts of a stream, ready to run.
pub struct Pipeline {
    /// Where frames come from.
    pub source: Box<dyn FrameSource>,
    /// Finds features.
    pub extractor: OrbExtractor,
    /// The CNN, if there is one.
    pub model: Option<DescriptorModel>,
    /// Where the CNN came from, if it is to be replaced when another one is deployed there.
    pub model_folder: Option<ModelFolder>,
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
        let Self { source, mut extractor, mut model, model_folder, recogniser, sinks } = self;
        let kept = model_folder.filter(|_| recogniser.has_cnn()).zip(model.as_ref());
        let kept = kept.map(|(folder, model)| ModelKeeper::new(folder, model.card(), watcher));
        let (keeper, desk, exchange) = match kept {
            Some((keeper, desk, exchange)) => (Some(keeper), Some(desk), Some(exchange)),
            None => (None, None, None),
        };
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
                Perception::new(&mut extractor, &vocabularies, model.as_mut()).replacing_by(exchange);
            let perceive = |visit: stages::Visit<'_>| perception.run(source, stop, watcher, visit);
            let (keeping, ended) = bounded(0);
            if let Some((syncer, interval)) = upkeep {
                stages::named("map").spawn_scoped(scope, move || stages::keep(&syncer, interval, &ended))?;
            }
            if let Some(keeper) = keeper {
                stages::named("models").spawn_scoped(scope, move || keeper.run())?;
            }
            let decider = stages::Decider { recogniser, desk, to_sinks, shows_matched };
            let recognised = decider.run(perceive, watcher);
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
