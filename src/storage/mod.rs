//! Files that can be trusted: read-only memory maps with a checked header, a log of checksummed
//! records, and files that are replaced whole or not at all.

mod header;
mod lock;
mod log;
mod mapped;
mod replace;

pub use header::{FileKind, HEADER_BYTES};
pub use lock::WriterLock;
pub use log::{FileLog, LogStore, MemoryLog, RecordLog, Recovery};
pub use mapped::FileBytes;
pub use replace::{check_replaceable, replace_file};

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
    /// The bytes are not what was written.
    #[error("{} is damaged: {reason}; restore it from a copy", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What does not fit, and where.
        reason: String,
    },
}

impl StorageError {
    /// Wraps what the operating system said about `path`.
    pub fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { action, path, source }
    }
}
