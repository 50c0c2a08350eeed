//! The features that a backbone has of the images of classes, computed once.

use std::ops::ControlFlow;

use super::clusters::{Class, Clusters, Sample, border};
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

/// Describes every image of `clusters`, which are of `maps`, by `backbone`. `progress` hears of every image, and may
/// end it.
///
/// # Errors
/// [`TrainingError::Interrupted`], or if a map or the backbone fails.
pub fn gather(
    maps: &[&PlaceMap],
    clusters: &Clusters,
    backbone: &mut DescriptorModel,
    progress: &mut dyn FnMut() -> ControlFlow<()>,
) -> Result<Gathered, TrainingError> {
    let empty = || Labelled::new(backbone.dimensions());
    let mut gathered = Gathered { learnt: empty(), checked: empty(), held_out: empty(), skipped: 0 };
    for (number, class) in clusters.classes.iter().enumerate() {
        let Class { map, learnt, held_out, .. } = class;
        let (learnt, checked) = learnt.split_at(border(learnt, CHECKED_SHARE));
        for (samples, into) in [
            (learnt, &mut gathered.learnt),
            (checked, &mut gathered.checked),
            (held_out, &mut gathered.held_out),
        ] {
            for sample in samples {
                match described(maps[*map], sample, backbone)? {
                    Some(features) => into.push(&features, number),
                    None => gathered.skipped += 1,
                }
                if progress().is_break() {
                    return Err(TrainingError::Interrupted);
                }
            }
        }
    }
    Ok(gathered)
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
