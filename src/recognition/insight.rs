//! What answers go by, for those who look on: how like the frame every keyframe is, where the robot is believed to be,
//! and what of the map is new.

use std::mem;
use std::sync::Arc;

use super::belief::neighbours;
use super::candidate::Evidence;
use super::recogniser::Recogniser;
use super::{Decision, Recognition};
use crate::place_map::{ExperienceId, MapError, Place, PlaceId, PlaceMap};

/// What an answer went by.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Insight {
    /// How like the frame keyframes are, by the cosine of the CNN's descriptors: of all that are searched, or of none
    /// where they are more than 65,536. Where no CNN takes part, by the L1 score of the words, of a few.
    pub similarities: Vec<(ExperienceId, f32)>,
    /// Probability of each place that stands out, in the order of the places.
    pub belief: Vec<(PlaceId, f32)>,
    /// Probability to be in none of these.
    pub elsewhere: f32,
    /// Places that are new, or have another experience.
    pub places: Vec<PlaceSketch>,
    /// Whether those are all places that there are, others being none any more.
    pub is_whole_map: bool,
}

/// A place as a node of the map's graph.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceSketch {
    /// Its number.
    pub id: PlaceId,
    /// What people call it, once somebody named it.
    pub name: Option<Arc<str>>,
    /// Number of its experiences.
    pub experiences: usize,
    /// Places next to it along the way.
    pub neighbours: Vec<PlaceId>,
}

/// The keyframe that a frame was matched with, as a picture.
#[derive(Clone, Debug)]
pub struct MatchedKeyframe {
    /// Which.
    pub experience: ExperienceId,
    /// Name of the frame it was.
    pub frame_name: String,
    /// Width of that frame in pixels; the thumbnail is smaller.
    pub width_px: u32,
    /// Height of that frame in pixels.
    pub height_px: u32,
    /// Its thumbnail.
    pub thumbnail_jpeg: Vec<u8>,
}

impl PlaceSketch {
    /// The sketch of `place`; places that were merged are those that they turned out to be.
    #[must_use]
    pub fn of(place: &Place, map: &PlaceMap) -> Self {
        let Place { id, name, experiences, .. } = place;
        let neighbours = neighbours(map, *id).into_iter().collect();
        Self { id: *id, name: name.clone(), experiences: experiences.len(), neighbours }
    }
}

impl Recogniser {
    /// From the next frame on, somebody looks on: what [`tell`](Self::tell) tells is kept until then, and it begins
    /// with the whole map.
    pub fn keep_insight(&mut self) {
        self.appearances.keep_similarities();
        self.is_map_untold = true;
    }

    /// Writes over `insight` what the latest answer went by, and what of the map is new since the one before.
    pub fn tell(&mut self, answer: &Recognition, insight: &mut Insight) {
        let Insight { similarities, belief, elsewhere, places, is_whole_map } = insight;
        similarities.clear();
        if let Some(kept) = self.appearances.similarities() {
            mem::swap(similarities, kept);
        }
        // Two scales do not go together: a CNN that failed on a frame leaves a gap.
        if self.model.is_none() {
            let by_words = answer.candidates.iter().filter(|candidate| candidate.by == Evidence::BowHv);
            similarities.extend(by_words.map(|candidate| (candidate.keyframe, candidate.score)));
        }
        belief.clear();
        belief.extend(self.belief.places());
        *elsewhere = self.belief.of_elsewhere();
        places.clear();
        *is_whole_map = mem::take(&mut self.is_map_untold);
        if *is_whole_map {
            let living = self.map.living_places();
            places.extend(living.map(|place| PlaceSketch::of(place, &self.map)));
        } else if answer.experience.is_some() {
            let place = answer.place.and_then(|place| self.map.place(place));
            places.extend(place.map(|place| PlaceSketch::of(place, &self.map)));
        }
    }

