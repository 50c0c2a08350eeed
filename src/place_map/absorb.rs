//! One map takes in another one: its places and experiences come behind its own, under new numbers.

use super::batch::Batch;
use super::format::{self, FeaturesRecord, PLACE, PlaceRecord};
use super::map::PlaceMap;
use super::{Experience, MapError, Place, PlaceId};

impl PlaceMap {
    /// Adds the places and experiences of `other`; its place `n` becomes the place that is answered, plus `n`.
    ///
    /// # Errors
    /// If `other` cannot be read, or as for [`learn`](Self::learn). Half of `other` may then be in the map, which stays
    /// as it is: every further change fails.
    pub fn absorb(&mut self, other: &PlaceMap) -> Result<PlaceId, MapError> {
        self.guarded(|map| map.absorb_all(other))
    }

    fn absorb_all(&mut self, other: &PlaceMap) -> Result<PlaceId, MapError> {
        let first = self.contents.places.len() as u32;
        let moved = |place: &PlaceId| place.0 + first;
        let bare = |place: &Place| PlaceRecord {
            place: moved(&place.id),
            name: place.name.clone(),
            merged_into: None,
            neighbours: Vec::new(),
        };
        let linked = |place: &Place| PlaceRecord {
            merged_into: place.merged_into.as_ref().map(moved),
            neighbours: place.neighbours.iter().map(moved).collect(),
            ..bare(place)
        };
        // Each may speak of any other, so all are there before any does: power may be cut after every record.
        self.write_places(other.places().map(bare))?;
        self.write_places(other.places().map(linked))?;
        for experience in other.experiences() {
            self.absorb_experience(other, experience, first)?;
        }
        Ok(PlaceId(first))
    }

    fn write_places(&mut self, records: impl Iterator<Item = PlaceRecord>) -> Result<(), MapError> {
        let mut batch = Batch::default();
        for record in records {
            batch.add(PLACE, format::encode(&record))?;
        }
        self.make_room(batch.length_bytes())?;
        self.write(&batch)
    }

    fn absorb_experience(
        &mut self,
        other: &PlaceMap,
        experience: &Experience,
        first_place: u32,
    ) -> Result<(), MapError> {
        let mut record = other.journal.experience(experience.location)?;
        record.experience = self.next_experience()?.0;
        record.place = experience.learnt_as.0 + first_place;
        let features = match experience.is_keyframe {
            true => {
                let features = FeaturesRecord::from(&other.journal.features(experience.location)?);
                Some(format::encode(&features).map_err(|reason| MapError::Unstorable { reason })?)
            }
            false => None,
        };
        let thumbnail_jpeg = other.journal.thumbnail(experience.location)?;
        let mut batch = Batch::default();
        batch.add_parts(record, features, thumbnail_jpeg)?;
        self.make_room(batch.length_bytes())?;
        self.write(&batch)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;

    use super::*;
    use crate::place_map::format::KIND;
    use crate::place_map::journal::segment_name;
    use crate::place_map::tests::{SMALL, found, knowledge};
    use crate::storage::{Folder, MemoryFolder, RecordLog, Surveyed};

    #[test]
    fn a_map_that_took_in_half_of_another_one_is_changed_no_more() {
        let folder = Arc::new(MemoryFolder::default());
        let mut damaged = PlaceMap::open_folder(folder.clone(), Some(SMALL), None).unwrap();
        for index in 0..3 {
            found(&mut damaged, index);
        }
        let file = folder.open(&segment_name(1), true).unwrap();
        let mut thumbnails = Vec::new();
        RecordLog::survey(file.clone(), (&KIND, Path::new("journal")), 0, &mut |surveyed| {
            if let Surveyed::Whole(record) = surveyed
                && record.envelope == format::THUMBNAIL
            {
                thumbnails.push(record.offset);
            }
        })
        .unwrap();
        let mut bytes = vec![0; file.length_bytes().unwrap() as usize];
        file.read_at(0, &mut bytes).unwrap();
        bytes[thumbnails[1] as usize + 100] ^= 1;
        file.truncate(0).unwrap();
        file.append(&bytes).unwrap();
        let mut map = PlaceMap::in_memory(SMALL).unwrap();
        found(&mut map, 7);
        assert!(map.absorb(&damaged).unwrap_err().to_string().contains("is damaged"));
        assert!(!map.is_writable());
        let half = knowledge(&map);
        assert!(map.absorb(&damaged).is_err() && map.name_place(PlaceId(0), "x").is_err());
        assert_eq!(knowledge(&map), half);
    }
}
