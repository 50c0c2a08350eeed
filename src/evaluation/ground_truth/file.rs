//! Files from outside, read whole: regular ones only, since others may never end, and not more of them
//! than any ground truth has.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::error::GroundTruthError;

/// Most bytes of a table or list of positions.
pub(in crate::evaluation) const MAX_TABLE_BYTES: u64 = 64 << 20;
/// Most bytes of a matrix.
pub(in crate::evaluation) const MAX_MATRIX_BYTES: u64 = 256 << 20;

/// The bytes of the file at `path`.
///
/// # Errors
/// If it is no regular file, cannot be read, or has more than `most_bytes`.
pub(in crate::evaluation) fn read(path: &Path, most_bytes: u64) -> Result<Vec<u8>, GroundTruthError> {
    let error = |error| GroundTruthError::read(path, error);
    if !path.metadata().map_err(error)?.is_file() {
        let reason = "it is no regular file; copy what it should hold into one";
        return Err(GroundTruthError::malformed(path, reason));
    }
    let mut bytes = Vec::new();
    File::open(path).and_then(|file| file.take(most_bytes + 1).read_to_end(&mut bytes)).map_err(error)?;
    if bytes.len() as u64 > most_bytes {
        let reason = format!("it has more than {} MiB; is it the right file?", most_bytes >> 20);
        return Err(GroundTruthError::malformed(path, reason));
    }
    Ok(bytes)
}

/// The text of the file at `path`, without a byte order mark.
///
/// # Errors
/// As [`read`], and if it is no UTF-8.
pub(in crate::evaluation) fn read_text(path: &Path, most_bytes: u64) -> Result<String, GroundTruthError> {
    let text = String::from_utf8(read(path, most_bytes)?)
        .map_err(|_| GroundTruthError::malformed(path, "it is no text in UTF-8; save it so"))?;
    Ok(match text.strip_prefix('\u{feff}') {
        Some(rest) => rest.to_owned(),
        None => text,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_regular_file_or_too_long_is_refused_and_never_waited_for() {
        let message = |path: &Path| read(path, 3).unwrap_err().to_string();
        assert!(message(Path::new("/dev/zero")).contains("no regular file"));
        let folder = tempfile::tempdir().unwrap();
        assert!(message(folder.path()).contains("no regular file"));
        let path = folder.path().join("long");
        std::fs::write(&path, "1234").unwrap();
        assert!(message(&path).contains("more than 0 MiB"));
        assert_eq!(read(&path, 4).unwrap(), b"1234");
    }

    #[test]
    fn text_comes_without_its_byte_order_mark() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text");
        std::fs::write(&path, "\u{feff}a").unwrap();
        assert_eq!(read_text(&path, 9).unwrap(), "a");
        std::fs::write(&path, [0xFF, 0xFE, b'a']).unwrap();
        assert!(read_text(&path, 9).unwrap_err().to_string().contains("no text in UTF-8"));
    }
}
