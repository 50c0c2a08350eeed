//! What is told of a frame in words and curves: of one that was just decided, or of the line that was written of it.

use std::borrow::Cow;

use super::style;
use super::target::one_line;
use crate::place_map::{ExperienceId, PlaceId};
use crate::recognition::{Candidate, Decision, Evidence};
use crate::telemetry::log_line::{CandidateLine, LogLine};
use crate::telemetry::{CnnStatus, Flow, FrameRecord, StageLatency};

/// Longest reason against a candidate that is told, in characters; ours have about 80.
const MAX_REASON: usize = 300;

/// What is told of a frame.
pub(super) struct Told<'a> {
    pub(super) capture_nanos: i64,
    pub(super) frame_name: Cow<'a, str>,
    pub(super) decision: Decision,
    pub(super) by: Option<Evidence>,
    pub(super) place: Option<PlaceId>,
    pub(super) name: Option<&'a str>,
    pub(super) confidence: f32,
    pub(super) inliers: Option<u32>,
    /// What the frame became in the map.
    pub(super) experience: Option<ExperienceId>,
    /// The keyframe that was matched, by number and, where that is known, its frame's name.
    pub(super) matched: Option<(ExperienceId, Option<Cow<'a, str>>)>,
    /// The accepted one first, then the best of the others.
    pub(super) candidates: Vec<ToldCandidate>,
    pub(super) cnn: CnnStatus,
    pub(super) latency: StageLatency,
    pub(super) flow: Flow,
}

/// What is told of a candidate.
pub(super) struct ToldCandidate {
    pub(super) place: PlaceId,
    pub(super) by: Evidence,
    pub(super) score: f32,
    pub(super) inliers: Option<u32>,
    /// Why it was turned down; `None` for the one that was accepted.
    pub(super) rejected: Option<String>,
}

impl<'a> From<&'a FrameRecord> for Told<'a> {
    fn from(record: &'a FrameRecord) -> Self {
        let recognition = &record.recognition;
        let matched = record.matched.as_ref();
        Self {
            capture_nanos: record.frame.capture_nanos,
            frame_name: record.frame.name.as_str().into(),
            decision: recognition.decision,
            by: recognition.by,
            place: recognition.place,
            name: recognition.name.as_deref(),
            confidence: recognition.confidence,
            inliers: recognition.inliers,
            experience: recognition.experience,
            matched: matched.map(|matched| (matched.experience, Some(matched.frame_name.as_str().into()))),
            candidates: recognition.candidates.iter().map(ToldCandidate::from).collect(),
            cnn: record.cnn,
            latency: record.latency,
            flow: record.flow,
        }
    }
}

impl From<&Candidate> for ToldCandidate {
    fn from(candidate: &Candidate) -> Self {
        let &Candidate { place, by, score, inliers, rejected, .. } = candidate;
        Self { place, by, score, inliers, rejected: rejected.map(|rejection| rejection.to_string()) }
    }
}

impl<'a> Told<'a> {
    /// What a line says, unless it has words that nobody knows. Of the frame's name it says nothing.
    pub(super) fn of_line(line: &'a LogLine<'_>) -> Option<Self> {
        let decision = style::DECISIONS.into_iter().find(|decision| decision.as_str() == line.decision)?;
        let is_match = matches!(decision, Decision::Recognised | Decision::Revisited);
        if !(0.0..=1.0).contains(&line.confidence) {
            return None;
        }
        let cnn = [CnnStatus::Available, CnnStatus::Unavailable, CnnStatus::Failed];
        Some(Self {
            capture_nanos: line.capture_nanos,
            frame_name: line.frame.to_string().into(),
            decision,
            by: match &line.by {
                Some(word) => Some(evidence(word)?),
                None => None,
            },
            place: line.place.map(PlaceId),
            name: line.name.as_deref(),
            confidence: line.confidence as f32,
            inliers: line.inliers,
            experience: line.experience.map(ExperienceId),
            matched: line.keyframe.filter(|_| is_match).map(|keyframe| (ExperienceId(keyframe), None)),
            candidates: line.candidates.iter().map(ToldCandidate::of_line).collect::<Option<_>>()?,
            cnn: cnn.into_iter().find(|status| status.as_str() == line.cnn.as_deref())?,
            latency: line.latency_us.into(),
            flow: line.flow.into(),
        })
    }
}

impl ToldCandidate {
    fn of_line(line: &CandidateLine<'_>) -> Option<Self> {
        let &CandidateLine { place, ref by, score, inliers, ref rejected, .. } = line;
        let (place, by, score) = (PlaceId(place), evidence(by)?, score as f32);
        let rejected = rejected.as_deref().map(|reason| one_line(reason).chars().take(MAX_REASON).collect());
        score.is_finite().then_some(Self { place, by, score, inliers, rejected })
    }
}

/// The evidence that has this word.
fn evidence(word: &str) -> Option<Evidence> {
    let all = [Evidence::Cnn, Evidence::BowHv, Evidence::PlaceInterval];
    all.into_iter().find(|evidence| evidence.as_str() == word)
}
