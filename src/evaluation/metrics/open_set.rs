//! How well the confidence tells frames of known places from frames of unknown ones.
//!
//! The area under the ROC curve is the Mann-Whitney statistic: the share of (known, unknown) pairs in
//! which the known frame scores higher, ties counted half (Hanley and McNeil, 1982, "The meaning and use of
//! the area under a receiver operating characteristic (ROC) curve").

use super::estimate::Estimate;
use super::score::rankable;

/// The score of a frame's best candidate.
#[derive(Clone, Copy)]
struct Scored {
    score: f64,
    is_known: bool,
}

/// Probability that a known frame scores higher than an unknown one; 1 is best, 0.5 is chance.
///
/// A score of NaN is the lowest. `None` if either is empty; the interval's samples are frames, known and
/// unknown together.
#[must_use]
pub fn auroc(known: &[f64], unknown: &[f64]) -> Option<Estimate> {
    let scored = |is_known| move |&score: &f64| Scored { score: rankable(score), is_known };
    let frames: Vec<Scored> =
        known.iter().map(scored(true)).chain(unknown.iter().map(scored(false))).collect();
    Estimate::bootstrap(&frames, area)
}

/// The area under the ROC curve; `None` where all frames are known or all unknown.
fn area(frames: &[Scored]) -> Option<f64> {
    let mut frames = frames.to_vec();
    frames.sort_unstable_by(|a, b| a.score.total_cmp(&b.score));
    let (mut known, mut unknown) = (0, 0);
    let mut half_wins = 0;
    for tied in frames.chunk_by(|a, b| a.score == b.score) {
        let tied_known = tied.iter().filter(|frame| frame.is_known).count() as u64;
        let tied_unknown = tied.len() as u64 - tied_known;
        half_wins += tied_known * (2 * unknown + tied_unknown);
        known += tied_known;
        unknown += tied_unknown;
    }
    let pairs = known * unknown;
    (pairs > 0).then(|| half_wins as f64 / (2 * pairs) as f64)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn value(known: &[f64], unknown: &[f64]) -> f64 {
        auroc(known, unknown).unwrap().value
    }

    /// Counts the pairs.
    fn oracle(known: &[f64], unknown: &[f64]) -> f64 {
        let credit = |k: f64, u: f64| if k > u { 1.0 } else { f64::from(u8::from(k == u)) / 2.0 };
        let wins: f64 = known.iter().flat_map(|&k| unknown.iter().map(move |&u| credit(k, u))).sum();
        wins / (known.len() * unknown.len()) as f64
    }

    fn scores() -> impl Strategy<Value = Vec<f64>> {
        prop::collection::vec((0_u8..8).prop_map(|eighths| f64::from(eighths) / 8.0), 1..25)
    }

    #[test]
    fn a_tie_counts_half() {
        // Pairs: 0.9 > 0.5, 0.9 > 0.2, 0.5 = 0.5, 0.5 > 0.2, 0.1 < 0.5, 0.1 < 0.2; 3.5 of 6.
        assert!((value(&[0.9, 0.5, 0.1], &[0.5, 0.2]) - 3.5 / 6.0).abs() < 1e-15);
        assert_eq!(value(&[0.3], &[0.3]), 0.5);
        assert_eq!(value(&[0.0], &[-0.0]), 0.5);
    }

    #[test]
    fn apart_is_1_and_the_wrong_way_round_is_0() {
        assert_eq!(value(&[0.7, 0.8], &[0.1, 0.6, 0.2]), 1.0);
        assert_eq!(value(&[0.1, 0.2], &[0.7, 0.8, 0.3]), 0.0);
    }

    #[test]
    fn nothing_to_tell_apart_is_none() {
        assert_eq!(auroc(&[], &[0.5]), None);
        assert_eq!(auroc(&[0.5], &[]), None);
        assert_eq!(auroc(&[], &[]), None);
    }

    #[test]
    fn a_score_of_nan_is_the_lowest() {
        assert_eq!(value(&[f64::NAN, 0.5], &[0.0]), 0.5);
        assert_eq!(value(&[f64::NAN], &[f64::NAN]), 0.5);
    }

    #[test]
    fn the_interval_counts_all_frames_and_holds_the_truth() {
        // Known frames score i / 100, unknown ones i / 100 - 1 / 4: the truth is 1 - 0.75² / 2 = 0.71875 but
        // for ties, and its standard error about 0.036.
        let known: Vec<f64> = (0..100).map(|i| f64::from(i) / 100.0).collect();
        let unknown: Vec<f64> = known.iter().map(|score| score - 0.25).collect();
        let estimate = auroc(&known, &unknown).unwrap();
        assert_eq!(estimate.n, 200);
        assert!((estimate.value - 0.718_75).abs() < 1e-3, "{estimate:?}");
        assert!((0.6..0.69).contains(&estimate.low) && (0.75..0.84).contains(&estimate.high), "{estimate:?}");
    }

    proptest! {
        #[test]
        fn auroc_is_the_share_of_pairs_in_the_right_order(known in scores(), unknown in scores()) {
            prop_assert!((value(&known, &unknown) - oracle(&known, &unknown)).abs() < 1e-12);
        }

        #[test]
        fn the_order_of_frames_does_not_matter(
            (known, shuffled) in scores()
                .prop_flat_map(|known| (Just(known.clone()), Just(known).prop_shuffle())),
            unknown in scores(),
        ) {
            prop_assert_eq!(value(&known, &unknown), value(&shuffled, &unknown));
        }

        #[test]
        fn known_and_unknown_changed_over_give_the_rest_to_1(known in scores(), unknown in scores()) {
            prop_assert!((value(&known, &unknown) + value(&unknown, &known) - 1.0).abs() < 1e-12);
        }
    }
}
