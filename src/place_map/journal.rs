//! The journal: numbered segments, of which the last one grows.
//!
//! A segment that is full is synced before the next one begins, so only the last can have a torn tail. When the
//! folder grows beyond its budget, whatever still counts in the oldest segment is written again at the end, and
//! the segment is deleted; so a record that something was given up is never deleted before the record of what it
//! gave up.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::contents::{Location, MAX_SEGMENT};
use super::format::{self, EXPERIENCE, ExperienceRecord, FEATURES, FeaturesRecord, KIND, THUMBNAIL};
use super::replay::version_1_experience;
use super::syncer::JournalSyncer;
use super::version_1;
use crate::feature::Features;
use crate::storage::{AppendFile, Envelope, Folder, LogIdentity, Reading, RecordLog, StorageError, Tail};

/// A point of the journal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Position {
    pub(super) segment: u32,
    pub(super) offset: u64,
}

pub(super) enum Segment {
    Log(RecordLog),
    Version1(version_1::Journal),
}

impl Segment {
    pub(super) fn length_bytes(&self) -> u64 {
        match self {
            Self::Log(log) => log.length_bytes(),
            Self::Version1(journal) => journal.length_bytes(),
        }
    }

    fn file(&self) -> Arc<dyn AppendFile> {
        match self {
            Self::Log(log) => log.file(),
            Self::Version1(journal) => journal.file(),
        }
    }
}

/// Reads the features of one keyframe after the other, and keeps its memory.
#[derive(Debug, Default)]
pub struct FeatureReader {
    payload: Vec<u8>,
    pub(super) features: Features,
}

/// The segments of a map's journal.
pub(super) struct Journal {
    pub(super) folder: Arc<dyn Folder>,
    pub(super) segments: BTreeMap<u32, Segment>,
    pub(super) syncer: JournalSyncer,
}

pub(super) fn segment_name(number: u32) -> String {
    format!("journal-{number:06}.loci")
}

fn segment_number(name: &str) -> Option<u32> {
    let number = name.strip_prefix("journal-")?.strip_suffix(".loci")?.parse().ok()?;
    (segment_name(number) == name).then_some(number)
}

/// What the segment `number` at `path` is to be.
pub(super) fn segment_identity(number: u32, path: &Path) -> LogIdentity<'_> {
    LogIdentity { kind: &KIND, number, path }
}

/// Numbers of the segments in `folder`, rising.
pub(super) fn segment_numbers(folder: &dyn Folder) -> Result<Vec<u32>, StorageError> {
    let names = folder.names().map_err(StorageError::io("list", folder.path()))?;
    let mut numbers: Vec<u32> = names.iter().filter_map(|name| segment_number(name)).collect();
    numbers.sort_unstable();
    Ok(numbers)
}

/// The segment at `path` is gone.
pub(super) fn missing(path: &Path) -> StorageError {
    let reason = io::Error::new(io::ErrorKind::NotFound, "it is missing; restore it from a copy");
    StorageError::io("open", path)(reason)
}

impl Journal {
    /// The journal of `segments`.
    pub(super) fn of(folder: Arc<dyn Folder>, segments: BTreeMap<u32, Segment>) -> Self {
        Self { folder, segments, syncer: JournalSyncer::default() }
    }

    /// Goes on in the segment `number`, once everything before it is on the medium.
    pub(super) fn begin_segment(&mut self, number: u32) -> Result<(), StorageError> {
        self.sync()?;
        let name = segment_name(number);
        let path = self.folder.path().join(&name);
        if number > MAX_SEGMENT {
            let reason = format!("a map has at most {MAX_SEGMENT} segments in its life; begin a new one");
            return Err(StorageError::io("create", &path)(io::Error::other(reason)));
        }
        let file = self.folder.open(&name, true).map_err(StorageError::io("create", &path))?;
        let reading = Reading { from: 0, wanted: |_| true, visit: &mut |_| Ok(()) };
        let (log, _) = RecordLog::open(file, segment_identity(number, &path), Tail::Mended, reading)?;
        self.folder.sync().map_err(StorageError::io("sync", self.folder.path()))?;
        self.segments.insert(number, Segment::Log(log));
        self.watch();
        Ok(())
    }

    /// Has the syncer bring the segment that grows onto the medium, and look after all of them.
    pub(super) fn watch(&self) {
        let files = self.segments.iter().map(|(&number, segment)| (self.path_of(number), segment.file()));
        let active = match self.segments.last_key_value() {
            Some((_, Segment::Log(log))) => Some(log.syncer()),
            _ => None,
        };
        self.syncer.watch(active, files.collect());
    }

    /// Goes on in a new segment.
    pub(super) fn rotate(&mut self) -> Result<(), StorageError> {
        self.begin_segment(self.active_number() + 1)
    }

    /// Adds records in one write and answers where they are.
    pub(super) fn append(&mut self, records: &[(Envelope, &[u8])]) -> Result<Vec<Location>, StorageError> {
        let number = self.active_number();
        match self.segments.get_mut(&number) {
            Some(Segment::Log(log)) => {
                let offsets = log.append(records)?;
                Ok(offsets.into_iter().map(|offset| Location::new(number, offset)).collect())
            }
            _ => Err(self.missing(number)),
        }
    }

    /// Returns when everything appended would survive a power cut, and fails if any segment was deleted.
    pub(super) fn sync(&self) -> Result<(), StorageError> {
        self.check()?;
        self.syncer.try_sync()
    }

    /// Fails if a sync in the background did.
    pub(super) fn check(&self) -> Result<(), StorageError> {
        self.syncer.take_failure().map_or(Ok(()), Err)
    }

    pub(super) fn syncer(&self) -> JournalSyncer {
        self.syncer.clone()
    }