    /// The keyframe that an answer went by, as a picture; nothing if it was given up since.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn matched_keyframe(&self, answer: &Recognition) -> Result<Option<MatchedKeyframe>, MapError> {
        let is_match = matches!(answer.decision, Decision::Recognised | Decision::Revisited);
        let keyframe = answer.keyframe.filter(|&id| is_match && self.map.experience(id).is_some());
        let Some(experience) = keyframe else { return Ok(None) };
        let features = self.map.features(experience)?;
        Ok(Some(MatchedKeyframe {
            experience,
            frame_name: self.map.origin(experience)?.frame_name,
            width_px: features.width_px,
            height_px: features.height_px,
            thumbnail_jpeg: self.map.thumbnail_jpeg(experience)?,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::super::world_for_tests::{Robot, in_memory, no_interval};
    use super::*;

    fn told(robot: &mut Robot, answer: &Recognition) -> Insight {
        let mut insight = Insight::default();
        robot.recogniser.tell(answer, &mut insight);
        insight
    }

    #[test]
    fn the_whole_map_is_told_first_and_then_what_is_new() {
        let mut robot = Robot::with_cnn();
        robot.see(0, 0);
        robot.recogniser.keep_insight();
        let answer = robot.see(1, 1);
        assert_eq!(answer.decision, Decision::NewPlace);
        let first = told(&mut robot, &answer);
        assert!(first.is_whole_map);
        let sketched: Vec<(u32, usize)> =
            first.places.iter().map(|place| (place.id.0, place.experiences)).collect();
        assert_eq!(sketched, [(0, 1), (1, 1)]);
        assert_eq!(first.places[1].neighbours, [PlaceId(0)]);
        let answer = robot.see(2, 2);
        let next = told(&mut robot, &answer);
        assert!(!next.is_whole_map);
        assert_eq!(next.places.iter().map(|place| place.id.0).collect::<Vec<_>>(), [2]);
    }

    #[test]
    fn every_keyframe_is_compared_and_the_likest_is_the_candidate() {
        let mut robot = Robot::with_cnn();
        robot.recogniser.keep_insight();
        (0..5).for_each(|place| drop(robot.see(place, place as usize)));
        robot.leave();
        let answer = robot.see(3, 3);
        let insight = told(&mut robot, &answer);
        // The frame itself has just become none: it looks as its place does.
        assert_eq!(insight.similarities.len(), robot.keyframes());
        let best = insight.similarities.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert_eq!((best.0, best.1), (answer.candidates[0].keyframe, answer.candidates[0].score));
    }

    #[test]
    fn nothing_is_kept_where_nobody_looks_on() {
        let mut robot = Robot::with_cnn();
        robot.see(0, 0);
        let answer = robot.see(1, 1);
        assert!(!answer.candidates.is_empty());
        let insight = told(&mut robot, &answer);
        assert!(insight.similarities.is_empty() && !insight.is_whole_map, "{insight:?}");
    }

    #[test]
    fn a_place_lies_next_to_what_its_neighbour_turned_out_to_be() {
        let mut map = in_memory();
        let mut robot = Robot::new(None, no_interval(), map);
        (0..4).for_each(|place| drop(robot.see(place, 0)));
        map = robot.recogniser.into_map();
        map.merge_places(PlaceId(2), PlaceId(0)).unwrap();
        let sketch = PlaceSketch::of(map.place(PlaceId(3)).unwrap(), &map);
        assert_eq!(sketch.neighbours, [PlaceId(0)]);
    }

    #[test]
    fn without_a_cnn_the_words_say_how_alike_keyframes_are() {
        let mut robot = Robot::without_cnn();
        robot.recogniser.keep_insight();
        robot.see(0, 0);
        robot.leave();
        let answer = robot.see(0, 0);
        let insight = told(&mut robot, &answer);
        let likest = insight.similarities.iter().max_by(|a, b| a.1.total_cmp(&b.1));
        assert!(likest.is_some_and(|(keyframe, score)| Some(*keyframe) == answer.keyframe && *score > 0.9));
    }

    #[test]
    fn what_is_believed_sums_up_to_one() {
        let mut robot = Robot::new(None, no_interval(), in_memory());
        robot.recogniser.keep_insight();
        for place in [0, 1, 2, 1, 0] {
            let answer = robot.see(place, place as usize);
            let insight = told(&mut robot, &answer);
            let sum = insight.elsewhere + insight.belief.iter().map(|(_, share)| share).sum::<f32>();
            assert!((sum - 1.0).abs() < 1e-3, "{insight:?}");
        }
    }
}
