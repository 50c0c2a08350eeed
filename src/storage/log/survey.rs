//! A log looked at to its last byte, beyond whatever is bad in it: for those who look after it. Opening is stricter
//! and stops at the first bad record.

use std::ops::ControlFlow;
use std::sync::Arc;

use super::{LOG_HEADER_BYTES, LogIdentity, LoggedRecord, RECORD_HEADER_BYTES, RecordLog};
use crate::storage::record::{Envelope, HEADER_BYTES, RecordHeader};
use crate::storage::{AppendFile, StorageError};

/// Bytes that are searched at once for a header.
const CHUNK_BYTES: u64 = 1 << 16;

/// What stands in a log.
#[derive(Clone, Copy, Debug)]
pub enum Surveyed<'a> {
    /// A record whose checksums are right.
    Whole(LoggedRecord<'a>),
    /// Bytes that had been a record.
    Bad {
        /// Where they begin.
        offset: u64,
        /// What the payload was, if at least that can be told.
        envelope: Option<Envelope>,
        /// Bytes up to where the next record may be.
        length_bytes: u64,
    },
    /// What a power cut, or a writer that is just writing, left at the end.
    Torn {
        /// Where it begins.
        offset: u64,
        /// Its length.
        length_bytes: u64,
    },
}

/// What stands at an offset of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Footing {
    /// A record begins there, or the log ends.
    Boundary,
    /// It lies within a record.
    Within,
    /// A bad record before it hides where records begin.
    Hidden {
        /// Where that one is.
        by: u64,
    },
}

impl RecordLog {
    /// What stands at `offset`, told by going from record to record, at `from` or the log's beginning first. No payload
    /// is read.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn footing(&self, from: u64, offset: u64) -> Result<Footing, StorageError> {
        let mut at = from.max(LOG_HEADER_BYTES);
        while at < offset {
            match self.read_record(at, self.length_bytes(), None)? {
                Some(header) => at += RECORD_HEADER_BYTES + u64::from(header.payload_bytes),
                None => return Ok(Footing::Hidden { by: at }),
            }
        }
        Ok(if at == offset { Footing::Boundary } else { Footing::Within })
    }

    /// Reads the log in `file` to its end, going on behind every bad record, and changes nothing. What is bad in its
    /// first `durable_bytes`, which are known to have been on the medium, is damage and no torn tail.
    ///
    /// # Errors
    /// If it is another log, of another kind or version, or the medium fails.
    pub fn survey(
        file: Arc<dyn AppendFile>,
        identity: LogIdentity<'_>,
        durable_bytes: u64,
        visit: &mut dyn FnMut(Surveyed<'_>),
    ) -> Result<(), StorageError> {
        let length = file.length_bytes().map_err(StorageError::io("read", identity.path))?;
        let log = Self::over(file, identity.path);
        if log.is_torn_at_birth(identity, length)? {
            if durable_bytes > 0 {
                visit(Surveyed::Bad { offset: 0, envelope: None, length_bytes: length });
            } else if length > 0 {
                visit(Surveyed::Torn { offset: 0, length_bytes: length });
            }
            return Ok(());
        }
        log.check_header(identity)?;
        if length < LOG_HEADER_BYTES {
            visit(Surveyed::Bad { offset: 0, envelope: None, length_bytes: length });
            return Ok(());
        }
        log.survey_records(length, durable_bytes, visit)
    }

    fn survey_records(
        &self,
        length: u64,
        durable_bytes: u64,
        visit: &mut dyn FnMut(Surveyed<'_>),
    ) -> Result<(), StorageError> {
        let (mut offset, mut payload) = (LOG_HEADER_BYTES, Vec::new());
        // What the records behind the first bad one testify, found out once for all.
        let mut testified = None;
        while offset < length {
            if let Some(header) = self.read_record(offset, length, Some(&mut payload))? {
                let length_bytes = RECORD_HEADER_BYTES + u64::from(header.payload_bytes);
                let (envelope, payload) = (header.envelope, Some(payload.as_slice()));
                visit(Surveyed::Whole(LoggedRecord { offset, envelope, payload, length_bytes }));
                offset += length_bytes;
                continue;
            }
            let testified = match testified {
                Some(bytes) => bytes,
                None => *testified.insert(self.durable_bytes_behind(offset, length)?),
            };
            if durable_bytes.max(testified) <= offset {
                visit(Surveyed::Torn { offset, length_bytes: length - offset });
                break;
            }
            let (envelope, length_bytes) = self.bad_record(offset, length)?;
            visit(Surveyed::Bad { offset, envelope, length_bytes });
            offset += length_bytes;
        }
        Ok(())
    }

    /// What can be told of the bad record at `offset`, and how many bytes to skip.
    fn bad_record(&self, offset: u64, length: u64) -> Result<(Option<Envelope>, u64), StorageError> {
        if let Some(header) = self.read_record(offset, length, None)? {
            // The payload alone is bad.
            return Ok((Some(header.envelope), RECORD_HEADER_BYTES + u64::from(header.payload_bytes)));
        }
        let mut next = length;
        self.visit_headers(offset + 1, length, &mut |at, _| {
            next = at;
            ControlFlow::Break(())
        })?;
        Ok((None, next - offset))
    }

    /// How many bytes of the log had been on the medium, as the records behind `offset` testify.
    fn durable_bytes_behind(&self, offset: u64, length: u64) -> Result<u64, StorageError> {
        let mut durable_bytes = 0;
        self.visit_headers(offset, length, &mut |_, header| {
            durable_bytes = durable_bytes.max(header.durable_bytes);
            ControlFlow::Continue(())
        })?;
        Ok(durable_bytes)
    }

    /// Whether a record behind `offset` testifies that the bytes at `offset` had been on the medium.
    pub(super) fn was_durable(&self, offset: u64, length: u64) -> Result<bool, StorageError> {
        let mut was_durable = false;
        self.visit_headers(offset, length, &mut |_, header| {
            was_durable = header.durable_bytes > offset;
            if was_durable { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })?;
        Ok(was_durable)
    }

    /// Every header from byte `from` on, wherever it stands, with its offset.
    fn visit_headers(
        &self,
        from: u64,
        length: u64,
        visit: &mut dyn FnMut(u64, RecordHeader) -> ControlFlow<()>,
    ) -> Result<(), StorageError> {
        let mut chunk = vec![0; CHUNK_BYTES as usize];
        let mut at = from;
        while at + RECORD_HEADER_BYTES <= length {
            let part = &mut chunk[..(length - at).min(CHUNK_BYTES) as usize];
            self.shared.file.read_at(at, part).map_err(StorageError::io("read", &self.shared.path))?;
            for (start, bytes) in (at..).zip(part.windows(HEADER_BYTES)) {
                let header = bytes.try_into().ok().and_then(RecordHeader::from_bytes);
                if header.is_some_and(|header| visit(start, header).is_break()) {
                    return Ok(());
                }
            }
            at += part.len() as u64 - RECORD_HEADER_BYTES + 1;
        }
        Ok(())
    }
}
