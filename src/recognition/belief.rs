//! Where the robot is by all that it has seen: a discrete Bayes filter over the places of the map and one that is not
//! in it (Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, chapter 8; Angeli et al., "Fast and incremental
//! method for loop-closure detection using bags of visual words", T-RO 2008).
//!
//! From one frame to the next the robot stays, goes on to a place next to its own or the one behind that, or turns up
//! anywhere, whatever its speed: what it sees decides between these. Only places that stand out are kept, so a frame
//! costs as much in a large map as in a small one.

use heapless::Vec as FixedVec;

use super::by_place::ByPlace;
use crate::place_map::{MAX_NEIGHBOURS, PlaceId, PlaceMap};

/// Probability to be where the frame before was.
const STAYS: f32 = 0.8;
/// Probability to be in a place next to it, and in one behind that. What is left is to be anywhere.
const GOES_ON: [f32; 2] = [0.12, 0.06];
/// Share of anywhere that is not in the map.
const UNMAPPED: f32 = 0.8;
/// Probability that a place that was just founded is a new one.
const FOUNDED: f32 = 0.5;
/// By how much a place becomes less likely of which nothing was found in a frame.
const NOT_FOUND: f32 = 0.05;
/// Log odds that one frame says at most, so that a few others may outweigh it.
const MOST_LOG_ODDS: f32 = 20.0;
/// Among how many places the mapped share of anywhere is parted. Not among all: the log odds of a place were fitted
/// where it is the best of a search, so it has been paid for already that it was found among many.
const FOUND: f32 = 16.0;
/// Places that are kept.
const KEPT: usize = 32;

/// Where the robot is.
#[derive(Clone, Debug)]
pub(super) struct Belief {
    /// Probability of the places that stand out.
    places: ByPlace<f32>,
    /// Of anywhere else, in the map or not.
    elsewhere: f32,
}

/// Where the robot is expected before a frame is looked at.
#[derive(Clone, Debug)]
pub(super) struct Expectation {
    places: ByPlace<f32>,
    /// Of any other place that is found in the frame.
    other: f32,
    unmapped: f32,
}

impl Default for Belief {
    /// Anywhere.
    fn default() -> Self {
        Self { places: ByPlace::default(), elsewhere: 1.0 }
    }
}

impl Default for Expectation {
    /// Nothing is known: every place is as likely as to be in none.
    fn default() -> Self {
        Self { places: ByPlace::default(), other: 0.5, unmapped: 0.5 }
    }
}

impl Belief {
    /// Writes over `expected` where the next frame is expected to be taken.
    pub(super) fn expect(&self, map: &PlaceMap, expected: &mut Expectation) {
        let Expectation { places, other, unmapped } = expected;
        places.clear();
        let mut anywhere = self.elsewhere;
        let mut expect = |place: PlaceId, share: f32| *places.entry(place, 0.0) += share;
        for (place, share) in self.places.iter() {
            let Some(place) = map.place(place).map(|place| place.id) else {
                anywhere += share;
                continue;
            };
            let next = neighbours(map, place);
            expect(place, share * STAYS);
            anywhere += share * (1.0 - STAYS - GOES_ON[0] - GOES_ON[1]);
            if next.is_empty() {
                anywhere += share * (GOES_ON[0] + GOES_ON[1]);
            }
            for &one in &next {
                let part = share / next.len() as f32;
                expect(one, part * GOES_ON[0]);
                let mut ends = neighbours(map, one);
                ends.retain(|&two| two != place);
                if ends.is_empty() {
                    // At the end of the way it stays there; the list has room.
                    let _ = ends.push(one);
                }
                ends.iter().for_each(|&two| expect(two, part * GOES_ON[1] / ends.len() as f32));
            }
        }
        *other = anywhere * (1.0 - UNMAPPED) / FOUND;
        *unmapped = anywhere * UNMAPPED;
    }

    fn keep_what_stands_out(&mut self) {
        let likeliest_first =
            |a: &(PlaceId, f32), b: &(PlaceId, f32)| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0));
        let Self { places, elsewhere } = self;
        places.keep_first(KEPT, likeliest_first, |left_out| {
            *elsewhere += left_out.iter().map(|(_, share)| share).sum::<f32>();
        });
    }

    /// The robot has just founded the place, or has not recognised where it is.
    pub(super) fn after_founding(place: PlaceId) -> Self {
        Self { places: ByPlace::from_iter([(place, FOUNDED)]), elsewhere: 1.0 - FOUNDED }
    }

    /// Probability of a place, with those next to it, which show much the same; 0 if one of these is likelier and
    /// `may_be` the right one.
    pub(super) fn around(&self, place: PlaceId, map: &PlaceMap, may_be: impl Fn(PlaceId) -> bool) -> f32 {
        let next = neighbours(map, place);
        if next.iter().any(|&id| self.of(id) > self.of(place) && may_be(id)) {
            return 0.0;
        }
        self.of(place) + next.iter().map(|&id| self.of(id)).sum::<f32>()
    }

    /// The places that stand out, with their probabilities.
    pub(super) fn places(&self) -> impl Iterator<Item = (PlaceId, f32)> {
        self.places.iter()
    }

    /// Probability of a place.
    pub(super) fn of(&self, place: PlaceId) -> f32 {
        self.places.get(place).unwrap_or_default()
    }

    /// Probability to be in none of the places that stand out.
    pub(super) fn of_elsewhere(&self) -> f32 {
        self.elsewhere
    }
}

