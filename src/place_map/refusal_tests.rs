//! Maps that lack a file, have one too many or one that is not their own, and changes that make no sense.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::contents::MAX_SEGMENT;
use super::journal::{segment_identity, segment_name};
use super::tests::{SMALL, features, found, knowledge, learn, reopened};
use super::{Experience, ExperienceId, MapError, PlaceId, PlaceMap};
use crate::storage::faulty::FaultyFolder;
use crate::storage::{DiskFolder, Folder, MemoryFolder, Reading, RecordLog, Tail};

#[test]
fn a_missing_map_is_named_with_the_command_that_makes_one() {
    let folder = tempfile::tempdir().unwrap();
    for path in [folder.path().to_owned(), folder.path().join("gone")] {
        let error = PlaceMap::open_read_only(&path).err().unwrap().to_string();
        assert!(error.contains(&path.display().to_string()) && error.contains("loci run"), "{error}");
    }
}

#[test]
fn a_segment_that_is_gone_is_named() {
    for gone in [1, 2, 3] {
        let folder = tempfile::tempdir().unwrap();
        let mut map = reopened(folder.path());
        for index in 0..60 {
            found(&mut map, index);
        }
        drop(map);
        let name = format!("journal-{gone:06}.loci");
        fs::remove_file(folder.path().join(&name)).unwrap();
        let error = PlaceMap::open(folder.path(), SMALL).err().unwrap().to_string();
        assert!(error.starts_with("cannot open ") && error.contains(&name), "{error}");
    }
}

#[test]
fn segments_that_changed_names_are_refused_by_name_whatever_the_map_is_opened_for() {
    let folder = tempfile::tempdir().unwrap();
    let mut map = reopened(folder.path());
    for index in 0..60 {
        found(&mut map, index);
    }
    drop(map);
    let [first, second] = [1, 2].map(|number| folder.path().join(segment_name(number)));
    fs::copy(&first, &second).unwrap();
    let expected = format!(
        "{} is number 1 of a map journal, not 2: renamed, copied or damaged at its head; name every file as it was",
        second.display()
    );
    // The snapshot is behind both.
    assert!(PlaceMap::verify(folder.path(), &|_, _| ()).unwrap().is_damaged());
    for opened in [
        PlaceMap::open(folder.path(), SMALL),
        PlaceMap::open_read_only(folder.path()),
        PlaceMap::open_damaged(folder.path(), SMALL),
    ] {
        assert_eq!(opened.err().unwrap().to_string(), expected);
    }
}

#[test]
fn segments_without_numbers_that_changed_names_cost_no_experience() {
    let folder = tempfile::tempdir().unwrap();
    let mut map = reopened(folder.path());
    for index in 0..60 {
        found(&mut map, index);
    }
    map.close().unwrap();
    let experiences: Vec<Experience> = map.experiences().copied().collect();
    drop(map);
    let mut segments = [1, 2].map(|number| fs::read(folder.path().join(segment_name(number))).unwrap());
    segments.iter_mut().for_each(|bytes| bytes[12..16].fill(0));
    for (number, bytes) in [2, 1].into_iter().zip(&segments) {
        fs::write(folder.path().join(segment_name(number)), bytes).unwrap();
    }
    let mut map = reopened(folder.path());
    assert!(map.snapshot_fault().unwrap().to_string().contains("says otherwise of experience"));
    map.compact().unwrap();
    assert!(map.take_loss().is_none());
    let left: Vec<ExperienceId> = map.experiences().map(|experience| experience.id).collect();
    assert_eq!(left, experiences.iter().map(|experience| experience.id).collect::<Vec<_>>());
}

#[test]
fn a_segment_that_is_deleted_under_the_map_is_named_by_its_next_change_and_the_map_is_read_on() {
    let on_disk = tempfile::tempdir().unwrap();
    let folders: [Arc<dyn Folder>; 3] = [
        Arc::new(DiskFolder::new(on_disk.path())),
        Arc::new(MemoryFolder::default()),
        Arc::new(FaultyFolder::default()),
    ];
    type Change = fn(&mut PlaceMap) -> Result<(), MapError>;
    let until_a_segment_ends: Change = |map| (100..200).try_for_each(|i| learn(map, None, i, true).map(drop));
    let after_a_sync_beside: Change = |map| {
        map.syncer().sync();
        learn(map, None, 100, true).map(drop)
    };
    let changes: [Change; 4] = [PlaceMap::sync, PlaceMap::close, until_a_segment_ends, after_a_sync_beside];
    for folder in folders {
        for change in changes {
            let mut map = PlaceMap::open_folder(folder.clone(), Some(SMALL), None).unwrap();
            for index in 0..40 {
                found(&mut map, index);
            }
            map.sync().unwrap();
            folder.remove("journal-000001.loci").unwrap();
            let error = change(&mut map).unwrap_err().to_string();
            assert!(
                error.contains("journal-000001.loci was deleted while the map was in use; restore it"),
                "{error}"
            );
            assert!(!map.is_writable());
            assert_eq!(map.features(ExperienceId(0)).unwrap(), features(0));
            assert!(learn(&mut map, None, 300, true).is_err());
            drop(map);
            folder.names().unwrap().iter().for_each(|name| folder.remove(name).unwrap());
        }
    }
}

