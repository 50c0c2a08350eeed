//! Files that only grow: on a disk, or in memory.

use std::fs::{File, TryLockError};
use std::io::{self, Write};
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::StorageError;

/// A file that is written at its end alone. One thread appends; any may read and sync.
pub trait AppendFile: Send + Sync {
    /// Length in bytes.
    ///
    /// # Errors
    /// What the medium says.
    fn length_bytes(&self) -> io::Result<u64>;

    /// Fills `buffer` from `offset`.
    ///
    /// # Errors
    /// What the medium says, and `UnexpectedEof` beyond the end.
    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()>;

    /// Adds `bytes` at the end. If that fails, some of them may have been added.
    ///
    /// # Errors
    /// What the medium says.
    fn append(&self, bytes: &[u8]) -> io::Result<()>;

    /// Cuts everything from `length_bytes` on.
    ///
    /// # Errors
    /// What the medium says.
    fn truncate(&self, length_bytes: u64) -> io::Result<()>;

    /// Returns when everything appended before the call would survive a power cut.
    ///
    /// # Errors
    /// What the medium says, and that the file was deleted meanwhile.
    fn sync(&self) -> io::Result<()>;

    /// Whether the file still has a name. One that was deleted takes every byte and keeps none.
    ///
    /// # Errors
    /// What the medium says.
    fn is_linked(&self) -> io::Result<bool>;
}

/// Fails if `file`, which was just synced, has no name any more.
pub(super) fn refuse_deleted(file: &dyn AppendFile) -> io::Result<()> {
    match file.is_linked()? {
        true => Ok(()),
        false => Err(io::Error::other("it was deleted while it was being written")),
    }
}

/// A file on a disk.
#[derive(Debug)]
pub struct DiskFile(File);

impl DiskFile {
    /// Opens the file at `path` for reading and, if `writable`, appending; then it is made if need be.
    ///
    /// # Errors
    /// If the file cannot be opened so.
    pub fn open(path: &Path, writable: bool) -> io::Result<Self> {
        if path.metadata().is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir()) {
            // Opening a named pipe would wait for somebody at its other end.
            return Err(io::Error::other("not a regular file"));
        }
        let mut options = File::options();
        options.read(true);
        if writable {
            options.append(true).create(true);
        }
        options.open(path).map(Self)
    }

    /// Keeps other processes from locking the file until this one closes it.
    ///
    /// # Errors
    /// If another one holds it; `path` serves the message.
    pub fn lock(self, path: &Path) -> Result<Self, StorageError> {
        match self.0.try_lock() {
            Ok(()) => Ok(self),
            Err(TryLockError::WouldBlock) => Err(StorageError::io("lock", path)(io::Error::other(
                "another process is writing it; wait until it is done",
            ))),
            Err(TryLockError::Error(source)) => Err(StorageError::io("lock", path)(source)),
        }
    }
}

impl AppendFile for DiskFile {
    fn length_bytes(&self) -> io::Result<u64> {
        Ok(self.0.metadata()?.len())
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
        self.0.read_exact_at(buffer, offset)
    }

    fn append(&self, bytes: &[u8]) -> io::Result<()> {
        (&self.0).write_all(bytes)
    }

    fn truncate(&self, length_bytes: u64) -> io::Result<()> {
        self.0.set_len(length_bytes)
    }

    fn sync(&self) -> io::Result<()> {
        self.0.sync_data()?;
        refuse_deleted(self)
    }

    fn is_linked(&self) -> io::Result<bool> {
        Ok(self.0.metadata()?.nlink() > 0)
    }
}

/// A file in memory, gone with the process.
#[derive(Debug, Default)]
pub struct MemoryFile {
    bytes: Mutex<Vec<u8>>,
    is_deleted: AtomicBool,
}

impl MemoryFile {
    /// A file that holds `bytes`.
    #[must_use]
    pub fn new(bytes: Vec<u8>) -> Self {
        Self { bytes: Mutex::new(bytes), is_deleted: AtomicBool::new(false) }
    }

    /// From now on it has no name.
    pub(super) fn delete(&self) {
        self.is_deleted.store(true, Ordering::Release);
    }

    fn bytes(&self) -> MutexGuard<'_, Vec<u8>> {
        self.bytes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl AppendFile for MemoryFile {
    fn length_bytes(&self) -> io::Result<u64> {
        Ok(self.bytes().len() as u64)
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
        let start = usize::try_from(offset).unwrap_or(usize::MAX);
        let bytes = self.bytes();
        let part = bytes.get(start..start.saturating_add(buffer.len()));
        buffer.copy_from_slice(part.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    fn append(&self, bytes: &[u8]) -> io::Result<()> {
        self.bytes().extend_from_slice(bytes);
        Ok(())
    }

    fn truncate(&self, length_bytes: u64) -> io::Result<()> {
        self.bytes().truncate(usize::try_from(length_bytes).unwrap_or(usize::MAX));
        Ok(())
    }

    fn sync(&self) -> io::Result<()> {
        refuse_deleted(self)
    }

    fn is_linked(&self) -> io::Result<bool> {
        Ok(!self.is_deleted.load(Ordering::Acquire))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_deleted_under_its_writer_is_noticed_at_the_next_sync() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let file = DiskFile::open(&path, true).unwrap();
        file.append(b"kept").unwrap();
        file.sync().unwrap();
        std::fs::remove_file(&path).unwrap();
        file.append(b"lost").unwrap();
        assert!(file.sync().unwrap_err().to_string().contains("deleted"));
    }
}
