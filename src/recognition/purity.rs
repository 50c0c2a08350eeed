//! How well the keyframes of a place hang together as the CNN sees them: those that are more like a place elsewhere
//! than like any other keyframe of their own are astray.

use std::sync::atomic::{AtomicBool, Ordering};

use super::belief::neighbours;
use super::recogniser::Recogniser;
use crate::place_map::{ExperienceId, MapError, PlaceId};

/// What is said of a place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Purity {
    /// The place.
    pub place: PlaceId,
    /// Its keyframes that the CNN knows; two at least.
    pub keyframes: usize,
    /// Those of them that are astray, each with the place that it is more like.
    pub astray: Vec<(ExperienceId, PlaceId)>,
}

impl Purity {
    /// Share of the keyframes that are not astray.
    #[must_use]
    pub fn share(&self) -> f64 {
        1.0 - self.astray.len() as f64 / self.keyframes as f64
    }
}

impl Recogniser {
    /// The purity of every place of which the CNN knows two keyframes at least, in the order of the places. Places next
    /// to each other share views, so being like one of these is not being astray. All places must be searched. Takes as
    /// many comparisons as there are pairs of keyframes.
    ///
    /// # Errors
    /// If `stop` is set meanwhile.
    pub fn purities(&self, stop: &AtomicBool) -> Result<Vec<Purity>, MapError> {
        let mut purities = Vec::new();
        for place in self.map.living_places() {
            let keyframes: Vec<ExperienceId> = self.keyframes_of(place.id).into_iter().collect();
            let known: Vec<ExperienceId> =
                keyframes.into_iter().filter(|keyframe| self.appearances.contains(*keyframe)).collect();
            if known.len() < 2 {
                continue;
            }
            let next = neighbours(&self.map, place.id);
            let mut astray = Vec::new();
            for &keyframe in &known {
                if stop.load(Ordering::Relaxed) {
                    return Err(MapError::Interrupted);
                }
                let is_elsewhere = |other: PlaceId| !next.contains(&other);
                astray.extend(self.appearances.astray(keyframe, is_elsewhere).map(|other| (keyframe, other)));
            }
            purities.push(Purity { place: place.id, keyframes: known.len(), astray });
        }
        Ok(purities)
    }
}

#[cfg(test)]
mod tests {
    use super::super::world_for_tests::{Robot, card, in_memory, no_interval, place_of};
    use super::*;

    fn never() -> AtomicBool {
        AtomicBool::new(false)
    }

    #[test]
    fn a_keyframe_that_looks_like_a_place_elsewhere_is_astray() {
        let mut map = in_memory();
        let place = place_of(&mut map, &[(1, 1), (1, 5)]);
        for (features, look) in [(2, 2), (3, 3), (4, 4)] {
            place_of(&mut map, &[(features, look)]);
        }
        let elsewhere = place_of(&mut map, &[(5, 5)]);
        let robot = Robot::new(Some(card()), no_interval(), map);
        let astray = vec![(ExperienceId(1), elsewhere)];
        let purities = robot.recogniser.purities(&never()).unwrap();
        assert_eq!(purities, [Purity { place, keyframes: 2, astray }]);
        assert!((purities[0].share() - 0.5).abs() < 1e-9);
    }

    #[test]
    fn a_place_next_to_it_leads_no_keyframe_astray() {
        let mut map = in_memory();
        place_of(&mut map, &[(1, 1), (1, 2)]);
        place_of(&mut map, &[(2, 2)]);
        let robot = Robot::new(Some(card()), no_interval(), map);
        assert_eq!(robot.recogniser.purities(&never()).unwrap()[0].astray, []);
    }

    #[test]
    fn a_place_with_one_keyframe_is_not_judged_and_who_stops_is_obeyed() {
        let mut map = in_memory();
        place_of(&mut map, &[(1, 1)]);
        place_of(&mut map, &[(2, 2), (2, 3)]);
        let robot = Robot::new(Some(card()), no_interval(), map);
        let judged = robot.recogniser.purities(&never()).unwrap();
        assert_eq!(judged.iter().map(|purity| purity.place).collect::<Vec<_>>(), [PlaceId(1)]);
        let stopped = robot.recogniser.purities(&AtomicBool::new(true));
        assert!(matches!(stopped, Err(MapError::Interrupted)));
    }
}
