//! Power cut, a medium that fills up, and operations that fail, at every operation of a map's scripted life and at
//! random ones of random lives: whatever was acknowledged is found again, and nothing is found that never was.
//!
//! [`crate::storage::faulty`] says what a power cut may leave of what was not synced.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::tests::{features, frame, traits};
use super::{Durability, Learnt, MapError, MapOptions, NewExperience, PlaceId, PlaceMap, snapshot};
use crate::storage::Folder;
use crate::storage::faulty::FaultyFolder;

/// Three experiences fill a segment of 64 KiB, and twenty the whole budget.
const THUMBNAIL_BYTES: usize = 20_000;
const BUDGET_BYTES: u64 = 512 << 10;
/// Syncs of its own the map does where a segment ends alone, since nothing here waits.
const INTERVAL: Durability = Durability::Interval(Duration::from_secs(1));

/// What is done to a map.
#[derive(Clone, Copy, Debug)]
enum Step {
    /// Founds a place.
    Found,
    Learn {
        place: u32,
        is_keyframe: bool,
    },
    Name(u32),
    Merge(u32, u32),
    Split(u32),
    Sync,
    /// What the thread that looks after durability does.
    Background,
    /// Takes in another map of two places.
    Absorb,
    /// Takes a snapshot.
    Close,
    Compact,
    /// Drops the map and opens it again.
    Reopen,
}

use Step::{Absorb, Background, Close, Compact, Found, Learn, Merge, Name, Reopen, Split, Sync};

/// A life in which segments fill up, are emptied and deleted, and everything else happens once at least.
fn script() -> Vec<Step> {
    let learn = |count: u32| {
        (0..count).map(|index| Learn { place: index * 5 % 4, is_keyframe: index.is_multiple_of(3) })
    };
    let mut script = vec![Found, Found, Background, Found, Name(1), Found, Sync];
    script.extend(learn(10));
    script.extend([Merge(2, 0), Close, Name(2), Found]);
    script.extend(learn(12));
    script.extend([Background, Split(2), Reopen]);
    script.extend(learn(9));
    script.extend([Compact, Merge(4, 1), Absorb, Background]);
    script.extend(learn(5));
    script.push(Sync);
    script
}

fn options(durability: Durability) -> MapOptions {
    MapOptions { durability, disk_bytes: BUDGET_BYTES, place_experiences: 100 }
}

fn open(folder: &FaultyFolder, durability: Durability) -> Result<PlaceMap, MapError> {
    PlaceMap::open_folder(Arc::new(folder.clone()), Some(options(durability)), None)
}

fn learn(
    map: &mut PlaceMap,
    place: Option<PlaceId>,
    index: u64,
    is_keyframe: bool,
) -> Result<Learnt, MapError> {
    let (features, traits) = (features(index), traits(index));
    let new = NewExperience {
        frame: &frame(index),
        view: index.wrapping_mul(0x9e37_79b9_7f4a_7c15),
        mean_luminance: (index * 37 % 256) as f32,
        thumbnail_jpeg: &[index as u8; THUMBNAIL_BYTES],
        keyframe: is_keyframe.then_some((&features, &traits)),
    };
    map.learn(place, &new)
}

/// Everything that a map knows, by what it is about, read back to the last byte.
type Facts = BTreeMap<String, String>;

fn facts(map: &PlaceMap) -> Facts {
    let mut facts = Facts::new();
    for place in map.places() {
        let fact = format!("{:?} {:?} {:?}", place.name, place.merged_into, place.neighbours);
        facts.insert(format!("{:?}", place.id), fact);
        assert!(place.experiences.iter().all(|&id| map.experience(id).is_some()));
    }
    for experience in map.experiences() {
        let id = experience.id;
        let mut fact = format!("{:?} {:?}", experience.learnt_as, map.origin(id).unwrap());
        if experience.is_keyframe {
            let keypoints = map.features(id).unwrap().keypoints.len();
            write!(fact, " {keypoints} {:?}", map.traits(id).unwrap()).unwrap();
        }
        let jpeg = map.thumbnail_jpeg(id).unwrap();
        assert!(jpeg.len() == THUMBNAIL_BYTES && jpeg.iter().all(|&byte| byte == jpeg[0]));
        write!(fact, " {}", jpeg[0]).unwrap();
        facts.insert(format!("{id:?}"), fact);
    }
    facts
}

/// A map's life up to where something failed.
struct Life {
    /// What it knew after so many steps.
    states: Vec<Facts>,
    /// After so many steps everything was on the medium for certain.
    certain: usize,
    /// The map, still open, if it could be opened.
    map: Option<PlaceMap>,
    /// What failed.
    failure: Option<MapError>,
}

impl Life {
    fn steps(&self) -> usize {
        self.states.len().saturating_sub(1)
    }
}

/// Lives through `script`.
fn live(folder: &FaultyFolder, durability: Durability, script: &[Step]) -> Life {
    let mut life = Life { states: Vec::new(), certain: 0, map: None, failure: None };
    match open(folder, durability) {
        Ok(map) => {
            life.states.push(facts_of(folder, &map));
            life.map = Some(map);
        }
        Err(error) => life.failure = Some(error),
    }
    for (index, &step) in script.iter().enumerate() {
        if life.failure.is_some() {
            break;
        }
        match take_step(&mut life.map, folder, durability, (index as u64, step)) {
            Ok(()) => {
                life.states.extend(life.map.as_ref().map(|map| facts_of(folder, map)));
                if durability == Durability::Every || matches!(step, Sync | Close | Compact | Reopen) {
                    life.certain = index + 1;
                }
            }
            Err(error) => life.failure = Some(error),
        }
    }
    life
}

