//! A model written to a folder of its own, whole or not at all.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::card::{LARGEST_CARD_BYTES, ModelCard};
use super::engine::sha256_hex;
use super::model::{CARD_FILE, MODEL_FILE};
use crate::storage::{BESIDE_SUFFIX, DiskFolder, Folder, StorageError, create_folders, replace};

/// Name of the page that tells of a model's training, in its folder.
const REPORT_FILE: &str = "report.html";

/// Makes `folder` the folder of the model of these bytes, whose hash is put into `card`, with the page `report`.
/// Whenever power fails, there is either no such folder or all of it.
///
/// # Errors
/// If there is something at `folder` already, or it cannot be written.
pub fn save_model(
    folder: &Path,
    card: &mut ModelCard,
    network: &[u8],
    report: &str,
) -> Result<(), StorageError> {
    // Without a slash at its end.
    let folder: &Path = &folder.components().collect::<PathBuf>();
    let error = |source| StorageError::Io { action: "write", path: folder.to_owned(), source };
    // A link that leads nowhere is something, too.
    if folder.symlink_metadata().is_ok() {
        return Err(error(io::Error::new(
            io::ErrorKind::AlreadyExists,
            "it is there already; choose another",
        )));
    }
    card.sha256 = sha256_hex(network);
    let text = toml::to_string(card).map_err(|reason| error(io::Error::other(reason)))?;
    card.check().map_err(|reason| error(io::Error::other(reason)))?;
    if text.len() as u64 > LARGEST_CARD_BYTES {
        return Err(error(io::Error::other("its card has too many places to be read again")));
    }
    let mut beside = folder.as_os_str().to_owned();
    beside.push(format!(".{}{BESIDE_SUFFIX}", std::process::id()));
    let beside = Path::new(&beside);
    let parent = folder.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let write = || {
        create_folders(beside)?;
        let written = DiskFolder::new(beside);
        replace(&written, MODEL_FILE, &[network])?;
        replace(&written, REPORT_FILE, &[report.as_bytes()])?;
        replace(&written, CARD_FILE, &[text.as_bytes()])?;
        fs::rename(beside, folder)?;
        DiskFolder::new(parent).sync()
    };
    write().map_err(|source| {
        // What is half written is of no use, and the error tells enough.
        let _ = fs::remove_dir_all(beside);
        error(source)
    })
}

#[cfg(test)]
mod tests {
    use super::super::card::tests::CARD;
    use super::*;

    #[test]
    fn a_saved_model_reads_back_and_takes_no_other_ones_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("models/site");
        let mut card: ModelCard = toml::from_str(CARD).unwrap();
        card.classes.push(super::super::ClassCard { place: 3, name: None, views: vec!["00ff".to_owned()] });
        save_model(&path.join(""), &mut card, b"network", "").unwrap();
        assert_eq!(ModelCard::read(&path.join(CARD_FILE)).unwrap(), card);
        assert_eq!(card.sha256, sha256_hex(b"network"));
        assert_eq!(fs::read(path.join(MODEL_FILE)).unwrap(), b"network");
        let refused = save_model(&path, &mut card, b"other", "").unwrap_err().to_string();
        assert!(refused.ends_with("site: it is there already; choose another"), "{refused}");
        assert_eq!(fs::read_dir(folder.path().join("models")).unwrap().count(), 1);
        let dangling = folder.path().join("dangling");
        std::os::unix::fs::symlink("nowhere", &dangling).unwrap();
        let refused = save_model(&dangling, &mut card, b"other", "").unwrap_err().to_string();
        assert!(refused.ends_with("dangling: it is there already; choose another"), "{refused}");
    }

    #[test]
    fn a_model_that_cannot_be_saved_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site");
        let mut card: ModelCard = toml::from_str(CARD).unwrap();
        // The card's place is taken, when the network has long been written.
        let beside = format!("site.{}{BESIDE_SUFFIX}", std::process::id());
        fs::create_dir_all(folder.path().join(beside).join(CARD_FILE).join("taken")).unwrap();
        let failed = save_model(&path, &mut card, b"network", "").unwrap_err().to_string();
        assert!(failed.starts_with("cannot write ") && failed.contains("site: "), "{failed}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
