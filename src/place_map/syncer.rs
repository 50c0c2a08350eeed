//! What brings a journal onto its medium while it is being written: the writer itself, or a thread of its own.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::storage::{AppendFile, LogSyncer, StorageError};

/// Segments by their paths.
pub(super) type Files = BTreeMap<PathBuf, Arc<dyn AppendFile>>;

/// Brings what was learnt onto the medium, from any thread.
#[derive(Clone, Default)]
pub struct JournalSyncer(Arc<Mutex<Watched>>);

/// The segment that grows and all there are, and why the journal cannot be synced any more.
#[derive(Default)]
struct Watched {
    active: Option<LogSyncer>,
    files: Arc<Files>,
    failure: Option<StorageError>,
}

impl JournalSyncer {
    /// Returns when everything learnt before the call would survive a power cut, or could not be made to, or a segment
    /// was deleted: then the map's next change fails and says why.
    pub fn sync(&self) {
        if let Err(failure) = self.try_sync() {
            self.watched().failure.get_or_insert(failure);
        }
    }

    pub(super) fn try_sync(&self) -> Result<(), StorageError> {
        // Not under the lock: the writer must not wait for a slow medium to learn that nothing failed.
        let (active, files) = {
            let watched = self.watched();
            (watched.active.clone(), Arc::clone(&watched.files))
        };
        active.map_or(Ok(()), |log| log.sync())?;
        for (path, file) in files.iter() {
            let is_linked = file.is_linked().map_err(StorageError::io("look at", path))?;
            // What the writer itself deletes is not watched any more by then.
            if !is_linked && self.watched().files.contains_key(path) {
                return Err(StorageError::Deleted { path: path.clone() });
            }
        }
        Ok(())
    }

    /// From now on `active` is the segment that grows, and `files` are all there are.
    pub(super) fn watch(&self, active: Option<LogSyncer>, files: Files) {
        let mut watched = self.watched();
        watched.active = active;
        watched.files = Arc::new(files);
    }

    /// Why a sync in the background failed, once.
    pub(super) fn take_failure(&self) -> Option<StorageError> {
        self.watched().failure.take()
    }

    fn watched(&self) -> MutexGuard<'_, Watched> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
