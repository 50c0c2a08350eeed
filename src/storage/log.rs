//! An append-only log of records, each framed by its length and checksum.
//!
//! The log begins with 16 bytes: magic (8), version (u32 little-endian), zero (4). Each record is its
//! length (u32 little-endian), the CRC-32 of its payload (u32 little-endian), and the payload.
//!
//! When power fails during an append the last record is torn; opening the log cuts it off and says
//! so. A record that is bad in the middle of the log is damage, never cut in silence.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::{FileKind, StorageError};

const LOG_HEADER_BYTES: u64 = 16;
const FRAME_BYTES: u64 = 8;
/// Longest payload in bytes; a longer length can only be damage.
const MAX_PAYLOAD_BYTES: u32 = 16 << 20;

/// Where the bytes of a log live.
pub trait LogStore: Send {
    /// Length in bytes.
    ///
    /// # Errors
    /// What the medium says.
    fn len(&self) -> io::Result<u64>;

    /// Whether nothing was ever written.
    ///
    /// # Errors
    /// What the medium says.
    fn is_empty(&self) -> io::Result<bool> {
        Ok(self.len()? == 0)
    }

    /// Fills `buffer` from `offset`.
    ///
    /// # Errors
    /// What the medium says, and `UnexpectedEof` beyond the end.
    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()>;

    /// Adds `bytes` at the end.
    ///
    /// # Errors
    /// What the medium says.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Cuts everything from `length` on.
    ///
    /// # Errors
    /// What the medium says.
    fn truncate(&mut self, length: u64) -> io::Result<()>;

    /// Returns when everything appended would survive a power cut.
    ///
    /// # Errors
    /// What the medium says.
    fn sync(&mut self) -> io::Result<()>;
}

/// A log in a file.
pub struct FileLog(File);

impl FileLog {
    /// Opens the file at `path` for reading and, if `writable`, appending; then it is made if need be.
    ///
    /// # Errors
    /// If the file cannot be opened so.
    pub fn open(path: &Path, writable: bool) -> Result<Self, StorageError> {
        let mut options = OpenOptions::new();
        options.read(true);
        if writable {
            options.append(true).create(true);
        }
        options.open(path).map(Self).map_err(StorageError::io("open", path))
    }

    /// Keeps other processes from locking the file until this one closes it.
    ///
    /// # Errors
    /// If another one holds it; `path` serves the message.
    pub fn lock(self, path: &Path) -> Result<Self, StorageError> {
        match self.0.try_lock() {
            Ok(()) => Ok(self),
            Err(TryLockError::WouldBlock) => {
                Err(StorageError::io("lock", path)(io::Error::other("another process is writing it")))
            }
            Err(TryLockError::Error(source)) => Err(StorageError::io("lock", path)(source)),
        }
    }
}

impl LogStore for FileLog {
    fn len(&self) -> io::Result<u64> {
        Ok(self.0.metadata()?.len())
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
        self.0.read_exact_at(buffer, offset)
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.0.set_len(length)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.0.sync_data()
    }
}

/// A log in memory, gone with the process.
#[derive(Default)]
pub struct MemoryLog(Vec<u8>);

