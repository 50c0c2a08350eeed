//! Whether another model lies in a model's folder than before.
//!
//! The folder may be a link that was turned over, or another one by now, or somebody may be copying into it. So what is
//! looked at are the files that its two names lead to, and only once they are the same for two looks.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::cnn::{CARD_FILE, MODEL_FILE};

/// What tells one file from another, or from itself before a change; `None` where there is none.
type FileState = Option<(u64, u64, u64, i64, i64)>;

/// The files of a model.
type State = [FileState; 2];

fn state(folder: &Path) -> State {
    [CARD_FILE, MODEL_FILE].map(|name| {
        let file = fs::metadata(folder.join(name)).ok()?;
        Some((file.dev(), file.ino(), file.len(), file.mtime(), file.mtime_nsec()))
    })
}

/// Looks at a folder again and again.
pub(super) struct FolderWatch {
    folder: PathBuf,
    latest: Option<State>,
    /// The state that was last found to be news.
    told: Option<State>,
}

impl FolderWatch {
    /// A watch to which everything is news.
    pub(super) fn new(folder: PathBuf) -> Self {
        Self { folder, latest: None, told: None }
    }

    /// Whether the files are others than when this was last true, and did not change since the last look.
    pub(super) fn has_news(&mut self) -> bool {
        let state = Some(state(&self.folder));
        let is_at_rest = std::mem::replace(&mut self.latest, state) == state;
        let is_news = is_at_rest && self.told != state;
        if is_news {
            self.told = state;
        }
        is_news
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    fn write(folder: &Path, name: &str, text: &str) {
        fs::create_dir_all(folder).unwrap();
        fs::write(folder.join(name), text).unwrap();
    }

    #[test]
    fn a_folder_that_is_being_copied_is_news_once_it_is_at_rest_and_only_once() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), CARD_FILE, "card");
        let mut watch = FolderWatch::new(folder.path().to_owned());
        let mut looks = vec![watch.has_news(), watch.has_news(), watch.has_news()];
        for bytes in ["n", "ne", "network"] {
            write(folder.path(), MODEL_FILE, bytes);
            looks.push(watch.has_news());
        }
        looks.extend([watch.has_news(), watch.has_news()]);
        assert_eq!(looks, [false, true, false, false, false, false, true, false]);
    }

    #[test]
    fn a_link_that_is_turned_over_is_news_and_so_is_a_folder_that_vanishes() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("current");
        for version in ["1", "2"] {
            write(&folder.path().join(version), CARD_FILE, "card");
            write(&folder.path().join(version), MODEL_FILE, "network");
        }
        symlink("1", &link).unwrap();
        let mut watch = FolderWatch::new(link.clone());
        let mut twice = || (watch.has_news(), watch.has_news());
        assert_eq!(twice(), (false, true));
        symlink("2", folder.path().join("next")).unwrap();
        fs::rename(folder.path().join("next"), &link).unwrap();
        assert_eq!(twice(), (false, true));
        fs::remove_file(&link).unwrap();
        assert_eq!(twice(), (false, true));
        assert_eq!(twice(), (false, false));
    }
}
