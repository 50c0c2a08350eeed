//! A damaged journal read around what is bad in it.
//!
//! The journal alone counts where all of it can be read. Where something cannot, its snapshot may know what that said;
//! so it counts, too, unless it is of another journal, and what is bad before its position had been on the medium.
//! Where nobody knows what a lost record said, a place without a name stands for one that others speak of.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use super::contents::{Contents, Location};
use super::format::{FEATURES, THUMBNAIL, is_known};
use super::inspection::{Flaw, Inspected, Said, inspect};
use super::journal::{Journal, Position, Segment};
use super::journal_opening::{Opened, SegmentFile, newer_records, open_files};
use super::snapshot::{self, Snapshot};
use super::version_1;
use crate::storage::{Folder, LOG_HEADER_BYTES, RecordLog, Recovery, StorageError, Tail};

/// Places whose records are lost that others may stand for.
const MOST_LOST_PLACES: usize = 1 << 14;

/// What was passed over since it cannot be read.
#[derive(Debug, thiserror::Error)]
pub struct PassedOver {
    /// Records; all from one that is bad up to the next whole one count as one.
    pub records: usize,
    /// What is wrong with the first.
    pub first: StorageError,
}

impl fmt::Display for PassedOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let records = if self.records == 1 { "record" } else { "records" };
        write!(f, "passed over, for it cannot be read: {} {records} (", self.records)?;
        match &self.first {
            StorageError::Damaged { path, reason } => write!(f, "{}: {reason})", path.display()),
            other => write!(f, "{other})"),
        }
    }
}

impl PassedOver {
    fn note(noted: &mut Option<Self>, damage: impl FnOnce() -> StorageError) {
        noted.get_or_insert_with(|| Self { records: 0, first: damage() }).records += 1;
    }
}

/// What was read around damage from some point on.
struct Salvaged {
    contents: Contents,
    recovery: Recovery,
    /// Where a torn tail begins in the last segment.
    torn_at: Option<u64>,
    passed_over: Option<PassedOver>,
}

impl Journal {
    /// Opens the journal in `folder` around what is damaged in it; with `is_writable` so that it can be gone on with.
    ///
    /// # Errors
    /// If a segment is missing, no segment, not its own, or newer than this program, or the medium fails; or if what
    /// is left makes no sense.
    pub(super) fn salvage(
        folder: &Arc<dyn Folder>,
        is_writable: bool,
        snapshot: Option<Snapshot>,
    ) -> Result<Opened, StorageError> {
        let files = open_files(folder.as_ref(), is_writable)?;
        let mut journal = unread(folder, &files)?;
        if let (true, Some(snapshot)) = (files.is_empty(), &snapshot) {
            // Of what is not there nothing can be kept.
            journal.disowns(snapshot)?;
        }
        let mut snapshot_fault = None;
        let snapshot = match snapshot.map(|snapshot| (journal.disowns(&snapshot), snapshot)) {
            Some((Ok(None) | Err(StorageError::Damaged { .. } | StorageError::Ahead { .. }), snapshot)) => {
                Some(snapshot)
            }
            Some((Ok(Some(reason)), _)) => {
                let path = folder.path().join(snapshot::NAME);
                snapshot_fault = Some(StorageError::Useless { path, reason });
                None
            }
            Some((Err(error), _)) => return Err(error),
            None => None,
        };
        let durable = snapshot.as_ref().map_or(Position::default(), |snapshot| snapshot.position);
        let mut alone = read_around(&files, Position::default(), durable, Contents::default())?;
        if let (Some((_, Segment::Log(log))), Some(end)) = (journal.segments.last_key_value(), alone.torn_at)
        {
            log.end_at(end);
        }
        let is_behind = (journal.end().segment, journal.end().offset) < (durable.segment, durable.offset);
        let is_whole = alone.passed_over.is_none() && !is_behind;
        let is_settled = is_whole && journal.settle(&mut alone.contents).is_ok();
        let Salvaged { contents, recovery, passed_over, .. } = match snapshot {
            Some(snapshot) if !is_settled => {
                let mut both = read_around(&files, snapshot.position, durable, snapshot.contents)?;
                both.make_sense(&journal)?;
                both
            }
            _ => {
                if !is_settled {
                    alone.make_sense(&journal)?;
                }
                alone
            }
        };
        if is_writable {
            journal.make_writable()?;
        }
        Ok(Opened { journal, contents, recovery, snapshot_fault, passed_over })
    }
}

