//! Places that drifted: what was learnt last does not hang together with what was learnt first any more.
//!
//! A place follows slow change, since each match brings a new look: dusk links the day to the night. But a chain of
//! matches may also lead astray, and a look in its middle may have been given up for want of room. So the keyframes of
//! a place are compared with one another. Two are linked where geometry verifies them, the CNN is sure of them, or the
//! robot learnt them in one go.

use std::sync::atomic::{AtomicBool, Ordering};

use super::look::Look;
use super::recogniser::Recogniser;
use crate::place_map::{ExperienceId, MapError, PlaceId};
use crate::verification::MatchingView;

/// A place of which the first keyframe and the last are not linked, not even through others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drift {
    /// The place.
    pub place: PlaceId,
    /// Its keyframes, those together that are linked; two parts at least, in the order of their first ones.
    pub parts: Vec<Vec<ExperienceId>>,
}

impl Recogniser {
    /// The places that drifted, of those that are searched. Nothing is changed; keyframes that are damaged are left
    /// out, which is a [failure of the map](Self::take_map_failure). Takes at most as many comparisons as a place has
    /// pairs of keyframes.
    ///
    /// # Errors
    /// If `stop` is set meanwhile, or the medium fails.
    pub fn drifted(&mut self, stop: &AtomicBool) -> Result<Vec<Drift>, MapError> {
        let mut drifted = Vec::new();
        let living = self.map.places().filter(|place| place.merged_into.is_none());
        for place in living.map(|place| place.id).collect::<Vec<_>>() {
            let parts = self.parts(place, stop)?;
            let last = parts.iter().flatten().max();
            // The first keyframe is in the first part.
            if parts.first().is_some_and(|part| part.iter().max() != last) {
                drifted.push(Drift { place, parts });
            }
        }
        self.map_failure.take().map_or(Ok(drifted), Err)
    }

    /// The keyframes of a place, those together that are linked.
    fn parts(&mut self, place: PlaceId, stop: &AtomicBool) -> Result<Vec<Vec<ExperienceId>>, MapError> {
        let mut parts: Vec<Vec<(ExperienceId, Look)>> = Vec::new();
        for keyframe in self.keyframes_of(place) {
            if self.working_set.is_left_out(keyframe) {
                continue;
            }
            let look = match self.look_of(&self.map, keyframe) {
                Ok(look) => look,
                Err(failure) if failure.is_damage() => {
                    self.leave_out(keyframe, failure);
                    continue;
                }
                Err(failure) => return Err(failure),
            };
            let one = (keyframe, look);
            let (mut linked, mut others) = (Vec::new(), Vec::new());
            for part in parts {
                if stop.load(Ordering::Relaxed) {
                    return Err(MapError::Interrupted);
                }
                // What was learnt last is most alike.
                let is_linked = part.iter().rev().any(|other| self.are_linked(&one, other));
                if is_linked { linked.extend(part) } else { others.push(part) }
            }
            linked.push(one);
            others.push(linked);
            parts = others;
        }
        let numbers = |part: Vec<(ExperienceId, Look)>| {
            let mut numbers: Vec<ExperienceId> = part.into_iter().map(|(keyframe, _)| keyframe).collect();
            numbers.sort_unstable();
            numbers
        };
        let mut parts: Vec<Vec<ExperienceId>> = parts.into_iter().map(numbers).collect();
        parts.sort_unstable();
        Ok(parts)
    }

    fn are_linked(&mut self, (a, look): &(ExperienceId, Look), (b, other): &(ExperienceId, Look)) -> bool {
        if a.0.abs_diff(b.0) <= self.options.place_interval {
            return true;
        }
        let cosine = look.appearance.as_ref().zip(other.appearance.as_ref()).map(|(a, b)| a.cosine(b));
        let is_sure =
            |cosine| self.model.as_ref().is_some_and(|card| cosine >= card.decision.recognise_above);
        if cosine.is_some_and(is_sure) {
            return true;
        }
        let groups = look.groups();
        let query = MatchingView { features: &look.features, groups: &groups };
        let verification = self.verify_keyframe((query, look.light.condition), *b);
        verification.effective_inliers >= self.options.min_inliers
    }
}

#[cfg(test)]
mod tests {
    use super::super::RecognitionOptions;
    use super::super::world_for_tests::{Robot, appearance, card, features, frame, in_memory, no_interval};
    use super::*;
    use crate::place_map::{Appearance, NewExperience, PlaceMap, Traits};

    static GO_ON: AtomicBool = AtomicBool::new(false);

    /// A place whose keyframes show the features of one place and the looks of another each.
    fn place_of(map: &mut PlaceMap, keyframes: &[(u64, usize)]) -> PlaceId {
        let mut place = None;
        for &(of, look) in keyframes {
            let descriptor = (&appearance(look)).into();
            let appearance = Some(Appearance { model: card().sha256, descriptor });
            let traits = Traits { words: Vec::new(), appearance };
            let new = NewExperience {
                frame: &frame(0),
                view: 0,
                mean_luminance: 120.0,
                thumbnail_jpeg: &[],
                keyframe: Some((&features(of), &traits)),
            };
            place = Some(map.learn(place, &new).unwrap().place);
        }
        place.unwrap()
    }

    fn drifted(map: PlaceMap, options: RecognitionOptions) -> Vec<Drift> {
        Robot::new(Some(card()), options, map).recogniser.drifted(&GO_ON).unwrap()
    }

    fn parts(drift: &Drift) -> Vec<Vec<u32>> {
        drift.parts.iter().map(|part| part.iter().map(|id| id.0).collect()).collect()
    }

    #[test]
    fn a_place_whose_looks_are_linked_by_others_has_not_drifted_however_far_it_came() {
        let mut map = in_memory();
        // Alike in its features, then in its look, then in its features again.
        place_of(&mut map, &[(1, 1), (1, 2), (2, 2), (2, 3)]);
        place_of(&mut map, &[(3, 4)]);
        assert_eq!(drifted(map, no_interval()), []);
    }

    #[test]
    fn a_place_whose_last_look_nothing_links_to_the_first_has_drifted_and_the_parts_are_named() {
        let mut map = in_memory();
        place_of(&mut map, &[(3, 4), (3, 4)]);
        let place = place_of(&mut map, &[(1, 1), (2, 2), (1, 3), (2, 5)]);
        let found = drifted(map, no_interval());
        assert_eq!((found.len(), found[0].place), (1, place));
        assert_eq!(parts(&found[0]), [[2, 4], [3, 5]]);
    }

    #[test]
    fn a_stray_look_in_between_is_no_drift() {
        let mut map = in_memory();
        place_of(&mut map, &[(1, 1), (2, 2), (1, 1)]);
        assert_eq!(drifted(map, no_interval()), []);
    }

    #[test]
    fn what_was_learnt_in_one_go_is_linked_by_the_robots_way() {
        let mut map = in_memory();
        place_of(&mut map, &[(1, 1), (2, 2), (3, 3)]);
        assert_eq!(drifted(map, RecognitionOptions { place_interval: 1, ..no_interval() }), []);
    }

    #[test]
    fn whoever_is_told_to_stop_stops() {
        let mut map = in_memory();
        place_of(&mut map, &[(1, 1), (2, 2)]);
        let mut robot = Robot::new(Some(card()), no_interval(), map);
        let error = robot.recogniser.drifted(&AtomicBool::new(true)).unwrap_err();
        assert!(matches!(error, MapError::Interrupted), "{error}");
    }
}
