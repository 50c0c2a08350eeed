//! Trained heads as nodes of an ONNX graph.

use super::error::TrainingError;
use super::head::Head;
use super::trained_model::of_backbone;
use crate::cnn::{DescriptorCard, FusionCard, ModelCard, TrainingCard};
use crate::onnx::{Attribute, Dimension, GraphBuilder, OnnxError, OnnxModel, Value};

/// Name of the output that holds the descriptor, of unit length.
pub(super) const DESCRIPTOR: &str = "descriptor";
/// Name of the output that holds s · cos θ to every class.
const CLASS_SCORES: &str = "class_scores";

impl Head {
    /// The network of `backbone`, whose card is `card`, going on into the head, and its card.
    ///
    /// # Errors
    /// [`TrainingError::Onnx`] if the backbone takes no head.
    pub fn grafted(
        &self,
        (backbone, card): (OnnxModel, &ModelCard),
    ) -> Result<(OnnxModel, ModelCard), TrainingError> {
        let network = backbone.grafted(|graph| {
            let features = graph.value(&card.descriptor.name)?;
            self.add_to(graph, &features)
        })?;
        let (name, version, sha256) = (&card.name, &card.version, &card.sha256);
        let card = ModelCard {
            version: "1".to_owned(),
            description: format!("{name} with a head trained on {} places.", self.class_count()),
            source: format!("backbone {name} {version}, SHA-256 {sha256}"),
            descriptor: self.descriptor_card(),
            training: TrainingCard { data: of_backbone(&card.training.data) },
            fusion: FusionCard { data: of_backbone(&card.fusion.data), ..card.fusion.clone() },
            ..card.clone()
        };
        Ok((network, card))
    }

    pub(super) fn dimensions(&self) -> usize {
        self.projection.len() / self.width
    }

    pub(super) fn class_count(&self) -> usize {
        self.classes.len() / self.dimensions().max(1)
    }

    pub(super) fn descriptor_card(&self) -> DescriptorCard {
        DescriptorCard { name: DESCRIPTOR.to_owned(), dimensions: self.dimensions() }
    }

    /// Adds the head behind `features`, `[batch, width]`, with the outputs of every trained model.
    pub(super) fn add_to(&self, graph: &mut GraphBuilder, features: &Value) -> Result<(), OnnxError> {
        let (dimensions, classes) = (self.dimensions(), self.class_count());
        let features = unit(graph, features);
        let projection = graph.weight("head projection", &[self.width, dimensions], &self.projection);
        let projected = graph.node("MatMul", &[&features, &projection], &[]);
        let descriptor = unit(graph, &projected);
        graph.output(DESCRIPTOR, &descriptor, &[Dimension::Batch, Dimension::Fixed(dimensions)])?;
        let directions = transposed(&self.classes, dimensions);
        let directions = graph.weight("head classes", &[dimensions, classes], &directions);
        let cosines = graph.node("MatMul", &[&descriptor, &directions], &[]);
        let scale = graph.weight("head scale", &[1], &[self.scale]);
        let scores = graph.node("Mul", &[&cosines, &scale], &[]);
        graph.output(CLASS_SCORES, &scores, &[Dimension::Batch, Dimension::Fixed(classes)])
    }
}

/// Rows of unit length.
fn unit(graph: &mut GraphBuilder, rows: &Value) -> Value {
    graph.node("LpNormalization", &[rows], &[("axis", Attribute::Int(1)), ("p", Attribute::Int(2))])
}

/// `[rows, columns]` as `[columns, rows]`.
fn transposed(values: &[f32], columns: usize) -> Vec<f32> {
    let column = |column| values.iter().skip(column).step_by(columns).copied();
    (0..columns).flat_map(column).collect()
}
