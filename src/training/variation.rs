//! Further images of a place out of one that a map has (the paper's section III.C.3).

use std::cell::RefCell;

use rand::Rng;
use rand_pcg::Pcg64;

use super::augmentation::Augmentation;
use super::error::TrainingError;
use crate::cnn::ImageGenerator;
use crate::raster::RgbImage;

/// What makes further images.
#[derive(Debug, Default)]
pub struct Variation {
    /// Other light, weather and view.
    pub augmentation: Option<Augmentation>,
    /// A network that makes an image of an image, such as a GAN's generator: half of the images go through it first.
    pub generator: Option<RefCell<ImageGenerator>>,
}

impl Variation {
    /// Whether it makes no other images.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.augmentation.is_none() && self.generator.is_none()
    }

    /// `image` as it might look another time; what changes, and how, is drawn from `random`.
    ///
    /// # Errors
    /// If the generator fails.
    pub fn vary(&self, image: &RgbImage, random: &mut Pcg64) -> Result<RgbImage, TrainingError> {
        let generated = match &self.generator {
            Some(generator) if random.random() => Some(generator.borrow_mut().generate(image)?),
            _ => None,
        };
        let image = generated.as_ref().unwrap_or(image);
        Ok(self.augmentation.map_or_else(|| image.clone(), |augmentation| augmentation.apply(image, random)))
    }
}
