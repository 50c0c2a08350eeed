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
    /// What is of no class, from all over the places with too few experiences, no more than training looks at: it shows
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
            let of_map = (class.map, clusters.classes.len());
            let (learnt, checked) = class.learnt.split_at(border(&class.learnt, CHECKED_SHARE));
            let mut readable = |samples: &[Sample]| pictures.readable(samples, of_map, clusters, progress);
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
        clusters.unreadable.sort_unstable();
        Ok(pictures)
    }

    /// Images of strangers, evenly spaced over all of theirs: as many as training looks at, if there are so many.
    fn strangers_of(
        &self,
        clusters: &mut Clusters,
        progress: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Vec<Picture>, TrainingError> {
        let mut all = Vec::new();
        for (index, stranger) in clusters.strangers.iter().enumerate() {
            let of_map = (stranger.map, clusters.classes.len() + index);
            all.extend(stranger.samples.iter().map(|&sample| (of_map, sample)));
        }
        let count = all.len().min(self.checked.len());
        let mut strangers = Vec::new();
        for (of_map, sample) in (0..count).map(|index| all[index * all.len() / count]) {
            strangers.extend(self.readable(&[sample], of_map, clusters, progress)?);
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

    /// Whether a model of `clusters` can be judged by them: some images are held out, and some show what is not near to
    /// another class.
    ///
    /// # Errors
    /// [`TrainingError::NothingHeldOut`], [`TrainingError::NothingElse`].
    pub fn check(&self, clusters: &Clusters) -> Result<(), TrainingError> {
        if self.held_out.is_empty() {
            return Err(TrainingError::NothingHeldOut);
        }
        let shows_another = |picture: &Picture| {
            (0..clusters.classes.len()).any(|class| !clusters.is_near(picture.class, class))
        };
        let is_known = !self.checked.is_empty();
        let is_told = is_known && self.checked.iter().chain(&self.strangers).any(shows_another);
        if is_told { Ok(()) } else { Err(TrainingError::NothingElse) }
    }

    /// How many images of `clusters` are tried at most.
    #[must_use]
    pub fn most_of(clusters: &Clusters) -> usize {
        let of_classes = clusters.classes.iter().map(|class| class.learnt.len() + class.held_out.len());
        let checked =
            clusters.classes.iter().map(|class| class.learnt.len() - border(&class.learnt, CHECKED_SHARE));
        of_classes.sum::<usize>() + clusters.stranger_count().min(checked.sum())
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

    /// The image of `picture`.
    ///
    /// # Errors
    /// [`TrainingError::ImageGone`], or if the medium fails.
    pub fn image(&self, picture: Picture) -> Result<RgbImage, TrainingError> {
        let jpeg = self.jpeg(picture.map, picture.experience)?;
        let image = jpeg.and_then(|jpeg| source::decode(&jpeg, "thumbnail").ok());
        image.ok_or(TrainingError::ImageGone)
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
    use crate::source::thumbnail_jpeg;
    use crate::training::ClusterRules;
    use crate::training::scripted_map::scripted_map;

    /// Classes and images of `map`, in which places of ten experiences or more are classes.
    fn pictured<T>(map: &PlaceMap, look: impl FnOnce(&Clusters, &Pictures<'_>) -> T) -> T {
        let maps = [map];
        let rules = ClusterRules { min_samples: 10, ..ClusterRules::default() };
        let mut clusters = Clusters::of(&maps, &rules).unwrap();
        let pictures = Pictures::of(&maps, &mut clusters, &mut || ControlFlow::Continue(())).unwrap();
        look(&clusters, &pictures)
    }

    #[test]
    fn strangers_are_from_all_over_the_small_places_and_no_more_than_what_is_looked_at() {
        let jpeg = thumbnail_jpeg(&RgbImage::new(64, 64));
        pictured(&scripted_map(&[20, 3, 25, 9, 5], |_| jpeg.clone()), |clusters, pictures| {
            assert_eq!((clusters.classes.len(), clusters.stranger_count()), (2, 17));
            let numbers: Vec<usize> = pictures.strangers.iter().map(|picture| picture.class).collect();
            assert_eq!((pictures.checked.len(), numbers), (8, vec![2, 2, 3, 3, 3, 3, 4, 4]));
            assert_eq!((pictures.len(), Pictures::most_of(clusters)), (45 + 8, 45 + 8));
        });
    }

    #[test]
    fn an_image_that_the_map_gave_up_is_missing_and_not_unreadable() {
        pictured(&scripted_map(&[10], |_| Vec::new()), |clusters, pictures| {
            assert_eq!((pictures.len(), clusters.without_image, &clusters.unreadable[..]), (0, 10, &[][..]));
        });
    }

    #[test]
    fn images_that_cannot_be_decoded_are_told_by_number_and_a_class_without_any_is_none() {
        pictured(&scripted_map(&[10, 2], |_| b"no JPEG".to_vec()), |clusters, pictures| {
            assert!(clusters.classes.is_empty() && pictures.is_empty());
            let numbers: Vec<u32> = clusters.unreadable.iter().map(|it| it.experience.0).collect();
            assert_eq!(numbers, (0..10).collect::<Vec<_>>(), "of strangers no more than what is looked at");
        });
    }

    #[test]
    fn strangers_are_numbered_behind_the_classes_that_have_images() {
        let jpeg = thumbnail_jpeg(&RgbImage::new(64, 64));
        let jpeg_of = |place| if place == 1 { b"no JPEG".to_vec() } else { jpeg.clone() };
        pictured(&scripted_map(&[20, 20, 2, 20], jpeg_of), |clusters, pictures| {
            let places: Vec<u32> = clusters.classes.iter().map(|class| class.place.0).collect();
            assert_eq!((places, clusters.unreadable.len()), (vec![0, 3], 20));
            assert!(pictures.held_out.iter().any(|picture| picture.class == 1));
            assert!(pictures.strangers.iter().all(|picture| picture.class == 2), "{:?}", pictures.strangers);
            // Along the way from place 0 to place 3; place 0 is two steps away.
            assert!(clusters.is_near(2, 0) && clusters.is_near(2, 1));
        });
    }
}
