//! What a new model must show before frames are described by it.
//!
//! That it runs was seen when it was opened. Besides, the same image must give the same descriptor, nearly every
//! keyframe of the map must have one, and different places must not look alike: a network that broke on its way (its
//! weights zeroed, its card that of another one) mostly gives all images about the same descriptor, and would recognise
//! everything as anything.

use std::collections::BTreeMap;

use crate::cnn::{CompactDescriptor, Descriptor, ModelCard};
use crate::place_map::PlaceId;
use crate::recognition::Exhibit;

/// Least cosine of two descriptors of one image: more than what rounding in another order changes.
const SAME_ABOVE: f32 = 0.9999;
/// Keyframes that are described twice.
const DESCRIBED_TWICE: usize = 4;
/// Most places that are compared with each other.
const MOST_PLACES: usize = 128;
/// Fewest pairs of places that say anything. A few places of a map may well be one that was founded twice.
const LEAST_PAIRS: usize = 100;
/// Of so many pairs of different places, one may look alike. The threshold of a card is made such that one in a few
/// hundred frames exceeds it with any place of a map; one in twenty of all pairs is far beyond that, and beyond what
/// places that were founded twice amount to.
const ONE_ALIKE_OF: usize = 20;
/// Of so many keyframes, one may be such that no descriptor can be made of it.
const ONE_FAILED_OF: usize = 20;

/// A place by the first of its keyframes that was described.
struct Sample {
    neighbours: Vec<PlaceId>,
    descriptor: CompactDescriptor,
}

/// The self-test of a model, as its descriptors come in.
pub(super) struct SelfTest {
    recognise_above: f32,
    described: usize,
    failed: usize,
    /// Every so many places by their numbers, so that they are from all over the map.
    stride: u32,
    samples: BTreeMap<PlaceId, Sample>,
}

impl SelfTest {
    /// The test of the model of `card`.
    pub(super) fn new(card: &ModelCard) -> Self {
        Self {
            recognise_above: card.decision.recognise_above,
            described: 0,
            failed: 0,
            stride: 1,
            samples: BTreeMap::new(),
        }
    }

    /// Whether the next keyframe is to be described twice.
    pub(super) fn asks_again(&self) -> bool {
        self.described < DESCRIBED_TWICE
    }

    /// Compares two descriptors of one image.
    ///
    /// # Errors
    /// If they differ.
    pub(super) fn compare(&self, first: &Descriptor, again: &Descriptor) -> Result<(), String> {
        let cosine = first.cosine(again);
        if cosine >= SAME_ABOVE {
            return Ok(());
        }
        Err(format!("the same image gives different descriptors (cosine {cosine:.4})"))
    }

    /// The model could not describe a keyframe.
    pub(super) fn count_failure(&mut self) {
        self.failed += 1;
    }

    /// The model has described a keyframe.
    pub(super) fn count(&mut self, exhibit: &Exhibit, descriptor: &CompactDescriptor) {
        self.described += 1;
        if !exhibit.place.0.is_multiple_of(self.stride) {
            return;
        }
        let sample = || Sample { neighbours: exhibit.neighbours.clone(), descriptor: descriptor.clone() };
        self.samples.entry(exhibit.place).or_insert_with(sample);
        while self.samples.len() > MOST_PLACES {
            self.stride *= 2;
            self.samples.retain(|place, _| place.0.is_multiple_of(self.stride));
        }
    }

    /// Whether the model may be used; once all keyframes were shown.
    ///
    /// # Errors
    /// Why not, for people.
    pub(super) fn verdict(&self) -> Result<(), String> {
        let keyframes = self.failed + self.described;
        if self.failed * ONE_FAILED_OF > keyframes {
            return Err(format!("it fails on {} of {keyframes} keyframes of the map", self.failed));
        }
        let (alike, pairs) = self.alike();
        if pairs < LEAST_PAIRS || alike * ONE_ALIKE_OF <= pairs {
            return Ok(());
        }
        let above = self.recognise_above;
        Err(format!("to it {alike} of {pairs} pairs of different places look alike (cosine above {above})"))
    }

    /// How many pairs of places that are not next to each other look alike, and of how many.
    fn alike(&self) -> (usize, usize) {
        let (mut alike, mut pairs) = (0, 0);
        for (place, sample) in &self.samples {
            for (other, other_sample) in self.samples.range(..place) {
                if sample.neighbours.contains(other) || other_sample.neighbours.contains(place) {
                    continue;
                }
                pairs += 1;
                let cosine = sample.descriptor.cosine(&other_sample.descriptor);
                alike += usize::from(cosine > self.recognise_above);
            }
        }
        (alike, pairs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place_map::ExperienceId;

    fn test() -> SelfTest {
        SelfTest { recognise_above: 0.9, described: 0, failed: 0, stride: 1, samples: BTreeMap::new() }
    }

    /// Counts a keyframe of `place`, next to the place after it, with the descriptor of a look.
    fn count(test: &mut SelfTest, place: u32, look: usize) {
        let values = (0..300).map(|i| i8::from(i == look)).collect();
        let exhibit = Exhibit {
            keyframe: ExperienceId(place),
            place: PlaceId(place),
            neighbours: vec![PlaceId(place + 1)],
            thumbnail_jpeg: Vec::new(),
        };
        test.count(&exhibit, &CompactDescriptor::from_values(values).unwrap());
    }

    #[test]
    fn a_network_to_which_everything_is_alike_is_refused_and_one_that_tells_places_apart_is_not() {
        let (mut constant, mut sound) = (test(), test());
        for place in 0..300 {
            count(&mut constant, place, 7);
            count(&mut sound, place, place as usize);
        }
        let reason = constant.verdict().unwrap_err();
        assert!(reason.contains("pairs of different places look alike"), "{reason}");
        assert_eq!(sound.verdict(), Ok(()));
        assert!((64..=128).contains(&sound.samples.len()), "{}", sound.samples.len());
    }

    #[test]
    fn neighbours_places_founded_twice_and_small_maps_say_nothing_against_a_network() {
        let (mut doubled, mut along, mut small) = (test(), test(), test());
        for place in 0..60 {
            // Every place of the first lap was founded once more on the second.
            count(&mut doubled, place, place as usize % 30);
            count(&mut along, place, place as usize / 2);
        }
        (0..14).for_each(|place| count(&mut small, place, 0));
        assert_eq!([doubled, along, small].map(|test| test.verdict()), [Ok(()), Ok(()), Ok(())]);
    }

    #[test]
    fn a_network_that_wavers_or_often_fails_is_refused() {
        let descriptor = |values: &[f32]| Descriptor::from_values(values.to_vec()).unwrap();
        let mut test = test();
        assert_eq!(test.compare(&descriptor(&[1.0, 2.0]), &descriptor(&[1.0, 2.000_01])), Ok(()));
        assert!(test.compare(&descriptor(&[1.0, 2.0]), &descriptor(&[1.0, 2.1])).is_err());
        (0..19).for_each(|place| count(&mut test, place, place as usize));
        test.count_failure();
        assert_eq!(test.verdict(), Ok(()));
        test.count_failure();
        assert_eq!(test.verdict(), Err("it fails on 2 of 21 keyframes of the map".to_owned()));
    }
}
