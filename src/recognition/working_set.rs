//! The working set: the places whose keyframes are searched, so many as memory has room for.
//!
//! The others wait on the disk. They come back when the robot approaches them: a place that is seen brings the
//! places next to it along (Labbé & Michaud, *Appearance-based loop closure detection for online large-scale and
//! long-term operation*, 2013). Those that were not seen for longest make room. A robot that recognises nothing may
//! have been carried to where everything waits, so it looks through what waits, a few places with every frame.

use std::collections::{BTreeSet, HashMap};
use std::mem;

use super::keyframe_index::KeyframeIndex;
use super::recogniser::Recogniser;
use crate::place_map::{ExperienceId, MapError, PlaceId, Unreadable};

/// Steps along the way within which a place that waits is fetched.
const FETCHED_STEPS: usize = 3;
/// Places that are fetched for one frame at most.
const FETCHED_AT_ONCE: usize = 8;
/// Share of the memory that is in use after room was made, so that this happens now and then and not every frame.
const ROOM_MADE: f64 = 0.9;
/// Share of the memory that the keyframes may have even where places and experiences alone take more than the rest.
const LEAST_SHARE: f64 = 0.25;

/// The places of the working set, and when each was last seen.
pub(super) struct WorkingSet {
    latest_turn: u64,
    turns: HashMap<PlaceId, u64>,
    /// Places that memory has no room for.
    waiting: BTreeSet<PlaceId>,
    /// Where to look next when the robot is lost.
    next_searched: PlaceId,
    /// Keyframes that could not be read: they are not asked again.
    unreadable: BTreeSet<ExperienceId>,
    /// Those of them that are damaged and of which nobody heard yet.
    unheard: Option<Unreadable>,
    /// The places near the one that was seen last; the memory serves the next one.
    near: Vec<PlaceId>,
}

impl Default for WorkingSet {
    fn default() -> Self {
        Self {
            latest_turn: 0,
            turns: HashMap::new(),
            waiting: BTreeSet::new(),
            next_searched: PlaceId(0),
            unreadable: BTreeSet::new(),
            unheard: None,
            near: Vec::new(),
        }
    }
}

impl WorkingSet {
    pub(super) fn contains(&self, place: PlaceId) -> bool {
        self.turns.contains_key(&place)
    }

    /// Number of places.
    pub(super) fn len(&self) -> usize {
        self.turns.len()
    }

    pub(super) fn is_left_out(&self, keyframe: ExperienceId) -> bool {
        self.unreadable.contains(&keyframe)
    }

    /// The damaged keyframes that were left out since this was last asked.
    pub(super) fn take_unreadable(&mut self) -> Option<Unreadable> {
        self.unheard.take()
    }

    /// Puts `place` last in the order, as if it had just been seen.
    fn touch(&mut self, place: PlaceId) {
        self.latest_turn += 1;
        self.turns.insert(place, self.latest_turn);
        self.waiting.remove(&place);
    }

    /// The place is no more: it was merged into another one.
    pub(super) fn remove(&mut self, place: PlaceId) {
        self.waiting.remove(&place);
        self.turns.remove(&place);
    }

    /// The places but for the one that was seen last, those first that were not seen for longest. They are put in order
    /// only now, for room is made seldom and places are seen with every frame.
    fn oldest_first(&self) -> Vec<PlaceId> {
        let mut by_turn: Vec<(u64, PlaceId)> =
            self.turns.iter().map(|(&place, &turn)| (turn, place)).collect();
        by_turn.sort_unstable();
        by_turn.pop();
        by_turn.into_iter().map(|(_, place)| place).collect()
    }

    /// Takes out a place: it waits from now on.
    fn put_away(&mut self, place: PlaceId) {
        self.turns.remove(&place);
        self.waiting.insert(place);
    }

    /// The next few of the places that wait, going round.
    fn next_waiting(&mut self, count: usize) -> Vec<PlaceId> {
        let (before, after) =
            (self.waiting.range(..self.next_searched), self.waiting.range(self.next_searched..));
        let next: Vec<PlaceId> = after.chain(before).take(count).copied().collect();
        if let Some(last) = next.last() {
            self.next_searched = PlaceId(last.0.saturating_add(1));
        }
        next
    }
}

impl Recogniser {
    /// Number of places whose keyframes are searched.
    #[must_use]
    pub fn working_places(&self) -> usize {
        self.working_set.len()
    }

    /// Takes in the places that were seen last, as many as memory has room for.
    pub(super) fn fill_working_set(&mut self) -> Result<(), MapError> {
        let living = self.map.living_places();
        let mut places: Vec<(Option<ExperienceId>, PlaceId)> =
            living.map(|place| (place.experiences.last().copied(), place.id)).collect();
        places.sort_unstable();
        let mut bytes = 0;
        let has_room = |&&(_, place): &&(Option<ExperienceId>, PlaceId)| {
            bytes += self.keyframes_of(place).len() * self.keyframe_bytes();
            bytes <= self.budget_bytes()
        };
        let room = places.iter().rev().take_while(has_room).count().max(1).min(places.len());
        let (left, taken) = places.split_at(places.len() - room);
        self.working_set.waiting.extend(left.iter().map(|&(_, place)| place));
        // In the order in which they were learnt: so words grow as they did then.
        let mut keyframes: Vec<ExperienceId> =
            taken.iter().flat_map(|&(_, place)| self.keyframes_of(place)).collect();
        keyframes.sort_unstable();
        self.restore_index(|keyframe| keyframes.binary_search(&keyframe).is_ok());
        keyframes.into_iter().try_for_each(|keyframe| self.index_if_sound(keyframe))?;
        taken.iter().for_each(|&(_, place)| self.working_set.touch(place));
        // CNN descriptors were not reckoned with.
        self.make_room();
        Ok(())
    }

