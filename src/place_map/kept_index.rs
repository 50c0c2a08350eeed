//! The index of a map's keyframes, kept in its folder so that the map opens quickly. It only saves time: it is of one
//! state of the map, and where it is missing, damaged or of another state, it is made anew.
//!
//! Whoever writes the map takes it out of the folder, for the next change makes it untrue. It never takes the room of
//! anything that was learnt: as long as it is mapped it counts, though no name leads to it.

use std::io;

use super::map::PlaceMap;
use super::snapshot;
use crate::storage::{self, BESIDE_SUFFIX, FileBytes, FileKind, Folder, HEADER_BYTES};

pub(super) const NAME: &str = "index.loci";
const KIND: FileKind = FileKind { magic: *b"LOCIIDX\0", version: 1, name: "index of a map" };
/// Bytes that say of which state of the map it is.
const STATE_BYTES: usize = 16;

/// An index that was kept.
#[derive(Debug)]
pub struct KeptIndex {
    /// The file.
    pub file: FileBytes,
    /// Where in it the index begins: at a multiple of four.
    pub begin: usize,
}

/// The index in `folder`, if there is one; if the map is written, it is there no longer.
pub(super) fn found(folder: &dyn Folder, is_writable: bool) -> Option<FileBytes> {
    let file = folder.map(NAME).ok();
    if is_writable && file.is_some() {
        // Where that fails, the map's state will tell that it is not its own any more.
        let _ = folder.remove(NAME);
    }
    file
}

impl PlaceMap {
    /// The index that was kept when the map was as it is now, once.
    pub fn take_index(&mut self) -> Option<KeptIndex> {
        let file = self.index.take()?;
        KIND.verify(&file, &self.folder.path().join(NAME)).ok()?;
        let begin = HEADER_BYTES + STATE_BYTES;
        (file.get(HEADER_BYTES..begin)? == self.state()?).then_some(KeptIndex { file, begin })
    }

    /// Keeps an index of the map as it is now, in parts that follow each other, if the budget has room for it. Without
    /// it the map opens as well, only slower: so that it cannot be written is no failure, and that it survives a power
    /// cut is not waited for.
    pub fn keep_index(&self, parts: &[&[u8]]) {
        let length_bytes: usize = parts.iter().map(|part| part.len()).sum();
        if !self.is_writable() || !self.has_room_for((HEADER_BYTES + STATE_BYTES + length_bytes) as u64) {
            return;
        }
        let Some(state) = self.state() else { return };
        let folder = self.folder.as_ref();
        let beside = format!("{NAME}{BESIDE_SUFFIX}");
        let parts = [&[&state[..]], parts].concat();
        let kept = write(folder, &beside, &parts).and_then(|()| folder.rename(&beside, NAME));
        if kept.is_err() {
            let _ = folder.remove(&beside);
        }
    }

    /// What tells this state of the map from all others: how far its journal goes, and what it knows.
    fn state(&self) -> Option<[u8; STATE_BYTES]> {
        let end = self.journal.end();
        let packed = snapshot::packed(end, &self.contents).ok()?;
        let mut state = [0; STATE_BYTES];
        state[..8].copy_from_slice(&end.offset.to_le_bytes());
        state[8..12].copy_from_slice(&end.segment.to_le_bytes());
        state[12..].copy_from_slice(&storage::checksum(&packed).to_le_bytes());
        Some(state)
    }
}

fn write(folder: &dyn Folder, name: &str, parts: &[&[u8]]) -> io::Result<()> {
    let file = folder.open(name, true)?;
    file.truncate(0)?;
    file.append(&KIND.header_of(parts))?;
    parts.iter().try_for_each(|part| file.append(part))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::tests::{SMALL, found, learn};
    use super::super::{MapOptions, PlaceMap};
    use super::*;
    use crate::storage::MemoryFolder;

    fn opened(folder: &Arc<MemoryFolder>, options: Option<MapOptions>) -> PlaceMap {
        PlaceMap::open_folder(folder.clone(), options, None).unwrap()
    }

    fn kept(map: &mut PlaceMap) -> Option<Vec<u8>> {
        map.take_index().map(|kept| kept.file[kept.begin..].to_vec())
    }

    /// A folder with a map of one place, and an index of it.
    fn folder() -> Arc<MemoryFolder> {
        let folder = Arc::new(MemoryFolder::default());
        let mut map = opened(&folder, Some(SMALL));
        found(&mut map, 0);
        map.close().unwrap();
        map.keep_index(&[b"an ", b"index"]);
        folder
    }

    #[test]
    fn it_comes_back_once_with_the_map_as_it_was() {
        let folder = folder();
        for _ in 0..2 {
            let mut map = opened(&folder, None);
            assert_eq!(kept(&mut map).unwrap(), b"an index");
            assert_eq!(kept(&mut map), None);
        }
        let mut map = opened(&folder, Some(SMALL));
        assert!(!folder.names().unwrap().contains(&NAME.to_owned()), "who writes the map has taken it out");
        assert_eq!(kept(&mut map).unwrap(), b"an index");
    }

    #[test]
    fn it_is_of_no_other_state_of_the_map() {
        let folder = folder();
        let index = folder.map(NAME).unwrap().to_vec();
        let mut map = opened(&folder, Some(SMALL));
        learn(&mut map, None, 1, true).unwrap();
        map.close().unwrap();
        folder.open(NAME, true).unwrap().append(&index).unwrap();
        assert_eq!(kept(&mut opened(&folder, None)), None);
    }

    #[test]
    fn what_a_power_cut_left_of_one_is_removed() {
        let folder = folder();
        folder.open("index.loci.part", true).unwrap().append(b"half").unwrap();
        opened(&folder, Some(SMALL));
        assert!(!folder.names().unwrap().contains(&"index.loci.part".to_owned()));
    }

    #[test]
    fn a_damaged_one_is_none() {
        let folder = folder();
        let index = folder.map(NAME).unwrap().to_vec();
        for cut in 0..index.len() {
            let file = folder.open(NAME, true).unwrap();
            file.truncate(0).unwrap();
            file.append(&index[..cut]).unwrap();
            assert_eq!(kept(&mut opened(&folder, None)), None, "{cut} bytes");
            let mut flipped = index.clone();
            flipped[cut] ^= 0x10;
            file.truncate(0).unwrap();
            file.append(&flipped).unwrap();
            assert_eq!(kept(&mut opened(&folder, None)), None, "byte {cut}");
        }
    }

    #[test]
    fn it_takes_no_room_that_the_budget_has_not() {
        let folder = folder();
        let is_kept = |folder: &MemoryFolder| folder.names().unwrap().contains(&NAME.to_owned());
        let map = opened(&folder, Some(SMALL));
        map.keep_index(&[&vec![0; SMALL.disk_bytes as usize]]);
        assert!(!is_kept(&folder));
        // Two thirds of the budget fit, but not beside as much that is still mapped.
        let most = vec![0; SMALL.disk_bytes as usize * 2 / 3];
        map.keep_index(&[&most]);
        assert!(is_kept(&folder));
        drop(map);
        let map = opened(&folder, Some(SMALL));
        map.keep_index(&[&most]);
        assert!(!is_kept(&folder));
    }
}
