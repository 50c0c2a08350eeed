//! An append-only log of records.
//!
//! The log begins with 16 bytes, all numbers little-endian: magic (8), version (u32), and which of several logs it is
//! (u32; 0 where nobody says). Then come the records, each behind a header: ARCHITECTURE.md has their bytes.
//!
//! A power cut may tear whatever was written since the last sync, in any order. So the first bad record ends the
//! log, unless a record behind it testifies that it had been on the medium: then it is damage, and never cut off in
//! silence.

mod identity;
mod shared;
mod survey;

pub use identity::{LogIdentity, log_kind};
pub use shared::LogSyncer;
pub use survey::{Footing, Surveyed};

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::record::{Envelope, HEADER_BYTES, RecordHeader};
use super::{AppendFile, FileKind, StorageError};
use identity::Header;
use shared::Shared;

/// Bytes of a log before its first record.
pub const LOG_HEADER_BYTES: u64 = 16;
/// Bytes of a record before its payload.
pub const RECORD_HEADER_BYTES: u64 = HEADER_BYTES as u64;

/// What may be at the end of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tail {
    /// Whatever a power cut left; it is cut off, and the log goes on.
    Mended,
    /// Whatever a power cut left, or what a writer is just about to write; it is left alone.
    Ignored,
    /// Whole records alone: the log was finished. Records that the reader does not want are not looked at.
    Sealed,
}

/// A record of a log that is being opened.
#[derive(Clone, Copy, Debug)]
pub struct LoggedRecord<'a> {
    /// Where it is, in bytes.
    pub offset: u64,
    /// What its payload is.
    pub envelope: Envelope,
    /// The payload; `None` for one that was not wanted.
    pub payload: Option<&'a [u8]>,
    /// Bytes that it takes, its header included.
    pub length_bytes: u64,
}

/// What to hand out of a log that is being opened.
pub struct Reading<'a> {
    /// Where to begin: a record's offset, or 0.
    pub from: u64,
    /// Whether the payload is wanted.
    pub wanted: fn(Envelope) -> bool,
    /// Hears of every record; a complaint is damage.
    pub visit: &'a mut dyn FnMut(LoggedRecord<'_>) -> Result<(), String>,
}

/// What opening a log found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Recovery {
    /// Whole records.
    pub records: u64,
    /// Bytes of a torn tail that were cut off (or are ignored, when reading only).
    pub torn_bytes: u64,
}

/// An append-only log of checksummed records.
pub struct RecordLog {
    shared: Arc<Shared>,
}

impl RecordLog {
    /// Opens a log and hands its records to `reading`. An empty file becomes a new log if it may be mended.
    ///
    /// # Errors
    /// If it is another log, of another kind or version, is damaged, or the medium fails.
    pub fn open(
        file: Arc<dyn AppendFile>,
        identity: LogIdentity<'_>,
        tail: Tail,
        reading: Reading<'_>,
    ) -> Result<(Self, Recovery), StorageError> {
        let length = file.length_bytes().map_err(StorageError::io("read", identity.path))?;
        let log = Self::over(file, identity.path);
        let mut recovery = Recovery::default();
        if !log.is_torn_at_birth(identity, length)? {
            log.check_header(identity)?;
            recovery = log.replay(length, tail, reading)?;
            log.shared.end.store(length - recovery.torn_bytes, Ordering::Release);
        } else if tail == Tail::Sealed {
            return Err(log.damaged(0));
        }
        if tail == Tail::Mended {
            log.mend(identity)?;
        }
        Ok((log, recovery))
    }

    /// A log whose file was not looked at yet.
    fn over(file: Arc<dyn AppendFile>, path: &Path) -> Self {
        Self { shared: Arc::new(Shared::new(file, path, LOG_HEADER_BYTES)) }
    }

    /// A log whose first `length_bytes` may hold anything: only [`read`](Self::read) and those who look after it can
    /// make something of it.
    #[must_use]
    pub fn unread(file: Arc<dyn AppendFile>, path: &Path, length_bytes: u64) -> Self {
        Self { shared: Arc::new(Shared::new(file, path, length_bytes)) }
    }

    /// Whether a record begins at `offset` whose header is whole, and all of which is there.
    #[must_use]
    pub fn has_record(&self, offset: u64) -> bool {
        matches!(self.read_record(offset, self.length_bytes(), None), Ok(Some(_)))
    }

    /// Leaves out what stands behind byte `length_bytes` of a log in which nothing was written yet.
    pub fn end_at(&self, length_bytes: u64) {
        self.shared.end.store(length_bytes.min(self.length_bytes()), Ordering::Release);
    }

