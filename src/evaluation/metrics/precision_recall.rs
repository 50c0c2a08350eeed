//! Precision and recall of a query's best candidate as the threshold falls.
//!
//! At a threshold a guess is given if its score is at or above it. Precision is right guesses given /
//! guesses given, recall is right guesses given / known queries. Average precision is
//! Σ (`R_i` - `R_{i-1}`) · `P_i` over the distinct thresholds, falling (scikit-learn's
//! `average_precision_score`, with the known queries in the denominator of recall).

use serde::Serialize;

use super::estimate::Estimate;
use super::score::rankable;
use crate::proportion::Proportion;

/// Most points of a curve that a report shows.
const MAX_POINTS: usize = 500;

/// A query's best candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guess {
    /// The higher, the surer; NaN is the lowest.
    pub score: f64,
    /// Whether it shows the query's place; never so for a query of an unknown place.
    pub is_right: bool,
}

/// Precision and recall at one threshold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PrecisionRecallPoint {
    /// Guesses with this score or a higher one are given.
    pub threshold: f64,
    /// Right guesses given / guesses given.
    pub precision: f64,
    /// Right guesses given / known queries.
    pub recall: f64,
}

/// Precision and recall at every threshold.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PrecisionRecall {
    /// One point a distinct score, the highest threshold first; of more than 500 evenly chosen ones, both
    /// ends included. Empty if there is no guess or no known query.
    pub points: Vec<PrecisionRecallPoint>,
}

impl PrecisionRecall {
    /// The curve of `guesses`, at most one a query; `known` queries have a place to be found, those without
    /// any candidate included.
    #[must_use]
    pub fn new(guesses: &[Guess], known: u64) -> Self {
        let steps = if known == 0 { Vec::new() } else { steps(guesses) };
        let shown = steps.len().min(MAX_POINTS);
        let intervals = shown.saturating_sub(1).max(1);
        let points = (0..shown).map(|index| {
            let step = steps[index * (steps.len() - 1) / intervals];
            let right = step.right as f64;
            PrecisionRecallPoint {
                threshold: step.threshold,
                precision: right / step.given as f64,
                recall: right / known as f64,
            }
        });
        Self { points: points.collect() }
    }
}

/// Average precision of `guesses`, at most one a query, where `known` queries have a place to be found;
/// `None` without known queries.
///
/// The interval's samples are queries: the guesses, and the known queries known to have none. A wrong guess
/// does not say whether its query was known, so each stands for the share of the wrong ones that must be.
#[must_use]
pub fn average_precision(guesses: &[Guess], known: u64) -> Option<Estimate> {
    Estimate::bootstrap(&queries(guesses, known), |queries| {
        let known: f64 = queries.iter().map(|query| query.known).sum();
        let guesses: Vec<Guess> = queries.iter().filter_map(|query| query.guess).collect();
        (known > 0.0).then(|| area(&steps(&guesses), known))
    })
}

/// Largest recall at a threshold without a wrong guess; `None` without known queries.
#[must_use]
pub fn recall_at_full_precision(guesses: &[Guess], known: u64) -> Option<Proportion> {
    let faultless = steps(guesses).into_iter().take_while(|step| step.right == step.given);
    Proportion::new(faultless.last().map_or(0, |step| step.right), known)
}

/// What is given at one threshold.
#[derive(Clone, Copy)]
struct Step {
    threshold: f64,
    right: u64,
    given: u64,
}

/// One step a distinct score, the highest first: guesses of equal score stand or fall together.
fn steps(guesses: &[Guess]) -> Vec<Step> {
    let mut falling: Vec<Guess> =
        guesses.iter().map(|guess| Guess { score: rankable(guess.score), ..*guess }).collect();
    falling.sort_unstable_by(|a, b| b.score.total_cmp(&a.score));
    let (mut right, mut given) = (0, 0);
    let tied = falling.chunk_by(|a, b| a.score == b.score);
    tied.map(|tied| {
        right += tied.iter().filter(|guess| guess.is_right).count() as u64;
        given += tied.len() as u64;
        Step { threshold: tied[0].score, right, given }
    })
    .collect()
}

