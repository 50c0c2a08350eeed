//! What a model says of the images of classes, computed once.

use std::ops::ControlFlow;

use rand_pcg::Pcg64;

use super::error::TrainingError;
use super::labelled::Labelled;
use super::pictures::{Picture, Pictures};
use super::variation::Variation;
use crate::cnn::{CnnError, Descriptor, DescriptorModel};
use crate::raster::RgbImage;

/// Vectors of all classes: features of a backbone, or descriptors of a trained model.
#[derive(Clone, Debug, PartialEq)]
pub struct Gathered {
    /// Of what is learnt.
    pub learnt: Labelled,
    /// Of what training looks at to choose the best epoch, and what the calibration is fitted on.
    pub checked: Labelled,
    /// Of what nobody sees until the end.
    pub held_out: Labelled,
    /// Of what is of no class, on which the calibration is fitted, too.
    pub strangers: Labelled,
}

impl Gathered {
    /// What `describe` says of all images of `pictures`. `progress` hears of every image, and may end it.
    ///
    /// # Errors
    /// [`TrainingError::Interrupted`], what `describe` answers, or if the medium fails.
    pub fn of(
        pictures: &Pictures<'_>,
        width: usize,
        describe: &mut Describe<'_>,
        progress: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Self, TrainingError> {
        let mut of = |part: &[Picture]| {
            let mut labelled = Labelled::new(width);
            for &picture in part {
                if let Some(vector) = describe(&pictures.image(picture)?)? {
                    labelled.push(&vector, picture.class);
                }
                if progress().is_break() {
                    return Err(TrainingError::Interrupted);
                }
            }
            Ok(labelled)
        };
        Ok(Self {
            learnt: of(&pictures.learnt)?,
            checked: of(&pictures.checked)?,
            held_out: of(&pictures.held_out)?,
            strangers: of(&pictures.strangers)?,
        })
    }

    /// The same, with what training looks at in the place of what nobody has seen.
    #[must_use]
    pub fn checked_as_held_out(&self) -> Self {
        Self { held_out: self.checked.clone(), ..self.clone() }
    }

    /// All vectors times `matrix`, `[width, columns]`.
    #[must_use]
    pub fn projected(&self, matrix: &[f32]) -> Self {
        Self {
            learnt: self.learnt.projected(matrix),
            checked: self.checked.projected(matrix),
            held_out: self.held_out.projected(matrix),
            strangers: self.strangers.projected(matrix),
        }
    }

    /// The same, with the mean of every class in the place of all that is learnt of it: what is recognised without any
    /// training.
    #[must_use]
    pub fn by_prototypes(&self) -> Self {
        let mut learnt = Labelled::new(self.learnt.width());
        let means = self.learnt.prototypes();
        means.chunks_exact(learnt.width()).enumerate().for_each(|(class, mean)| learnt.push(mean, class));
        Self { learnt, ..self.clone() }
    }
}

/// What `describe` says of `copies` of every one of `part` of `pictures`, each varied in its own way, settled by
/// `seed`. `progress` hears of every one, and may end it.
///
/// # Errors
/// [`TrainingError::Interrupted`], what `describe` answers, or if the medium fails.
pub fn varied(
    (pictures, part): (&Pictures<'_>, &[Picture]),
    width: usize,
    (variation, copies, seed): (&Variation, usize, u64),
    describe: &mut Describe<'_>,
    progress: &mut dyn FnMut() -> ControlFlow<()>,
) -> Result<Labelled, TrainingError> {
    let mut labelled = Labelled::new(width);
    for (number, &picture) in part.iter().enumerate() {
        let image = pictures.image(picture)?;
        let mut random = Pcg64::new(u128::from(seed), number as u128);
        for _ in 0..copies {
            if let Some(vector) = describe(&variation.vary(&image, &mut random)?)? {
                labelled.push(&vector, picture.class);
            }
            if progress().is_break() {
                return Err(TrainingError::Interrupted);
            }
        }
    }
    Ok(labelled)
}

/// What is said of an image; nothing if it has no direction.
pub type Describe<'a> = dyn FnMut(&RgbImage) -> Result<Option<Vec<f32>>, TrainingError> + 'a;

/// What `model` says of an image.
///
/// # Errors
/// [`TrainingError::Cnn`].
pub fn described(model: &mut DescriptorModel, image: &RgbImage) -> Result<Option<Vec<f32>>, TrainingError> {
    Ok(descriptor(model, image)?.map(|descriptor| descriptor.as_slice().to_vec()))
}

/// The descriptor of an image; nothing if it has none.
pub(super) fn descriptor(
    model: &mut DescriptorModel,
    image: &RgbImage,
) -> Result<Option<Descriptor>, CnnError> {
    match model.describe(image) {
        Err(CnnError::Degenerate { .. }) => Ok(None),
        described => described.map(Some),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prototypes_stand_in_the_place_of_what_is_learnt_and_of_nothing_else() {
        let labelled = |vectors: &[([f32; 2], usize)]| {
            let mut labelled = Labelled::new(2);
            vectors.iter().for_each(|(vector, class)| labelled.push(vector, *class));
            labelled
        };
        let learnt = labelled(&[([0.6, 0.8], 0), ([0.6, -0.8], 0), ([0.0, 1.0], 1)]);
        let [checked, held_out, strangers] = [0, 1, 2].map(|class| labelled(&[([0.0, 1.0], class)]));
        let gathered = Gathered { learnt, checked, held_out, strangers };
        let learnt = labelled(&[([1.0, 0.0], 0), ([0.0, 1.0], 1)]);
        assert_eq!(gathered.by_prototypes(), Gathered { learnt, ..gathered });
    }
}
