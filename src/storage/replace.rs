//! Files that are replaced whole or not at all: write beside, sync, rename, sync the folder.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use super::StorageError;
use super::folder::{BESIDE_SUFFIX, DiskFolder, Folder, replace};

/// Makes `parts`, one after the other, the content of the file at `path`.
///
/// Whenever power fails, the file holds either its old content or the new.
///
/// # Errors
/// If the folder cannot be written; the old content is then still there.
pub fn replace_file(path: &Path, parts: &[&[u8]]) -> Result<(), StorageError> {
    let error = |source| StorageError::Io { action: "write", path: path.to_owned(), source };
    let name = name_of(path).map_err(error)?;
    replace(&DiskFolder::new(path.parent().unwrap_or(Path::new(""))), name, parts).map_err(error)
}

/// Fails as [`replace_file`] would where the folder is missing or may not be written to, before there is
/// anything to write; and where what is there is no regular file, which must not be replaced by one.
///
/// # Errors
/// If no file can be put at `path`.
pub fn check_replaceable(path: &Path) -> Result<(), StorageError> {
    name_of(path).map_err(StorageError::io("write", path))?;
    refuse_all_but_files(path)?;
    let beside = beside(path);
    File::create(&beside).and_then(|_| fs::remove_file(&beside)).map_err(StorageError::io("write", path))
}

/// The name of the file at `path`.
fn name_of(path: &Path) -> io::Result<&str> {
    let name = path.file_name().ok_or(io::ErrorKind::IsADirectory)?;
    name.to_str().ok_or_else(|| io::Error::other("its name is not UTF-8; choose another"))
}

fn refuse_all_but_files(path: &Path) -> Result<(), StorageError> {
    let error = |source| Err(StorageError::Io { action: "write", path: path.to_owned(), source });
    if path.is_dir() {
        return error(io::ErrorKind::IsADirectory.into());
    }
    if path.exists() && !path.is_file() {
        return error(io::Error::other("it is a device or a pipe, not a file"));
    }
    Ok(())
}

/// A file of any length that is written to take the place of another one, whole or not at all: dropped before it is
/// [finished](Self::finish), it leaves nothing behind.
#[derive(Debug)]
pub struct Replacement {
    /// `None` once it took the other one's place.
    file: Option<BufWriter<File>>,
    path: PathBuf,
    beside: PathBuf,
}

impl Replacement {
    /// Begins a file that will stand at `path`.
    ///
    /// # Errors
    /// As [`check_replaceable`].
    pub fn create(path: &Path) -> Result<Self, StorageError> {
        refuse_all_but_files(path)?;
        let beside = beside(path);
        let file = File::create(&beside).map_err(StorageError::io("write", path))?;
        Ok(Self { file: Some(BufWriter::new(file)), path: path.to_owned(), beside })
    }

    /// Makes what was written the content of the file, as [`replace_file`] does.
    ///
    /// # Errors
    /// If the folder cannot be written; the old content is then still there.
    pub fn finish(mut self) -> Result<(), StorageError> {
        self.put_in_place().map_err(StorageError::io("write", &self.path))
    }

    fn put_in_place(&mut self) -> io::Result<()> {
        let Some(file) = &mut self.file else { return Ok(()) };
        file.flush()?;
        file.get_ref().sync_all()?;
        fs::rename(&self.beside, &self.path)?;
        self.file = None;
        DiskFolder::new(self.path.parent().unwrap_or(Path::new(""))).sync()
    }
}

impl Write for Replacement {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.as_mut().map_or(Ok(0), |file| file.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.as_mut().map_or(Ok(()), Write::flush)
    }
}

impl Drop for Replacement {
    fn drop(&mut self) {
        if self.file.is_some() {
            // Whoever drops it knows already that something failed; a leftover would only add to it.
            let _ = fs::remove_file(&self.beside);
        }
    }
}

/// Where a file is written before it takes the place of `path`.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}{BESIDE_SUFFIX}", std::process::id()));
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    use super::*;

    #[test]
    fn whether_a_file_can_be_written_is_known_beforehand_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        check_replaceable(&folder.path().join("file")).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(check_replaceable(folder.path()).is_err());
        let nameless = folder.path().join(OsStr::from_bytes(b"\xff.lvoc"));
        assert!(check_replaceable(&nameless).unwrap_err().to_string().contains("not UTF-8"));
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
    fn a_file_written_in_pieces_replaces_the_old_one_only_once_it_is_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, b"old").unwrap();
        let mut given_up = Replacement::create(&path).unwrap();
        given_up.write_all(b"half").unwrap();
        drop(given_up);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        let mut finished = Replacement::create(&path).unwrap();
        for _ in 0..10_000 {
            finished.write_all(b"new ").unwrap();
        }
        assert_eq!(fs::read(&path).unwrap(), b"old");
        finished.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new ".repeat(10_000));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        for device in ["/dev/null", "/"] {
            assert!(Replacement::create(Path::new(device)).is_err(), "{device}");
        }
    }

    #[test]
    fn an_unwritable_place_is_named() {
        let error = replace_file(Path::new("/proc/nothing/here"), &[b"x"]).unwrap_err();
        assert!(error.to_string().starts_with("cannot write /proc/nothing/here: "), "{error}");
    }
}