impl Expectation {
    /// Writes over `belief` what is believed once the frame has said so of places; of those of which it says nothing,
    /// nothing was found.
    pub(super) fn see(&self, log_odds: &ByPlace<f32>, belief: &mut Belief) {
        let odds = |said: f32| said.clamp(-MOST_LOG_ODDS, MOST_LOG_ODDS).exp();
        let places = &mut belief.places;
        places.clear();
        log_odds.iter().for_each(|(place, said)| places.set(place, self.of(place) * odds(said)));
        for (place, share) in self.places.iter() {
            places.entry(place, share * NOT_FOUND);
        }
        let sum = places.iter().map(|(_, share)| share).sum::<f32>() + self.unmapped;
        places.values_mut().for_each(|share| *share /= sum);
        belief.elsewhere = self.unmapped / sum;
        belief.keep_what_stands_out();
    }

    /// The places that the robot may be in because it was in one of the places that stood out.
    pub(super) fn places(&self) -> impl Iterator<Item = PlaceId> {
        self.places.iter().map(|(place, _)| place)
    }

    /// Probability to be in none of the map.
    pub(super) fn of_elsewhere(&self) -> f32 {
        self.unmapped
    }

    /// Probability to be in a place because of where the robot was.
    pub(super) fn share(&self, place: PlaceId) -> f32 {
        self.places.get(place).unwrap_or_default()
    }

    /// Probability of a place, if it is found in the frame.
    pub(super) fn of(&self, place: PlaceId) -> f32 {
        self.share(place) + self.other
    }
}

/// The places next to one.
pub(super) type Neighbours = FixedVec<PlaceId, MAX_NEIGHBOURS>;

