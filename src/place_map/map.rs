//! The map itself, grown record by record.

use std::sync::Arc;

use super::batch::Batch;
use super::contents::{Contents, MAX_NEIGHBOURS};
use super::format::{self, PLACE, PlaceRecord, THINNED, ThinnedRecord};
use super::journal::Journal;
use super::syncer::JournalSyncer;
use super::thinning::{self, Glimpse};
use super::upkeep::Upkeep;
use super::{Durability, ExperienceId, MapError, MapOptions, PassedOver, Place, PlaceId, Traits};
use crate::feature::Features;
use crate::frame::Frame;
use crate::storage::{Envelope, FileBytes, Folder, RecordLog, Recovery, StorageError, WriterLock};

/// An experience to be added to a place.
#[derive(Clone, Copy)]
pub struct NewExperience<'a> {
    /// The frame it comes from.
    pub frame: &'a Frame,
    /// Difference hash of the frame.
    pub view: u64,
    /// Mean luminance of the frame, 0 to 255.
    pub mean_luminance: f32,
    /// A small JPEG for retraining and for people.
    pub thumbnail_jpeg: &'a [u8],
    /// Features and what they are found by, if the place is to be recognised by it.
    pub keyframe: Option<(&'a Features, &'a Traits)>,
}

/// What became of an experience.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Learnt {
    /// The place.
    pub place: PlaceId,
    /// Its number, unless it told nothing that the place's others do not.
    pub experience: Option<ExperienceId>,
    /// Keyframes that were given up for it or for the budget.
    pub given_up: Vec<ExperienceId>,
}

/// A growing map.
pub struct PlaceMap {
    pub(super) contents: Contents,
    pub(super) journal: Journal,
    pub(super) folder: Arc<dyn Folder>,
    pub(super) options: MapOptions,
    pub(super) upkeep: Upkeep,
    pub(super) recovery: Recovery,
    pub(super) snapshot_fault: Option<StorageError>,
    pub(super) passed_over: Option<PassedOver>,
    /// The place of the experience before.
    pub(super) latest_place: Option<PlaceId>,
    pub(super) is_writable: bool,
    /// The index that lay in the folder, whatever map it is of.
    pub(super) index: Option<FileBytes>,
    /// Kept for as long as the map may be written.
    pub(super) _lock: Option<WriterLock>,
}

impl PlaceMap {
    /// Adds an experience to `place`, or to a new one, and forgets what the budget has no room for.
    ///
    /// # Errors
    /// If there is no such place, the map is full or read-only, or the medium fails. After a failure of the medium
    /// the map stays as it is: every further change fails.
    pub fn learn(&mut self, place: Option<PlaceId>, new: &NewExperience<'_>) -> Result<Learnt, MapError> {
        let id = self.next_experience()?;
        let place = match place {
            Some(place) => self.existing(place)?,
            None => PlaceId(self.contents.places.len() as u32),
        };
        let mut given_up = self.given_up_for(id, place, new);
        let experience = (!given_up.contains(&id)).then_some(id);
        given_up.retain(|&other| other != id);
        let mut batch = Batch::default();
        if experience.is_some() {
            for record in self.linked(place) {
                batch.add(PLACE, format::encode(&record))?;
            }
            batch.add_experience(id, place, new)?;
        }
        if !given_up.is_empty() {
            batch.add(THINNED, format::encode(&ThinnedRecord::new(&given_up)))?;
        }
        let mut forgotten: Vec<ExperienceId> =
            given_up.into_iter().filter(|&id| self.is_keyframe(id)).collect();
        if !batch.0.is_empty() {
            forgotten.extend(self.make_room(batch.length_bytes())?);
            self.write(&batch)?;
        }
        self.latest_place = Some(place);
        Ok(Learnt { place, experience, given_up: forgotten })
    }

    /// Gives `place` a name, or another one.
    ///
    /// # Errors
    /// If there is no such place, or as for [`learn`](Self::learn).
    pub fn name_place(&mut self, place: PlaceId, name: &str) -> Result<(), MapError> {
        let place = self.existing(place)?;
        let record = self.contents.places[&place].record();
        self.write_place(PlaceRecord { name: Some(name.to_owned()), ..record })
    }

