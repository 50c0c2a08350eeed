//! The log, written, cut and bent.

use std::sync::atomic::{AtomicBool, AtomicU64};

use super::*;
use crate::storage::faulty::FaultyFolder;
use crate::storage::record::MAX_PAYLOAD_BYTES;
use crate::storage::{Folder, MemoryFile};
use proptest::prelude::*;

const KIND: FileKind = FileKind { magic: *b"LOCITEST", version: 3, name: "test log" };
const NOTE: Envelope = Envelope { kind: 1, version: 1 };
const BLOB: Envelope = Envelope { kind: 2, version: 1 };

fn identity() -> LogIdentity<'static> {
    LogIdentity { kind: &KIND, number: 0x0102, path: Path::new("log") }
}

type Opened = (RecordLog, Recovery, Vec<Vec<u8>>);

fn open(file: &Arc<MemoryFile>, tail: Tail) -> Result<Opened, StorageError> {
    let mut records = Vec::new();
    let mut visit = |record: LoggedRecord<'_>| {
        records.extend(record.payload.map(<[u8]>::to_vec));
        Ok(())
    };
    let reading = Reading { from: 0, wanted: |envelope| envelope == NOTE, visit: &mut visit };
    let (log, recovery) = RecordLog::open(file.clone(), identity(), tail, reading)?;
    Ok((log, recovery, records))
}

fn bytes_of(file: &MemoryFile) -> Vec<u8> {
    let mut bytes = vec![0; file.length_bytes().unwrap() as usize];
    file.read_at(0, &mut bytes).unwrap();
    bytes
}

/// A log of these records, which were synced up to but not with the last `unsynced` ones.
fn written(records: &[&[u8]], unsynced: usize) -> Vec<u8> {
    let file = Arc::new(MemoryFile::default());
    let (mut log, ..) = open(&file, Tail::Mended).unwrap();
    for (index, &record) in records.iter().enumerate() {
        log.append(&[(NOTE, record)]).unwrap();
        if index + unsynced < records.len() {
            log.sync().unwrap();
        }
    }
    bytes_of(&file)
}

fn reopened(bytes: Vec<u8>, tail: Tail) -> Result<Opened, StorageError> {
    open(&Arc::new(MemoryFile::new(bytes)), tail)
}

#[test]
fn records_can_be_read_again_by_their_offset() {
    let (mut log, ..) = open(&Arc::default(), Tail::Mended).unwrap();
    let offsets = log.append(&[(NOTE, b"one"), (BLOB, b"three")]).unwrap();
    assert_eq!(log.read(offsets[0]).unwrap(), (NOTE, b"one".to_vec()));
    assert_eq!(log.read(offsets[1]).unwrap(), (BLOB, b"three".to_vec()));
    assert!(log.read(offsets[1] + 1).is_err());
    assert!(log.append(&[(NOTE, b"")]).is_err());
    assert!(log.append(&[(NOTE, &vec![0; MAX_PAYLOAD_BYTES + 1])]).is_err());
}

#[test]
fn reading_may_begin_at_any_record_and_leave_out_what_is_not_wanted() {
    let file = Arc::new(MemoryFile::default());
    let (mut log, ..) = open(&file, Tail::Mended).unwrap();
    let offsets = log.append(&[(NOTE, b"one"), (BLOB, b"two"), (NOTE, b"three")]).unwrap();
    for (tail, from, expected) in
        [(Tail::Ignored, 0, 2), (Tail::Sealed, offsets[1], 1), (Tail::Mended, log.length_bytes(), 0)]
    {
        let mut wanted = 0;
        let mut visit = |record: LoggedRecord<'_>| {
            wanted += usize::from(record.payload.is_some());
            Ok(())
        };
        let reading = Reading { from, wanted: |envelope| envelope == NOTE, visit: &mut visit };
        RecordLog::open(file.clone(), identity(), tail, reading).unwrap();
        assert_eq!(wanted, expected);
    }
    let reading = Reading { from: log.length_bytes() + 1, wanted: |_| true, visit: &mut |_| Ok(()) };
    let error = RecordLog::open(file, identity(), Tail::Ignored, reading).err().unwrap();
    assert!(error.to_string().contains("it ends after"), "{error}");
}

