//! A folder of files that only grow: on a disk, or in memory.
//!
//! What a folder says to have done survives a power cut once it was [synced](Folder::sync), and not before:
//! a file that was made, renamed or removed may be back as it was, or not, whatever happened to the others.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::FileBytes;
use super::append_file::{AppendFile, DiskFile, MemoryFile};

/// A folder. Names are plain file names.
pub trait Folder: Send + Sync {
    /// Where it is; for messages.
    fn path(&self) -> &Path;

    /// The names in it, in no order.
    ///
    /// # Errors
    /// What the medium says.
    fn names(&self) -> io::Result<Vec<String>>;

    /// Opens a file for reading and, if `writable`, appending; then it is made if need be.
    ///
    /// # Errors
    /// What the medium says.
    fn open(&self, name: &str, writable: bool) -> io::Result<Arc<dyn AppendFile>>;

    /// The bytes of a file that nobody appends to: mapped, if it is on a disk.
    ///
    /// # Errors
    /// What the medium says.
    fn map(&self, name: &str) -> io::Result<FileBytes> {
        let file = self.open(name, false)?;
        let mut bytes = vec![0; file.length_bytes()? as usize];
        file.read_at(0, &mut bytes)?;
        Ok(FileBytes::Owned(bytes))
    }

    /// Gives the file `from` the name `to`; a file of that name is gone.
    ///
    /// # Errors
    /// What the medium says.
    fn rename(&self, from: &str, to: &str) -> io::Result<()>;

    /// Removes a file. Who has it open can go on reading it.
    ///
    /// # Errors
    /// What the medium says.
    fn remove(&self, name: &str) -> io::Result<()>;

    /// Returns when every file made, renamed or removed before the call would stay so after a power cut.
    ///
    /// # Errors
    /// What the medium says.
    fn sync(&self) -> io::Result<()>;
}

/// Makes `parts`, one after the other, the content of the file `name`. Whenever power fails, the file holds
/// either its old content or the new.
///
/// # Errors
/// What the medium says; the old content is then still there, unless the folder alone could not be synced.
pub fn replace(folder: &dyn Folder, name: &str, parts: &[&[u8]]) -> io::Result<()> {
    let beside = format!("{name}.{}{BESIDE_SUFFIX}", std::process::id());
    let replaced = write_beside(folder, &beside, parts).and_then(|()| folder.rename(&beside, name));
    if replaced.is_err() {
        // The failure itself is what matters to the caller; a leftover would only add to it.
        let _ = folder.remove(&beside);
    }
    replaced.and_then(|()| folder.sync())
}

/// How names of files end that are about to replace another one, and are left when power fails.
pub const BESIDE_SUFFIX: &str = ".part";

fn write_beside(folder: &dyn Folder, beside: &str, parts: &[&[u8]]) -> io::Result<()> {
    let file = folder.open(beside, true)?;
    file.truncate(0)?;
    parts.iter().try_for_each(|part| file.append(part))?;
    file.sync()
}

/// A folder on a disk.
#[derive(Debug)]
pub struct DiskFolder(PathBuf);

impl DiskFolder {
    /// The folder at `path`, which need not be there yet.
    #[must_use]
    pub fn new(path: &Path) -> Self {
        Self(if path.as_os_str().is_empty() { PathBuf::from(".") } else { path.to_owned() })
    }
}

impl Folder for DiskFolder {
    fn path(&self) -> &Path {
        &self.0
    }

    fn names(&self) -> io::Result<Vec<String>> {
        let entries = fs::read_dir(&self.0)?.collect::<io::Result<Vec<_>>>()?;
        // No name of ours is lost: they are all ASCII.
        Ok(entries.into_iter().filter_map(|entry| entry.file_name().into_string().ok()).collect())
    }

    fn open(&self, name: &str, writable: bool) -> io::Result<Arc<dyn AppendFile>> {
        Ok(Arc::new(DiskFile::open(&self.0.join(name), writable)?))
    }

    fn map(&self, name: &str) -> io::Result<FileBytes> {
        FileBytes::open(&self.0.join(name))
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        fs::rename(self.0.join(from), self.0.join(to))
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        fs::remove_file(self.0.join(name))
    }

    fn sync(&self) -> io::Result<()> {
        File::open(&self.0)?.sync_all()
    }
}