    /// From now on `from` is `into`, and its number another name for that one. A name that only `from` has goes along.
    ///
    /// # Errors
    /// If there is no such place or both are one already, or as for [`learn`](Self::learn).
    pub fn merge_places(&mut self, from: PlaceId, into: PlaceId) -> Result<(), MapError> {
        let (from, into) = (self.existing(from)?, self.existing(into)?);
        if from == into {
            return Err(MapError::Merge { place: from.0, reason: "both are one place already" });
        }
        let merged = self.contents.places[&from].record();
        let kept = self.contents.places[&into].record();
        let mut batch = Batch::default();
        if kept.name.is_none() && merged.name.is_some() {
            let kept = PlaceRecord { name: merged.name.clone(), ..kept };
            batch.add(PLACE, format::encode(&kept))?;
        }
        batch.add(PLACE, format::encode(&PlaceRecord { merged_into: Some(into.0), ..merged }))?;
        self.write(&batch)
    }

    /// Undoes the merge of `place` into another one: what was learnt as `place` is its own again.
    ///
    /// # Errors
    /// If there is no such place, it is not merged or [cannot be split](Self::can_be_split), or as for
    /// [`learn`](Self::learn).
    pub fn split_place(&mut self, place: PlaceId) -> Result<(), MapError> {
        let Some(found) = self.contents.places.get(&place) else {
            return Err(MapError::NoPlace { place: place.0 });
        };
        if found.merged_into.is_none() {
            return Err(MapError::Merge { place: place.0, reason: "it is not merged into another one" });
        }
        if !self.can_be_split(place) {
            return Err(MapError::Merge {
                place: place.0,
                reason: "the merge is final: one of both has no keyframe left",
            });
        }
        self.write_place(PlaceRecord { merged_into: None, ..found.record() })
    }

    /// Whether `place` is merged into another one and each would keep a keyframe without the other.
    #[must_use]
    pub fn can_be_split(&self, place: PlaceId) -> bool {
        let whole = self.contents.resolve(place);
        let keyframes = self.contents.places.get(&whole).into_iter().flat_map(|whole| &whole.experiences);
        let keyframes =
            keyframes.filter_map(|id| self.contents.experiences.get(id)).filter(|e| e.is_keyframe);
        let goes: Vec<bool> =
            keyframes.map(|keyframe| self.contents.is_part(keyframe.learnt_as, place)).collect();
        whole != place && goes.contains(&true) && goes.contains(&false)
    }

