//! Maps written, cut, reopened and rewritten; and what the tests of this module write into them.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::*;
use crate::cnn;
use crate::feature::{Descriptor, Features, Keypoint};
use crate::frame::Frame;
use crate::geometry::Point;
use crate::raster::{GreyImage, RgbImage};
use crate::storage::Folder;
use crate::storage::faulty::FaultyFolder;

/// A map so small that it is full of segments soon: 2 MiB, segments of 64 KiB.
pub(super) const SMALL: MapOptions = MapOptions {
    durability: Durability::Interval(Duration::from_millis(200)),
    disk_bytes: 2 << 20,
    place_experiences: 100,
};

pub(super) fn frame(index: u64) -> Frame {
    Frame {
        index,
        capture_nanos: index as i64 * 1_000,
        name: format!("{index:03}.jpg"),
        colour: RgbImage::new(4, 4),
        grey: GreyImage::new(4, 4),
        jpeg: None,
        pose: Some(Pose { position_metres: [1.0, 2.0, index as f64], orientation: [0.0, 0.0, 0.0, 1.0] }),
        true_place: None,
    }
}

/// Features that read back as they are: on the steps that the journal stores.
pub(super) fn features(seed: u64) -> Features {
    let keypoint = |i: u64| Keypoint {
        point: Point { x: (i * 3) as f32 + 0.125, y: (seed % 100) as f32 + 0.5 },
        scale: 1.0,
        angle_radians: 0.0,
        response: 0,
    };
    Features {
        width_px: 640,
        height_px: 480,
        keypoints: (0..20).map(keypoint).collect(),
        descriptors: (0..20).map(|i| Descriptor([(seed as u8).wrapping_add(i); 32])).collect(),
    }
}

pub(super) fn traits(seed: u64) -> Traits {
    let descriptor = cnn::Descriptor::from_values(vec![0.6, 0.8, seed as f32 / 100.0]).unwrap();
    Traits {
        words: vec![VocabularyWords {
            vocabulary: 7,
            words: (0..20).map(|i| WordId(i + seed as u32)).collect(),
        }],
        appearance: Some(Appearance { model: "abc".to_owned(), descriptor: (&descriptor).into() }),
    }
}

/// Learns frame `index`, as a keyframe if asked to.
pub(super) fn learn(
    map: &mut PlaceMap,
    place: Option<PlaceId>,
    index: u64,
    is_keyframe: bool,
) -> Result<Learnt, MapError> {
    learn_with(map, place, (index, is_keyframe), &[index as u8; 3000])
}

pub(super) fn learn_with(
    map: &mut PlaceMap,
    place: Option<PlaceId>,
    (index, is_keyframe): (u64, bool),
    thumbnail_jpeg: &[u8],
) -> Result<Learnt, MapError> {
    let (features, traits) = (features(index), traits(index));
    let new = NewExperience {
        frame: &frame(index),
        view: index.wrapping_mul(0x9e37_79b9_7f4a_7c15),
        mean_luminance: (index * 37 % 256) as f32,
        thumbnail_jpeg,
        keyframe: is_keyframe.then_some((&features, &traits)),
    };
    map.learn(place, &new)
}

pub(super) fn found(map: &mut PlaceMap, index: u64) -> PlaceId {
    learn(map, None, index, true).unwrap().place
}

/// Everything that a map knows, read back to the last thumbnail.
pub(super) fn knowledge(map: &PlaceMap) -> Vec<String> {
    let place = |place: &Place| {
        let Place { id, name, merged_into, neighbours, experiences, .. } = place;
        format!("{id:?} {name:?} {merged_into:?} {neighbours:?} {experiences:?}")
    };
    let experience = |experience: &Experience| {
        let &Experience { id, learnt_as, view, mean_luminance, is_keyframe, .. } = experience;
        let (origin, traits) = (map.origin(id).unwrap(), map.traits(id).unwrap());
        let features = is_keyframe.then(|| map.features(id).unwrap());
        let jpeg = map.thumbnail_jpeg(id).unwrap();
        format!("{id:?} {learnt_as:?} {view} {mean_luminance:?} {origin:?} {traits:?} {features:?} {jpeg:?}")
    };
    map.places().map(place).chain(map.experiences().map(experience)).collect()
}

pub(super) fn reopened(folder: &Path) -> PlaceMap {
    PlaceMap::open(folder, SMALL).unwrap()
}

