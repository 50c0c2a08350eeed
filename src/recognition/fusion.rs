//! What the CNN and geometry say together of one place.
//!
//! A logistic model over few numbers: how alike the place is and how many effective inliers agree, and by how much it
//! is ahead of others (Lowe's ratio test, for places). What is about as alike as many places may be any of them. Its
//! weights are in the model's card, those of geometry alone here; both were fitted by `models/fuse.py`, which says on
//! what.

use super::by_place::ByPlace;
use super::candidate::{Candidate, Evidence};
use crate::cnn::ModelCard;
use crate::place_map::{ExperienceId, PlaceId};

/// Log odds that a place is right where no CNN takes part: offset, and weights of ln(1 + effective inliers), of there
/// being any, and of what that logarithm is more than that of the best other place.
const GEOMETRY: [f32; 4] = [-0.618, 2.05, -4.77, 1.113];

/// Effective inliers of another place from which on a cosine that passes the card's threshold is not enough by itself.
const VERIFIED: u32 = 8;
/// Which of the other places that the CNN names, the most alike first, a place has to be ahead of.
pub(super) const RIVAL: usize = 4;

/// What was found of one place in a frame, and of others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clues {
    /// Cosine of the CNN descriptors, if a CNN takes part.
    pub cosine: Option<f32>,
    /// Cosine of the fourth most alike of the other places; `None` where there are fewer to compare with. The first
    /// three may share its view.
    pub rival_cosine: Option<f32>,
    /// Effective inliers; 0 where geometry found nothing.
    pub inliers: u32,
    /// The most effective inliers of a place that is neither next to it nor its twin, which the frame shows about as
    /// well beyond doubt.
    pub rival_inliers: u32,
}

impl Clues {
    /// Log odds that the place is right, it and being somewhere else having been as likely before.
    #[must_use]
    pub fn log_odds(self, model: Option<&ModelCard>) -> f32 {
        let inliers = (self.inliers as f32).ln_1p();
        let any = if self.inliers > 0 { 1.0 } else { 0.0 };
        let inlier_margin = inliers - (self.rival_inliers as f32).ln_1p();
        let (Some(model), Some(cosine)) = (model, self.cosine) else {
            return GEOMETRY[0] + GEOMETRY[1] * inliers + GEOMETRY[2] * any + GEOMETRY[3] * inlier_margin;
        };
        let alike = model.log_odds(cosine);
        let margin = self.rival_cosine.map_or(0.0, |rival| alike - model.log_odds(rival));
        let weights = &model.fusion;
        let together = weights.offset
            + weights.cosine * alike
            + weights.cosine_margin * margin
            + weights.inliers * inliers
            + weights.any_inliers * any
            + weights.inlier_margin * inlier_margin;
        let is_verified_elsewhere = self.rival_inliers >= self.inliers.max(VERIFIED);
        let passes = cosine >= model.decision.recognise_above && !is_verified_elsewhere;
        if passes { together.max(weights.passed) } else { together }
    }

    /// The probability of that.
    #[must_use]
    pub fn probability(self, model: Option<&ModelCard>) -> f32 {
        1.0 / (1.0 + (-self.log_odds(model)).exp())
    }

    /// Whether anything was found of the place at all.
    pub(super) fn are_any(self) -> bool {
        self.cosine.is_some() || self.inliers > 0
    }
}

