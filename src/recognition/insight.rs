//! What answers go by, for those who look on: how like the frame every keyframe is, where the robot is believed to be,
//! and what of the map is new.

use std::mem;
use std::sync::Arc;

use super::Recognition;
use super::candidate::Evidence;
use super::recogniser::Recogniser;
use crate::place_map::{ExperienceId, Place, PlaceId};

/// What an answer went by.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Insight {
    /// How like the frame keyframes are, by the cosine of the CNN's descriptors; of all that are searched, unless they
    /// are more than 65,536. Where no CNN takes part, by the L1 score of the words, of those that share most of them.
    pub similarities: Vec<(ExperienceId, f32)>,
    /// Probability of each place that stands out, in the order of the places.
    pub belief: Vec<(PlaceId, f32)>,
    /// Probability to be in none of these.
    pub elsewhere: f32,
    /// Places that are new or changed.
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

impl From<&Place> for PlaceSketch {
    fn from(place: &Place) -> Self {
        let Place { id, name, experiences, neighbours, .. } = place;
        Self { id: *id, name: name.clone(), experiences: experiences.len(), neighbours: neighbours.clone() }
    }
}

impl Recogniser {
    /// From the next frame on, somebody looks on: what [`tell`](Self::tell) tells is kept until then.
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
        if similarities.is_empty() {
            let by_words = answer.candidates.iter().filter(|candidate| candidate.by == Evidence::BowHv);
            similarities.extend(by_words.map(|candidate| (candidate.keyframe, candidate.score)));
        }
        belief.clear();
        belief.extend(self.belief.places());
        *elsewhere = self.belief.of_elsewhere();
        places.clear();
        *is_whole_map = mem::take(&mut self.is_map_untold);
        if *is_whole_map {
            let living = self.map.places().filter(|place| place.merged_into.is_none());
            places.extend(living.map(PlaceSketch::from));
        } else if answer.experience.is_some() {
            let place = answer.place.and_then(|place| self.map.place(place));
            places.extend(place.map(PlaceSketch::from));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::world_for_tests::{Robot, in_memory, no_interval};
    use super::super::{Decision, RecognitionOptions};
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
        let insight = told(&mut robot, &answer);
        assert!(insight.similarities.iter().all(|(_, score)| *score < 0.5), "{insight:?}");
        assert!(!insight.is_whole_map);
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
        let mut robot = Robot::new(None, RecognitionOptions { ..no_interval() }, in_memory());
        robot.recogniser.keep_insight();
        for place in [0, 1, 2, 1, 0] {
            let answer = robot.see(place, place as usize);
            let insight = told(&mut robot, &answer);
            let sum = insight.elsewhere + insight.belief.iter().map(|(_, share)| share).sum::<f32>();
            assert!((sum - 1.0).abs() < 1e-3, "{insight:?}");
        }
    }
}