#[test]
fn where_records_begin_is_told_from_their_headers_alone() {
    let mut bytes = written(&[b"first", b"second", b"third"], 0);
    // The payload of the first.
    bytes[16 + 28] ^= 1;
    let over = |bytes: &[u8]| RecordLog::over(Arc::new(MemoryFile::new(bytes.to_vec())), Path::new("log"));
    let footing = |bytes: &[u8], from, offset| {
        let log = over(bytes);
        log.shared.end.store(bytes.len() as u64, Ordering::Release);
        log.footing(from, offset).unwrap()
    };
    for (from, offset, expected) in [
        (0, 16, Footing::Boundary),
        (0, 49, Footing::Boundary),
        (49, 83, Footing::Boundary),
        (0, bytes.len() as u64, Footing::Boundary),
        (0, 15, Footing::Within),
        (0, 50, Footing::Within),
        (83, 49, Footing::Within),
        (0, bytes.len() as u64 + 1, Footing::Hidden { by: bytes.len() as u64 }),
    ] {
        assert_eq!(footing(&bytes, from, offset), expected, "{from} to {offset}");
    }
    bytes[49] ^= 1;
    assert_eq!(footing(&bytes, 0, 83), Footing::Hidden { by: 49 });
    assert_eq!(footing(&bytes, 83, bytes.len() as u64), Footing::Boundary);
}

#[test]
fn a_bad_record_that_had_been_on_the_medium_is_damage() {
    let mut bytes = written(&[b"first", b"second", b"third"], 0);
    bytes[LOG_HEADER_BYTES as usize + HEADER_BYTES] ^= 1;
    for tail in [Tail::Mended, Tail::Ignored, Tail::Sealed] {
        let error = reopened(bytes.clone(), tail).err().unwrap().to_string();
        assert_eq!(error, "log is damaged: bad record at byte 16; restore it from a copy");
    }
}

#[test]
fn a_bad_record_that_was_never_acknowledged_ends_the_log_even_before_good_ones() {
    let mut bytes = written(&[b"first", b"second", b"third"], 2);
    let second = LOG_HEADER_BYTES as usize + HEADER_BYTES + b"first".len();
    bytes[second + HEADER_BYTES] ^= 1;
    let torn = (bytes.len() - second) as u64;
    let (_, recovery, records) = reopened(bytes.clone(), Tail::Ignored).unwrap();
    assert_eq!((recovery.torn_bytes, records), (torn, vec![b"first".to_vec()]));
    assert!(reopened(bytes, Tail::Sealed).is_err(), "a finished log has no torn tail");
}

#[test]
fn a_tail_of_zeros_is_torn_and_cut_off() {
    let file = Arc::new(MemoryFile::new([written(&[b"first"], 0), vec![0; 5000]].concat()));
    let (_, recovery, records) = open(&file, Tail::Mended).unwrap();
    assert_eq!((recovery.torn_bytes, records), (5000, vec![b"first".to_vec()]));
    assert_eq!(bytes_of(&file), written(&[b"first"], 0));
}

#[test]
fn foreign_older_and_newer_logs_are_refused_by_name() {
    let message = |bytes: &[u8]| reopened(bytes.to_vec(), Tail::Mended).err().unwrap().to_string();
    assert_eq!(message(b"something else entirely"), "log is not a test log: it does not begin as one");
    assert_eq!(message(b"foreign"), "log is not a test log: it does not begin as one");
    let mut other = LogIdentity { kind: &FileKind { version: 4, ..KIND }, ..identity() }.header();
    assert!(message(&other).contains("update Loci"));
    other[8] = 2;
    assert!(message(&other).contains("version 2, this Loci reads from 3 on"));
}

