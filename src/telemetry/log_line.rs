//! What a line of JSON says of a frame, for those who write it and those who read it again.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::{Flow, FrameRecord, Losses, StageLatency, Waiting};
use crate::recognition::Candidate;

/// A line. Words are those that decisions and evidence give themselves.
#[derive(Serialize, Deserialize)]
pub(super) struct LogLine<'a> {
    pub(super) frame: u64,
    pub(super) capture_nanos: i64,
    pub(super) decision: Cow<'a, str>,
    pub(super) by: Option<Cow<'a, str>>,
    pub(super) place: Option<u32>,
    pub(super) name: Option<Cow<'a, str>>,
    pub(super) keyframe: Option<u32>,
    pub(super) experience: Option<u32>,
    pub(super) confidence: f64,
    pub(super) inliers: Option<u32>,
    #[serde(default)]
    pub(super) candidates: Vec<CandidateLine<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) cnn: Option<Cow<'a, str>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) model: Option<Cow<'a, str>>,
    #[serde(default)]
    pub(super) latency_us: LatencyLine,
    #[serde(default)]
    pub(super) flow: FlowLine,
}

#[derive(Serialize, Deserialize)]
pub(super) struct CandidateLine<'a> {
    pub(super) place: u32,
    pub(super) by: Cow<'a, str>,
    pub(super) score: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) inliers: Option<u32>,
    pub(super) probability: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) rejected: Option<String>,
}

#[derive(Clone, Copy, Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct LatencyLine {
    decode: u64,
    features: u64,
    cnn: u64,
    retrieval: u64,
    verification: u64,
    total: u64,
    answer: u64,
}

#[derive(Clone, Copy, Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct FlowLine {
    unreadable: u64,
    lost: u64,
    dropped: u64,
    spared: u64,
    missed: u64,
    waiting: WaitingLine,
}

#[derive(Clone, Copy, Default, Serialize, Deserialize)]
#[serde(default)]
struct WaitingLine {
    features: usize,
    cnn: usize,
    recognition: usize,
    sinks: usize,
}

impl<'a> From<&'a FrameRecord> for LogLine<'a> {
    fn from(record: &'a FrameRecord) -> Self {
        let recognition = &record.recognition;
        Self {
            frame: record.frame.index,
            capture_nanos: record.frame.capture_nanos,
            decision: recognition.decision.as_str().into(),
            by: recognition.by.map(|by| by.as_str().into()),
            place: recognition.place.map(|place| place.0),
            name: recognition.name.as_deref().map(Cow::from),
            keyframe: recognition.keyframe.map(|keyframe| keyframe.0),
            experience: recognition.experience.map(|experience| experience.0),
            confidence: rounded(recognition.confidence),
            inliers: recognition.inliers,
            candidates: recognition.candidates.iter().map(CandidateLine::from).collect(),
            cnn: record.cnn.as_str().map(Cow::from),
            model: record.model.as_deref().map(Cow::from),
            latency_us: LatencyLine::from(record.latency),
            flow: FlowLine::from(record.flow),
        }
    }
}

impl From<&Candidate> for CandidateLine<'_> {
    fn from(candidate: &Candidate) -> Self {
        Self {
            place: candidate.place.0,
            by: candidate.by.as_str().into(),
            score: rounded(candidate.score),
            inliers: candidate.inliers,
            probability: rounded(candidate.probability),
            rejected: candidate.rejected.map(|rejection| rejection.to_string()),
        }
    }
}

impl From<StageLatency> for LatencyLine {
    fn from(latency: StageLatency) -> Self {
        Self {
            decode: latency.decode_us,
            features: latency.features_us,
            cnn: latency.cnn_us,
            retrieval: latency.retrieval_us,
            verification: latency.verification_us,
            total: latency.total_us,
            answer: latency.answer_us,
        }
    }
}

impl From<LatencyLine> for StageLatency {
    fn from(line: LatencyLine) -> Self {
        Self {
            decode_us: line.decode,
            features_us: line.features,
            cnn_us: line.cnn,
            retrieval_us: line.retrieval,
            verification_us: line.verification,
            total_us: line.total,
            answer_us: line.answer,
        }
    }
}

impl From<Flow> for FlowLine {
    fn from(flow: Flow) -> Self {
        let Losses { unreadable, lost, dropped, spared } = flow.losses;
        let Waiting { features, cnn, recognition, sinks } = flow.waiting;
        let waiting = WaitingLine { features, cnn, recognition, sinks };
        Self { unreadable, lost, dropped, spared, missed: flow.missed_records, waiting }
    }
}

impl From<FlowLine> for Flow {
    fn from(line: FlowLine) -> Self {
        let FlowLine { unreadable, lost, dropped, spared, missed, waiting } = line;
        let WaitingLine { features, cnn, recognition, sinks } = waiting;
        Self {
            waiting: Waiting { features, cnn, recognition, sinks },
            losses: Losses { unreadable, lost, dropped, spared },
            missed_records: missed,
        }
    }
}

/// Four decimals are all that means anything.
fn rounded(value: f32) -> f64 {
    (f64::from(value) * 1e4).round() / 1e4
}