/// Writes over `clues` those of each candidate's place. Candidates that were turned down count for nothing.
/// `is_described` says which keyframes the CNN could have found, `are_next` which places lie next to each other along
/// the robot's ways; from `beyond_doubt` effective inliers on a place is verified beyond doubt.
pub(super) fn clues(
    candidates: &[Candidate],
    (model, beyond_doubt): (Option<&ModelCard>, u32),
    is_described: impl Fn(ExperienceId) -> bool,
    are_next: impl Fn(PlaceId, PlaceId) -> bool,
    clues: &mut ByPlace<Clues>,
) {
    let open = || candidates.iter().filter(|candidate| candidate.rejected.is_none());
    let by_cnn = || open().filter(|candidate| candidate.by == Evidence::Cnn);
    // What is no candidate of the CNN's is at most as alike as the last of them, and passes no threshold.
    let least = by_cnn().map(|candidate| candidate.score).reduce(f32::min);
    let least = least.zip(model).map(|(least, model)| least.min(model.decision.recognise_above.next_down()));
    clues.clear();
    for candidate in open() {
        let cosine = match candidate.by {
            Evidence::Cnn => Some(candidate.score),
            _ => least.filter(|_| is_described(candidate.keyframe)),
        };
        let known = clues.entry(candidate.place, Clues::default());
        known.cosine = [known.cosine, cosine].into_iter().flatten().reduce(f32::max);
        known.inliers = known.inliers.max(candidate.inliers.unwrap_or_default());
    }
    for position in 0..clues.len() {
        let (place, &mut Clues { inliers, .. }) = clues.at_mut(position);
        let is_rival = |&(other, found): &(PlaceId, Clues)| {
            other != place && !are_twins([inliers, found.inliers], beyond_doubt) && !are_next(place, other)
        };
        let rival_inliers = clues.iter().filter(is_rival).map(|(_, found)| found.inliers).max();
        // They come best first, one a place.
        let mut others = by_cnn().filter(|candidate| candidate.place != place);
        let rival_cosine = others.nth(RIVAL - 1).map(|candidate| candidate.score);
        let (_, clues) = clues.at_mut(position);
        (clues.rival_cosine, clues.rival_inliers) = (rival_cosine, rival_inliers.unwrap_or_default());
    }
}

