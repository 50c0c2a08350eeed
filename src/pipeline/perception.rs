//! Perception: everything about a frame that needs no memory of others, done side by side.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use std::{io, thread};

use crossbeam_channel::{Receiver, bounded, never};

use super::capture::Capture;
use super::exchange::{Describer, Exchange, ModelInUse};
use super::intake::{Captured, intake};
use super::pacing::{CpuBudget, Pace};
use super::stages::{self, Extraction, Inputs};
use super::{QUEUE_FRAMES, Watcher};
use crate::cnn::{self, DescriptorModel};
use crate::feature::OrbExtractor;
use crate::frame::Frame;
use crate::recognition::Look;
use crate::source::FrameSource;
use crate::telemetry::{CnnStatus, Flow, Losses, Waiting};
use crate::vocabulary::VocabularySet;

/// A frame and what was seen in it.
#[derive(Clone, Debug)]
pub struct Seen {
    /// The frame.
    pub frame: Arc<Frame>,
    /// What was seen in it.
    pub look: Look,
    /// What the CNN contributed.
    pub cnn: CnnStatus,
    /// The model that the frame was given to, if there is one.
    pub model: Option<ModelInUse>,
    /// How long it took.
    pub latency: PerceptionLatency,
    /// When it was captured; where the source is not live, when reading it began.
    pub captured_at: Instant,
    /// How the stream keeps pace with its source, as far as sinks have no part in it.
    pub flow: Flow,
}

/// Time that perception took, in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PerceptionLatency {
    /// Reading and decoding or rendering the frame; of a live source everything since it was captured.
    pub decode_us: u64,
    /// Features and their words.
    pub features_us: u64,
    /// The CNN.
    pub cnn_us: u64,
}

impl PerceptionLatency {
    /// Decoding, then features or the CNN, whichever takes longer: they go side by side.
    pub(super) fn longest_us(&self) -> u64 {
        self.decode_us + self.features_us.max(self.cnn_us)
    }
}

/// What sees: features with their words, and the CNN where there is one.
pub struct Perception<'a> {
    /// Finds features.
    pub extractor: &'a mut OrbExtractor,
    /// Knows their words, in every light.
    pub vocabularies: &'a VocabularySet,
    /// The CNN, if there is one.
    pub model: Option<&'a mut DescriptorModel>,
    /// Where other models come from.
    exchange: Option<Exchange>,
    /// Processor time that all of it may take.
    budget: Option<CpuBudget>,
    /// What is not needed any more.
    spare: Spare,
}

/// Looks and descriptors whose memory may be used again.
pub(super) struct Spare {
    pub(super) looks: Receiver<Look>,
    pub(super) descriptors: Receiver<cnn::Descriptor>,
}

impl<'a> Perception<'a> {
    /// What finds features by `extractor` and their words in `vocabularies`, and describes frames by `model`.
    #[must_use]
    pub fn new(
        extractor: &'a mut OrbExtractor,
        vocabularies: &'a VocabularySet,
        model: Option<&'a mut DescriptorModel>,
    ) -> Self {
        let spare = Spare { looks: never(), descriptors: never() };
        Self { extractor, vocabularies, model, exchange: None, budget: None, spare }
    }

    /// The same, but that models take over which come by `exchange`.
    pub(super) fn replacing_by(self, exchange: Option<Exchange>) -> Self {
        Self { exchange, ..self }
    }

    /// The same, but that it looks at no more frames than fit into `budget`.
    pub(super) fn within(self, budget: Option<CpuBudget>) -> Self {
        Self { budget, ..self }
    }

    /// The same, in the memory of what comes by `spare`.
    pub(super) fn reusing(self, spare: Spare) -> Self {
        Self { spare, ..self }
    }

