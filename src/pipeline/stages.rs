//! The stages between capture and recognition, each a loop over its queue, and what all threads have in common.

use std::sync::Arc;
use std::thread::ScopedJoinHandle;
use std::time::{Duration, Instant};
use std::{panic, thread};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};

use super::exchange::{Describer, ModelInUse};
use super::intake::{Captured, Exit};
use crate::cnn::{self, CnnError};
use crate::feature::OrbExtractor;
use crate::frame::Frame;
use crate::place_map::JournalSyncer;
use crate::recognition::Look;
use crate::vocabulary::{LightSwitch, VocabularySet};

/// A frame with its features and their words.
pub(super) struct Featured {
    pub(super) captured: Captured,
    /// As far as it is known without the CNN.
    pub(super) look: Look,
    pub(super) features_us: u64,
    /// Frames that waited behind this one.
    pub(super) waiting: usize,
}

/// A frame's descriptor, or why there is none.
pub(super) struct Described {
    pub(super) descriptor: Result<cnn::Descriptor, CnnError>,
    /// What it was given to.
    pub(super) model: ModelInUse,
    pub(super) cnn_us: u64,
    /// Frames that waited behind this one.
    pub(super) waiting: usize,
}

/// A thread of that name, to be started.
pub(super) fn named(stage: &str) -> thread::Builder {
    thread::Builder::new().name(format!("loci-{stage}"))
}

/// What finds features.
pub(super) struct Extraction<'a> {
    pub(super) extractor: &'a mut OrbExtractor,
    pub(super) vocabularies: &'a VocabularySet,
    /// Looks whose memory may be used again.
    pub(super) spare: Receiver<Look>,
}

impl Extraction<'_> {
    /// Hands every frame on to the CNN, if there is one, and meanwhile finds its features and their words.
    pub(super) fn run(
        self,
        exit: &Exit,
        to_cnn: Option<Sender<Arc<Frame>>>,
        to_recognition: Sender<Featured>,
    ) {
        let mut switch = LightSwitch::default();
        while let Some((captured, waiting)) = exit.take() {
            if to_cnn.as_ref().is_some_and(|queue| queue.send(Arc::clone(&captured.frame)).is_err()) {
                break;
            }
            let started = Instant::now();
            let mut look = self.spare.try_recv().unwrap_or_default();
            look.light = switch.follow(self.vocabularies, captured.frame.grey.mean_luminance());
            self.extractor.extract_into(&captured.frame.grey, &mut look.features);
            look.quantised =
                self.vocabularies.vocabulary(look.light.condition).quantise_all(&look.features.descriptors);
            let featured = Featured { captured, look, features_us: micros(started), waiting };
            if to_recognition.send(featured).is_err() {
                break;
            }
        }
    }
}

/// Runs the CNN on every frame.
pub(super) fn describe(
    mut describer: Describer<'_>,
    frames: Receiver<Arc<Frame>>,
    to_recognition: Sender<Described>,
) {
    for frame in &frames {
        let described = Described { waiting: frames.len(), ..describer.describe(&frame.colour) };
        if to_recognition.send(described).is_err() {
            break;
        }
    }
}

/// What recognition waits for: a frame's features and, where a CNN runs, its descriptor. Both queues
/// hold the same frames in the same order.
pub(super) struct Inputs {
    pub(super) featured: Receiver<Featured>,
    pub(super) described: Option<Receiver<Described>>,
}

impl Inputs {
    /// Both halves of the next frame; `None` when one of the stages before has ended.
    pub(super) fn next(&self) -> Option<(Featured, Option<Described>)> {
        let featured = self.featured.recv().ok()?;
        match &self.described {
            None => Some((featured, None)),
            Some(queue) => Some((featured, Some(queue.recv().ok()?))),
        }
    }
}

/// Brings the map onto its medium every `interval`, until `ended` is closed.
pub(super) fn keep(syncer: &JournalSyncer, interval: Duration, ended: &Receiver<()>) {
    while ended.recv_timeout(interval) == Err(RecvTimeoutError::Timeout) {
        syncer.sync();
    }
}

/// What a stage answered; its panic, a defect of ours, goes on in the caller.
pub(super) fn joined<T>(stage: ScopedJoinHandle<'_, T>) -> T {
    stage.join().unwrap_or_else(|defect| panic::resume_unwind(defect))
}

/// Microseconds since then.
pub(super) fn micros(since: Instant) -> u64 {
    u64::try_from(since.elapsed().as_micros()).unwrap_or(u64::MAX)
}
