//! What brings a journal onto its medium while it is being written: the writer itself, or a thread of its own.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::storage::{LogSyncer, RecordLog, StorageError};

/// Brings what was learnt onto the medium, from any thread.
#[derive(Clone, Default)]
pub struct JournalSyncer(Arc<Mutex<Active>>);

/// The segment that grows, and why it cannot be synced any more.
#[derive(Default)]
struct Active {
    log: Option<LogSyncer>,
    failure: Option<StorageError>,
}

impl JournalSyncer {
    /// Returns when everything learnt before the call would survive a power cut, or could not be made to: then
    /// the map's next change fails and says why.
    pub fn sync(&self) {
        if let Err(failure) = self.try_sync() {
            self.active().failure.get_or_insert(failure);
        }
    }

    pub(super) fn try_sync(&self) -> Result<(), StorageError> {
        // Not under the lock: the writer must not wait for a slow medium to learn that nothing failed.
        let log = self.active().log.clone();
        log.map_or(Ok(()), |log| log.sync())
    }

    pub(super) fn follow(&self, log: &RecordLog) {
        self.active().log = Some(log.syncer());
    }

    /// Why a sync in the background failed, once.
    pub(super) fn take_failure(&self) -> Option<StorageError> {
        self.active().failure.take()
    }

    fn active(&self) -> MutexGuard<'_, Active> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
