//! What keeps a map small and quick to open: new segments, snapshots, and giving up what tells least.
//!
//! The folder stays within its budget: beyond 70 % of it, experiences are given up, first in the places that have
//! most; and whatever still counts in the oldest segment is written again at the end, a little with each new
//! experience, until the segment can be deleted.

use super::batch::Batch;
use super::contents::Fact;
use super::format::{self, FeaturesRecord, PLACE, THINNED, ThinnedRecord};
use super::map::PlaceMap;
use super::{ExperienceId, MapError, Place, snapshot, thinning};
use crate::storage::{LOG_HEADER_BYTES, StorageError};

/// Share of the budget that records may take which count.
const LIVE_SHARE: f64 = 0.7;
/// Most bytes that are written again with every new experience while a segment is being emptied at leisure.
const CLEANING_BYTES: u64 = 256 << 10;
/// Most of them where the folder is about to be too large: so many take no frame long.
const HURRIED_CLEANING_BYTES: u64 = 4 << 20;
/// Experiences that are given up with every new one while there are too many.
const GIVEN_UP_AT_ONCE: usize = 4;
/// Segments that are to stay free: one that grows, one that takes what another one still held, and one to spare.
const FREE_SEGMENTS: u64 = 3;
/// Segments that must stay free, or the next one to be emptied might overfill the folder.
const LEAST_FREE_SEGMENTS: u64 = 2;

/// What is under way, and how large the snapshot is.
pub(super) struct Upkeep {
    /// The segment that is being emptied, and what is still in it, the next one last.
    cleaning: Option<(u32, Vec<Fact>)>,
    snapshot_bytes: u64,
    /// Of the index that was there when the map was opened.
    index_bytes: u64,
    /// What was given up since it could not be read, until somebody asks.
    loss: Option<Loss>,
    /// Keyframes among that of which nobody heard yet.
    lost_keyframes: Vec<ExperienceId>,
}

/// What could not be read when it was to be written again.
struct Loss {
    experiences: usize,
    keyframes: usize,
    thumbnails: usize,
    first: StorageError,
}

impl Loss {
    fn new(first: StorageError) -> Self {
        Self { experiences: 0, keyframes: 0, thumbnails: 0, first }
    }
}

impl Upkeep {
    pub(super) fn new(snapshot_bytes: u64, index_bytes: u64) -> Self {
        Self { cleaning: None, snapshot_bytes, index_bytes, loss: None, lost_keyframes: Vec::new() }
    }

    /// What was lost for the time being, `damage` among it.
    fn loss(&mut self, damage: StorageError) -> &mut Loss {
        self.loss.get_or_insert_with(|| Loss::new(damage))
    }

    pub(super) fn snapshot_bytes(&self) -> u64 {
        self.snapshot_bytes
    }
}

impl PlaceMap {
    /// Bytes that the folder takes; twice the snapshot, for it is replaced by writing another one, and the index that
    /// was in it, which may still be mapped.
    fn folder_bytes(&self) -> u64 {
        self.journal.total_bytes() + 2 * self.upkeep.snapshot_bytes + self.upkeep.index_bytes
    }

    /// Whether the budget has room for a file of so many bytes more.
    pub(super) fn has_room_for(&self, bytes: u64) -> bool {
        self.folder_bytes().saturating_add(bytes) <= self.options.disk_bytes
    }

    /// Bytes after which the journal goes on in a new segment.
    pub(super) fn segment_bytes(&self) -> u64 {
        self.options.segment_bytes(self.journal.total_bytes())
    }

    /// Bytes of the journal that do not count any more.
    fn dead_bytes(&self) -> u64 {
        let headers_bytes = LOG_HEADER_BYTES * self.journal.segment_count() as u64;
        self.journal.total_bytes().saturating_sub(self.contents.live_bytes + headers_bytes)
    }

    /// What the map gave up since it could not be read any more, once.
    pub fn take_loss(&mut self) -> Option<MapError> {
        let Loss { experiences, keyframes, thumbnails, first } = self.upkeep.loss.take()?;
        Some(MapError::GaveUp { experiences, keyframes, thumbnails, first })
    }

