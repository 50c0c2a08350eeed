//! What a stream amounted to.

use std::collections::BTreeMap;

use hdrhistogram::Histogram;

use crate::place_map::MapSummary;
use crate::recognition::Decision;
use crate::telemetry::{CnnStatus, Flow, FrameRecord};

/// Longest latency that is told apart, in microseconds: a minute.
const MAX_LATENCY_US: u64 = 60_000_000;

/// The name of the time from capture to the answer, waiting included.
pub const ANSWER: &str = "answer";

/// Counts and latencies of a stream.
#[derive(Debug)]
pub struct RunSummary {
    /// Frames that were decided.
    pub frames: u64,
    /// Frames on which the CNN failed.
    pub cnn_failures: u64,
    /// Times that the map could not be read or changed.
    pub map_failures: u64,
    /// Sinks of a live stream that failed and were left out.
    pub sink_failures: u64,
    /// How the stream kept pace with its source.
    pub flow: Flow,
    /// Times that another model took over, or the one before came back.
    pub model_changes: u64,
    /// Whether the source was live.
    pub is_live: bool,
    /// Whether a CNN took part.
    pub has_cnn: bool,
    /// Frames a decision, by the decision's word.
    pub decisions: BTreeMap<&'static str, u64>,
    /// What is in the map now.
    pub map: Option<MapSummary>,
    stages: [(&'static str, Option<Histogram<u32>>); 7],
}

/// Latency of a stage in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageStatistics {
    /// Name of the stage.
    pub stage: &'static str,
    /// Median.
    pub p50_us: u64,
    /// 99th percentile.
    pub p99_us: u64,
}

impl RunSummary {
    pub(super) fn new(has_cnn: bool, is_live: bool) -> Self {
        // One significant digit would do for a glance; two tell 1.0 ms from 1.1 ms. Bounds are constant,
        // so a histogram can always be made.
        let histogram = || Histogram::new_with_max(MAX_LATENCY_US, 2).ok();
        let names = ["decode", "features", "cnn", "retrieval", "verification", "total", ANSWER];
        Self {
            frames: 0,
            cnn_failures: 0,
            map_failures: 0,
            sink_failures: 0,
            flow: Flow::default(),
            model_changes: 0,
            is_live,
            has_cnn,
            decisions: BTreeMap::new(),
            map: None,
            stages: names.map(|name| (name, histogram())),
        }
    }

    pub(super) fn count(&mut self, record: &FrameRecord) {
        self.frames += 1;
        self.flow = record.flow;
        self.model_changes += u64::from(record.model.is_some());
        self.cnn_failures += u64::from(record.cnn == CnnStatus::Failed);
        *self.decisions.entry(record.recognition.decision.as_str()).or_default() += 1;
        let latency = &record.latency;
        let micros = [
            latency.decode_us,
            latency.features_us,
            latency.cnn_us,
            latency.retrieval_us,
            latency.verification_us,
            latency.total_us,
            latency.answer_us,
        ];
        for ((_, histogram), micros) in self.stages.iter_mut().zip(micros) {
            histogram.iter_mut().for_each(|histogram| histogram.saturating_record(micros));
        }
    }

    /// How many frames were decided so.
    #[must_use]
    pub fn decided(&self, decision: Decision) -> u64 {
        self.decisions.get(decision.as_str()).copied().unwrap_or(0)
    }

    /// Whether something was lost on the way.
    #[must_use]
    pub fn lost_something(&self) -> bool {
        self.flow.losses.unreadable + self.cnn_failures + self.map_failures + self.sink_failures > 0
    }

    /// Latency of every stage.
    #[must_use]
    pub fn latency(&self) -> Vec<StageStatistics> {
        let statistics = |(stage, histogram): &(&'static str, Option<Histogram<u32>>)| {
            let histogram = histogram.as_ref()?;
            let at = |quantile| histogram.value_at_quantile(quantile);
            Some(StageStatistics { stage, p50_us: at(0.5), p99_us: at(0.99) })
        };
        self.stages.iter().filter_map(statistics).collect()
    }
}
