//! What a map answers without being changed.

use std::collections::BTreeSet;

use super::contents::Location;
use super::format::{self, ExperienceRecord};
use super::journal::FeatureReader;
use super::map::PlaceMap;
use super::{Experience, ExperienceId, MapError, Origin, Place, PlaceId, Traits, Unreadable};
use crate::feature::Features;

/// Lists and name of a place, roughly.
const PLACE_HEAP_BYTES: usize = 64;

/// What is in a map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapSummary {
    /// Number of places; one that was merged into another one does not count.
    pub places: usize,
    /// Number of places with a name.
    pub named_places: usize,
    /// Number of places that were merged into another one.
    pub merged_places: usize,
    /// Number of experiences.
    pub experiences: usize,
    /// Number of those by which places are recognised.
    pub keyframes: usize,
    /// Bytes of the journal.
    pub journal_bytes: u64,
    /// Bytes of those records that count.
    pub live_bytes: u64,
    /// Bytes of a torn tail that opening found.
    pub torn_bytes: u64,
    /// Records that were passed over, since they cannot be read.
    pub passed_over: usize,
    /// Segments of the journal.
    pub segments: usize,
    /// Bytes of the snapshot; 0 if there is none that can be read.
    pub snapshot_bytes: u64,
}

impl PlaceMap {
    /// All places, oldest first, those included that were merged into another one.
    pub fn places(&self) -> impl ExactSizeIterator<Item = &Place> {
        self.contents.places.values()
    }

    /// Those that were not merged into another one.
    pub fn living_places(&self) -> impl Iterator<Item = &Place> {
        self.places().filter(|place| place.merged_into.is_none())
    }

    /// The place that `id` is by now.
    #[must_use]
    pub fn place(&self, id: PlaceId) -> Option<&Place> {
        self.contents.places.get(&self.contents.resolve(id))
    }

    /// All experiences, oldest first.
    pub fn experiences(&self) -> impl Iterator<Item = &Experience> {
        self.contents.experiences.values()
    }

    /// The experiences numbered `first` and above, oldest first.
    pub fn experiences_from(&self, first: ExperienceId) -> impl Iterator<Item = &Experience> {
        self.contents.experiences.range(first..).map(|(_, experience)| experience)
    }

    /// The experience numbered `id`.
    #[must_use]
    pub fn experience(&self, id: ExperienceId) -> Option<&Experience> {
        self.contents.experiences.get(&id)
    }

    /// Number of experiences that there ever were.
    #[must_use]
    pub fn experiences_ever(&self) -> u32 {
        self.contents.next_experience
    }

    /// The frame that an experience came from.
    ///
    /// # Errors
    /// If there is no such experience or its record cannot be read.
    pub fn origin(&self, id: ExperienceId) -> Result<Origin, MapError> {
        let record = self.journal.experience(self.location(id)?)?;
        let ExperienceRecord { frame_index, frame_name, capture_nanos, pose, .. } = record;
        Ok(Origin { frame_index, frame_name, capture_nanos, pose: pose.map(format::unpack_pose) })
    }

    /// What a keyframe is found by; nothing of an experience that is none.
    ///
    /// # Errors
    /// If there is no such experience or its record cannot be read.
    pub fn traits(&self, id: ExperienceId) -> Result<Traits, MapError> {
        let location = self.location(id)?;
        let record = self.journal.experience(location)?;
        let Some(keyframe) = record.keyframe else { return Ok(Traits::default()) };
        Ok(keyframe.unpacked().map_err(|reason| self.journal.damaged(location, &reason))?)
    }

    /// Hashes of the models whose descriptors it holds, sorted, and which keyframes are damaged, so that theirs are not
    /// known.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn models(&self) -> Result<(Vec<String>, Option<Unreadable>), MapError> {
        let (mut models, mut unreadable) = (BTreeSet::new(), None);
        for keyframe in self.experiences().filter(|experience| experience.is_keyframe) {
            match self.traits(keyframe.id) {
                Ok(traits) => models.extend(traits.appearance.map(|appearance| appearance.model)),
                Err(MapError::Storage(damage)) if damage.is_damage() => {
                    Unreadable::note(&mut unreadable, damage);
                }
                Err(error) => return Err(error),
            }
        }
        Ok((models.into_iter().collect(), unreadable))
    }

    /// The features of a keyframe.
    ///
    /// # Errors
    /// If there is no such keyframe or its record cannot be read.
    pub fn features(&self, id: ExperienceId) -> Result<Features, MapError> {
        let mut reader = FeatureReader::default();
        self.read_features(id, &mut reader)?;
        Ok(reader.features)
    }

    /// The features of a keyframe, in the memory of `reader`.
    ///
    /// # Errors
    /// As [`features`](Self::features).
    pub fn read_features<'r>(
        &self,
        id: ExperienceId,
        reader: &'r mut FeatureReader,
    ) -> Result<&'r Features, MapError> {
        if !self.is_keyframe(id) {
            return Err(MapError::NoExperience { experience: id.0 });
        }
        self.journal.read_features(self.location(id)?, reader)?;
        Ok(&reader.features)
    }

    /// The thumbnail of an experience: the bytes of a JPEG, none if there is none.
    ///
    /// # Errors
    /// If there is no such experience or its record cannot be read.
    pub fn thumbnail_jpeg(&self, id: ExperienceId) -> Result<Vec<u8>, MapError> {
        Ok(self.journal.thumbnail(self.location(id)?)?)
    }

    /// Bytes of memory that places and experiences take, roughly.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        let place = size_of::<(PlaceId, Place)>() + PLACE_HEAP_BYTES;
        let experience = size_of::<(ExperienceId, Experience)>() + size_of::<ExperienceId>();
        // The trees' nodes are two thirds full.
        (self.contents.places.len() * place + self.contents.experiences.len() * experience) * 3 / 2
    }

    /// What is in the map.
    #[must_use]
    pub fn summary(&self) -> MapSummary {
        let merged_places = self.places().filter(|place| place.merged_into.is_some()).count();
        let is_named = |place: &&Place| place.merged_into.is_none() && place.name.is_some();
        MapSummary {
            places: self.places().len() - merged_places,
            named_places: self.places().filter(is_named).count(),
            merged_places,
            experiences: self.contents.experiences.len(),
            keyframes: self.experiences().filter(|experience| experience.is_keyframe).count(),
            journal_bytes: self.journal.total_bytes(),
            live_bytes: self.contents.live_bytes,
            torn_bytes: self.recovery.torn_bytes,
            passed_over: self.passed_over.as_ref().map_or(0, |passed_over| passed_over.records),
            segments: self.journal.segment_count(),
            snapshot_bytes: self.upkeep.snapshot_bytes(),
        }
    }

    pub(super) fn location(&self, id: ExperienceId) -> Result<Location, MapError> {
        let experience = self.experience(id).ok_or(MapError::NoExperience { experience: id.0 })?;
        Ok(experience.location)
    }

    pub(super) fn is_keyframe(&self, id: ExperienceId) -> bool {
        self.experience(id).is_some_and(|experience| experience.is_keyframe)
    }
}
