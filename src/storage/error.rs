//! Why a file could not be read or written.

use std::io;
use std::path::{Path, PathBuf};

/// Why a file could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StorageError {
    /// The operating system said no.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was tried, as a verb.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The file is of another kind.
    #[error("{} is not a {kind}: {reason}", path.display())]
    WrongKind {
        /// The file.
        path: PathBuf,
        /// What was expected.
        kind: &'static str,
        /// How it was noticed.
        reason: String,
    },
    /// The file was written by a newer Loci.
    #[error("{} is a {kind} of version {got}, this Loci reads up to {newest}: update Loci", path.display())]
    TooNew {
        /// The file.
        path: PathBuf,
        /// What it is.
        kind: &'static str,
        /// Its version.
        got: u32,
        /// The newest that can be read.
        newest: u32,
    },
    /// The file was written by an earlier Loci, whose files of this kind are not read any more.
    #[error("{} is a {kind} of version {got}, this Loci reads from {oldest} on: move it away", path.display())]
    TooOld {
        /// The file.
        path: PathBuf,
        /// What it is.
        kind: &'static str,
        /// Its version.
        got: u32,
        /// The oldest that can be read.
        oldest: u32,
    },
    /// The file holds records of a kind or layout that this program does not know.
    #[error(
        "{} holds records of kind {kind}, version {version}, which this Loci does not know: update Loci",
        path.display()
    )]
    NewerRecords {
        /// The file.
        path: PathBuf,
        /// Kind of the first such record.
        kind: u8,
        /// Version of its layout.
        version: u8,
    },
    /// The file stands under the name of another one of those that it belongs to.
    #[error(
        "{} is number {got} of a {kind}, not {expected}: renamed, copied or damaged at its head; \
         name every file as it was",
        path.display()
    )]
    Misplaced {
        /// The file.
        path: PathBuf,
        /// What it is.
        kind: &'static str,
        /// Which one it is.
        got: u32,
        /// Which one was to be there.
        expected: u32,
    },
    /// The bytes are not what was written.
    #[error("{} is damaged: {reason}; restore it from a copy", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What does not fit, and where.
        reason: String,
    },
    /// Somebody deleted the file while it was open.
    #[error("{} was deleted while the map was in use; restore it from a copy", path.display())]
    Deleted {
        /// The file.
        path: PathBuf,
    },
    /// The journal may have lost what had been on the medium when its snapshot was taken.
    #[error(
        "{} knows more than the journal beside it: {reason}; keep what is left of both by \
         `loci map compact --repair`, or delete the snapshot",
        path.display()
    )]
    Ahead {
        /// The snapshot.
        path: PathBuf,
        /// What is missing.
        reason: String,
    },
    /// The snapshot is damaged, or not of the journal beside it, which is enough without.
    #[error("{} is of no use to this journal: {reason}; the next run that learns replaces it", path.display())]
    Useless {
        /// The file.
        path: PathBuf,
        /// What does not fit.
        reason: String,
    },
}

impl StorageError {
    /// Whether the bytes are not there as they were written, which no further try changes.
    #[must_use]
    pub fn is_damage(&self) -> bool {
        match self {
            Self::Damaged { .. } => true,
            Self::Io { source, .. } => source.kind() == io::ErrorKind::UnexpectedEof,
            _ => false,
        }
    }

    /// What is wrong, without the file's name.
    #[must_use]
    pub fn reason(&self) -> String {
        match self {
            Self::Io { action, source, .. } => format!("cannot {action} it: {source}"),
            Self::Damaged { reason, .. } | Self::Ahead { reason, .. } | Self::Useless { reason, .. } => {
                reason.clone()
            }
            Self::WrongKind { kind, reason, .. } => format!("it is not a {kind}: {reason}"),
            Self::TooOld { got, oldest, .. } => {
                format!("it is of version {got}, this Loci reads from {oldest} on")
            }
            Self::TooNew { got, newest, .. } => {
                format!("it is of version {got}, this Loci reads up to {newest}: update Loci")
            }
            Self::NewerRecords { kind, version, .. } => {
                format!("it holds records of kind {kind}, version {version}: update Loci")
            }
            Self::Misplaced { got, expected, .. } => {
                format!("it is number {got}, not {expected}: it was renamed or copied")
            }
            Self::Deleted { .. } => "it was deleted while the map was in use".to_owned(),
        }
    }

    /// Wraps what the operating system said about `path`.
    pub fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, path: path.to_owned(), source }
    }
}
