//! Which log a file is: what its first 16 bytes say, and what they should.

use std::path::Path;

use super::LOG_HEADER_BYTES;
use crate::storage::{AppendFile, FileKind, StorageError};

/// Where it says which log it is.
const NUMBER_OFFSET: usize = 12;

/// Which log a file is to be.
#[derive(Clone, Copy, Debug)]
pub struct LogIdentity<'a> {
    /// Its kind.
    pub kind: &'a FileKind,
    /// Which of several logs that belong together; 0 for one that stands alone.
    pub number: u32,
    /// The file, for messages.
    pub path: &'a Path,
}

impl LogIdentity<'_> {
    pub(super) fn header(&self) -> [u8; LOG_HEADER_BYTES as usize] {
        let mut header = [0; LOG_HEADER_BYTES as usize];
        header[..8].copy_from_slice(&self.kind.magic);
        header[8..NUMBER_OFFSET].copy_from_slice(&self.kind.version.to_le_bytes());
        header[NUMBER_OFFSET..].copy_from_slice(&self.number.to_le_bytes());
        header
    }
}

/// Magic and version of a log, zeros where it is shorter.
///
/// # Errors
/// If the medium fails.
pub fn log_kind(file: &dyn AppendFile, path: &Path) -> Result<([u8; 8], u32), StorageError> {
    let Header { magic, version, .. } = Header::read(file, path)?;
    Ok((magic, version))
}

/// What a log says of itself, zeros where it is shorter and no number if that is not whole.
pub(super) struct Header {
    pub(super) magic: [u8; 8],
    pub(super) version: u32,
    pub(super) number: u32,
}

impl Header {
    pub(super) fn read(file: &dyn AppendFile, path: &Path) -> Result<Self, StorageError> {
        let mut bytes = [0; LOG_HEADER_BYTES as usize];
        let there =
            file.length_bytes().map_err(StorageError::io("read", path))?.min(LOG_HEADER_BYTES) as usize;
        file.read_at(0, &mut bytes[..there]).map_err(StorageError::io("read", path))?;
        let [magic @ .., v0, v1, v2, v3, n0, n1, n2, n3] = bytes;
        Ok(Self {
            magic,
            version: u32::from_le_bytes([v0, v1, v2, v3]),
            number: if there == bytes.len() { u32::from_le_bytes([n0, n1, n2, n3]) } else { 0 },
        })
    }
}
