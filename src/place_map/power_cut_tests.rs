//! Power cut, a medium that fills up, and operations that fail, at every operation of a map's scripted life and at
//! random ones of random lives: whatever was acknowledged is found again, and nothing is found that never was.
//!
//! [`crate::storage::faulty`] says what a power cut may leave of what was not synced.

use std::sync::Arc;

use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::journal::segment_name;
use super::scripted_life::Step::{
    Background, Close, Compact, Found, Learn, Merge, Name, Renew, Reopen, Split, Sync,
};
use super::scripted_life::{Facts, INTERVAL, Life, Step, facts, learn, live, open, options, script};
use super::{Durability, ExperienceId, MapError, PlaceId, PlaceMap, snapshot};
use crate::storage::Folder;
use crate::storage::faulty::FaultyFolder;

/// What is said of a place that was absorbed before the links among those places were.
const UNLINKED: &str = "None None []";

/// Whether `found` is `before`, `after`, or something on the way from the one to the other.
fn is_between(found: &Facts, before: &Facts, after: &Facts) -> bool {
    let is_one_of_both =
        |about: &String, fact| [before, after].iter().any(|state| state.get(about) == Some(fact));
    let is_being_absorbed = |about: &String, fact: &String| {
        fact == UNLINKED && !before.contains_key(about) && after.contains_key(about)
    };
    found.iter().all(|(about, fact)| is_one_of_both(about, fact) || is_being_absorbed(about, fact))
        && before.keys().filter(|&about| after.contains_key(about)).all(|about| found.contains_key(about))
}

/// Asserts that `found` holds all that was certain in `life`, a part of the one that led through `states`, and
/// nothing that never was.
fn assert_explained(found: &Facts, life: &Life, states: &[Facts]) {
    let is_explained = (life.certain..=life.steps()).any(|steps| {
        let before = &states[steps];
        is_between(found, before, states.get(steps + 1).unwrap_or(before))
    });
    assert!(is_explained, "found {found:#?}\nof {:#?}", states.get(life.certain));
}

/// Opens what a power cut left, and asserts that it is what it must be, however it is opened, and grows on.
fn assert_recovered(left: &FaultyFolder, durability: Durability, life: &Life, states: &[Facts]) {
    let read_only = PlaceMap::open_folder(Arc::new(left.clone()), None, None).unwrap();
    let found = facts(&read_only);
    assert_explained(&found, life, states);
    let mut map = open(left, durability).unwrap();
    assert_eq!(facts(&map), found);
    if left.names().unwrap().iter().any(|name| name == snapshot::NAME) {
        assert!(map.snapshot_fault().is_none());
        left.remove(snapshot::NAME).unwrap();
        let without = PlaceMap::open_folder(Arc::new(left.clone()), None, None).unwrap();
        assert_eq!(facts(&without), found, "without its snapshot");
    }
    let ever = map.experiences_ever();
    let learnt = learn(&mut map, None, 99, true).unwrap();
    assert!(learnt.experience.is_some_and(|id| id.0 == ever), "no number is used twice");
    let grown = facts(&map);
    drop(map);
    assert_eq!(facts(&open(left, durability).unwrap()), grown);
}

fn lost(_ways: usize) -> usize {
    0
}

fn kept(ways: usize) -> usize {
    ways - 1
}

fn random(seed: u64) -> impl FnMut(usize) -> usize {
    let mut random = Pcg64::seed_from_u64(seed);
    move |ways| random.random_range(0..ways)
}

/// What a power cut may leave of `folder`: nothing that is not certain, everything, and whatever chance leaves.
fn leftovers(folder: &FaultyFolder, seed: u64) -> [FaultyFolder; 4] {
    [
        folder.after_power_cut(&mut lost),
        folder.after_power_cut(&mut kept),
        folder.after_power_cut(&mut random(seed)),
        folder.after_power_cut(&mut random(!seed)),
    ]
}

