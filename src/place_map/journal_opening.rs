//! How a journal is opened: its segments are read, from where its snapshot stands if that proves to be the journal's
//! own, else from the beginning. Only once what they say is sound is a torn tail cut or a segment begun.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::contents::{Contents, Location, MAX_SEGMENT};
use super::format::{FEATURES, KIND, THUMBNAIL, is_known};
use super::journal::{Journal, Position, Segment, missing, segment_identity, segment_name, segment_numbers};
use super::replay::{apply, apply_version_1};
use super::salvage::PassedOver;
use super::snapshot::{self, Snapshot};
use super::version_1;
use crate::storage::{
    AppendFile, Envelope, Folder, LoggedRecord, Reading, RecordLog, Recovery, StorageError, Tail, log_kind,
};

/// Behind every record there can be.
pub(super) const BEHIND_ALL: Position = Position { segment: u32::MAX, offset: 0 };

/// A journal, and what it says.
pub(super) struct Opened {
    pub(super) journal: Journal,
    pub(super) contents: Contents,
    pub(super) recovery: Recovery,
    /// Why the snapshot was of no use.
    pub(super) snapshot_fault: Option<StorageError>,
    /// What was passed over, if it was opened around damage.
    pub(super) passed_over: Option<PassedOver>,
}

/// A segment that was not read yet.
pub(super) struct SegmentFile {
    pub(super) number: u32,
    pub(super) path: PathBuf,
    pub(super) file: Arc<dyn AppendFile>,
    pub(super) length_bytes: u64,
    /// What its end may be like; nothing is mended here.
    pub(super) tail: Tail,
}

impl SegmentFile {
    pub(super) fn is_version_1(&self) -> Result<bool, StorageError> {
        Ok(log_kind(self.file.as_ref(), &self.path)? == (KIND.magic, version_1::VERSION))
    }
}

impl Journal {
    /// Opens the journal in `folder`, whose `snapshot` saves reading it from the beginning if it is the journal's own.
    /// With `writable` a torn tail is cut off, and an empty folder gets a first segment.
    ///
    /// # Errors
    /// If a segment is missing, damaged, newer than this program, or the medium fails.
    pub(super) fn open(
        folder: &Arc<dyn Folder>,
        writable: bool,
        snapshot: Option<Snapshot>,
    ) -> Result<Opened, StorageError> {
        let files = open_files(folder.as_ref(), writable)?;
        let useless = |reason| StorageError::Useless { path: folder.path().join(snapshot::NAME), reason };
        let mut snapshot_fault = None;
        let mut start = Snapshot::default();
        if let Some(snapshot) = snapshot {
            match at(folder, &files, BEHIND_ALL, &mut Contents::default())?.0.disowns(&snapshot) {
                Ok(None) => start = snapshot,
                Ok(Some(reason)) => snapshot_fault = Some(useless(reason)),
                // What the journal has lost is not lost for good by reading what it has.
                Err(ahead @ StorageError::Ahead { .. }) if !writable => snapshot_fault = Some(ahead),
                Err(error) => return Err(error),
            }
        }
        let has_snapshot = start.position != Position::default();
        let Snapshot { position, mut contents, .. } = start;
        let (mut journal, mut recovery) = at(folder, &files, position, &mut contents)?;
        let mut settled = journal.settle(&mut contents);
        if has_snapshot && let Err(StorageError::Damaged { reason, .. }) = settled {
            snapshot_fault = Some(useless(reason));
            contents = Contents::default();
            (journal, recovery) = at(folder, &files, Position::default(), &mut contents)?;
            settled = journal.settle(&mut contents);
        }
        settled?;
        if writable {
            journal.make_writable()?;
        }
        Ok(Opened { journal, contents, recovery, snapshot_fault, passed_over: None })
    }

    /// Puts together what was read of the journal, if it makes sense.
    pub(super) fn settle(&self, contents: &mut Contents) -> Result<(), StorageError> {
        let is_gone = |location: &Location| !self.segments.contains_key(&location.segment());
        if let Some(gone) = contents.locations().find(is_gone) {
            return Err(self.missing(gone.segment()));
        }
        let damaged = |reason| StorageError::Damaged { path: self.folder.path().to_owned(), reason };
        if contents.live_bytes > self.total_bytes() {
            return Err(damaged("it speaks of more than there is".to_owned()));
        }
        contents.settle().map_err(damaged)
    }

