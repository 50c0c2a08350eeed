//! How a map is opened: in memory, for the one who writes it, or for anybody who reads it meanwhile.

use std::io;
use std::path::Path;
use std::sync::Arc;

use super::journal::{Journal, segment_numbers};
use super::journal_opening::Opened;
use super::map::PlaceMap;
use super::snapshot::{self, Snapshot};
use super::upkeep::Upkeep;
use super::{MapError, MapOptions, kept_index, version_1};
use crate::storage::{
    BESIDE_SUFFIX, DiskFolder, Folder, MemoryFolder, StorageError, WriterLock, create_folders, log_kind,
};

/// A way to open a journal: its folder, whether to write it, and its snapshot.
type OpenJournal = fn(&Arc<dyn Folder>, bool, Option<Snapshot>) -> Result<Opened, StorageError>;

/// Times that a reader begins anew because a segment was deleted while it opened the map.
pub(super) const READER_ATTEMPTS: u32 = 5;

impl PlaceMap {
    /// A map in memory, gone with the process; its journal takes at most the bytes that the disk's may.
    ///
    /// # Errors
    /// Never in practice: memory takes every record.
    pub fn in_memory(options: MapOptions) -> Result<Self, MapError> {
        Self::open_folder(Arc::new(MemoryFolder::default()), Some(options), None)
    }

    /// Opens the map in `folder` for writing, or makes one. A torn tail of its journal is cut off.
    ///
    /// # Errors
    /// If the folder cannot be written, another process writes it, or the journal is damaged.
    pub fn open(folder: &Path, options: MapOptions) -> Result<Self, MapError> {
        create_folders(folder).map_err(StorageError::io("create map folder", folder))?;
        let lock = WriterLock::acquire(folder)?;
        Self::open_folder(Arc::new(DiskFolder::new(folder)), Some(options), Some(lock))
    }

    /// Opens the map in `folder` for writing, as [`open`](Self::open), if there is one.
    ///
    /// # Errors
    /// If there is none, or as for [`open`](Self::open).
    pub fn open_existing(folder: &Path, options: MapOptions) -> Result<Self, MapError> {
        check_exists(folder)?;
        Self::open(folder, options)
    }

    /// Opens the map in `folder` for writing, as [`open_existing`](Self::open_existing), also where it is damaged: what
    /// cannot be read is [passed over](Self::passed_over), and gone for good once the map is
    /// [compacted](Self::compact).
    ///
    /// # Errors
    /// If there is none, the folder cannot be written, another process writes it, or what is left makes no sense.
    pub fn open_damaged(folder: &Path, options: MapOptions) -> Result<Self, MapError> {
        check_exists(folder)?;
        let lock = WriterLock::acquire(folder)?;
        Self::salvage(Arc::new(DiskFolder::new(folder)), Some(options), Some(lock))
    }

    /// Opens the map in `folder` for reading, as it is now; other processes may read and one may write it. Of a damaged
    /// one is read what can be; the rest is [passed over](Self::passed_over).
    ///
    /// # Errors
    /// If there is no map, or what can be read of it makes no sense.
    pub fn open_read_only(folder: &Path) -> Result<Self, MapError> {
        let missing = || MapError::Missing { path: folder.to_owned() };
        if !folder.is_dir() {
            return Err(missing());
        }
        let mut map = match Self::open_sound(folder) {
            Err(damaged @ MapError::Damaged { .. }) => {
                Self::salvage(Arc::new(DiskFolder::new(folder)), None, None).map_err(|_| damaged)?
            }
            opened => opened?,
        };
        if map.journal.active_number() > 0 {
            return Ok(map);
        }
        let ahead = map.snapshot_fault.take().filter(|fault| matches!(fault, StorageError::Ahead { .. }));
        Err(ahead.map_or_else(missing, MapError::from))
    }

    /// Opens the map in `folder` for reading, unless it is damaged.
    pub(super) fn open_sound(folder: &Path) -> Result<Self, MapError> {
        opened_beside_a_writer(|| Self::open_folder(Arc::new(DiskFolder::new(folder)), None, None))
    }

    /// Opens the map in `folder`, for writing if there are `options`.
    pub(super) fn open_folder(
        folder: Arc<dyn Folder>,
        options: Option<MapOptions>,
        lock: Option<WriterLock>,
    ) -> Result<Self, MapError> {
        Self::open_by(Journal::open, folder.clone(), options, lock).map_err(|error| match error {
            StorageError::Damaged { path, reason } if can_be_salvaged(folder.as_ref(), &path) => {
                MapError::Damaged { path, reason }
            }
            error => error.into(),
        })
    }

    /// As [`open_folder`](Self::open_folder), but around what is damaged.
    pub(super) fn salvage(
        folder: Arc<dyn Folder>,
        options: Option<MapOptions>,
        lock: Option<WriterLock>,
    ) -> Result<Self, MapError> {
        Ok(Self::open_by(Journal::salvage, folder, options, lock)?)
    }

