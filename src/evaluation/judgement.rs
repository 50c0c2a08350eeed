//! Judgement: answers held against the ground truth.

use super::answer::{Answer, Candidate};
use super::ground_truth::{GroundTruth, Relation};

/// A frame that was asked about, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Asked {
    /// Of the query traverse.
    Query(usize),
    /// Of the traverse of places that the reference does not show.
    Stranger(usize),
}

/// A frame whose answer was judged.
#[derive(Clone, Debug, PartialEq)]
pub struct Judged {
    /// Which frame was asked about.
    pub asked: Asked,
    /// Whether the reference shows its place.
    pub is_known: bool,
    /// Whether an answer was given.
    pub is_given: bool,
    /// Confidence that the best candidate is right; 0 if there is none.
    pub confidence: f64,
    /// What the ground truth says of the best candidate's place; `Different` if there is none.
    pub best: Relation,
    /// What it says of the best candidate's keyframe itself.
    pub best_keyframe: Relation,
    /// How many candidates come before the first that shows the same place.
    pub rank: Option<usize>,
}

/// Which reference frames may be found for which query frame, and what they show.
#[derive(Clone, Copy)]
pub struct Search<'a> {
    /// The ground truth.
    pub truth: &'a GroundTruth,
    /// The first reference frame that may not be found, for each query frame.
    pub horizons: &'a [usize],
}

/// The horizon of every frame of a sequence that is compared with its own past: the first frame that lies
/// fewer than `recent` before it, by frame `numbers`, which ascend.
#[must_use]
pub fn horizons_of_past(numbers: &[u64], recent: u64) -> Vec<usize> {
    let horizon = |(query, &number): (usize, &u64)| {
        numbers.partition_point(|&past| past.saturating_add(recent) <= number).min(query)
    };
    numbers.iter().enumerate().map(horizon).collect()
}

impl Search<'_> {
    /// The first reference frame that may not be found for `query`.
    #[must_use]
    pub fn horizon(&self, query: usize) -> usize {
        self.horizons.get(query).copied().unwrap_or_default()
    }

    /// The reference frames that truly show the place of `query`.
    pub fn matches(&self, query: usize) -> impl Iterator<Item = usize> {
        let truth = self.truth;
        (0..self.horizon(query)).filter(move |&frame| truth.relation(query, frame) == Relation::Same)
    }

    /// Whether the reference shows the place of `query`.
    #[must_use]
    pub fn is_known(&self, query: usize) -> bool {
        self.matches(query).next().is_some()
    }

    /// What the ground truth says of a candidate: of its frame, or of any frame of its place in the map
    /// that lies in the past. Of a place that was only seen just now, or that is right just now and was
    /// somewhere else before, it says nothing: the robot never left it.
    #[must_use]
    pub fn relation(&self, query: usize, candidate: &Candidate, places: &[Vec<usize>]) -> Relation {
        let horizon = self.horizon(query);
        let Some(place) = candidate.place else {
            return self.truth.relation(query, candidate.reference);
        };
        let frames = places.get(place).into_iter().flatten().filter(|&&frame| frame < horizon);
        let mut relation = Relation::Unsaid;
        for &frame in frames {
            match self.truth.relation(query, frame) {
                Relation::Same => return Relation::Same,
                Relation::Different => relation = Relation::Different,
                Relation::Unsaid => {}
            }
        }
        let is_right_just_now = candidate.reference >= horizon
            && self.truth.relation_just_now(query, candidate.reference) != Relation::Different;
        if is_right_just_now { Relation::Unsaid } else { relation }
    }

    /// What the ground truth says of a candidate's own frame.
    fn keyframe_relation(&self, query: usize, candidate: &Candidate) -> Relation {
        if candidate.reference < self.horizon(query) {
            self.truth.relation(query, candidate.reference)
        } else {
            Relation::Unsaid
        }
    }

    /// Judges the answers to the scored query frames; `known` says which of all are known.
    #[must_use]
    pub fn judge(&self, answers: &[Answer], known: &[bool], places: &[Vec<usize>]) -> Vec<Judged> {
        let scored = answers.iter().enumerate().filter(|(query, _)| self.truth.is_scored(*query));
        let judged = scored.map(|(query, answer)| {
            let relations: Vec<Relation> =
                answer.candidates.iter().map(|candidate| self.relation(query, candidate, places)).collect();
            let best = answer.candidates.first();
            Judged {
                asked: Asked::Query(query),
                is_known: known[query],
                is_given: answer.is_given,
                confidence: answer.confidence,
                best: relations.first().copied().unwrap_or(Relation::Different),
                best_keyframe: best.map_or(Relation::Different, |best| self.keyframe_relation(query, best)),
                rank: relations.iter().position(|&relation| relation == Relation::Same),
            }
        });
        judged.collect()
    }
}

