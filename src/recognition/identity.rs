//! Whether two places are one, or one place is two.
//!
//! The robot may found a place twice: it came back in another light, or the place waited on the disk. Later frames
//! that geometry matches strongly to both, on several visits, say that both are one: they are merged, and the
//! younger number stays a name of the older place. If frames then keep matching the one half and never the other,
//! they were two that look alike: the merge is undone.
//!
//! Places next to each other along the way share views without being one: places that were founded soon after
//! each other are never merged.

use std::collections::BTreeMap;

use super::candidate::{Candidates, Evidence};
use super::recogniser::Recogniser;
use crate::place_map::{MapError, PlaceId};

/// Effective inliers, as a multiple of what a match needs, that make a match strong.
const STRONG: u32 = 2;
/// Frames after which a frame counts as one of another visit.
const VISIT_FRAMES: u64 = 20;
/// Visits that must match both places before they are merged.
const MERGED_AT: i32 = 3;
/// By how many the visits that match one half alone must outnumber those that match both before a merge is undone.
const SPLIT_AT: i32 = -6;
/// Experiences that lie at least between the foundings of places that may be one.
const FOUNDING_GAP: u32 = 50;
/// Pairs of places that are thought about at a time.
const MAX_PAIRS: usize = 1024;

/// What speaks for two places being one.
#[derive(Default)]
struct PairEvidence {
    /// Visits that matched both, less those that matched one alone. Of a merged pair it counts from the first visit
    /// that makes it doubtful, and is dropped once the doubt is gone: else pairs without doubt, which are seen again
    /// with every round, would crowd out those that are still to be merged.
    balance: i32,
    /// Frame that counted last.
    latest_frame: Option<u64>,
}

/// The pairs of places that may be one.
#[derive(Default)]
pub(super) struct Identities {
    frames: u64,
    pairs: BTreeMap<(PlaceId, PlaceId), PairEvidence>,
}

/// A place as it was learnt that a frame was compared with.
#[derive(Clone, Copy)]
struct Compared {
    learnt_as: PlaceId,
    place: PlaceId,
    is_strong: bool,
    is_match: bool,
}

/// What a frame says of two places.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Together,
    Apart,
    Nothing,
}

/// What is to be done about two places.
enum Change {
    Merge { from: PlaceId, into: PlaceId },
    Split { place: PlaceId },
}

impl Identities {
    /// Counts what this frame says of a pair, once a visit; answers the balance.
    fn count(&mut self, pair: (PlaceId, PlaceId), is_merged: bool, verdict: Verdict) -> i32 {
        if !self.pairs.contains_key(&pair) {
            if is_merged && verdict == Verdict::Together {
                return 0;
            }
            self.make_room();
        }
        let frame = self.frames;
        let evidence = self.pairs.entry(pair).or_default();
        if evidence.latest_frame.is_none_or(|latest| frame - latest > VISIT_FRAMES) {
            evidence.balance += if verdict == Verdict::Together { 1 } else { -1 };
            evidence.latest_frame = Some(frame);
        }
        let balance = evidence.balance;
        if is_merged && balance >= 0 {
            self.pairs.remove(&pair);
        }
        balance
    }

    /// Forgets the pair that was not seen for longest, if there are too many.
    fn make_room(&mut self) {
        if self.pairs.len() >= MAX_PAIRS {
            let oldest = self.pairs.iter().min_by_key(|(_, evidence)| evidence.latest_frame);
            if let Some(oldest) = oldest.map(|(&pair, _)| pair) {
                self.pairs.remove(&oldest);
            }
        }
    }
}

impl Recogniser {
    /// Learns from verified candidates which places are one, and changes the map when the evidence is enough.
    ///
    /// # Errors
    /// If the map cannot be changed.
    pub(super) fn weigh_identities(&mut self, candidates: &Candidates) -> Result<(), MapError> {
        self.identities.frames += 1;
        let compared = self.compared(candidates);
        let pairs = (0..compared.len()).flat_map(|j| (0..j).map(move |i| (i, j)));
        let change = pairs.into_iter().find_map(|(i, j)| self.weigh(compared[i], compared[j]));
        match change {
            Some(Change::Merge { from, into }) => self.merge(from, into),
            Some(Change::Split { place }) => self.split(place),
            None => Ok(()),
        }
    }

