//! What the CNN and geometry say together of one place.
//!
//! A logistic model over few numbers. Its weights and those of geometry alone were fitted by `models/fuse.py`, which
//! says on what. Where the CNN's threshold is passed, that alone says enough: by night there may be no geometry to ask.

use std::collections::BTreeMap;

use super::candidate::{Candidate, Evidence};
use crate::cnn::ModelCard;
use crate::place_map::{ExperienceId, PlaceId};

/// Log odds that a place is right: offset, and weights of the log odds that the CNN gives, of ln(1 + effective inliers)
/// and of there being inliers at all.
const TOGETHER: [f32; 4] = [-1.511, 0.275, 2.491, -3.996];
/// The same where no CNN takes part: offset, and weight of the effective inliers.
const GEOMETRY: [f32; 2] = [-1.313, 0.202];
/// Log odds that a place is right whose cosine passes the threshold, which one in two hundred frames of other places
/// does: half of the frames of the place itself do, too.
const PASSED: f32 = 4.6;

/// What was found of one place in a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clues {
    /// Cosine of the CNN descriptors, if a CNN takes part.
    pub cosine: Option<f32>,
    /// Effective inliers; 0 where geometry found nothing.
    pub inliers: u32,
}

impl Clues {
    /// Log odds that the place is right, all places and none of them being as likely before.
    #[must_use]
    pub fn log_odds(self, model: Option<&ModelCard>) -> f32 {
        let inliers = self.inliers as f32;
        let (Some(model), Some(cosine)) = (model, self.cosine) else {
            return GEOMETRY[0] + GEOMETRY[1] * inliers;
        };
        let found = [1.0, model.log_odds(cosine), inliers.ln_1p(), inliers.min(1.0)];
        let together: f32 = TOGETHER.iter().zip(found).map(|(weight, value)| weight * value).sum();
        if cosine >= model.decision.recognise_above { together.max(PASSED) } else { together }
    }

    /// The probability of that.
    #[must_use]
    pub fn probability(self, model: Option<&ModelCard>) -> f32 {
        1.0 / (1.0 + (-self.log_odds(model)).exp())
    }
}