#[test]
fn the_script_fills_empties_and_deletes_segments_and_gives_experiences_up() {
    let folder = FaultyFolder::default();
    let life = live(&folder, INTERVAL, &script());
    assert!(life.failure.is_none());
    let map = life.map.unwrap();
    let learnt = script().iter().filter(|step| matches!(step, Found | Learn { .. })).count() + 2;
    assert_eq!(map.experiences_ever() as usize, learnt);
    assert!(map.experiences().count() < learnt, "nothing was given up");
    let names = folder.names().unwrap();
    assert!(!names.iter().any(|name| name == "journal-000001.loci"), "{names:?}");
    // Before everything was written again on request.
    let folder = FaultyFolder::default();
    let before = script().iter().position(|step| matches!(step, Compact)).unwrap();
    live(&folder, INTERVAL, &script()[..before]);
    let names = folder.names().unwrap();
    assert!(!names.iter().any(|name| name == "journal-000001.loci"), "{names:?}");
}

/// Lives through the script once for each of its operations, at which `fail` has the folder fail, and has `check` look
/// at that life beside the states of the whole one.
fn at_every_operation(
    durability: Durability,
    fail: impl Fn(&FaultyFolder, u64),
    check: impl Fn(u64, FaultyFolder, Life, &[Facts]),
) {
    let script = script();
    let whole = FaultyFolder::default();
    let Life { states, .. } = live(&whole, durability, &script);
    assert_eq!(states.len(), script.len() + 1);
    for operation in 0..whole.operations() {
        let folder = FaultyFolder::default();
        fail(&folder, operation);
        let life = live(&folder, durability, &script);
        check(operation, folder, life, &states);
    }
}

#[test]
fn wherever_power_is_cut_nothing_that_was_acknowledged_is_lost() {
    for durability in [Durability::Every, INTERVAL] {
        at_every_operation(durability, FaultyFolder::cut_power_at, |operation, folder, life, states| {
            assert!(life.failure.is_some() || life.states.len() == states.len());
            for left in leftovers(&folder, operation) {
                assert_recovered(&left, durability, &life, states);
            }
        });
    }
}

#[test]
fn power_cut_again_in_the_midst_of_recovery_loses_nothing_either() {
    at_every_operation(INTERVAL, FaultyFolder::cut_power_at, |operation, folder, life, states| {
        let again = || folder.after_power_cut(&mut random(operation));
        let recovered = again();
        drop(open(&recovered, INTERVAL).unwrap());
        for second in 0..recovered.operations() {
            let left = again();
            left.cut_power_at(second);
            assert!(open(&left, INTERVAL).is_err());
            for left in leftovers(&left, second) {
                assert_recovered(&left, INTERVAL, &life, states);
            }
        }
    });
}

#[test]
fn wherever_the_medium_fills_up_the_map_is_read_on_and_nothing_is_lost() {
    for durability in [Durability::Every, INTERVAL] {
        at_every_operation(durability, FaultyFolder::fill_up_at, |operation, folder, life, states| {
            if let Some(map) = &life.map {
                assert_explained(&facts(map), &life, states);
                assert_eq!(map.is_writable(), life.failure.is_none());
            }
            for left in leftovers(&folder, operation) {
                assert_recovered(&left, durability, &life, states);
            }
        });
    }
}

#[test]
fn wherever_an_operation_fails_the_map_is_closed_and_nothing_is_lost() {
    for durability in [Durability::Every, INTERVAL] {
        at_every_operation(durability, FaultyFolder::fail_at, |operation, folder, mut life, states| {
            assert!(life.failure.is_some(), "operation {operation} failed and nobody heard of it");
            assert_eq!(life.states, states[..life.states.len()], "a change that failed was taken for done");
            if let Some(mut map) = life.map.take() {
                assert_explained(&facts(&map), &life, states);
                assert!(!map.is_writable() && learn(&mut map, None, 98, true).is_err());
            }
            for left in
                [folder.after_power_cut(&mut lost), folder.after_power_cut(&mut random(operation)), folder]
            {
                assert_recovered(&left, durability, &life, states);
            }
        });
    }
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let place = || 0..8_u32;
    let step = prop_oneof![
        2 => Just(Found),
        12 => (place(), any::<bool>()).prop_map(|(place, is_keyframe)| Learn { place, is_keyframe }),
        1 => place().prop_map(Name),
        1 => (place(), place()).prop_map(|(from, into)| Merge(from, into)),
        1 => place().prop_map(Split),
        2 => (0..40_u32).prop_map(Renew),
        1 => Just(Sync),
        1 => Just(Background),
        1 => Just(Close),
        1 => Just(Compact),
        1 => Just(Reopen),
    ];
    proptest::collection::vec(step, 1..60).prop_map(|steps| std::iter::once(Found).chain(steps).collect())
}

