//! Everything that a map's files say, read to the last byte: checksums, contents, and the snapshot against what the
//! journal gives without it.
//!
//! Opening a map is stricter and quicker: it stops at the first damage, and leaves out what it need not read. Whether
//! it can do with what is wrong, only opening the map tells.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::MapError;
use super::contents::{Contents, Location, MAX_SEGMENT};
use super::inspection::{Flaw, Inspected, Said, inspect};
use super::journal::{Position, segment_name, segment_numbers};
use super::map::PlaceMap;
use super::map_opening::READER_ATTEMPTS;
use super::snapshot::{self, Snapshot};
use crate::storage::{AppendFile, DiskFolder, Folder, LOG_HEADER_BYTES, StorageError};

/// Problems that are listed; more are only counted.
const MAX_PROBLEMS: usize = 1000;

/// What [`PlaceMap::verify`] read, and what is wrong with it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verification {
    /// Segments of the journal.
    pub segments: usize,
    /// Whole records in them.
    pub records: u64,
    /// Bytes of the segments and the snapshot.
    pub bytes: u64,
    /// What is to be said of the snapshot.
    pub snapshot: SnapshotState,
    /// What is wrong with it and what helps, if it is useless or wrong.
    pub snapshot_fault: Option<String>,
    /// What is wrong with the journal, in the order of the files; at most a thousand problems.
    pub problems: Vec<Problem>,
    /// Number of problems beyond those.
    pub further_problems: u64,
    /// Why the map cannot be opened to be written, if it cannot.
    pub refusal: Option<String>,
}

/// What is to be said of a map's snapshot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SnapshotState {
    /// There is none: the map opens more slowly, and is the same.
    #[default]
    Missing,
    /// The map is the same with it and without it.
    Right,
    /// It cannot be read or is not of this journal: the map opens without it.
    Useless,
    /// The map opens with it, and is another one without it.
    Wrong,
    /// The journal is damaged, so there is nothing to compare it with.
    NotCompared,
}

/// Something that is wrong with a map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The file; the map's folder, where it is no single one.
    pub path: PathBuf,
    /// Where in the file, in bytes, if it is at one place.
    pub offset: Option<u64>,
    /// What is wrong.
    pub reason: String,
    /// Whether it is a torn tail, which the next writer cuts off.
    pub is_torn_tail: bool,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        if let Some(offset) = self.offset {
            write!(f, ", byte {offset}")?;
        }
        write!(f, ": {}", self.reason)
    }
}

impl Verification {
    /// Whether more is wrong with the journal than a torn tail.
    #[must_use]
    pub fn is_damaged(&self) -> bool {
        self.further_problems > 0 || self.problems.iter().any(|problem| !problem.is_torn_tail)
    }

    fn add(&mut self, problem: Problem) {
        if self.problems.len() < MAX_PROBLEMS {
            self.problems.push(problem);
        } else {
            self.further_problems += 1;
        }
    }

    fn add_damage(&mut self, path: PathBuf, offset: Option<u64>, reason: impl Into<String>) {
        self.add(Problem { path, offset, reason: reason.into(), is_torn_tail: false });
    }
}

impl PlaceMap {
    /// Reads every record of the map in `folder` to the last byte and lists everything that is wrong, also where the
    /// map cannot be opened. Nothing is changed; another process may write the map meanwhile. `progress` hears how
    /// many of how many bytes were read.
    ///
    /// # Errors
    /// If there is no map, or the system does not let its files be read.
    pub fn verify(folder: &Path, progress: &dyn Fn(u64, u64)) -> Result<Verification, MapError> {
        if !folder.is_dir() {
            return Err(MapError::Missing { path: folder.to_owned() });
        }
        let folder = DiskFolder::new(folder);
        for _ in 1..READER_ATTEMPTS {
            let (verification, was_disturbed) = Verifier::verify(&folder, progress)?;
            if !was_disturbed {
                return Ok(verification);
            }
        }
        Ok(Verifier::verify(&folder, progress)?.0)
    }
}