impl LogStore for MemoryLog {
    fn len(&self) -> io::Result<u64> {
        Ok(self.0.len() as u64)
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
        let start = usize::try_from(offset).unwrap_or(usize::MAX);
        let bytes = self.0.get(start..start.saturating_add(buffer.len()));
        buffer.copy_from_slice(bytes.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.extend_from_slice(bytes);
        Ok(())
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.0.truncate(usize::try_from(length).unwrap_or(usize::MAX));
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// What opening a log found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Recovery {
    /// Whole records.
    pub records: u64,
    /// Bytes of a torn last record that were cut off (or are ignored, when reading only).
    pub torn_bytes: u64,
}

/// An append-only log of checksummed records.
pub struct RecordLog {
    store: Box<dyn LogStore>,
    path: PathBuf,
    end: u64,
}

impl RecordLog {
    /// Opens a log, hands every record with its offset to `visit`, and cuts a torn tail when
    /// `writable`. An empty store becomes a new log. `path` only serves messages.
    ///
    /// # Errors
    /// If the log is of another kind or newer, a record before the last is bad, or the medium fails.
    pub fn open(
        store: Box<dyn LogStore>,
        kind: &FileKind,
        path: &Path,
        writable: bool,
        mut visit: impl FnMut(u64, &[u8]) -> Result<(), StorageError>,
    ) -> Result<(Self, Recovery), StorageError> {
        let mut log = Self { store, path: path.to_owned(), end: 0 };
        let length = log.store.len().map_err(StorageError::io("read", path))?;
        log.end = log.check_or_write_header(kind, length, writable)?;
        let mut recovery = Recovery::default();
        let mut payload = Vec::new();
        while let Some(next) = log.read_next(length, &mut payload)? {
            visit(log.end, &payload)?;
            recovery.records += 1;
            log.end = next;
        }
        recovery.torn_bytes = length.saturating_sub(log.end);
        if recovery.torn_bytes > 0 && writable {
            log.store.truncate(log.end).map_err(StorageError::io("repair", path))?;
        }
        Ok((log, recovery))
    }

    /// Adds a record and answers its offset. It survives a power cut once [`sync`](Self::sync)
    /// returned.
    ///
    /// # Errors
    /// If the payload is longer than 16 MiB or the medium fails; the log then ends where it did.
    pub fn append(&mut self, payload: &[u8]) -> Result<u64, StorageError> {
        let length = u32::try_from(payload.len()).ok().filter(|&length| length <= MAX_PAYLOAD_BYTES);
        let Some(length) = length else {
            let source = io::Error::other(format!("a record of {} bytes is too long", payload.len()));
            return Err(StorageError::Io { action: "append to", path: self.path.clone(), source });
        };
        let mut framed = Vec::with_capacity(payload.len() + FRAME_BYTES as usize);
        framed.extend_from_slice(&length.to_le_bytes());
        framed.extend_from_slice(&crc32fast::hash(payload).to_le_bytes());
        framed.extend_from_slice(payload);
        let offset = self.end;
        if let Err(source) = self.store.append(&framed) {
            // A half-written frame must not end up in the middle of the log.
            let _ = self.store.truncate(offset);
            return Err(StorageError::Io { action: "append to", path: self.path.clone(), source });
        }
        self.end += framed.len() as u64;
        Ok(offset)
    }

    /// The payload of the record at `offset`.
    ///
    /// # Errors
    /// If there is no good record or the medium fails.
    pub fn read(&self, offset: u64) -> Result<Vec<u8>, StorageError> {
        let mut payload = Vec::new();
        match self.read_frame(offset, self.end, &mut payload)? {
            Frame::Good { .. } => Ok(payload),
            Frame::End | Frame::Torn | Frame::Bad => Err(self.damaged(offset)),
        }
    }

    /// Returns when every appended record would survive a power cut.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn sync(&mut self) -> Result<(), StorageError> {
        self.store.sync().map_err(StorageError::io("sync", &self.path))
    }

    /// Length of the log in bytes.
    #[must_use]
    pub fn length_bytes(&self) -> u64 {
        self.end
    }

    fn check_or_write_header(
        &mut self,
        kind: &FileKind,
        length: u64,
        writable: bool,
    ) -> Result<u64, StorageError> {
        let mut expected = [0; LOG_HEADER_BYTES as usize];
        expected[..8].copy_from_slice(&kind.magic);
        expected[8..12].copy_from_slice(&kind.version.to_le_bytes());
        let mut header = expected;
        let there = length.min(LOG_HEADER_BYTES) as usize;
        let path = self.path.as_path();
        self.store.read_at(0, &mut header[..there]).map_err(StorageError::io("read", path))?;
        if header[..8] != kind.magic {
            let reason = "it does not begin as one".to_owned();
            return Err(StorageError::WrongKind { path: path.to_owned(), kind: kind.name, reason });
        }
        let got = u32::from_le_bytes([header[8], header[9], header[10], header[11]]);
        if got > kind.version {
            let (path, kind, newest) = (path.to_owned(), kind.name, kind.version);
            return Err(StorageError::TooNew { path, kind, got, newest });
        }
        if length < LOG_HEADER_BYTES && writable {
            // New, or torn while it was made: nothing can have been lost.
            self.store.truncate(0).map_err(StorageError::io("create", path))?;
            self.store.append(&expected).map_err(StorageError::io("create", path))?;
        }
        Ok(length.min(LOG_HEADER_BYTES).max(if writable { LOG_HEADER_BYTES } else { 0 }))
    }

    /// Reads the record at the end of what was read so far; `None` when there is no further whole
    /// record.
    fn read_next(&self, length: u64, payload: &mut Vec<u8>) -> Result<Option<u64>, StorageError> {
        match self.read_frame(self.end, length, payload)? {
            Frame::Good { next } => Ok(Some(next)),
            Frame::End | Frame::Torn => Ok(None),
            Frame::Bad if self.rest_is_zero(length)? => Ok(None),
            Frame::Bad => Err(self.damaged(self.end)),
        }
    }

    fn read_frame(&self, offset: u64, length: u64, payload: &mut Vec<u8>) -> Result<Frame, StorageError> {
        if offset >= length {
            return Ok(Frame::End);
        }
        if length - offset < FRAME_BYTES {
            return Ok(Frame::Torn);
        }
        let read = |at, buffer: &mut [u8]| {
            self.store.read_at(at, buffer).map_err(StorageError::io("read", &self.path))
        };
        let mut frame = [0; FRAME_BYTES as usize];
        read(offset, &mut frame)?;
        let payload_bytes = u32::from_le_bytes([frame[0], frame[1], frame[2], frame[3]]);
        let checksum = u32::from_le_bytes([frame[4], frame[5], frame[6], frame[7]]);
        if payload_bytes == 0 || payload_bytes > MAX_PAYLOAD_BYTES {
            return Ok(Frame::Bad);
        }
        let next = offset + FRAME_BYTES + u64::from(payload_bytes);
        if next > length {
            return Ok(Frame::Torn);
        }
        payload.resize(payload_bytes as usize, 0);
        read(offset + FRAME_BYTES, payload)?;
        match (crc32fast::hash(payload) == checksum, next == length) {
            (true, _) => Ok(Frame::Good { next }),
            (false, true) => Ok(Frame::Torn),
            (false, false) => Ok(Frame::Bad),
        }
    }

    /// A file system may lengthen a file before it writes the bytes: a tail of zeros is torn, too.
    fn rest_is_zero(&self, length: u64) -> Result<bool, StorageError> {
        let mut chunk = [0; 4096];
        let mut offset = self.end;
        while offset < length {
            let part = &mut chunk[..(length - offset).min(4096) as usize];
            self.store.read_at(offset, part).map_err(StorageError::io("read", &self.path))?;
            if part.iter().any(|&byte| byte != 0) {
                return Ok(false);
            }
            offset += part.len() as u64;
        }
        Ok(true)
    }

    fn damaged(&self, offset: u64) -> StorageError {
        let reason = format!("bad record at byte {offset}");
        StorageError::Damaged { path: self.path.clone(), reason }
    }
}

enum Frame {
    Good { next: u64 },
    End,
    Torn,
    Bad,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const KIND: FileKind = FileKind { magic: *b"LOCITEST", version: 1, name: "test log" };

