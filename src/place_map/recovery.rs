//! How a journal is opened: its segments are read, from where its snapshot stands if that proves to be the journal's
//! own, else from the beginning. Only once what they say is sound is a torn tail cut or a segment begun.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use super::Experience;
use super::contents::{Contents, Location, MAX_SEGMENT};
use super::format::{FEATURES, KIND, THUMBNAIL};
use super::journal::{Journal, Position, Segment, missing, segment_name, segment_numbers};
use super::replay::{apply, apply_version_1};
use super::snapshot::{self, Snapshot};
use super::version_1;
use crate::storage::{
    AppendFile, Folder, Footing, LoggedRecord, Reading, RecordLog, Recovery, StorageError, Tail, log_kind,
};

/// Behind every record there can be.
const BEHIND_ALL: Position = Position { segment: u32::MAX, offset: 0 };

/// A journal, and what it says.
pub(super) struct Opened {
    pub(super) journal: Journal,
    pub(super) contents: Contents,
    pub(super) recovery: Recovery,
    /// Why the snapshot was of no use.
    pub(super) snapshot_fault: Option<StorageError>,
}

/// A segment that was not read yet.
struct SegmentFile {
    number: u32,
    path: PathBuf,
    file: Arc<dyn AppendFile>,
    length_bytes: u64,
    /// What its end may be like; nothing is mended here.
    tail: Tail,
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
            match at(folder, &files, BEHIND_ALL, &mut Contents::default())?.0.disowns(&snapshot)? {
                None => start = snapshot,
                Some(reason) => snapshot_fault = Some(useless(reason)),
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
        Ok(Opened { journal, contents, recovery, snapshot_fault })
    }

    /// Why `snapshot` cannot be of this journal, if it cannot.
    ///
    /// # Errors
    /// If it is, and the journal has lost or damaged what the snapshot stands for; or the medium fails.
    fn disowns(&self, snapshot: &Snapshot) -> Result<Option<String>, StorageError> {
        let Position { segment, offset } = snapshot.position;
        if segment < self.oldest_number() {
            return Ok(Some(format!("it is older than {}", segment_name(self.oldest_number()))));
        }
        if snapshot.contents.locations().any(|location| location >= Location::new(segment, offset)) {
            return Ok(Some("it speaks of what was not yet written when it was taken".to_owned()));
        }
        // Where a record of the snapshot was found, the way from there to its position is the shortest.
        let mut found_at = None;
        if let Some(witness) = self.witness(snapshot) {
            match self.bears_out(witness)? {
                Some(false) => return Ok(Some(format!("it says otherwise of experience {}", witness.id.0))),
                Some(true) if witness.location.segment() == segment => {
                    found_at = Some(witness.location.offset());
                }
                Some(true) | None => {}
            }
        }
        let length = match self.segments.get(&segment) {
            None => return Err(self.missing(segment)),
            Some(Segment::Version1(_)) => {
                return Ok(Some(format!(
                    "it was taken in {}, of which none is taken",
                    segment_name(segment)
                )));
            }
            Some(Segment::Log(log)) => log.length_bytes(),
        };
        let damaged = |reason| StorageError::Damaged { path: self.path_of(segment), reason };
        if offset > length {
            let reason =
                format!("it ends after {length} bytes, but had {offset} when its snapshot was taken");
            return Err(damaged(reason));
        }
        match self.footing(Location::new(segment, offset), found_at.unwrap_or(0))? {
            Footing::Boundary => Ok(None),
            // What is damaged there the snapshot knows.
            Footing::Hidden { .. } if found_at.is_some() => Ok(None),
            Footing::Within => {
                let name = segment_name(segment);
                Ok(Some(format!("it was taken at byte {offset} of {name}, where no record begins")))
            }
            Footing::Hidden { by } => Err(damaged(format!("bad record at byte {by}"))),
        }
    }

