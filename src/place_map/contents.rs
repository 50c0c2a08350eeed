//! What a map knows at a moment: its places, its experiences, and where each one's record is.
//!
//! Journal and snapshot lead here by the same few steps, whether a record was just written or is read back.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::format::PlaceRecord;
use super::{Experience, ExperienceId, Place, PlaceId};

/// Places that a place remembers as next to it.
pub const MAX_NEIGHBOURS: usize = 8;

/// Where a record is: a segment's number and the offset in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Location(u64);

const OFFSET_BITS: u32 = 40;
/// The largest number that a segment can have.
pub(super) const MAX_SEGMENT: u32 = (1 << (u64::BITS - OFFSET_BITS)) - 1;

impl Location {
    /// The record at `offset` bytes, less than 2^40, of a segment, at most [`MAX_SEGMENT`].
    pub(super) fn new(segment: u32, offset: u64) -> Self {
        Self(u64::from(segment) << OFFSET_BITS | offset & ((1 << OFFSET_BITS) - 1))
    }

    pub(super) fn from_bits(bits: u64) -> Self {
        Self(bits)
    }

    pub(super) fn to_bits(self) -> u64 {
        self.0
    }

    pub(super) fn segment(self) -> u32 {
        (self.0 >> OFFSET_BITS) as u32
    }

    pub(super) fn offset(self) -> u64 {
        self.0 & ((1 << OFFSET_BITS) - 1)
    }
}

/// The contents of a map.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Contents {
    /// Numbered without gaps once [settled](Self::settle).
    pub(super) places: BTreeMap<PlaceId, Place>,
    pub(super) experiences: BTreeMap<ExperienceId, Experience>,
    pub(super) next_experience: u32,
    /// Bytes of the records that count.
    pub(super) live_bytes: u64,
    /// Whether every place knows its experiences, and new ones are to be told.
    is_settled: bool,
}

impl Contents {
    /// A place's record at `location` that takes `bytes`; one of the same place before it does not count any more.
    pub(super) fn put_place(&mut self, record: PlaceRecord, location: Location, bytes: u64) {
        let id = PlaceId(record.place);
        let root_before = self.is_settled.then(|| self.resolve(id));
        let before = self.places.remove(&id);
        self.live_bytes += bytes;
        self.live_bytes -= before.as_ref().map_or(0, |place| u64::from(place.record_bytes));
        let place = Place {
            id,
            name: record.name.map(Arc::from),
            merged_into: record.merged_into.map(PlaceId),
            neighbours: record.neighbours.into_iter().map(PlaceId).collect(),
            experiences: before.map_or_else(Vec::new, |place| place.experiences),
            location,
            record_bytes: bytes as u32,
        };
        self.places.insert(id, place);
        if let Some(root_before) = root_before {
            self.move_experiences(root_before, self.resolve(id));
        }
    }

    /// An experience's record; one of the same experience before it does not count any more.
    pub(super) fn put_experience(&mut self, experience: Experience) {
        let (id, learnt_as) = (experience.id, experience.learnt_as);
        self.next_experience = self.next_experience.max(id.0.saturating_add(1));
        self.live_bytes += u64::from(experience.record_bytes);
        let before = self.experiences.insert(id, experience);
        self.live_bytes -= before.map_or(0, |before| u64::from(before.record_bytes));
        if !self.is_settled || before.is_some_and(|before| before.learnt_as == learnt_as) {
            return;
        }
        if let Some(before) = before {
            self.leave(before.learnt_as, id);
        }
        let place = self.resolve(learnt_as);
        if let Some(Place { experiences, .. }) = self.places.get_mut(&place) {
            let position = experiences.partition_point(|&other| other < id);
            experiences.insert(position, id);
        }
    }

    /// Gives an experience up; one that is not there already is.
    pub(super) fn remove_experience(&mut self, id: ExperienceId) {
        let Some(experience) = self.experiences.remove(&id) else { return };
        self.live_bytes -= u64::from(experience.record_bytes);
        if self.is_settled {
            self.leave(experience.learnt_as, id);
        }
    }

    /// Takes an experience that was learnt as `learnt_as` from the place that this is by now.
    fn leave(&mut self, learnt_as: PlaceId, id: ExperienceId) {
        let place = self.resolve(learnt_as);
        if let Some(place) = self.places.get_mut(&place) {
            place.experiences.retain(|&other| other != id);
        }
    }

    /// Puts together what was read in any order: an old place's record may have been written again behind those of
    /// its experiences.
    ///
    /// # Errors
    /// If a place is missing that something speaks of, or places were merged in a circle.
    pub(super) fn settle(&mut self) -> Result<(), String> {
        let missing = (0..).map(PlaceId).zip(self.places.keys()).find(|(expected, id)| expected != *id);
        let unknown = self.spoken_of().find(|&id| !self.places.contains_key(id)).copied();
        if let Some(place) = missing.map(|(expected, _)| expected).or(unknown) {
            return Err(format!("place {} is missing", place.0));
        }
        let roots = self.roots()?;
        self.group(&roots);
        self.is_settled = true;
        Ok(())
    }

