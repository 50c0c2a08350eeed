//! Why a map could not be opened or changed.

use std::path::PathBuf;

use crate::storage::StorageError;

/// Why a map could not be opened or changed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapError {
    /// A file could not be read or written.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The journal is damaged where the map cannot be opened without.
    #[error(
        "{} is damaged: {reason}; restore it from a copy, or keep the rest by `loci map compact --repair`",
        path.display()
    )]
    Damaged {
        /// The segment, or the map's folder.
        path: PathBuf,
        /// What does not fit, and where.
        reason: String,
    },
    /// The folder holds no map.
    #[error("no map in {}: `loci run SOURCE --map FOLDER` makes one", path.display())]
    Missing {
        /// The folder.
        path: PathBuf,
    },
    /// There is no room for another place.
    #[error(
        "the map is full: its {places} places take {bytes} of {budget_bytes} bytes; give it more with --map-disk"
    )]
    Full {
        /// Number of places.
        places: usize,
        /// What they take.
        bytes: u64,
        /// What they may take.
        budget_bytes: u64,
    },
    /// Every number that an experience can have was given away.
    #[error("the map has had {count} experiences, as many as it can count; begin a new one")]
    OutOfNumbers {
        /// How many there were.
        count: u32,
    },
    /// What had to be written again, so that the rest could be kept, could not be read.
    #[error(
        "given up, for it cannot be read (experiences: {experiences}, keyframes: {keyframes}, \
         thumbnails: {thumbnails}): {}",
        found(first)
    )]
    GaveUp {
        /// Experiences that were given up.
        experiences: usize,
        /// Keyframes that were kept as experiences by which nothing is recognised.
        keyframes: usize,
        /// Thumbnails without which experiences were kept.
        thumbnails: usize,
        /// What was wrong with the first.
        first: StorageError,
    },
    /// Keyframes could not be read; the others serve without them.
    #[error(transparent)]
    Unreadable(#[from] Unreadable),
    /// Somebody wanted no more of it.
    #[error("interrupted")]
    Interrupted,
    /// The map was opened for reading.
    #[error("the map is read-only")]
    ReadOnly,
    /// There is no such place.
    #[error("there is no place {place} in the map")]
    NoPlace {
        /// Its number.
        place: u32,
    },
    /// There is no such experience.
    #[error("there is no experience {experience} in the map")]
    NoExperience {
        /// Its number.
        experience: u32,
    },
    /// Two places cannot be merged, or one cannot be taken apart.
    #[error("place {place}: {reason}")]
    Merge {
        /// Its number.
        place: u32,
        /// Why not.
        reason: &'static str,
    },
    /// The record could not be packed.
    #[error("an experience cannot be stored: {reason}")]
    Unstorable {
        /// What does not fit.
        reason: String,
    },
}

/// Keyframes that cannot be read, so that nothing is recognised by them.
#[derive(Debug, thiserror::Error)]
#[error(
    "keyframes left out, for they cannot be read: {keyframes} ({}); `loci map compact` gives them up",
    found(first)
)]
pub struct Unreadable {
    /// How many.
    pub keyframes: usize,
    /// What is wrong with the first.
    pub first: StorageError,
}

impl Unreadable {
    /// One keyframe more cannot be read.
    pub(crate) fn note(noted: &mut Option<Self>, damage: StorageError) {
        noted.get_or_insert(Self { keyframes: 0, first: damage }).keyframes += 1;
    }
}

/// What is wrong, and where, without the fix that damage has where nothing can be given up.
fn found(damage: &StorageError) -> String {
    match damage {
        StorageError::Damaged { path, reason } => format!("{}: {reason}", path.display()),
        other => other.to_string(),
    }
}

impl MapError {
    /// Whether a record is not there as it was written, while others may be.
    #[must_use]
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Storage(error) if error.is_damage())
    }

    /// Whether the folder may be read and not written, as on a full disk.
    #[must_use]
    pub fn is_unwritable(&self) -> bool {
        use std::io::ErrorKind::{
            FileTooLarge, PermissionDenied, QuotaExceeded, ReadOnlyFilesystem, StorageFull,
        };
        match self {
            Self::Storage(StorageError::Io { source, .. }) => matches!(
                source.kind(),
                PermissionDenied | ReadOnlyFilesystem | StorageFull | QuotaExceeded | FileTooLarge
            ),
            _ => false,
        }
    }
}
