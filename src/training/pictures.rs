//! The images of classes: what is learnt, what training looks at to choose its best epoch, and what is held out.
//!
//! They stay in their maps, and are decoded when they are looked at: a map may hold more than memory.

use std::ops::ControlFlow;

use super::clusters::{Clusters, Sample, border};
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
    /// Its class.
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
    /// Images that cannot be read.
    pub skipped: usize,
}

impl<'a> Pictures<'a> {
    /// The images of `clusters`, which are of `maps`, each tried once; classes without an image that can be learnt are
    /// left out of them. `progress` hears of every image, and may end it.
    ///
    /// # Errors
    /// [`TrainingError::Interrupted`], or if the medium fails.
    pub fn of(
        maps: &'a [&'a PlaceMap],
        clusters: &mut Clusters,
        progress: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Self, TrainingError> {
        let mut pictures =
            Self { maps, learnt: Vec::new(), checked: Vec::new(), held_out: Vec::new(), skipped: 0 };
        let mut pictured = Vec::new();
        for class in std::mem::take(&mut clusters.classes) {
            let (map, number) = (class.map, pictured.len());
            let (learnt, checked) = class.learnt.split_at(border(&class.learnt, CHECKED_SHARE));
            let mut readable = |samples: &[Sample]| pictures.readable(samples, (map, number), progress);
            let (learnt, checked, held_out) =
                (readable(learnt)?, readable(checked)?, readable(&class.held_out)?);
            // Without a learnt image there is no class, whatever else there is of it.
            if !learnt.is_empty() {
                pictures.learnt.extend(learnt);
                pictures.checked.extend(checked);
                pictures.held_out.extend(held_out);
                pictured.push(class);
            }
        }
        clusters.classes = pictured;
        Ok(pictures)
    }

    /// Those of `samples` whose image can be read.
    fn readable(
        &mut self,
        samples: &[Sample],
        (map, class): (usize, usize),
        progress: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Vec<Picture>, TrainingError> {
        let mut readable = Vec::new();
        for sample in samples {
            let jpeg = self.jpeg(map, sample.experience)?;
            if source::decode(&jpeg, "thumbnail").is_ok() {
                let checksum = storage::checksum(&jpeg);
                readable.push(Picture { class, map, experience: sample.experience, checksum });
            } else {
                self.skipped += 1;
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
        self.learnt.len() + self.checked.len() + self.held_out.len()
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
        Ok(source::decode(&jpeg, "thumbnail").ok())
    }

    /// The bytes of an experience's thumbnail; none if they cannot be read.
    fn jpeg(&self, map: usize, experience: ExperienceId) -> Result<Vec<u8>, TrainingError> {
        match self.maps[map].thumbnail_jpeg(experience) {
            Err(MapError::Storage(error)) if error.is_damage() => Ok(Vec::new()),
            jpeg => Ok(jpeg?),
        }
    }
}