    /// Looks at every frame of `source`, in order, until it ends, `stop` is set or `visit` breaks off.
    /// Answers which frames did not come through.
    ///
    /// # Errors
    /// What `visit` answers; or that the system has no thread left.
    pub fn run<E: From<io::Error>>(
        self,
        source: Box<dyn FrameSource>,
        stop: &AtomicBool,
        watcher: &dyn Watcher,
        visit: impl FnMut(Seen) -> Result<ControlFlow<()>, E>,
    ) -> Result<Losses, E> {
        let Self { extractor, vocabularies, model, exchange, budget, spare } = self;
        let depth = QueueDepths::of(source.is_live());
        let (entrance, exit) = intake(source.is_live());
        let (to_inputs, featured) = bounded(depth.recognition[0]);
        thread::scope(|scope| {
            let (to_cnn, described) = match model {
                None => (None, None),
                Some(model) => {
                    let (to_cnn, frames) = bounded(depth.cnn);
                    let (to_inputs, described) = bounded(depth.recognition[1]);
                    let describer = Describer::new(model, exchange);
                    stages::named("cnn").spawn_scoped(scope, || {
                        stages::describe(describer, (frames, spare.descriptors), to_inputs)
                    })?;
                    (Some(to_cnn), Some(described))
                }
            };
            let capture = Capture { source, entrance, pace: budget.map(Pace::new), watcher };
            let capture = stages::named("capture").spawn_scoped(scope, || capture.run(stop))?;
            let extraction = Extraction { extractor, vocabularies, spare: spare.looks };
            stages::named("features")
                .spawn_scoped(scope, move || extraction.run(&exit, to_cnn, to_inputs))?;
            let visited = visit_all(Inputs { featured, described }, watcher, visit);
            let losses = stages::joined(capture);
            visited.map(|()| losses)
        })
    }
}

/// Frames that wait before a stage at most. Of a live source none waits longer than it has to.
struct QueueDepths {
    cnn: usize,
    /// Of those with features, and of those described.
    recognition: [usize; 2],
}

impl QueueDepths {
    fn of(is_live: bool) -> Self {
        if is_live {
            Self { cnn: 0, recognition: [0, 1] }
        } else {
            Self { cnn: QUEUE_FRAMES, recognition: [QUEUE_FRAMES; 2] }
        }
    }
}

fn visit_all<E>(
    inputs: Inputs,
    watcher: &dyn Watcher,
    mut visit: impl FnMut(Seen) -> Result<ControlFlow<()>, E>,
) -> Result<(), E> {
    while let Some((featured, described)) = inputs.next() {
        if let Some(error) = described.as_ref().and_then(|described| described.descriptor.as_ref().err()) {
            watcher.cnn_failed(&featured.captured.frame.name, error);
        }
        let seen = seen(featured, described, inputs.featured.len());
        watcher.seen(&seen);
        if visit(seen)?.is_break() {
            break;
        }
    }
    Ok(())
}

/// Puts together what the stages found of a frame, behind which so many wait to be decided.
fn seen(featured: stages::Featured, described: Option<stages::Described>, recognition: usize) -> Seen {
    let stages::Featured { captured, mut look, features_us, waiting: features } = featured;
    let Captured { frame, decode_us, captured_at, losses } = captured;
    let cnn = match &described {
        None => CnnStatus::Unavailable,
        Some(described) if described.descriptor.is_ok() => CnnStatus::Available,
        Some(_) => CnnStatus::Failed,
    };
    let (cnn_us, waiting_cnn) =
        described.as_ref().map_or((0, 0), |described| (described.cnn_us, described.waiting));
    let model = described.as_ref().map(|described| described.model.clone());
    look.appearance = described.and_then(|described| described.descriptor.ok());
    let latency = PerceptionLatency { decode_us, features_us, cnn_us };
    let waiting = Waiting { features, cnn: waiting_cnn, recognition, sinks: 0 };
    let flow = Flow { waiting, losses, missed_records: 0 };
    Seen { frame, look, cnn, model, latency, captured_at, flow }
}