    /// The latest experience of `snapshot` whose record would lie within the journal.
    fn witness<'a>(&self, snapshot: &'a Snapshot) -> Option<&'a Experience> {
        let Position { segment, offset } = self.end();
        let end = Location::new(segment, offset);
        let experiences = snapshot.contents.experiences.values();
        experiences
            .filter(|experience| experience.location < end)
            .max_by_key(|experience| experience.location)
    }

    /// Whether the journal has the record of `witness` where the snapshot says; `None` if that cannot be told, since
    /// the segment is gone, damaged, or of a version that does not number its experiences.
    fn bears_out(&self, witness: &Experience) -> Result<Option<bool>, StorageError> {
        let Some(Segment::Log(_)) = self.segments.get(&witness.location.segment()) else { return Ok(None) };
        match self.experience(witness.location) {
            Ok(record) => {
                let is_same = (record.experience, record.place, record.view)
                    == (witness.id.0, witness.learnt_as.0, witness.view);
                Ok(Some(is_same))
            }
            Err(StorageError::Damaged { .. }) => {
                let footing = self.footing(witness.location, 0)?;
                Ok((footing == Footing::Within).then_some(false))
            }
            Err(error) => Err(error),
        }
    }

    fn footing(&self, location: Location, from: u64) -> Result<Footing, StorageError> {
        match self.segments.get(&location.segment()) {
            Some(Segment::Log(log)) => log.footing(from, location.offset()),
            _ => Err(self.missing(location.segment())),
        }
    }

    /// Puts together what was read of the journal, if it makes sense.
    fn settle(&self, contents: &mut Contents) -> Result<(), StorageError> {
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

    fn make_writable(&mut self) -> Result<(), StorageError> {
        match self.segments.last_key_value() {
            Some((_, Segment::Log(log))) => {
                log.mend(&KIND)?;
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

/// Opens all segments before any is read: a writer may delete some meanwhile.
fn open_files(folder: &dyn Folder, writable: bool) -> Result<Vec<SegmentFile>, StorageError> {
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
    if log_kind(file.as_ref(), path)? == (KIND.magic, version_1::VERSION) {
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
    let mut visit = |record: LoggedRecord<'_>| {
        let LoggedRecord { offset, envelope, payload, length_bytes } = record;
        let Some(payload) = payload else { return Ok(()) };
        apply(contents, Location::new(*number, offset), (envelope, payload), length_bytes)
    };
    let wanted = |envelope| envelope != FEATURES && envelope != THUMBNAIL;
    let reading = Reading { from, wanted, visit: &mut visit };
    let (log, recovery) = RecordLog::open(Arc::clone(file), (&KIND, path), *tail, reading)?;
    Ok((Segment::Log(log), recovery))
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;
    use crate::place_map::format::{self, PLACE, PlaceRecord};
    use crate::place_map::tests::{SMALL, found, knowledge, learn};
    use crate::place_map::{Durability, MapOptions, PlaceMap};
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
        let map = map_of(0..5);
        let Snapshot { position, mut contents, .. } = snapshot_of(map.path());
        contents.places.remove(&crate::place_map::PlaceId(2));
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
    fn a_journal_that_lost_what_its_snapshot_stands_for_is_damaged_and_nothing_is_cut() {
        let map = map_of(0..5);
        let path = map.path().join(segment_name(1));
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() - 700]).unwrap();
        let (left, had) = (bytes.len() - 700, bytes.len());
        let reason = format!("it ends after {left} bytes, but had {had} when its snapshot was taken");
        assert_eq!(
            refusal(map.path()),
            format!("{} is damaged: {reason}; restore it from a copy", path.display())
        );
        let map = map_of(0..30);
        let last = map.path().join(segment_name(snapshot_of(map.path()).position.segment));
        fs::remove_file(&last).unwrap();
        let expected = format!("cannot open {}: it is missing; restore it from a copy", last.display());
        assert_eq!(refusal(map.path()), expected);
    }

    #[test]
    fn damage_before_the_position_of_the_snapshot_keeps_no_map_from_opening_and_costs_nothing_else() {
        let map = map_of(0..5);
        let mut grown = PlaceMap::open(map.path(), UNSYNCED).unwrap();
        grown.name_place(crate::place_map::PlaceId(1), "hall").unwrap();
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
        let (mut log, _) = RecordLog::open(file, (&KIND, &path), Tail::Mended, reading).unwrap();
        let place = PlaceRecord { place: 3, name: None, merged_into: None, neighbours: Vec::new() };
        log.append(&[(PLACE, &format::encode(&place).unwrap())]).unwrap();
        fs::write(&path, [fs::read(&path).unwrap(), vec![7; 50]].concat()).unwrap();
        assert!(refusal(map.path()).contains("place 0 is missing"));
    }
}