    pub(super) fn make_writable(&mut self) -> Result<(), StorageError> {
        match self.segments.last_key_value() {
            Some((&last, Segment::Log(log))) => {
                log.mend(segment_identity(last, &self.path_of(last)))?;
                self.watch();
                Ok(())
            }
            Some((&last, Segment::Version1(journal))) => {
                // Whoever wrote it may have left that to the system.
                journal.sync()?;
                self.begin_segment(last + 1)
            }
            None => self.begin_segment(1),
        }
    }
}

/// The segment at `path` has a record that this program does not know.
pub(super) fn newer_records(path: &Path, Envelope { kind, version }: Envelope) -> StorageError {
    StorageError::NewerRecords { path: path.to_owned(), kind, version }
}

/// Opens all segments before any is read: a writer may delete some meanwhile.
pub(super) fn open_files(folder: &dyn Folder, writable: bool) -> Result<Vec<SegmentFile>, StorageError> {
    let numbers = segment_numbers(folder)?;
    let open = |number: u32| {
        let name = segment_name(number);
        let path = folder.path().join(&name);
        let is_last = numbers.last() == Some(&number);
        let opened =
            folder.open(&name, is_last && writable).and_then(|file| Ok((file.length_bytes()?, file)));
        let (length_bytes, file) = opened.map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => missing(&path),
            _ => StorageError::io("open", &path)(error),
        })?;
        let tail = if is_last { Tail::Ignored } else { Tail::Sealed };
        Ok(SegmentFile { number, path, file, length_bytes, tail })
    };
    let (Some(&first), Some(&last)) = (numbers.first(), numbers.last()) else { return Ok(Vec::new()) };
    if last > MAX_SEGMENT {
        let reason = format!("a segment's number is at most {MAX_SEGMENT}; move it away");
        let path = folder.path().join(segment_name(last));
        return Err(StorageError::io("open", &path)(io::Error::other(reason)));
    }
    (first..=last).map(open).collect()
}

/// The journal of `files`, and in `contents` what it says from `position` on.
fn at(
    folder: &Arc<dyn Folder>,
    files: &[SegmentFile],
    position: Position,
    contents: &mut Contents,
) -> Result<(Journal, Recovery), StorageError> {
    let mut segments = BTreeMap::new();
    let mut recovery = Recovery::default();
    for file in files {
        let from = match file.number.cmp(&position.segment) {
            Ordering::Less => file.length_bytes,
            Ordering::Equal => position.offset,
            Ordering::Greater => 0,
        };
        let (segment, found) = read(file, from, contents)?;
        recovery.records += found.records;
        recovery.torn_bytes += found.torn_bytes;
        segments.insert(file.number, segment);
    }
    Ok((Journal::of(Arc::clone(folder), segments), recovery))
}

