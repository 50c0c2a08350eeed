//! Places that drifted: what was learnt last does not hang together with what was learnt first any more.
//!
//! A place follows slow change, since each match brings a new look: dusk links the day to the night. But a chain of
//! matches may also lead astray, and a look in its middle may have been given up for want of room. So the keyframes of
//! a place are compared with one another, as frames are with keyframes: two are linked where the one would join the
//! other's place, or where the robot learnt both in one go.

use std::sync::atomic::{AtomicBool, Ordering};

use super::decision::SHOWN_LOG_ODDS;
use super::fusion::{Clues, RIVAL};
use super::look::Look;
use super::recogniser::Recogniser;
use crate::cnn::Descriptor;
use crate::place_map::{ExperienceId, MapError, PlaceId};

/// A place of which the first keyframe and the last are not linked, not even through others, or several are not linked
/// to several others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drift {
    /// The place.
    pub place: PlaceId,
    /// Its keyframes, those together that are linked; two parts at least, in the order of their first ones.
    pub parts: Vec<Vec<ExperienceId>>,
}

/// A keyframe, and what is compared of it.
struct Shown {
    keyframe: ExperienceId,
    frame_index: u64,
    look: Look,
    /// How alike the CNN holds the fourth of the other places.
    rival_cosine: Option<f32>,
}

impl Recogniser {
    /// The places that drifted. All places must be searched. Nothing is changed; keyframes that are damaged are left
    /// out, which is a [failure of the map](Self::take_map_failure). Takes at most as many comparisons as a place has
    /// pairs of keyframes.
    ///
    /// # Errors
    /// If `stop` is set meanwhile, or the medium fails.
    pub fn drifted(&mut self, stop: &AtomicBool) -> Result<Vec<Drift>, MapError> {
        let mut drifted = Vec::new();
        let living = self.map.living_places();
        for place in living.map(|place| place.id).collect::<Vec<_>>() {
            let parts = self.parts(place, stop)?;
            if has_drifted(&parts) {
                drifted.push(Drift { place, parts });
            }
        }
        Ok(drifted)
    }

    /// The keyframes of a place in order, those together that are linked.
    fn parts(&mut self, place: PlaceId, stop: &AtomicBool) -> Result<Vec<Vec<ExperienceId>>, MapError> {
        let mut parts: Vec<Vec<Shown>> = Vec::new();
        for keyframe in self.keyframes_of(place) {
            let Some(one) = self.shown(place, keyframe)? else { continue };
            let (mut linked, mut others) = (Vec::new(), Vec::new());
            for part in parts {
                if stop.load(Ordering::Relaxed) {
                    return Err(MapError::Interrupted);
                }
                // What was learnt last is mostly the most alike.
                let is_linked = part.iter().rev().any(|other| self.are_linked(&one, other));
                if is_linked { linked.extend(part) } else { others.push(part) }
            }
            linked.push(one);
            others.push(linked);
            parts = others;
        }
        let in_order = |part: Vec<Shown>| {
            let mut keyframes: Vec<ExperienceId> = part.into_iter().map(|shown| shown.keyframe).collect();
            keyframes.sort_unstable();
            keyframes
        };
        let mut parts: Vec<Vec<ExperienceId>> = parts.into_iter().map(in_order).collect();
        parts.sort_unstable();
        Ok(parts)
    }

    /// What a keyframe of `place` shows, unless it is damaged.
    fn shown(&mut self, place: PlaceId, keyframe: ExperienceId) -> Result<Option<Shown>, MapError> {
        if self.working_set.is_left_out(keyframe) {
            return Ok(None);
        }
        let read = self.look_of(&self.map, keyframe);
        match read.and_then(|look| Ok((look, self.map.origin(keyframe)?.frame_index))) {
            Ok((look, frame_index)) => {
                let rival_cosine = look.appearance.as_ref().and_then(|seen| self.rival_cosine(place, seen));
                Ok(Some(Shown { keyframe, frame_index, look, rival_cosine }))
            }
            Err(failure) if failure.is_damage() => {
                self.leave_out(keyframe, failure);
                Ok(None)
            }
            Err(failure) => Err(failure),
        }
    }