    /// Makes room for `bytes` more, and answers which keyframes were given up for it.
    ///
    /// # Errors
    /// If the map is full or the medium fails.
    pub(super) fn make_room(&mut self, bytes: u64) -> Result<Vec<ExperienceId>, MapError> {
        let budget_bytes = self.options.disk_bytes;
        let mut given_up = Vec::new();
        self.give_up(GIVEN_UP_AT_ONCE, &mut given_up)?;
        self.clean_in_time(bytes)?;
        let excess_bytes = |map: &Self| map.folder_bytes().saturating_add(bytes).saturating_sub(budget_bytes);
        if excess_bytes(self) > 0 {
            // The map was larger before it got this budget: what else comes little by little comes at once.
            self.give_up(usize::MAX, &mut given_up)?;
        }
        // Once through all segments: what does not count may be in any of them.
        for _ in 0..self.journal.segment_count() {
            if (1..=self.dead_bytes()).contains(&excess_bytes(self)) {
                self.clean(u64::MAX)?;
            }
        }
        given_up.append(&mut self.upkeep.lost_keyframes);
        if excess_bytes(self) > 0 {
            let places = self.contents.places.len();
            return Err(MapError::Full { places, bytes: self.contents.live_bytes, budget_bytes });
        }
        Ok(given_up)
    }

    /// Writes a little of the oldest segment again where free segments get few beside `bytes` more, and much where they
    /// are about to run out: most of the oldest segments may count to the last byte.
    fn clean_in_time(&mut self, bytes: u64) -> Result<(), MapError> {
        let is_worth_it =
            |map: &Self| map.upkeep.cleaning.is_some() || map.dead_bytes() >= map.segment_bytes();
        let is_short_of = |map: &Self, segments: u64| {
            let free_bytes = segments * map.segment_bytes().max(map.journal.longest_bytes());
            map.folder_bytes().saturating_add(bytes).saturating_add(free_bytes) > map.options.disk_bytes
        };
        if is_short_of(self, FREE_SEGMENTS) && is_worth_it(self) {
            self.clean(CLEANING_BYTES.min(self.segment_bytes()))?;
        }
        let mut left_bytes = HURRIED_CLEANING_BYTES;
        while left_bytes > 0 && is_short_of(self, LEAST_FREE_SEGMENTS) && is_worth_it(self) {
            left_bytes = left_bytes.saturating_sub(self.clean(left_bytes)?.max(1));
        }
        Ok(())
    }

    /// Gives up what tells least, as much as is too much but at most `count` experiences; the keyframes among them
    /// come to `keyframes`.
    fn give_up(&mut self, count: usize, keyframes: &mut Vec<ExperienceId>) -> Result<(), MapError> {
        let most_bytes = LIVE_SHARE * self.options.disk_bytes as f64;
        for _ in 0..count {
            if self.contents.live_bytes as f64 <= most_bytes {
                break;
            }
            let Some(id) = thinning::least_telling_of_all(&self.contents) else { break };
            keyframes.extend(self.is_keyframe(id).then_some(id));
            let mut batch = Batch::default();
            batch.add(THINNED, format::encode(&ThinnedRecord::new(&[id])))?;
            self.write(&batch)?;
        }
        Ok(())
    }

    /// Writes up to `bytes` of what still counts in the oldest segment again, and deletes it once nothing does; answers
    /// how many bytes were written.
    fn clean(&mut self, bytes: u64) -> Result<u64, MapError> {
        self.guarded(|map| {
            if map.journal.oldest_number() == map.journal.active_number() {
                map.rotate()?;
            }
            map.empty_oldest(bytes)
        })
    }

    fn empty_oldest(&mut self, bytes: u64) -> Result<u64, MapError> {
        let oldest = self.journal.oldest_number();
        let (segment, mut facts) = self.upkeep.cleaning.take().unwrap_or_else(|| {
            let mut facts = self.contents.facts_in(oldest);
            facts.reverse();
            (oldest, facts)
        });
        let mut written = 0;
        while written < bytes {
            let Some(fact) = facts.pop() else {
                self.journal.remove_oldest()?;
                return Ok(written);
            };
            written += self.write_again(fact, segment)?;
            if self.journal.end().offset >= self.options.rewritten_segment_bytes(self.journal.total_bytes()) {
                self.rotate()?;
            }
        }
        self.upkeep.cleaning = Some((segment, facts));
        Ok(written)
    }

    /// Writes `fact` at the end of the journal if its record is still in `segment`; answers how many bytes it took.
    fn write_again(&mut self, fact: Fact, segment: u32) -> Result<u64, MapError> {
        let mut batch = Batch::default();
        match fact {
            Fact::Place(id) => {
                let place = &self.contents.places[&id];
                if place.location.segment() == segment {
                    batch.add(PLACE, format::encode(&place.record()))?;
                }
            }
            Fact::Experience(id) => {
                if let Some(experience) = self.contents.experiences.get(&id)
                    && experience.location.segment() == segment
                {
                    self.add_again(id, &mut batch)?;
                }
            }
        }
        self.append(&batch)?;
        Ok(batch.length_bytes())
    }