/// A segment that will be read.
struct OpenSegment {
    number: u32,
    path: PathBuf,
    file: Arc<dyn AppendFile>,
    length_bytes: u64,
}

/// What may be wrong with the snapshot.
enum Doubt {
    /// It cannot be read: what is said of that.
    Unreadable(String),
    /// It speaks of a segment that is not there.
    Missing(PathBuf),
    /// It says something else than the journal.
    Otherwise(String),
}

/// What a snapshot says, brought up to the end of the journal by what follows it there.
struct Shortcut {
    position: Position,
    /// Whether a record begins, or the journal ends, at the position.
    is_anchored: bool,
    contents: Contents,
}

impl Shortcut {
    /// Takes note of what stands at `here`.
    fn follow(&mut self, here: Position, said: Option<&Said<'_>>, length_bytes: u64) {
        self.is_anchored |= here == self.position;
        if let Some(said) = said
            && (here.segment, here.offset) >= (self.position.segment, self.position.offset)
        {
            // A complaint is heard from the journal's own replay.
            let _ = said.apply(&mut self.contents, Location::new(here.segment, here.offset), length_bytes);
        }
    }
}

struct Verifier<'a> {
    folder: &'a dyn Folder,
    found: Verification,
    /// What the journal alone gives.
    replayed: Contents,
    shortcut: Option<Shortcut>,
    doubt: Option<Doubt>,
    /// A segment that ends, at that byte, before the snapshot was taken; and what is to be said if that is damage.
    lost_end: Option<(PathBuf, u64, String)>,
    /// A writer got in the way.
    was_disturbed: bool,
}

impl<'a> Verifier<'a> {
    /// What is to be said of the map, and whether a writer got in the way.
    fn verify(folder: &'a dyn Folder, progress: &dyn Fn(u64, u64)) -> Result<(Verification, bool), MapError> {
        let mut verifier = Self {
            folder,
            found: Verification::default(),
            replayed: Contents::default(),
            shortcut: None,
            doubt: None,
            lost_end: None,
            was_disturbed: false,
        };
        // First, so that the journal is at least as new.
        verifier.read_snapshot()?;
        let segments = verifier.open_segments()?;
        let total_bytes = segments.iter().map(|segment| segment.length_bytes).sum();
        let mut read_bytes = 0;
        for (index, segment) in segments.iter().enumerate() {
            let is_last = index + 1 == segments.len();
            verifier.read_segment(segment, is_last, &|offset| {
                // A segment may have grown since.
                progress((read_bytes + offset).min(total_bytes), total_bytes);
            });
            read_bytes += segment.length_bytes;
        }
        verifier.found.segments = segments.len();
        verifier.found.bytes += read_bytes;
        verifier.conclude(&segments);
        verifier.open();
        Ok((verifier.found, verifier.was_disturbed))
    }

    fn read_snapshot(&mut self) -> Result<(), StorageError> {
        match snapshot::read(self.folder) {
            Ok(None) => {}
            Ok(Some(Snapshot { position, contents, length_bytes })) => {
                self.found.bytes += length_bytes;
                self.found.snapshot = SnapshotState::NotCompared;
                self.shortcut = Some(Shortcut { position, is_anchored: false, contents });
            }
            Err(error @ StorageError::Io { .. }) => return Err(error),
            Err(StorageError::Damaged { path, reason }) => {
                let useless = StorageError::Useless { path, reason };
                self.doubt = Some(Doubt::Unreadable(useless.to_string()));
            }
            Err(error) => self.doubt = Some(Doubt::Unreadable(error.to_string())),
        }
        Ok(())
    }

