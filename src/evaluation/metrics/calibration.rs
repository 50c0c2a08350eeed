//! Whether a confidence means what it says: of the answers with confidence 0.8, 80 % should be right.
//!
//! Reliability diagram and expected calibration error Σ (`n_b` / n) · |`accuracy_b` - `confidence_b`| over
//! ten equal bins (Guo and others, 2017, "On calibration of modern neural networks"). As in scikit-learn's
//! `calibration_curve`, a confidence on a border belongs to the bin below it.

use serde::Serialize;

use super::estimate::Estimate;
use super::score::rankable;
use crate::proportion::Proportion;

const BINS: usize = 10;

/// The answers whose confidence is above `low` and at most `high`; the first bin holds 0 too.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReliabilityBin {
    /// Lower border.
    pub low: f64,
    /// Upper border.
    pub high: f64,
    /// Number of answers.
    pub n: u64,
    /// Their mean confidence.
    pub mean_confidence: Option<f64>,
    /// Right ones among them.
    pub accuracy: Option<Proportion>,
}

/// How the confidence compares with how often the answer is right.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Calibration {
    /// Ten equal bins, the lowest confidence first.
    pub bins: Vec<ReliabilityBin>,
}

impl Calibration {
    /// Sorts `answers`, each a confidence and whether it is right, into bins. A confidence outside 0 ..= 1
    /// counts as the nearer end, NaN as 0.
    #[must_use]
    pub fn new(answers: &[(f64, bool)]) -> Self {
        let bins = tallies(answers).into_iter().enumerate().map(|(index, tally)| ReliabilityBin {
            low: border(index),
            high: border(index + 1),
            n: tally.n,
            mean_confidence: (tally.n > 0).then(|| tally.confidence_sum / tally.n as f64),
            accuracy: Proportion::new(tally.right, tally.n),
        });
        Self { bins: bins.collect() }
    }
}

/// Mean distance between confidence and accuracy over ten equal bins, weighted by their `answers`, each a
/// confidence and whether it is right; `None` without answers.
#[must_use]
pub fn expected_calibration_error(answers: &[(f64, bool)]) -> Option<Estimate> {
    Estimate::bootstrap(answers, |answers| {
        // n_b · |right_b / n_b - confidences_b / n_b| is the distance of the sums.
        let distances = tallies(answers).map(|tally| (tally.right as f64 - tally.confidence_sum).abs());
        Some(distances.iter().sum::<f64>() / answers.len() as f64)
    })
}

/// What a bin holds.
#[derive(Clone, Copy, Default)]
struct Tally {
    n: u64,
    right: u64,
    confidence_sum: f64,
}

fn tallies(answers: &[(f64, bool)]) -> [Tally; BINS] {
    let mut tallies = [Tally::default(); BINS];
    for &(confidence, is_right) in answers {
        let confidence = rankable(confidence).clamp(0.0, 1.0);
        let bin = (1..BINS).take_while(|&index| confidence > border(index)).count();
        tallies[bin].n += 1;
        tallies[bin].right += u64::from(is_right);
        tallies[bin].confidence_sum += confidence;
    }
    tallies
}

