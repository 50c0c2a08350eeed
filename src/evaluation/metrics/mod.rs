//! Metrics: numbers from answers and truth, each with its count and 95 % interval; nothing else is known here.
//!
//! They are computed as scikit-learn computes them, and its numbers are stored with the tests.

mod calibration;
mod clusters;
mod estimate;
mod latency;
mod open_set;
mod precision_recall;
mod ranking;
mod score;

pub use calibration::{Calibration, ReliabilityBin, expected_calibration_error};
pub use clusters::{false_merges, purity, true_places};
pub use estimate::Estimate;
pub use latency::quantile;
pub use open_set::auroc;
pub use precision_recall::{
    Guess, PrecisionRecall, PrecisionRecallPoint, average_precision, recall_at_full_precision,
};
pub use ranking::recall_at;

#[cfg(test)]
mod tests {
    //! Compares the metrics with the numbers of scikit-learn that `tests/data/metrics/make.py` stored.

    use serde_json::Value;

    use super::*;
    use crate::proportion::Proportion;

    const STORED: &str =
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/metrics/scikit_learn.json"));

    fn stored(list: &str) -> Vec<Value> {
        let file: Value = serde_json::from_str(STORED).unwrap();
        file[list].as_array().unwrap().clone()
    }

    fn floats(list: &Value) -> Vec<f64> {
        list.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
    }

    /// The scores and labels of a case.
    fn samples(case: &Value) -> Vec<(f64, bool)> {
        let labels = case["labels"].as_array().unwrap().iter().map(|label| label.as_bool().unwrap());
        floats(&case["scores"]).into_iter().zip(labels).collect()
    }

    /// The guesses of a case, and how many of them are right.
    fn guesses(case: &Value) -> (Vec<Guess>, u64) {
        let guesses: Vec<_> =
            samples(case).into_iter().map(|(score, is_right)| Guess { score, is_right }).collect();
        let right = guesses.iter().filter(|guess| guess.is_right).count() as u64;
        (guesses, right)
    }

    #[track_caller]
    fn assert_close(ours: f64, theirs: f64, case: &Value) {
        assert!((ours - theirs).abs() < 1e-9, "{ours} is not {theirs} in {}", case["name"]);
    }

    #[test]
    fn average_precision_is_that_of_scikit_learn() {
        for case in stored("cases") {
            let (guesses, right) = guesses(&case);
            let theirs = case["average_precision_score"].as_f64().unwrap();
            assert_close(average_precision(&guesses, right).unwrap().value, theirs, &case);
            // Recall, and with it the area, halves when twice as many are to be found.
            assert_close(average_precision(&guesses, 2 * right).unwrap().value, theirs / 2.0, &case);
        }
    }

    #[test]
    fn the_precision_recall_curve_is_that_of_scikit_learn() {
        for case in stored("cases") {
            let (guesses, right) = guesses(&case);
            let points = PrecisionRecall::new(&guesses, right).points;
            let theirs = &case["precision_recall_curve"];
            let [thresholds, precisions, recalls] =
                ["thresholds", "precision", "recall"].map(|key| floats(&theirs[key]));
            // Theirs begins with the lowest threshold, and ends with a point that belongs to none.
            assert_eq!(points.len(), thresholds.len(), "{}", case["name"]);
            for (index, point) in points.iter().rev().enumerate() {
                assert_close(point.threshold, thresholds[index], &case);
                assert_close(point.precision, precisions[index], &case);
                assert_close(point.recall, recalls[index], &case);
            }
            // The added point has precision 1 and recall 0, which is right where nothing is faultless.
            let faultless = (0..precisions.len()).filter(|&index| precisions[index] == 1.0);
            let best = faultless.map(|index| recalls[index]).fold(0.0, f64::max);
            assert_close(recall_at_full_precision(&guesses, right).unwrap().rate, best, &case);
        }
    }

    #[test]
    fn auroc_is_that_of_scikit_learn() {
        let mut compared = 0;
        for case in stored("cases") {
            let side = |wanted: bool| {
                let samples = samples(&case).into_iter();
                samples.filter(|sample| sample.1 == wanted).map(|sample| sample.0).collect::<Vec<_>>()
            };
            let ours = auroc(&side(true), &side(false));
            assert_eq!(ours.is_some(), case["roc_auc_score"].is_f64(), "{}", case["name"]);
            if let Some(ours) = ours {
                assert_close(ours.value, case["roc_auc_score"].as_f64().unwrap(), &case);
                compared += 1;
            }
        }
        assert!(compared >= 7, "only {compared} cases have both sides");
    }

    #[test]
    fn the_reliability_diagram_is_that_of_scikit_learn() {
        for case in stored("cases") {
            let bins = Calibration::new(&samples(&case)).bins;
            let counts: Vec<f64> = bins.iter().map(|bin| bin.n as f64).collect();
            assert_eq!(counts, floats(&case["bin_counts"]), "{}", case["name"]);
            // Theirs leaves out empty bins.
            let accuracies: Vec<f64> = bins.iter().filter_map(|bin| Some(bin.accuracy?.rate)).collect();
            let confidences: Vec<f64> = bins.iter().filter_map(|bin| bin.mean_confidence).collect();
            for (ours, key) in [(accuracies, "prob_true"), (confidences, "prob_pred")] {
                let theirs = floats(&case["calibration_curve"][key]);
                assert_eq!(ours.len(), theirs.len(), "{}", case["name"]);
                ours.iter().zip(theirs).for_each(|(&ours, theirs)| assert_close(ours, theirs, &case));
            }
        }
    }

    #[test]
    fn the_calibration_error_is_that_of_scikit_learns_diagram() {
        for case in stored("cases") {
            let ours = expected_calibration_error(&samples(&case)).unwrap().value;
            assert_close(ours, case["expected_calibration_error"].as_f64().unwrap(), &case);
        }
    }

    #[test]
    fn wilsons_interval_is_that_of_scipy() {
        for case in stored("wilson") {
            let [successes, n] = ["successes", "n"].map(|key| case[key].as_u64().unwrap());
            let ours = Proportion::new(successes, n).unwrap();
            // SciPy knows z to more digits.
            assert!((ours.low - case["low"].as_f64().unwrap()).abs() < 1e-7, "{ours:?} {case}");
            assert!((ours.high - case["high"].as_f64().unwrap()).abs() < 1e-7, "{ours:?} {case}");
        }
    }
}
