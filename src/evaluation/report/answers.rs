//! Every answer as a row of CSV, for those who want to count something else.
//!
//! Names stand as they are, since a program joins tables by them; a spreadsheet should read them as text.

use super::ReportError;
use crate::evaluation::results::{AnswerRecord, MethodResult, Report};

const HEAD: [&str; 11] = [
    "experiment",
    "method",
    "database",
    "query",
    "is_known",
    "is_given",
    "confidence",
    "reference",
    "place",
    "is_right",
    "reason",
];

/// The whole table.
pub(super) fn table(report: &Report) -> Result<Vec<u8>, ReportError> {
    let mut bytes = Vec::new();
    let mut writer = csv::Writer::from_writer(&mut bytes);
    writer.write_record(HEAD)?;
    for experiment in &report.experiments {
        for result in &experiment.results {
            for answer in &result.answers {
                writer.write_record(row(&experiment.name, result, answer))?;
            }
        }
    }
    writer.flush().map_err(csv::Error::from)?;
    drop(writer);
    Ok(bytes)
}

fn row(experiment: &str, result: &MethodResult, answer: &AnswerRecord) -> [String; HEAD.len()] {
    let of_bool = |value: Option<bool>| value.map(|value| value.to_string()).unwrap_or_default();
    let confidence = Some(answer.confidence).filter(|confidence| confidence.is_finite());
    [
        experiment.to_owned(),
        result.method.as_str().to_owned(),
        result.database.as_str().to_owned(),
        answer.query.clone(),
        of_bool(answer.is_known),
        answer.is_given.to_string(),
        confidence.map(|confidence| format!("{confidence:.6}")).unwrap_or_default(),
        answer.reference.clone().unwrap_or_default(),
        answer.place.map(|place| place.to_string()).unwrap_or_default(),
        of_bool(answer.is_right),
        answer.reason.clone(),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::sample::{HOSTILE, report};
    use super::*;

    fn rows(report: &Report) -> Vec<Vec<String>> {
        let bytes = table(report).unwrap();
        let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(bytes.as_slice());
        let fields = |record: csv::StringRecord| record.iter().map(str::to_owned).collect();
        reader.records().map(|record| fields(record.unwrap())).collect()
    }

    #[test]
    fn every_answer_is_a_row_under_its_heads() {
        let report = report();
        let answers = report.experiments.iter().flat_map(|experiment| &experiment.results);
        let answers: usize = answers.map(|result| result.answers.len()).sum();
        let rows = rows(&report);
        assert!(answers > 6);
        assert_eq!(rows.len(), 1 + answers);
        assert_eq!(rows[0], HEAD);
        let name = &report.experiments[0].name;
        let given = [name, "cnn", "frames", "winter/000001.jpg", "true", "true", "0.874321", "summer/7.jpg"];
        assert_eq!(rows[1][..8], given);
        assert_eq!(rows[1][8..], ["", "true", "cosine 0.874 ≥ 0.700"]);
    }

    #[test]
    fn what_is_not_known_is_an_empty_cell() {
        let rows = rows(&report());
        assert_eq!(rows[2][4..], ["", "false", "0.000000", "", "", "", "no candidate"]);
    }

    #[test]
    fn hostile_names_keep_their_cells() {
        let mut report = report();
        let hostile = format!("{HOSTILE},\"x\"\r\n=1+1\n,,");
        report.experiments[0].name.clone_from(&hostile);
        let answer = &mut report.experiments[0].results[0].answers[0];
        answer.query.clone_from(&hostile);
        answer.reference = Some(hostile.clone());
        answer.reason.clone_from(&hostile);
        let rows = rows(&report);
        for column in [0, 3, 7, 10] {
            assert_eq!(rows[1][column], hostile);
        }
        assert!(rows.iter().all(|row| row.len() == HEAD.len()));
    }

    #[test]
    fn a_confidence_that_is_no_number_is_an_empty_cell() {
        let mut report = report();
        report.experiments[0].results[0].answers[0].confidence = f64::NAN;
        assert_eq!(rows(&report)[1][6], "");
    }

    #[test]
    fn without_answers_the_heads_stand_alone() {
        let mut report = report();
        report.experiments.clear();
        assert_eq!(rows(&report), [HEAD]);
    }
}
