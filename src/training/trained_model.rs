//! A backbone with a trained head: its network, its card, and how it fares on what it never saw.

use super::calibration::Calibration;
use super::clusters::{Class, Clusters};
use super::error::TrainingError;
use super::gathering::Gathered;
use super::head::Head;
use super::labelled::Labelled;
use crate::cnn::{ClassCard, DecisionCard, DescriptorCard, ModelCard, TrainingCard};
use crate::onnx::{Attribute, Dimension, GraphBuilder, OnnxError, OnnxModel};

/// Name of the output that holds the descriptor, of unit length.
const DESCRIPTOR: &str = "descriptor";
/// Name of the output that holds s · cos θ to every class.
const CLASS_SCORES: &str = "class_scores";
/// Experiences by which a class is found in another map.
const MOST_VIEWS: usize = 8;

/// A network and what is to be known of it.
#[derive(Clone, Debug)]
pub struct TrainedModel {
    /// The network.
    pub network: OnnxModel,
    /// Its card; the network's hash is not in it yet.
    pub card: ModelCard,
    /// Share of what was held out whose own class is the nearest.
    pub recall: f64,
    /// The same for the means of the classes by the backbone alone: what training must not fall below.
    pub untrained_recall: f64,
    /// Images that were held out.
    pub held_out: usize,
}

impl TrainedModel {
    /// The model of `backbone`, whose card is `card`, with `head`, which was trained on `gathered` of `clusters`.
    ///
    /// # Errors
    /// [`TrainingError::Onnx`] if the backbone takes no head.
    pub fn new(
        (backbone, card): (OnnxModel, &ModelCard),
        head: &Head,
        clusters: &Clusters,
        gathered: &Gathered,
    ) -> Result<Self, TrainingError> {
        let width = gathered.learnt.width();
        let network = grafted(backbone, &card.descriptor.name, head, width)?;
        let recall = gathered.held_out.projected(&head.projection).recall(&head.classes);
        let untrained_recall = gathered.held_out.recall(&gathered.learnt.prototypes());
        let mut trained = Self {
            network,
            card: described(card, head, clusters, gathered),
            recall,
            untrained_recall,
            held_out: gathered.held_out.len(),
        };
        let [recall, untrained] = [recall, untrained_recall].map(|share| format!("{share:.3}"));
        let count = trained.held_out;
        let metrics = [("held_out", recall), ("held_out_untrained", untrained)];
        let measured = |(name, value)| (str::to_owned(name), format!("n {count}: R@1 {value}"));
        trained.card.metrics = metrics.into_iter().map(measured).collect();
        Ok(trained)
    }

    /// Whether the model is at least as good as the backbone alone on what neither saw.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        self.held_out > 0 && self.recall >= self.untrained_recall
    }
}

/// The backbone whose value `features`, `[batch, width]`, goes on into the head.
fn grafted(backbone: OnnxModel, features: &str, head: &Head, width: usize) -> Result<OnnxModel, OnnxError> {
    let dimensions = head.projection.len() / width.max(1);
    let classes = head.classes.len() / dimensions.max(1);
    let mut network = backbone.grafted(|graph| {
        let features = graph.value(features)?;
        let features = unit(graph, &features);
        let projection = graph.weight("head projection", &[width, dimensions], &head.projection);
        let projected = graph.node("MatMul", &[&features, &projection], &[]);
        let descriptor = unit(graph, &projected);
        graph.output(DESCRIPTOR, &descriptor, &[Dimension::Batch, Dimension::Fixed(dimensions)])?;
        let directions = transposed(&head.classes, dimensions);
        let directions = graph.weight("head classes", &[dimensions, classes], &directions);
        let cosines = graph.node("MatMul", &[&descriptor, &directions], &[]);
        let scale = graph.weight("head scale", &[1], &[head.scale]);
        let scores = graph.node("Mul", &[&cosines, &scale], &[]);
        graph.output(CLASS_SCORES, &scores, &[Dimension::Batch, Dimension::Fixed(classes)])
    })?;
    network.describe("loci.head", &format!("{classes} classes, {dimensions} dimensions"));
    Ok(network)
}

/// Rows of unit length.
fn unit(graph: &mut GraphBuilder, rows: &crate::onnx::Value) -> crate::onnx::Value {
    graph.node("LpNormalization", &[rows], &[("axis", Attribute::Int(1)), ("p", Attribute::Int(2))])
}

