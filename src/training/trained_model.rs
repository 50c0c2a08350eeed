//! A trained network, its card, and how it fares on what it never saw.

use super::clusters::{Class, Clusters};
use super::gathering::Gathered;
use super::standing::{Rivals, Standing, figure};
use crate::cnn::{ClassCard, DecisionCard, InputCard, ModelCard, TrainingCard};
use crate::onnx::{OnnxModel, STORAGE_KEY};

/// Experiences by which a class is found in another map.
const MOST_VIEWS: usize = 8;

/// What the card of every trained model says between its places and the images that the best epoch was chosen by.
const HOW: &str =
    " that BoW+HV and the CNN founded without labels; the best epoch chosen and the calibration fitted on ";
/// What a card says in its place of a backbone that was trained likewise.
const LIKEWISE: &str = ", likewise";
/// What stands before that which a card says of a backbone.
const BACKBONE: &str = "The backbone: ";

/// Where there was too little to fit a threshold on.
pub(super) const NOTHING_RECOGNISED: DecisionCard =
    DecisionCard { recognise_above: 1.0, calibration_slope: 0.0, calibration_offset: 0.0 };

/// A network and what is to be known of it.
#[derive(Clone, Debug)]
pub struct TrainedModel {
    /// The network; its weights take half the bytes.
    pub network: OnnxModel,
    /// Its card; the network's hash is not in it yet.
    pub card: ModelCard,
    /// How it stands on what was held out.
    pub standing: Standing,
    /// How those stand that it must do as well as.
    pub rivals: Rivals,
    /// Whether copies in other light were learnt and looked at, too.
    pub has_copies: bool,
}

impl TrainedModel {
    /// The model of `network`, which says `descriptors` of the images of `clusters` and must do as well as its
    /// `rivals`. `card` tells what the network is; decision, classes and figures are put into it.
    #[must_use]
    pub fn new(
        network: OnnxModel,
        card: ModelCard,
        clusters: &Clusters,
        (descriptors, rivals): (&Gathered, Rivals),
        has_copies: bool,
    ) -> Self {
        let copies = if has_copies { ", copies in other light included" } else { "" };
        let strangers = match descriptors.strangers.len() {
            0 => String::new(),
            count => format!(" and {count} of smaller places"),
        };
        let standing = Standing::of(descriptors, |one, other| clusters.is_near(one, other));
        let decision = standing.calibration.map(|calibration| DecisionCard {
            recognise_above: (calibration.threshold as f32).clamp(-1.0, 1.0),
            calibration_slope: calibration.slope as f32,
            calibration_offset: calibration.offset as f32,
        });
        let metrics = [
            ("held_out", &standing),
            ("held_out_before", &rivals.current),
            ("held_out_untrained", &rivals.prototypes),
        ];
        let card = ModelCard {
            decision: decision.unwrap_or(NOTHING_RECOGNISED),
            training: TrainingCard {
                data: format!(
                    "{} images of {} places{HOW}{} later ones{strangers}{copies}. {}",
                    descriptors.learnt.len(),
                    clusters.classes.len(),
                    descriptors.checked.len(),
                    card.training.data
                ),
            },
            metrics: metrics
                .into_iter()
                .map(|(name, standing)| (name.to_owned(), described(standing)))
                .collect(),
            classes: clusters.classes.iter().map(class_card).collect(),
            recipe: "loci train".to_owned(),
            ..card
        };
        Self { network: network.stored_as_half(), card, standing, rivals, has_copies }
    }

    /// Calls the model `name`, and has the network's file say for itself what the card says of it.
    pub fn call(&mut self, name: &str) {
        name.clone_into(&mut self.card.name);
        let ModelCard { name, version, licence, source, recipe, input, .. } = &self.card;
        let InputCard { width_px, height_px, mean, scale, .. } = input;
        let preprocessing =
            format!("RGB, stretched to {width_px} x {height_px}, (value - {mean}) * {scale}, channels first");
        let storage = if self.network.is_quantised() { "int8" } else { "float16" };
        let said = [
            ("name", name.as_str()),
            ("version", version),
            ("licence", licence),
            ("source", source),
            ("recipe", recipe),
            ("preprocessing", &preprocessing),
            (STORAGE_KEY, storage),
        ];
        said.into_iter().for_each(|(key, value)| self.network.describe(key, value));
    }

    /// Whether the model does as well on what was held out as the one that it is to take the place of, and as class
    /// means without any training.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        self.fault().is_none()
    }

    /// Why the model is not accepted, in a sentence about it.
    #[must_use]
    pub fn fault(&self) -> Option<String> {
        let Standing { recognised, mistaken, .. } = self.standing;
        if recognised == 0 {
            return Some("recognises nothing of what was held out".to_owned());
        }
        if recognised <= mistaken {
            return Some("mistakes as much of what was held out as it recognises".to_owned());
        }
        let Rivals { current, prototypes } = self.rivals;
        let rivals = [(current, "the one before"), (prototypes, "class means without any training")];
        let better = rivals.iter().filter(|(rival, _)| !self.standing.is_as_good_as(rival)).map(|it| it.1);
        let better = better.collect::<Vec<_>>().join(" and ");
        (!better.is_empty()).then(|| format!("does not do as well on what was held out as {better}"))
    }
}

