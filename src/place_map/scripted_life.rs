//! A map's life by a script, on a folder that may fail: what it knew after each step, and what was certain by then.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::tests::learn_with;
use super::{Appearance, Durability, ExperienceId, Learnt, MapError, MapOptions, PlaceId, PlaceMap};
use crate::cnn::CompactDescriptor;
use crate::storage::Folder;
use crate::storage::faulty::FaultyFolder;

/// Three experiences fill a segment of 64 KiB, and twenty the whole budget.
const THUMBNAIL_BYTES: usize = 20_000;
const BUDGET_BYTES: u64 = 512 << 10;
/// Syncs of its own the map does where a segment ends alone, since nothing here waits.
pub(super) const INTERVAL: Durability = Durability::Interval(Duration::from_secs(1));

/// What is done to a map.
#[derive(Clone, Copy, Debug)]
pub(super) enum Step {
    /// Founds a place.
    Found,
    Learn {
        place: u32,
        is_keyframe: bool,
    },
    Name(u32),
    Merge(u32, u32),
    Split(u32),
    /// Computes the CNN descriptors of two experiences anew.
    Renew(u32),
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

use Step::{Absorb, Background, Close, Compact, Found, Learn, Merge, Name, Renew, Reopen, Split, Sync};

/// A life in which segments fill up, are emptied and deleted, and everything else happens once at least.
pub(super) fn script() -> Vec<Step> {
    let learn = |count: u32| {
        (0..count).map(|index| Learn { place: index * 5 % 4, is_keyframe: index.is_multiple_of(3) })
    };
    let mut script = vec![Found, Found, Background, Found, Name(1), Found, Sync];
    script.extend(learn(10));
    script.extend([Merge(2, 0), Close, Name(2), Found]);
    script.extend(learn(12));
    script.extend([Background, Renew(3), Split(2), Reopen]);
    script.extend(learn(9));
    script.extend([Compact, Merge(4, 1), Absorb, Background]);
    script.extend(learn(5));
    script.push(Sync);
    script
}

pub(super) fn options(durability: Durability) -> MapOptions {
    MapOptions { durability, disk_bytes: BUDGET_BYTES, place_experiences: 100 }
}

pub(super) fn open(folder: &FaultyFolder, durability: Durability) -> Result<PlaceMap, MapError> {
    PlaceMap::open_folder(Arc::new(folder.clone()), Some(options(durability)), None)
}

pub(super) fn learn(
    map: &mut PlaceMap,
    place: Option<PlaceId>,
    index: u64,
    is_keyframe: bool,
) -> Result<Learnt, MapError> {
    learn_with(map, place, (index, is_keyframe), &[index as u8; THUMBNAIL_BYTES])
}

/// Everything that a map knows, by what it is about, read back to the last byte.
pub(super) type Facts = BTreeMap<String, String>;

pub(super) fn facts(map: &PlaceMap) -> Facts {
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
pub(super) struct Life {
    /// What it knew after so many steps.
    pub(super) states: Vec<Facts>,
    /// After so many steps everything was on the medium for certain.
    pub(super) certain: usize,
    /// The map, still open, if it could be opened.
    pub(super) map: Option<PlaceMap>,
    /// What failed.
    pub(super) failure: Option<MapError>,
}

impl Life {
    pub(super) fn steps(&self) -> usize {
        self.states.len().saturating_sub(1)
    }
}

/// Lives through `script`.
pub(super) fn live(folder: &FaultyFolder, durability: Durability, script: &[Step]) -> Life {
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
                let known = life.map.as_ref().map(|map| facts_of(folder, map));
                // What is computed anew is no answer that somebody was given, and waits for the next change; what is
                // refused changes nothing.
                let is_change = life.states.last() != known.as_ref() && !matches!(step, Renew(_));
                let is_answered = durability == Durability::Every && is_change;
                life.states.extend(known);
                if is_answered || matches!(step, Sync | Close | Compact | Reopen) {
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
        Renew(first) => map.renew_appearances(&renewed(first, index)).map(drop),
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

/// Other descriptors of two experiences, if there are any of those numbers.
fn renewed(first: u32, index: u64) -> [(ExperienceId, Appearance); 2] {
    let descriptor = CompactDescriptor::from_values(vec![100, index as i8, 1]).unwrap();
    let appearance = Appearance { model: "new".to_owned(), descriptor };
    [first, first + 1].map(|id| (ExperienceId(id), appearance.clone()))
}

/// A map of two places, to be absorbed.
fn other_map(index: u64) -> PlaceMap {
    let mut other = PlaceMap::in_memory(options(Durability::None)).unwrap();
    for place in 0..2 {
        learn(&mut other, None, index + place, true).unwrap();
    }
    other
}
