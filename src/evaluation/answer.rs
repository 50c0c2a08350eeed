//! Answers: which reference frames a method finds for a query frame, best first, and whether it says so.

/// Most candidates that an answer lists.
pub const MAX_CANDIDATES: usize = 10;

/// What a method finds for one query frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answer {
    /// Candidates, the best first.
    pub candidates: Vec<Candidate>,
    /// Confidence that the best of them is right, as the method reports it: where nothing is accepted, what
    /// its confidence in that leaves.
    pub confidence: f64,
    /// Whether the best one is accepted at the shipped threshold.
    pub is_given: bool,
}

impl Answer {
    /// The answer over what was found: `chosen` first if something was accepted, then the likeliest, each
    /// place of a map and each frame once. What was found first goes before what is equally likely.
    pub(super) fn new(chosen: Option<Candidate>, mut found: Vec<Candidate>, confidence: f64) -> Self {
        let is_given = chosen.is_some();
        found.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let mut candidates: Vec<Candidate> = Vec::with_capacity(MAX_CANDIDATES);
        for candidate in chosen.into_iter().chain(found) {
            if candidates.len() < MAX_CANDIDATES
                && !candidates.iter().any(|known| known.is_one_with(&candidate))
            {
                candidates.push(candidate);
            }
        }
        Self { candidates, confidence, is_given }
    }
}

/// A reference frame that may show the same place.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// The reference frame, counted from 0: a keyframe where a map is searched.
    pub reference: usize,
    /// The place of the map that the frame belongs to, where a map is searched.
    pub place: Option<usize>,
    /// Its own probability of showing the same place.
    pub probability: f64,
    /// Why it was accepted or not.
    pub reason: String,
}

impl Candidate {
    fn is_one_with(&self, other: &Self) -> bool {
        match (self.place, other.place) {
            (Some(place), Some(other)) => place == other,
            _ => self.reference == other.reference,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(reference: usize, place: Option<usize>, probability: f64) -> Candidate {
        Candidate { reference, place, probability, reason: String::new() }
    }

    fn order(answer: &Answer) -> Vec<usize> {
        answer.candidates.iter().map(|candidate| candidate.reference).collect()
    }

    #[test]
    fn what_was_accepted_comes_before_what_is_likelier() {
        let found = vec![candidate(1, None, 0.2), candidate(3, None, 0.99), candidate(2, None, 0.7)];
        let answer = Answer::new(Some(candidate(2, None, 0.7)), found, 0.7);
        assert_eq!((order(&answer), answer.is_given), (vec![2, 3, 1], true));
    }

    #[test]
    fn where_nothing_is_accepted_the_likeliest_comes_first_and_every_place_once() {
        let found = vec![
            candidate(1, Some(7), 0.2),
            candidate(4, Some(8), 0.3),
            candidate(5, Some(7), 0.4),
            candidate(6, Some(9), 0.3),
        ];
        let answer = Answer::new(None, found, 0.5);
        assert_eq!((order(&answer), answer.is_given), (vec![5, 4, 6], false));
    }

    #[test]
    fn an_answer_lists_only_so_many() {
        let found = (0..40).map(|frame| candidate(frame, None, 0.5)).collect();
        assert_eq!(order(&Answer::new(None, found, 0.5)), (0..MAX_CANDIDATES).collect::<Vec<_>>());
    }
}