    /// Opens all segments at once: a writer may delete them meanwhile.
    fn open_segments(&mut self) -> Result<Vec<OpenSegment>, MapError> {
        let numbers = segment_numbers(self.folder)?;
        if numbers.is_empty() {
            let missing = || MapError::Missing { path: self.folder.path().to_owned() };
            // Where there is a snapshot still, the journal is gone.
            return Err(PlaceMap::open_read_only(self.folder.path()).err().unwrap_or_else(missing));
        }
        for pair in numbers.windows(2).filter(|pair| pair[1] - pair[0] > 1) {
            let reason = match pair[1] - pair[0] - 1 {
                1 => "the segment is missing".to_owned(),
                count => format!("{count} segments from this one on are missing"),
            };
            self.found.add_damage(self.path_of(pair[0] + 1), None, reason);
        }
        let mut segments = Vec::new();
        for number in numbers {
            let path = self.path_of(number);
            if number > MAX_SEGMENT {
                let reason = format!("a segment's number is at most {MAX_SEGMENT}");
                self.found.add_damage(path, None, reason);
                continue;
            }
            let opened = self.folder.open(&segment_name(number), false);
            match opened.and_then(|file| file.length_bytes().map(|length_bytes| (file, length_bytes))) {
                Ok((file, length_bytes)) => segments.push(OpenSegment { number, path, file, length_bytes }),
                Err(error) if error.kind() == io::ErrorKind::NotFound => {
                    self.was_disturbed = true;
                    self.found.add_damage(path, None, "the segment is missing");
                }
                Err(error) => return Err(StorageError::io("open", &path)(error).into()),
            }
        }
        Ok(segments)
    }

    fn read_segment(&mut self, segment: &OpenSegment, is_last: bool, progress: &dyn Fn(u64)) {
        let stood = self.shortcut.as_ref().map(|shortcut| shortcut.position).unwrap_or_default();
        // What the snapshot stands for had been on the medium before it was written.
        let durable_bytes = match stood.segment.cmp(&segment.number) {
            std::cmp::Ordering::Equal if is_last => stood.offset,
            std::cmp::Ordering::Less if is_last => 0,
            _ => u64::MAX,
        };
        let mut end = LOG_HEADER_BYTES;
        let mut is_torn = false;
        let read = inspect((segment.number, &segment.file, &segment.path), durable_bytes, &mut |inspected| {
            is_torn |= matches!(inspected.found, Err(Flaw::TornTail));
            if !matches!(inspected.found, Err(Flaw::TornTail)) {
                end = inspected.offset + inspected.length_bytes;
            }
            self.take(segment, &inspected);
            progress(end);
        });
        if let Err(error) = read {
            self.found.add_damage(segment.path.clone(), None, error.reason());
        } else if stood.segment == segment.number && end < stood.offset {
            let reason =
                format!("the segment ends here, but had {} bytes when the snapshot was taken", stood.offset);
            self.lost_end = Some((segment.path.clone(), end, reason));
        }
        if let Some(shortcut) = &mut self.shortcut {
            shortcut.follow(Position { segment: segment.number, offset: end }, None, 0);
        }
        // Then the tail was not torn: the writer was just writing it.
        self.was_disturbed |= is_torn && segment.file.length_bytes().ok() != Some(segment.length_bytes);
    }

    fn take(&mut self, segment: &OpenSegment, inspected: &Inspected<'_>) {
        let &Inspected { offset, length_bytes, ref found } = inspected;
        if let Some(shortcut) = &mut self.shortcut {
            shortcut.follow(Position { segment: segment.number, offset }, found.as_ref().ok(), length_bytes);
        }
        let location = Location::new(segment.number, offset);
        let path = segment.path.clone();
        match found {
            Ok(said) => match said.apply(&mut self.replayed, location, length_bytes) {
                Ok(()) => self.found.records += 1,
                Err(reason) => {
                    self.found.add_damage(path, Some(offset), format!("{}: {reason}", said.name()));
                }
            },
            Err(Flaw::Doubtful { reason, .. } | Flaw::Bad { reason, .. }) => {
                self.found.add_damage(path, Some(offset), reason.as_str())
            }
            Err(Flaw::TornTail) => {
                let reason = format!("{length_bytes} bytes of a torn tail, which count for nothing");
                self.found.add(Problem { path, offset: Some(offset), reason, is_torn_tail: true });
            }
        }
    }