impl Salvaged {
    /// Gives up what lies in what the journal has lost, lets nameless places stand for lost ones, and takes merges back
    /// that go in a circle.
    fn make_sense(&mut self, journal: &Journal) -> Result<(), StorageError> {
        let Self { contents, passed_over, .. } = self;
        let somewhere = Location::new(journal.oldest_number(), LOG_HEADER_BYTES);
        let is_there = |location: Location| match journal.segments.get(&location.segment()) {
            Some(Segment::Log(log)) => log.has_record(location.offset()),
            Some(segment) => location.offset() < segment.length_bytes(),
            None => false,
        };
        let damaged = |reason| StorageError::Damaged { path: journal.folder.path().to_owned(), reason };
        for id in contents.lose_experiences(is_there) {
            PassedOver::note(passed_over, || damaged(format!("the record of experience {} is gone", id.0)));
        }
        contents.move_places(is_there, somewhere);
        for id in contents.replace_lost_places(MOST_LOST_PLACES, somewhere) {
            PassedOver::note(passed_over, || damaged(format!("the record of place {} is gone", id.0)));
        }
        for id in contents.break_circles(somewhere) {
            PassedOver::note(passed_over, || damaged(format!("place {} was merged into itself", id.0)));
        }
        journal.settle(contents)
    }
}

/// The journal of `files`, in which nothing was looked at yet.
fn unread(folder: &Arc<dyn Folder>, files: &[SegmentFile]) -> Result<Journal, StorageError> {
    let segment = |file: &SegmentFile| {
        let segment = if file.is_version_1()? {
            let from = file.length_bytes;
            let journal =
                version_1::Journal::open(Arc::clone(&file.file), &file.path, from, &mut |_, _, _| Ok(()));
            Segment::Version1(journal?.0)
        } else {
            Segment::Log(RecordLog::unread(Arc::clone(&file.file), &file.path, file.length_bytes))
        };
        Ok((file.number, segment))
    };
    let segments = files.iter().map(segment).collect::<Result<BTreeMap<_, _>, _>>()?;
    Ok(Journal::of(Arc::clone(folder), segments))
}

/// What `contents` become by the whole records from `from` on. What is bad before `durable` is no torn tail.
fn read_around(
    files: &[SegmentFile],
    from: Position,
    durable: Position,
    contents: Contents,
) -> Result<Salvaged, StorageError> {
    let mut salvaged = Salvaged { contents, recovery: Recovery::default(), torn_at: None, passed_over: None };
    for file in files {
        let offset_in = |position: Position| match file.number.cmp(&position.segment) {
            Ordering::Less => u64::MAX,
            Ordering::Equal => position.offset,
            Ordering::Greater => 0,
        };
        let durable_bytes = if file.tail == Tail::Sealed { u64::MAX } else { offset_in(durable) };
        salvaged.read_around(file, offset_in(from), durable_bytes)?;
    }
    Ok(salvaged)
}

