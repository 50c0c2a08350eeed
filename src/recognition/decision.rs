//! The decision itself: how likely each candidate is, which one is taken, and what that makes of the frame.

use std::mem;

use heapless::Vec as FixedVec;

use super::belief::{self, Expectation, Neighbours};
use super::by_place::ByPlace;
use super::candidate::{Candidate, Candidates, Evidence, MAX_CANDIDATES, Rejection};
use super::fusion::{self, Clues};
use super::grounds::{Grounds, PlaceGrounds, Thresholds};
use super::identity::STRONG;
use super::look::Look;
use super::recogniser::Recogniser;
use super::{Decision, Recognition};
use crate::place_map::PlaceId;
use crate::verification::Verification;

/// Log odds that a frame has to give a place itself: whatever was seen before, what it speaks against is not its place.
const LEAST_LOG_ODDS: f32 = -3.0;
/// Log odds from which on a frame shows a place itself. Only then does it join it: a robot that stays where it is
/// believed to be would otherwise take its places along, and all would become one.
pub(super) const SHOWN_LOG_ODDS: f32 = 1.0;

/// What a frame and those before it say of places; its memory serves the next frame.
#[derive(Default)]
pub(super) struct Weighed {
    clues: ByPlace<Clues>,
    /// What these make of each place, and 0 of the one that was just founded.
    log_odds: ByPlace<f32>,
    expected: Expectation,
}

impl Recogniser {
    /// Says of every candidate how likely it is and, where that is too little, that it is turned down.
    pub(super) fn weigh_candidates(&mut self, candidates: &mut Candidates) -> Grounds {
        // Taken, so that the recogniser can be asked meanwhile.
        let mut weighed = mem::take(&mut self.weighed);
        let Weighed { clues, log_odds, expected } = &mut weighed;
        self.find_clues(candidates, clues);
        log_odds.clear();
        for (place, clues) in clues.iter() {
            log_odds.set(place, clues.log_odds(self.model.as_ref()));
        }
        if let Some(place) = self.visits.founded_within_interval() {
            // Of the place that was just founded nothing is asked, so nothing speaks against it.
            log_odds.set(place, 0.0);
        }
        // Where every frame counts by itself, nothing is ever expected.
        if self.options.sequence {
            self.belief.expect(&self.map, expected);
        }
        expected.see(log_odds, &mut self.belief);
        let grounds = self.grounds(&weighed);
        self.turn_down(candidates, (&grounds, &weighed.log_odds));
        self.weighed = weighed;
        grounds
    }

    /// Says why candidates are turned down that are too unlikely.
    fn turn_down(&self, candidates: &mut Candidates, (grounds, log_odds): (&Grounds, &ByPlace<f32>)) {
        let Thresholds { probability: needed, log_odds: least, .. } = grounds.thresholds;
        for candidate in candidates.iter_mut() {
            candidate.probability = self.belief.of(candidate.place);
            let around = grounds.around(candidate.place);
            let got = around + grounds.of(candidate.place).map_or(0.0, |grounds| grounds.twins);
            let said = log_odds.get(candidate.place);
            let why = if around == 0.0 && candidate.probability > 0.0 {
                Some(Rejection::NextIsLikelier)
            } else if got < needed {
                Some(Rejection::Unlikely { got, needed })
            } else {
                said.filter(|_| !grounds.may_be(candidate.place))
                    .map(|got| Rejection::NotSeen { got, needed: least })
            };
            candidate.rejected = candidate.rejected.or(why);
        }
    }

    /// Effective inliers from which on geometry verifies a place beyond doubt.
    fn beyond_doubt(&self) -> u32 {
        STRONG * self.options.min_inliers
    }

    fn thresholds(&self) -> Thresholds {
        Thresholds {
            probability: self.options.accept_above,
            log_odds: if self.options.read_only || self.has_shown { LEAST_LOG_ODDS } else { SHOWN_LOG_ODDS },
            inliers: self.options.min_inliers,
            features: self.options.keyframe_features,
            cnn_alone: self.model.as_ref().map(|model| model.decision.recognise_above),
        }
    }