/// Area under the curve, by steps.
fn area(steps: &[Step], known: f64) -> f64 {
    let mut right_before = 0;
    let precisions = steps.iter().map(|step| {
        let gained = step.right - right_before;
        right_before = step.right;
        gained as f64 * (step.right as f64 / step.given as f64)
    });
    // An empty sum of floats is -0.
    0.0 + precisions.sum::<f64>() / known
}

/// A query as the bootstrap draws it.
#[derive(Clone, Copy)]
struct Query {
    guess: Option<Guess>,
    /// Share of it that is known.
    known: f64,
}

/// The guesses, and as many queries without one as `known` asks for.
fn queries(guesses: &[Guess], known: u64) -> Vec<Query> {
    let right = guesses.iter().filter(|guess| guess.is_right).count() as u64;
    debug_assert!(right <= known, "{right} right guesses for {known} known queries");
    let wrong = guesses.len() as u64 - right;
    let missed = known.saturating_sub(right);
    let known_if_wrong = if missed < wrong { missed as f64 / wrong as f64 } else { 1.0 };
    let silent = (wrong..missed).map(|_| Query { guess: None, known: 1.0 });
    let guessed = guesses
        .iter()
        .map(|&guess| Query { guess: Some(guess), known: if guess.is_right { 1.0 } else { known_if_wrong } });
    guessed.chain(silent).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn guesses(of: &[(f64, bool)]) -> Vec<Guess> {
        of.iter().map(|&(score, is_right)| Guess { score, is_right }).collect()
    }

    fn value(guesses: &[Guess], known: u64) -> f64 {
        average_precision(guesses, known).unwrap().value
    }

    fn triples(curve: &PrecisionRecall) -> Vec<(f64, f64, f64)> {
        curve.points.iter().map(|point| (point.threshold, point.precision, point.recall)).collect()
    }

    /// Right guesses and guesses at or above `threshold`.
    fn counts(guesses: &[Guess], threshold: f64) -> (f64, f64) {
        let given: Vec<_> = guesses.iter().filter(|guess| guess.score >= threshold).collect();
        (given.iter().filter(|guess| guess.is_right).count() as f64, given.len() as f64)
    }

    /// Distinct scores, the highest first.
    fn thresholds(guesses: &[Guess]) -> Vec<f64> {
        let mut thresholds: Vec<f64> = guesses.iter().map(|guess| guess.score).collect();
        thresholds.sort_by(|a, b| b.total_cmp(a));
        thresholds.dedup();
        thresholds
    }

    /// Average precision by its definition, each threshold on its own.
    fn oracle(guesses: &[Guess], known: u64) -> f64 {
        let mut recall_before = 0.0;
        let mut area = 0.0;
        for threshold in thresholds(guesses) {
            let (right, given) = counts(guesses, threshold);
            area += (right / known as f64 - recall_before) * (right / given);
            recall_before = right / known as f64;
        }
        area
    }

    fn right(guesses: &[Guess]) -> u64 {
        guesses.iter().filter(|guess| guess.is_right).count() as u64
    }

    /// Guesses with many ties, and at least one known query.
    fn outcomes() -> impl Strategy<Value = (Vec<Guess>, u64)> {
        let guess = (0_u8..12, any::<bool>())
            .prop_map(|(twelfths, is_right)| Guess { score: f64::from(twelfths) / 12.0, is_right });
        (prop::collection::vec(guess, 1..40), 0_u64..20).prop_map(|(guesses, missed)| {
            let known = (right(&guesses) + missed).max(1);
            (guesses, known)
        })
    }

    #[test]
    fn the_curve_of_four_guesses() {
        // Falling: 0.9 right, 0.8 wrong, 0.7 right, 0.1 wrong; five queries are known.
        let guesses = guesses(&[(0.7, true), (0.9, true), (0.1, false), (0.8, false)]);
        let curve = PrecisionRecall::new(&guesses, 5);
        let expected = [(0.9, 1.0, 0.2), (0.8, 0.5, 0.2), (0.7, 2.0 / 3.0, 0.4), (0.1, 0.5, 0.4)];
        assert_eq!(triples(&curve), expected);
        // 0.2 · 1 + 0 · 0.5 + 0.2 · 2/3 + 0 · 0.5 = 1/3.
        assert!((value(&guesses, 5) - 1.0 / 3.0).abs() < 1e-15);
        let recall = recall_at_full_precision(&guesses, 5).unwrap();
        assert_eq!((recall.successes, recall.n), (1, 5));
    }

    #[test]
    fn guesses_of_equal_score_stand_or_fall_together() {
        // At 0.9: 1 of 1. At 0.5: 2 more right and 1 wrong, 3 of 4.
        let guesses = guesses(&[(0.5, true), (0.5, false), (0.9, true), (0.5, true)]);
        let curve = PrecisionRecall::new(&guesses, 4);
        assert_eq!(triples(&curve), [(0.9, 1.0, 0.25), (0.5, 0.75, 0.75)]);
        // 0.25 · 1 + 0.5 · 0.75 = 0.625.
        assert_eq!(value(&guesses, 4), 0.625);
        assert_eq!(recall_at_full_precision(&guesses, 4).unwrap().successes, 1);
    }

    #[test]
    fn a_right_guess_that_ties_with_a_wrong_one_is_not_faultless() {
        let tied = guesses(&[(0.9, true), (0.9, false), (0.4, true)]);
        assert_eq!(recall_at_full_precision(&tied, 2).unwrap().successes, 0);
        let apart = guesses(&[(0.9, true), (0.89, false), (0.4, true)]);
        assert_eq!(recall_at_full_precision(&apart, 2).unwrap().successes, 1);
        let faultless = guesses(&[(0.9, true), (0.89, true), (0.4, true)]);
        assert_eq!(recall_at_full_precision(&faultless, 4).unwrap().successes, 3);
    }

    #[test]
    fn queries_without_a_candidate_cost_recall() {
        let guesses = guesses(&[(0.9, true), (0.8, true)]);
        assert_eq!(value(&guesses, 2), 1.0);
        assert_eq!(value(&guesses, 8), 0.25);
        assert_eq!(average_precision(&guesses, 8).unwrap().n, 8);
    }

    #[test]
    fn wrong_guesses_of_unknown_queries_cost_precision() {
        // One right guess below three wrong ones: 1 · 1/4.
        let guesses = guesses(&[(0.9, false), (0.8, false), (0.7, false), (0.6, true)]);
        let estimate = average_precision(&guesses, 1).unwrap();
        assert_eq!((estimate.value, estimate.n), (0.25, 4));
        assert_eq!(recall_at_full_precision(&guesses, 1).unwrap().successes, 0);
    }

    #[test]
    fn without_guesses_nothing_is_found_and_without_known_queries_nothing_is_asked() {
        let nothing_found = Estimate { value: 0.0, n: 3, low: 0.0, high: 0.0 };
        assert_eq!(average_precision(&[], 3), Some(nothing_found));
        assert_eq!(recall_at_full_precision(&[], 3).unwrap().successes, 0);
        assert!(PrecisionRecall::new(&[], 3).points.is_empty());
        let wrong = guesses(&[(0.5, false)]);
        assert_eq!(average_precision(&wrong, 0), None);
        assert_eq!(recall_at_full_precision(&wrong, 0), None);
        assert!(PrecisionRecall::new(&wrong, 0).points.is_empty());
    }

    #[test]
    fn a_score_of_nan_is_the_lowest() {
        // At 0.2: 1 of 1. At NaN: 2 of 3. 0.5 · 1 + 0.5 · 2/3 = 5/6.
        let guesses = guesses(&[(f64::NAN, true), (0.2, true), (f64::NAN, false)]);
        assert!((value(&guesses, 2) - 5.0 / 6.0).abs() < 1e-15);
        let curve = PrecisionRecall::new(&guesses, 2);
        assert_eq!(triples(&curve), [(0.2, 1.0, 0.5), (f64::NEG_INFINITY, 2.0 / 3.0, 1.0)]);
    }

    #[test]
    fn a_long_curve_is_thinned_evenly_and_keeps_both_ends() {
        let curve_of = |count: u32| {
            let guesses: Vec<_> =
                (0..count).map(|i| Guess { score: f64::from(i), is_right: i % 2 == 0 }).collect();
            PrecisionRecall::new(&guesses, u64::from(count)).points
        };
        assert_eq!((curve_of(1).len(), curve_of(500).len(), curve_of(501).len()), (1, 500, 500));
        let points = curve_of(1_997);
        assert_eq!((points.len(), points[0].threshold, points[499].threshold), (500, 1_996.0, 0.0));
        // 1,996 steps in 499 intervals: every fourth.
        assert!(points.windows(2).all(|pair| pair[0].threshold - pair[1].threshold == 4.0));
    }

    #[test]
    fn the_interval_narrows_as_queries_grow_and_holds_the_truth() {
        // Right and wrong guesses in turn at every score: precision is 1/2 throughout, recall ends at 1.
        let width_of = |count: u32| {
            let guesses: Vec<_> =
                (0..count).map(|i| Guess { score: f64::from(i / 2), is_right: i % 2 == 0 }).collect();
            let estimate = average_precision(&guesses, u64::from(count / 2)).unwrap();
            assert!((estimate.value - 0.5).abs() < 1e-12 && estimate.n == u64::from(count), "{estimate:?}");
            assert!(estimate.low < 0.5 && 0.5 < estimate.high, "{estimate:?}");
            estimate.high - estimate.low
        };
        assert!(width_of(2_000) < width_of(100) / 2.0);
    }

    proptest! {
        #[test]
        fn average_precision_is_what_its_definition_says((guesses, known) in outcomes()) {
            let estimate = average_precision(&guesses, known).unwrap();
            prop_assert!((estimate.value - oracle(&guesses, known)).abs() < 1e-12);
            prop_assert!(0.0 <= estimate.low && estimate.high <= 1.0 + 1e-12, "{:?}", estimate);
        }

        #[test]
        fn every_point_is_counted_at_its_threshold((guesses, known) in outcomes()) {
            let expected: Vec<_> = thresholds(&guesses).into_iter().map(|threshold| {
                let (right, given) = counts(&guesses, threshold);
                (threshold, right / given, right / known as f64)
            }).collect();
            prop_assert_eq!(triples(&PrecisionRecall::new(&guesses, known)), expected);
        }

        #[test]
        fn full_precision_is_the_best_of_all_faultless_thresholds((guesses, known) in outcomes()) {
            let faultless = thresholds(&guesses).into_iter().map(|threshold| counts(&guesses, threshold));
            let best = faultless.filter(|(right, given)| right == given).map(|(right, _)| right as u64).max();
            let recall = recall_at_full_precision(&guesses, known).unwrap();
            prop_assert_eq!((recall.successes, recall.n), (best.unwrap_or(0), known));
        }

        #[test]
        fn the_order_of_queries_does_not_matter(
            ((guesses, known), shuffled) in outcomes()
                .prop_flat_map(|outcome| (Just(outcome.clone()), Just(outcome.0).prop_shuffle())),
        ) {
            prop_assert!((value(&guesses, known) - value(&shuffled, known)).abs() < 1e-12);
            prop_assert_eq!(PrecisionRecall::new(&guesses, known), PrecisionRecall::new(&shuffled, known));
            prop_assert_eq!(
                recall_at_full_precision(&guesses, known),
                recall_at_full_precision(&shuffled, known)
            );
        }
    }
}