impl Salvaged {
    fn read_around(&mut self, file: &SegmentFile, from: u64, durable_bytes: u64) -> Result<(), StorageError> {
        let is_version_1 = file.is_version_1()?;
        let (mut newer, mut fatal) = (None, None);
        inspect((file.number, &file.file, &file.path), durable_bytes, &mut |inspected| {
            let Inspected { offset, length_bytes, found } = inspected;
            let is_wanted = offset >= from;
            let reason = match found {
                Ok(said) | Err(Flaw::Doubtful { said, .. }) if is_wanted => {
                    if let Said::Now(envelope, _) = said
                        && !is_known(envelope)
                    {
                        newer = newer.or(Some(envelope));
                    }
                    let location = Location::new(file.number, offset);
                    match said.apply(&mut self.contents, location, length_bytes) {
                        Ok(()) => return self.recovery.records += 1,
                        Err(reason) if is_version_1 => {
                            fatal = fatal.take().or(Some(reason));
                            return;
                        }
                        Err(reason) => format!("{}: {reason}", said.name()),
                    }
                }
                // One that was there when the map went on in the next segment is no news.
                Err(Flaw::TornTail) if file.tail == Tail::Sealed => return,
                Err(Flaw::TornTail) => {
                    self.torn_at = Some(offset);
                    return self.recovery.torn_bytes += length_bytes;
                }
                Err(Flaw::Bad { envelope: Some(envelope), .. }) if !is_known(envelope) => {
                    newer = newer.or(Some(envelope));
                    return;
                }
                // Whoever reads the experience notices that.
                Err(Flaw::Bad { envelope: Some(FEATURES | THUMBNAIL), .. }) => return,
                // What stands before a record of version 1 says which experience it is.
                Err(Flaw::Bad { reason, .. }) if is_version_1 => {
                    fatal = fatal.take().or(Some(reason));
                    return;
                }
                // One piece of bad bytes may reach across the point from which on they count.
                Err(Flaw::Bad { reason, .. }) if offset + length_bytes > from => reason,
                _ => return,
            };
            PassedOver::note(&mut self.passed_over, || StorageError::Damaged {
                path: file.path.clone(),
                reason: format!("record at byte {offset}: {reason}"),
            });
        })?;
        match (fatal, newer) {
            (Some(reason), _) => Err(StorageError::Damaged { path: file.path.clone(), reason }),
            (None, Some(envelope)) => Err(newer_records(&file.path, envelope)),
            (None, None) => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::{Path, PathBuf};

    use super::*;
    use crate::place_map::format::{EXPERIENCE, PLACE};
    use crate::place_map::journal::{segment_identity, segment_name};
    use crate::place_map::tests::{SMALL, knowledge, learn};
    use crate::place_map::{Durability, ExperienceId, MapOptions, PlaceId, PlaceMap};
    use crate::storage::{DiskFolder, Envelope, Surveyed};

    const PLACES: u64 = 8;
    /// Every record testifies that those before it were on the medium.
    const SYNCED: MapOptions = MapOptions { durability: Durability::Every, ..SMALL };

    /// A map of some places with an experience each, the first of which has a name; closed.
    fn map(places: u64) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let mut map = PlaceMap::open(folder.path(), SYNCED).unwrap();
        (0..places).for_each(|number| drop(learn(&mut map, None, number, true).unwrap()));
        map.name_place(PlaceId(0), "dock").unwrap();
        map.close().unwrap();
        folder
    }

    fn without_snapshot(map: tempfile::TempDir) -> tempfile::TempDir {
        fs::remove_file(map.path().join(snapshot::NAME)).unwrap();
        map
    }

    /// What stands where in the first segment, and how long it is.
    fn records(folder: &Path) -> Vec<(Envelope, u64, u64)> {
        let file = DiskFolder::new(folder).open(&segment_name(1), false).unwrap();
        let mut records = Vec::new();
        RecordLog::survey(file, segment_identity(1, Path::new("journal")), u64::MAX, &mut |surveyed| {
            let Surveyed::Whole(record) = surveyed else { panic!("{surveyed:?}") };
            records.push((record.envelope, record.offset, record.length_bytes));
        })
        .unwrap();
        records
    }

    fn segment(folder: &Path, number: u32) -> PathBuf {
        folder.join(segment_name(number))
    }

    /// Flips a bit of the first segment.
    fn flip(folder: &Path, offset: u64) {
        let mut bytes = fs::read(segment(folder, 1)).unwrap();
        bytes[offset as usize] ^= 1;
        fs::write(segment(folder, 1), bytes).unwrap();
    }

    fn cut(folder: &Path, number: u32, length_bytes: usize) {
        let bytes = fs::read(segment(folder, number)).unwrap();
        fs::write(segment(folder, number), &bytes[..length_bytes]).unwrap();
    }

    /// Repairs a damaged map; answers how many records were passed over, and the map as it is opened then.
    fn repaired(folder: &Path) -> (usize, PlaceMap) {
        let read = PlaceMap::open_read_only(folder).unwrap();
        let mut map = PlaceMap::open_damaged(folder, SMALL).unwrap();
        // Where its snapshot knows enough it opens for reading without looking at every record.
        assert!([0, map.summary().passed_over].contains(&read.summary().passed_over));
        let passed_over = map.summary().passed_over;
        map.compact().unwrap();
        let after = knowledge(&map);
        drop(map);
        let verified = PlaceMap::verify(folder, &|_, _| ()).unwrap();
        assert!(!verified.is_damaged() && verified.refusal.is_none(), "{verified:?}");
        let map = PlaceMap::open(folder, SMALL).unwrap();
        assert_eq!(knowledge(&map), after);
        (passed_over, map)
    }

    #[test]
    fn whichever_record_is_damaged_that_one_alone_is_lost() {
        let folder = without_snapshot(map(PLACES));
        let mut records = records(folder.path());
        // The last ones nobody could tell from torn ones.
        let latest = records.iter().rposition(|&(envelope, ..)| envelope == EXPERIENCE).unwrap();
        records.truncate(latest - 3);
        for (envelope, offset, length_bytes) in records {
            // The payload, and the header, behind which nobody knows what the record was.
            for at in [offset + length_bytes - 1, offset + 9] {
                let folder = without_snapshot(map(PLACES));
                flip(folder.path(), at);
                let refusal = PlaceMap::open(folder.path(), SMALL).err().unwrap().to_string();
                let (bad, fix) = (format!("bad record at byte {offset}"), "`loci map compact --repair`");
                assert!(refusal.contains(&bad) && refusal.ends_with(fix), "{refusal}");
                let (_, map) = repaired(folder.path());
                let left = PLACES as usize;
                let lost = (left - map.experiences().count(), left - map.summary().keyframes);
                let expected = match envelope {
                    EXPERIENCE => (1, 1),
                    FEATURES => (0, 1),
                    _ => (0, 0),
                };
                assert_eq!((lost, map.places().len()), (expected, left), "{envelope:?} at {at}");
            }
        }
    }

    #[test]
    fn what_its_snapshot_knows_is_not_lost_with_the_records_that_said_it() {
        for (envelope, offset, _) in records(map(PLACES).path()) {
            let folder = map(PLACES);
            // Of the latest experience too: somebody else testifies that the snapshot is the journal's own.
            flip(folder.path(), offset + 9);
            let (_, map) = repaired(folder.path());
            assert_eq!(
                map.place(PlaceId(0)).unwrap().name.as_deref(),
                Some("dock"),
                "{envelope:?} at {offset}"
            );
            let lost = usize::from(envelope == EXPERIENCE);
            assert_eq!((map.places().len(), map.experiences().count()), (8, 8 - lost), "at {offset}");
        }
    }

    #[test]
    fn segments_that_lost_their_end_or_all_of_it_cost_what_stood_there() {
        let whole = map(60);
        let middle = records(whole.path())[40].1 as usize;
        for (length_bytes, has_snapshot) in
            [(0, true), (0, false), (10, false), (16, true), (16, false), (middle, false), (middle + 5, true)]
        {
            let folder = if has_snapshot { map(60) } else { without_snapshot(map(60)) };
            cut(folder.path(), 1, length_bytes);
            let (passed_over, map) = repaired(folder.path());
            assert!(passed_over > 0, "{length_bytes}");
            assert_eq!(map.places().len(), 60);
            assert!((20..60).contains(&map.experiences().count()), "{}", map.experiences().count());
        }
    }

    #[test]
    fn a_journal_that_lost_its_end_keeps_what_its_snapshot_knows_of_its_places() {
        let folder = map(60);
        let mut map = PlaceMap::open(folder.path(), SMALL).unwrap();
        map.compact().unwrap();
        let last = map.journal.active_number();
        drop(map);
        cut(folder.path(), last - 1, 5000);
        let (passed_over, map) = repaired(folder.path());
        assert!(passed_over > 0 && map.place(PlaceId(0)).unwrap().name.is_some());
        assert_eq!(map.places().len(), 60);
    }

    #[test]
    fn a_map_that_lost_a_part_of_its_last_record_keeps_what_its_snapshot_knows_of_it() {
        let folder = map(3);
        PlaceMap::open(folder.path(), SMALL).unwrap().compact().unwrap();
        let name = segment_name(PlaceMap::open_read_only(folder.path()).unwrap().journal.active_number());
        let bytes = fs::read(folder.path().join(&name)).unwrap();
        fs::write(folder.path().join(&name), &bytes[..bytes.len() - 20]).unwrap();
        let (passed_over, map) = repaired(folder.path());
        // It was the record of a place, written again by compacting.
        assert_eq!((passed_over, map.places().len(), map.experiences().count()), (0, 3, 3));
        assert_eq!(map.place(PlaceId(0)).unwrap().name.as_deref(), Some("dock"));
    }

    #[test]
    fn a_damaged_map_may_be_written_before_it_is_compacted() {
        let folder = map(60);
        flip(folder.path(), records(folder.path())[40].1 + 9);
        fs::remove_file(folder.path().join(snapshot::NAME)).unwrap();
        let last = PlaceMap::open_read_only(folder.path()).unwrap().journal.active_number();
        cut(folder.path(), last, 0);
        let mut map = PlaceMap::open_damaged(folder.path(), SMALL).unwrap();
        let found = learn(&mut map, None, 99, true).unwrap();
        assert!(map.features(found.experience.unwrap()).is_ok());
        map.compact().unwrap();
        let after = knowledge(&map);
        drop(map);
        assert_eq!(knowledge(&PlaceMap::open(folder.path(), SMALL).unwrap()), after);
    }

    #[test]
    fn a_map_of_which_nothing_but_the_snapshot_is_left_says_so() {
        let folder = map(3);
        fs::remove_file(segment(folder.path(), 1)).unwrap();
        let refusal = PlaceMap::open_damaged(folder.path(), SMALL).err().unwrap().to_string();
        assert!(refusal.contains("journal-000001.loci is missing"), "{refusal}");
    }

    #[test]
    fn a_circle_of_merges_is_taken_apart() {
        let folder = tempfile::tempdir().unwrap();
        let mut map = PlaceMap::open(folder.path(), SYNCED).unwrap();
        (0..2).for_each(|number| drop(learn(&mut map, None, number, true).unwrap()));
        map.merge_places(PlaceId(1), PlaceId(0)).unwrap();
        let split = map.journal.end().offset;
        map.split_place(PlaceId(1)).unwrap();
        map.merge_places(PlaceId(0), PlaceId(1)).unwrap();
        drop(map);
        flip(folder.path(), split + 30);
        let (_, map) = repaired(folder.path());
        assert_eq!(map.experiences().count(), 2);
        assert_eq!(map.places().filter(|place| place.merged_into.is_some()).count(), 1);
    }

    #[test]
    fn records_of_a_later_loci_are_never_passed_over() {
        for newer in [Envelope { kind: 6, version: 1 }, Envelope { version: 2, ..PLACE }] {
            let folder = without_snapshot(map(PLACES));
            let file = DiskFolder::new(folder.path()).open(&segment_name(1), true).unwrap();
            let mut log =
                RecordLog::unread(Arc::clone(&file), Path::new("log"), file.length_bytes().unwrap());
            log.append(&[(newer, b"what nobody knows yet")]).unwrap();
            let before = fs::read(segment(folder.path(), 1)).unwrap();
            for opened in [PlaceMap::open(folder.path(), SMALL), PlaceMap::open_damaged(folder.path(), SMALL)]
            {
                let refusal = opened.err().unwrap().to_string();
                assert!(refusal.ends_with("which this Loci does not know: update Loci"), "{refusal}");
            }
            assert!(fs::read(segment(folder.path(), 1)).unwrap() == before);
        }
    }

    #[test]
    fn a_place_with_a_number_beyond_all_reason_takes_no_memory() {
        let folder = without_snapshot(map(PLACES));
        let mut map = PlaceMap::open(folder.path(), SYNCED).unwrap();
        map.write_place(crate::place_map::PlaceRecord {
            place: u32::MAX,
            name: None,
            merged_into: None,
            neighbours: Vec::new(),
        })
        .unwrap();
        drop(map);
        let _ = fs::remove_file(folder.path().join(snapshot::NAME));
        let refusal = PlaceMap::open_damaged(folder.path(), SMALL).err().unwrap().to_string();
        assert!(refusal.contains("place 8 is missing"), "{refusal}");
    }

    #[test]
    fn a_torn_tail_of_version_1_costs_the_segment_behind_it_nothing() {
        let fixture =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/map/version_1").join(segment_name(1));
        let folder = tempfile::tempdir().unwrap();
        let torn = [fs::read(fixture).unwrap(), vec![1, 0, 0, 0, 7, 7]].concat();
        fs::write(segment(folder.path(), 1), torn).unwrap();
        let mut map = PlaceMap::open(folder.path(), SYNCED).unwrap();
        let before = map.experiences().count();
        let damaged = learn(&mut map, None, 8, true).unwrap().experience.unwrap();
        let offset = map.location(damaged).unwrap().offset() as usize;
        (9..12).for_each(|number| drop(learn(&mut map, None, number, true).unwrap()));
        drop(map);
        let mut bytes = fs::read(segment(folder.path(), 2)).unwrap();
        bytes[offset + 30] ^= 1;
        fs::write(segment(folder.path(), 2), bytes).unwrap();
        let (passed_over, map) = repaired(folder.path());
        assert_eq!((passed_over, map.experiences().count()), (1, before + 3));
    }

    #[test]
    fn a_sound_map_is_opened_as_ever() {
        let folder = map(PLACES);
        let before = knowledge(&PlaceMap::open_read_only(folder.path()).unwrap());
        let map = PlaceMap::open_damaged(folder.path(), SMALL).unwrap();
        assert!(map.passed_over().is_none() && knowledge(&map) == before);
        assert!(map.experience(ExperienceId(7)).is_some());
    }
}
