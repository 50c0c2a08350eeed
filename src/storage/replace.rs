//! Files that are replaced whole or not at all: write beside, sync, rename, sync the folder.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use super::StorageError;

/// Makes `parts`, one after the other, the content of the file at `path`.
///
/// Whenever power fails, the file holds either its old content or the new.
///
/// # Errors
/// If the folder cannot be written; the old content is then still there.
pub fn replace_file(path: &Path, parts: &[&[u8]]) -> Result<(), StorageError> {
    let beside = beside(path);
    let written = write_and_sync(&beside, parts).and_then(|()| {
        fs::rename(&beside, path)?;
        sync_folder(path)
    });
    written.map_err(|source| {
        // The failure itself is what matters to the caller; a leftover would only add to it.
        let _ = fs::remove_file(&beside);
        StorageError::Io { action: "write", path: path.to_owned(), source }
    })
}

/// Fails as [`replace_file`] would where the folder is missing or may not be written to, before there is
/// anything to write; and where what is there is no regular file, which must not be replaced by one.
///
/// # Errors
/// If no file can be put at `path`.
pub fn check_replaceable(path: &Path) -> Result<(), StorageError> {
    let error = |source| StorageError::Io { action: "write", path: path.to_owned(), source };
    if path.is_dir() {
        return Err(error(std::io::ErrorKind::IsADirectory.into()));
    }
    if path.exists() && !path.is_file() {
        return Err(error(std::io::Error::other("it is a device or a pipe, not a file")));
    }
    let beside = beside(path);
    File::create(&beside).and_then(|_| fs::remove_file(&beside)).map_err(error)
}

/// Where a file is written before it takes the place of `path`.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    path.with_file_name(name)
}

fn write_and_sync(path: &Path, parts: &[&[u8]]) -> std::io::Result<()> {
    let mut file = File::create(path)?;
    for part in parts {
        file.write_all(part)?;
    }
    file.sync_all()
}

fn sync_folder(path: &Path) -> std::io::Result<()> {
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whether_a_file_can_be_written_is_known_beforehand_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        check_replaceable(&folder.path().join("file")).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(check_replaceable(folder.path()).is_err());
        let message = check_replaceable(&folder.path().join("gone/file")).unwrap_err().to_string();
        assert!(message.starts_with("cannot write ") && message.contains("gone/file"), "{message}");
    }

    #[test]
    fn a_file_is_replaced_and_nothing_is_left_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        replace_file(&path, &[b"old"]).unwrap();
        replace_file(&path, &[b"ne", b"w"]).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn an_unwritable_place_is_named() {
        let error = replace_file(Path::new("/proc/nothing/here"), &[b"x"]).unwrap_err();
        assert!(error.to_string().starts_with("cannot write /proc/nothing/here: "), "{error}");
    }
}