proptest! {
    #[test]
    fn whatever_was_done_and_wherever_power_is_cut_nothing_that_was_acknowledged_is_lost(
        script in steps(),
        is_every: bool,
        cut in any::<prop::sample::Index>(),
        seed: u64,
    ) {
        let durability = if is_every { Durability::Every } else { INTERVAL };
        let whole = FaultyFolder::default();
        let Life { states, failure, .. } = live(&whole, durability, &script);
        prop_assert!(failure.is_none());
        let folder = FaultyFolder::default();
        folder.cut_power_at(cut.index(whole.operations() as usize) as u64);
        let life = live(&folder, durability, &script);
        for left in leftovers(&folder, seed) {
            assert_recovered(&left, durability, &life, &states);
        }
    }
}

/// A map of twelve places in several segments, with a record of an experience damaged in the first and in the third;
/// with a snapshot also one that lost its end, and with that the names of places.
fn damaged(has_snapshot: bool) -> FaultyFolder {
    let folder = FaultyFolder::default();
    let mut map = open(&folder, Durability::Every).unwrap();
    for place in 0..12 {
        learn(&mut map, None, place, true).unwrap();
    }
    map.sync().unwrap();
    let end = map.journal.end();
    map.name_place(PlaceId(3), "hall").unwrap();
    map.merge_places(PlaceId(5), PlaceId(4)).unwrap();
    map.close().unwrap();
    if has_snapshot {
        let file = folder.open(&segment_name(end.segment), true).unwrap();
        file.truncate(end.offset).and_then(|()| file.sync()).unwrap();
    }
    let locations = [1, 8].map(|id| map.location(ExperienceId(id)).unwrap());
    drop(map);
    for location in locations {
        let file = folder.open(&segment_name(location.segment()), true).unwrap();
        let mut bytes = vec![0; file.length_bytes().unwrap() as usize];
        file.read_at(0, &mut bytes).unwrap();
        bytes[location.offset() as usize + 30] ^= 1;
        file.truncate(0).and_then(|()| file.append(&bytes)).and_then(|()| file.sync()).unwrap();
    }
    if !has_snapshot {
        folder.remove(snapshot::NAME).and_then(|()| folder.sync()).unwrap();
    }
    folder
}

fn repair(folder: &FaultyFolder) -> Result<PlaceMap, MapError> {
    let mut map = PlaceMap::salvage(Arc::new(folder.clone()), Some(options(Durability::Every)), None)?;
    map.compact().map(|()| map)
}

#[test]
fn wherever_power_is_cut_in_a_repair_the_next_one_ends_it() {
    for has_snapshot in [false, true] {
        let whole = damaged(has_snapshot);
        let first = whole.operations();
        let repaired = facts(&repair(&whole).unwrap());
        assert_eq!(repaired.len(), 12 + 10);
        assert!(
            repaired["PlaceId(3)"].contains("hall") && repaired["PlaceId(5)"].contains("Some(PlaceId(4))")
        );
        for operation in first..whole.operations() {
            let folder = damaged(has_snapshot);
            folder.cut_power_at(operation);
            assert!(repair(&folder).is_err());
            for left in leftovers(&folder, operation) {
                assert_eq!(facts(&repair(&left).unwrap()), repaired, "cut at {operation}");
                assert_eq!(facts(&open(&left, Durability::Every).unwrap()), repaired);
            }
        }
    }
}
