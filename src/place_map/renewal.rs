//! CNN descriptors of keyframes that are in the map already, computed anew: another model was deployed, or the CNN was
//! not there when they were learnt.
//!
//! An experience's record points back to its features and its thumbnail, so all of it is written again, as upkeep does;
//! the last record counts.

use super::batch::Batch;
use super::format::{self, FeaturesRecord, KeyframeRecord};
use super::map::PlaceMap;
use super::{Appearance, ExperienceId, MapError};

/// What a record may grow by at most, besides its descriptor's values: the model's name.
const MODEL_BYTES: u64 = 128;

impl PlaceMap {
    /// Gives keyframes other CNN descriptors, and answers which keyframes were given up to make room. Of what is not
    /// there any more or is damaged, nothing is written: whoever reads it says so.
    ///
    /// It is on the medium with the next sync, whatever the durability: what a power cut costs is computed again.
    ///
    /// # Errors
    /// If the map is full or read-only, or the medium fails. After a failure of the medium every further change fails.
    pub fn renew_appearances(
        &mut self,
        renewed: &[(ExperienceId, Appearance)],
    ) -> Result<Vec<ExperienceId>, MapError> {
        if !self.is_writable {
            return Err(MapError::ReadOnly);
        }
        let record_bytes = |id| self.experience(id).map_or(0, |e| u64::from(e.record_bytes));
        let grown_bytes = |appearance: &Appearance| appearance.descriptor.values().len() as u64 + MODEL_BYTES;
        let bytes = renewed.iter().map(|(id, appearance)| record_bytes(*id) + grown_bytes(appearance)).sum();
        // First: what is given up for it must not come back.
        let given_up = self.make_room(bytes)?;
        let mut batch = Batch::default();
        for (id, appearance) in renewed {
            self.add_renewed(*id, appearance, &mut batch)?;
        }
        if !batch.0.is_empty() {
            self.guarded(|map| {
                map.append(&batch)?;
                if map.journal.end().offset >= map.segment_bytes() {
                    map.rotate()?;
                }
                Ok(())
            })?;
        }
        Ok(given_up)
    }

    fn add_renewed(
        &self,
        id: ExperienceId,
        appearance: &Appearance,
        batch: &mut Batch,
    ) -> Result<(), MapError> {
        if !self.is_keyframe(id) {
            return Ok(());
        }
        let (journal, location) = (&self.journal, self.location(id)?);
        let read = journal
            .experience(location)
            .and_then(|record| Ok((record, journal.features(location)?, journal.thumbnail(location)?)));
        let (mut record, features, thumbnail_jpeg) = match read {
            Err(damage) if damage.is_damage() => return Ok(()),
            read => read?,
        };
        if let Some(keyframe) = &mut record.keyframe {
            keyframe.appearance = KeyframeRecord::new(0, &[], Some(appearance)).appearance;
        }
        // A record of version 1 does not know its number.
        record.experience = id.0;
        let features = format::encode(&FeaturesRecord::from(&features));
        batch.add_parts(
            record,
            Some(features.map_err(|reason| MapError::Unstorable { reason })?),
            thumbnail_jpeg,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cnn::CompactDescriptor;
    use crate::place_map::tests::{SMALL, found, knowledge, learn, reopened};
    use crate::place_map::{MapOptions, PlaceId};

    fn appearance(value: i8) -> Appearance {
        let descriptor = CompactDescriptor::from_values(vec![127, value, 5]).unwrap();
        Appearance { model: "new".to_owned(), descriptor }
    }

    #[test]
    fn a_renewed_descriptor_is_found_after_a_restart_and_nothing_else_has_changed() {
        let folder = tempfile::tempdir().unwrap();
        let mut map = reopened(folder.path());
        for index in 0..4 {
            found(&mut map, index);
        }
        learn(&mut map, Some(PlaceId(1)), 9, false).unwrap();
        let (before, second) = (knowledge(&map), map.traits(ExperienceId(1)).unwrap());
        let renewed = [(ExperienceId(1), appearance(3)), (ExperienceId(4), appearance(4))];
        assert_eq!(map.renew_appearances(&renewed).unwrap(), []);
        let was = format!("{:?}", second.appearance.unwrap());
        let expected: Vec<String> = (0..)
            .zip(&before)
            .map(|(line, fact)| match line {
                // Places come first.
                5 => fact.replace(&was, &format!("{:?}", appearance(3))),
                _ => fact.clone(),
            })
            .collect();
        assert_ne!(expected, before);
        assert_eq!(knowledge(&map), expected);
        drop(map);
        assert_eq!(knowledge(&reopened(folder.path())), expected);
    }

    #[test]
    fn a_map_whose_keyframes_are_renewed_again_and_again_stays_within_its_budget_and_whole() {
        let mut map = PlaceMap::in_memory(MapOptions { disk_bytes: 1 << 20, ..SMALL }).unwrap();
        for index in 0..150 {
            learn(&mut map, Some(PlaceId(index as u32 % 20)).filter(|_| index >= 20), index, true).unwrap();
        }
        let mut given_up = Vec::new();
        for round in 0..20 {
            let keyframes: Vec<ExperienceId> = map.experiences().map(|experience| experience.id).collect();
            for pair in keyframes.chunks(2) {
                let renewed: Vec<_> = pair.iter().map(|&id| (id, appearance(round))).collect();
                given_up.extend(map.renew_appearances(&renewed).unwrap());
                assert!(map.summary().journal_bytes <= 1 << 20);
            }
        }
        assert!(map.places().all(|place| !place.experiences.is_empty()));
        for experience in map.experiences() {
            assert!(!given_up.contains(&experience.id), "what was given up came back");
            assert_eq!(map.traits(experience.id).unwrap().appearance, Some(appearance(19)));
            assert!(
                map.features(experience.id).is_ok() && !map.thumbnail_jpeg(experience.id).unwrap().is_empty()
            );
        }
    }

    #[test]
    fn a_map_that_is_only_read_keeps_its_descriptors() {
        let folder = tempfile::tempdir().unwrap();
        found(&mut reopened(folder.path()), 0);
        let mut map = PlaceMap::open_read_only(folder.path()).unwrap();
        let refused = map.renew_appearances(&[(ExperienceId(0), appearance(1))]);
        assert!(matches!(refused, Err(MapError::ReadOnly)));
    }
}
