//! Which places followed which in a run, and which frames strayed.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use crate::place_map::PlaceId;
use crate::recognition::PlaceSketch;

/// Strays that are kept at most: the first ones.
const MOST_STRAYS: usize = 10_000;

/// The places of a run, as far as it was told.
#[derive(Default)]
pub(super) struct Succession {
    places: BTreeMap<PlaceId, Met>,
    /// How often the robot went from one place to another, either way.
    crossings: BTreeMap<(PlaceId, PlaceId), usize>,
    /// Frames that may have strayed, and how many of the crossings are to and from such.
    lone: Vec<Stray>,
    lone_crossings: BTreeMap<(PlaceId, PlaceId), usize>,
    /// The latest frames with their places, the oldest first.
    latest: VecDeque<(u64, Option<PlaceId>)>,
}

/// What is known of a place.
#[derive(Default)]
struct Met {
    name: Option<Arc<str>>,
    experiences: usize,
    neighbours: BTreeSet<PlaceId>,
}

/// A frame that is alone in its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Stray {
    pub(super) frame: u64,
    pub(super) place: PlaceId,
    /// Where the two frames before it were.
    pub(super) before: PlaceId,
    /// Where the two frames after it were.
    pub(super) after: PlaceId,
}

impl Stray {
    fn crossings(&self) -> [(PlaceId, PlaceId); 2] {
        [pair(self.before, self.place), pair(self.place, self.after)]
    }
}

impl Succession {
    /// Takes in what was answered of a frame, and whether it became an experience.
    pub(super) fn add(&mut self, frame: u64, place: Option<(PlaceId, Option<&str>)>, is_experience: bool) {
        let before = self.latest.back().and_then(|(_, before)| *before);
        self.latest.push_back((frame, place.map(|(place, _)| place)));
        self.note_stray();
        let Some((place, name)) = place else { return };
        let met = self.places.entry(place).or_default();
        met.experiences += usize::from(is_experience);
        met.name = name.map(Arc::from).or(met.name.take());
        if let Some(before) = before.filter(|before| *before != place) {
            met.neighbours.insert(before);
            self.places.entry(before).or_default().neighbours.insert(place);
            *self.crossings.entry(pair(before, place)).or_default() += 1;
        }
    }

    /// What comes next does not follow what came before.
    pub(super) fn begin_anew(&mut self) {
        self.latest.clear();
    }

    /// All places, those next to which they were being their neighbours.
    pub(super) fn sketches(&self) -> Vec<PlaceSketch> {
        let sketch = |(&id, met): (&PlaceId, &Met)| {
            let Met { name, experiences, neighbours } = met;
            let neighbours = neighbours.iter().copied().collect();
            PlaceSketch { id, name: name.clone(), experiences: *experiences, neighbours }
        };
        self.places.iter().map(sketch).collect()
    }

    /// The frames that strayed, in their order: alone in their answer, where the robot stayed in a place or went from
    /// one to another as it did at other times, too, and from one of these to the stray's place it went at no other.
    pub(super) fn strays(&self) -> Vec<Stray> {
        let is_known_way = |stray: &Stray| {
            stray.before == stray.after || self.crossings.contains_key(&pair(stray.before, stray.after))
        };
        let is_unheard_of =
            |crossing: &(PlaceId, PlaceId)| self.crossings.get(crossing) == self.lone_crossings.get(crossing);
        let strayed = |stray: &&Stray| is_known_way(stray) && stray.crossings().iter().any(is_unheard_of);
        self.lone.iter().filter(strayed).copied().collect()
    }

    /// Notes the frame in the middle of the latest five, if it is alone between two and two.
    fn note_stray(&mut self) {
        if self.latest.len() > 5 {
            self.latest.pop_front();
        }
        let latest = self.latest.make_contiguous();
        let &mut [(_, Some(before)), (_, second), (frame, Some(place)), (_, Some(after)), (_, fifth)] =
            latest
        else {
            return;
        };
        let are_two = second == Some(before) && fifth == Some(after);
        if !are_two || place == before || place == after {
            return;
        }
        let stray = Stray { frame, place, before, after };
        for crossing in stray.crossings() {
            *self.lone_crossings.entry(crossing).or_default() += 1;
        }
        if self.lone.len() < MOST_STRAYS {
            self.lone.push(stray);
        }
    }
}

/// The smaller number first.
fn pair(one: PlaceId, other: PlaceId) -> (PlaceId, PlaceId) {
    (one.min(other), one.max(other))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A run that was answered so; a dash is unknown.
    fn run(places: &str) -> Succession {
        let mut succession = Succession::default();
        for (frame, place) in (0..).zip(places.chars()) {
            succession.add(frame, place.to_digit(10).map(|place| (PlaceId(place), None)), true);
        }
        succession
    }

    fn strays(places: &str) -> Vec<u64> {
        run(places).strays().iter().map(|stray| stray.frame).collect()
    }

    #[test]
    fn a_frame_strayed_that_was_alone_and_went_where_the_robot_never_went_else() {
        assert_eq!(strays("00011117111222"), [7]);
        assert_eq!(strays("1171171122"), [2, 5]);
        assert_eq!(strays("0001111711122217"), Vec::<u64>::new());
    }

    #[test]
    fn a_frame_strayed_on_a_way_that_is_known_without_it() {
        assert_eq!(strays("00112200711"), [8]);
        // The way is new: the robot may have been there.
        assert_eq!(strays("0071122"), Vec::<u64>::new());
    }

    #[test]
    fn at_the_border_of_two_places_none_strays() {
        assert_eq!(strays("00010011101111"), Vec::<u64>::new());
        assert_eq!(strays("00-00100"), [5]);
        assert_eq!(strays("00-00"), Vec::<u64>::new());
    }

    #[test]
    fn a_place_grows_and_has_those_next_to_it_that_followed_it_or_went_before() {
        let mut succession = run("0012-30");
        succession.add(7, Some((PlaceId(0), Some("dock"))), false);
        succession.begin_anew();
        succession.add(0, Some((PlaceId(8), None)), true);
        let sketches = succession.sketches();
        assert_eq!(sketches.iter().map(|place| place.id.0).collect::<Vec<_>>(), [0, 1, 2, 3, 8]);
        assert_eq!((sketches[0].experiences, sketches[0].name.as_deref()), (3, Some("dock")));
        assert_eq!(sketches[0].neighbours, [1, 3].map(PlaceId));
        assert!(sketches[4].neighbours.is_empty());
    }
}