    fn compared(&self, candidates: &Candidates) -> Vec<Compared> {
        let by_geometry = candidates.iter().filter(|candidate| candidate.by == Evidence::BowHv);
        let compared = by_geometry.filter_map(|candidate| {
            let inliers = candidate.inliers?;
            Some(Compared {
                learnt_as: self.map.experience(candidate.keyframe)?.learnt_as,
                place: candidate.place,
                is_strong: inliers >= STRONG * self.options.min_inliers,
                is_match: inliers >= self.options.min_inliers,
            })
        });
        compared.collect()
    }

    fn weigh(&mut self, a: Compared, b: Compared) -> Option<Change> {
        let (older, younger) = (a.learnt_as.min(b.learnt_as), a.learnt_as.max(b.learnt_as));
        let is_merged = a.place == b.place;
        let verdict = match (a.is_strong && b.is_strong, is_merged) {
            (true, true) => Verdict::Together,
            (true, false) if self.were_founded_apart(a.place, b.place) => Verdict::Together,
            (false, true) if a.is_strong && !b.is_match || b.is_strong && !a.is_match => Verdict::Apart,
            _ => Verdict::Nothing,
        };
        if verdict == Verdict::Nothing || older == younger {
            return None;
        }
        let balance = self.identities.count((older, younger), is_merged, verdict);
        if !is_merged && balance >= MERGED_AT {
            self.identities.pairs.remove(&(older, younger));
            return Some(Change::Merge { from: a.place.max(b.place), into: a.place.min(b.place) });
        }
        (is_merged && balance <= SPLIT_AT).then_some(Change::Split { place: younger })
    }

    /// Whether so much was learnt between the foundings of two places that the robot must have come back.
    fn were_founded_apart(&self, a: PlaceId, b: PlaceId) -> bool {
        let founded = |place| self.map.place(place).and_then(|place| place.experiences.first().copied());
        founded(a).zip(founded(b)).is_some_and(|(a, b)| a.0.abs_diff(b.0) >= FOUNDING_GAP)
    }

    /// From now on `from` is `into`.
    fn merge(&mut self, from: PlaceId, into: PlaceId) -> Result<(), MapError> {
        self.map.merge_places(from, into)?;
        self.working_set.remove(from);
        self.visits.rename(from, into);
        self.regroup(into)
    }

    /// From now on what was learnt as `place` is a place of its own again, if it was merged.
    fn split(&mut self, place: PlaceId) -> Result<(), MapError> {
        self.identities.pairs.retain(|&(a, b), _| a != place && b != place);
        if self.map.places().nth(place.0 as usize).is_none_or(|place| place.merged_into.is_none()) {
            return Ok(());
        }
        self.map.split_place(place)?;
        self.regroup(place)
    }

    /// Tells the indices whose keyframes those of `place` are, and takes it in.
    fn regroup(&mut self, place: PlaceId) -> Result<(), MapError> {
        for keyframe in self.keyframes_of(place) {
            self.keyframes.rename(keyframe, place);
            self.appearances.rename(keyframe, place);
        }
        self.stay_near(place)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_without_doubt_never_crowd_out_those_that_are_still_to_be_merged() {
        let mut identities = Identities::default();
        let pair = |number: u32| (PlaceId(2 * number), PlaceId(2 * number + 1));
        let mut balance = 0;
        for _ in 0..MERGED_AT {
            for merged in 1..=2 * MAX_PAIRS as u32 {
                identities.frames += 1;
                identities.count(pair(merged), true, Verdict::Together);
            }
            balance = identities.count(pair(0), false, Verdict::Together);
        }
        assert_eq!((balance, identities.pairs.len()), (MERGED_AT, 1));
    }

    #[test]
    fn a_doubt_is_gone_when_as_many_visits_matched_both_as_one() {
        let mut identities = Identities::default();
        let pair = (PlaceId(0), PlaceId(1));
        let mut balances = Vec::new();
        for verdict in
            [Verdict::Apart, Verdict::Apart, Verdict::Together, Verdict::Together, Verdict::Together]
        {
            identities.frames += VISIT_FRAMES + 1;
            balances.push(identities.count(pair, true, verdict));
        }
        assert_eq!((balances, identities.pairs.len()), (vec![-1, -2, -1, 0, 0], 0));
    }

    #[test]
    fn no_more_pairs_are_kept_than_there_may_be() {
        let mut identities = Identities::default();
        for number in 0..2 * MAX_PAIRS as u32 {
            identities.frames += 1;
            identities.count((PlaceId(number), PlaceId(number + 1)), false, Verdict::Together);
        }
        assert_eq!(identities.pairs.len(), MAX_PAIRS);
        assert!(!identities.pairs.contains_key(&(PlaceId(0), PlaceId(1))));
    }
}
