//! The places as the CNN knows them: one descriptor a keyframe, compared one by one.

use heapless::Vec as FixedVec;

use super::candidate::{Candidate, Evidence, MAX_CANDIDATES};
use crate::cnn;
use crate::place_map::{ExperienceId, PlaceId};

struct Entry {
    place: PlaceId,
    keyframe: ExperienceId,
    descriptor: cnn::Descriptor,
}

/// CNN descriptors of all keyframes.
#[derive(Default)]
pub(super) struct AppearanceIndex {
    entries: Vec<Entry>,
}

impl AppearanceIndex {
    pub(super) fn add(&mut self, place: PlaceId, keyframe: ExperienceId, descriptor: cnn::Descriptor) {
        self.entries.push(Entry { place, keyframe, descriptor });
    }

    /// The best keyframe of each of the places that are most like `descriptor`, best first.
    pub(super) fn query(&self, descriptor: &cnn::Descriptor) -> FixedVec<Candidate, MAX_CANDIDATES> {
        let mut best: FixedVec<Candidate, MAX_CANDIDATES> = FixedVec::new();
        for entry in &self.entries {
            let score = descriptor.cosine(&entry.descriptor);
            if let Some(known) = best.iter().position(|candidate| candidate.place == entry.place) {
                if best[known].score >= score {
                    continue;
                }
                best.remove(known);
            }
            let position = best.partition_point(|candidate| candidate.score >= score);
            if best.is_full() && position < best.len() {
                best.pop();
            }
            // Refused only when full of better ones.
            let _ = best.insert(position, entry.candidate(score));
        }
        best
    }
}

impl Entry {
    fn candidate(&self, score: f32) -> Candidate {
        Candidate {
            place: self.place,
            keyframe: self.keyframe,
            by: Evidence::Cnn,
            score,
            inliers: None,
            rejected: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_best_keyframe_of_every_leading_place_is_found(
            entries in proptest::collection::vec((0..12_u32, 0.0..3.1_f32), 0..60),
        ) {
            let mut index = AppearanceIndex::default();
            for (keyframe, &(place, angle)) in (0..).zip(&entries) {
                let descriptor = cnn::Descriptor::from_values(vec![angle.cos(), angle.sin()]).unwrap();
                index.add(PlaceId(place), ExperienceId(keyframe), descriptor);
            }
            let mut expected: Vec<(f32, u32)> = (0..12).filter_map(|place| {
                let angles = entries.iter().filter(|entry| entry.0 == place).map(|entry| entry.1);
                angles.reduce(f32::min).map(|angle| (angle, place))
            }).collect();
            expected.sort_by(|a, b| a.0.total_cmp(&b.0));
            expected.truncate(MAX_CANDIDATES);
            let found = index.query(&cnn::Descriptor::from_values(vec![1.0, 0.0]).unwrap());
            prop_assert_eq!(found.len(), expected.len());
            for (found, (angle, _)) in found.iter().zip(expected) {
                prop_assert!((found.score - angle.cos()).abs() < 1e-5);
            }
        }
    }
}
