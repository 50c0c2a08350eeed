//! In how many bits a trained model computes.

use loci::cnn::{DescriptorModel, ModelCard};
use loci::onnx::{OnnxError, OnnxModel};
use loci::training::{
    Agreement, Clusters, Gathered, Pictures, Standing, TrainedModel, TrainingError, agreement, in_all_light,
    quantise,
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

impl Candidate {
    fn judged(self, clusters: &Clusters, current: Standing) -> TrainedModel {
        TrainedModel::new(self.network, self.card, clusters, (&self.descriptors, current))
    }
}

impl Trainer<'_> {
    /// `candidate` in the precision that is wanted: if nothing is said, in 8 bits where that recognises as much, give
    /// or take what chance may do.
    pub(super) fn in_precision(
        &self,
        candidate: Candidate,
        (pictures, clusters): (&Pictures<'_>, &Clusters),
        current: Standing,
    ) -> anyhow::Result<(TrainedModel, Precision)> {
        let wanted = self.arguments.precision;
        if wanted == Precision::F32 {
            return Ok((candidate.judged(clusters, current), Precision::F32));
        }
        let (int8, agreed) = match self.in_eight_bits(&candidate, pictures) {
            Ok(int8) => int8,
            Err(error) if wanted == Precision::Auto && is_unfit(&error) => {
                return Ok((candidate.judged(clusters, current), Precision::F32));
            }
            Err(error) => return Err(error),
        };
        // By what training may look at: what is held out chooses nothing.
        let recognises_as_much = {
            let of = |candidate: &Candidate| {
                Standing::of(&candidate.descriptors.checked_as_held_out(), |a, b| a == b)
            };
            of(&int8).recall() >= of(&candidate).recall_interval().0
        };
        let mut int8 = int8.judged(clusters, current);
        if wanted == Precision::Auto && !(recognises_as_much && int8.is_accepted()) {
            return Ok((candidate.judged(clusters, current), Precision::F32));
        }
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
        let int8 = quantise(network, card, &self.runtime, images)?;
        let open =
            |network: &OnnxModel| DescriptorModel::from_onnx(card, &network.to_bytes(), &self.runtime, 2);
        let (mut model, mut whole) = (open(&int8)?, open(network)?);
        let step = pictures.checked.len().div_ceil(RANGE_IMAGES).max(1);
        let images = pictures.checked.iter().step_by(step).filter_map(|&at| pictures.image(at).transpose());
        let agreed = agreement(&mut whole, &mut model, images)?;
        let descriptors = self.gathered(pictures, &mut model)?;
        Ok((Candidate { network: int8, card: card.clone(), descriptors }, agreed))
    }
}

/// Whether the network itself, or a lack of images, stands in the way of 8 bits.
fn is_unfit(error: &anyhow::Error) -> bool {
    let unfit = error.downcast_ref::<TrainingError>();
    matches!(unfit, Some(TrainingError::Onnx(OnnxError::NothingToQuantise) | TrainingError::NoImages))
}
