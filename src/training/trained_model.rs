//! A trained network, its card, and how it fares on what it never saw.

use super::clusters::{Class, Clusters};
use super::gathering::Gathered;
use super::standing::Standing;
use crate::cnn::{ClassCard, DecisionCard, ModelCard, TrainingCard};
use crate::onnx::OnnxModel;

/// Experiences by which a class is found in another map.
const MOST_VIEWS: usize = 8;

/// Where there was too little to fit a threshold on.
pub(super) const NOTHING_RECOGNISED: DecisionCard =
    DecisionCard { recognise_above: 1.0, calibration_slope: 0.0, calibration_offset: 0.0 };

/// A network and what is to be known of it.
#[derive(Clone, Debug)]
pub struct TrainedModel {
    /// The network.
    pub network: OnnxModel,
    /// Its card; the network's hash is not in it yet.
    pub card: ModelCard,
    /// How it stands on what was held out.
    pub standing: Standing,
    /// How the model stands that it is to take the place of.
    pub current: Standing,
}

impl TrainedModel {
    /// The model of `network`, which says `descriptors` of the images of `clusters`; the one that it is to take the
    /// place of stands like `current`. `card` tells what the network is; decision, classes and figures are put into
    /// it.
    #[must_use]
    pub fn new(
        network: OnnxModel,
        card: ModelCard,
        clusters: &Clusters,
        (descriptors, current): (&Gathered, Standing),
    ) -> Self {
        let standing = Standing::of(descriptors, |one, other| clusters.is_near(one, other));
        let decision = standing.calibration.map(|calibration| DecisionCard {
            recognise_above: (calibration.threshold as f32).clamp(-1.0, 1.0),
            calibration_slope: calibration.slope as f32,
            calibration_offset: calibration.offset as f32,
        });
        let metrics = [("held_out", described(&standing)), ("held_out_before", described(&current))];
        let card = ModelCard {
            decision: decision.unwrap_or(NOTHING_RECOGNISED),
            training: TrainingCard {
                data: format!(
                    "{} images of {} places that BoW+HV and the CNN founded without labels; the best epoch chosen and \
                     the calibration fitted on {} later ones, copies in other light included. {}",
                    descriptors.learnt.len(),
                    clusters.classes.len(),
                    descriptors.checked.len(),
                    card.training.data
                ),
            },
            metrics: metrics.into_iter().map(|(name, figures)| (name.to_owned(), figures)).collect(),
            classes: clusters.classes.iter().map(class_card).collect(),
            recipe: "loci train".to_owned(),
            ..card
        };
        Self { network, card, standing, current }
    }

    /// Whether the model does as well on what was held out as the one that it is to take the place of: it recognises as
    /// much, what it mistakes taken off, and more than it mistakes.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        let balance = |standing: &Standing| standing.recognised as i64 - standing.mistaken as i64;
        let (own, before) = (balance(&self.standing), balance(&self.current));
        own > 0 && own >= before && self.standing.recognised >= self.current.recognised
    }
}

/// Figures for the card.
fn described(standing: &Standing) -> String {
    let (low, high) = standing.recall_interval();
    format!(
        "n {}: recall {:.3} ({low:.3} to {high:.3}) at precision {:.3}; R@1 {:.3}",
        standing.asked,
        standing.recall(),
        standing.precision(),
        standing.recall_at_one()
    )
}