    fn rival_cosine(&mut self, place: PlaceId, seen: &Descriptor) -> Option<f32> {
        let named = self.appearances.query(seen);
        named.iter().filter(|candidate| candidate.place != place).nth(RIVAL - 1).map(|rival| rival.score)
    }

    /// Whether `one` would join the place of `other`, which was learnt before it, or was learnt in one go with it.
    fn are_linked(&mut self, one: &Shown, other: &Shown) -> bool {
        // In the next run frames are counted anew.
        let is_near = one.keyframe.0.abs_diff(other.keyframe.0) <= self.options.place_interval;
        if is_near && one.frame_index > other.frame_index {
            return true;
        }
        let (seen, known) = (one.look.appearance.as_ref(), other.look.appearance.as_ref());
        let cosine = seen.zip(known).map(|(seen, known)| seen.cosine(known));
        let geometry =
            self.comparing(&one.look, |recogniser, query| recogniser.geometry(query, &other.look.features));
        let inliers = geometry.effective_inliers;
        let clues = Clues { cosine, rival_cosine: one.rival_cosine, inliers, rival_inliers: 0 };
        inliers >= self.options.min_inliers || clues.log_odds(self.model.as_ref()) >= SHOWN_LOG_ODDS
    }
}

/// Whether the first keyframe and the last are not linked, or several are not linked to several others: two places that
/// are visited in turn. A single look in between, linked to none, is no drift.
fn has_drifted(parts: &[Vec<ExperienceId>]) -> bool {
    let last = parts.iter().flatten().max();
    // The first keyframe is in the first part.
    let ends_elsewhere = parts.first().is_some_and(|part| part.last() != last);
    ends_elsewhere || parts.iter().filter(|part| part.len() > 1).count() > 1
}

#[cfg(test)]
mod tests {
    use super::super::RecognitionOptions;
    use super::super::world_for_tests::{Robot, card, in_memory, learn, new, no_interval, place_of};
    use super::*;
    use crate::frame::Frame;
    use crate::place_map::{NewExperience, PlaceMap};

    static GO_ON: AtomicBool = AtomicBool::new(false);

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
    fn a_place_that_is_two_visited_in_turn_has_drifted_though_it_ends_where_it_began() {
        let mut map = in_memory();
        place_of(&mut map, &[(1, 1), (2, 2), (2, 2), (1, 1)]);
        assert_eq!(parts(&drifted(map, no_interval())[0]), [[0, 3], [1, 2]]);
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
        let mut map = in_memory();
        let place = place_of(&mut map, &[(1, 1)]);
        learn(&mut map, Some(place), (0, 2, 2));
        let found = drifted(map, RecognitionOptions { place_interval: 1, ..no_interval() });
        assert_eq!(found.len(), 1, "what comes next may be of the next run");
    }

    #[test]
    fn a_place_without_a_keyframe_or_with_one_has_not_drifted_and_geometry_links_without_a_cnn() {
        let mut map = in_memory();
        place_of(&mut map, &[(1, 1)]);
        place_of(&mut map, &[(2, 1), (2, 3)]);
        map.learn(None, &NewExperience { keyframe: None, ..new(&Frame::numbered(9)) }).unwrap();
        let mut robot = Robot::new(None, no_interval(), map);
        assert_eq!(robot.recogniser.drifted(&GO_ON).unwrap(), []);
    }

    #[test]
    fn a_place_that_was_merged_into_another_is_judged_with_it() {
        let mut map = in_memory();
        let here = place_of(&mut map, &[(1, 1), (1, 2)]);
        let there = place_of(&mut map, &[(3, 4)]);
        map.merge_places(there, here).unwrap();
        let found = drifted(map, no_interval());
        assert_eq!((found.len(), found[0].place), (1, here));
        assert_eq!(parts(&found[0]), [vec![0, 1], vec![2]]);
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
