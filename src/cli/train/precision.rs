//! In how many bits a trained model computes.

use loci::cnn::{DescriptorModel, ModelCard};
use loci::onnx::{OnnxError, OnnxModel};
use loci::training::{
    Agreement, Clusters, Gathered, Pictures, Rivals, Standing, TrainedModel, TrainingError, agreement,
    in_all_light, quantise,
};

use super::Trainer;
use super::arguments::Precision;

/// Images on which the ranges of the activations are measured.
const RANGE_IMAGES: usize = 64;

/// A network that was trained, before anything is said of how it stands.
pub(super) struct Candidate {
    pub(super) network: OnnxModel,
    pub(super) card: ModelCard,
    pub(super) descriptors: Gathered,
}

impl Trainer<'_> {
    /// `candidate` in the precision that is wanted: if nothing is said, in 8 bits where that recognises as much of what
    /// training merely looks at, give or take what chance may do. One whose backbone is in 8 bits is so already.
    pub(super) fn in_precision(
        &self,
        candidate: Candidate,
        (pictures, clusters): (&Pictures<'_>, &Clusters),
        rivals: Rivals,
    ) -> anyhow::Result<(TrainedModel, Precision)> {
        let wanted = self.arguments.precision;
        let judged = |Candidate { network, card, descriptors }: Candidate| {
            let has_copies = self.arguments.copies() > 0;
            TrainedModel::new(network, card, clusters, (&descriptors, rivals), has_copies)
        };
        if candidate.network.is_quantised() {
            return Ok((judged(candidate), Precision::Int8));
        }
        if wanted == Precision::F32 {
            return Ok((judged(candidate), Precision::F32));
        }
        let (int8, agreed) = match self.in_eight_bits(&candidate, pictures) {
            Ok(int8) => int8,
            Err(error) if wanted == Precision::Auto && is_unfit(&error) => {
                return Ok((judged(candidate), Precision::F32));
            }
            Err(error) => return Err(error),
        };
        let is_near = |one, other| clusters.is_near(one, other);
        let both = (&int8.descriptors, &candidate.descriptors);
        if wanted == Precision::Auto && !recognises_as_much(both, is_near) {
            return Ok((judged(candidate), Precision::F32));
        }
        let mut int8 = judged(int8);
        let Agreement { images, mean_cosine, worst_cosine } = agreed;
        let figures = format!("n {images}: cosine to f32 {mean_cosine:.3}, the worst {worst_cosine:.3}");
        int8.card.metrics.insert("int8".to_owned(), figures);
        Ok((int8, Precision::Int8))
    }

    /// The same in 8 bits, and how far both agree on images that its ranges were not measured on.
    fn in_eight_bits(
        &self,
        candidate: &Candidate,
        pictures: &Pictures<'_>,
    ) -> anyhow::Result<(Candidate, Agreement)> {
        let Candidate { network, card, .. } = candidate;
        let images = in_all_light((pictures, &self.variation), RANGE_IMAGES, self.arguments.seed);
        let int8 = quantise(network, card, &self.runtime, self.progress.until_stopped(images))?;
        let open =
            |network: &OnnxModel| DescriptorModel::from_onnx(card, &network.to_bytes(), &self.runtime, 2);
        let (mut model, mut whole) = (open(&int8)?, open(network)?);
        let step = pictures.checked.len().div_ceil(RANGE_IMAGES).max(1);
        let images = pictures.checked.iter().step_by(step).map(|&picture| pictures.image(picture));
        let agreed = agreement(&mut whole, &mut model, self.progress.until_stopped(images))?;
        let descriptors = self.gathered(pictures, &mut model)?;
        Ok((Candidate { network: int8, card: card.clone(), descriptors }, agreed))
    }
}

/// Whether the one recognises as much as the other, give or take what chance may do, of what training merely looks at,
/// where some classes are near each other. What is held out chooses nothing.
fn recognises_as_much(
    (one, other): (&Gathered, &Gathered),
    is_near: impl Fn(usize, usize) -> bool + Sync,
) -> bool {
    let [one, other] = [one, other].map(|it| Standing::of(&it.checked_as_held_out(), &is_near));
    one.recall() >= other.recall_interval().0
}

/// Whether the network itself, or a lack of images, stands in the way of 8 bits.
fn is_unfit(error: &anyhow::Error) -> bool {
    let unfit = error.downcast_ref::<TrainingError>();
    matches!(unfit, Some(TrainingError::Onnx(OnnxError::NothingToQuantise) | TrainingError::NoImages))
}

#[cfg(test)]
mod tests {
    use loci::training::Labelled;

    use super::*;

    /// Vectors of two classes; those of every part that is `told_apart` lie with their own class, else with the other.
    fn gathered(checked_is_told_apart: bool, held_out_is_told_apart: bool) -> Gathered {
        let part = |count: usize, is_told_apart: bool| {
            let mut part = Labelled::new(3);
            for index in 0..count {
                let class = index % 2;
                let mut vector = [0.0, 0.0, 0.01 * index as f32];
                vector[if is_told_apart { class } else { 1 - class }] = 1.0;
                part.push(&vector, class);
            }
            part
        };
        Gathered {
            learnt: part(20, true),
            checked: part(20, checked_is_told_apart),
            held_out: part(20, held_out_is_told_apart),
            strangers: Labelled::new(3),
        }
    }

    #[test]
    fn the_precision_is_chosen_by_what_training_looks_at_whatever_becomes_of_what_is_held_out() {
        let as_much = |one: &Gathered, other: &Gathered| recognises_as_much((one, other), |a, b| a == b);
        let whole = gathered(true, true);
        assert!(as_much(&gathered(true, true), &whole));
        assert!(as_much(&gathered(true, false), &whole));
        assert!(!as_much(&gathered(false, true), &whole));
        assert!(as_much(&gathered(false, true), &gathered(false, false)));
    }

    #[test]
    fn a_stranger_that_was_founded_where_a_class_is_hides_no_loss() {
        // At so many degrees from the class that was learnt: its own images are looked at, the stranger is nearer.
        let at = |degrees: &[(f32, usize)]| {
            let mut part = Labelled::new(2);
            for &(degrees, class) in degrees {
                part.push(&[degrees.to_radians().cos(), degrees.to_radians().sin()], class);
            }
            part
        };
        let looked_at = |degrees: f32| Gathered {
            learnt: at(&[(0.0, 0), (90.0, 1)]),
            checked: at(&[(degrees, 0), (90.0 - degrees, 1)]),
            held_out: at(&[]),
            strangers: at(&[(5.0, 2)]),
        };
        let both = (&looked_at(80.0), &looked_at(10.0));
        assert!(!recognises_as_much(both, |one, other| one == other || (one, other) == (2, 0)));
        assert!(recognises_as_much(both, |one, other| one == other), "the stranger alone would hide it");
    }
}