/// [Log odds](Clues::log_odds) of each candidate's place. Candidates that were turned down count for nothing.
/// `is_described` says which keyframes the CNN could have found.
pub(super) fn log_odds(
    candidates: &[Candidate],
    model: Option<&ModelCard>,
    is_described: impl Fn(ExperienceId) -> bool,
) -> BTreeMap<PlaceId, f32> {
    let open = || candidates.iter().filter(|candidate| candidate.rejected.is_none());
    let by_cnn = || open().filter(|candidate| candidate.by == Evidence::Cnn);
    // What is no candidate of the CNN's is at most as alike as the last of them, and passes no threshold.
    let least = by_cnn().map(|candidate| candidate.score).reduce(f32::min);
    let least = least.zip(model).map(|(least, model)| least.min(model.decision.recognise_above.next_down()));
    let mut clues: BTreeMap<PlaceId, Clues> = BTreeMap::new();
    for candidate in open() {
        let cosine = match candidate.by {
            Evidence::Cnn => Some(candidate.score),
            _ => least.filter(|_| is_described(candidate.keyframe)),
        };
        let inliers = candidate.inliers.unwrap_or_default();
        let known = clues.entry(candidate.place).or_default();
        known.cosine = [known.cosine, cosine].into_iter().flatten().reduce(f32::max);
        known.inliers = known.inliers.max(inliers);
    }
    clues.into_iter().map(|(place, clues)| (place, clues.log_odds(model))).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn card() -> ModelCard {
        let text = "
            name = 'test'\nversion = '1'\ndescription = ''\nlicence = ''\nsource = ''\nrecipe = ''\nsha256 = ''
            input = { name = 'image', width_px = 32, height_px = 32, mean = 0.0, scale = 1.0 }
            descriptor = { name = 'descriptor', dimensions = 16 }
            decision = { recognise_above = 0.8, calibration_slope = 20.0, calibration_offset = -15.0 }
            training = { data = '' }\nmetrics = {}";
        toml::from_str(text).unwrap()
    }

    fn candidate(place: u32, by: Evidence, score: f32, inliers: Option<u32>) -> Candidate {
        let (place, keyframe) = (PlaceId(place), ExperienceId(place));
        Candidate { place, keyframe, by, score, inliers, probability: 0.0, rejected: None }
    }

    #[test]
    fn a_cosine_above_the_threshold_is_enough_where_geometry_finds_nothing() {
        let by_night = |cosine| Clues { cosine: Some(cosine), inliers: 0 }.probability(Some(&card()));
        assert!(by_night(0.81) > 0.98 && by_night(0.79) < 0.5, "{} {}", by_night(0.81), by_night(0.79));
    }

    #[test]
    fn geometry_speaks_for_a_place_that_the_cnn_does_not_know_and_a_few_inliers_do_not() {
        let of = |inliers| Clues { cosine: Some(0.6), inliers }.probability(Some(&card()));
        assert!(of(30) > 0.9 && of(3) < 0.3, "{} {}", of(30), of(3));
        let alone = |inliers| Clues { cosine: None, inliers }.probability(None);
        assert!(alone(30) > 0.9 && alone(3) < 0.4, "{} {}", alone(30), alone(3));
    }

    #[test]
    fn what_was_turned_down_says_nothing_and_both_kinds_speak_of_one_place() {
        let here = candidate(1, Evidence::Cnn, 0.7, None);
        let elsewhere = candidate(2, Evidence::Cnn, 0.6, None);
        let verified = candidate(1, Evidence::BowHv, 0.1, Some(20));
        let unknown = candidate(3, Evidence::BowHv, 0.1, Some(5));
        let rejected = Some(crate::recognition::Rejection::WithinPlaceInterval);
        let left = Candidate { rejected, ..candidate(4, Evidence::Cnn, 0.9, None) };
        let said = log_odds(&[here, elsewhere, left, verified, unknown], Some(&card()), |_| true);
        let of = |cosine, inliers| Clues { cosine: Some(cosine), inliers }.log_odds(Some(&card()));
        let expected = [(1, of(0.7, 20)), (2, of(0.6, 0)), (3, of(0.6, 5))];
        assert_eq!(said, expected.map(|(place, odds)| (PlaceId(place), odds)).into());
    }

    #[test]
    fn a_place_that_the_cnn_did_not_name_passes_no_threshold_of_its_and_one_without_a_descriptor_is_geometrys()
     {
        let named = candidate(1, Evidence::Cnn, 0.9, None);
        let other = candidate(2, Evidence::BowHv, 0.1, Some(0));
        let of = |is_described: bool| {
            log_odds(&[named.clone(), other.clone()], Some(&card()), |_| is_described)[&PlaceId(2)]
        };
        assert!(of(true) < 0.0 && of(false) < 0.0, "{} {}", of(true), of(false));
        assert_eq!(of(false), Clues { cosine: None, inliers: 0 }.log_odds(None));
    }

    proptest! {
        #[test]
        fn more_of_either_never_makes_a_place_less_likely(
            cosine in 0.0_f32..1.0,
            more in 0.0_f32..0.5,
            inliers in 4_u32..200,
            further in 0_u32..50,
        ) {
            let of = |cosine, inliers| Clues { cosine: Some(cosine), inliers }.log_odds(Some(&card()));
            prop_assert!(of(cosine + more, inliers) >= of(cosine, inliers));
            prop_assert!(of(cosine, inliers + further) >= of(cosine, inliers));
            let alone = |inliers| Clues { cosine: None, inliers }.log_odds(None);
            prop_assert!(alone(inliers + further) >= alone(inliers));
        }
    }
}