    /// Places that other places or experiences name.
    fn spoken_of(&self) -> impl Iterator<Item = &PlaceId> {
        let named = self.places.values().flat_map(|place| place.merged_into.iter().chain(&place.neighbours));
        named.chain(self.experiences.values().map(|experience| &experience.learnt_as))
    }

    /// Gives up the experiences whose records are not where they were, and answers their numbers.
    pub(super) fn lose_experiences(&mut self, is_there: impl Fn(Location) -> bool) -> Vec<ExperienceId> {
        let lost = self.experiences.values().filter(|experience| !is_there(experience.location));
        let lost: Vec<ExperienceId> = lost.map(|experience| experience.id).collect();
        lost.iter().for_each(|&id| self.remove_experience(id));
        lost
    }

    /// Keeps the places whose records are not where they were, as if they stood at `somewhere` and took nothing.
    pub(super) fn move_places(&mut self, is_there: impl Fn(Location) -> bool, somewhere: Location) {
        for place in self.places.values_mut().filter(|place| !is_there(place.location)) {
            self.live_bytes -= u64::from(place.record_bytes);
            (place.location, place.record_bytes) = (somewhere, 0);
        }
    }

    /// Puts a place without a name, as if its record stood at `somewhere` and took nothing, where a record is lost that
    /// others need, and answers their numbers; unless more than `most` are lost, and more than are left.
    pub(super) fn replace_lost_places(&mut self, most: usize, somewhere: Location) -> Vec<PlaceId> {
        let Some(&last) = self.places.keys().chain(self.spoken_of()).max() else { return Vec::new() };
        let lost = u64::from(last.0) + 1 - self.places.len() as u64;
        if lost > most.max(self.places.len()) as u64 {
            return Vec::new();
        }
        let places = (0..=last.0).map(PlaceId);
        let lost: Vec<PlaceId> = places.filter(|place| !self.places.contains_key(place)).collect();
        for place in &lost {
            let record =
                PlaceRecord { place: place.0, name: None, merged_into: None, neighbours: Vec::new() };
            self.put_place(record, somewhere, 0);
        }
        lost
    }

    /// Takes back a merge of every circle, as if the places' records stood at `somewhere` and took nothing, and answers
    /// of which places.
    pub(super) fn break_circles(&mut self, somewhere: Location) -> Vec<PlaceId> {
        let mut looked_at = BTreeSet::new();
        let mut closing = Vec::new();
        for &place in self.places.keys() {
            let mut way = BTreeSet::new();
            let mut here = Some(place);
            while let Some(at) = here.filter(|at| !looked_at.contains(at)) {
                if !way.insert(at) {
                    closing.push(at);
                    break;
                }
                here = self.places.get(&at).and_then(|place| place.merged_into);
            }
            looked_at.extend(way);
        }
        for id in &closing {
            let Some(place) = self.places.get_mut(id) else { continue };
            self.live_bytes -= u64::from(place.record_bytes);
            (place.merged_into, place.location, place.record_bytes) = (None, somewhere, 0);
        }
        closing
    }

    /// What every place is by now, each step of every chain of merges walked once.
    fn roots(&self) -> Result<BTreeMap<PlaceId, PlaceId>, String> {
        let mut roots = BTreeMap::new();
        for &place in self.places.keys() {
            let mut chain = Vec::new();
            let mut here = place;
            let root = loop {
                match (roots.get(&here), self.places.get(&here).and_then(|place| place.merged_into)) {
                    (Some(&root), _) => break root,
                    (None, None) => break here,
                    (None, Some(_)) if chain.len() > self.places.len() => {
                        return Err(format!("place {} was merged into itself", place.0));
                    }
                    (None, Some(next)) => {
                        chain.push(here);
                        here = next;
                    }
                }
            };
            roots.insert(here, root);
            roots.extend(chain.into_iter().map(|link| (link, root)));
        }
        Ok(roots)
    }

    /// Whether `part` is `place`, or was merged into it, perhaps by way of others.
    pub(super) fn is_part(&self, part: PlaceId, place: PlaceId) -> bool {
        let next = |part: &PlaceId| self.places.get(part).and_then(|part| part.merged_into);
        std::iter::successors(Some(part), next).any(|part| part == place)
    }

    /// The place that `place` is by now.
    pub(super) fn resolve(&self, place: PlaceId) -> PlaceId {
        let mut here = place;
        while let Some(next) = self.places.get(&here).and_then(|place| place.merged_into) {
            here = next;
        }
        here
    }

    /// Puts every experience to the place that the one it was learnt as is by now.
    fn group(&mut self, roots: &BTreeMap<PlaceId, PlaceId>) {
        self.places.values_mut().for_each(|place| place.experiences.clear());
        for experience in self.experiences.values() {
            let place = roots.get(&experience.learnt_as).and_then(|root| self.places.get_mut(root));
            place.into_iter().for_each(|place| place.experiences.push(experience.id));
        }
    }