    /// Adds records, all in one write, and answers their offsets. They survive a power cut once
    /// [`sync`](Self::sync) returned.
    ///
    /// # Errors
    /// If a payload is empty or longer than 16 MiB or the medium fails; the log then ends where it did.
    pub fn append(&mut self, records: &[(Envelope, &[u8])]) -> Result<Vec<u64>, StorageError> {
        let error = |source| StorageError::Io { action: "append to", path: self.shared.path.clone(), source };
        self.shared.check().map_err(error)?;
        let end = self.shared.end.load(Ordering::Acquire);
        let durable = self.shared.durable.load(Ordering::Acquire);
        let mut framed = Vec::new();
        let mut offsets = Vec::with_capacity(records.len());
        for &(envelope, payload) in records {
            offsets.push(end + framed.len() as u64);
            let Some(header) = RecordHeader::new(envelope, payload, durable) else {
                let length = payload.len();
                return Err(error(io::Error::other(format!("a record must not have {length} bytes"))));
            };
            framed.extend(header.to_bytes());
            framed.extend_from_slice(payload);
        }
        if let Err(source) = self.shared.file.append(&framed) {
            self.shared.cut(end);
            return Err(error(source));
        }
        self.shared.end.store(end + framed.len() as u64, Ordering::Release);
        Ok(offsets)
    }

    /// Bytes that a record with `payload` takes.
    #[must_use]
    pub fn framed_bytes(payload: &[u8]) -> u64 {
        RECORD_HEADER_BYTES + payload.len() as u64
    }

    /// The record at `offset`.
    ///
    /// # Errors
    /// If there is no good record or the medium fails.
    pub fn read(&self, offset: u64) -> Result<(Envelope, Vec<u8>), StorageError> {
        let mut payload = Vec::new();
        self.read_into(offset, &mut payload).map(|envelope| (envelope, payload))
    }

    /// As [`read`](Self::read), the payload being written over what is in `payload`.
    ///
    /// # Errors
    /// As [`read`](Self::read); then `payload` may hold anything.
    pub fn read_into(&self, offset: u64, payload: &mut Vec<u8>) -> Result<Envelope, StorageError> {
        let header = self.read_record(offset, self.length_bytes(), Some(payload))?;
        header.map(|header| header.envelope).ok_or_else(|| self.damaged(offset))
    }

    /// Hands the records before byte `until`, within the log, to `reading` once more.
    ///
    /// # Errors
    /// If one of them that is wanted is bad, none ends there, or the medium fails.
    pub fn reread(&self, until: u64, reading: Reading<'_>) -> Result<Recovery, StorageError> {
        self.replay(until, Tail::Sealed, reading)
    }

    /// Returns when every appended record would survive a power cut.
    ///
    /// # Errors
    /// If the medium fails. What it lost then is unknown, so the log must not be written any more.
    pub fn sync(&self) -> Result<(), StorageError> {
        self.shared.sync()
    }

    /// What can sync the log from another thread.
    #[must_use]
    pub fn syncer(&self) -> LogSyncer {
        LogSyncer(Arc::clone(&self.shared))
    }

    /// The file, for those who look whether it still has a name.
    #[must_use]
    pub fn file(&self) -> Arc<dyn AppendFile> {
        Arc::clone(&self.shared.file)
    }

    /// Length of the log in bytes.
    #[must_use]
    pub fn length_bytes(&self) -> u64 {
        self.shared.end.load(Ordering::Acquire)
    }