/// Lower border of bin `index`.
fn border(index: usize) -> f64 {
    index as f64 / BINS as f64
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A confidence between borders or on one.
    fn answers() -> impl Strategy<Value = Vec<(f64, bool)>> {
        let confidence = (0_u8..=40).prop_map(|fortieths| f64::from(fortieths) / 40.0);
        prop::collection::vec((confidence, any::<bool>()), 1..60)
    }

    /// The bins one by one, each going through all answers.
    fn oracle(answers: &[(f64, bool)]) -> f64 {
        let holds = |bin: u8, confidence: f64| {
            let (low, high) = (f64::from(bin) / 10.0, f64::from(bin + 1) / 10.0);
            (low < confidence && confidence <= high) || (bin == 0 && confidence == 0.0)
        };
        let mut error = 0.0;
        for bin in 0..10 {
            let members: Vec<_> = answers.iter().filter(|answer| holds(bin, answer.0)).collect();
            if members.is_empty() {
                continue;
            }
            let n = members.len() as f64;
            let accuracy = members.iter().filter(|answer| answer.1).count() as f64 / n;
            let confidence = members.iter().map(|answer| answer.0).sum::<f64>() / n;
            error += n / answers.len() as f64 * (accuracy - confidence).abs();
        }
        error
    }

    #[test]
    fn five_answers_by_hand() {
        // Bin 0.9 to 1: 0.95 right, 1.0 wrong: accuracy 0.5, confidence 0.975. Bin 0.2 to 0.3: 0.25 wrong,
        // 0.3 right, 0.28 wrong: accuracy 1/3, confidence 0.83/3.
        let answers = [(0.95, true), (0.25, false), (1.0, false), (0.3, true), (0.28, false)];
        let bins = Calibration::new(&answers).bins;
        assert_eq!(bins.iter().map(|bin| bin.n).collect::<Vec<_>>(), [0, 0, 3, 0, 0, 0, 0, 0, 0, 2]);
        assert_eq!((bins[2].low, bins[2].high), (0.2, 0.3));
        assert_eq!(bins[2].accuracy, Proportion::new(1, 3));
        assert!((bins[2].mean_confidence.unwrap() - 0.83 / 3.0).abs() < 1e-15);
        assert_eq!((bins[9].low, bins[9].high, bins[9].accuracy), (0.9, 1.0, Proportion::new(1, 2)));
        assert!((bins[9].mean_confidence.unwrap() - 0.975).abs() < 1e-15);
        assert_eq!((bins[4].mean_confidence, bins[4].accuracy), (None, None));
        // 2/5 · |0.5 - 0.975| + 3/5 · |1/3 - 0.83/3| = 0.19 + 0.034 = 0.224.
        let error = expected_calibration_error(&answers).unwrap();
        assert!((error.value - 0.224).abs() < 1e-12 && error.n == 5, "{error:?}");
    }

    #[test]
    fn a_border_belongs_to_the_bin_below_it() {
        for tenths in 1..=10_u8 {
            let bins = Calibration::new(&[(f64::from(tenths) / 10.0, true)]).bins;
            let full = bins.iter().position(|bin| bin.n == 1);
            assert_eq!(full, Some(usize::from(tenths) - 1), "{tenths} tenths");
        }
        assert_eq!(Calibration::new(&[(0.0, true)]).bins[0].n, 1);
        assert_eq!(Calibration::new(&[(0.100_001, true)]).bins[1].n, 1);
    }

    #[test]
    fn a_confidence_out_of_range_counts_as_the_nearer_end() {
        let bins = Calibration::new(&[(-3.0, true), (f64::NAN, false), (7.0, true)]).bins;
        assert_eq!((bins[0].n, bins[0].mean_confidence), (2, Some(0.0)));
        assert_eq!((bins[9].n, bins[9].mean_confidence), (1, Some(1.0)));
    }

    #[test]
    fn sure_and_right_has_no_error_and_sure_and_wrong_has_all() {
        assert_eq!(expected_calibration_error(&[(1.0, true), (0.0, false)]).unwrap().value, 0.0);
        assert_eq!(expected_calibration_error(&[(1.0, false), (0.0, true)]).unwrap().value, 1.0);
    }

    #[test]
    fn without_answers_there_is_no_error_and_every_bin_is_empty() {
        assert_eq!(expected_calibration_error(&[]), None);
        let bins = Calibration::new(&[]).bins;
        assert!(bins.len() == 10 && bins.iter().all(|bin| bin.n == 0 && bin.accuracy.is_none()));
    }

    proptest! {
        #[test]
        fn the_error_is_what_its_definition_says(answers in answers()) {
            let error = expected_calibration_error(&answers).unwrap();
            prop_assert!((error.value - oracle(&answers)).abs() < 1e-12);
        }

        #[test]
        fn every_answer_is_in_the_bin_of_its_confidence(answers in answers()) {
            let bins = Calibration::new(&answers).bins;
            prop_assert_eq!(bins.iter().map(|bin| bin.n).sum::<u64>(), answers.len() as u64);
            for bin in bins {
                let Some(mean) = bin.mean_confidence else { continue };
                prop_assert!(bin.low - 1e-12 <= mean && mean <= bin.high + 1e-12);
            }
        }

        #[test]
        fn the_order_of_answers_does_not_matter(
            (answers, shuffled) in answers()
                .prop_flat_map(|answers| (Just(answers.clone()), Just(answers).prop_shuffle())),
        ) {
            let value = |answers: &[(f64, bool)]| expected_calibration_error(answers).unwrap().value;
            prop_assert!((value(&answers) - value(&shuffled)).abs() < 1e-12);
        }
    }
}