#[test]
fn a_log_that_stands_under_the_name_of_another_one_is_refused_and_one_that_says_no_number_is_not() {
    let mut bytes = written(&[b"first"], 0);
    assert_eq!(bytes[12..16], [2, 1, 0, 0]);
    for tail in [Tail::Mended, Tail::Ignored, Tail::Sealed] {
        bytes[12..16].copy_from_slice(&[3, 1, 0, 0]);
        let error = reopened(bytes.clone(), tail).err().unwrap().to_string();
        assert_eq!(
            error,
            "log is number 259 of a test log, not 258: renamed, copied or damaged at its head; \
             name every file as it was"
        );
        bytes[12..16].copy_from_slice(&[0; 4]);
        let (_, recovery, records) = reopened(bytes.clone(), tail).unwrap();
        assert_eq!((recovery.torn_bytes, records), (0, vec![b"first".to_vec()]));
    }
    // Also one without records, whose number was not torn off.
    let (_, recovery, _) = reopened(bytes[..16].to_vec(), Tail::Sealed).unwrap();
    assert_eq!(recovery, Recovery::default());
}

#[test]
fn a_medium_that_refuses_half_a_record_leaves_the_log_as_it_was() {
    /// Takes half of what it is given, and says that it is full.
    struct FullFile(MemoryFile);
    impl AppendFile for FullFile {
        fn length_bytes(&self) -> io::Result<u64> {
            self.0.length_bytes()
        }
        fn read_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
            self.0.read_at(offset, buffer)
        }
        fn append(&self, bytes: &[u8]) -> io::Result<()> {
            if bytes.len() < 100 {
                return self.0.append(bytes);
            }
            self.0.append(&bytes[..bytes.len() / 2])?;
            Err(io::ErrorKind::StorageFull.into())
        }
        fn truncate(&self, length_bytes: u64) -> io::Result<()> {
            self.0.truncate(length_bytes)
        }
        fn sync(&self) -> io::Result<()> {
            Ok(())
        }
        fn is_linked(&self) -> io::Result<bool> {
            Ok(true)
        }
    }
    let file = Arc::new(FullFile(MemoryFile::default()));
    let reading = Reading { from: 0, wanted: |_| true, visit: &mut |_| Ok(()) };
    let (mut log, _) = RecordLog::open(file.clone(), identity(), Tail::Mended, reading).unwrap();
    log.append(&[(NOTE, b"fits")]).unwrap();
    let before = bytes_of(&file.0);
    let error = log.append(&[(NOTE, &[7; 200])]).unwrap_err().to_string();
    assert!(error.starts_with("cannot append to log: "), "{error}");
    assert_eq!(bytes_of(&file.0), before);
    log.append(&[(NOTE, b"fits, too")]).unwrap();
}

#[test]
fn a_refused_record_does_not_come_back_after_a_power_cut() {
    let folder = FaultyFolder::default();
    let file = folder.open("log", true).unwrap();
    let reading = Reading { from: 0, wanted: |_| true, visit: &mut |_| Ok(()) };
    let (mut log, _) = RecordLog::open(file, identity(), Tail::Mended, reading).unwrap();
    folder.sync().unwrap();
    let next = folder.operations();
    folder.fill_up_at(next);
    log.append(&[(NOTE, &[7; 3000]), (NOTE, &[8; 3000])]).unwrap_err();
    let found = folder.after_power_cut(&mut |n| n - 1).open("log", false).unwrap();
    assert_eq!(found.length_bytes().unwrap(), LOG_HEADER_BYTES);
}

#[test]
fn after_a_sync_that_failed_no_other_one_succeeds() {
    let folder = FaultyFolder::default();
    let file = folder.open("log", true).unwrap();
    let reading = Reading { from: 0, wanted: |_| true, visit: &mut |_| Ok(()) };
    let (mut log, _) = RecordLog::open(file, identity(), Tail::Mended, reading).unwrap();
    folder.remove("log").unwrap();
    log.append(&[(NOTE, b"lost")]).unwrap();
    assert!(log.sync().unwrap_err().to_string().contains("deleted"));
    assert!(log.syncer().sync().unwrap_err().to_string().contains("the medium failed before"));
    assert!(log.append(&[(NOTE, b"more")]).unwrap_err().to_string().contains("the medium failed before"));
}

