//! What keeps a map small and quick to open: new segments, snapshots, and giving up what tells least.
//!
//! The folder stays within its budget: beyond 70 % of it, experiences are given up, first in the places that have
//! most; and whatever still counts in the oldest segment is written again at the end, a little with each new
//! experience, until the segment can be deleted.

use super::batch::Batch;
use super::contents::Fact;
use super::format::{self, FeaturesRecord, PLACE, THINNED, ThinnedRecord};
use super::map::PlaceMap;
use super::{ExperienceId, MapError, snapshot, thinning};

/// Share of the budget that records may take which count.
const LIVE_SHARE: f64 = 0.7;
/// Bytes that are written again with every new experience while a segment is being emptied.
const CLEANING_BYTES: u64 = 256 << 10;
/// Experiences that are given up with every new one while there are too many.
const GIVEN_UP_AT_ONCE: usize = 4;
/// Segments that are to stay free: one that grows, and one that takes what another one still held.
const FREE_SEGMENTS: u64 = 3;

/// What is under way, and how large the snapshot is.
pub(super) struct Upkeep {
    /// The segment that is being emptied, and what is still in it, the next one last.
    cleaning: Option<(u32, Vec<Fact>)>,
    snapshot_bytes: u64,
}

impl Upkeep {
    pub(super) fn new(snapshot_bytes: u64) -> Self {
        Self { cleaning: None, snapshot_bytes }
    }

    pub(super) fn snapshot_bytes(&self) -> u64 {
        self.snapshot_bytes
    }
}

impl PlaceMap {
    /// Bytes that the folder takes; twice the snapshot, for it is replaced by writing another one.
    fn folder_bytes(&self) -> u64 {
        self.journal.total_bytes() + 2 * self.upkeep.snapshot_bytes
    }

    /// Makes room for `bytes` more, and answers which keyframes were given up for it.
    ///
    /// # Errors
    /// If the map is full or the medium fails.
    pub(super) fn make_room(&mut self, bytes: u64) -> Result<Vec<ExperienceId>, MapError> {
        let budget_bytes = self.options.disk_bytes;
        let free_bytes = FREE_SEGMENTS * self.options.segment_bytes();
        let mut given_up = Vec::new();
        self.give_up(GIVEN_UP_AT_ONCE, &mut given_up)?;
        if self.folder_bytes().saturating_add(free_bytes) > budget_bytes {
            self.clean(CLEANING_BYTES)?;
        }
        if self.folder_bytes().saturating_add(bytes) > budget_bytes {
            // The map was larger before it got this budget: what else comes little by little comes at once.
            self.give_up(usize::MAX, &mut given_up)?;
        }
        while self.folder_bytes().saturating_add(bytes) > budget_bytes {
            let before = self.journal.oldest_number();
            self.clean(u64::MAX)?;
            if self.journal.oldest_number() == before {
                let places = self.contents.places.len();
                return Err(MapError::Full { places, bytes: self.contents.live_bytes, budget_bytes });
            }
        }
        Ok(given_up)
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

    /// Writes up to `bytes` of what still counts in the oldest segment again, and deletes it once nothing does.
    fn clean(&mut self, bytes: u64) -> Result<(), MapError> {
        self.guarded(|map| {
            let dead_bytes = map.journal.total_bytes().saturating_sub(map.contents.live_bytes);
            if map.upkeep.cleaning.is_none() && dead_bytes < map.options.segment_bytes() {
                // Nothing would be gained by it.
                return Ok(());
            }
            if map.journal.oldest_number() == map.journal.active_number() {
                map.rotate()?;
            }
            map.empty_oldest(bytes)
        })
    }

    fn empty_oldest(&mut self, bytes: u64) -> Result<(), MapError> {
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
                return Ok(());
            };
            written += self.write_again(fact, segment)?;
            if self.journal.end().offset >= self.options.segment_bytes() {
                self.rotate()?;
            }
        }
        self.upkeep.cleaning = Some((segment, facts));
        Ok(())
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

    fn add_again(&self, id: ExperienceId, batch: &mut Batch) -> Result<(), MapError> {
        let location = self.location(id)?;
        let mut record = self.journal.experience(location)?;
        // A record of version 1 does not know its number.
        record.experience = id.0;
        let features = match record.keyframe {
            Some(_) => {
                let record = FeaturesRecord::from(&self.journal.features(location)?);
                Some(format::encode(&record).map_err(|reason| MapError::Unstorable { reason })?)
            }
            None => None,
        };
        batch.add_parts(record, features, self.journal.thumbnail(location)?)
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

    /// Rewrites the journal without what does not count any more.
    ///
    /// # Errors
    /// If the map is read-only or the medium fails; nothing is lost then.
    pub fn compact(&mut self) -> Result<(), MapError> {
        self.guarded(|map| {
            let last = map.journal.active_number();
            map.rotate()?;
            while map.journal.oldest_number() <= last {
                map.empty_oldest(u64::MAX)?;
            }
            map.take_snapshot()
        })
    }
}