/// `[rows, columns]` as `[columns, rows]`.
fn transposed(values: &[f32], columns: usize) -> Vec<f32> {
    let column = |column| values.iter().skip(column).step_by(columns).copied();
    (0..columns).flat_map(column).collect()
}

/// The card of the backbone with the head; its metrics are those of the backbone still.
fn described(backbone: &ModelCard, head: &Head, clusters: &Clusters, gathered: &Gathered) -> ModelCard {
    let learnt = gathered.learnt.projected(&head.projection);
    let is_near = |one: usize, other: usize| match (clusters.classes.get(one), clusters.classes.get(other)) {
        (Some(one), Some(other)) => one.is_near(other),
        _ => false,
    };
    let (same, other) = best_cosines(&gathered.checked.projected(&head.projection), &learnt, is_near);
    let decision = match Calibration::fit(&same, &other) {
        Some(Calibration { slope, offset, threshold }) => DecisionCard {
            recognise_above: (threshold as f32).clamp(-1.0, 1.0),
            calibration_slope: slope as f32,
            calibration_offset: offset as f32,
        },
        None => backbone.decision.clone(),
    };
    let (classes, images) = (clusters.classes.len(), gathered.learnt.len());
    ModelCard {
        description: format!("{} with a head trained on {classes} places.", backbone.name),
        source: format!("backbone {} {}, SHA-256 {}", backbone.name, backbone.version, backbone.sha256),
        recipe: "loci train".to_owned(),
        descriptor: DescriptorCard { name: DESCRIPTOR.to_owned(), dimensions: learnt.width() },
        decision,
        training: TrainingCard {
            data: format!(
                "{images} images of {classes} places that BoW+HV and the CNN founded without labels; best epoch {} \
                 chosen and calibration fitted on {} later ones. The backbone: {}",
                head.epoch,
                gathered.checked.len(),
                backbone.training.data
            ),
        },
        classes: clusters.classes.iter().map(class_card).collect(),
        ..backbone.clone()
    }
}

fn class_card(class: &Class) -> ClassCard {
    let samples = class.learnt.iter().filter(|sample| sample.view != 0);
    let step = (class.learnt.len() / MOST_VIEWS).max(1);
    let views = samples.step_by(step).take(MOST_VIEWS).map(|sample| format!("{:016x}", sample.view));
    ClassCard { place: class.place.0, name: class.name.clone(), views: views.collect() }
}