/// What the card of a trained model says of its backbone, whose own card says `data` of what it learnt from. Of a
/// backbone that was trained likewise it says how many images and places, and not once more how.
pub(super) fn of_backbone(data: &str) -> String {
    let Some((images, rest)) = data.split_once(HOW) else { return format!("{BACKBONE}{data}") };
    let before = rest.split_once(". ").map_or("", |(_, before)| before);
    let before = before.strip_prefix(BACKBONE).unwrap_or(before);
    format!("{BACKBONE}{images}{LIKEWISE}; before that: {before}")
}

/// Figures for the card.
fn described(standing: &Standing) -> String {
    let (low, high) = standing.recall_interval();
    format!(
        "n {}: recall {:.3} ({low:.3} to {high:.3}) at precision {}; R@1 {:.3}",
        standing.asked,
        standing.recall(),
        figure(standing.precision()),
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
            [training]\ndata = 'made up'\n[metrics]\n";
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
        Gathered { learnt, checked, held_out, strangers: Labelled::new(WIDTH) }
    }

    fn rivals(gathered: &Gathered) -> Rivals {
        let standing = |gathered: &Gathered| Standing::of(gathered, |_, _| false);
        Rivals { current: standing(gathered), prototypes: standing(&gathered.by_prototypes()) }
    }

    fn model_of(head: &Head, gathered: &Gathered) -> TrainedModel {
        let (network, card) = head.grafted((backbone(), &card())).unwrap();
        let descriptors = gathered.projected(&head.projection);
        TrainedModel::new(network, card, &Clusters::default(), (&descriptors, rivals(gathered)), true)
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
    fn the_networks_file_says_of_itself_what_the_card_says_and_nothing_of_the_backbone() {
        let gathered = gathered();
        let head = trained_on(&gathered.learnt, &gathered.checked);
        let mut named = backbone();
        for (key, value) in [("name", "toy"), ("version", "7"), (STORAGE_KEY, "float32")] {
            named.describe(key, value);
        }
        let backbone_card = ModelCard { version: "7".to_owned(), ..card() };
        let (network, card) = head.grafted((named, &backbone_card)).unwrap();
        let descriptors = (&gathered.projected(&head.projection), rivals(&gathered));
        let mut model = TrainedModel::new(network, card, &Clusters::default(), descriptors, false);
        model.call("site");
        let read = OnnxModel::read(&model.network.to_bytes()).unwrap();
        for (key, value) in [
            ("name", "site"),
            ("version", "1"),
            ("licence", "MIT"),
            ("source", "backbone toy 7, SHA-256 "),
            ("recipe", "loci train"),
            ("preprocessing", "RGB, stretched to 16 x 16, (value - 100) * 0.01, channels first"),
            (STORAGE_KEY, "float16"),
        ] {
            assert_eq!(read.described(key), Some(value), "{key}");
        }
        let ModelCard { name, version, source, .. } = &model.card;
        assert_eq!([name, version, source], ["site", "1", "backbone toy 7, SHA-256 "]);
    }

    #[test]
    fn the_card_speaks_of_copies_where_there_were_some_and_says_once_how_a_retrained_backbone_was_trained() {
        let (head, mut model, gathered) = trained();
        let copies = "later ones, copies in other light included. The backbone: ";
        assert!(model.card.training.data.contains(copies), "{}", model.card.training.data);
        for has_copies in [false, true] {
            let (network, card) = head.grafted((backbone(), &model.card)).unwrap();
            let descriptors = (&gathered.projected(&head.projection), model.rivals);
            model = TrainedModel::new(network, card, &Clusters::default(), descriptors, has_copies);
            let data = &model.card.training.data;
            assert_eq!(data.matches("without labels").count(), 1, "{data}");
            assert_eq!(data.matches("The backbone").count(), 1, "{data}");
            assert_eq!(data.contains("copies"), has_copies, "{data}");
        }
        let ending = "The backbone: 90 images of 0 places, likewise; before that: 90 images of 0 places, likewise; \
                      before that: made up";
        assert!(model.card.training.data.ends_with(ending), "{}", model.card.training.data);
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
        let descriptors = (&wrong.projected(&head.projection), rivals(&gathered));
        let model = TrainedModel::new(network, card, &Clusters::default(), descriptors, false);
        assert!(!model.is_accepted(), "{:?} {:?}", model.standing, model.rivals);
    }

    #[test]
    fn a_model_is_accepted_that_does_as_well_as_the_one_before_and_as_class_means_or_says_why_not() {
        let (_, model, _) = trained();
        let standing = |recognised| Standing { recognised, mistaken: 1, ..model.standing };
        let fault = |own, before, untrained| {
            let rivals = Rivals { current: standing(before), prototypes: standing(untrained) };
            TrainedModel { standing: standing(own), rivals, ..model.clone() }.fault()
        };
        assert_eq!(fault(20, 20, 20), None);
        let not_as_well = "does not do as well on what was held out as";
        for (before, untrained, rivals) in [
            (21, 20, "the one before"),
            (20, 21, "class means without any training"),
            (21, 21, "the one before and class means without any training"),
        ] {
            assert_eq!(fault(20, before, untrained), Some(format!("{not_as_well} {rivals}")));
        }
        assert_eq!(fault(1, 0, 0).as_deref(), Some("mistakes as much of what was held out as it recognises"));
        assert_eq!(fault(0, 0, 0).as_deref(), Some("recognises nothing of what was held out"));
    }
}
