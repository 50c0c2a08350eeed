//! One JSON object a processed frame, one line each.

use std::io::Write;

use serde::Serialize;

use super::{CnnStatus, Flow, FrameRecord, Losses, RecognitionSink, StageLatency, TelemetryError, Waiting};
use crate::recognition::{Candidate, Evidence};

/// Writes records as JSON Lines and flushes each, so that a reader is never behind.
pub struct JsonLines<W> {
    output: W,
}

impl<W: Write + Send> JsonLines<W> {
    /// Writes to `output`.
    pub fn new(output: W) -> Self {
        Self { output }
    }
}

impl<W: Write + Send> RecognitionSink for JsonLines<W> {
    fn record(&mut self, record: &FrameRecord) -> Result<(), TelemetryError> {
        let mut line = serde_json::to_vec(&Line::from(record)).map_err(std::io::Error::from)?;
        line.push(b'\n');
        self.output.write_all(&line)?;
        Ok(self.output.flush()?)
    }

    fn finish(&mut self) -> Result<(), TelemetryError> {
        Ok(self.output.flush()?)
    }
}

#[derive(Serialize)]
struct Line<'a> {
    frame: u64,
    capture_nanos: i64,
    decision: &'static str,
    by: Option<&'static str>,
    place: Option<u32>,
    name: Option<&'a str>,
    keyframe: Option<u32>,
    experience: Option<u32>,
    confidence: f64,
    inliers: Option<u32>,
    candidates: Vec<CandidateLine>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cnn: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    model: Option<&'a str>,
    latency_us: LatencyLine,
    flow: FlowLine,
}

#[derive(Serialize)]
struct CandidateLine {
    place: u32,
    by: &'static str,
    score: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    inliers: Option<u32>,
    probability: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    rejected: Option<String>,
}

#[derive(Serialize)]
struct LatencyLine {
    decode: u64,
    features: u64,
    cnn: u64,
    retrieval: u64,
    verification: u64,
    total: u64,
    answer: u64,
}

#[derive(Serialize)]
struct FlowLine {
    unreadable: u64,
    lost: u64,
    dropped: u64,
    spared: u64,
    missed: u64,
    waiting: WaitingLine,
}

#[derive(Serialize)]
struct WaitingLine {
    features: usize,
    cnn: usize,
    recognition: usize,
    sinks: usize,
}

impl<'a> From<&'a FrameRecord> for Line<'a> {
    fn from(record: &'a FrameRecord) -> Self {
        let recognition = &record.recognition;
        Self {
            frame: record.frame.index,
            capture_nanos: record.frame.capture_nanos,
            decision: recognition.decision.as_str(),
            by: recognition.by.map(Evidence::as_str),
            place: recognition.place.map(|place| place.0),
            name: recognition.name.as_deref(),
            keyframe: recognition.keyframe.map(|keyframe| keyframe.0),
            experience: recognition.experience.map(|experience| experience.0),
            confidence: rounded(recognition.confidence),
            inliers: recognition.inliers,
            candidates: recognition.candidates.iter().map(CandidateLine::from).collect(),
            cnn: match record.cnn {
                CnnStatus::Available => None,
                CnnStatus::Unavailable => Some("unavailable"),
                CnnStatus::Failed => Some("failed"),
            },
            model: record.model.as_deref(),
            latency_us: LatencyLine::from(record.latency),
            flow: FlowLine::from(record.flow),
        }
    }
}

