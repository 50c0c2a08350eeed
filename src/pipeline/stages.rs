//! The stages, each a loop over its queue.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::ScopedJoinHandle;
use std::time::{Duration, Instant};
use std::{panic, thread};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};

use super::desk::Desk;
use super::exchange::{Describer, ModelInUse};
use super::perception::{PerceptionLatency, Seen};
use super::{PipelineError, RunSummary, Watcher};
use crate::cnn::{self, CnnError};
use crate::feature::{Features, OrbExtractor};
use crate::frame::Frame;
use crate::place_map::{JournalSyncer, MapError, PlaceMap};
use crate::recognition::{Decision, Recogniser, Recognition};
use crate::source::{FrameSource, thumbnail_jpeg};
use crate::telemetry::{FrameRecord, MatchedKeyframe, RecognitionSink, StageLatency, TelemetryError};
use crate::vocabulary::{Light, LightSwitch, Quantised, VocabularySet};

/// A frame on its way.
#[derive(Clone)]
pub(super) struct Captured {
    pub(super) frame: Arc<Frame>,
    pub(super) decode_us: u64,
}

/// A frame with its features and their words.
pub(super) struct Featured {
    pub(super) captured: Captured,
    pub(super) features: Features,
    pub(super) light: Light,
    pub(super) quantised: Vec<Quantised>,
    pub(super) features_us: u64,
}

/// A frame's descriptor, or why there is none.
pub(super) struct Described {
    pub(super) descriptor: Result<cnn::Descriptor, CnnError>,
    /// What it was given to.
    pub(super) model: ModelInUse,
    pub(super) cnn_us: u64,
}

/// What is done with a frame that was seen.
pub(super) type Visit<'a> = &'a mut dyn FnMut(Seen) -> Result<ControlFlow<()>, PipelineError>;

/// A thread of that name, to be started.
pub(super) fn named(stage: &str) -> thread::Builder {
    thread::Builder::new().name(format!("loci-{stage}"))
}

/// Reads frames until the source ends, `stop` is set or nobody listens; answers how many were skipped.
pub(super) fn capture(
    mut source: Box<dyn FrameSource>,
    stop: &AtomicBool,
    watcher: &dyn Watcher,
    (to_features, to_cnn): (Sender<Captured>, Option<Sender<Captured>>),
) -> u64 {
    let mut skipped = 0;
    while !stop.load(Ordering::Relaxed) {
        let started = Instant::now();
        match source.next_frame() {
            None => break,
            Some(Err(error)) => {
                watcher.skipped(&error);
                skipped += 1;
            }
            Some(Ok(frame)) => {
                let captured = Captured { frame: Arc::new(frame), decode_us: micros(started) };
                let heard_by_cnn = to_cnn.as_ref().is_none_or(|queue| queue.send(captured.clone()).is_ok());
                if !heard_by_cnn || to_features.send(captured).is_err() {
                    break;
                }
            }
        }
    }
    skipped
}

/// Extracts and quantises the features of every frame.
pub(super) fn extract(
    extractor: &mut OrbExtractor,
    vocabularies: &VocabularySet,
    captured: Receiver<Captured>,
    to_recognition: Sender<Featured>,
) {
    let mut switch = LightSwitch::default();
    for captured in captured {
        let started = Instant::now();
        let light = switch.follow(vocabularies, captured.frame.grey.mean_luminance());
        let features = extractor.extract(&captured.frame.grey);
        let quantised = vocabularies.vocabulary(light.condition).quantise_all(&features.descriptors);
        let featured = Featured { captured, features, light, quantised, features_us: micros(started) };
        if to_recognition.send(featured).is_err() {
            break;
        }
    }
}