/// Makes the folder at `path` and those above it that are missing; what was made stays after a power cut.
///
/// # Errors
/// What the medium says.
pub fn create_folders(path: &Path) -> io::Result<()> {
    let changed = changed_by_creating(path);
    fs::create_dir_all(path)?;
    changed.into_iter().try_for_each(|folder| DiskFolder::new(folder).sync())
}

/// The folders that get another one in them when `path` is made.
fn changed_by_creating(path: &Path) -> Vec<&Path> {
    let missing = path.ancestors().take_while(|folder| !folder.as_os_str().is_empty() && !folder.exists());
    missing.map(|folder| folder.parent().unwrap_or(folder)).collect()
}

/// A folder in memory, gone with the process.
#[derive(Default)]
pub struct MemoryFolder(Mutex<BTreeMap<String, Arc<MemoryFile>>>);

impl MemoryFolder {
    fn files(&self) -> MutexGuard<'_, BTreeMap<String, Arc<MemoryFile>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Folder for MemoryFolder {
    fn path(&self) -> &Path {
        Path::new("map in memory")
    }

    fn names(&self) -> io::Result<Vec<String>> {
        Ok(self.files().keys().cloned().collect())
    }

    fn open(&self, name: &str, writable: bool) -> io::Result<Arc<dyn AppendFile>> {
        let mut files = self.files();
        match files.get(name) {
            Some(file) => Ok(file.clone()),
            None if writable => Ok(files.entry(name.to_owned()).or_default().clone()),
            None => Err(io::ErrorKind::NotFound.into()),
        }
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        let mut files = self.files();
        let file = files.remove(from).ok_or(io::ErrorKind::NotFound)?;
        if let Some(replaced) = files.insert(to.to_owned(), file) {
            replaced.delete();
        }
        Ok(())
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        self.files().remove(name).ok_or(io::ErrorKind::NotFound)?.delete();
        Ok(())
    }

    fn sync(&self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn content(folder: &dyn Folder, name: &str) -> Vec<u8> {
        let file = folder.open(name, false).unwrap();
        let mut bytes = vec![0; file.length_bytes().unwrap() as usize];
        file.read_at(0, &mut bytes).unwrap();
        bytes
    }

    #[test]
    fn folders_on_a_disk_and_in_memory_do_the_same() {
        let disk = tempfile::tempdir().unwrap();
        let folders: [Box<dyn Folder>; 2] =
            [Box::new(DiskFolder::new(disk.path())), Box::new(MemoryFolder::default())];
        for folder in folders {
            let folder = folder.as_ref();
            assert_eq!(folder.open("a", false).err().unwrap().kind(), io::ErrorKind::NotFound);
            folder.open("a", true).unwrap().append(b"old").unwrap();
            let replaced = folder.open("a", true).unwrap();
            replace(folder, "b", &[b"ne", b"w"]).unwrap();
            folder.rename("b", "a").unwrap();
            assert!(!replaced.is_linked().unwrap());
            assert!(replaced.sync().unwrap_err().to_string().contains("deleted"));
            assert_eq!(content(folder, "a"), b"new");
            assert_eq!(*folder.map("a").unwrap(), *b"new");
            assert_eq!(folder.map("b").unwrap_err().kind(), io::ErrorKind::NotFound);
            assert_eq!(folder.names().unwrap(), ["a"]);
            let still_open = folder.open("a", false).unwrap();
            assert!(still_open.is_linked().unwrap());
            folder.remove("a").unwrap();
            assert!(!still_open.is_linked().unwrap());
            folder.sync().unwrap();
            assert_eq!(folder.remove("a").unwrap_err().kind(), io::ErrorKind::NotFound);
            assert_eq!(still_open.length_bytes().unwrap(), 3);
        }
    }

    #[test]
    fn every_folder_that_a_new_one_changes_is_synced() {
        let disk = tempfile::tempdir().unwrap();
        let [maps, site] = ["maps", "maps/site"].map(|name| disk.path().join(name));
        assert_eq!(changed_by_creating(&site), [&maps, disk.path()]);
        create_folders(&site).unwrap();
        assert!(site.is_dir());
        assert_eq!(changed_by_creating(&site), [] as [&Path; 0]);
        create_folders(&site).unwrap();
        assert_eq!(changed_by_creating(Path::new("surely/not there")), [Path::new("surely"), Path::new("")]);
    }
}