    /// Adds the records of an experience, without what is damaged of them.
    fn add_again(&mut self, id: ExperienceId, batch: &mut Batch) -> Result<(), MapError> {
        let location = self.location(id)?;
        let mut record = match self.journal.experience(location) {
            Err(damage) if damage.is_damage() => {
                self.upkeep.lost_keyframes.extend(self.is_keyframe(id).then_some(id));
                self.upkeep.loss(damage).experiences += 1;
                return batch.add(THINNED, format::encode(&ThinnedRecord::new(&[id])));
            }
            record => record?,
        };
        // A record of version 1 does not know its number.
        record.experience = id.0;
        let features = match record.keyframe.is_some().then(|| self.journal.features(location)).transpose() {
            Err(damage) if damage.is_damage() => {
                self.upkeep.lost_keyframes.push(id);
                self.upkeep.loss(damage).keyframes += 1;
                record.keyframe = None;
                None
            }
            features => features?,
        };
        let thumbnail_jpeg = match self.journal.thumbnail(location) {
            Err(damage) if damage.is_damage() => {
                self.upkeep.loss(damage).thumbnails += 1;
                Vec::new()
            }
            thumbnail => thumbnail?,
        };
        let features = features.map(|features| format::encode(&FeaturesRecord::from(&features))).transpose();
        batch.add_parts(record, features.map_err(|reason| MapError::Unstorable { reason })?, thumbnail_jpeg)
    }

    /// Writes the places that no record says, since those were lost, to a new segment, before a snapshot takes the
    /// place of the one that knew them.
    fn write_what_is_nowhere(&mut self) -> Result<(), MapError> {
        self.journal.rotate()?;
        let nowhere = self.contents.places.values().filter(|place| place.record_bytes == 0);
        let records: Vec<_> = nowhere.map(Place::record).collect();
        for record in records {
            let mut batch = Batch::default();
            batch.add(PLACE, format::encode(&record))?;
            self.append(&batch)?;
        }
        self.journal.sync()?;
        Ok(())
    }

    /// Goes on in a new segment, and takes a snapshot of everything before it.
    pub(super) fn rotate(&mut self) -> Result<(), MapError> {
        self.journal.rotate()?;
        self.take_snapshot()
    }

    fn take_snapshot(&mut self) -> Result<(), MapError> {
        self.journal.sync()?;
        self.upkeep.snapshot_bytes =
            snapshot::write(self.folder.as_ref(), self.journal.end(), &self.contents)?;
        Ok(())
    }

