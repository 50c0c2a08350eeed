//! Whether two places are one, or one place is two.
//!
//! The robot may found a place twice: it came back in another light, or the place waited on the disk. Later frames
//! that geometry matches strongly to both, on several visits, say that both are one: they are merged, and the
//! younger number stays a name of the older place. If frames then keep matching the one half and not the other,
//! they were two that look alike: the merge is undone.
//!
//! Places next to each other along the way share views without being one. So a visit counts as a whole: it says one
//! place only if at least two of three frames that show either show both, which a border between two does not; and
//! places that were founded soon after each other are never merged.

use std::collections::BTreeMap;

use heapless::Vec as FixedVec;

use super::candidate::{Candidates, Evidence, MAX_CANDIDATES};
use super::recogniser::Recogniser;
use crate::place_map::{MapError, PlaceId};

/// Effective inliers, as a multiple of what a match needs, that make a match strong.
pub(super) const STRONG: u32 = 2;
/// Frames after which a visit is over.
const VISIT_FRAMES: u64 = 20;
/// By how many the visits that say one place must outnumber the others before places are merged.
const MERGED_AT: i32 = 3;
/// The same for two places, before a merge is undone.
const SPLIT_AT: i32 = -6;
/// Experiences that lie at least between the foundings of places that may be one.
const FOUNDING_GAP: u32 = 50;
/// Pairs of places that are thought about at a time.
const MAX_PAIRS: usize = 1024;

/// The smaller number first.
type Pair = (PlaceId, PlaceId);

/// What speaks for two places being one.
#[derive(Default)]
struct PairEvidence {
    /// Visits that say one place, less those that say two.
    balance: i32,
    /// Frames of the visit that is not over: those that match both, and those that match one alone.
    together: u32,
    apart: u32,
    /// Frame that counted last.
    latest_frame: u64,
}

/// What a frame says of two places.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Together,
    Apart,
}

impl PairEvidence {
    fn count(&mut self, frame: u64, verdict: Verdict) {
        match verdict {
            Verdict::Together => self.together += 1,
            Verdict::Apart => self.apart += 1,
        }
        self.latest_frame = frame;
    }

    /// Ends the visit if it is over at `frame`; answers its frames that match both and that match one alone.
    fn ended(&mut self, frame: u64) -> Option<(u32, u32)> {
        let is_over = self.together + self.apart > 0 && frame - self.latest_frame > VISIT_FRAMES;
        is_over.then(|| (std::mem::take(&mut self.together), std::mem::take(&mut self.apart)))
    }
}

/// What is thought about whether places are one.
#[derive(Default)]
pub(super) struct Identities {
    frames: u64,
    /// Places that may be one.
    suspected: BTreeMap<Pair, PairEvidence>,
    /// Halves of a merged place that may be two: from the first frame that makes it doubtful until the doubt is gone.
    doubted: BTreeMap<Pair, PairEvidence>,
}

/// A place as it was learnt that a frame was compared with.
#[derive(Clone, Copy)]
struct Compared {
    learnt_as: PlaceId,
    place: PlaceId,
    is_strong: bool,
    is_match: bool,
}

/// What is to be done about two places.
#[derive(Debug, PartialEq, Eq)]
enum Change {
    Merge { from: PlaceId, into: PlaceId },
    Split { place: PlaceId },
}

impl Identities {
    /// The frame matches both.
    fn suspect(&mut self, pair: Pair) {
        make_room(&mut self.suspected, pair);
        self.suspected.entry(pair).or_default().count(self.frames, Verdict::Together);
    }

    /// Counts against all suspicions of which the frame matches one place strongly and the other not at all.
    fn clear(&mut self, is_strong: impl Fn(PlaceId) -> bool, is_match: impl Fn(PlaceId) -> bool) {
        for (&(a, b), evidence) in &mut self.suspected {
            if is_strong(a) && !is_match(b) || is_strong(b) && !is_match(a) {
                evidence.count(self.frames, Verdict::Apart);
            }
        }
    }

    /// What the frame says of two halves of a place. What speaks for a merge counts only where it is doubted.
    fn doubt(&mut self, halves: Pair, verdict: Verdict) {
        if verdict == Verdict::Apart {
            make_room(&mut self.doubted, halves);
            self.doubted.entry(halves).or_default().count(self.frames, verdict);
        } else if let Some(evidence) = self.doubted.get_mut(&halves) {
            evidence.count(self.frames, verdict);
        }
    }

