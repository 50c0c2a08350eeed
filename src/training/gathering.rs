//! The features that a backbone has of the images of classes, computed once.

use std::ops::ControlFlow;

use super::clusters::{Clusters, Sample, border};
use super::error::TrainingError;
use super::labelled::Labelled;
use crate::cnn::{CnnError, DescriptorModel};
use crate::place_map::{MapError, PlaceMap};
use crate::source;

/// Share of what is learnt that training only looks at, to choose the best epoch: the latest of each class.
const CHECKED_SHARE: f64 = 0.2;

/// Features of all classes.
#[derive(Clone, Debug, PartialEq)]
pub struct Gathered {
    /// What is learnt.
    pub learnt: Labelled,
    /// What training looks at to choose the best epoch, and what the calibration is fitted on.
    pub checked: Labelled,
    /// What nobody sees until the end.
    pub held_out: Labelled,
    /// Images that could not be read or described.
    pub skipped: usize,
}

/// Describes every image of `clusters`, which are of `maps`, by `backbone`; classes without an image that can be learnt
/// are left out of them. `progress` hears of every image, and may end it.
///
/// # Errors
/// [`TrainingError::Interrupted`], or if a map or the backbone fails.
pub fn gather(
    maps: &[&PlaceMap],
    clusters: &mut Clusters,
    backbone: &mut DescriptorModel,
    progress: &mut dyn FnMut() -> ControlFlow<()>,
) -> Result<Gathered, TrainingError> {
    let empty = || Labelled::new(backbone.dimensions());
    let mut gathered = Gathered { learnt: empty(), checked: empty(), held_out: empty(), skipped: 0 };
    let mut eye = Eye { backbone, progress };
    let mut described = Vec::new();
    for class in std::mem::take(&mut clusters.classes) {
        let (map, number, before) = (maps[class.map], described.len(), gathered.learnt.len());
        let (learnt, checked) = class.learnt.split_at(border(&class.learnt, CHECKED_SHARE));
        gathered.skipped += eye.describe(map, learnt, &mut gathered.learnt, number)?;
        // Without a learnt image there is no class, whatever else there is of it.
        if gathered.learnt.len() > before {
            gathered.skipped += eye.describe(map, checked, &mut gathered.checked, number)?;
            gathered.skipped += eye.describe(map, &class.held_out, &mut gathered.held_out, number)?;
            described.push(class);
        }
    }
    clusters.classes = described;
    Ok(gathered)
}

/// What looks at images, and who hears of each.
struct Eye<'a> {
    backbone: &'a mut DescriptorModel,
    progress: &'a mut dyn FnMut() -> ControlFlow<()>,
}

impl Eye<'_> {
    /// Adds the features of the images of `samples` to `into` as those of the class `number`; answers how many could
    /// not be read.
    fn describe(
        &mut self,
        map: &PlaceMap,
        samples: &[Sample],
        into: &mut Labelled,
        number: usize,
    ) -> Result<usize, TrainingError> {
        let mut skipped = 0;
        for sample in samples {
            match described(map, sample, self.backbone)? {
                Some(features) => into.push(&features, number),
                None => skipped += 1,
            }
            if (self.progress)().is_break() {
                return Err(TrainingError::Interrupted);
            }
        }
        Ok(skipped)
    }
}

/// The features of an experience's image; nothing if it cannot be read or has none.
fn described(
    map: &PlaceMap,
    sample: &Sample,
    backbone: &mut DescriptorModel,
) -> Result<Option<Vec<f32>>, TrainingError> {
    let jpeg = match map.thumbnail_jpeg(sample.experience) {
        Ok(jpeg) => jpeg,
        Err(MapError::Storage(error)) if error.is_damage() => return Ok(None),
        Err(error) => return Err(error.into()),
    };
    let Ok(image) = source::decode(&jpeg, "thumbnail") else { return Ok(None) };
    match backbone.describe(&image) {
        Ok(descriptor) => Ok(Some(descriptor.as_slice().to_vec())),
        Err(CnnError::Degenerate { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}
