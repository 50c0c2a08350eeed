//! Maps that have no room: what they give up, and that their folders never outgrow the budget.

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::tests::{SMALL, found, knowledge, learn, learn_with};
use super::*;
use crate::storage::{AppendFile, Folder, MemoryFolder};

#[test]
fn a_full_place_keeps_what_differs_and_every_new_keyframe() {
    let options = MapOptions { place_experiences: 10, ..SMALL };
    let mut map = PlaceMap::in_memory(options).unwrap();
    let place = found(&mut map, 0);
    let mut given_up = 0;
    for index in 1..60 {
        let learnt = learn(&mut map, Some(place), index, index % 20 == 0).unwrap();
        assert!(learnt.experience.is_some() || index % 20 > 0, "keyframe {index} was turned away");
        given_up += learnt.given_up.len();
        assert!(map.experiences().count() <= 10);
    }
    assert_eq!(map.summary().keyframes + given_up, 3);
}

#[test]
fn a_map_stays_within_its_budget_for_ever_and_loses_no_place() {
    let folder = Arc::new(MemoryFolder::default());
    let mut map = PlaceMap::open_folder(folder.clone(), Some(SMALL), None).unwrap();
    let bytes = |folder: &MemoryFolder| -> u64 {
        let names = folder.names().unwrap();
        names.iter().map(|name| folder.open(name, false).unwrap().length_bytes().unwrap()).sum()
    };
    let mut most = 0;
    for index in 0..6000 {
        let place = (index >= 200).then(|| PlaceId((index * 7 % 200) as u32));
        learn(&mut map, place, index, index % 5 == 0).unwrap();
        most = most.max(bytes(&folder));
    }
    assert!(most <= SMALL.disk_bytes, "{most} bytes");
    let summary = map.summary();
    assert_eq!(summary.places, 200);
    assert!(map.places().all(|place| !place.experiences.is_empty()));
    assert!(summary.live_bytes <= SMALL.disk_bytes * 3 / 4, "{summary:?}");
    let before = knowledge(&map);
    drop(map);
    assert_eq!(knowledge(&PlaceMap::open_folder(folder.clone(), Some(SMALL), None).unwrap()), before);
    folder.remove("snapshot.loci").unwrap();
    assert_eq!(knowledge(&PlaceMap::open_folder(folder, Some(SMALL), None).unwrap()), before);
}

/// A folder in memory that knows how many bytes were in it at most: it shrinks only as files go.
#[derive(Default)]
struct MeasuredFolder {
    folder: MemoryFolder,
    most_bytes: AtomicU64,
}

impl MeasuredFolder {
    /// Most bytes since this was asked before.
    fn take_most_bytes(&self) -> u64 {
        self.measure().unwrap();
        self.most_bytes.swap(0, Ordering::Relaxed)
    }

    fn measure(&self) -> io::Result<()> {
        let lengths = self.names()?.into_iter().map(|name| self.folder.open(&name, false)?.length_bytes());
        self.most_bytes.fetch_max(lengths.sum::<io::Result<u64>>()?, Ordering::Relaxed);
        Ok(())
    }
}

impl Folder for MeasuredFolder {
    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn names(&self) -> io::Result<Vec<String>> {
        self.folder.names()
    }

    fn open(&self, name: &str, writable: bool) -> io::Result<Arc<dyn AppendFile>> {
        self.folder.open(name, writable)
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        self.measure()?;
        self.folder.rename(from, to)
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        self.measure()?;
        self.folder.remove(name)
    }

    fn sync(&self) -> io::Result<()> {
        self.folder.sync()
    }
}

#[test]
fn a_map_is_never_larger_than_its_budget_not_even_while_a_segment_is_emptied() {
    for thumbnail_bytes in [300, 3_000, 12_000, 30_000] {
        let folder = Arc::new(MeasuredFolder::default());
        let mut map = PlaceMap::open_folder(folder.clone(), Some(SMALL), None).unwrap();
        for index in 0..3000 {
            let place = (index >= 30).then(|| PlaceId((index * 7 % 30) as u32));
            learn_with(&mut map, place, (index, index % 5 == 0), &vec![1; thumbnail_bytes]).unwrap();
        }
        let most_bytes = folder.take_most_bytes();
        assert!(most_bytes <= SMALL.disk_bytes, "{most_bytes} bytes with thumbnails of {thumbnail_bytes}");
        assert!(map.journal.oldest_number() > 5, "no segment was emptied");
    }
}

#[test]
fn a_map_that_was_compacted_fits_a_budget_little_larger_than_it_is() {
    let folder = Arc::new(MeasuredFolder::default());
    let mut map = PlaceMap::open_folder(folder.clone(), Some(MapOptions::default()), None).unwrap();
    for index in 0..900 {
        let place = (index >= 30).then(|| PlaceId((index * 7 % 30) as u32));
        learn(&mut map, place, index, index % 5 == 0).unwrap();
    }
    assert_eq!(map.journal.segment_count(), 1);
    map.compact().unwrap();
    let live_bytes = map.summary().live_bytes;
    assert!(map.journal.longest_bytes() < live_bytes / 20);
    drop(map);
    let options = MapOptions { disk_bytes: live_bytes * 9 / 8, ..SMALL };
    let mut map = PlaceMap::open_folder(folder.clone(), Some(options), None).unwrap();
    folder.take_most_bytes();
    for index in 900..4000 {
        learn(&mut map, Some(PlaceId((index * 7 % 30) as u32)), index, index % 5 == 0).unwrap();
    }
    let most_bytes = folder.take_most_bytes();
    assert!(most_bytes <= options.disk_bytes, "{most_bytes} of {}", options.disk_bytes);
    assert!(map.experiences().count() > 100);
}

#[test]
fn a_full_map_says_so_and_keeps_every_place() {
    let options = MapOptions { disk_bytes: 1 << 20, ..SMALL };
    let mut map = PlaceMap::in_memory(options).unwrap();
    let full = (0..1000).find_map(|index| learn(&mut map, None, index, true).err()).unwrap();
    assert!(
        full.to_string().contains("the map is full") && full.to_string().contains("--map-disk"),
        "{full}"
    );
    assert!(map.summary().places > 100);
    assert!(map.places().all(|place| place.experiences.len() == 1));
    assert!(map.is_writable(), "it can still be named and merged");
}
