//! A damaged segment read around what is bad in it, so that compacting the map keeps the rest.
//!
//! A segment of version 1 is not: there, only the count of those before it says which place a record is of.

use super::contents::{Contents, Location};
use super::format::{FEATURES, THUMBNAIL};
use super::inspection::{Flaw, Inspected, inspect};
use super::journal_opening::SegmentFile;
use crate::storage::{RECORD_HEADER_BYTES, Recovery, StorageError, Tail};

/// What was passed over.
pub(super) struct Skipped {
    /// Records; where not even the next one's beginning can be told, all up to the next whole one count as one.
    pub(super) records: usize,
    /// Records that they can have been at most.
    pub(super) most_records: u64,
    /// What is wrong with the first.
    pub(super) first: StorageError,
}

impl Skipped {
    fn note(skipped: &mut Option<Self>, length_bytes: u64, damage: impl FnOnce() -> StorageError) {
        let skipped = skipped.get_or_insert_with(|| Self { records: 0, most_records: 0, first: damage() });
        skipped.records += 1;
        skipped.most_records += length_bytes.div_ceil(RECORD_HEADER_BYTES);
    }
}

/// Adds to `contents` what the whole records of a segment say from byte `from` on; what is bad comes to `skipped`.
/// Parts of experiences do not count there.
///
/// # Errors
/// If it is no segment that can be read, or the medium fails.
pub(super) fn read_around(
    segment: &SegmentFile,
    from: u64,
    contents: &mut Contents,
    skipped: &mut Option<Skipped>,
) -> Result<Recovery, StorageError> {
    let mut recovery = Recovery::default();
    let durable_bytes = if segment.tail == Tail::Sealed { u64::MAX } else { from };
    inspect((segment.number, &segment.file, &segment.path), durable_bytes, &mut |inspected| {
        let Inspected { offset, length_bytes, found } = inspected;
        if offset < from {
            return;
        }
        let location = Location::new(segment.number, offset);
        let reason = match found {
            Ok(said) | Err(Flaw::Doubtful { said, .. }) => {
                match said.apply(contents, location, length_bytes) {
                    Ok(()) => {
                        recovery.records += 1;
                        return;
                    }
                    Err(reason) => format!("{}: {reason}", said.name()),
                }
            }
            Err(Flaw::TornTail) => {
                recovery.torn_bytes = length_bytes;
                return;
            }
            // Whoever writes the experience again notices that.
            Err(Flaw::Bad { envelope: Some(FEATURES | THUMBNAIL), .. }) => return,
            Err(Flaw::Bad { reason, .. }) => reason,
        };
        Skipped::note(skipped, length_bytes, || StorageError::Damaged {
            path: segment.path.clone(),
            reason: format!("record at byte {offset}: {reason}"),
        });
    })?;
    Ok(recovery)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::{Path, PathBuf};

    use super::*;
    use crate::place_map::format::{EXPERIENCE, PLACE};
    use crate::place_map::journal::{segment_identity, segment_name};
    use crate::place_map::tests::{SMALL, knowledge, learn};
    use crate::place_map::{Durability, MapOptions, PlaceMap, snapshot};
    use crate::storage::{DiskFolder, Envelope, Folder, RecordLog, Surveyed};

    const PLACES: u64 = 8;
    /// Every record testifies that those before it were on the medium.
    const SYNCED: MapOptions = MapOptions { durability: Durability::Every, ..SMALL };

    /// A map of some places with an experience each, whose journal is all that it has.
    fn map() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let mut map = PlaceMap::open(folder.path(), SYNCED).unwrap();
        (0..PLACES).for_each(|number| drop(learn(&mut map, None, number, true).unwrap()));
        map.close().unwrap();
        fs::remove_file(folder.path().join(snapshot::NAME)).unwrap();
        folder
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

    /// Flips a bit of the first segment, and answers its path.
    fn flip(folder: &Path, offset: u64) -> PathBuf {
        let path = folder.join(segment_name(1));
        let mut bytes = fs::read(&path).unwrap();
        bytes[offset as usize] ^= 1;
        fs::write(&path, bytes).unwrap();
        path
    }

    /// Compacts a damaged map; answers what is said of the loss, and the map as it is opened then.
    fn repaired(folder: &Path) -> (String, PlaceMap) {
        let mut map = PlaceMap::open_damaged(folder, SMALL).unwrap();
        map.compact().unwrap();
        let loss = map.take_loss().unwrap().to_string();
        let after = knowledge(&map);
        drop(map);
        assert!(!PlaceMap::verify(folder, &|_, _| ()).unwrap().is_damaged());
        let map = PlaceMap::open(folder, SMALL).unwrap();
        assert_eq!(knowledge(&map), after);
        (loss, map)
    }

    #[test]
    fn whichever_record_is_damaged_compacting_gives_up_that_one_alone() {
        let folder = map();
        let mut records = records(folder.path());
        // The last ones nobody could tell from torn ones.
        let latest = records.iter().rposition(|&(envelope, ..)| envelope == PLACE).unwrap();
        records.truncate(latest - 1);
        for (envelope, offset, length_bytes) in records {
            // The payload, and the header, behind which nobody knows what the record was.
            for at in [offset + length_bytes - 1, offset + 9] {
                let folder = map();
                let path = flip(folder.path(), at);
                let refusal = PlaceMap::open(folder.path(), SMALL).err().unwrap().to_string();
                assert!(refusal.contains(&format!("bad record at byte {offset}")), "{refusal}");
                let (loss, repaired) = repaired(folder.path());
                assert!(loss.contains(&format!("{}: ", path.display())), "{loss}");
                let (experiences, keyframes) = (repaired.experiences().count(), repaired.summary().keyframes);
                let lost = match envelope {
                    EXPERIENCE => (1, 1),
                    FEATURES => (0, 1),
                    _ => (0, 0),
                };
                let left = PLACES as usize;
                assert_eq!((left - experiences, left - keyframes), lost, "{envelope:?} at {at}: {loss}");
                assert_eq!(repaired.places().len(), left);
            }
        }
    }
}
