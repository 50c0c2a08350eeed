//! The places as the CNN knows them: one descriptor a keyframe, compared one by one.

use std::collections::HashMap;

use heapless::Vec as FixedVec;

use super::candidate::{Candidate, Evidence, MAX_CANDIDATES};
use crate::cnn::{self, CompactDescriptor};
use crate::place_map::{ExperienceId, PlaceId};

/// What the allocator and those who count who shares it take of every descriptor.
pub(super) const ALLOCATION_BYTES: usize = 32;
/// Keyframes of which it is kept at most how like a frame they are.
const MOST_SIMILARITIES: usize = 1 << 16;
/// Memory of a position, with what tables keep in reserve.
const POSITION_BYTES: usize = 16;

struct Entry {
    place: PlaceId,
    keyframe: ExperienceId,
    descriptor: CompactDescriptor,
}

/// CNN descriptors of all keyframes.
#[derive(Default)]
pub(super) struct AppearanceIndex {
    entries: Vec<Entry>,
    /// Where each keyframe is among them.
    positions: HashMap<ExperienceId, u32>,
    /// What was asked for last; its memory serves the next one.
    asked: Option<CompactDescriptor>,
    /// How like it each keyframe is, where somebody looks on.
    similarities: Option<Vec<(ExperienceId, f32)>>,
}

impl AppearanceIndex {
    pub(super) fn add(&mut self, place: PlaceId, keyframe: ExperienceId, descriptor: CompactDescriptor) {
        self.remove(keyframe);
        self.positions.insert(keyframe, self.entries.len() as u32);
        self.entries.push(Entry { place, keyframe, descriptor });
    }

    /// Forgets a keyframe, if it has one of that number.
    pub(super) fn remove(&mut self, keyframe: ExperienceId) {
        let Some(position) = self.positions.remove(&keyframe) else { return };
        self.entries.swap_remove(position as usize);
        if let Some(moved) = self.entries.get(position as usize) {
            self.positions.insert(moved.keyframe, position);
        }
    }

    pub(super) fn contains(&self, keyframe: ExperienceId) -> bool {
        self.positions.contains_key(&keyframe)
    }

    /// From now on the keyframe is one of `place`.
    pub(super) fn rename(&mut self, keyframe: ExperienceId, place: PlaceId) {
        if let Some(&position) = self.positions.get(&keyframe) {
            self.entries[position as usize].place = place;
        }
    }

    /// Number of keyframes.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    /// Bytes of memory that it takes, roughly.
    pub(super) fn memory_bytes(&self) -> usize {
        // All come from one model and have as many values.
        let values =
            self.entries.first().map_or(0, |entry| entry.descriptor.values().len() + ALLOCATION_BYTES);
        self.entries.len() * (values + size_of::<Entry>() + POSITION_BYTES)
    }

    /// The place that `keyframe` is more like than any other keyframe of its own, if there is one among those that are
    /// `elsewhere`.
    pub(super) fn astray(
        &self,
        keyframe: ExperienceId,
        is_elsewhere: impl Fn(PlaceId) -> bool,
    ) -> Option<PlaceId> {
        let asked = &self.entries[*self.positions.get(&keyframe)? as usize];
        let (mut own, mut best) = (f32::MIN, None);
        for entry in self.entries.iter().filter(|entry| entry.keyframe != keyframe) {
            let score = asked.descriptor.cosine(&entry.descriptor);
            if entry.place == asked.place {
                own = own.max(score);
            } else if best.is_none_or(|(_, most)| score > most) && is_elsewhere(entry.place) {
                best = Some((entry.place, score));
            }
        }
        best.filter(|(_, score)| *score > own).map(|(place, _)| place)
    }

    /// From now on it is kept how like every keyframe is what is asked for.
    pub(super) fn keep_similarities(&mut self) {
        self.similarities.get_or_insert_default();
    }

    /// Whether that is kept.
    pub(super) fn keeps_similarities(&self) -> bool {
        self.similarities.is_some()
    }