fn read(
    segment: &SegmentFile,
    from: u64,
    contents: &mut Contents,
) -> Result<(Segment, Recovery), StorageError> {
    let SegmentFile { number, path, file, tail, .. } = segment;
    if segment.is_version_1()? {
        let mut visit = |offset, length, record| {
            apply_version_1(contents, Location::new(*number, offset), length, record)
        };
        let (journal, mut recovery) = version_1::Journal::open(Arc::clone(file), path, from, &mut visit)?;
        if *tail == Tail::Sealed {
            // A torn tail that was there when the map went on in the next segment is no news.
            recovery.torn_bytes = 0;
        }
        return Ok((Segment::Version1(journal), recovery));
    }
    let mut newer = None;
    let mut visit = |record: LoggedRecord<'_>| {
        let LoggedRecord { offset, envelope, payload, length_bytes } = record;
        let Some(payload) = payload else { return Ok(()) };
        newer = newer.or((!is_known(envelope)).then_some(envelope));
        apply(contents, Location::new(*number, offset), (envelope, payload), length_bytes)
    };
    let wanted = |envelope| envelope != FEATURES && envelope != THUMBNAIL;
    let reading = Reading { from, wanted, visit: &mut visit };
    let opened = RecordLog::open(Arc::clone(file), segment_identity(*number, path), *tail, reading);
    match newer {
        Some(envelope) => Err(newer_records(path, envelope)),
        None => opened.map(|(log, recovery)| (Segment::Log(log), recovery)),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;
    use crate::place_map::batch::Batch;
    use crate::place_map::format::{self, PLACE, PlaceRecord, THINNED, ThinnedRecord};
    use crate::place_map::tests::{SMALL, found, knowledge, learn};
    use crate::place_map::{Durability, ExperienceId, MapOptions, PlaceId, PlaceMap};
    use crate::storage::DiskFolder;

    /// Nothing but the snapshot says what is on the medium.
    const UNSYNCED: MapOptions = MapOptions { durability: Durability::None, ..SMALL };

    /// A map of the places `numbers`, closed.
    fn map_of(numbers: std::ops::Range<u64>) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        grow(folder.path(), numbers);
        folder
    }

    fn grow(folder: &Path, numbers: std::ops::Range<u64>) {
        let mut map = PlaceMap::open(folder, UNSYNCED).unwrap();
        numbers.for_each(|number| drop(learn(&mut map, None, number, true).unwrap()));
        map.close().unwrap();
    }

    /// The bytes of all segments.
    fn journal(folder: &Path) -> Vec<Vec<u8>> {
        let numbers = segment_numbers(&DiskFolder::new(folder)).unwrap();
        numbers.iter().map(|&number| fs::read(folder.join(segment_name(number))).unwrap()).collect()
    }

    fn snapshot_of(folder: &Path) -> Snapshot {
        snapshot::read(&DiskFolder::new(folder)).unwrap().unwrap()
    }

    /// Opens the map with and without its snapshot and asserts that both are the same and no byte of the journal was
    /// changed; answers what is wrong with the snapshot.
    fn fault(folder: &Path) -> String {
        let before = journal(folder);
        let map = PlaceMap::open(folder, UNSYNCED).unwrap();
        let (with, fault) = (knowledge(&map), map.snapshot_fault().map(ToString::to_string));
        drop(map);
        assert!(journal(folder) == before, "the journal was changed");
        fs::remove_file(folder.join(snapshot::NAME)).unwrap();
        assert_eq!(with, knowledge(&PlaceMap::open_read_only(folder).unwrap()));
        fault.unwrap()
    }

    fn refusal(folder: &Path) -> String {
        let before = journal(folder);
        let error = PlaceMap::open(folder, UNSYNCED).err().unwrap().to_string();
        assert!(journal(folder) == before, "the journal was changed");
        error
    }

    #[test]
    fn a_snapshot_of_another_map_is_not_used_and_costs_no_record() {
        // Taken at the end of a run, and where a segment ends.
        for others in [100..105, 100..118, 100..150] {
            let (map, other) = (map_of(0..90), map_of(others));
            fs::copy(other.path().join(snapshot::NAME), map.path().join(snapshot::NAME)).unwrap();
            let said = fault(map.path());
            assert!(said.contains("snapshot.loci is of no use to this journal: it "), "{said}");
        }
    }

    #[test]
    fn a_snapshot_taken_where_no_record_begins_is_not_used_and_costs_no_record() {
        let map = map_of(0..5);
        let Snapshot { position, contents, .. } = snapshot_of(map.path());
        for (back, said) in
            [(1, "where no record begins"), (30, "where no record begins"), (2000, "not yet written")]
        {
            let inside = Position { offset: position.offset - back, ..position };
            snapshot::write(&DiskFolder::new(map.path()), inside, &contents).unwrap();
            assert!(fault(map.path()).contains(said));
        }
    }

    #[test]
    fn a_snapshot_whose_places_do_not_fit_together_is_not_used() {
        let map = map_of(0..30);
        let Snapshot { position, mut contents, .. } = snapshot_of(map.path());
        contents.places.remove(&PlaceId(2));
        snapshot::write(&DiskFolder::new(map.path()), position, &contents).unwrap();
        assert!(fault(map.path()).contains("place 2 is missing"));
    }

    #[test]
    fn a_snapshot_from_before_the_oldest_segment_is_not_used() {
        let map = map_of(0..30);
        let old = fs::read(map.path().join(snapshot::NAME)).unwrap();
        let mut grown = PlaceMap::open(map.path(), UNSYNCED).unwrap();
        found(&mut grown, 31);
        grown.compact().unwrap();
        drop(grown);
        fs::write(map.path().join(snapshot::NAME), old).unwrap();
        assert!(fault(map.path()).contains("it is older than journal-00000"));
    }

    #[test]
    fn a_snapshot_from_a_copy_of_the_map_opens_it_as_it_is_now() {
        let map = map_of(0..30);
        let old = fs::read(map.path().join(snapshot::NAME)).unwrap();
        grow(map.path(), 30..60);
        fs::write(map.path().join(snapshot::NAME), old).unwrap();
        let now = PlaceMap::open_read_only(map.path()).unwrap();
        assert!(now.snapshot_fault().is_none());
        fs::remove_file(map.path().join(snapshot::NAME)).unwrap();
        assert_eq!(knowledge(&now), knowledge(&PlaceMap::open_read_only(map.path()).unwrap()));
    }

    #[test]
    fn a_journal_that_lost_what_its_snapshot_stands_for_is_read_alone_and_not_written() {
        let map = map_of(0..5);
        let path = map.path().join(segment_name(1));
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() - 700]).unwrap();
        let (left, had) = (bytes.len() - 700, bytes.len());
        let reason = format!("{} ends after {left} bytes, but had {had} when it was taken", segment_name(1));
        assert_only_read(map.path(), &reason);
        let map = map_of(0..30);
        let last = segment_name(snapshot_of(map.path()).position.segment);
        fs::remove_file(map.path().join(&last)).unwrap();
        assert_only_read(map.path(), &format!("{last} is missing"));
    }

    #[test]
    fn wherever_between_two_records_a_journal_lost_its_end_it_is_not_written_while_its_snapshot_knows_more() {
        // Of one segment, and of several of which old ones were emptied.
        for (places, compacted) in [(0..5, false), (0..40, true)] {
            let map = map_of(places);
            if compacted {
                PlaceMap::open(map.path(), UNSYNCED).unwrap().compact().unwrap();
            }
            let Position { segment, offset } = snapshot_of(map.path()).position;
            let path = map.path().join(segment_name(segment));
            let bytes = fs::read(&path).unwrap();
            let mut ends = vec![0, 10];
            let mut end = 16;
            while end < offset as usize {
                ends.push(end);
                end += 28 + u32::from_le_bytes(bytes[end + 8..end + 12].try_into().unwrap()) as usize;
            }
            assert!(ends.len() > 4, "{ends:?}");
            let snapshot = fs::read(map.path().join(snapshot::NAME)).unwrap();
            for end in ends {
                fs::write(&path, &bytes[..end]).unwrap();
                fs::write(map.path().join(snapshot::NAME), &snapshot).unwrap();
                let (name, end) = (segment_name(segment), end.max(16));
                let reason = format!("{name} ends after {end} bytes, but had {offset} when it was taken");
                // What was written again by compacting makes no sense without what followed.
                if compacted {
                    assert!(refusal(map.path()).contains(&reason), "{end}");
                } else {
                    assert_only_read(map.path(), &reason);
                }
            }
        }
    }

    /// Asserts that the map is not written since its snapshot knows more, but read without it.
    fn assert_only_read(folder: &Path, reason: &str) {
        let snapshot = folder.join(snapshot::NAME);
        let fix = "keep what is left of both by `loci map compact --repair`, or delete the snapshot";
        let said = format!("{} knows more than the journal beside it: {reason}; {fix}", snapshot.display());
        assert_eq!(refusal(folder), said);
        let read = PlaceMap::open_read_only(folder).unwrap();
        assert_eq!(read.snapshot_fault().unwrap().to_string(), said);
        fs::remove_file(snapshot).unwrap();
        assert_eq!(knowledge(&PlaceMap::open(folder, UNSYNCED).unwrap()), knowledge(&read));
    }

    #[test]
    fn a_snapshot_from_a_copy_that_was_changed_otherwise_is_not_used() {
        type Change = fn(&mut PlaceMap, &str);
        let name: Change = |map, name| map.name_place(PlaceId(0), name).unwrap();
        let name_then_the_same: Change = |map, name| {
            map.name_place(PlaceId(0), name).unwrap();
            map.name_place(PlaceId(1), "hall").unwrap();
        };
        let name_at_the_end_of_a_segment: Change = |map, name| {
            map.name_place(PlaceId(0), name).unwrap();
            map.rotate().unwrap();
        };
        let give_up: Change = |map, name| {
            let id = ExperienceId(u32::from(name == "aaa"));
            let mut batch = Batch::default();
            batch.add(THINNED, format::encode(&ThinnedRecord::new(&[id]))).unwrap();
            map.write(&batch).unwrap();
        };
        for change in [name, name_then_the_same, name_at_the_end_of_a_segment, give_up] {
            let [one, other] = ["aaa", "bbb"].map(|name| {
                let folder = map_of(0..5);
                let mut map = PlaceMap::open(folder.path(), UNSYNCED).unwrap();
                change(&mut map, name);
                map.close().unwrap();
                folder
            });
            fs::copy(one.path().join(snapshot::NAME), other.path().join(snapshot::NAME)).unwrap();
            let said = fault(other.path());
            assert!(said.contains("it says otherwise of "), "{said}");
        }
    }

    #[test]
    fn a_snapshot_that_cannot_be_read_keeps_no_map_from_opening() {
        let map = map_of(0..5);
        let path = map.path().join(snapshot::NAME);
        let mut newer = fs::read(&path).unwrap();
        newer[8] += 1;
        fs::write(&path, newer).unwrap();
        assert!(fault(map.path()).ends_with("reads up to 1: update Loci"));
        fs::create_dir(&path).unwrap();
        let read = PlaceMap::open_read_only(map.path()).unwrap();
        assert!(read.snapshot_fault().unwrap().to_string().contains("snapshot.loci: "));
        assert_eq!(read.places().len(), 5);
    }

    #[test]
    fn damage_before_the_position_of_the_snapshot_keeps_no_map_from_opening_and_costs_nothing_else() {
        let map = map_of(0..5);
        let mut grown = PlaceMap::open(map.path(), UNSYNCED).unwrap();
        grown.name_place(PlaceId(1), "hall").unwrap();
        grown.close().unwrap();
        let before = knowledge(&grown);
        drop(grown);
        let path = map.path().join(segment_name(1));
        let mut bytes = fs::read(&path).unwrap();
        let position = bytes.len() - 40;
        bytes[position] ^= 1;
        fs::write(&path, &bytes).unwrap();
        let opened = PlaceMap::open(map.path(), UNSYNCED).unwrap();
        assert!(opened.snapshot_fault().is_none() && knowledge(&opened) == before);
        assert!(fs::read(&path).unwrap() == bytes, "the journal was changed");
    }

    #[test]
    fn nothing_is_cut_off_a_journal_that_makes_no_sense() {
        let map = tempfile::tempdir().unwrap();
        let path = map.path().join(segment_name(1));
        let file = DiskFolder::new(map.path()).open(&segment_name(1), true).unwrap();
        let reading = Reading { from: 0, wanted: |_| true, visit: &mut |_| Ok(()) };
        let (mut log, _) = RecordLog::open(file, segment_identity(1, &path), Tail::Mended, reading).unwrap();
        let place = PlaceRecord { place: 3, name: None, merged_into: None, neighbours: Vec::new() };
        log.append(&[(PLACE, &format::encode(&place).unwrap())]).unwrap();
        fs::write(&path, [fs::read(&path).unwrap(), vec![7; 50]].concat()).unwrap();
        assert!(refusal(map.path()).contains("place 0 is missing"));
    }
}
