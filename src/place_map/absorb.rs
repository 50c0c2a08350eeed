//! One map takes in another one: its places and experiences come behind its own, under new numbers.

use super::batch::Batch;
use super::format::{self, FeaturesRecord, PLACE, PlaceRecord};
use super::map::PlaceMap;
use super::{Experience, MapError, PlaceId};

impl PlaceMap {
    /// Adds the places and experiences of `other`; its place `n` becomes the place that is answered, plus `n`.
    ///
    /// # Errors
    /// If `other` cannot be read, or as for [`learn`](Self::learn).
    pub fn absorb(&mut self, other: &PlaceMap) -> Result<PlaceId, MapError> {
        let first = self.contents.places.len() as u32;
        let moved = |place: &PlaceId| place.0 + first;
        let mut batch = Batch::default();
        for place in other.places() {
            let record = PlaceRecord {
                place: moved(&place.id),
                name: place.name.clone(),
                merged_into: place.merged_into.as_ref().map(moved),
                neighbours: place.neighbours.iter().map(moved).collect(),
            };
            batch.add(PLACE, format::encode(&record))?;
        }
        // All at once, since each may speak of any other.
        self.make_room(batch.length_bytes())?;
        self.write(&batch)?;
        for experience in other.experiences() {
            self.absorb_experience(other, experience, first)?;
        }
        Ok(PlaceId(first))
    }

    fn absorb_experience(
        &mut self,
        other: &PlaceMap,
        experience: &Experience,
        first_place: u32,
    ) -> Result<(), MapError> {
        let mut record = other.journal.experience(experience.location)?;
        record.experience = self.contents.next_experience;
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
