//! Recognition: decides every frame in order, keeps the map, and hands on what came of it.

use std::ops::ControlFlow;
use std::time::Instant;

use crossbeam_channel::Sender;

use super::delivery::Delivery;
use super::desk::Desk;
use super::exchange::ModelInUse;
use super::onlooker::Onlooker;
use super::perception::{PerceptionLatency, Seen};
use super::pool::Pool;
use super::stages::micros;
use super::{PipelineError, RunSummary, Watcher};
use crate::cnn;
use crate::frame::Frame;
use crate::place_map::MapError;
use crate::recognition::{Look, Recogniser};
use crate::source::thumbnail_jpeg;
use crate::telemetry::{FrameRecord, Losses, StageLatency};

/// Records whose memory is kept: more than are under way where no sink is slow.
const POOLED: usize = 24;

/// What is done with a frame that was seen.
pub(super) type Visit<'a> = &'a mut dyn FnMut(Seen) -> Result<ControlFlow<()>, PipelineError>;

/// What decides frames, and where the answers go.
pub(super) struct Decider<'a> {
    pub(super) recogniser: Recogniser,
    /// Where keyframes are described anew, if a CNN takes part that may be replaced.
    pub(super) desk: Option<Desk>,
    pub(super) delivery: Delivery,
    /// Take what is not needed any more.
    pub(super) spare: (Sender<Look>, Sender<cnn::Descriptor>),
    /// Somebody who looks on, if anybody does.
    pub(super) onlooker: Option<Onlooker>,
    pub(super) watcher: &'a dyn Watcher,
}

impl Decider<'_> {
    /// Decides every frame, in order.
    pub(super) fn run(
        mut self,
        perceive: impl FnOnce(Visit<'_>) -> Result<Losses, PipelineError>,
    ) -> Result<RunSummary, PipelineError> {
        let mut summary = RunSummary::new(self.recogniser.has_cnn(), self.delivery.is_live);
        if self.onlooker.is_some() {
            self.recogniser.keep_insight();
        }
        let mut records = Pool::new(POOLED);
        let perceived = perceive(&mut |seen| {
            let (record, failure) = self.answer(seen);
            if let Some(failure) = failure {
                self.watcher.map_failed(&failure, !self.recogniser.is_read_only());
                summary.map_failures += 1;
            }
            summary.count(&record);
            self.watcher.decided(&record);
            let (record, before) = records.share(record);
            before.into_iter().for_each(|before| self.give_back(before));
            self.delivery.deliver(&record, self.watcher)
        });
        // First of all: whatever became of the sinks, what was learnt is to be on the medium.
        if let Err(failure) = self.recogniser.close() {
            self.watcher.map_failed(&failure, false);
            summary.map_failures += 1;
        }
        summary.map = Some(self.recogniser.map().summary());
        summary.flow.missed_records = self.delivery.missed;
        summary.sink_failures = self.delivery.finish(self.watcher)?;
        summary.flow.losses = perceived?;
        Ok(summary)
    }

    /// Lets the memory of an answer that was delivered be used again; where there is no room for it, it is given up.
    fn give_back(&mut self, record: FrameRecord) {
        let FrameRecord { mut look, recognition, insight, .. } = record;
        if let Some(onlooker) = &mut self.onlooker {
            onlooker.take_back(insight);
        }
        let (looks, descriptors) = &self.spare;
        look.appearance.take().into_iter().for_each(|descriptor| drop(descriptors.try_send(descriptor)));
        drop(looks.try_send(look));
        self.recogniser.reuse(recognition);
    }

    /// Decides a frame by the model that described it; answers, besides, what failed of the map.
    fn answer(&mut self, mut seen: Seen) -> (FrameRecord, Option<MapError>) {
        let Self { recogniser, desk, delivery, onlooker, watcher, .. } = self;
        let (started, before_us) = (Instant::now(), seen.latency.longest_us());
        let captured_at = seen.captured_at;
        (seen.flow.waiting.sinks, seen.flow.missed_records) = (delivery.waiting(), delivery.missed);
        if let Some(desk) = desk {
            desk.take_orders(recogniser);
        }
        let model = seen.model.as_ref().and_then(|model| follow(recogniser, model, (&seen.frame, *watcher)));
        let mut record = FrameRecord { model, ..decide(recogniser, seen) };
        if let Some(desk) = desk {
            desk.show(recogniser);
            recogniser.store_renewed();
        }
        record.latency.total_us = before_us + micros(started);
        let mut failure = recogniser.take_map_failure();
        if let Some(onlooker) = onlooker {
            onlooker.make_up_for(delivery.missed, recogniser);
            failure = failure.or(onlooker.show(recogniser, &mut record).err());
        }
        record.latency.answer_us = micros(captured_at);
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
    let Seen { frame, look, cnn, latency, flow, .. } = seen;
    let started = Instant::now();
    let mut candidates = recogniser.retrieve(&look);
    let retrieval_us = micros(started);
    let verifications = recogniser.verify(&look, &mut candidates);
    let verification_us = micros(started) - retrieval_us;
    let thumbnail = || thumbnail_jpeg(&frame.colour);
    let recognition = recogniser.decide(&frame, &look, (candidates, verifications), thumbnail);
    let PerceptionLatency { decode_us, features_us, cnn_us } = latency;
    // Known once everything was done for the frame.
    let (total_us, answer_us) = (0, 0);
    let latency =
        StageLatency { decode_us, features_us, cnn_us, retrieval_us, verification_us, total_us, answer_us };
    FrameRecord { frame, look, recognition, matched: None, insight: None, cnn, model: None, latency, flow }
}
