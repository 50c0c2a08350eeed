//! The images of classes: what is learnt, what training looks at to choose its best epoch, and what is held out; and
//! images of no class.
//!
//! They stay in their maps, and are decoded when they are looked at: a map may hold more than memory.

use std::ops::ControlFlow;

use super::clusters::{Clusters, Sample, Unreadable, border};
use super::error::TrainingError;
use crate::place_map::{ExperienceId, MapError, PlaceMap};
use crate::raster::RgbImage;
use crate::source;
use crate::storage;

/// Share of what is learnt that training only looks at, to choose the best epoch: the latest of each class.
const CHECKED_SHARE: f64 = 0.2;

/// An image of a class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Its class; of a stranger, its number behind the last class.
    pub class: usize,
    /// Which of the maps it is in.
    map: usize,
    experience: ExperienceId,
    /// Of its JPEG: what tells it from an image of the same number in another map.
    checksum: u32,
}

/// The images of all classes.
pub struct Pictures<'a> {
    maps: &'a [&'a PlaceMap],
    /// What is learnt.
    pub learnt: Vec<Picture>,
    /// What training looks at to choose the best epoch, and what the calibration is fitted on.
    pub checked: Vec<Picture>,
    /// What nobody sees until the end.
    pub held_out: Vec<Picture>,
    /// What is of no class, from all places with too few experiences alike, no more than training looks at: it shows
    /// which cosines mean nothing.
    pub strangers: Vec<Picture>,
}

impl<'a> Pictures<'a> {
    /// The images of `clusters`, which are of `maps`, each tried once. Classes without an image that can be learnt are
    /// left out of them, and what has no image, or none that can be read, is told there. `progress` hears of every
    /// image, and may end it.
    ///
    /// # Errors
    /// [`TrainingError::Interrupted`], or if the medium fails.
    pub fn of(
        maps: &'a [&'a PlaceMap],
        clusters: &mut Clusters,
        progress: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Self, TrainingError> {
        let (learnt, checked, held_out) = (Vec::new(), Vec::new(), Vec::new());
        let mut pictures = Self { maps, learnt, checked, held_out, strangers: Vec::new() };
        for class in std::mem::take(&mut clusters.classes) {
            let at = (class.map, clusters.classes.len());
            let (learnt, checked) = class.learnt.split_at(border(&class.learnt, CHECKED_SHARE));
            let mut readable = |samples: &[Sample]| pictures.readable(samples, at, clusters, progress);
            let (learnt, checked, held_out) =
                (readable(learnt)?, readable(checked)?, readable(&class.held_out)?);
            // Without a learnt image there is no class, whatever else there is of it.
            if !learnt.is_empty() {
                pictures.learnt.extend(learnt);
                pictures.checked.extend(checked);
                pictures.held_out.extend(held_out);
                clusters.classes.push(class);
            }
        }
        pictures.strangers = pictures.strangers_of(clusters, progress)?;
        Ok(pictures)
    }