fn class_card(class: &Class) -> ClassCard {
    let samples = class.learnt.iter().filter(|sample| sample.view != 0 && !sample.is_joined);
    let step = (class.learnt.len() / MOST_VIEWS).max(1);
    let views = samples.step_by(step).take(MOST_VIEWS).map(|sample| format!("{:016x}", sample.view));
    ClassCard { place: class.place.0, name: class.name.clone(), views: views.collect() }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::cnn::{CARD_FILE, DescriptorModel, MODEL_FILE, installed_runtime, save_model};
    use crate::onnx::{Attribute, Dimension, GraphBuilder};
    use crate::raster::RgbImage;
    use crate::training::graph::DESCRIPTOR;
    use crate::training::{Device, FitOptions, Head, Labelled};

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
        Gathered { learnt, checked, held_out }
    }

    fn model_of(head: &Head, gathered: &Gathered) -> TrainedModel {
        let (network, card) = head.grafted((backbone(), &card())).unwrap();
        let (descriptors, current) =
            (gathered.projected(&head.projection), Standing::of(gathered, |_, _| false));
        TrainedModel::new(network, card, &Clusters::default(), (&descriptors, current))
    }

    fn trained_on(learnt: &Labelled, checked: &Labelled) -> Head {
        let options = FitOptions { epochs: 5, ..FitOptions::default() };
        let mut go_on = |_| ControlFlow::Continue(());
        Head::train((learnt, checked), 4, &options, (&Device::flex(), None), &mut go_on).unwrap()
    }

    fn trained() -> (Head, TrainedModel, Gathered) {
        let gathered = gathered();
        let head = trained_on(&gathered.learnt, &gathered.checked);
        let model = model_of(&head, &gathered);
        (head, model, gathered)
    }

    #[test]
    fn the_network_computes_what_was_trained_and_says_so_in_its_card() {
        let (head, mut model, _) = trained();
        assert_eq!(model.network.outputs().collect::<Vec<_>>(), [DESCRIPTOR, "class_scores"]);
        assert!(model.standing.recall_at_one() > 0.9, "{:?}", model.standing);
        assert!(model.card.metrics["held_out"].starts_with("n 30: recall "), "{:?}", model.card.metrics);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site");
        save_model(&path, &mut model.card, &model.network.to_bytes(), "").unwrap();
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
    fn a_model_trained_on_shuffled_labels_is_not_accepted() {
        let gathered = gathered();
        // Each vector is learnt as one of any class, by chance.
        let mut random = Pcg64::seed_from_u64(9);
        let shuffled = |labelled: &Labelled, random: &mut Pcg64| {
            let mut shuffled = Labelled::new(WIDTH);
            for index in 0..labelled.len() {
                shuffled.push(labelled.vector(index), random.random_range(0..3));
            }
            shuffled
        };
        let learnt = shuffled(&gathered.learnt, &mut random);
        let wrong = Gathered { learnt: learnt.clone(), ..gathered.clone() };
        let head = trained_on(&learnt, &gathered.checked);
        // Judged by what it would know of the places: what it was taught.
        let (network, card) = head.grafted((backbone(), &card())).unwrap();
        let descriptors = wrong.projected(&head.projection);
        let current = Standing::of(&gathered, |_, _| false);
        let model = TrainedModel::new(network, card, &Clusters::default(), (&descriptors, current));
        assert!(!model.is_accepted(), "{:?} {:?}", model.standing, model.current);
    }

    #[test]
    fn a_model_that_recognises_nothing_is_not_accepted_even_where_the_one_before_does_neither() {
        let (_, model, _) = trained();
        let nothing = Standing { recognised: 0, mistaken: 0, ..model.standing };
        let blind = TrainedModel { standing: nothing, current: nothing, ..model.clone() };
        assert!(!blind.is_accepted());
        let as_good = TrainedModel { current: model.standing, ..model.clone() };
        assert!(as_good.standing.recognised > 0 && as_good.is_accepted());
        // Neither where it is wrong more often than right, nor where it is wrong more often than the one before.
        let wild = Standing { recognised: 3, mistaken: 4, ..nothing };
        assert!(!TrainedModel { standing: wild, current: wild, ..model.clone() }.is_accepted());
        let surer = Standing { recognised: 20, mistaken: 1, ..nothing };
        let bolder = Standing { recognised: 22, mistaken: 5, ..nothing };
        assert!(!TrainedModel { standing: bolder, current: surer, ..model }.is_accepted());
    }
}