    fn find_clues(&self, candidates: &Candidates, clues: &mut ByPlace<Clues>) {
        // One a candidate's place, so that no more than candidates fit in.
        let mut next: FixedVec<(PlaceId, Neighbours), { 2 * MAX_CANDIDATES }> = FixedVec::new();
        for &Candidate { place, .. } in candidates {
            if next.iter().all(|known| known.0 != place) {
                let _ = next.push((place, belief::neighbours(&self.map, place)));
            }
        }
        let leads =
            |a: PlaceId, b: PlaceId| next.iter().any(|(place, next)| *place == a && next.contains(&b));
        let are_next = |a: PlaceId, b: PlaceId| leads(a, b) && leads(b, a);
        let is_described = |keyframe| self.appearances.contains(keyframe);
        let rules = (self.model.as_ref(), self.beyond_doubt());
        fusion::clues(candidates, rules, is_described, are_next, clues);
    }

    fn grounds(&mut self, Weighed { clues, log_odds, expected }: &Weighed) -> Grounds {
        let mut places = self.spare.grounds();
        let thresholds = self.thresholds();
        // Where nothing was found of a place, the frame says nothing for it, however little it says against it.
        let may_be = |place: PlaceId| {
            let is_found = clues.get(place).is_some_and(Clues::are_any);
            is_found && log_odds.get(place).is_some_and(|said| said >= thresholds.log_odds)
        };
        let of = |place: PlaceId| PlaceGrounds {
            place,
            clues: clues.get(place),
            log_odds: log_odds.get(place),
            before: expected.share(place),
            after: self.belief.of(place),
            around: self.belief.around(place, &self.map, may_be),
            twins: self.likeliness_of_twins(place, clues),
            may_be: may_be(place),
        };
        places.extend(log_odds.iter().map(|(place, _)| of(place)));
        places.extend(expected.places().filter(|&place| log_odds.get(place).is_none()).map(of));
        places.sort_unstable_by(|a, b| b.after.total_cmp(&a.after).then(a.place.cmp(&b.place)));
        let elsewhere = [expected.of_elsewhere(), self.belief.of_elsewhere()];
        Grounds { places, elsewhere, thresholds }
    }

    /// Probability of the twins of a place, if it has any.
    fn likeliness_of_twins(&self, place: PlaceId, clues: &ByPlace<Clues>) -> f32 {
        let Some(here) = clues.get(place) else { return 0.0 };
        let are_next = |other| belief::neighbours(&self.map, place).contains(&other);
        let is_twin = |&(other, there): &(PlaceId, Clues)| {
            other != place
                && fusion::are_twins([here.inliers, there.inliers], self.beyond_doubt())
                && !are_next(other)
        };
        clues.iter().filter(is_twin).map(|(other, _)| self.belief.of(other)).sum()
    }

    /// The candidate that speaks most for the likeliest place that nothing speaks against: the CNN where it is sure,
    /// else geometry where it found something.
    pub(super) fn chosen(&self, candidates: &Candidates) -> Option<Candidate> {
        let open = || candidates.iter().filter(|candidate| candidate.rejected.is_none());
        let likeliest = open().map(|candidate| candidate.probability).reduce(f32::max)?;
        let place = open().find(|candidate| candidate.probability >= likeliest)?.place;
        let speaks = |candidate: &&Candidate| match candidate.by {
            _ if self.is_known_by_cnn(candidate) => u32::MAX,
            Evidence::BowHv => candidate.inliers.unwrap_or_default(),
            // What geometry does not verify the CNN found.
            _ => self.options.min_inliers.saturating_sub(1),
        };
        // Of equals the first.
        open().filter(|candidate| candidate.place == place).rev().max_by_key(speaks).cloned()
    }