#[test]
fn a_map_reopened_is_the_map_that_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut map = reopened(folder.path());
    let (dock, hall) = (found(&mut map, 0), found(&mut map, 1));
    let last = learn(&mut map, Some(dock), 2, false).unwrap().experience.unwrap();
    map.name_place(dock, "dock 3").unwrap();
    let before = knowledge(&map);
    drop(map);
    for reopened in [PlaceMap::open_read_only(folder.path()).unwrap(), reopened(folder.path())] {
        assert_eq!(knowledge(&reopened), before);
        let summary = reopened.summary();
        assert_eq!((summary.places, summary.experiences, summary.keyframes), (2, 3, 2));
        assert_eq!(reopened.place(dock).unwrap().name.as_deref(), Some("dock 3"));
        assert_eq!(reopened.place(dock).unwrap().neighbours, [hall]);
        assert_eq!(reopened.features(ExperienceId(0)).unwrap(), features(0));
        assert_eq!(reopened.traits(ExperienceId(1)).unwrap(), traits(1));
        assert_eq!(reopened.thumbnail_jpeg(last).unwrap(), [2; 3000]);
        assert_eq!(reopened.origin(last).unwrap().frame_name, "002.jpg");
    }
}

#[test]
fn a_map_that_outgrew_many_segments_is_the_same_with_and_without_its_snapshot() {
    let folder = tempfile::tempdir().unwrap();
    let mut map = reopened(folder.path());
    let place = found(&mut map, 0);
    for index in 1..100 {
        learn(&mut map, (index % 7 > 0).then_some(place), index, index % 3 == 0).unwrap();
    }
    map.name_place(PlaceId(1), "hall").unwrap();
    let before = knowledge(&map);
    drop(map);
    assert!(
        folder.path().join("journal-000004.loci").exists() && folder.path().join("snapshot.loci").exists()
    );
    assert_eq!(knowledge(&reopened(folder.path())), before);
    fs::remove_file(folder.path().join("snapshot.loci")).unwrap();
    assert_eq!(knowledge(&reopened(folder.path())), before);
    fs::write(folder.path().join("snapshot.loci"), b"LOCISNP\0\x01\0\0\0 and then something else entirely")
        .unwrap();
    let map = reopened(folder.path());
    assert_eq!(knowledge(&map), before);
    assert!(
        map.snapshot_fault().unwrap().to_string().contains("snapshot.loci is of no use to this journal: "),
        "{:?}",
        map.snapshot_fault()
    );
}

#[test]
fn a_torn_last_experience_costs_that_experience_alone() {
    let folder = tempfile::tempdir().unwrap();
    let mut map = reopened(folder.path());
    let place = found(&mut map, 0);
    learn(&mut map, Some(place), 1, true).unwrap();
    drop(map);
    let path = folder.path().join("journal-000001.loci");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() - 3]).unwrap();
    let mut map = reopened(folder.path());
    assert_eq!(map.experiences().count(), 1);
    assert!(map.summary().torn_bytes > 0);
    learn(&mut map, Some(place), 2, true).unwrap();
    drop(map);
    assert_eq!(reopened(folder.path()).experiences().count(), 2);
}

#[test]
fn a_map_of_version_1_opens_and_grows_on() {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/map/version_1");
    let folder = tempfile::tempdir().unwrap();
    fs::copy(fixture.join("journal-000001.loci"), folder.path().join("journal-000001.loci")).unwrap();
    let before = knowledge(&PlaceMap::open_read_only(folder.path()).unwrap());
    let mut map = reopened(folder.path());
    assert_eq!(knowledge(&map), before);
    let names: Vec<Option<&str>> = map.places().map(|place| place.name.as_deref()).collect();
    assert_eq!(names, [Some("dock 4"), None]);
    let learnt: Vec<(u32, Option<f32>, bool)> =
        map.experiences().map(|e| (e.learnt_as.0, e.mean_luminance, e.is_keyframe)).collect();
    assert_eq!(
        learnt,
        [(0, Some(80.0), true), (1, Some(81.0), true), (0, Some(82.0), false), (1, None, true)]
    );
    let features = map.features(ExperienceId(1)).unwrap();
    assert_eq!((features.len(), features.descriptors[1].0[..3].to_vec()), (12, vec![32, 39, 46]));
    assert_eq!(map.origin(ExperienceId(2)).unwrap().frame_name, "002.jpg");
    assert_eq!(map.thumbnail_jpeg(ExperienceId(2)).unwrap(), [2; 9]);
    assert!(map.traits(ExperienceId(0)).unwrap().appearance.is_some());
    learn(&mut map, Some(PlaceId(1)), 9, true).unwrap();
    assert_eq!(map.experiences_ever(), 5);
    // Written again in today's format, it says the same, to the precision of today's packing.
    let (places, origin) = (
        map.places().map(|p| p.experiences.clone()).collect::<Vec<_>>(),
        map.origin(ExperienceId(0)).unwrap(),
    );
    map.compact().unwrap();
    drop(map);
    assert!(!folder.path().join("journal-000001.loci").exists());
    let map = reopened(folder.path());
    assert_eq!(map.places().map(|p| p.experiences.clone()).collect::<Vec<_>>(), places);
    assert_eq!(map.origin(ExperienceId(0)).unwrap(), origin);
    assert_eq!(map.features(ExperienceId(1)).unwrap().descriptors, features.descriptors);
}