    /// How like every keyframe is what was asked for last, to be taken away; empty where that is not kept.
    pub(super) fn similarities(&mut self) -> Option<&mut Vec<(ExperienceId, f32)>> {
        self.similarities.as_mut()
    }

    /// The best keyframe of each of the places that are most like `descriptor`, best first.
    pub(super) fn query(&mut self, descriptor: &cnn::Descriptor) -> FixedVec<Candidate, MAX_CANDIDATES> {
        let asked = match &mut self.asked {
            Some(asked) => {
                asked.set(descriptor);
                asked
            }
            none => none.insert(descriptor.into()),
        };
        let mut best: FixedVec<Candidate, MAX_CANDIDATES> = FixedVec::new();
        let mut similarities = self.similarities.as_mut().filter(|_| self.entries.len() <= MOST_SIMILARITIES);
        similarities.iter_mut().for_each(|similarities| similarities.clear());
        for entry in &self.entries {
            let score = asked.cosine(&entry.descriptor);
            if let Some(similarities) = &mut similarities {
                similarities.push((entry.keyframe, score));
            }
            if let Some(known) = best.iter().position(|candidate| candidate.place == entry.place) {
                if best[known].score >= score {
                    continue;
                }
                best.remove(known);
            }
            let position = best.partition_point(|candidate| candidate.score >= score);
            if best.is_full() && position < best.len() {
                best.pop();
            }
            // Refused only when full of better ones.
            let _ = best.insert(position, entry.candidate(score));
        }
        best
    }
}

impl Entry {
    fn candidate(&self, score: f32) -> Candidate {
        Candidate {
            place: self.place,
            keyframe: self.keyframe,
            by: Evidence::Cnn,
            score,
            votes: None,
            inliers: None,
            probability: 0.0,
            rejected: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unit(angle: f32) -> cnn::Descriptor {
        cnn::Descriptor::from_values(vec![angle.cos(), angle.sin()]).unwrap()
    }

    proptest! {
        #[test]
        fn the_best_keyframe_of_every_leading_place_is_found(
            entries in proptest::collection::vec((0..12_u32, 0.0..3.1_f32), 0..60),
        ) {
            let mut index = AppearanceIndex::default();
            for (keyframe, &(place, angle)) in (0..).zip(&entries) {
                let descriptor = (&unit(angle)).into();
                index.add(PlaceId(place), ExperienceId(keyframe), descriptor);
            }
            let mut expected: Vec<(f32, u32)> = (0..12).filter_map(|place| {
                let angles = entries.iter().filter(|entry| entry.0 == place).map(|entry| entry.1);
                angles.reduce(f32::min).map(|angle| (angle, place))
            }).collect();
            expected.sort_by(|a, b| a.0.total_cmp(&b.0));
            expected.truncate(MAX_CANDIDATES);
            let found = index.query(&unit(0.0));
            prop_assert_eq!(found.len(), expected.len());
            for (found, (angle, _)) in found.iter().zip(expected) {
                prop_assert!((found.score - angle.cos()).abs() < 0.01);
            }
        }

        #[test]
        fn what_was_added_last_and_not_removed_since_is_found_under_its_latest_place(
            changes in proptest::collection::vec((0..3_u8, 0..8_u32, 0..12_u32), 0..60),
        ) {
            let mut index = AppearanceIndex::default();
            let mut expected = std::collections::BTreeMap::new();
            for (kind, keyframe, place) in changes {
                match kind {
                    0 => {
                        index.add(PlaceId(place), ExperienceId(keyframe), (&unit(0.0)).into());
                        expected.insert(keyframe, place);
                    }
                    1 => {
                        index.remove(ExperienceId(keyframe));
                        expected.remove(&keyframe);
                    }
                    _ => {
                        index.rename(ExperienceId(keyframe), PlaceId(place));
                        expected.entry(keyframe).and_modify(|known| *known = place);
                    }
                }
                let mut held: Vec<(u32, u32)> =
                    index.entries.iter().map(|entry| (entry.keyframe.0, entry.place.0)).collect();
                held.sort_unstable();
                prop_assert_eq!(held, expected.clone().into_iter().collect::<Vec<_>>());
            }
        }
    }
}