/// Whether a frame shows two places with so many inliers beyond doubt, and neither much better. It may be one place
/// that was founded twice, and two that look alike are told apart by how the robot came there: if either spoke against
/// the other, a third would be founded.
pub(super) fn are_twins(inliers: [u32; 2], beyond_doubt: u32) -> bool {
    let (fewer, more) = (inliers[0].min(inliers[1]), inliers[0].max(inliers[1]));
    fewer >= beyond_doubt && more < 2 * fewer
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
        Candidate { place, keyframe, by, score, votes: None, inliers, probability: 0.0, rejected: None }
    }

    /// The clues of each candidate's place, where 16 inliers are beyond doubt.
    fn found_of(
        candidates: &[Candidate],
        model: Option<&ModelCard>,
        is_described: impl Fn(ExperienceId) -> bool,
        are_next: impl Fn(PlaceId, PlaceId) -> bool,
    ) -> ByPlace<Clues> {
        let mut found = ByPlace::default();
        clues(candidates, (model, 16), is_described, are_next, &mut found);
        found
    }

    fn together(cosine: f32, rival: f32, inliers: u32) -> Clues {
        Clues { cosine: Some(cosine), rival_cosine: Some(rival), inliers, rival_inliers: 0 }
    }

    #[test]
    fn by_night_a_place_is_known_by_being_far_ahead_of_all_others_where_geometry_finds_nothing() {
        let by_night = |rival| together(0.79, rival, 0).probability(Some(&card()));
        assert!(by_night(0.4) > 0.75 && by_night(0.78) < 0.4, "{} {}", by_night(0.4), by_night(0.78));
    }

    #[test]
    fn geometry_speaks_for_a_place_that_the_cnn_does_not_know_and_a_few_inliers_do_not() {
        let of = |inliers| together(0.7, 0.6, inliers).probability(Some(&card()));
        assert!(of(30) > 0.9 && of(3) < 0.3, "{} {}", of(30), of(3));
        let alone = |inliers| Clues { inliers, ..Clues::default() }.probability(None);
        assert!(alone(30) > 0.9 && alone(3) < 0.4, "{} {}", alone(30), alone(3));
        let twin = Clues { inliers: 12, rival_inliers: 12, ..Clues::default() };
        assert!(twin.probability(None) < alone(12) - 0.1, "two places that match alike");
    }

    #[test]
    fn what_was_turned_down_says_nothing_and_both_kinds_speak_of_one_place() {
        let here = candidate(1, Evidence::Cnn, 0.7, None);
        let elsewhere = candidate(2, Evidence::Cnn, 0.6, None);
        let verified = candidate(1, Evidence::BowHv, 0.1, Some(20));
        let unknown = candidate(3, Evidence::BowHv, 0.1, Some(5));
        let rejected = Some(crate::recognition::Rejection::WithinPlaceInterval);
        let left = Candidate { rejected, ..candidate(4, Evidence::Cnn, 0.9, None) };
        let found = [here, elsewhere, left, verified, unknown];
        let clues = found_of(&found, Some(&card()), |_| true, |a, b| a.0 + b.0 == 3);
        let of = |place| clues.get(PlaceId(place)).unwrap();
        assert_eq!((of(1).cosine, of(1).inliers, of(1).rival_inliers), (Some(0.7), 20, 5), "2 is next to it");
        assert_eq!((of(2).cosine, of(2).inliers, of(2).rival_inliers), (Some(0.6), 0, 5));
        assert_eq!((of(3).cosine, of(3).inliers, of(3).rival_inliers), (Some(0.6), 5, 20));
        assert_eq!(clues.get(PlaceId(4)), None);
    }

    #[test]
    fn a_place_that_the_cnn_did_not_name_is_at_most_as_alike_as_the_last_and_one_without_a_descriptor_is_geometrys()
     {
        let named = candidate(1, Evidence::Cnn, 0.9, None);
        let other = candidate(2, Evidence::BowHv, 0.1, Some(0));
        let of = |is_described: bool| {
            let found = [named.clone(), other.clone()];
            found_of(&found, Some(&card()), |_| is_described, |_, _| false).get(PlaceId(2)).unwrap()
        };
        assert_eq!(
            (of(true).cosine, of(false).cosine),
            (Some(0.8_f32.next_down()), None),
            "below the threshold"
        );
    }

    #[test]
    fn a_place_has_to_be_ahead_of_the_fourth_other_one() {
        let named: Vec<Candidate> =
            (0..6).map(|i| candidate(i, Evidence::Cnn, 0.9 - 0.1 * i as f32, None)).collect();
        let rival = |named: &[Candidate], place| {
            let clues = found_of(named, Some(&card()), |_| true, |_, _| false);
            clues.get(PlaceId(place)).unwrap().rival_cosine
        };
        assert_eq!((rival(&named, 0), rival(&named, 5)), (Some(named[4].score), Some(named[3].score)));
        assert_eq!(rival(&named[..4], 0), None, "too few to tell");
    }

    #[test]
    fn of_two_places_that_are_verified_beyond_doubt_neither_speaks_against_the_other_unless_it_is_far_ahead()
    {
        let rivals = |here: u32, there: u32| {
            let found =
                [(1, here), (2, there)].map(|(place, n)| candidate(place, Evidence::BowHv, 0.1, Some(n)));
            let clues = found_of(&found, None, |_| false, |_, _| false);
            [1, 2].map(|place| clues.get(PlaceId(place)).unwrap().rival_inliers)
        };
        assert_eq!(rivals(20, 20), [0, 0]);
        assert_eq!(rivals(20, 39), [0, 0]);
        assert_eq!(rivals(20, 40), [40, 20], "far ahead");
        assert_eq!(rivals(20, 15), [15, 20], "not beyond doubt");
    }

    proptest! {
        #[test]
        fn more_of_either_never_makes_a_place_less_likely(
            cosine in 0.0_f32..1.0,
            more in 0.0_f32..0.5,
            inliers in 4_u32..200,
            further in 0_u32..50,
        ) {
            let of = |cosine, inliers| together(cosine, 0.5, inliers).log_odds(Some(&card()));
            prop_assert!(of(cosine + more, inliers) >= of(cosine, inliers));
            prop_assert!(of(cosine, inliers + further) >= of(cosine, inliers));
            let alone = |inliers| Clues { inliers, ..Clues::default() }.log_odds(None);
            prop_assert!(alone(inliers + further) >= alone(inliers));
        }
    }
}
