//! Files from outside, read whole: regular ones, and not more of them than is sensible.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::error::GroundTruthError;

/// The bytes of the file at `path`.
///
/// # Errors
/// If it is no regular file, cannot be read, or has more than `most_bytes`.
pub(in crate::evaluation) fn read(path: &Path, most_bytes: u64) -> Result<Vec<u8>, GroundTruthError> {
    let error = |error| GroundTruthError::read(path, error);
    if !path.metadata().map_err(error)?.is_file() {
        return Err(GroundTruthError::malformed(path, "it is no regular file"));
    }
    let mut bytes = Vec::new();
    File::open(path).and_then(|file| file.take(most_bytes + 1).read_to_end(&mut bytes)).map_err(error)?;
    if bytes.len() as u64 > most_bytes {
        return Err(GroundTruthError::malformed(path, format!("more than {most_bytes} bytes")));
    }
    Ok(bytes)
}
