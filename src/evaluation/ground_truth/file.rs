//! Files of ground truths, read within bounds: a file from outside may be of any size or no file at all.

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use super::error::{Fault, GroundTruthError, Rows};

/// Largest text or table that is read, in bytes.
pub(in crate::evaluation) const MAX_TEXT_BYTES: u64 = 64 << 20;
/// Largest `.mat` or `.npy` file that is read, in bytes.
pub(in crate::evaluation) const MAX_BINARY_BYTES: u64 = 256 << 20;
/// Most frames that a ground truth may speak of.
pub(super) const MAX_FRAMES: usize = 1_000_000;
/// Most pairs of frames that a ground truth may list.
pub(super) const MAX_PAIRS: usize = 50_000_000;

/// Why a ground truth with more than [`MAX_FRAMES`] is refused.
pub(super) fn too_many_frames() -> String {
    format!("it speaks of more than {MAX_FRAMES} frames; keep fewer")
}

/// Why a ground truth with more than [`MAX_PAIRS`] is refused.
pub(super) fn too_many_pairs() -> String {
    format!("more than {MAX_PAIRS} of its pairs of frames show the same place; keep fewer frames")
}

/// The bytes of the regular file at `path`, at most `most_bytes`.
///
/// # Errors
/// If it cannot be read, is larger, or is a folder, a pipe or a device, which is never opened.
pub(in crate::evaluation) fn read(path: &Path, most_bytes: u64) -> Result<Vec<u8>, GroundTruthError> {
    let unreadable = |error| GroundTruthError::read(path, error);
    let refused = |reason: String| Err(GroundTruthError::malformed(path, reason));
    // Before it is opened: opening a pipe waits for whoever writes into it.
    let metadata = fs::metadata(path).map_err(unreadable)?;
    if metadata.is_dir() {
        return refused("it is a folder; name a file in it".to_owned());
    }
    if !metadata.is_file() {
        return refused("it is not a regular file; copy its content into one".to_owned());
    }
    let too_large = |bytes: u64| {
        refused(format!("it has {bytes} bytes or more, and at most {most_bytes} are read; keep fewer frames"))
    };
    if metadata.len() > most_bytes {
        return too_large(metadata.len());
    }
    // Its length may be wrong or grow meanwhile.
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(unreadable)?;
    file.take(most_bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > most_bytes { too_large(bytes.len() as u64) } else { Ok(bytes) }
}

/// The text in the file at `path`, without a byte order mark.
///
/// # Errors
/// As those of [`read`], and if it is not UTF-8; the error says on which line.
pub(in crate::evaluation) fn read_text(path: &Path) -> Result<String, GroundTruthError> {
    text(read(path, MAX_TEXT_BYTES)?).map_err(|fault| fault.at(path))
}

fn text(mut bytes: Vec<u8>) -> Result<String, Fault> {
    if bytes.starts_with(b"\xFF\xFE") || bytes.starts_with(b"\xFE\xFF") {
        return Err("it is UTF-16 text; save it as UTF-8".into());
    }
    if bytes.starts_with(b"\xEF\xBB\xBF") {
        bytes.drain(..3);
    }
    String::from_utf8(bytes).map_err(|error| {
        let before = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count() as u64;
        Fault::of(Rows::Lines(vec![line]), "it is not UTF-8 text; save it as UTF-8")
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    fn message<T>(result: Result<T, GroundTruthError>) -> String {
        result.err().expect("an error").to_string()
    }

    #[test]
    fn a_file_is_read_up_to_the_limit_and_not_one_byte_further() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.npy");
        fs::write(&path, b"12345").unwrap();
        assert_eq!(read(&path, 5).unwrap(), b"12345");
        let message = message(read(&path, 4));
        assert!(message.ends_with("5 bytes or more, and at most 4 are read; keep fewer frames"), "{message}");
    }

    #[test]
    fn a_pipe_a_device_or_a_folder_is_refused_without_waiting_for_it() {
        let folder = tempfile::tempdir().unwrap();
        assert!(message(read(folder.path(), 9)).ends_with("it is a folder; name a file in it"));
        let pipe = folder.path().join("truth.csv");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for path in [&pipe, Path::new("/dev/zero")] {
            let message = message(read(path, 9));
            assert!(message.ends_with("not a regular file; copy its content into one"), "{message}");
        }
        assert!(message(read(&folder.path().join("none"), 9)).starts_with("cannot read"));
    }

    #[test]
    fn files_that_claim_to_be_empty_but_never_end_are_bounded_too() {
        // The kernel's files have a length of 0, whatever comes out of them.
        let message = message(read(Path::new("/proc/self/status"), 10));
        assert!(message.contains("at most 10 are read"), "{message}");
    }

    #[test]
    fn text_loses_its_byte_order_mark_and_other_encodings_are_named() {
        assert_eq!(text(b"\xEF\xBB\xBFa,b".to_vec()).as_deref(), Ok("a,b"));
        let at = |bytes: &[u8]| text(bytes.to_vec()).unwrap_err().at(Path::new("t.csv")).to_string();
        assert_eq!(at(b"\xFF\xFEa\0"), "t.csv: it is UTF-16 text; save it as UTF-8");
        assert_eq!(at(b"file\nM\xFCnster\n"), "t.csv, row 2: it is not UTF-8 text; save it as UTF-8");
    }
}