/// Of every vector that is asked about, the greatest cosine to one of its own class, and to one of any other that is
/// not near to it.
fn best_cosines(
    asked: &Labelled,
    known: &Labelled,
    is_near: impl Fn(usize, usize) -> bool,
) -> (Vec<f32>, Vec<f32>) {
    let (mut same, mut other) = (Vec::new(), Vec::new());
    for (index, &class) in asked.classes().iter().enumerate() {
        let vector = asked.vector(index);
        let (mut own, mut best) = (f32::MIN, f32::MIN);
        for (number, &known_class) in known.classes().iter().enumerate() {
            let cosine: f32 = known.vector(number).iter().zip(vector).map(|(a, b)| a * b).sum();
            if known_class == class {
                own = own.max(cosine);
            } else if !is_near(class, known_class) {
                best = best.max(cosine);
            }
        }
        same.extend((own > f32::MIN).then_some(own));
        other.extend((best > f32::MIN).then_some(best));
    }
    (same, other)
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::cnn::{CARD_FILE, DescriptorModel, MODEL_FILE, installed_runtime, save_model};
    use crate::raster::RgbImage;
    use crate::training::{Device, Head, HeadOptions};

    const WIDTH: usize = 6;

    /// A backbone that gives means of the planes and their squares.
    fn backbone() -> OnnxModel {
        let mut graph = GraphBuilder::new("backbone");
        let side = Dimension::Fixed(16);
        let image = graph.input("image", &[Dimension::Batch, Dimension::Fixed(3), side, side]);
        let pooled = graph.node("GlobalAveragePool", &[&image], &[]);
        let means = graph.node("Flatten", &[&pooled], &[("axis", Attribute::Int(1))]);
        let squares = graph.node("Mul", &[&means, &means], &[]);
        let both = graph.node("Concat", &[&means, &squares], &[("axis", Attribute::Int(1))]);
        graph.output(DESCRIPTOR, &both, &[Dimension::Batch, Dimension::Fixed(WIDTH)]).unwrap();
        graph.finish()
    }

    fn card() -> ModelCard {
        let card = "name = 'toy'\nversion = '1'\ndescription = ''\nlicence = 'MIT'\n\
            source = ''\nrecipe = ''\nsha256 = ''\n\
            [input]\nname = 'image'\nwidth_px = 16\nheight_px = 16\nmean = 100.0\nscale = 0.01\n\
            [descriptor]\nname = 'descriptor'\ndimensions = 6\n\
            [decision]\nrecognise_above = 0.5\ncalibration_slope = 1.0\ncalibration_offset = 0.0\n\
            [training]\ndata = ''\n[metrics]\n";
        toml::from_str(card).unwrap()
    }

    /// What the backbone says of an image of one colour.
    fn features(colour: [u8; 3]) -> Vec<f32> {
        let means = colour.map(|value| (f32::from(value) - 100.0) * 0.01);
        means.into_iter().chain(means.map(|mean| mean * mean)).collect()
    }

    /// Images of three colours, a little different each time.
    fn gathered() -> Gathered {
        let mut random = Pcg64::seed_from_u64(3);
        let mut parts = [90, 30, 30].map(|count| {
            let mut labelled = Labelled::new(WIDTH);
            for index in 0..count {
                let class = index % 3;
                let mut colour = [90, 110, 100];
                colour[class] += 60;
                colour.iter_mut().for_each(|value| *value += random.random_range(0..30));
                labelled.push(&features(colour), class);
            }
            labelled
        });
        let [learnt, checked, held_out] =
            parts.each_mut().map(|part| std::mem::replace(part, Labelled::new(WIDTH)));
        Gathered { learnt, checked, held_out, skipped: 0 }
    }

    fn trained() -> (Head, TrainedModel, Gathered) {
        let gathered = gathered();
        let options = HeadOptions { dimensions: 4, epochs: 5, ..HeadOptions::default() };
        let mut go_on = |_| ControlFlow::Continue(());
        let head = Head::train(&gathered.learnt, &gathered.checked, &options, &Device::flex(), &mut go_on);
        let head = head.unwrap();
        let model = TrainedModel::new((backbone(), &card()), &head, &Clusters::default(), &gathered).unwrap();
        (head, model, gathered)
    }

    #[test]
    fn the_network_computes_what_was_trained_and_says_so_in_its_card() {
        let (head, mut model, _) = trained();
        assert_eq!(model.network.outputs().collect::<Vec<_>>(), [DESCRIPTOR, CLASS_SCORES]);
        assert!(model.is_accepted() && model.recall > 0.9, "{}", model.recall);
        assert_eq!(model.card.metrics["held_out"], format!("n 30: R@1 {:.3}", model.recall));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site");
        save_model(&path, &mut model.card, &model.network.to_bytes()).unwrap();
        assert!(path.join(CARD_FILE).exists() && path.join(MODEL_FILE).exists());
        let Some(runtime) = installed_runtime() else { return };
        let mut opened = DescriptorModel::open(&path, &runtime, 1).unwrap();
        for colour in [[200, 10, 30], [101, 99, 180], [90, 170, 100]] {
            let image = RgbImage::from_pixels(4, 4, colour.repeat(16)).unwrap();
            let mut expected = Labelled::new(WIDTH);
            expected.push(&features(colour), 0);
            let expected = expected.projected(&head.projection);
            let got = opened.describe(&image).unwrap();
            for (got, expected) in got.as_slice().iter().zip(expected.vector(0)) {
                assert!((got - expected).abs() < 1e-4, "{got} for {expected}");
            }
        }
    }

    #[test]
    fn a_model_that_recognises_less_than_its_backbone_alone_is_not_accepted() {
        let (head, _, gathered) = trained();
        let mut turned = head;
        // Every direction is that of another class.
        turned.classes.rotate_left(4);
        let model =
            TrainedModel::new((backbone(), &card()), &turned, &Clusters::default(), &gathered).unwrap();
        assert!(!model.is_accepted() && model.recall < model.untrained_recall);
    }

    #[test]
    fn the_threshold_lies_above_what_other_classes_reach() {
        let (head, model, gathered) = trained();
        let learnt = gathered.learnt.projected(&head.projection);
        let (same, other) =
            best_cosines(&gathered.checked.projected(&head.projection), &learnt, |_, _| false);
        assert_eq!((same.len(), other.len()), (30, 30));
        let DecisionCard { recognise_above, calibration_slope, .. } = model.card.decision;
        assert!(other.iter().all(|&cosine| cosine <= recognise_above) && calibration_slope > 0.0);
    }
}
