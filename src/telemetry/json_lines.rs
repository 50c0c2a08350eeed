//! Records as JSON Lines: one object a processed frame, one line each.

use std::io::Write;

use super::log_line::LogLine;
use super::{FrameRecord, RecognitionSink, TelemetryError};

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
        let mut line = serde_json::to_vec(&LogLine::from(record)).map_err(std::io::Error::from)?;
        line.push(b'\n');
        self.output.write_all(&line)?;
        Ok(self.output.flush()?)
    }

    fn finish(&mut self) -> Result<(), TelemetryError> {
        Ok(self.output.flush()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    use crate::frame::Frame;
    use crate::place_map::{ExperienceId, PlaceId};
    use crate::raster::{GreyImage, RgbImage};
    use crate::recognition::{
        Candidate, Candidates, Decision, Evidence, Grounds, Look, Recognition, Rejection,
    };
    use crate::telemetry::{CnnStatus, Flow, Losses, StageLatency, Waiting};

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
