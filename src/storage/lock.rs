//! One writer a folder: an advisory lock that names its holder.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::Path;

use super::StorageError;

/// Held while a folder is being written; released when dropped, also by a crash.
#[derive(Debug)]
pub struct WriterLock {
    _file: File,
}

impl WriterLock {
    /// Locks `folder`.
    ///
    /// # Errors
    /// If another process holds it (its process id is in the message) or the folder is not writable.
    pub fn acquire(folder: &Path) -> Result<Self, StorageError> {
        let path = folder.join("writer.lock");
        let error = |action| StorageError::io(action, &path);
        let mut options = OpenOptions::new();
        let mut file =
            options.read(true).write(true).create(true).truncate(false).open(&path).map_err(error("open"))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut holder = String::new();
                (&mut file).take(20).read_to_string(&mut holder).map_err(error("read"))?;
                let reason =
                    format!("process {} is writing there; stop it or use --read-only", holder.trim());
                return Err(error("lock")(io::Error::other(reason)));
            }
            Err(TryLockError::Error(source)) => return Err(error("lock")(source)),
        }
        file.set_len(0).and_then(|()| file.rewind()).map_err(error("write"))?;
        writeln!(file, "{}", std::process::id()).map_err(error("write"))?;
        Ok(Self { _file: file })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_writer_is_told_who_holds_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let held = WriterLock::acquire(folder.path()).unwrap();
        let error = WriterLock::acquire(folder.path()).unwrap_err().to_string();
        assert!(error.contains(&format!("process {} is writing", std::process::id())), "{error}");
        drop(held);
        WriterLock::acquire(folder.path()).unwrap();
    }
}