/// Runs the CNN on every frame.
pub(super) fn describe(
    mut describer: Describer<'_>,
    captured: Receiver<Captured>,
    to_recognition: Sender<Described>,
) {
    for captured in captured {
        if to_recognition.send(describer.describe(&captured.frame.colour)).is_err() {
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

/// What decides frames, and where the answers go.
pub(super) struct Decider {
    pub(super) recogniser: Recogniser,
    /// Where keyframes are described anew, if a CNN takes part that may be replaced.
    pub(super) desk: Option<Desk>,
    pub(super) to_sinks: Sender<FrameRecord>,
    pub(super) shows_matched: bool,
}

impl Decider {
    /// Decides every frame, in order.
    pub(super) fn run(
        mut self,
        perceive: impl FnOnce(Visit<'_>) -> Result<u64, PipelineError>,
        watcher: &dyn Watcher,
    ) -> Result<RunSummary, PipelineError> {
        let mut summary = RunSummary::new(self.recogniser.has_cnn());
        summary.skipped = perceive(&mut |seen| {
            let (record, failure) = self.answer(seen, watcher);
            if let Some(failure) = failure {
                watcher.map_failed(&failure, !self.recogniser.is_read_only());
                summary.map_failures += 1;
            }
            summary.count(&record);
            watcher.decided(&record);
            let is_heard = self.to_sinks.send(record).is_ok();
            Ok(if is_heard { ControlFlow::Continue(()) } else { ControlFlow::Break(()) })
        })?;
        if let Err(failure) = self.recogniser.close() {
            watcher.map_failed(&failure, false);
            summary.map_failures += 1;
        }
        summary.map = Some(self.recogniser.map().summary());
        Ok(summary)
    }

    /// Decides a frame by the model that described it; answers, besides, what failed of the map.
    fn answer(&mut self, seen: Seen, watcher: &dyn Watcher) -> (FrameRecord, Option<MapError>) {
        let Self { recogniser, desk, shows_matched, .. } = self;
        let (started, before_us) = (Instant::now(), seen.latency.longest_us());
        if let Some(desk) = desk {
            desk.take_orders(recogniser);
        }
        let model = seen.model.as_ref().and_then(|model| follow(recogniser, model, (&seen.frame, watcher)));
        let mut record = FrameRecord { model, ..decide(recogniser, seen) };
        if let Some(desk) = desk {
            desk.show(recogniser);
            recogniser.store_renewed();
        }
        record.latency.total_us = before_us + micros(started);
        let mut failure = recogniser.take_map_failure();
        if *shows_matched {
            match matched_keyframe(recogniser.map(), &record.recognition) {
                Ok(matched) => record.matched = matched,
                Err(unreadable) => failure = failure.or(Some(unreadable)),
            }
        }
        (record, failure)
    }
}

/// Has the recogniser compare what `model` described with nothing else's descriptors; answers the model's hash if it is
/// another one than before.
fn follow(
    recogniser: &mut Recogniser,
    model: &ModelInUse,
    (frame, watcher): (&Frame, &dyn Watcher),
) -> Option<String> {
    let changed = recogniser.use_model(&model.card).map(|described_anew| {
        watcher.model_changed(&model.card, frame.index, described_anew);
        model.card.sha256.clone()
    });
    if !model.is_on_trial {
        recogniser.settle_model();
    }
    changed
}

fn decide(recogniser: &mut Recogniser, seen: Seen) -> FrameRecord {
    let Seen { frame, look, cnn, latency, .. } = seen;
    let started = Instant::now();
    let mut candidates = recogniser.retrieve(&look);
    let retrieval_us = micros(started);
    let verifications = recogniser.verify(&look, &mut candidates);
    let verification_us = micros(started) - retrieval_us;
    let thumbnail = || thumbnail_jpeg(&frame.colour);
    let recognition = recogniser.decide(&frame, &look, (candidates, verifications), thumbnail);
    let PerceptionLatency { decode_us, features_us, cnn_us } = latency;
    // Known once everything was done for the frame.
    let total_us = 0;
    let latency = StageLatency { decode_us, features_us, cnn_us, retrieval_us, verification_us, total_us };
    FrameRecord { frame, look: Arc::new(look), recognition, matched: None, cnn, model: None, latency }
}

fn matched_keyframe(map: &PlaceMap, recognition: &Recognition) -> Result<Option<MatchedKeyframe>, MapError> {
    let is_match = matches!(recognition.decision, Decision::Recognised | Decision::Revisited);
    // It may just have been given up.
    let keyframe = recognition.keyframe.filter(|&id| is_match && map.experience(id).is_some());
    let Some(experience) = keyframe else { return Ok(None) };
    let features = map.features(experience)?;
    Ok(Some(MatchedKeyframe {
        experience,
        frame_name: map.origin(experience)?.frame_name,
        width_px: features.width_px,
        height_px: features.height_px,
        thumbnail_jpeg: map.thumbnail_jpeg(experience)?,
    }))
}

/// Brings the map onto its medium every `interval`, until `ended` is closed.
pub(super) fn keep(syncer: &JournalSyncer, interval: Duration, ended: &Receiver<()>) {
    while ended.recv_timeout(interval) == Err(RecvTimeoutError::Timeout) {
        syncer.sync();
    }
}

/// Hands every record to every sink, until one refuses.
pub(super) fn deliver(
    mut sinks: Vec<Box<dyn RecognitionSink>>,
    records: Receiver<FrameRecord>,
) -> Result<(), TelemetryError> {
    for record in records {
        for sink in &mut sinks {
            sink.record(&record)?;
        }
    }
    sinks.iter_mut().try_for_each(|sink| sink.finish())
}

/// What a stage answered; its panic, a defect of ours, goes on in the caller.
pub(super) fn joined<T>(stage: ScopedJoinHandle<'_, T>) -> T {
    stage.join().unwrap_or_else(|defect| panic::resume_unwind(defect))
}

/// Microseconds since then.
pub(super) fn micros(since: Instant) -> u64 {
    u64::try_from(since.elapsed().as_micros()).unwrap_or(u64::MAX)
}