    /// What can be said only once everything was read.
    fn conclude(&mut self, segments: &[OpenSegment]) {
        if let Err(reason) = self.replayed.settle() {
            self.found.add_damage(self.folder.path().to_owned(), None, reason);
        }
        let Some(Shortcut { position, is_anchored, mut contents }) = self.shortcut.take() else { return };
        let is_there = |number: &u32| segments.iter().any(|segment| segment.number == *number);
        let is_past = segments.first().is_some_and(|first| position.segment < first.number);
        let missing = contents.locations().map(Location::segment).find(|number| !is_there(number));
        if let Some(number) =
            missing.or((!is_past && !is_there(&position.segment)).then_some(position.segment))
        {
            self.doubt = Some(Doubt::Missing(self.path_of(number)));
        } else if self.found.is_damaged() || self.lost_end.is_some() {
            // With what remains of the journal, any snapshot would differ.
        } else if !is_past && !is_anchored {
            let Position { segment, offset } = position;
            let segment = segment_name(segment);
            let reason = format!("it was taken at byte {offset} of {segment}, where no record begins");
            self.doubt = Some(Doubt::Otherwise(reason));
        } else {
            self.doubt =
                contents.settle().err().or_else(|| self.replayed.difference(&contents)).map(Doubt::Otherwise);
            if self.doubt.is_none() {
                self.found.snapshot = SnapshotState::Right;
            }
        }
    }

    /// Opens the map if anything is wrong: so what is said of it is what everybody hears who opens it.
    fn open(&mut self) {
        if self.doubt.is_none() && !self.found.is_damaged() && self.lost_end.is_none() {
            return;
        }
        let opened = PlaceMap::open_sound(self.folder.path());
        let fault = opened.as_ref().ok().and_then(PlaceMap::snapshot_fault);
        // A snapshot of another map says nothing of where this one's segments end.
        if !matches!(fault, Some(StorageError::Useless { .. }))
            && let Some((segment, end, reason)) = self.lost_end.take()
        {
            self.found.add_damage(segment, Some(end), reason);
        }
        if let Some(ahead @ StorageError::Ahead { .. }) = fault {
            self.found.refusal = Some(ahead.to_string());
            return;
        }
        let fault = fault.map(ToString::to_string);
        self.found.refusal = opened.err().map(|error| error.to_string());
        let said = match (self.doubt.take(), fault) {
            (_, Some(fault)) | (Some(Doubt::Unreadable(fault)), None) => (SnapshotState::Useless, fault),
            (Some(Doubt::Otherwise(reason)), None) => {
                let path = self.folder.path().join(snapshot::NAME);
                let fault = format!("{}: {reason}; delete it, the journal has everything", path.display());
                (SnapshotState::Wrong, fault)
            }
            (Some(Doubt::Missing(segment)), None) => {
                let reason = "the segment is missing, the snapshot speaks of it";
                return self.found.add_damage(segment, None, reason);
            }
            (None, None) => return,
        };
        (self.found.snapshot, self.found.snapshot_fault) = (said.0, Some(said.1));
    }

    fn path_of(&self, number: u32) -> PathBuf {
        self.folder.path().join(segment_name(number))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::fs;

    use proptest::prelude::*;

    use super::*;
    use crate::place_map::format::{self, EXPERIENCE, FEATURES, PLACE, THINNED, THUMBNAIL, ThinnedRecord};
    use crate::place_map::journal::segment_identity;
    use crate::place_map::tests::{SMALL, knowledge, learn};
    use crate::place_map::{Durability, ExperienceId, MapOptions, PlaceId};
    use crate::storage::{Envelope, Reading, RecordLog, Surveyed, Tail};

    const JOURNAL: &str = "journal-000001.loci";

    fn verified(folder: &Path) -> Verification {
        PlaceMap::verify(folder, &|done, total| assert!(done <= total)).unwrap()
    }

    fn fixture(version: u32) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/data/map/version_{version}"))
    }

