//! Files that can be trusted: read-only memory maps with a checked header, folders of logs of checksummed
//! records, and files that are replaced whole or not at all.

mod append_file;
mod error;
#[cfg(test)]
pub(crate) mod faulty;
mod folder;
mod header;
mod lock;
mod log;
mod mapped;
mod record;
mod replace;

pub use append_file::{AppendFile, DiskFile, MemoryFile};
pub use error::StorageError;
pub use folder::{BESIDE_SUFFIX, DiskFolder, Folder, MemoryFolder, create_folders, replace};
pub use header::{FileKind, HEADER_BYTES, checksum};
pub use lock::WriterLock;
pub use log::{
    Footing, LOG_HEADER_BYTES, LogIdentity, LogSyncer, LoggedRecord, RECORD_HEADER_BYTES, Reading, RecordLog,
    Recovery, Surveyed, Tail, log_kind,
};
pub use mapped::FileBytes;
pub use record::Envelope;
pub use replace::{Replacement, check_replaceable, replace_file};
