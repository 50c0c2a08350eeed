//! Which experience of a place tells least: one of the two that are most alike in light and view.

use super::contents::Contents;
use super::{Experience, ExperienceId, Place};

/// Difference in mean luminance, of 255, that counts as much as a view of which every bit differs.
const LIGHT_SPAN: f32 = 64.0;
/// Bits of a view.
const VIEW_BITS: f32 = 64.0;

/// What is compared of an experience.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Glimpse {
    pub(super) id: ExperienceId,
    pub(super) view: u64,
    pub(super) mean_luminance: Option<f32>,
    pub(super) is_keyframe: bool,
}

impl From<&Experience> for Glimpse {
    fn from(experience: &Experience) -> Self {
        let &Experience { id, view, mean_luminance, is_keyframe, .. } = experience;
        Self { id, view, mean_luminance, is_keyframe }
    }
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
/// the one that is no keyframe, else the younger. `None` of fewer than two.
pub(super) fn least_telling(glimpses: &[Glimpse]) -> Option<ExperienceId> {
    let mut closest: Option<(f32, &Glimpse, &Glimpse)> = None;
    for (index, younger) in glimpses.iter().enumerate() {
        for older in &glimpses[..index] {
            let difference = older.difference(younger);
            if closest.is_none_or(|(least, ..)| difference < least) {
                closest = Some((difference, older, younger));
            }
        }
    }
    let (_, older, younger) = closest?;
    Some(if younger.is_keyframe && !older.is_keyframe { older.id } else { younger.id })
}

/// The one that tells least in the place that has most experiences; `None` if every place has but one.
pub(super) fn least_telling_of_all(contents: &Contents) -> Option<ExperienceId> {
    let fullest = contents.places.values().max_by_key(|place| place.experiences.len())?;
    least_telling(&glimpses(contents, fullest))
}

/// The experiences of `place`.
pub(super) fn glimpses(contents: &Contents, place: &Place) -> Vec<Glimpse> {
    let experiences = place.experiences.iter().filter_map(|id| contents.experiences.get(id));
    experiences.map(Glimpse::from).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glimpse(id: u32, view: u64, mean_luminance: f32, is_keyframe: bool) -> Glimpse {
        Glimpse { id: ExperienceId(id), view, mean_luminance: Some(mean_luminance), is_keyframe }
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
    fn the_last_experience_is_never_given_up() {
        assert_eq!(least_telling(&[glimpse(0, 0, 100.0, true)]), None);
        assert_eq!(least_telling(&[]), None);
    }
}