    /// Some images of the strangers of `clusters`.
    fn strangers_of(
        &self,
        clusters: &mut Clusters,
        progress: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Vec<Picture>, TrainingError> {
        let behind = clusters.classes.len();
        let all = clusters.strangers.iter().enumerate().flat_map(|(index, class)| {
            class.learnt.iter().map(move |&sample| (sample, (class.map, behind + index)))
        });
        let step = clusters.stranger_count().div_ceil(self.checked.len().max(1)).max(1);
        let some: Vec<_> = all.step_by(step).collect();
        let mut strangers = Vec::new();
        for (sample, at) in some {
            strangers.extend(self.readable(&[sample], at, clusters, progress)?);
        }
        Ok(strangers)
    }

    /// Those of `samples` whose image can be read; the others are told to `clusters`.
    fn readable(
        &self,
        samples: &[Sample],
        (map, class): (usize, usize),
        clusters: &mut Clusters,
        progress: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Vec<Picture>, TrainingError> {
        let mut readable = Vec::new();
        for &Sample { experience, .. } in samples {
            match self.jpeg(map, experience)? {
                Some(jpeg) if jpeg.is_empty() => clusters.without_image += 1,
                Some(jpeg) if source::decode(&jpeg, "thumbnail").is_ok() => {
                    let checksum = storage::checksum(&jpeg);
                    readable.push(Picture { class, map, experience, checksum });
                }
                _ => clusters.unreadable.push(Unreadable { map, experience }),
            }
            if progress().is_break() {
                return Err(TrainingError::Interrupted);
            }
        }
        Ok(readable)
    }

    /// Number of images.
    #[must_use]
    pub fn len(&self) -> usize {
        [&self.learnt, &self.checked, &self.held_out, &self.strangers].into_iter().map(Vec::len).sum()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The image of `picture`; nothing if there is none that can be read.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn image(&self, picture: Picture) -> Result<Option<RgbImage>, TrainingError> {
        let jpeg = self.jpeg(picture.map, picture.experience)?;
        Ok(jpeg.and_then(|jpeg| source::decode(&jpeg, "thumbnail").ok()))
    }

    /// The bytes of an experience's thumbnail, of which there may be none; nothing if they cannot be read.
    fn jpeg(&self, map: usize, experience: ExperienceId) -> Result<Option<Vec<u8>>, TrainingError> {
        match self.maps[map].thumbnail_jpeg(experience) {
            Err(MapError::Storage(error)) if error.is_damage() => Ok(None),
            jpeg => Ok(Some(jpeg?)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::Features;
    use crate::frame::Frame;
    use crate::place_map::{MapOptions, NewExperience, PlaceId, Traits};
    use crate::raster::GreyImage;
    use crate::source::thumbnail_jpeg;
    use crate::training::ClusterRules;

    /// A map of places that were seen so many times each, every time with `jpeg` as its image.
    fn map(sizes: &[usize], jpeg: &[u8]) -> PlaceMap {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        let (features, traits) = (Features::default(), Traits::default());
        for &size in sizes {
            let mut place: Option<PlaceId> = None;
            for time in 0..size {
                let frame = Frame {
                    index: 0,
                    capture_nanos: time as i64,
                    name: String::new(),
                    colour: RgbImage::new(1, 1),
                    grey: GreyImage::new(1, 1),
                    jpeg: None,
                    pose: None,
                    true_place: None,
                };
                let new = NewExperience {
                    frame: &frame,
                    view: 0,
                    mean_luminance: 100.0,
                    thumbnail_jpeg: jpeg,
                    keyframe: place.is_none().then_some((&features, &traits)),
                };
                place = Some(map.learn(place, &new).unwrap().place);
            }
        }
        map
    }

    /// Classes and images of `map`, in which places of ten experiences or more are classes.
    fn pictured<T>(map: &PlaceMap, look: impl FnOnce(&Clusters, &Pictures<'_>) -> T) -> T {
        let maps = [map];
        let rules = ClusterRules { min_samples: 10, ..ClusterRules::default() };
        let mut clusters = Clusters::of(&maps, &rules).unwrap();
        let pictures = Pictures::of(&maps, &mut clusters, &mut || ControlFlow::Continue(())).unwrap();
        look(&clusters, &pictures)
    }

    #[test]
    fn strangers_are_of_all_small_places_numbered_behind_the_classes_and_no_more_than_what_is_looked_at() {
        let map = map(&[20, 3, 25, 9, 5], &thumbnail_jpeg(&RgbImage::new(64, 64)));
        pictured(&map, |clusters, pictures| {
            assert_eq!((clusters.classes.len(), clusters.stranger_count()), (2, 17));
            let numbers: Vec<usize> = pictures.strangers.iter().map(|picture| picture.class).collect();
            assert_eq!((pictures.checked.len(), numbers), (8, vec![2, 3, 3, 3, 4, 4]));
            assert_eq!(pictures.len(), 45 + 6);
        });
    }

    #[test]
    fn an_image_that_the_map_gave_up_is_missing_and_not_unreadable() {
        pictured(&map(&[10], b""), |clusters, pictures| {
            assert_eq!((pictures.len(), clusters.without_image, &clusters.unreadable[..]), (0, 10, &[][..]));
        });
    }

    #[test]
    fn images_that_cannot_be_decoded_are_told_by_number_and_a_class_without_any_is_none() {
        pictured(&map(&[10, 2], b"no JPEG"), |clusters, pictures| {
            assert!(clusters.classes.is_empty() && pictures.is_empty());
            let numbers: Vec<u32> = clusters.unreadable.iter().map(|it| it.experience.0).collect();
            assert_eq!(numbers, (0..=10).collect::<Vec<_>>(), "ten of the class, one of the two strangers");
        });
    }
}