#[test]
fn a_journal_of_version_1_is_on_the_medium_before_the_map_goes_on_in_a_second_segment() {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/map/version_1/journal-000001.loci");
    let bytes = fs::read(fixture).unwrap();
    let folder = FaultyFolder::default();
    folder.open("journal-000001.loci", true).unwrap().append(&bytes).unwrap();
    let options = MapOptions { durability: Durability::Every, ..SMALL };
    let mut map = PlaceMap::open_folder(Arc::new(folder.clone()), Some(options), None).unwrap();
    found(&mut map, 9);
    let left = folder.after_power_cut(&mut |_| 0);
    assert_eq!(knowledge(&PlaceMap::open_folder(Arc::new(left), None, None).unwrap()), knowledge(&map));
}

#[test]
fn a_merged_place_is_found_by_its_old_number_and_can_be_taken_apart_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut map = reopened(folder.path());
    let (dock, hall, lift) = (found(&mut map, 0), found(&mut map, 1), found(&mut map, 2));
    map.name_place(hall, "hall").unwrap();
    let before = knowledge(&map);
    map.merge_places(hall, dock).unwrap();
    map.merge_places(dock, lift).unwrap();
    assert!(map.merge_places(lift, hall).is_err(), "no circle");
    let merged = knowledge(&map);
    let mut map = reopened_after(map, folder.path());
    assert_eq!(knowledge(&map), merged);
    for id in [dock, hall, lift] {
        assert_eq!(map.place(id).unwrap().id, lift);
    }
    assert_eq!(map.place(hall).unwrap().experiences.len(), 3);
    assert_eq!(map.place(hall).unwrap().name.as_deref(), Some("hall"));
    assert_eq!((map.summary().places, map.summary().merged_places), (1, 2));
    let learnt = learn(&mut map, Some(hall), 3, false).unwrap();
    assert_eq!(learnt.place, lift);
    map.split_place(hall).unwrap();
    map.split_place(dock).unwrap();
    let apart: Vec<usize> = map.places().map(|place| place.experiences.len()).collect();
    assert_eq!(apart, [1, 1, 2]);
    assert_eq!(knowledge(&map)[1], before[1], "the hall is as it was");
}

fn reopened_after(map: PlaceMap, folder: &Path) -> PlaceMap {
    drop(map);
    reopened(folder)
}

#[test]
fn a_map_takes_in_another_one_under_new_numbers() {
    let (mut first, mut second) = (PlaceMap::in_memory(SMALL).unwrap(), PlaceMap::in_memory(SMALL).unwrap());
    for index in 0..3 {
        found(&mut first, index);
        found(&mut second, index + 10);
    }
    second.name_place(PlaceId(1), "hall").unwrap();
    second.merge_places(PlaceId(0), PlaceId(2)).unwrap();
    learn(&mut second, Some(PlaceId(0)), 20, false).unwrap();
    let before = knowledge(&second);
    assert_eq!(first.absorb(&second, &AtomicBool::new(false)).unwrap().0, PlaceId(3));
    assert_eq!(knowledge(&second), before, "the other map stays as it is");
    assert_eq!((first.places().len(), first.experiences().count()), (6, 7));
    assert_eq!(first.place(PlaceId(3)).unwrap().id, PlaceId(5));
    assert_eq!(first.place(PlaceId(4)).unwrap().name.as_deref(), Some("hall"));
    let experiences = [3, 5, 6].map(ExperienceId);
    assert_eq!(first.place(PlaceId(5)).unwrap().experiences, experiences);
    assert_eq!(first.features(experiences[1]).unwrap(), features(12));
    assert_eq!(first.traits(experiences[1]).unwrap(), traits(12));
    assert_eq!(first.origin(experiences[2]).unwrap().frame_name, "020.jpg");
    assert_eq!(first.thumbnail_jpeg(experiences[2]).unwrap(), [20; 3000]);
}

#[test]
fn a_map_of_version_2_opens_with_and_without_its_snapshot() {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/map/version_2");
    let map = PlaceMap::open_read_only(&fixture).unwrap();
    assert!(map.snapshot_fault().is_none());
    let places: Vec<(Option<&str>, Option<PlaceId>, usize)> =
        map.places().map(|p| (p.name.as_deref(), p.merged_into, p.experiences.len())).collect();
    assert_eq!(places, [(Some("dock"), None, 3), (None, Some(PlaceId(0)), 0)]);
    assert_eq!(map.features(ExperienceId(2)).unwrap().descriptors[1], Descriptor([3; 32]));
    assert_eq!(map.traits(ExperienceId(2)).unwrap().words[0].words, [2, 3, 4].map(WordId));
    assert_eq!(map.thumbnail_jpeg(ExperienceId(1)).unwrap(), [1; 9]);
    let folder = tempfile::tempdir().unwrap();
    fs::copy(fixture.join("journal-000001.loci"), folder.path().join("journal-000001.loci")).unwrap();
    assert_eq!(knowledge(&PlaceMap::open_read_only(folder.path()).unwrap()), knowledge(&map));
}
