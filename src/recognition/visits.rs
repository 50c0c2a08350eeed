//! Stays at places, counted in decided frames: Algorithm 1's interval δ_ep.

use crate::place_map::PlaceId;

struct Visit {
    place: PlaceId,
    began: u64,
    last_seen: u64,
    /// Whether the visit founded the place.
    founded: bool,
}

/// The visits that are not over: their place was seen within the last place interval.
pub(super) struct Visits {
    place_interval: u64,
    frames_decided: u64,
    open: Vec<Visit>,
}

impl Visits {
    pub(super) fn new(place_interval: u32) -> Self {
        Self { place_interval: u64::from(place_interval), frames_decided: 0, open: Vec::new() }
    }

    /// The place of the frame before, if it was founded within the place interval: the next frame joins
    /// it unasked.
    pub(super) fn founded_within_interval(&self) -> Option<PlaceId> {
        let here = self.open.iter().find(|visit| visit.last_seen + 1 == self.frames_decided)?;
        (here.founded && self.is_recent(here.began)).then_some(here.place)
    }

    /// Whether a visit to `place` is younger than the place interval, or begins with the next frame.
    /// Only then may frames become keyframes: otherwise a place would grow along with the robot, each
    /// frame matching the one before.
    pub(super) fn is_young(&self, place: PlaceId) -> bool {
        let visit = self.open.iter().find(|visit| visit.place == place);
        visit.is_none_or(|visit| self.is_recent(visit.began))
    }

    /// From now on visits to `from` are visits to `into`.
    pub(super) fn rename(&mut self, from: PlaceId, into: PlaceId) {
        self.open.iter_mut().filter(|visit| visit.place == from).for_each(|visit| visit.place = into);
    }

    /// Counts a frame that shows `place`; `founded` if it founded it.
    pub(super) fn move_to(&mut self, place: PlaceId, founded: bool) {
        let now = self.frames_decided;
        match self.open.iter_mut().find(|visit| visit.place == place) {
            Some(visit) => visit.last_seen = now,
            None => self.open.push(Visit { place, began: now, last_seen: now, founded }),
        }
        self.frames_decided += 1;
        self.open.retain(|visit| now - visit.last_seen <= self.place_interval);
    }

    /// Whether the next frame lies within the place interval of decided frame `frame`.
    fn is_recent(&self, frame: u64) -> bool {
        self.frames_decided - frame <= self.place_interval
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DOCK: PlaceId = PlaceId(0);
    const HALL: PlaceId = PlaceId(1);

    #[test]
    fn frames_join_a_founded_place_for_one_interval() {
        let mut visits = Visits::new(3);
        assert_eq!(visits.founded_within_interval(), None);
        visits.move_to(DOCK, true);
        for _ in 0..3 {
            assert_eq!(visits.founded_within_interval(), Some(DOCK));
            visits.move_to(DOCK, false);
        }
        assert_eq!(visits.founded_within_interval(), None);
    }

    #[test]
    fn frames_do_not_join_a_place_that_was_known_or_left() {
        let mut visits = Visits::new(3);
        visits.move_to(DOCK, false);
        assert_eq!(visits.founded_within_interval(), None);
        visits.move_to(HALL, true);
        visits.move_to(DOCK, false);
        assert_eq!(visits.founded_within_interval(), None);
    }

    #[test]
    fn a_long_stay_brings_no_keyframes_but_a_return_does() {
        let mut visits = Visits::new(2);
        for _ in 0..3 {
            assert!(visits.is_young(DOCK));
            visits.move_to(DOCK, false);
        }
        assert!(!visits.is_young(DOCK));
        visits.move_to(HALL, true);
        assert!(!visits.is_young(DOCK), "a glance elsewhere ends no visit");
        visits.move_to(HALL, false);
        visits.move_to(HALL, false);
        assert!(visits.is_young(DOCK));
    }

    #[test]
    fn an_interval_of_zero_founds_a_place_a_frame() {
        let mut visits = Visits::new(0);
        visits.move_to(DOCK, true);
        assert_eq!(visits.founded_within_interval(), None);
        assert!(visits.is_young(HALL));
    }
}