/// The places next to one along the ways that the robot went, each once, in their order.
pub(super) fn neighbours(map: &PlaceMap, place: PlaceId) -> Neighbours {
    let ids = map.place(place).into_iter().flat_map(|place| &place.neighbours);
    let living = ids.filter_map(|&id| map.place(id)).map(|place| place.id).filter(|&id| id != place);
    let mut neighbours = Neighbours::new();
    for id in living {
        if let Err(position) = neighbours.binary_search(&id) {
            // Maps know no more of a place.
            let _ = neighbours.insert(position, id);
        }
    }
    neighbours
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::world_for_tests::in_memory;
    use super::*;
    use crate::feature::Features;
    use crate::frame::Frame;
    use crate::place_map::{NewExperience, Traits};

    /// A map of so many places, founded one after the other along a way.
    fn way(places: u32) -> PlaceMap {
        let mut map = in_memory();
        for index in 0..u64::from(places) {
            let frame = Frame::numbered(index);
            let new = NewExperience {
                frame: &frame,
                view: index,
                mean_luminance: 100.0,
                thumbnail_jpeg: &[],
                keyframe: Some((&Features::default(), &Traits::default())),
            };
            map.learn(None, &new).unwrap();
        }
        map
    }

    fn at(place: u32) -> Belief {
        Belief { places: ByPlace::from_iter([(PlaceId(place), 1.0)]), elsewhere: 0.0 }
    }

    fn expectation(belief: &Belief, map: &PlaceMap) -> Expectation {
        let mut expected = Expectation::default();
        belief.expect(map, &mut expected);
        expected
    }

    fn seeing(expected: &Expectation, log_odds: &[(u32, f32)]) -> Belief {
        let mut belief = Belief::default();
        expected.see(&said(log_odds), &mut belief);
        belief
    }

    fn said(log_odds: &[(u32, f32)]) -> ByPlace<f32> {
        log_odds.iter().map(|&(place, said)| (PlaceId(place), said)).collect()
    }

    #[test]
    fn one_doubtful_frame_does_not_move_a_robot_and_two_good_ones_carry_it_anywhere() {
        let map = way(40);
        let at = at(7);
        let doubtful = seeing(&expectation(&at, &map), &[(7, 0.0), (30, 1.0)]);
        assert!(doubtful.of(PlaceId(7)) > 0.8, "{doubtful:?}");
        let carried = seeing(&expectation(&at, &map), &[(7, -2.0), (30, 5.0)]);
        let carried = seeing(&expectation(&carried, &map), &[(30, 5.0)]);
        assert!(carried.of(PlaceId(30)) > 0.9, "{carried:?}");
    }

    #[test]
    fn a_robot_that_goes_on_is_expected_in_the_next_place_and_at_the_end_of_the_way_stays() {
        let map = way(6);
        let expected = expectation(&at(2), &map);
        let [stays, next, behind, far] = [2, 3, 4, 5].map(|place| expected.of(PlaceId(place)));
        assert!(stays > next && next > behind && behind > 3.0 * far, "{expected:?}");
        assert_eq!(expected.of(PlaceId(1)), next);
        let expected = expectation(&at(0), &map);
        assert!(expected.of(PlaceId(1)) > next, "there is no other way to go");
    }

    #[test]
    fn a_robot_that_sees_nothing_it_knows_is_soon_believed_elsewhere() {
        let map = way(6);
        let mut belief = at(2);
        for _ in 0..3 {
            belief = seeing(&expectation(&belief, &map), &[(2, -3.0), (4, -3.0)]);
        }
        assert!(belief.of_elsewhere() > 0.9, "{belief:?}");
    }

    #[test]
    fn a_frame_by_itself_makes_a_place_as_likely_as_its_odds_say() {
        let alone = seeing(&Expectation::default(), &[(3, 2.0), (5, -4.0)]);
        assert!((alone.of(PlaceId(3)) - 0.88).abs() < 0.01 && alone.of(PlaceId(5)) < 0.02, "{alone:?}");
        let torn = seeing(&Expectation::default(), &[(3, 6.0), (5, 6.0)]);
        assert!((torn.of(PlaceId(3)) - 0.5).abs() < 0.01 && torn.of_elsewhere() < 0.01, "{torn:?}");
        assert_eq!(seeing(&Expectation::default(), &[]).of_elsewhere(), 1.0);
    }

    #[test]
    fn a_place_that_is_gone_is_anywhere() {
        let map = way(2);
        let expected = expectation(&at(9), &map);
        assert_eq!(expected.of(PlaceId(0)), expected.of(PlaceId(1)));
        assert!((expected.unmapped - UNMAPPED).abs() < 1e-6);
    }

    /// The same over all places at once, without leaving any out.
    fn naive(places: usize, before: &[f64], log_odds: &ByPlace<f32>) -> Vec<f64> {
        let mut expected = vec![0.0; places];
        let mut anywhere = before[places];
        let next = |place: usize| {
            let left = place.checked_sub(1);
            left.into_iter().chain((place + 1 < places).then_some(place + 1)).collect::<Vec<_>>()
        };
        let [one, two] = GOES_ON.map(f64::from);
        let stays = f64::from(STAYS);
        for place in 0..places {
            expected[place] += before[place] * stays;
            anywhere += before[place] * (1.0 - stays - one - two);
            if next(place).is_empty() {
                anywhere += before[place] * (one + two);
            }
            for &neighbour in &next(place) {
                let part = before[place] / next(place).len() as f64;
                expected[neighbour] += part * one;
                let behind: Vec<usize> =
                    next(neighbour).into_iter().filter(|&other| other != place).collect();
                let ends = if behind.is_empty() { vec![neighbour] } else { behind };
                ends.iter().for_each(|&end| expected[end] += part * two / ends.len() as f64);
            }
        }
        let unmapped = f64::from(UNMAPPED);
        let mut after: Vec<f64> = (0..places)
            .map(|place| {
                let found = anywhere * (1.0 - unmapped) / f64::from(FOUND);
                let odds = log_odds.get(PlaceId(place as u32)).map(|said| f64::from(said).exp());
                odds.map_or(expected[place] * f64::from(NOT_FOUND), |odds| (expected[place] + found) * odds)
            })
            .collect();
        after.push(anywhere * unmapped);
        let sum: f64 = after.iter().sum();
        after.iter().map(|share| share / sum).collect()
    }

    proptest! {
        #[test]
        fn belief_is_what_bayes_rule_says_over_all_places_at_once(
            places in 1_u32..9,
            frames in prop::collection::vec(prop::collection::vec((0_u32..9, -6.0_f32..6.0), 0..5), 1..6),
        ) {
            let map = way(places);
            let mut belief = Belief::default();
            let mut expected = vec![0.0; places as usize + 1];
            expected[places as usize] = 1.0;
            for frame in frames {
                let frame: Vec<_> = frame.into_iter().filter(|said| said.0 < places).collect();
                belief = seeing(&expectation(&belief, &map), &frame);
                expected = naive(places as usize, &expected, &said(&frame));
                for place in 0..places {
                    let got = f64::from(belief.of(PlaceId(place)));
                    // A place that was never said anything of is part of elsewhere.
                    let is_kept = belief.places.get(PlaceId(place)).is_some();
                    prop_assert!(!is_kept || (got - expected[place as usize]).abs() < 1e-4, "{belief:?} {expected:?}");
                }
                let sum = belief.places.iter().map(|(_, share)| share).sum::<f32>() + belief.elsewhere;
                prop_assert!((sum - 1.0).abs() < 1e-4 && belief.places.len() <= KEPT);
                // What is not kept apart counts as anywhere from then on.
                let kept = |place: usize| belief.places.get(PlaceId(place as u32));
                expected = (0..places as usize).map(|place| kept(place).map_or(0.0, f64::from)).collect();
                expected.push(f64::from(belief.elsewhere));
            }
        }
    }
}