impl From<&Candidate> for CandidateLine {
    fn from(candidate: &Candidate) -> Self {
        Self {
            place: candidate.place.0,
            by: candidate.by.as_str(),
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

impl From<Flow> for FlowLine {
    fn from(flow: Flow) -> Self {
        let Losses { unreadable, lost, dropped, spared } = flow.losses;
        let Waiting { features, cnn, recognition, sinks } = flow.waiting;
        Self {
            unreadable,
            lost,
            dropped,
            spared,
            missed: flow.missed_records,
            waiting: WaitingLine { features, cnn, recognition, sinks },
        }
    }
}

/// Four decimals are all that means anything.
fn rounded(value: f32) -> f64 {
    (f64::from(value) * 1e4).round() / 1e4
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    use crate::frame::Frame;
    use crate::place_map::{ExperienceId, PlaceId};
    use crate::raster::{GreyImage, RgbImage};
    use crate::recognition::{Candidates, Decision, Grounds, Look, Recognition, Rejection};

    fn record() -> FrameRecord {
        let frame = Frame {
            index: 412,
            capture_nanos: 1_723_456_789_000_000_000,
            name: "412.jpg".to_owned(),
            colour: RgbImage::new(1, 1),
            grey: GreyImage::new(1, 1),
            jpeg: None,
            pose: None,
            true_place: None,
        };
        let accepted = Candidate {
            place: PlaceId(17),
            keyframe: ExperienceId(233),
            by: Evidence::Cnn,
            score: 0.993,
            votes: None,
            inliers: None,
            probability: 0.974,
            rejected: None,
        };
        let rejected = Candidate {
            place: PlaceId(9),
            keyframe: ExperienceId(80),
            by: Evidence::BowHv,
            score: 0.041,
            votes: Some(9.5),
            inliers: Some(6),
            probability: 0.004,
            rejected: Some(Rejection::Unlikely { got: 0.004, needed: 0.5 }),
        };
        let recognition = Recognition {
            decision: Decision::Recognised,
            by: Some(Evidence::Cnn),
            place: Some(PlaceId(17)),
            name: Some("dock 3".into()),
            keyframe: Some(ExperienceId(233)),
            experience: Some(ExperienceId(412)),
            confidence: 0.993,
            inliers: None,
            candidates: Candidates::from_iter([accepted, rejected]),
            verification: None,
            grounds: Grounds::default(),
        };
        let latency = StageLatency {
            decode_us: 310,
            features_us: 980,
            cnn_us: 2100,
            retrieval_us: 120,
            verification_us: 60,
            total_us: 2600,
            answer_us: 3100,
        };
        let (frame, look, cnn) = (Arc::new(frame), Look::default(), CnnStatus::Available);
        let waiting = Waiting { features: 1, cnn: 0, recognition: 2, sinks: 4 };
        let losses = Losses { unreadable: 2, lost: 3, dropped: 7, spared: 5 };
        let flow = Flow { waiting, losses, missed_records: 9 };
        let (matched, insight, model) = (None, None, None);
        FrameRecord { frame, look, recognition, matched, insight, cnn, model, latency, flow }
    }

    fn line(record: &FrameRecord) -> String {
        let mut output = Vec::new();
        JsonLines::new(&mut output).record(record).unwrap();
        String::from_utf8(output).unwrap()
    }

    #[test]
    fn a_line_reads_as_documented() {
        let expected = concat!(
            r#"{"frame":412,"capture_nanos":1723456789000000000,"decision":"recognised","by":"cnn","#,
            r#""place":17,"name":"dock 3","keyframe":233,"experience":412,"confidence":0.993,"inliers":null,"#,
            r#""candidates":[{"place":17,"by":"cnn","score":0.993,"probability":0.974},"#,
            r#"{"place":9,"by":"bow_hv","score":0.041,"inliers":6,"probability":0.004,"#,
            r#""rejected":"probability 0.004 < 0.500"}],"#,
            r#""latency_us":{"decode":310,"features":980,"cnn":2100,"retrieval":120,"verification":60,"total":2600,"#,
            r#""answer":3100},"flow":{"unreadable":2,"lost":3,"dropped":7,"spared":5,"missed":9,"#,
            r#""waiting":{"features":1,"cnn":0,"recognition":2,"sinks":4}}}"#,
            "\n"
        );
        assert_eq!(line(&record()), expected);
    }

    #[test]
    fn a_missing_cnn_is_said_in_every_record() {
        let without = FrameRecord { cnn: CnnStatus::Unavailable, ..record() };
        assert!(line(&without).contains(r#""cnn":"unavailable""#));
    }

    #[test]
    fn another_model_is_said_in_the_first_record_that_it_has_part_in() {
        let changed = FrameRecord { model: Some("ab12".to_owned()), ..record() };
        assert!(line(&changed).contains(r#""model":"ab12","latency_us""#));
    }

    #[test]
    fn a_reader_that_has_gone_is_no_failure_of_ours() {
        struct Closed;
        impl Write for Closed {
            fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
                Err(std::io::ErrorKind::BrokenPipe.into())
            }
            fn flush(&mut self) -> std::io::Result<()> {
                Ok(())
            }
        }
        let error = JsonLines::new(Closed).record(&record()).unwrap_err();
        assert!(matches!(error, TelemetryError::ReaderGone));
    }
}
