//! One map takes in another one: its places and experiences come behind its own, under new numbers.

use std::sync::atomic::{AtomicBool, Ordering};

use super::batch::Batch;
use super::format::{self, FeaturesRecord, PLACE, PlaceRecord};
use super::map::PlaceMap;
use super::{Experience, MapError, Place, PlaceId};
use crate::storage::StorageError;

/// What is damaged of the map that is taken in.
#[derive(Default)]
struct Loss {
    experiences: usize,
    thumbnails: usize,
    first: Option<StorageError>,
}

impl Loss {
    /// What was read, unless it is damaged: then nothing, and why is kept if it is the first.
    fn sound<T>(&mut self, read: Result<T, StorageError>) -> Result<Option<T>, StorageError> {
        match read {
            Err(damage) if damage.is_damage() => {
                self.first.get_or_insert(damage);
                Ok(None)
            }
            read => read.map(Some),
        }
    }

    fn told(self) -> Option<MapError> {
        let Self { experiences, thumbnails, first } = self;
        first.map(|first| MapError::GaveUp { experiences, keyframes: 0, thumbnails, first })
    }
}

impl PlaceMap {
    /// Adds the places and experiences of `other`; its place `n` becomes the place that is answered, plus `n`. What is
    /// damaged is left out, the thumbnail alone if no more is, and answered, too.
    ///
    /// # Errors
    /// If `stop` is set meanwhile, the medium of `other` fails, or as for [`learn`](Self::learn). Half of `other` may
    /// then be in the map, which stays as it is: every further change fails.
    pub fn absorb(
        &mut self,
        other: &PlaceMap,
        stop: &AtomicBool,
    ) -> Result<(PlaceId, Option<MapError>), MapError> {
        self.guarded(|map| map.absorb_all(other, stop))
    }

    fn absorb_all(
        &mut self,
        other: &PlaceMap,
        stop: &AtomicBool,
    ) -> Result<(PlaceId, Option<MapError>), MapError> {
        let first = self.contents.places.len() as u32;
        let moved = |place: &PlaceId| place.0 + first;
        let bare = |place: &Place| PlaceRecord {
            place: moved(&place.id),
            name: place.name.as_deref().map(str::to_owned),
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
        let mut loss = Loss::default();
        for experience in other.experiences() {
            if stop.load(Ordering::Relaxed) {
                return Err(MapError::Interrupted);
            }
            self.absorb_experience(other, experience, (first, &mut loss))?;
        }
        Ok((PlaceId(first), loss.told()))
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
        (first_place, loss): (u32, &mut Loss),
    ) -> Result<(), MapError> {
        let (journal, location) = (&other.journal, experience.location);
        let read = journal.experience(location).and_then(|record| {
            Ok((record, experience.is_keyframe.then(|| journal.features(location)).transpose()?))
        });
        let Some((mut record, features)) = loss.sound(read)? else {
            loss.experiences += 1;
            return Ok(());
        };
        record.experience = self.next_experience()?.0;
        record.place = experience.learnt_as.0 + first_place;
        let features = features.map(|features| format::encode(&FeaturesRecord::from(&features))).transpose();
        let features = features.map_err(|reason| MapError::Unstorable { reason })?;
        let thumbnail_jpeg = loss.sound(journal.thumbnail(location))?;
        loss.thumbnails += usize::from(thumbnail_jpeg.is_none());
        let mut batch = Batch::default();
        batch.add_parts(record, features, thumbnail_jpeg.unwrap_or_default())?;
        self.make_room(batch.length_bytes())?;
        self.write(&batch)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;

    use super::*;
    use crate::place_map::ExperienceId;
    use crate::place_map::journal::{segment_identity, segment_name};
    use crate::place_map::tests::{SMALL, found, knowledge};
    use crate::storage::{Folder, MemoryFolder, RecordLog, Surveyed};

    static GO_ON: AtomicBool = AtomicBool::new(false);

    #[test]
    fn what_is_damaged_is_left_out_and_told_and_the_rest_is_taken_in() {
        let folder = Arc::new(MemoryFolder::default());
        let mut damaged = PlaceMap::open_folder(folder.clone(), Some(SMALL), None).unwrap();
        for index in 0..3 {
            found(&mut damaged, index);
        }
        let file = folder.open(&segment_name(1), true).unwrap();
        let (mut thumbnails, mut features) = (Vec::new(), Vec::new());
        RecordLog::survey(file.clone(), segment_identity(1, Path::new("journal")), 0, &mut |surveyed| {
            let Surveyed::Whole(record) = surveyed else { panic!("{surveyed:?}") };
            match record.envelope {
                format::THUMBNAIL => thumbnails.push(record.offset),
                format::FEATURES => features.push(record.offset),
                _ => {}
            }
        })
        .unwrap();
        let mut bytes = vec![0; file.length_bytes().unwrap() as usize];
        file.read_at(0, &mut bytes).unwrap();
        for damaged in [thumbnails[1], features[2]] {
            bytes[damaged as usize + 100] ^= 1;
        }
        file.truncate(0).unwrap();
        file.append(&bytes).unwrap();
        let mut map = PlaceMap::in_memory(SMALL).unwrap();
        found(&mut map, 7);
        let (first_place, loss) = map.absorb(&damaged, &GO_ON).unwrap();
        let loss = loss.unwrap().to_string();
        assert!(
            loss.contains("(experiences: 1, keyframes: 0, thumbnails: 1): ") && loss.contains("bad record"),
            "{loss}"
        );
        assert_eq!((first_place, map.places().len(), map.experiences().count()), (PlaceId(1), 4, 3));
        assert!(map.thumbnail_jpeg(ExperienceId(2)).unwrap().is_empty());
    }

    #[test]
    fn a_map_that_took_in_half_of_another_one_is_changed_no_more() {
        let [mut other, mut map] = [(); 2].map(|()| PlaceMap::in_memory(SMALL).unwrap());
        found(&mut other, 1);
        found(&mut map, 7);
        let stopped = map.absorb(&other, &AtomicBool::new(true));
        assert!(matches!(stopped, Err(MapError::Interrupted)) && !map.is_writable());
        let half = knowledge(&map);
        assert!(map.absorb(&other, &GO_ON).is_err() && map.name_place(PlaceId(0), "x").is_err());
        assert_eq!(knowledge(&map), half);
    }
}