    /// Moves the experiences of `from` that are of `into` by now; a merge or its undoing touches no other place.
    fn move_experiences(&mut self, from: PlaceId, into: PlaceId) {
        if from == into {
            return;
        }
        let Some(place) = self.places.get_mut(&from) else { return };
        let experiences = std::mem::take(&mut place.experiences);
        let learnt_as = |id: &ExperienceId| self.experiences.get(id).map(|experience| experience.learnt_as);
        let stays = |id: &ExperienceId| learnt_as(id).is_some_and(|place| self.resolve(place) == from);
        let (staying, moving): (Vec<_>, Vec<_>) = experiences.into_iter().partition(stays);
        if let Some(place) = self.places.get_mut(&from) {
            place.experiences = staying;
        }
        if let Some(place) = self.places.get_mut(&into) {
            place.experiences.extend(moving);
            // The stable sort takes two runs in order as they are and merges them in one pass.
            place.experiences.sort();
        }
    }

    /// Everything whose record is in `segment`, in the order of their offsets.
    pub(super) fn facts_in(&self, segment: u32) -> Vec<Fact> {
        let places = self.places.values().map(|place| (place.location, Fact::Place(place.id)));
        let experiences = self.experiences.values().map(|e| (e.location, Fact::Experience(e.id)));
        let mut facts: Vec<(Location, Fact)> =
            places.chain(experiences).filter(|(location, _)| location.segment() == segment).collect();
        facts.sort_unstable_by_key(|&(location, _)| location);
        facts.into_iter().map(|(_, fact)| fact).collect()
    }

    /// Where everything is.
    pub(super) fn locations(&self) -> impl Iterator<Item = Location> {
        let places = self.places.values().map(|place| place.location);
        places.chain(self.experiences.values().map(|experience| experience.location))
    }
}

/// What a record may be about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fact {
    Place(PlaceId),
    Experience(ExperienceId),
}

impl Contents {
    /// What a snapshot says otherwise than these contents of its journal.
    pub(super) fn difference(&self, snapshot: &Self) -> Option<String> {
        let mut experiences = self.experiences.keys().chain(snapshot.experiences.keys());
        let is_same = |id| match (self.experiences.get(id), snapshot.experiences.get(id)) {
            (Some(one), Some(other)) => is_equal(one, other),
            _ => false,
        };
        if let Some(experience) = experiences.find(|id| !is_same(id)) {
            return Some(format!("it says otherwise of experience {} than the journal", experience.0));
        }
        let mut places = self.places.keys().chain(snapshot.places.keys());
        if let Some(place) = places.find(|id| self.places.get(id) != snapshot.places.get(id)) {
            return Some(format!("it says otherwise of place {} than the journal", place.0));
        }
        (snapshot.next_experience < self.next_experience)
            .then(|| "it counts fewer experiences than the journal".to_owned())
    }
}

/// Whether two experiences are equal to the bit: a stored number may be NaN.
fn is_equal(one: &Experience, other: &Experience) -> bool {
    let light = |experience: &Experience| experience.mean_luminance.map(f32::to_bits);
    let rest = |experience: &Experience| Experience { mean_luminance: None, ..*experience };
    light(one) == light(other) && rest(one) == rest(other)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PLACES: u32 = 8;

    fn place(place: u32, merged_into: Option<PlaceId>) -> PlaceRecord {
        let merged_into = merged_into.map(|place| place.0);
        PlaceRecord { place, name: None, merged_into, neighbours: Vec::new() }
    }

    fn experience(id: u32, learnt_as: u32) -> Experience {
        Experience {
            id: ExperienceId(id),
            learnt_as: PlaceId(learnt_as),
            view: 0,
            mean_luminance: None,
            is_keyframe: true,
            location: Location::new(1, 0),
            record_bytes: 1,
        }
    }

    /// The contents as they are once every experience is looked at anew.
    fn grouped_anew(contents: &Contents) -> Contents {
        let mut anew = Contents { is_settled: false, ..contents.clone() };
        anew.settle().unwrap();
        anew
    }

    proptest! {
        #[test]
        fn merges_and_splits_leave_every_experience_where_grouping_all_anew_would_put_it(
            changes in proptest::collection::vec((0..5_u8, 0..PLACES, 0..PLACES), 1..60),
        ) {
            let mut contents = Contents::default();
            (0..PLACES).for_each(|id| contents.put_place(place(id, None), Location::new(1, 0), 1));
            contents.settle().unwrap();
            for (next, (kind, one, other)) in (0..).zip(changes) {
                let (root, into) = (contents.resolve(PlaceId(one)), contents.resolve(PlaceId(other)));
                match kind {
                    0 if root != into => contents.put_place(place(root.0, Some(into)), Location::new(1, 0), 1),
                    1 => contents.put_place(place(one, None), Location::new(1, 0), 1),
                    2 => contents.remove_experience(ExperienceId(next / 2)),
                    3 if next % 2 == 0 => contents.put_experience(experience(next / 2, one)),
                    _ => contents.put_experience(experience(next, one)),
                }
                prop_assert_eq!(&contents, &grouped_anew(&contents));
            }
        }
    }
}