    fn copied(folder: &Path) -> tempfile::TempDir {
        let copy = tempfile::tempdir().unwrap();
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            fs::copy(&path, copy.path().join(path.file_name().unwrap())).unwrap();
        }
        copy
    }

    /// A map of several segments, with its snapshot.
    fn large_map() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let mut map = PlaceMap::open(folder.path(), SMALL).unwrap();
        for index in 0..100 {
            learn(&mut map, (index % 7 > 0).then_some(PlaceId(0)), index, index % 3 == 0).unwrap();
        }
        map.close().unwrap();
        folder
    }

    /// A map of one segment with every kind of record, and where the first of each is.
    fn map_of_all_kinds() -> (tempfile::TempDir, BTreeMap<u8, (u64, u64)>) {
        let folder = tempfile::tempdir().unwrap();
        let options = MapOptions { place_experiences: 3, durability: Durability::Every, ..SMALL };
        let mut map = PlaceMap::open(folder.path(), options).unwrap();
        for index in 0..6 {
            learn(&mut map, (index > 0).then_some(PlaceId(0)), index, true).unwrap();
        }
        map.close().unwrap();
        let file = DiskFolder::new(folder.path()).open(JOURNAL, false).unwrap();
        let mut first = BTreeMap::new();
        RecordLog::survey(file, segment_identity(1, Path::new(JOURNAL)), 0, &mut |surveyed| {
            let Surveyed::Whole(record) = surveyed else { panic!("{surveyed:?}") };
            first.entry(record.envelope.kind).or_insert((record.offset, record.length_bytes));
        })
        .unwrap();
        (folder, first)
    }

    fn flip(path: &Path, position: u64) {
        let mut bytes = fs::read(path).unwrap();
        bytes[position as usize] ^= 1;
        fs::write(path, bytes).unwrap();
    }

    #[test]
    fn a_sound_map_is_read_to_its_last_byte_and_not_changed() {
        let map = large_map();
        for folder in [map.path(), &fixture(1), &fixture(2)] {
            let files = || -> BTreeMap<_, _> {
                let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
                entries.map(|path| (path.clone(), fs::read(path).unwrap())).collect()
            };
            let before = files();
            let found = verified(folder);
            assert_eq!(found.problems, []);
            let is_read = |path: &&PathBuf| path.extension().is_some_and(|extension| extension == "loci");
            let bytes: usize = before.keys().filter(is_read).map(|path| before[path].len()).sum();
            assert_eq!(found.bytes, bytes as u64);
            let has_snapshot = folder.join(snapshot::NAME).exists();
            let expected = if has_snapshot { SnapshotState::Right } else { SnapshotState::Missing };
            assert_eq!(found.snapshot, expected);
            assert!(before == files());
        }
        assert!(verified(map.path()).segments > 3);
        assert_eq!(verified(&fixture(1)).records, 8);
    }

    #[test]
    fn a_flipped_byte_in_each_kind_of_record_is_found_and_named() {
        let (map, first) = map_of_all_kinds();
        let kinds = [PLACE, EXPERIENCE, FEATURES, THUMBNAIL, THINNED];
        let names = ["place", "experience", "features", "thumbnail", "given up"];
        for (Envelope { kind, .. }, name) in kinds.into_iter().zip(names) {
            let (offset, length_bytes) = first[&kind];
            for (position, named) in [(offset + length_bytes - 1, name), (offset + 9, "no whole record")] {
                let copy = copied(map.path());
                flip(&copy.path().join(JOURNAL), position);
                let found = verified(copy.path());
                assert!(found.is_damaged() && found.snapshot == SnapshotState::NotCompared, "{found:?}");
                let problem = &found.problems[0];
                assert_eq!((problem.path.clone(), problem.offset), (copy.path().join(JOURNAL), Some(offset)));
                assert!(problem.reason.contains(named), "{problem}");
            }
        }
    }

    #[test]
    fn no_flipped_byte_of_any_version_goes_unnoticed() {
        for (version, name) in [(1, JOURNAL), (2, JOURNAL), (2, snapshot::NAME)] {
            let copy = copied(&fixture(version));
            let path = copy.path().join(name);
            let bytes = fs::read(&path).unwrap();
            // The zeros in the header of a journal mean nothing.
            for position in
                (0..bytes.len()).filter(|position| name != JOURNAL || !(12..16).contains(position))
            {
                let mut flipped = bytes.clone();
                flipped[position] ^= 1;
                fs::write(&path, flipped).unwrap();
                let found = verified(copy.path());
                let is_noticed = match name {
                    snapshot::NAME => found.snapshot_fault.is_some(),
                    _ => found.is_damaged() || version == 1 && !found.problems.is_empty(),
                };
                assert!(is_noticed, "byte {position} of {name}, version {version}: {found:?}");
            }
        }
    }

    #[test]
    fn every_problem_is_found_and_not_only_the_first() {
        let map = large_map();
        let segment = |number| map.path().join(segment_name(number));
        for (number, position) in [(1, 17), (1, 5000), (3, 60_000)] {
            flip(&segment(number), position);
        }
        fs::remove_file(segment(2)).unwrap();
        flip(&map.path().join(snapshot::NAME), 100);
        assert!(PlaceMap::open_read_only(map.path()).is_err());
        let found = verified(map.path());
        let count = |path: &Path| found.problems.iter().filter(|problem| problem.path == path).count();
        assert!(count(&segment(1)) >= 2, "{:?}", found.problems);
        assert_eq!((count(&segment(2)), found.snapshot), (1, SnapshotState::Useless));
        assert!(found.refusal.as_ref().unwrap().ends_with("restore it from a copy"));
        assert!(count(&segment(3)) >= 1 && found.records > 50, "{found:?}");
    }

    #[test]
    fn a_torn_tail_is_told_from_damage() {
        let (map, _) = map_of_all_kinds();
        let path = map.path().join(JOURNAL);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, [&bytes[..], &[7; 40]].concat()).unwrap();
        let found = verified(map.path());
        assert_eq!((found.problems.len(), found.is_damaged()), (1, false), "{found:?}");
        assert_eq!(found.problems[0].offset, Some(bytes.len() as u64));
        assert_eq!(found.snapshot, SnapshotState::Right);
        // Bytes that the snapshot stands for had been on the medium.
        fs::write(&path, &bytes[..bytes.len() - 3]).unwrap();
        assert!(verified(map.path()).is_damaged());
        let last = verified(&fixture(1)).bytes - 3;
        let old = copied(&fixture(1));
        fs::File::options().write(true).open(old.path().join(JOURNAL)).unwrap().set_len(last).unwrap();
        let found = verified(old.path());
        assert!(found.problems.len() == 1 && !found.is_damaged(), "{found:?}");
    }

    #[test]
    fn of_a_snapshot_that_says_otherwise_is_said_what_opening_the_map_makes_of_it() {
        let (map, _) = map_of_all_kinds();
        let folder = DiskFolder::new(map.path());
        let Snapshot { position, contents, .. } = snapshot::read(&folder).unwrap().unwrap();
        let said = |position, contents: &Contents| {
            snapshot::write(&folder, position, contents).unwrap();
            let found = verified(map.path());
            assert_eq!((&found.problems, &found.refusal), (&Vec::new(), &None));
            let said = found.snapshot_fault.unwrap();
            let opened = PlaceMap::open_read_only(map.path()).unwrap();
            match opened.snapshot_fault() {
                Some(fault) => {
                    assert_eq!((found.snapshot, fault.to_string()), (SnapshotState::Useless, said.clone()));
                }
                None => {
                    assert_eq!(found.snapshot, SnapshotState::Wrong);
                    assert!(said.ends_with("; delete it, the journal has everything"), "{said}");
                }
            }
            said
        };
        let mut other = contents.clone();
        let id = *other.experiences.keys().next().unwrap();
        other.experiences.get_mut(&id).unwrap().view ^= 1;
        assert!(said(position, &other).contains(&format!("otherwise of experience {}", id.0)));
        let mut other = contents.clone();
        other.places.get_mut(&PlaceId(0)).unwrap().name = Some("hall".into());
        assert!(said(position, &other).contains("otherwise of place 0"));
        let mut other = contents.clone();
        other.remove_experience(ExperienceId(5));
        assert!(said(position, &other).contains("otherwise of experience 5"));
        let mut other = contents.clone();
        let place = contents.places[&PlaceId(0)].clone();
        other.put_place(place.record(), place.location, 1 << 30);
        assert!(said(position, &other).contains("it speaks of more than there is"));
        let inside = Position { offset: position.offset - 1, ..position };
        assert!(said(inside, &contents).contains("no record begins"));
        snapshot::write(&folder, Position { segment: 9, ..position }, &contents).unwrap();
        let refusal = verified(map.path()).refusal.unwrap();
        assert!(
            refusal.contains("knows more than the journal beside it: journal-000009.loci is missing"),
            "{refusal}"
        );
    }

    #[test]
    fn contents_that_make_no_sense_behind_a_right_checksum_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = DiskFolder::new(folder.path()).open(JOURNAL, true).unwrap();
        let reading = Reading { from: 0, wanted: |_| true, visit: &mut |_| Ok(()) };
        let (mut log, _) =
            RecordLog::open(file, segment_identity(1, Path::new(JOURNAL)), Tail::Mended, reading).unwrap();
        let thinned = format::encode(&ThinnedRecord::new(&[ExperienceId(3)])).unwrap();
        let foreign = Envelope { kind: 9, version: 1 };
        let records = [(FEATURES, &b"x"[..]), (THINNED, &thinned), (PLACE, b"y"), (foreign, b"z")];
        let offsets = log.append(&records).unwrap();
        let found = verified(folder.path());
        assert_eq!(found.records, 1);
        let offsets = [offsets[0], offsets[2], offsets[3]].map(Some);
        assert_eq!(found.problems.iter().map(|problem| problem.offset).collect::<Vec<_>>(), offsets);
        assert!(found.problems[2].reason.contains("update Loci"), "{:?}", found.problems);
    }

    #[test]
    fn a_map_is_sound_while_another_thread_writes_and_compacts_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut map = PlaceMap::open(folder.path(), SMALL).unwrap();
        let writer = std::thread::spawn(move || {
            for index in 0..1500 {
                let place = (index >= 50).then(|| PlaceId((index * 7 % 50) as u32));
                learn(&mut map, place, index, index % 5 == 0).unwrap();
                if index % 400 == 399 {
                    map.compact().unwrap();
                }
            }
        });
        let mut rounds = 0;
        while !writer.is_finished() {
            let found = verified(folder.path());
            // A busy machine may halt the writer in the midst of a record.
            let is_sound = found.problems.iter().all(|problem| problem.is_torn_tail);
            assert!(is_sound, "round {rounds}: {:?}", found.problems);
            rounds += 1;
        }
        writer.join().unwrap();
        assert!(rounds > 3, "{rounds} rounds");
    }

    #[test]
    fn a_missing_map_is_named() {
        let folder = tempfile::tempdir().unwrap();
        for path in [folder.path().to_owned(), folder.path().join("gone")] {
            let error = PlaceMap::verify(&path, &|_, _| ()).unwrap_err().to_string();
            assert!(error.contains("no map in"), "{error}");
        }
    }

    proptest! {
        #[test]
        fn what_verify_lets_pass_opens_and_reads_to_the_last_thumbnail(
            flips in proptest::collection::vec((16..1259_usize, 0..8_u8), 0..3), cut in 1000..1300_usize,
        ) {
            let copy = copied(&fixture(2));
            fs::remove_file(copy.path().join(snapshot::NAME)).unwrap();
            let mut bytes = fs::read(copy.path().join(JOURNAL)).unwrap();
            for (position, bit) in flips {
                bytes[position] ^= 1 << bit;
            }
            bytes.truncate(cut);
            fs::write(copy.path().join(JOURNAL), bytes).unwrap();
            let found = verified(copy.path());
            match PlaceMap::open_read_only(copy.path()) {
                Ok(map) => {
                    prop_assert_eq!(found.problems.is_empty(), map.summary().torn_bytes == 0);
                    if !found.is_damaged() {
                        knowledge(&map);
                    }
                }
                Err(_) => prop_assert!(found.is_damaged()),
            }
        }
    }
}