    /// Whether the CNN alone is sure of a candidate.
    pub(super) fn is_known_by_cnn(&self, candidate: &Candidate) -> bool {
        let needed = self.model.as_ref().map(|model| model.decision.recognise_above);
        candidate.by == Evidence::Cnn && needed.is_some_and(|needed| candidate.score >= needed)
    }

    /// The decision, before anything is written. A new place has no number yet.
    pub(super) fn judge(
        &self,
        look: &Look,
        chosen: Option<Candidate>,
        (candidates, grounds): (Candidates, Grounds),
        verification: Option<Verification>,
    ) -> Recognition {
        let elsewhere = self.belief.of_elsewhere();
        let (decision, by, place, confidence) = match (&chosen, self.visits.founded_within_interval()) {
            (Some(chosen), _) => {
                let is_cnn = chosen.by == Evidence::Cnn;
                let decision = if is_cnn { Decision::Recognised } else { Decision::Revisited };
                (decision, Some(chosen.by), Some(chosen.place), grounds.around(chosen.place))
            }
            (None, Some(place)) => {
                let likely = grounds.around(place).max(self.belief.of(place));
                (Decision::SamePlace, Some(Evidence::PlaceInterval), Some(place), likely)
            }
            (None, None) if self.options.read_only || self.is_doubtful(look) => {
                (Decision::Unknown, None, None, elsewhere)
            }
            (None, None) => (Decision::NewPlace, None, None, elsewhere),
        };
        Recognition {
            decision,
            by,
            place,
            name: place.and_then(|place| self.map.place(place)).and_then(|place| place.name.clone()),
            keyframe: chosen.as_ref().map(|chosen| chosen.keyframe),
            experience: None,
            confidence,
            inliers: chosen.as_ref().and_then(|chosen| chosen.inliers),
            candidates,
            verification,
            grounds,
        }
    }

    /// Whether a frame that shows no known place founds none: it is the first one after a known place, or the first
    /// poor one.
    fn is_doubtful(&self, look: &Look) -> bool {
        let is_first_poor = !self.was_poor && look.is_poor(self.options.keyframe_features);
        self.has_shown || self.options.sequence && is_first_poor
    }

