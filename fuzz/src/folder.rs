//! Files for readers that take paths: in a folder in memory, gone after the run.

use std::path::{Path, PathBuf};

use tempfile::{Builder, TempDir};

/// Where Linux keeps files in memory; elsewhere the usual folder for temporary files serves.
const IN_MEMORY: &str = "/dev/shm";

/// A new folder, empty.
pub(crate) fn folder() -> TempDir {
    let builder = || Builder::new().prefix("loci-fuzz-").rand_bytes(6).to_owned();
    builder().tempdir_in(IN_MEMORY).or_else(|_| builder().tempdir()).expect("a folder for temporary files")
}

/// Writes `bytes` to the file `name` in `folder`.
pub(crate) fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a file in a temporary folder");
    path
}
