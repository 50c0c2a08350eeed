//! Perception: everything about a frame that needs no memory of others, done side by side.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::{io, thread};

use crossbeam_channel::bounded;

use super::exchange::{Describer, Exchange, ModelInUse};
use super::stages::{self, Inputs};
use super::{QUEUE_FRAMES, Watcher};
use crate::cnn::DescriptorModel;
use crate::feature::OrbExtractor;
use crate::frame::Frame;
use crate::recognition::Look;
use crate::source::FrameSource;
use crate::telemetry::CnnStatus;
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
}

/// Time that perception took, in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PerceptionLatency {
    /// Reading, rendering or waiting for the frame.
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
}

impl<'a> Perception<'a> {
    /// What finds features by `extractor` and their words in `vocabularies`, and describes frames by `model`.
    #[must_use]
    pub fn new(
        extractor: &'a mut OrbExtractor,
        vocabularies: &'a VocabularySet,
        model: Option<&'a mut DescriptorModel>,
    ) -> Self {
        Self { extractor, vocabularies, model, exchange: None }
    }

    /// The same, but that models take over which come by `exchange`.
    pub(super) fn replacing_by(self, exchange: Option<Exchange>) -> Self {
        Self { exchange, ..self }
    }

    /// Looks at every frame of `source`, in order, until it ends, `stop` is set or `visit` breaks off.
    /// Answers how many frames could not be read.
    ///
    /// # Errors
    /// What `visit` answers; or that the system has no thread left.
    pub fn run<E: From<io::Error>>(
        self,
        source: Box<dyn FrameSource>,
        stop: &AtomicBool,
        watcher: &dyn Watcher,
        visit: impl FnMut(Seen) -> Result<ControlFlow<()>, E>,
    ) -> Result<u64, E> {
        let Self { extractor, vocabularies, model, exchange } = self;
        let (to_features, captured) = bounded(QUEUE_FRAMES);
        let (to_inputs, featured) = bounded(QUEUE_FRAMES);
        thread::scope(|scope| {
            let (to_cnn, described) = match model {
                None => (None, None),
                Some(model) => {
                    let (to_cnn, captured) = bounded(QUEUE_FRAMES);
                    let (to_inputs, described) = bounded(QUEUE_FRAMES);
                    let describer = Describer::new(model, exchange);
                    stages::named("cnn")
                        .spawn_scoped(scope, || stages::describe(describer, captured, to_inputs))?;
                    (Some(to_cnn), Some(described))
                }
            };
            let capture = stages::named("capture")
                .spawn_scoped(scope, || stages::capture(source, stop, watcher, (to_features, to_cnn)))?;
            stages::named("features")
                .spawn_scoped(scope, || stages::extract(extractor, vocabularies, captured, to_inputs))?;
            let visited = visit_all(Inputs { featured, described }, watcher, visit);
            let skipped = stages::joined(capture);
            visited.map(|()| skipped)
        })
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
        let seen = seen(featured, described);
        watcher.seen(&seen);
        if visit(seen)?.is_break() {
            break;
        }
    }
    Ok(())
}

fn seen(featured: stages::Featured, described: Option<stages::Described>) -> Seen {
    let stages::Featured { captured, features, light, quantised, features_us } = featured;
    let cnn = match &described {
        None => CnnStatus::Unavailable,
        Some(described) if described.descriptor.is_ok() => CnnStatus::Available,
        Some(_) => CnnStatus::Failed,
    };
    let cnn_us = described.as_ref().map_or(0, |described| described.cnn_us);
    let model = described.as_ref().map(|described| described.model.clone());
    let appearance = described.and_then(|described| described.descriptor.ok());
    let latency = PerceptionLatency { decode_us: captured.decode_us, features_us, cnn_us };
    let look = Look { features, light, quantised, appearance };
    Seen { frame: captured.frame, look, cnn, model, latency }
}