    type Opened = (RecordLog, Recovery, Vec<Vec<u8>>);

    fn open(bytes: Vec<u8>) -> Result<Opened, StorageError> {
        let mut records = Vec::new();
        let (log, recovery) =
            RecordLog::open(Box::new(MemoryLog(bytes)), &KIND, Path::new("log"), true, |_, payload| {
                records.push(payload.to_vec());
                Ok(())
            })?;
        Ok((log, recovery, records))
    }

    fn written(records: &[Vec<u8>]) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let store = Box::new(FileLog::open(&path, true).unwrap());
        let (mut log, _) = RecordLog::open(store, &KIND, &path, true, |_, _| Ok(())).unwrap();
        for record in records {
            log.append(record).unwrap();
        }
        log.sync().unwrap();
        std::fs::read(&path).unwrap()
    }

    #[test]
    fn records_can_be_read_again_by_their_offset() {
        let (mut log, _, _) = open(Vec::new()).unwrap();
        let offsets = [log.append(b"one").unwrap(), log.append(b"three").unwrap()];
        assert_eq!(log.read(offsets[0]).unwrap(), b"one");
        assert_eq!(log.read(offsets[1]).unwrap(), b"three");
        assert!(log.read(offsets[1] + 1).is_err());
    }

    #[test]
    fn a_bad_record_in_the_middle_is_damage() {
        let mut bytes = written(&[b"first".to_vec(), b"second".to_vec()]);
        bytes[LOG_HEADER_BYTES as usize + FRAME_BYTES as usize] ^= 1;
        let error = open(bytes).err().unwrap().to_string();
        assert_eq!(error, "log is damaged: bad record at byte 16; restore it from a copy");
    }

    #[test]
    fn a_tail_of_zeros_is_torn() {
        let mut bytes = written(&[b"first".to_vec()]);
        bytes.extend([0; 5000]);
        let (_, recovery, records) = open(bytes).unwrap();
        assert_eq!((recovery.torn_bytes, records), (5000, vec![b"first".to_vec()]));
    }

    #[test]
    fn a_foreign_log_is_refused() {
        let error = open(b"something else entirely".to_vec()).err().unwrap().to_string();
        assert_eq!(error, "log is not a test log: it does not begin as one");
    }

    proptest! {
        #[test]
        fn a_cut_anywhere_keeps_every_whole_record(
            records in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 1..40), 1..6),
            cut in any::<prop::sample::Index>(),
        ) {
            let bytes = written(&records);
            let cut = cut.index(bytes.len() + 1);
            let mut end = LOG_HEADER_BYTES as usize;
            let whole = records.iter().take_while(|record| {
                end += FRAME_BYTES as usize + record.len();
                end <= cut
            }).count();
            let (mut log, recovery, kept) = open(bytes[..cut].to_vec()).unwrap();
            prop_assert_eq!(recovery.records as usize, whole);
            prop_assert_eq!(&kept, &records[..whole]);
            let offset = log.append(b"next").unwrap();
            prop_assert_eq!(log.read(offset).unwrap(), b"next");
        }
    }
}