    /// Returns when everything added so far would survive a power cut.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn sync(&mut self) -> Result<(), MapError> {
        if self.is_writable { self.guarded(|map| Ok(map.journal.sync()?)) } else { Ok(()) }
    }

    /// What can sync the map from another thread.
    #[must_use]
    pub fn syncer(&self) -> JournalSyncer {
        self.journal.syncer()
    }

    /// Whether the map can be changed: it was opened for writing, and nothing failed since.
    #[must_use]
    pub fn is_writable(&self) -> bool {
        self.is_writable
    }

    /// The settings that it is written with.
    #[must_use]
    pub fn options(&self) -> &MapOptions {
        &self.options
    }

    /// What was wrong with the snapshot, if opening had to do without.
    #[must_use]
    pub fn snapshot_fault(&self) -> Option<&StorageError> {
        self.snapshot_fault.as_ref()
    }

    /// What was passed over since it cannot be read, if the map was opened around damage.
    #[must_use]
    pub fn passed_over(&self) -> Option<&PassedOver> {
        self.passed_over.as_ref()
    }

    /// The number of the next experience.
    ///
    /// # Errors
    /// If there is none left.
    pub(super) fn next_experience(&self) -> Result<ExperienceId, MapError> {
        match self.contents.next_experience {
            count @ u32::MAX => Err(MapError::OutOfNumbers { count }),
            next => Ok(ExperienceId(next)),
        }
    }

    fn existing(&self, place: PlaceId) -> Result<PlaceId, MapError> {
        let found = self.place(place).ok_or(MapError::NoPlace { place: place.0 })?;
        Ok(found.id)
    }

    /// The experiences that tell least in a place that has enough of them: perhaps the new one, unless it is a
    /// keyframe. One for the new one, and a second one where a merge has brought too many together.
    fn given_up_for(&self, id: ExperienceId, place: PlaceId, new: &NewExperience<'_>) -> Vec<ExperienceId> {
        let Some(Place { id: half, experiences, .. }) = self.contents.places.get(&place) else {
            return Vec::new();
        };
        let most = self.options.place_experiences;
        if experiences.len() < most {
            return Vec::new();
        }
        let mut glimpses = thinning::glimpses(&self.contents, &self.contents.places[&place]);
        // A look that recognition lacks is worth more than what the hash says of it.
        if new.keyframe.is_none() {
            let (view, mean_luminance) = (new.view, Some(new.mean_luminance));
            glimpses.push(Glimpse { id, half: *half, view, mean_luminance, is_keyframe: false });
        }
        let mut given_up = Vec::new();
        for _ in 0..1 + usize::from(experiences.len() > most) {
            let Some(least) = thinning::least_telling(&glimpses) else { break };
            glimpses.retain(|glimpse| glimpse.id != least);
            given_up.push(least);
        }
        given_up
    }

    /// The records of places that the way to `place` makes or changes.
    fn linked(&self, place: PlaceId) -> Vec<PlaceRecord> {
        let known = self.contents.places.get(&place);
        let mut records = Vec::new();
        let latest = self.latest_place.map(|latest| self.contents.resolve(latest));
        let here = known.map(Place::record);
        let is_new = here.is_none();
        let mut here = here.unwrap_or(PlaceRecord {
            place: place.0,
            name: None,
            merged_into: None,
            neighbours: Vec::new(),
        });
        let mut is_changed = is_new;
        if let Some(latest) = latest.filter(|&latest| latest != place) {
            let mut there = self.contents.places[&latest].record();
            if add_neighbour(&mut there, place) {
                records.push(there);
            }
            is_changed |= add_neighbour(&mut here, latest);
        }
        if is_changed {
            // First, since the other one names it.
            records.insert(0, here);
        }
        records
    }

    pub(super) fn write_place(&mut self, record: PlaceRecord) -> Result<(), MapError> {
        let mut batch = Batch::default();
        batch.add(PLACE, format::encode(&record))?;
        self.write(&batch)
    }

    /// Writes a batch, all of it or nothing, and takes its contents over.
    pub(super) fn write(&mut self, batch: &Batch) -> Result<(), MapError> {
        self.guarded(|map| {
            map.append(batch)?;
            if map.options.durability == Durability::Every {
                map.journal.sync()?;
            }
            if map.journal.end().offset >= map.segment_bytes() {
                map.rotate()?;
            }
            Ok(())
        })
    }

    /// Does something to a map that is writable, and closes it for ever if the medium fails.
    pub(super) fn guarded<T>(
        &mut self,
        change: impl FnOnce(&mut Self) -> Result<T, MapError>,
    ) -> Result<T, MapError> {
        if !self.is_writable {
            return Err(MapError::ReadOnly);
        }
        let changed = self.journal.check().map_err(MapError::from).and_then(|()| change(self));
        self.is_writable = changed.is_ok();
        changed
    }

    pub(super) fn append(&mut self, batch: &Batch) -> Result<(), MapError> {
        let records: Vec<(Envelope, &[u8])> =
            batch.0.iter().map(|(envelope, payload)| (*envelope, payload.as_slice())).collect();
        let locations = self.journal.append(&records)?;
        for (&(envelope, payload), location) in records.iter().zip(locations) {
            let length_bytes = RecordLog::framed_bytes(payload);
            super::replay::apply(&mut self.contents, location, (envelope, payload), length_bytes)
                .map_err(|reason| MapError::Unstorable { reason })?;
        }
        Ok(())
    }
}

/// Notes `neighbour` as the latest of a place; whether that is news.
fn add_neighbour(record: &mut PlaceRecord, neighbour: PlaceId) -> bool {
    if record.neighbours.contains(&neighbour.0) {
        return false;
    }
    if record.neighbours.len() == MAX_NEIGHBOURS {
        record.neighbours.remove(0);
    }
    record.neighbours.push(neighbour.0);
    true
}