#[test]
fn no_sync_succeeds_beside_one_that_fails() {
    /// Its first sync takes a while and fails; the system then forgets what it could not write.
    #[derive(Default)]
    struct ForgetfulFile {
        memory: MemoryFile,
        syncs: AtomicU64,
        is_failing: AtomicBool,
    }
    impl AppendFile for ForgetfulFile {
        fn length_bytes(&self) -> io::Result<u64> {
            self.memory.length_bytes()
        }
        fn read_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
            self.memory.read_at(offset, buffer)
        }
        fn append(&self, bytes: &[u8]) -> io::Result<()> {
            self.memory.append(bytes)
        }
        fn truncate(&self, length_bytes: u64) -> io::Result<()> {
            self.memory.truncate(length_bytes)
        }
        fn sync(&self) -> io::Result<()> {
            if self.is_failing.load(Ordering::Acquire) && self.syncs.fetch_add(1, Ordering::AcqRel) == 0 {
                std::thread::sleep(std::time::Duration::from_millis(100));
                return Err(io::ErrorKind::StorageFull.into());
            }
            Ok(())
        }
        fn is_linked(&self) -> io::Result<bool> {
            Ok(true)
        }
    }
    let file = Arc::new(ForgetfulFile::default());
    let reading = Reading { from: 0, wanted: |_| true, visit: &mut |_| Ok(()) };
    let (mut log, _) = RecordLog::open(file.clone(), identity(), Tail::Mended, reading).unwrap();
    log.append(&[(NOTE, b"lost")]).unwrap();
    file.is_failing.store(true, Ordering::Release);
    std::thread::scope(|scope| {
        let syncer = log.syncer();
        let first = scope.spawn(move || syncer.sync());
        while file.syncs.load(Ordering::Acquire) == 0 {
            std::thread::yield_now();
        }
        assert!(log.sync().is_err());
        assert!(first.join().unwrap().is_err());
    });
}

#[test]
fn a_log_whose_refused_record_could_not_be_cut_off_is_never_synced_nor_written_again() {
    let folder = FaultyFolder::default();
    let file = folder.open("log", true).unwrap();
    let reading = Reading { from: 0, wanted: |_| true, visit: &mut |_| Ok(()) };
    let (mut log, _) = RecordLog::open(file, identity(), Tail::Mended, reading).unwrap();
    folder.fill_up_at(folder.operations());
    folder.fail_at(folder.operations() + 2);
    log.append(&[(NOTE, &[7; 3000])]).unwrap_err();
    assert!(log.syncer().sync().unwrap_err().to_string().contains("the medium failed before"));
    assert!(log.append(&[(NOTE, b"x")]).unwrap_err().to_string().contains("the medium failed before"));
}

/// What a survey finds: 'w'hole, 'b'ad or 't'orn, with offset and length.
fn surveyed(bytes: &[u8], tail: Tail) -> Vec<(char, u64, u64)> {
    let mut found = Vec::new();
    let file = Arc::new(MemoryFile::new(bytes.to_vec()));
    let durable_bytes = if tail == Tail::Sealed { u64::MAX } else { 0 };
    RecordLog::survey(file, identity(), durable_bytes, &mut |what| {
        found.push(match what {
            Surveyed::Whole(record) => ('w', record.offset, record.length_bytes),
            Surveyed::Bad { offset, length_bytes, .. } => ('b', offset, length_bytes),
            Surveyed::Torn { offset, length_bytes } => ('t', offset, length_bytes),
        });
    })
    .unwrap();
    found
}

#[test]
fn a_survey_goes_on_behind_every_bad_record() {
    let bytes = written(&[b"first", b"second", b"third", b"fourth"], 0);
    let whole = [('w', 16, 33), ('w', 49, 34), ('w', 83, 33), ('w', 116, 34)];
    assert_eq!(surveyed(&bytes, Tail::Ignored), whole);
    // A header and a payload.
    for position in [16 + 9, 16 + 30] {
        let mut bad = bytes.clone();
        bad[position] ^= 1;
        bad[83 + 1] ^= 1;
        let found = surveyed(&bad, Tail::Ignored);
        assert_eq!(found, [('b', 16, 33), ('w', 49, 34), ('b', 83, 33), ('w', 116, 34)]);
    }
}