    /// Bytes of memory of a keyframe that has as many features as it may.
    fn keyframe_bytes(&self) -> usize {
        let conditions = self.vocabularies().conditions().count();
        KeyframeIndex::keyframe_bytes(conditions * self.options.keyframe_features)
    }

    /// The robot is at `place`: fetches what is near, and makes room by putting away what was not seen for longest.
    pub(super) fn stay_near(&mut self, place: PlaceId) -> Result<(), MapError> {
        // Taken, so that the recogniser can be asked meanwhile.
        let mut near = mem::take(&mut self.working_set.near);
        self.find_near(place, &mut near);
        let waiting: Vec<PlaceId> =
            near.iter().copied().filter(|&place| !self.working_set.contains(place)).collect();
        let (fetched, left) = waiting.split_at(waiting.len().min(FETCHED_AT_ONCE));
        let fetched = fetched.iter().try_for_each(|&place| self.take_in(place));
        if fetched.is_ok() {
            // The nearest comes last in turn, so that it is put away last.
            let seen = near.iter().rev().filter(|place| !left.contains(place));
            seen.for_each(|&place| self.working_set.touch(place));
            self.make_room();
        }
        self.working_set.near = near;
        fetched
    }

    /// The robot recognises nothing: fetches the next few of the places that wait.
    pub(super) fn look_around(&mut self) -> Result<(), MapError> {
        for place in self.working_set.next_waiting(FETCHED_AT_ONCE) {
            self.take_in(place)?;
            self.working_set.touch(place);
        }
        self.make_room();
        Ok(())
    }

    /// Writes over what is in `near` `place` and those within a few steps of it along the way, nearest first.
    fn find_near(&self, place: PlaceId, near: &mut Vec<PlaceId>) {
        near.clear();
        near.extend(self.map.place(place).map(|place| place.id));
        let mut from = 0;
        for _ in 0..FETCHED_STEPS {
            let to = near.len();
            for index in from..to {
                let neighbours = self.map.place(near[index]).map_or(&[][..], |place| &place.neighbours);
                let resolved = neighbours.iter().filter_map(|&id| self.map.place(id)).map(|place| place.id);
                for neighbour in resolved {
                    if !near.contains(&neighbour) {
                        near.push(neighbour);
                    }
                }
            }
            from = to;
        }
    }

    fn make_room(&mut self) {
        let budget_bytes = self.budget_bytes();
        if self.index_bytes() <= budget_bytes {
            return;
        }
        let enough_bytes = (ROOM_MADE * budget_bytes as f64) as usize;
        for place in self.working_set.oldest_first() {
            if self.index_bytes() <= enough_bytes {
                break;
            }
            self.working_set.put_away(place);
            self.keyframes_of(place).into_iter().for_each(|keyframe| self.forget(keyframe));
        }
        self.keyframes.sweep();
    }

    /// Makes the keyframes of `place` findable that are not.
    fn take_in(&mut self, place: PlaceId) -> Result<(), MapError> {
        let mut waiting = self.keyframes_of(place);
        waiting.retain(|&keyframe| !self.keyframes.contains(keyframe));
        waiting.retain(|&keyframe| !self.working_set.is_left_out(keyframe));
        waiting.into_iter().try_for_each(|keyframe| self.index_if_sound(keyframe))
    }

    /// Makes a keyframe findable, unless its record is damaged.
    fn index_if_sound(&mut self, keyframe: ExperienceId) -> Result<(), MapError> {
        match self.index(keyframe) {
            Err(damage) if damage.is_damage() => {
                self.keyframes.remove(keyframe);
                self.leave_out(keyframe, damage);
                Ok(())
            }
            indexed => indexed,
        }
    }

    /// From now on `keyframe`, which could not be read, is not taken in any more. Of those that are damaged is only
    /// said how many they are.
    pub(super) fn leave_out(&mut self, keyframe: ExperienceId, failure: MapError) {
        let WorkingSet { unreadable, unheard, .. } = &mut self.working_set;
        let is_news = unreadable.insert(keyframe);
        match failure {
            MapError::Storage(damage) if damage.is_damage() => {
                if is_news {
                    Unreadable::note(unheard, damage);
                }
            }
            failure => drop(self.map_failure.get_or_insert(failure)),
        }
    }

    pub(super) fn keyframes_of(&self, place: PlaceId) -> Vec<ExperienceId> {
        let experiences = self.map.place(place).into_iter().flat_map(|place| &place.experiences);
        let is_keyframe = |id: &ExperienceId| self.map.experience(*id).is_some_and(|e| e.is_keyframe);
        experiences.copied().filter(is_keyframe).collect()
    }

    /// Bytes of memory that what is searched takes.
    #[must_use]
    pub fn index_bytes(&self) -> usize {
        self.keyframes.memory_bytes() + self.appearances.memory_bytes() + self.renewals.memory_bytes()
    }

    /// What it may take: what places and experiences leave of the budget.
    pub(super) fn budget_bytes(&self) -> usize {
        let budget_bytes = self.options.memory_bytes;
        let least = (budget_bytes as f64 * LEAST_SHARE) as usize;
        budget_bytes.saturating_sub(self.map.memory_bytes()).max(least)
    }
}