    /// Brings everything onto the medium and takes a snapshot, so that the map opens quickly.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn close(&mut self) -> Result<(), MapError> {
        if self.is_writable() { self.guarded(Self::take_snapshot) } else { Ok(()) }
    }

    /// Rewrites the journal without what does not count any more, nor what [cannot be read](Self::take_loss).
    ///
    /// # Errors
    /// If the map is read-only or the medium fails; nothing more is lost then.
    pub fn compact(&mut self) -> Result<(), MapError> {
        self.guarded(|map| {
            let last = map.journal.active_number();
            if map.passed_over.is_some() {
                map.write_what_is_nowhere()?;
            }
            map.rotate()?;
            while map.journal.oldest_number() <= last {
                map.empty_oldest(u64::MAX)?;
            }
            map.take_snapshot()
        })
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;
    use crate::place_map::format::{EXPERIENCE, FEATURES, THUMBNAIL};
    use crate::place_map::journal::{segment_identity, segment_name};
    use crate::place_map::tests::{SMALL, found, knowledge, learn};
    use crate::place_map::{MapOptions, PlaceId};
    use crate::storage::{DiskFolder, Envelope, Folder, RecordLog, Surveyed};

    /// Flips the last bit of a record in the first segment: of the one of that kind that stands so many of them behind
    /// the first.
    fn damage(folder: &Path, kind: Envelope, number: usize) {
        let file = DiskFolder::new(folder).open(&segment_name(1), false).unwrap();
        let mut last_bytes = Vec::new();
        RecordLog::survey(file, segment_identity(1, Path::new("journal")), u64::MAX, &mut |surveyed| {
            match surveyed {
                Surveyed::Whole(record) if record.envelope == kind => {
                    last_bytes.push(record.offset + record.length_bytes - 1);
                }
                _ => {}
            }
        })
        .unwrap();
        let path = folder.join(segment_name(1));
        let mut bytes = fs::read(&path).unwrap();
        bytes[last_bytes[number] as usize] ^= 1;
        fs::write(path, bytes).unwrap();
    }

    /// A map of forty places whose second experience is damaged, as is a thumbnail and the features of another.
    fn damaged_map(folder: &Path) -> PlaceMap {
        let mut map = PlaceMap::open(folder, SMALL).unwrap();
        for index in 0..40 {
            found(&mut map, index);
        }
        for (kind, number) in [(EXPERIENCE, 1), (THUMBNAIL, 3), (FEATURES, 5)] {
            damage(folder, kind, number);
        }
        map
    }

    #[test]
    fn compacting_gives_up_what_is_damaged_and_says_so_once() {
        let folder = tempfile::tempdir().unwrap();
        let mut map = damaged_map(folder.path());
        map.compact().unwrap();
        let said = map.take_loss().unwrap().to_string();
        assert!(
            said.contains("(experiences: 1, keyframes: 1, thumbnails: 1): ")
                && said.contains(&segment_name(1)),
            "{said}"
        );
        assert!(map.take_loss().is_none());
        assert_eq!(map.places().len(), 40);
        let left: Vec<u32> = map.experiences().map(|experience| experience.id.0).collect();
        assert_eq!(left, (0..40).filter(|&id| id != 1).collect::<Vec<_>>());
        assert!(!map.experience(ExperienceId(5)).unwrap().is_keyframe);
        assert_eq!(map.thumbnail_jpeg(ExperienceId(5)).unwrap(), [5; 3000]);
        assert!(map.thumbnail_jpeg(ExperienceId(3)).unwrap().is_empty());
        assert!(map.features(ExperienceId(3)).is_ok());
        let before = knowledge(&map);
        drop(map);
        assert!(!PlaceMap::verify(folder.path(), &|_, _| ()).unwrap().is_damaged());
        fs::remove_file(folder.path().join(snapshot::NAME)).unwrap();
        assert_eq!(knowledge(&PlaceMap::open_read_only(folder.path()).unwrap()), before);
    }

    #[test]
    fn a_robot_whose_old_segments_are_damaged_learns_on_and_hears_which_keyframes_are_gone() {
        let folder = tempfile::tempdir().unwrap();
        let mut map = damaged_map(folder.path());
        let mut given_up = Vec::new();
        let mut losses = Vec::new();
        for index in 0..1000 {
            let learnt = learn(&mut map, Some(PlaceId(index as u32 % 40)), index, index % 5 == 0).unwrap();
            given_up.extend(learnt.given_up);
            losses.extend(map.take_loss().map(|loss| loss.to_string()));
        }
        assert!(!folder.path().join(segment_name(1)).exists());
        assert!(!losses.is_empty());
        for lost in [1, 5].map(ExperienceId) {
            assert!(given_up.contains(&lost) && map.experience(lost).is_none_or(|e| !e.is_keyframe));
        }
    }

    #[test]
    fn a_map_whose_oldest_segments_count_to_the_last_byte_is_not_full_below_its_budget() {
        let mut map = PlaceMap::in_memory(SMALL).unwrap();
        for index in 0..330 {
            found(&mut map, index);
        }
        assert!(map.dead_bytes() < 16 << 10 && map.folder_bytes() < SMALL.disk_bytes * 3 / 4);
        for index in 330..3000 {
            learn(&mut map, Some(PlaceId(index as u32 % 7)), index, index % 3 == 0).unwrap();
        }
        assert_eq!(map.places().len(), 330);
        assert!(map.folder_bytes() <= SMALL.disk_bytes);
    }

    #[test]
    fn a_map_is_full_only_once_nothing_is_left_that_does_not_count() {
        let folder = tempfile::tempdir().unwrap();
        let mut map = PlaceMap::open(folder.path(), MapOptions { place_experiences: 2, ..SMALL }).unwrap();
        for index in 0..100 {
            found(&mut map, index);
        }
        for index in 100..110 {
            learn(&mut map, Some(PlaceId(0)), index, true).unwrap();
        }
        map.close().unwrap();
        let (folder_bytes, dead_bytes) = (map.folder_bytes(), map.dead_bytes());
        assert!((20_000..map.segment_bytes()).contains(&dead_bytes), "{dead_bytes}");
        drop(map);
        // One more fits as it is; some more once it is written again; then it is full.
        let mut map = PlaceMap::open(
            folder.path(),
            MapOptions { disk_bytes: folder_bytes + 5000, place_experiences: 2, ..SMALL },
        )
        .unwrap();
        let founded = (200..300).take_while(|&index| learn(&mut map, None, index, true).is_ok()).count();
        assert!((5..20).contains(&founded), "{founded}");
        assert!(map.dead_bytes() < 10_000, "{}", map.dead_bytes());
        assert_eq!(map.places().len(), 100 + founded);
    }
}