#[test]
fn a_sync_beside_the_writer_never_takes_its_own_deleting_for_somebody_elses() {
    let mut map = PlaceMap::in_memory(SMALL).unwrap();
    let syncer = map.syncer();
    let is_over = AtomicBool::new(false);
    let oldest = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(Ordering::Relaxed) {
                syncer.sync();
            }
        });
        let learnt = (0..1000)
            .try_for_each(|index| learn(&mut map, (index > 0).then_some(PlaceId(0)), index, true).map(drop));
        is_over.store(true, Ordering::Relaxed);
        learnt.map(|()| map.journal.oldest_number())
    });
    assert!(oldest.unwrap() > 5);
}

#[test]
fn a_segment_with_a_number_that_none_can_have_is_refused_by_name() {
    for number in [1 << 24, u32::MAX] {
        let folder = tempfile::tempdir().unwrap();
        found(&mut reopened(folder.path()), 0);
        let named = |number: u32| folder.path().join(format!("journal-{number:06}.loci"));
        fs::rename(named(1), named(number)).unwrap();
        let expected = format!(
            "cannot open {}: a segment's number is at most 16777215; move it away",
            named(number).display()
        );
        for opened in [PlaceMap::open(folder.path(), SMALL), PlaceMap::open_read_only(folder.path())] {
            assert_eq!(opened.err().unwrap().to_string(), expected);
        }
        assert!(PlaceMap::verify(folder.path(), &|_, _| ()).unwrap().is_damaged());
    }
}

#[test]
fn a_map_whose_segments_are_all_numbered_goes_on_in_none() {
    let folder = Arc::new(MemoryFolder::default());
    let (name, path) = (segment_name(MAX_SEGMENT), Path::new("last"));
    let reading = Reading { from: 0, wanted: |_| true, visit: &mut |_| Ok(()) };
    let file = folder.open(&name, true).unwrap();
    RecordLog::open(file, segment_identity(MAX_SEGMENT, path), Tail::Mended, reading).unwrap();
    let mut map = PlaceMap::open_folder(folder, Some(SMALL), None).unwrap();
    let full = (0..40).find_map(|index| learn(&mut map, None, index, true).err()).unwrap().to_string();
    assert!(full.contains("at most 16777215 segments in its life; begin a new one"), "{full}");
    let before = map.experiences().count();
    assert!(map.experiences().all(|experience| map.features(experience.id).is_ok()) && before > 10);
}

#[test]
fn an_experience_too_many_is_refused_and_takes_no_other_ones_number() {
    let folder = Arc::new(MemoryFolder::default());
    let mut map = PlaceMap::open_folder(folder.clone(), Some(SMALL), None).unwrap();
    found(&mut map, 0);
    map.contents.next_experience = u32::MAX - 1;
    found(&mut map, 1);
    let before = knowledge(&map);
    let (mut other, mut again) = (PlaceMap::in_memory(SMALL).unwrap(), map);
    found(&mut other, 2);
    for map in [&mut again, &mut PlaceMap::open_folder(folder, Some(SMALL), None).unwrap()] {
        let refusals =
            [learn(map, None, 3, true).map(drop), map.absorb(&other, &AtomicBool::new(false)).map(drop)];
        for refusal in refusals {
            let refusal = refusal.unwrap_err().to_string();
            assert!(
                refusal.contains("4294967295 experiences, as many as it can count; begin a new one"),
                "{refusal}"
            );
        }
        assert!(knowledge(map).starts_with(&before[..1]));
        assert_eq!(map.features(ExperienceId(u32::MAX - 1)).unwrap(), features(1));
    }
}

#[test]
fn what_is_not_in_the_map_is_refused_by_number_and_changes_nothing() {
    let mut map = PlaceMap::in_memory(SMALL).unwrap();
    let place = found(&mut map, 0);
    let before = knowledge(&map);
    let message = |error: MapError| error.to_string();
    assert_eq!(
        message(learn(&mut map, Some(PlaceId(3)), 1, true).unwrap_err()),
        "there is no place 3 in the map"
    );
    assert_eq!(message(map.name_place(PlaceId(3), "x").unwrap_err()), "there is no place 3 in the map");
    assert_eq!(message(map.features(ExperienceId(5)).unwrap_err()), "there is no experience 5 in the map");
    assert!(message(map.merge_places(place, place).unwrap_err()).contains("one place already"));
    assert!(message(map.split_place(place).unwrap_err()).contains("not merged"));
    assert_eq!(knowledge(&map), before);
    assert!(map.is_writable());
}