#[test]
fn a_survey_tells_a_torn_tail_from_damage_as_opening_does() {
    let mut bytes = written(&[b"first", b"second", b"third"], 1);
    bytes[83 + 30] ^= 1;
    assert_eq!(surveyed(&bytes, Tail::Ignored).last(), Some(&('t', 83, 33)));
    assert_eq!(surveyed(&bytes, Tail::Sealed).last(), Some(&('b', 83, 33)));
    assert_eq!(surveyed(&bytes[..100], Tail::Sealed).last(), Some(&('b', 83, 17)));
    assert_eq!(surveyed(&bytes[..7], Tail::Ignored), [('t', 0, 7)]);
    assert_eq!(surveyed(&bytes[..7], Tail::Sealed), [('b', 0, 7)]);
    assert_eq!(surveyed(&[], Tail::Ignored), []);
    assert_eq!(surveyed(&[], Tail::Sealed), [('b', 0, 0)]);
    // Half a header, but with bytes that no writer put there.
    bytes.truncate(15);
    bytes[13] = 7;
    assert_eq!(surveyed(&bytes, Tail::Ignored), [('b', 0, 15)]);
    assert!(reopened(bytes, Tail::Mended).is_err());
}

proptest! {
    #[test]
    fn a_cut_anywhere_keeps_every_whole_record(
        records in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 1..40), 1..6),
        unsynced in 0..6_usize,
        cut in any::<prop::sample::Index>(),
    ) {
        let parts: Vec<&[u8]> = records.iter().map(Vec::as_slice).collect();
        let bytes = written(&parts, unsynced);
        let cut = cut.index(bytes.len() + 1);
        let mut end = LOG_HEADER_BYTES as usize;
        let whole = records.iter().take_while(|record| {
            end += HEADER_BYTES + record.len();
            end <= cut
        }).count();
        let (mut log, recovery, kept) = reopened(bytes[..cut].to_vec(), Tail::Mended).unwrap();
        prop_assert_eq!(recovery.records as usize, whole);
        prop_assert_eq!(&kept, &records[..whole]);
        let offset = log.append(&[(NOTE, b"next")]).unwrap()[0];
        prop_assert_eq!(log.read(offset).unwrap().1, b"next");
    }

    #[test]
    fn a_flipped_bit_is_damage_or_ends_the_log_but_never_changes_a_record(
        unsynced in 0..4_usize, position in any::<prop::sample::Index>(), bit in 0..8_u8,
    ) {
        let records: [&[u8]; 3] = [b"first", b"second", b"third"];
        let mut bytes = written(&records, unsynced);
        let position = position.index(bytes.len());
        bytes[position] ^= 1_u8 << bit;
        if let Ok((_, _, kept)) = reopened(bytes, Tail::Mended) {
            prop_assert_eq!(&kept[..], &records[..kept.len()]);
            // The zero bytes of the log's header mean nothing and are not checked.
            prop_assert!(kept.len() < 3 || (12..16).contains(&position));
        }
    }

    #[test]
    fn a_survey_accounts_for_every_byte_and_agrees_with_opening(
        unsynced in 0..4_usize,
        flips in proptest::collection::vec((16..200_usize, 0..8_u8), 0..4),
        cut in 16..200_usize,
    ) {
        let mut bytes = written(&[b"first", b"second", b"third"], unsynced);
        bytes.truncate(cut);
        for (position, bit) in flips {
            if let Some(byte) = bytes.get_mut(position) {
                *byte ^= 1 << bit;
            }
        }
        for tail in [Tail::Ignored, Tail::Sealed] {
            let found = surveyed(&bytes, tail);
            let end = found.iter().fold(LOG_HEADER_BYTES, |end, &(_, offset, length)| {
                assert_eq!(offset, end);
                end + length
            });
            prop_assert_eq!(end, bytes.len() as u64);
            let is_damaged = found.iter().any(|&(what, ..)| what == 'b');
            // Records that are not wanted are not looked at in a finished log.
            let opened = open(&Arc::new(MemoryFile::new(bytes.clone())), tail);
            prop_assert_eq!(opened.is_err(), is_damaged);
        }
    }
}