    /// Number of the segment that grows; 0 if there is none.
    pub(super) fn active_number(&self) -> u32 {
        self.segments.last_key_value().map_or(0, |(&number, _)| number)
    }

    /// Number of the oldest segment; 0 if there is none.
    pub(super) fn oldest_number(&self) -> u32 {
        self.segments.first_key_value().map_or(0, |(&number, _)| number)
    }

    /// Where the next record will be.
    pub(super) fn end(&self) -> Position {
        let (&segment, offset) = match self.segments.last_key_value() {
            Some((number, segment)) => (number, segment.length_bytes()),
            None => return Position::default(),
        };
        Position { segment, offset }
    }

    /// Number of segments.
    pub(super) fn segment_count(&self) -> usize {
        self.segments.len()
    }

    /// Bytes of all segments.
    pub(super) fn total_bytes(&self) -> u64 {
        self.segments.values().map(Segment::length_bytes).sum()
    }

    /// Bytes of the longest segment.
    pub(super) fn longest_bytes(&self) -> u64 {
        self.segments.values().map(Segment::length_bytes).max().unwrap_or(0)
    }

    /// Deletes the oldest segment, once everything that was written is on the medium.
    pub(super) fn remove_oldest(&mut self) -> Result<(), StorageError> {
        self.sync()?;
        let Some((number, _)) = self.segments.pop_first() else { return Ok(()) };
        let name = segment_name(number);
        let path = self.folder.path().join(&name);
        self.watch();
        match self.folder.remove(&name) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(StorageError::io("delete", &path)(error));
            }
            _ => {}
        }
        self.folder.sync().map_err(StorageError::io("sync", self.folder.path()))
    }

    /// The experience whose record is at `location`.
    pub(super) fn experience(&self, location: Location) -> Result<ExperienceRecord, StorageError> {
        match self.segment(location)? {
            Segment::Log(log) => {
                let (envelope, payload) = log.read(location.offset())?;
                match envelope {
                    EXPERIENCE => format::decode(&payload).map_err(|reason| self.damaged(location, &reason)),
                    _ => Err(self.damaged(location, "it is no experience")),
                }
            }
            Segment::Version1(journal) => {
                let (old, mean_luminance) = self.old_experience(journal, location)?;
                version_1_experience(old, mean_luminance).map_err(|reason| self.damaged(location, &reason))
            }
        }
    }

    /// The features of the keyframe whose record is at `location`.
    pub(super) fn features(&self, location: Location) -> Result<Features, StorageError> {
        let mut reader = FeatureReader::default();
        self.read_features(location, &mut reader)?;
        Ok(reader.features)
    }

    /// Has `reader` read the features of the keyframe whose record is at `location`.
    pub(super) fn read_features(
        &self,
        location: Location,
        FeatureReader { payload, features }: &mut FeatureReader,
    ) -> Result<(), StorageError> {
        let damaged = |reason: String| self.damaged(location, &reason);
        match self.segment(location)? {
            Segment::Log(log) => {
                if log.read_into(location.offset(), payload)? != EXPERIENCE {
                    return Err(self.damaged(location, "it is no experience"));
                }
                let back = format::features_back_bytes(payload).map_err(damaged)?;
                self.read_blob((location, back), FEATURES, payload)?;
                FeaturesRecord::unpack(payload, features).map_err(damaged)
            }
            Segment::Version1(journal) => {
                *features = self.old_experience(journal, location)?.0.features().map_err(damaged)?;
                Ok(())
            }
        }
    }

    /// The JPEG of the experience whose record is at `location`; nothing if it has none.
    pub(super) fn thumbnail(&self, location: Location) -> Result<Vec<u8>, StorageError> {
        match self.segment(location)? {
            Segment::Log(_) => match self.experience(location)?.thumbnail_back_bytes {
                0 => Ok(Vec::new()),
                back => {
                    let mut jpeg = Vec::new();
                    self.read_blob((location, back), THUMBNAIL, &mut jpeg)?;
                    Ok(jpeg)
                }
            },
            Segment::Version1(journal) => Ok(self.old_experience(journal, location)?.0.thumbnail_jpeg),
        }
    }

    /// Reads the part of an experience that begins so many bytes before its record.
    fn read_blob(
        &self,
        (location, back): (Location, u32),
        expected: Envelope,
        payload: &mut Vec<u8>,
    ) -> Result<(), StorageError> {
        let Segment::Log(log) = self.segment(location)? else {
            return Err(self.damaged(location, "it has no parts"));
        };
        let offset = location.offset().checked_sub(u64::from(back));
        match offset.map(|offset| log.read_into(offset, payload)).transpose()? {
            Some(envelope) if envelope == expected => Ok(()),
            _ => Err(self.damaged(location, "it points to what is not its own")),
        }
    }

    fn old_experience(
        &self,
        journal: &version_1::Journal,
        location: Location,
    ) -> Result<(version_1::ExperienceRecord, Option<f32>), StorageError> {
        let record = journal.read(location.offset())?;
        record.into_experience().ok_or_else(|| self.damaged(location, "it is no experience"))
    }

    fn segment(&self, location: Location) -> Result<&Segment, StorageError> {
        self.segments.get(&location.segment()).ok_or_else(|| self.missing(location.segment()))
    }

    pub(super) fn path_of(&self, number: u32) -> PathBuf {
        self.folder.path().join(segment_name(number))
    }

    pub(super) fn missing(&self, number: u32) -> StorageError {
        missing(&self.path_of(number))
    }

    pub(super) fn damaged(&self, location: Location, reason: &str) -> StorageError {
        let reason = format!("record at byte {}: {reason}", location.offset());
        StorageError::Damaged { path: self.path_of(location.segment()), reason }
    }
}