    /// Marks everything but the chosen one as turned down, and puts that first.
    pub(super) fn mark_outdone(&self, candidates: &mut Candidates, chosen: &Candidate) {
        let inliers = chosen.inliers.filter(|&inliers| inliers >= self.options.min_inliers);
        for candidate in candidates.iter_mut().filter(|candidate| *candidate != chosen) {
            let is_other = candidate.place != chosen.place && self.is_known_by_cnn(candidate);
            let is_told = matches!(
                candidate.rejected,
                None | Some(Rejection::Unlikely { .. } | Rejection::NotSeen { .. })
            );
            match inliers.filter(|_| is_other && is_told) {
                Some(inliers) => {
                    candidate.rejected = Some(Rejection::Overruled { by: chosen.place, inliers })
                }
                None => drop(candidate.rejected.get_or_insert(Rejection::Outdone { by: chosen.place })),
            }
        }
        if let Some(position) = candidates.iter().position(|candidate| candidate == chosen) {
            candidates[..=position].rotate_right(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::world_for_tests::{Robot, appearance, card, in_memory};
    use super::super::{Look, RecognitionOptions};
    use super::*;
    use crate::place_map::ExperienceId;

    fn candidate(place: u32, by: Evidence, score: f32, inliers: Option<u32>) -> Candidate {
        let (place, keyframe) = (PlaceId(place), ExperienceId(place));
        Candidate { place, keyframe, by, score, votes: None, inliers, probability: 0.0, rejected: None }
    }

    /// Decides between places of a robot's map by what was found of them, as if it had been found in a frame.
    fn decide(robot: &mut Robot, found: &[Candidate]) -> Recognition {
        let look = Look { appearance: Some(appearance(3)), ..Look::default() };
        let verified = found.iter().filter(|candidate| candidate.by == Evidence::BowHv).count();
        let candidates = found.iter().cloned().collect();
        let frame = robot.frame();
        let geometry = (0..verified).map(|_| Verification::default()).collect();
        robot.recogniser.decide(&frame, &look, (candidates, geometry), Vec::new)
    }

    /// What the CNN finds of one place and of another, the same of others behind them.
    fn named(place: u32, cosine: f32, other: u32, of_others: f32) -> Vec<Candidate> {
        let rest = (0..8).filter(|&id| id != place && id != other).take(4);
        let rest = rest.map(|id| candidate(id, Evidence::Cnn, of_others, None));
        let first = candidate(place, Evidence::Cnn, cosine, None);
        [first, candidate(other, Evidence::Cnn, of_others + 0.01, None)].into_iter().chain(rest).collect()
    }

    /// A robot that knows so many places, one after the other along a way.
    fn robot_with(places: u64) -> Robot {
        let options = RecognitionOptions { place_interval: 0, ..RecognitionOptions::default() };
        let mut robot = Robot::new(Some(card()), options, in_memory());
        (0..places).for_each(|place| drop(robot.see(place, place as usize)));
        robot
    }

    #[test]
    fn geometry_that_verifies_another_place_overrules_a_cnn_that_is_sure_and_says_so() {
        let sure = named(3, 0.9, 1, 0.7);
        let found = [&sure[..], &[candidate(1, Evidence::BowHv, 0.1, Some(80))]].concat();
        let mut robot = robot_with(8);
        let answer = decide(&mut robot, &found);
        assert_eq!((answer.decision, answer.place), (Decision::Revisited, Some(PlaceId(1))));
        let overruled = answer.candidates.iter().find(|candidate| candidate.place == PlaceId(3)).unwrap();
        assert_eq!(overruled.rejected, Some(Rejection::Overruled { by: PlaceId(1), inliers: 80 }));
        let sure = decide(&mut robot_with(8), &sure);
        assert_eq!((sure.decision, sure.place), (Decision::Recognised, Some(PlaceId(3))));
    }

    #[test]
    fn a_frame_joins_a_place_only_if_it_shows_it_and_a_second_one_that_does_not_founds_another() {
        let mut robot = robot_with(8);
        let (shown, weak) = (named(1, 0.9, 6, 0.4), named(1, 0.72, 6, 0.62));
        (0..3).for_each(|_| drop(decide(&mut robot, &shown)));
        let believed = decide(&mut robot, &weak);
        assert_eq!((believed.place, believed.experience), (Some(PlaceId(1)), None), "known, but not learnt");
        let founded = decide(&mut robot, &weak);
        assert_eq!(founded.decision, Decision::NewPlace);
        assert!(founded.candidates.iter().all(|candidate| candidate.rejected.is_some()));
        robot = robot_with(8);
        (0..3).for_each(|_| drop(decide(&mut robot, &shown)));
        decide(&mut robot, &weak);
        assert_eq!(decide(&mut robot, &shown).place, Some(PlaceId(1)), "one bad frame changes nothing");
    }

    #[test]
    fn the_grounds_say_what_was_thought_of_every_candidates_place_before_and_after() {
        let mut robot = robot_with(8);
        let found = named(1, 0.9, 6, 0.4);
        let answer = decide(&mut robot, &found);
        let of =
            |place| answer.grounds.places.iter().find(|grounds| grounds.place == PlaceId(place)).unwrap();
        assert_eq!(of(1).clues.unwrap().rival_cosine, Some(0.4));
        assert_eq!(of(1).after, answer.candidates[0].probability);
        assert!(of(1).log_odds > Some(3.0) && of(1).before < of(1).after && of(6).log_odds < Some(-2.0));
        assert_eq!(answer.confidence, of(1).around);
        let after: f32 = answer.grounds.places.iter().map(|grounds| grounds.after).sum();
        assert!((after + answer.grounds.elsewhere[1] - 1.0).abs() < 1e-4);
        assert_eq!(answer.grounds.thresholds.cnn_alone, Some(0.8));
    }
}