    fn open_by(
        open: OpenJournal,
        folder: Arc<dyn Folder>,
        options: Option<MapOptions>,
        lock: Option<WriterLock>,
    ) -> Result<Self, StorageError> {
        let (snapshot, unreadable) = match snapshot::read(folder.as_ref()) {
            Ok(snapshot) => (snapshot, None),
            Err(StorageError::Damaged { path, reason }) => {
                (None, Some(StorageError::Useless { path, reason }))
            }
            // It only saves time: the journal is enough.
            Err(fault) => (None, Some(fault)),
        };
        let length_bytes = snapshot.as_ref().map_or(0, |snapshot| snapshot.length_bytes);
        let is_writable = options.is_some();
        let Opened { journal, contents, recovery, snapshot_fault, passed_over } =
            open(&folder, is_writable, snapshot)?;
        if is_writable {
            remove_leftovers(folder.as_ref())?;
        }
        let index = kept_index::found(folder.as_ref(), is_writable);
        let index_bytes = index.as_ref().map_or(0, |index| index.len() as u64);
        Ok(Self {
            contents,
            journal,
            index,
            folder,
            options: options.unwrap_or_default(),
            upkeep: Upkeep::new(length_bytes, index_bytes),
            recovery,
            snapshot_fault: unreadable.or(snapshot_fault),
            passed_over,
            latest_place: None,
            is_writable,
            _lock: lock,
        })
    }
}

/// Whether the map in `folder` can be read around damage at `path`: in a segment of version 1 it cannot.
fn can_be_salvaged(folder: &dyn Folder, path: &Path) -> bool {
    let Some(name) = path.file_name().and_then(|name| name.to_str()) else { return true };
    let Ok(file) = folder.open(name, false) else { return true };
    !matches!(log_kind(file.as_ref(), path), Ok((_, version_1::VERSION)))
}

/// Refuses a folder in which there is no map.
fn check_exists(folder: &Path) -> Result<(), MapError> {
    let has_snapshot = folder.join(snapshot::NAME).exists();
    if !folder.is_dir() || !has_snapshot && segment_numbers(&DiskFolder::new(folder))?.is_empty() {
        return Err(MapError::Missing { path: folder.to_owned() });
    }
    Ok(())
}

/// What `open` answers, asked again where it may have met a writer at work.
fn opened_beside_a_writer(
    mut open: impl FnMut() -> Result<PlaceMap, MapError>,
) -> Result<PlaceMap, MapError> {
    let mut attempts = 0;
    loop {
        let opened = open();
        let doubt = match &opened {
            Ok(map) => map.snapshot_fault.as_ref(),
            Err(MapError::Storage(error)) => Some(error),
            Err(_) => None,
        };
        let is_damaged = matches!(opened, Err(MapError::Damaged { .. }));
        attempts += 1;
        if attempts >= doubt.map_or(1 + u32::from(is_damaged), attempts_after) {
            return opened;
        }
    }
}

/// How often a reader tries at most that was told this.
fn attempts_after(error: &StorageError) -> u32 {
    match error {
        StorageError::Io { source, .. } if source.kind() == io::ErrorKind::NotFound => READER_ATTEMPTS,
        StorageError::Io { source, .. } if source.kind() == io::ErrorKind::UnexpectedEof => 2,
        StorageError::Damaged { .. } | StorageError::Useless { .. } | StorageError::Ahead { .. } => 2,
        _ => 1,
    }
}

/// Files that a power cut left beside those that they were to replace.
fn remove_leftovers(folder: &dyn Folder) -> Result<(), StorageError> {
    let names = folder.names().map_err(StorageError::io("list", folder.path()))?;
    let is_ours = |name: &str| [snapshot::NAME, kept_index::NAME].iter().any(|of| name.starts_with(of));
    for name in names.iter().filter(|name| is_ours(name) && name.ends_with(BESIDE_SUFFIX)) {
        folder.remove(name).map_err(StorageError::io("delete", &folder.path().join(name)))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_that_met_a_writer_at_work_tries_again_and_a_damaged_map_is_read_twice_at_most() {
        let io = |kind: io::ErrorKind| StorageError::io("read", Path::new("segment"))(kind.into());
        let damaged = || StorageError::Damaged { path: "segment".into(), reason: "bad record".into() };
        let errors: [(&dyn Fn() -> StorageError, u32); 4] = [
            (&|| io(io::ErrorKind::NotFound), READER_ATTEMPTS),
            (&|| io(io::ErrorKind::UnexpectedEof), 2),
            (&damaged, 2),
            (&|| io(io::ErrorKind::PermissionDenied), 1),
        ];
        for (error, most) in errors {
            for failures in 0..=most {
                let mut asked = 0;
                let opened = opened_beside_a_writer(|| {
                    asked += 1;
                    if asked <= failures {
                        Err(error().into())
                    } else {
                        PlaceMap::in_memory(MapOptions::default())
                    }
                });
                assert_eq!(opened.is_ok(), failures < most, "{}", error());
                assert_eq!(asked, most.min(failures + 1));
            }
        }
    }
}
