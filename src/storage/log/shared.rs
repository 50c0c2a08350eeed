//! What the writer of a log shares with those who sync it: its file, and how much of it is on the medium.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::storage::{AppendFile, StorageError};

/// A log's bytes, as its writer and those who sync it share them.
pub(super) struct Shared {
    pub(super) file: Arc<dyn AppendFile>,
    pub(super) path: PathBuf,
    /// Bytes up to the end of the last whole record.
    pub(super) end: AtomicU64,
    /// Bytes that are on the medium for certain.
    pub(super) durable: AtomicU64,
    /// The medium failed, and what it holds is unknown: the system may have thrown away what it could not write, and
    /// a further sync succeed.
    has_failed: AtomicBool,
    /// Held during a sync, so that none succeeds beside one that fails.
    turn: Mutex<()>,
}

impl Shared {
    pub(super) fn new(file: Arc<dyn AppendFile>, path: &Path, end: u64) -> Self {
        Self {
            file,
            path: path.to_owned(),
            end: AtomicU64::new(end),
            durable: AtomicU64::new(0),
            has_failed: AtomicBool::new(false),
            turn: Mutex::new(()),
        }
    }

    /// Brings what is not on the medium onto it, if there is anything.
    pub(super) fn sync(&self) -> Result<(), StorageError> {
        self.sync_if(|shared, end| shared.durable.load(Ordering::Acquire) < end)
    }

    fn sync_if(&self, is_needed: impl FnOnce(&Self, u64) -> bool) -> Result<(), StorageError> {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let end = self.end.load(Ordering::Acquire);
        let synced = match self.check() {
            Ok(()) if is_needed(self, end) => self.file.sync(),
            checked => checked,
        };
        self.has_failed.fetch_or(synced.is_err(), Ordering::AcqRel);
        synced.map_err(StorageError::io("sync", &self.path))?;
        self.durable.fetch_max(end, Ordering::Release);
        Ok(())
    }

    pub(super) fn check(&self) -> io::Result<()> {
        match self.has_failed.load(Ordering::Acquire) {
            true => Err(io::Error::other("the medium failed before, what it holds is unknown")),
            false => Ok(()),
        }
    }

    /// Cuts off what was half written behind `end`: it must not end up in the middle of the log, nor come back after
    /// a power cut.
    pub(super) fn cut(&self, end: u64) {
        let is_cut = self.file.truncate(end).is_ok() && self.sync_if(|_, _| true).is_ok();
        self.has_failed.fetch_or(!is_cut, Ordering::AcqRel);
    }
}

/// Brings what was appended to a log onto its medium, from any thread.
#[derive(Clone)]
pub struct LogSyncer(pub(super) Arc<Shared>);

impl LogSyncer {
    /// Returns when every record appended before the call would survive a power cut.
    ///
    /// # Errors
    /// If the medium fails. What it lost then is unknown, so the log must not be written any more.
    pub fn sync(&self) -> Result<(), StorageError> {
        self.0.sync()
    }
}