/// Judges answers about frames of places that the reference does not show.
#[must_use]
pub fn judge_strangers(answers: &[Answer]) -> Vec<Judged> {
    let judged = |(stranger, answer): (usize, &Answer)| Judged {
        asked: Asked::Stranger(stranger),
        is_known: false,
        is_given: answer.is_given,
        confidence: answer.confidence,
        best: Relation::Different,
        best_keyframe: Relation::Different,
        rank: None,
    };
    answers.iter().enumerate().map(judged).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::ground_truth::{Rule, Spot, Tolerance};

    /// A route of which every frame is another place, except that frame 10 + i is the place of frame i.
    fn two_laps() -> GroundTruth {
        let spots: Vec<Spot> = (0..20).map(|frame| Spot::Ordinal(frame % 10)).collect();
        let tolerance = Tolerance::default();
        GroundTruth {
            definition: String::new(),
            sha256: None,
            rule: Rule::Spots { query: spots.clone(), reference: spots, tolerance },
        }
    }

    fn candidate(reference: usize, place: Option<usize>) -> Candidate {
        Candidate { reference, place, probability: 0.9, reason: String::new() }
    }

    fn answer(candidates: Vec<Candidate>) -> Answer {
        Answer { candidates, confidence: 0.9, is_given: true }
    }

    fn past(recent: u64) -> Vec<usize> {
        horizons_of_past(&(0..20).collect::<Vec<_>>(), recent)
    }

    #[test]
    fn the_past_ends_as_many_frames_back_as_was_asked() {
        assert_eq!(past(3)[10], 8, "frames 0 to 7 are 3 or more back");
        assert_eq!(past(3)[2], 0);
        assert_eq!(past(0)[5], 5, "never the frame itself");
        let truth = two_laps();
        let (just, too_far) = (past(10), past(11));
        let search = |horizons| Search { truth: &truth, horizons };
        assert!(search(&just).is_known(10) && !search(&too_far).is_known(10), "off by one");
        assert!(!search(&just).is_known(9));
    }

    #[test]
    fn the_past_is_counted_in_frames_of_the_sequence_however_few_were_looked_at() {
        assert_eq!(horizons_of_past(&[0, 5, 10, 15, 30], 10), [0, 0, 1, 2, 4]);
        assert_eq!(horizons_of_past(&[0, 5], u64::MAX), [0, 0]);
    }

    #[test]
    fn an_answer_is_right_by_its_frame_and_one_beside_it_is_wrong() {
        let truth = two_laps();
        let horizons = past(5);
        let search = Search { truth: &truth, horizons: &horizons };
        let mut answers = vec![Answer::default(); 20];
        answers[13] = answer(vec![candidate(3, None)]);
        answers[14] = answer(vec![candidate(3, None), candidate(4, None)]);
        let known: Vec<bool> = (0..20).map(|query| search.is_known(query)).collect();
        let judged = search.judge(&answers, &known, &[]);
        assert_eq!((judged[13].best, judged[13].rank), (Relation::Same, Some(0)));
        assert_eq!((judged[14].best, judged[14].rank), (Relation::Different, Some(1)));
        assert_eq!(judged.iter().filter(|judged| judged.is_known).count(), 10);
    }

    #[test]
    fn a_place_is_right_if_any_of_its_past_frames_is_and_unsaid_if_it_has_none() {
        let truth = two_laps();
        let horizons = past(5);
        let search = Search { truth: &truth, horizons: &horizons };
        let places = [vec![2, 3, 12], vec![5, 6], vec![11, 12], vec![6, 12, 13]];
        let relation = |query, place| search.relation(query, &candidate(0, Some(place)), &places);
        assert_eq!(relation(13, 0), Relation::Same);
        assert_eq!(relation(13, 1), Relation::Different);
        assert_eq!(relation(13, 2), Relation::Unsaid, "seen a moment ago, never left");
        let matched = |reference| search.relation(13, &candidate(reference, Some(3)), &places);
        assert_eq!(matched(13), Relation::Unsaid, "right just now, somewhere else before");
        assert_eq!(matched(12), Relation::Different, "wrong now as before");
    }

    #[test]
    fn whatever_is_said_of_a_stranger_is_wrong() {
        let judged = judge_strangers(&[answer(vec![candidate(3, None)]), Answer::default()]);
        assert_eq!([judged[0].is_given, judged[1].is_given], [true, false]);
        assert!(judged.iter().all(|judged| !judged.is_known && judged.best == Relation::Different));
    }
}
