//! The stream: its threads and the queues between them.
//!
//! ```text
//! capture ──> features ────┬─> recognition ─┬─> sink
//!                │         │        ▲       └─> sink
//!                └──> cnn ─┘        │
//!                      ▲            │
//!                      └── models ──┘
//! ```
//!
//! Every box is a thread, and finding features goes on while the CNN looks at the same frame. Queues are bounded, so
//! memory does not grow. A full one holds up the stage before it, and files lose no frame; a live source cannot be held
//! up, so there the oldest frame gives way, and a sink that is slow misses records. Whatever ends one stage (the last
//! frame, a failure, the stop flag) closes its queue, and the others follow.

mod capture;
mod decider;
mod delivery;
mod desk;
mod exchange;
#[cfg(test)]
mod flow_tests;
mod folder_watch;
mod intake;
mod model_keeper;
#[cfg(all(test, feature = "cnn"))]
mod model_tests;
mod onlooker;
mod pacing;
mod perception;
mod pool;
mod self_test;
mod stages;
mod summary;
mod watcher;

pub use exchange::ModelInUse;
pub use model_keeper::ModelFolder;
pub use pacing::{BudgetError, CpuBudget};
pub use perception::{Perception, PerceptionLatency, Seen};
pub use summary::{ANSWER, RunSummary, StageStatistics};
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
use decider::{Decider, Visit};
use delivery::Delivery;
use model_keeper::ModelKeeper;
use onlooker::Onlooker;
use perception::Spare;

/// Frames that wait between two stages at most.
const QUEUE_FRAMES: usize = 4;
/// Looks and descriptors whose memory waits to be used again.
const SPARE: usize = 24;

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
    /// Processor time that all of it may take, if not as much as there is.
    pub budget: Option<CpuBudget>,
}

impl Pipeline {
    /// Runs the stream to its end or until `stop` is set; then everything learnt is on the medium.
    ///
    /// # Errors
    /// If a sink refuses a record of a source that is not live, or no thread can be had. A map that fails ends nothing:
    /// the watcher hears of it, as it does of the sinks of a live source.
    pub fn run(self, stop: &AtomicBool, watcher: &dyn Watcher) -> Result<RunSummary, PipelineError> {
        let Self { source, mut extractor, mut model, model_folder, recogniser, sinks, budget } = self;
        let kept = model_folder.filter(|_| recogniser.has_cnn()).zip(model.as_ref());
        let kept = kept.map(|(folder, model)| ModelKeeper::new(folder, model.card(), watcher));
        let (keeper, desk, exchange) = match kept {
            Some((keeper, desk, exchange)) => (Some(keeper), Some(desk), Some(exchange)),
            None => (None, None, None),
        };
        let vocabularies = recogniser.vocabularies().clone();
        let upkeep = match recogniser.map().options().durability {
            Durability::Interval(interval) => Some((recogniser.map().syncer(), interval)),
            Durability::Every | Durability::None => None,
        };
        let shows_matched = sinks.iter().any(|sink| sink.shows_matched_keyframe());
        let is_looked_on = shows_matched || sinks.iter().any(|sink| sink.looks_on());
        let onlooker = is_looked_on.then(|| Onlooker::new(shows_matched));
        let delivery = Delivery::start(sinks, source.is_live())?;
        let ((spare_looks, looks), (spare_descriptors, descriptors)) = (bounded(SPARE), bounded(SPARE));
        thread::scope(|scope| {
            let perception = Perception::new(&mut extractor, &vocabularies, model.as_mut());
            let perception =
                perception.replacing_by(exchange).within(budget).reusing(Spare { looks, descriptors });
            let perceive = |visit: Visit<'_>| perception.run(source, stop, watcher, visit);
            let (keeping, ended) = bounded(0);
            if let Some((syncer, interval)) = upkeep {
                stages::named("map").spawn_scoped(scope, move || stages::keep(&syncer, interval, &ended))?;
            }
            if let Some(keeper) = keeper {
                stages::named("models").spawn_scoped(scope, move || keeper.run())?;
            }
            let spare = (spare_looks, spare_descriptors);
            let decider = Decider { recogniser, desk, delivery, spare, onlooker, watcher };
            let summary = decider.run(perceive);
            drop::<Sender<()>>(keeping);
            summary
        })
    }
}