    /// Makes a log whose tail was ignored ready to be written: a torn tail is cut off, an empty file begun, and
    /// everything brought onto the medium, for nobody knows whether it is.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn mend(&self, identity: LogIdentity<'_>) -> Result<(), StorageError> {
        let Shared { file, path, .. } = self.shared.as_ref();
        let length = file.length_bytes().map_err(StorageError::io("read", path))?;
        if self.is_torn_at_birth(identity, length)? {
            let begun = file.truncate(0).and_then(|()| file.append(&identity.header()));
            begun.map_err(StorageError::io("create", path))?;
            self.shared.end.store(LOG_HEADER_BYTES, Ordering::Release);
        } else if length > self.length_bytes() {
            file.truncate(self.length_bytes()).map_err(StorageError::io("repair", path))?;
        }
        self.sync()
    }

    /// Whether a log of `length` bytes is new or was torn while it was made.
    fn is_torn_at_birth(&self, identity: LogIdentity<'_>, length: u64) -> Result<bool, StorageError> {
        if length > LOG_HEADER_BYTES {
            return Ok(false);
        }
        let mut there = vec![0; length as usize];
        self.shared.file.read_at(0, &mut there).map_err(StorageError::io("read", &self.shared.path))?;
        let header = identity.header();
        let nameless = LogIdentity { number: 0, ..identity }.header();
        let is_whole = there == header || there == nameless;
        Ok(!is_whole && there.iter().zip(header).all(|(&byte, whole)| byte == whole || byte == 0))
    }

    fn check_header(&self, identity: LogIdentity<'_>) -> Result<(), StorageError> {
        let LogIdentity { kind: &FileKind { magic, version, name }, number, path } = identity;
        let path = path.to_owned();
        let Header { magic: found, version: got, number: is } =
            Header::read(self.shared.file.as_ref(), &path)?;
        if found != magic {
            let reason = "it does not begin as one".to_owned();
            return Err(StorageError::WrongKind { path, kind: name, reason });
        }
        match got.cmp(&version) {
            std::cmp::Ordering::Equal => {}
            std::cmp::Ordering::Greater => {
                return Err(StorageError::TooNew { path, kind: name, got, newest: version });
            }
            std::cmp::Ordering::Less => {
                return Err(StorageError::TooOld { path, kind: name, got, oldest: version });
            }
        }
        if is != 0 && is != number {
            return Err(StorageError::Misplaced { path, kind: name, got: is, expected: number });
        }
        Ok(())
    }

    fn replay(&self, length: u64, tail: Tail, reading: Reading<'_>) -> Result<Recovery, StorageError> {
        let Reading { from, wanted, visit } = reading;
        let mut recovery = Recovery::default();
        let mut offset = from.max(LOG_HEADER_BYTES);
        if offset > length {
            let reason = format!("it ends after {length} bytes, but had {offset}");
            return Err(StorageError::Damaged { path: self.shared.path.clone(), reason });
        }
        let mut payload = Vec::new();
        while offset < length {
            let is_lazy = |envelope| tail == Tail::Sealed && !wanted(envelope);
            let Some((header, is_read)) = self.read_wanted(offset, length, &mut payload, is_lazy)? else {
                if tail == Tail::Sealed || self.was_durable(offset, length)? {
                    return Err(self.damaged(offset));
                }
                recovery.torn_bytes = length - offset;
                break;
            };
            let length_bytes = RECORD_HEADER_BYTES + u64::from(header.payload_bytes);
            let payload = (is_read && wanted(header.envelope)).then_some(payload.as_slice());
            visit(LoggedRecord { offset, envelope: header.envelope, payload, length_bytes }).map_err(
                |reason| {
                    let reason = format!("record at byte {offset}: {reason}");
                    StorageError::Damaged { path: self.shared.path.clone(), reason }
                },
            )?;
            recovery.records += 1;
            offset += length_bytes;
        }
        Ok(recovery)
    }

    /// The header of the record at `offset`, and whether its payload was read; `None` if it is bad.
    fn read_wanted(
        &self,
        offset: u64,
        length: u64,
        payload: &mut Vec<u8>,
        is_lazy: impl Fn(Envelope) -> bool,
    ) -> Result<Option<(RecordHeader, bool)>, StorageError> {
        let Some(header) = self.read_record(offset, length, None)? else { return Ok(None) };
        if is_lazy(header.envelope) {
            return Ok(Some((header, false)));
        }
        Ok(self.read_record(offset, length, Some(payload))?.map(|header| (header, true)))
    }

    /// The header of the record at `offset`, whose payload, if asked for, is read and checked; `None` if it is
    /// bad or reaches beyond `length`.
    fn read_record(
        &self,
        offset: u64,
        length: u64,
        payload: Option<&mut Vec<u8>>,
    ) -> Result<Option<RecordHeader>, StorageError> {
        let read = |at, buffer: &mut [u8]| {
            self.shared.file.read_at(at, buffer).map_err(StorageError::io("read", &self.shared.path))
        };
        let left = length.saturating_sub(offset);
        if left <= RECORD_HEADER_BYTES {
            return Ok(None);
        }
        let mut bytes = [0; HEADER_BYTES];
        read(offset, &mut bytes)?;
        let Some(header) = RecordHeader::from_bytes(&bytes) else { return Ok(None) };
        if u64::from(header.payload_bytes) > left - RECORD_HEADER_BYTES {
            return Ok(None);
        }
        if let Some(payload) = payload {
            payload.resize(header.payload_bytes as usize, 0);
            read(offset + RECORD_HEADER_BYTES, payload)?;
            if !header.fits(payload) {
                return Ok(None);
            }
        }
        Ok(Some(header))
    }

    fn damaged(&self, offset: u64) -> StorageError {
        let reason = format!("bad record at byte {offset}");
        StorageError::Damaged { path: self.shared.path.clone(), reason }
    }
}

#[cfg(test)]
mod tests;
