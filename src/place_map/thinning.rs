//! Which experience of a place tells least: one of the two that are most alike in light and view.
//!
//! A place that was merged from several may be taken apart again, so each of them keeps what it is recognised by,
//! until the merge has stood for so long that it is final: else a robot that drives for ever would fill its map with
//! halves.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use super::contents::Contents;
use super::{Experience, ExperienceId, Place, PlaceId};

/// Difference in mean luminance, of 255, that counts as much as a view of which every bit differs.
const LIGHT_SPAN: f32 = 64.0;
/// Bits of a view.
const VIEW_BITS: f32 = 64.0;

/// Experiences after which a merge that was not undone is final; at three a second, nine hours.
const FINAL_AFTER: u32 = 100_000;

/// What is compared of an experience.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Glimpse {
    pub(super) id: ExperienceId,
    /// The place that it was learnt as; once a merge is final, what that is by now.
    pub(super) half: PlaceId,
    pub(super) view: u64,
    pub(super) mean_luminance: Option<f32>,
    pub(super) is_keyframe: bool,
}

impl Glimpse {
    /// How far apart two experiences are in light and view; 0 for the same.
    fn difference(&self, other: &Self) -> f32 {
        let view = (self.view ^ other.view).count_ones() as f32 / VIEW_BITS;
        let light = self.mean_luminance.zip(other.mean_luminance).map_or(0.0, |(a, b)| (a - b).abs());
        view + light / LIGHT_SPAN
    }
}

/// The one that tells least among `glimpses`, which are in the order of their numbers: of the two that are most alike
/// the one that is no keyframe, else the younger; but never the last keyframe, or the last of all, of a half. `None`
/// where there is no such.
pub(super) fn least_telling(glimpses: &[Glimpse]) -> Option<ExperienceId> {
    let mut counts: BTreeMap<(PlaceId, bool), usize> = BTreeMap::new();
    for glimpse in glimpses {
        *counts.entry((glimpse.half, glimpse.is_keyframe)).or_default() += 1;
    }
    let count =
        |glimpse: &Glimpse, is_keyframe| counts.get(&(glimpse.half, is_keyframe)).copied().unwrap_or(0);
    let is_spare = |glimpse: &&Glimpse| match glimpse.is_keyframe {
        true => count(glimpse, true) > 1,
        false => count(glimpse, true) + count(glimpse, false) > 1,
    };
    let mut least: Option<(f32, ExperienceId)> = None;
    for (index, younger) in glimpses.iter().enumerate() {
        for older in &glimpses[..index] {
            let difference = older.difference(younger);
            if least.is_none_or(|(known, _)| difference < known) {
                let first = if younger.is_keyframe && !older.is_keyframe { older } else { younger };
                let spare = [first, younger, older].into_iter().find(is_spare);
                least = spare.map(|spare| (difference, spare.id)).or(least);
            }
        }
    }
    least.map(|(_, id)| id)
}

/// The one that tells least in the place that has most experiences and some to spare; `None` if no place has.
pub(super) fn least_telling_of_all(contents: &Contents) -> Option<ExperienceId> {
    let least = |place: &Place| least_telling(&glimpses(contents, place));
    let fullest = contents.places.values().max_by_key(|place| place.experiences.len())?;
    least(fullest).or_else(|| {
        let mut places: Vec<&Place> = contents.places.values().collect();
        places.sort_by_key(|place| Reverse(place.experiences.len()));
        places.into_iter().take_while(|place| place.experiences.len() > 1).find_map(least)
    })
}

