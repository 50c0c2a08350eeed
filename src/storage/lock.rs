//! One writer a folder: advisory locks, and a file that names who holds them.
//!
//! Both the file and the folder itself are locked: the file alone may be deleted while it is held, and the folder alone
//! cannot be locked everywhere.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use super::StorageError;

/// Times that a lock file which was deleted before it was locked is made anew.
const ATTEMPTS: u32 = 10;

/// Held while a folder is being written; released when dropped, also by a crash.
#[derive(Debug)]
pub struct WriterLock {
    _file: Held,
    _folder: Held,
}

/// A file that is locked. Closing it would not always unlock it at once: a child process that is just being started
/// still has it open for a moment.
#[derive(Debug)]
struct Held(File);

impl Drop for Held {
    fn drop(&mut self) {
        // If that fails, the end of the process unlocks it.
        let _ = self.0.unlock();
    }
}

impl WriterLock {
    /// Locks `folder`.
    ///
    /// # Errors
    /// If another process holds it (its process id is in the message) or the folder is not writable.
    pub fn acquire(folder: &Path) -> Result<Self, StorageError> {
        let path = folder.join("writer.lock");
        let opened = File::open(folder).map_err(StorageError::io("open", folder))?;
        if let Err(TryLockError::WouldBlock) = opened.try_lock() {
            return Err(held_by_another(&path));
        }
        let held_folder = Held(opened);
        for _ in 0..ATTEMPTS {
            let held = locked(&path)?;
            if is_at(&held.0, &path).map_err(StorageError::io("look at", &path))? {
                let mut file = &held.0;
                file.set_len(0)
                    .and_then(|()| file.rewind())
                    .and_then(|()| writeln!(file, "{}", std::process::id()))
                    .map_err(StorageError::io("write", &path))?;
                return Ok(Self { _file: held, _folder: held_folder });
            }
        }
        Err(StorageError::io("lock", &path)(io::Error::other("it is deleted again and again")))
    }
}

/// The lock file at `path`, made if need be and locked.
fn locked(path: &Path) -> Result<Held, StorageError> {
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false);
    let file = options.open(path).map_err(StorageError::io("open", path))?;
    match file.try_lock() {
        Ok(()) => Ok(Held(file)),
        Err(TryLockError::WouldBlock) => Err(held_by_another(path)),
        Err(TryLockError::Error(source)) => Err(StorageError::io("lock", path)(source)),
    }
}

/// Whether `file` is still the one at `path`.
fn is_at(file: &File, path: &Path) -> io::Result<bool> {
    let there = match fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
        there => there?,
    };
    let held = file.metadata()?;
    Ok((held.dev(), held.ino()) == (there.dev(), there.ino()))
}

/// Names who holds the lock, as far as the file at `path` says.
fn held_by_another(path: &Path) -> StorageError {
    let mut said = Vec::new();
    // A file that is gone or cannot be read names nobody.
    let _ = File::open(path).and_then(|file| file.take(20).read_to_end(&mut said));
    let holder = match String::from_utf8_lossy(&said).trim().parse::<u32>() {
        Ok(process) => format!("process {process}"),
        Err(_) => "another process".to_owned(),
    };
    let reason = format!("{holder} is writing there; stop it first");
    StorageError::io("lock", path)(io::Error::other(reason))
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

    #[test]
    fn deleting_the_lock_file_admits_no_second_writer() {
        let folder = tempfile::tempdir().unwrap();
        let held = WriterLock::acquire(folder.path()).unwrap();
        fs::remove_file(folder.path().join("writer.lock")).unwrap();
        let error = WriterLock::acquire(folder.path()).unwrap_err().to_string();
        assert!(error.contains("another process is writing there"), "{error}");
        drop(held);
        WriterLock::acquire(folder.path()).unwrap();
    }

    #[test]
    fn a_lock_file_that_says_nothing_sensible_still_locks() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("writer.lock");
        let held = WriterLock::acquire(folder.path()).unwrap();
        fs::write(&path, [0xff; 100]).unwrap();
        let error = WriterLock::acquire(folder.path()).unwrap_err().to_string();
        assert!(error.contains("another process is writing there"), "{error}");
        drop(held);
        WriterLock::acquire(folder.path()).unwrap();
    }

    #[test]
    fn a_lock_file_that_was_replaced_before_it_was_locked_is_not_taken_for_the_one_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("writer.lock");
        let stale = locked(&path).unwrap();
        assert!(is_at(&stale.0, &path).unwrap());
        fs::remove_file(&path).unwrap();
        assert!(!is_at(&stale.0, &path).unwrap());
        let fresh = locked(&path).unwrap();
        assert!(is_at(&fresh.0, &path).unwrap() && !is_at(&stale.0, &path).unwrap());
    }

    #[test]
    fn a_writer_of_before_that_locks_the_file_alone_is_respected() {
        let folder = tempfile::tempdir().unwrap();
        let _held = locked(&folder.path().join("writer.lock")).unwrap();
        assert!(WriterLock::acquire(folder.path()).unwrap_err().to_string().contains("is writing there"));
    }

    #[test]
    fn a_dropped_lock_is_free_although_a_child_still_has_its_files_open() {
        let folder = tempfile::tempdir().unwrap();
        let held = WriterLock::acquire(folder.path()).unwrap();
        // As a child has that was not yet told to close what is not its own.
        let _copies = [held._file.0.try_clone().unwrap(), held._folder.0.try_clone().unwrap()];
        drop(held);
        WriterLock::acquire(folder.path()).unwrap();
    }
}