/// Facts, or none of a folder whose power is cut: nothing can be read there.
fn facts_of(folder: &FaultyFolder, map: &PlaceMap) -> Facts {
    if folder.names().is_ok() { facts(map) } else { Facts::new() }
}

/// Does `step` to the open map. What it refuses for good reason counts as done.
fn take_step(
    open_map: &mut Option<PlaceMap>,
    folder: &FaultyFolder,
    durability: Durability,
    (index, step): (u64, Step),
) -> Result<(), MapError> {
    if matches!(step, Reopen) {
        *open_map = None;
        *open_map = Some(open(folder, durability)?);
        return Ok(());
    }
    let map = open_map.as_mut().expect("an open map");
    let places = map.places().len() as u32;
    let known = |place: u32| PlaceId(place % places);
    let done = match step {
        Found => learn(map, None, index, true).map(drop),
        Learn { place, is_keyframe } => learn(map, Some(known(place)), index, is_keyframe).map(drop),
        Name(place) => map.name_place(known(place), &format!("name {index}")),
        Merge(from, into) => map.merge_places(known(from), known(into)),
        Split(place) => map.split_place(known(place)),
        Sync => map.sync(),
        Background => {
            map.syncer().sync();
            Ok(())
        }
        Absorb => map.absorb(&other_map(index), &AtomicBool::new(false)).map(drop),
        Close => map.close(),
        Compact => map.compact(),
        Reopen => Ok(()),
    };
    if map.is_writable() { Ok(()) } else { done }
}

/// A map of two places, to be absorbed.
fn other_map(index: u64) -> PlaceMap {
    let mut other = PlaceMap::in_memory(options(Durability::None)).unwrap();
    for place in 0..2 {
        learn(&mut other, None, index + place, true).unwrap();
    }
    other
}

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

#[test]
fn wherever_power_is_cut_nothing_that_was_acknowledged_is_lost() {
    let script = script();
    for durability in [Durability::Every, INTERVAL] {
        let whole = FaultyFolder::default();
        let Life { states, .. } = live(&whole, durability, &script);
        assert_eq!(states.len(), script.len() + 1);
        for operation in 0..whole.operations() {
            let folder = FaultyFolder::default();
            folder.cut_power_at(operation);
            let life = live(&folder, durability, &script);
            assert!(life.failure.is_some() || life.steps() == script.len());
            for left in leftovers(&folder, operation) {
                assert_recovered(&left, durability, &life, &states);
            }
        }
    }
}

#[test]
fn power_cut_again_in_the_midst_of_recovery_loses_nothing_either() {
    let script = script();
    let whole = FaultyFolder::default();
    let Life { states, .. } = live(&whole, INTERVAL, &script);
    for operation in 0..whole.operations() {
        let folder = FaultyFolder::default();
        folder.cut_power_at(operation);
        let life = live(&folder, INTERVAL, &script);
        let again = || folder.after_power_cut(&mut random(operation));
        let recovered = again();
        drop(open(&recovered, INTERVAL).unwrap());
        for second in 0..recovered.operations() {
            let left = again();
            left.cut_power_at(second);
            assert!(open(&left, INTERVAL).is_err());
            for left in leftovers(&left, second) {
                assert_recovered(&left, INTERVAL, &life, &states);
            }
        }
    }
}

#[test]
fn wherever_the_medium_fills_up_the_map_is_read_on_and_nothing_is_lost() {
    let script = script();
    for durability in [Durability::Every, INTERVAL] {
        let whole = FaultyFolder::default();
        let Life { states, .. } = live(&whole, durability, &script);
        for operation in 0..whole.operations() {
            let folder = FaultyFolder::default();
            folder.fill_up_at(operation);
            let life = live(&folder, durability, &script);
            if let Some(map) = &life.map {
                assert_explained(&facts(map), &life, &states);
                assert_eq!(map.is_writable(), life.failure.is_none());
            }
            for left in leftovers(&folder, operation) {
                assert_recovered(&left, durability, &life, &states);
            }
        }
    }
}

#[test]
fn wherever_an_operation_fails_the_map_is_closed_and_nothing_is_lost() {
    let script = script();
    for durability in [Durability::Every, INTERVAL] {
        let whole = FaultyFolder::default();
        let Life { states, .. } = live(&whole, durability, &script);
        for operation in 0..whole.operations() {
            let folder = FaultyFolder::default();
            folder.fail_at(operation);
            let mut life = live(&folder, durability, &script);
            assert!(life.failure.is_some(), "operation {operation} failed and nobody heard of it");
            assert_eq!(life.states, states[..life.states.len()], "a change that failed was taken for done");
            if let Some(mut map) = life.map.take() {
                assert_explained(&facts(&map), &life, &states);
                assert!(!map.is_writable() && learn(&mut map, None, 98, true).is_err());
            }
            for left in
                [folder.after_power_cut(&mut lost), folder.after_power_cut(&mut random(operation)), folder]
            {
                assert_recovered(&left, durability, &life, &states);
            }
        }
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