/// The experiences of `place`.
pub(super) fn glimpses(contents: &Contents, place: &Place) -> Vec<Glimpse> {
    let experiences = || place.experiences.iter().filter_map(|id| contents.experiences.get(id));
    // A place that was merged learns nothing more: what it learnt last says how old the merge is at least.
    let latest: BTreeMap<PlaceId, ExperienceId> = experiences().map(|e| (e.learnt_as, e.id)).collect();
    let half = |learnt_as: PlaceId| match contents.next_experience.saturating_sub(latest[&learnt_as].0) {
        age if age > FINAL_AFTER => place.id,
        _ => learnt_as,
    };
    let glimpse = |&Experience { id, learnt_as, view, mean_luminance, is_keyframe, .. }: &Experience| {
        Glimpse { id, half: half(learnt_as), view, mean_luminance, is_keyframe }
    };
    experiences().map(glimpse).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place_map::PlaceMap;
    use crate::place_map::tests::{SMALL, found};

    fn glimpse(id: u32, view: u64, mean_luminance: f32, is_keyframe: bool) -> Glimpse {
        Glimpse {
            id: ExperienceId(id),
            half: PlaceId(0),
            view,
            mean_luminance: Some(mean_luminance),
            is_keyframe,
        }
    }

    fn thinned_to(mut glimpses: Vec<Glimpse>, count: usize) -> Vec<u32> {
        while glimpses.len() > count {
            let given_up = least_telling(&glimpses).unwrap();
            glimpses.retain(|glimpse| glimpse.id != given_up);
        }
        glimpses.iter().map(|glimpse| glimpse.id.0).collect()
    }

    #[test]
    fn what_differs_most_in_light_and_view_is_kept() {
        let by_day = (0..10).map(|id| glimpse(id, 1 << id, 120.0, false));
        let by_night = (10..20).map(|id| glimpse(id, 1 << (id - 10), 20.0, false));
        let elsewhere = (20..30).map(|id| glimpse(id, u64::MAX << (id - 20), 120.0, false));
        let all: Vec<Glimpse> = by_day.chain(by_night).chain(elsewhere).collect();
        assert_eq!(thinned_to(all, 3), [0, 10, 20]);
    }

    #[test]
    fn a_keyframe_outlives_an_experience_that_is_like_it() {
        let alike = [glimpse(0, 0, 100.0, false), glimpse(1, 0, 100.0, true), glimpse(2, 7, 100.0, false)];
        assert_eq!(thinned_to(alike.to_vec(), 2), [1, 2]);
        assert_eq!(thinned_to(alike.to_vec(), 1), [1]);
    }

    #[test]
    fn a_place_that_was_merged_into_another_keeps_a_keyframe_of_its_own() {
        let merged = |id| Glimpse { half: PlaceId(1), ..glimpse(id, 0, 100.0, true) };
        let alike = [glimpse(0, 0, 100.0, true), merged(1), glimpse(2, 0, 100.0, false), merged(3)];
        assert_eq!(thinned_to(alike.to_vec(), 2), [0, 3]);
        assert_eq!(least_telling(&[alike[0], alike[1]]), None, "each is the last of its place");
    }

    #[test]
    fn a_merge_that_stood_for_long_is_final_and_one_that_lost_its_keyframe_is_not_undone() {
        let mut map = PlaceMap::in_memory(SMALL).unwrap();
        let (dock, hall) = (found(&mut map, 0), found(&mut map, 1));
        map.merge_places(hall, dock).unwrap();
        let halves = |map: &PlaceMap| {
            let glimpses = glimpses(&map.contents, map.place(hall).unwrap());
            glimpses.iter().map(|glimpse| glimpse.half).collect::<Vec<_>>()
        };
        assert_eq!(halves(&map), [dock, hall]);
        map.contents.next_experience += FINAL_AFTER - 1;
        assert_eq!(halves(&map), [dock, hall]);
        map.contents.next_experience += 1;
        assert_eq!(halves(&map), [dock, dock]);
        assert!(map.can_be_split(hall));
        map.contents.remove_experience(map.place(hall).unwrap().experiences[1]);
        assert!(!map.can_be_split(hall));
        assert!(map.split_place(hall).unwrap_err().to_string().contains("the merge is final"));
    }

    #[test]
    fn the_last_experience_is_never_given_up() {
        assert_eq!(least_telling(&[glimpse(0, 0, 100.0, true)]), None);
        assert_eq!(least_telling(&[]), None);
    }
}
