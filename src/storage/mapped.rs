//! The bytes of a file that is used in place, straight from the page cache.
#![expect(unsafe_code, reason = "mapping a file is unsafe; this is the one place that does it")]

use std::fs::File;
use std::io;
use std::ops::Deref;
use std::path::Path;

use memmap2::Mmap;

use super::StorageError;

/// Bytes of a mapped file, or of one that was just made and has no file yet.
#[derive(Debug)]
pub enum FileBytes {
    /// A read-only mapping.
    Mapped(Mmap),
    /// Bytes in memory.
    Owned(Vec<u8>),
}

impl FileBytes {
    /// Maps the file at `path` read-only.
    ///
    /// # Errors
    /// If it is not a regular file or cannot be opened.
    pub fn map(path: &Path) -> Result<Self, StorageError> {
        Self::open(path).map_err(StorageError::io("open", path))
    }

    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let metadata = path.metadata()?;
        if !metadata.is_file() {
            return Err(io::Error::other("not a regular file"));
        }
        if metadata.len() == 0 {
            return Ok(Self::Owned(Vec::new()));
        }
        let file = File::open(path)?;
        // SAFETY: the mapping is read-only and private. The files mapped here are replaced by rename (`replace`) or
        // removed, never written in place, so their pages do not change or vanish under us.
        let map = unsafe { Mmap::map(&file) }?;
        Ok(Self::Mapped(map))
    }
}

impl Deref for FileBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Owned(bytes) => bytes,
        }
    }
}