    /// Judges the visits that are over; what they say is to be done, the first such thing.
    fn judge_visits(&mut self) -> Option<Change> {
        let frame = self.frames;
        for (&(into, from), evidence) in &mut self.suspected {
            // A visit without a frame that matches both may have been in a light in which only one can be matched.
            if let Some((together @ 1.., apart)) = evidence.ended(frame) {
                evidence.balance += if together >= 2 * apart { 1 } else { -1 };
                if evidence.balance >= MERGED_AT {
                    return Some(Change::Merge { from, into });
                }
            }
        }
        let mut split = None;
        self.doubted.retain(|&(_, place), evidence| {
            let Some((together, apart)) = evidence.ended(frame) else { return true };
            evidence.balance += if together >= 2 * apart { 1 } else { -1 };
            if evidence.balance <= SPLIT_AT {
                split.get_or_insert(Change::Split { place });
            }
            evidence.balance < 0
        });
        split
    }

    /// Begins anew with everything about `place`, which is about to change.
    fn forget(&mut self, place: PlaceId) {
        self.suspected.retain(|&(a, b), _| a != place && b != place);
    }
}

/// Forgets the pair that was not seen for longest, if there are too many and `pair` is new.
fn make_room(pairs: &mut BTreeMap<Pair, PairEvidence>, pair: Pair) {
    if pairs.len() < MAX_PAIRS || pairs.contains_key(&pair) {
        return;
    }
    let oldest = pairs.iter().min_by_key(|(_, evidence)| evidence.latest_frame);
    if let Some(oldest) = oldest.map(|(&pair, _)| pair) {
        pairs.remove(&oldest);
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
        for (i, &b) in compared.iter().enumerate() {
            compared[..i].iter().for_each(|&a| self.weigh(a, b));
        }
        let any = |place, is: fn(&Compared) -> bool| compared.iter().any(|c| c.place == place && is(c));
        self.identities.clear(|place| any(place, |c| c.is_strong), |place| any(place, |c| c.is_match));
        match self.identities.judge_visits() {
            Some(Change::Merge { from, into }) => self.merge(from, into),
            Some(Change::Split { place }) => self.split(place),
            None => Ok(()),
        }
    }

    fn compared(&self, candidates: &Candidates) -> FixedVec<Compared, { 2 * MAX_CANDIDATES }> {
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

    fn weigh(&mut self, a: Compared, b: Compared) {
        let pair = |a: PlaceId, b: PlaceId| (a.min(b), a.max(b));
        let is_together = a.is_strong && b.is_strong;
        if a.place != b.place {
            if is_together && self.were_founded_apart(a.learnt_as, b.learnt_as) {
                self.identities.suspect(pair(a.place, b.place));
            }
        } else if a.learnt_as != b.learnt_as {
            let halves = pair(a.learnt_as, b.learnt_as);
            if is_together {
                self.identities.doubt(halves, Verdict::Together);
            } else if a.is_strong && !b.is_match || b.is_strong && !a.is_match {
                self.identities.doubt(halves, Verdict::Apart);
            }
        }
    }

    /// Whether so much was learnt between the foundings of two places that the robot must have come back.
    fn were_founded_apart(&self, a: PlaceId, b: PlaceId) -> bool {
        let founded = |half: PlaceId| {
            let experiences = &self.map.place(half)?.experiences;
            let is_of_half = |id: &&_| self.map.experience(**id).is_some_and(|e| e.learnt_as == half);
            experiences.iter().find(is_of_half).copied()
        };
        founded(a).zip(founded(b)).is_some_and(|(a, b)| a.0.abs_diff(b.0) >= FOUNDING_GAP)
    }

    /// From now on `from` is `into`.
    fn merge(&mut self, from: PlaceId, into: PlaceId) -> Result<(), MapError> {
        [from, into].into_iter().for_each(|place| self.identities.forget(place));
        self.map.merge_places(from, into)?;
        self.working_set.remove(from);
        self.visits.rename(from, into);
        self.regroup(into)
    }

    /// From now on what was learnt as `place` is a place of its own again, if its merge is not final.
    fn split(&mut self, place: PlaceId) -> Result<(), MapError> {
        self.identities.doubted.retain(|&(a, b), _| a != place && b != place);
        if !self.map.can_be_split(place) {
            return Ok(());
        }
        self.map.split_place(place)?;
        self.regroup(place)
    }

    /// Tells the indices whose keyframes those of `place` are, and takes it in.
    fn regroup(&mut self, place: PlaceId) -> Result<(), MapError> {
        self.is_map_untold = true;
        for keyframe in self.keyframes_of(place) {
            self.keyframes.rename(keyframe, place);
            self.appearances.rename(keyframe, place);
            self.renewals.rename(keyframe, place);
        }
        self.stay_near(place)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: Pair = (PlaceId(0), PlaceId(1));

    /// A visit whose frames match both places, and one alone, so often; then the robot is elsewhere.
    fn visit(identities: &mut Identities, together: u32, apart: u32) -> Option<Change> {
        for index in 0..together + apart {
            identities.frames += 1;
            match index < together {
                true => identities.suspect(HERE),
                false => identities.clear(|place| place == HERE.0, |place| place == HERE.0),
            }
            assert_eq!(identities.judge_visits(), None, "the visit is not over");
        }
        identities.frames += VISIT_FRAMES + 1;
        identities.judge_visits()
    }

    fn visit_halves(identities: &mut Identities, verdict: Verdict) -> Option<Change> {
        identities.frames += 1;
        identities.doubt(HERE, verdict);
        identities.frames += VISIT_FRAMES + 1;
        identities.judge_visits()
    }

    #[test]
    fn a_place_and_the_next_one_share_a_few_frames_a_visit_and_are_never_merged() {
        let mut identities = Identities::default();
        for _ in 0..20 {
            assert_eq!(visit(&mut identities, 3, 2), None);
        }
    }

    #[test]
    fn one_place_is_seen_as_both_nearly_always_and_is_merged_at_the_end_of_the_third_visit() {
        let mut identities = Identities::default();
        assert_eq!(visit(&mut identities, 4, 2), None);
        assert_eq!(visit(&mut identities, 0, 5), None, "in a light in which one alone can be matched");
        assert_eq!(visit(&mut identities, 2, 0), None);
        let merge = Change::Merge { from: PlaceId(1), into: PlaceId(0) };
        assert_eq!(visit(&mut identities, 5, 1), Some(merge));
    }

    #[test]
    fn a_visit_that_lasts_is_one_visit() {
        let mut identities = Identities::default();
        for _ in 0..100 * VISIT_FRAMES {
            identities.frames += 1;
            identities.suspect(HERE);
            assert_eq!(identities.judge_visits(), None);
        }
    }

    #[test]
    fn merges_without_doubt_are_not_thought_about() {
        let mut identities = Identities::default();
        assert_eq!(visit_halves(&mut identities, Verdict::Together), None);
        assert_eq!(identities.doubted.len(), 0);
    }

    #[test]
    fn a_doubt_is_gone_when_as_many_visits_matched_both_as_one() {
        let mut identities = Identities::default();
        let mut open = Vec::new();
        for verdict in [Verdict::Apart, Verdict::Apart, Verdict::Together, Verdict::Together] {
            assert_eq!(visit_halves(&mut identities, verdict), None);
            open.push(identities.doubted.len());
        }
        assert_eq!(open, [1, 1, 1, 0]);
    }

    #[test]
    fn a_merge_is_undone_after_six_visits_that_matched_one_half_alone() {
        let mut identities = Identities::default();
        for _ in 0..5 {
            assert_eq!(visit_halves(&mut identities, Verdict::Apart), None);
        }
        let split = Change::Split { place: PlaceId(1) };
        assert_eq!(visit_halves(&mut identities, Verdict::Apart), Some(split));
    }

    #[test]
    fn no_more_pairs_are_kept_than_there_may_be() {
        let mut identities = Identities::default();
        for number in 0..2 * MAX_PAIRS as u32 {
            identities.frames += 1;
            identities.suspect((PlaceId(number), PlaceId(number + 1)));
        }
        assert_eq!(identities.suspected.len(), MAX_PAIRS);
        assert!(!identities.suspected.contains_key(&HERE));
    }
}
