//! The paper's CNN: three convolutions and a fully connected layer, trained from nothing.
//!
//! 16, 32 and 64 filters of 2 × 2, a ReLU after each, on images of 224 × 224 (section IV of the paper). What it
//! leaves open: each image is brought to mean 0 and deviation 1, so that light that is only brighter tells nothing;
//! after each ReLU a maximum over 2 × 2, and a mean over 3 × 3 after the last, without which the fully connected
//! layer would have three million inputs; that layer makes the descriptor, and the classes are directions for it as
//! those of any head.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::module::{avg_pool2d, conv2d, max_pool2d};
use burn::tensor::ops::{AvgPoolOptions, ConvOptions, MaxPoolOptions};
use burn::tensor::{Device, Tensor, TensorData};
use rand::Rng;
use rand_pcg::Pcg64;

use super::checkpoint::Checkpoint;
use super::error::TrainingError;
use super::fitting::{FitOptions, Fitted, Lesson, Step, fit};
use super::head::{Head, HeadNetwork, values};
use super::labelled::{Glance, Labelled};
use super::pictures::{Picture, Pictures};
use super::trained_model::NOTHING_RECOGNISED;
use super::variation::Variation;
use crate::cnn::{FusionCard, InputCard, ModelCard, Preprocessor, TrainingCard};
use crate::onnx::{Attribute, Dimension, GraphBuilder, OnnxModel, Value};
use crate::raster::RgbImage;

/// Pixels of a side of an image.
const SIDE_PX: usize = 224;
/// Filters of each convolution.
const FILTERS: [usize; 3] = [16, 32, 64];
/// Values of a side of what the last pooling leaves: 224 → 223 → 111 → 110 → 55 → 54 → 27 → 9.
const LAST_SIDE: usize = 9;
/// Values of an image after the last pooling.
const WIDTH: usize = FILTERS[2] * LAST_SIDE * LAST_SIDE;
/// Keeps an image of one colour from being divided by nothing.
const LEAST_VARIANCE: f32 = 1e-6;
/// Images that are looked at together.
const CHECKED_AT_ONCE: usize = 12;

/// What may be settled of a training of the paper's CNN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperOptions {
    /// Values of a descriptor.
    pub dimensions: usize,
    /// How it is trained.
    pub fit: FitOptions,
}

impl Default for PaperOptions {
    fn default() -> Self {
        let fit = FitOptions { epochs: 15, batch: 32, learning_rate: 1e-3, ..FitOptions::default() };
        Self { dimensions: 256, fit }
    }
}

/// The paper's CNN, trained.
#[derive(Clone, Debug)]
pub struct PaperCnn {
    /// The convolutions, first to last.
    pub convolutions: Vec<Filters>,
    /// The fully connected layer and the directions of the classes.
    pub head: Head,
    network: Network,
    device: Device,
}

/// The filters of a convolution.
#[derive(Clone, Debug, PartialEq)]
pub struct Filters {
    /// `[filters, channels, 2, 2]`
    pub weights: Vec<f32>,
    /// `[filters]`
    pub biases: Vec<f32>,
}

impl Filters {
    fn shape(&self) -> [usize; 4] {
        let count = self.biases.len();
        [count, self.weights.len() / count.max(1) / 4, 2, 2]
    }
}

#[derive(Module, Debug)]
struct Convolution {
    /// `[filters, channels, 2, 2]`
    weight: Param<Tensor<4>>,
    /// `[filters]`
    bias: Param<Tensor<1>>,
}

#[derive(Module, Debug)]
struct Network {
    convolutions: Vec<Convolution>,
    head: HeadNetwork,
}

impl Network {
    fn new(convolutions: &[Filters], head: &Head, device: &Device) -> Self {
        let convolution = |filters: &Filters| {
            let weight = TensorData::new(filters.weights.clone(), filters.shape());
            let bias = TensorData::new(filters.biases.clone(), [filters.biases.len()]);
            Convolution {
                weight: Param::from_tensor(Tensor::from_data(weight, device)),
                bias: Param::from_tensor(Tensor::from_data(bias, device)),
            }
        };
        let convolutions = convolutions.iter().map(convolution).collect();
        let head = HeadNetwork::new(&head.projection, &head.classes, head.dimensions(), device);
        Self { convolutions, head }
    }

    /// What the last pooling leaves of `images`, `[n, 3, 224, 224]`: `[n, WIDTH]`.
    fn features(&self, images: Tensor<4>) -> Tensor<2> {
        let mut maps = normalised(images);
        for Convolution { weight, bias } in &self.convolutions {
            let options = ConvOptions::new([1; 2], [0; 2], [1; 2], 1);
            let filtered = relu(conv2d(maps, weight.val(), Some(bias.val()), options));
            maps = max_pool2d(filtered, MaxPoolOptions::new([2; 2]));
        }
        avg_pool2d(maps, AvgPoolOptions::new([3; 2])).flatten(1, 3)
    }
}

/// Each image with mean 0 and deviation 1.
fn normalised(images: Tensor<4>) -> Tensor<4> {
    let mean = |values: Tensor<4>| values.mean_dim(1).mean_dim(2).mean_dim(3);
    let centred = images.clone() - mean(images);
    let deviation = mean(centred.clone().powi_scalar(2)).add_scalar(LEAST_VARIANCE).sqrt();
    centred / deviation
}

/// What goes in: RGB planes of values from 0 to 1.
fn input_card() -> InputCard {
    InputCard {
        name: "image".to_owned(),
        width_px: SIDE_PX,
        height_px: SIDE_PX,
        mean: 0.0,
        scale: 1.0 / 255.0,
    }
}

/// `images` as `[n, 3, 224, 224]`.
fn tensor(images: &[RgbImage], device: &Device) -> Result<Tensor<4>, TrainingError> {
    let mut preprocessor = Preprocessor::new(&input_card());
    let mut values = Vec::with_capacity(images.len() * 3 * SIDE_PX * SIDE_PX);
    for image in images {
        values.extend_from_slice(preprocessor.tensor(image)?);
    }
    Ok(Tensor::from_data(TensorData::new(values, [images.len(), 3, SIDE_PX, SIDE_PX]), device))
}

impl PaperCnn {
    /// Trains on `pictures` of `classes` classes, each varied anew each time that it is learnt; of all epochs the one
    /// is kept after which most of what is only looked at is recognised. `progress` hears of every epoch and may end
    /// the training early, with the best one so far.
    ///
    /// # Errors
    /// [`TrainingError::TooFewClasses`] or [`TrainingError::NotFinite`], or if a map or the checkpoint fails.
    pub fn train(
        (pictures, variation): (&Pictures<'_>, &Variation),
        classes: usize,
        options: &PaperOptions,
        (device, checkpoint): (&Device, Option<&Checkpoint>),
        progress: &mut dyn FnMut(Step) -> ControlFlow<()>,
    ) -> Result<Self, TrainingError> {
        if classes < 2 {
            return Err(TrainingError::TooFewClasses { classes });
        }
        let (convolutions, head) = untrained(classes, options);
        let lesson = PictureLesson {
            pictures,
            classes: pictures.learnt.iter().map(|picture| picture.class).collect(),
            variation,
            options,
            device: device.clone().autodiff(),
        };
        let start = Network::new(&convolutions, &head, &lesson.device);
        let Fitted { network, epoch, glance, epochs } =
            fit(&lesson, start, &options.fit, checkpoint, progress)?;
        let filters = |Convolution { weight, bias }: &Convolution| {
            Ok(Filters { weights: values(weight.val())?, biases: values(bias.val())? })
        };
        let convolutions = network.convolutions.iter().map(filters).collect::<Result<_, TrainingError>>()?;
        let (projection, directions) = network.head.matrices()?;
        let head = Head { projection, classes: directions, epoch, recall: glance.recall, epochs, ..head };
        Ok(Self::new(convolutions, head, device))
    }

    fn new(convolutions: Vec<Filters>, head: Head, device: &Device) -> Self {
        let network = Network::new(&convolutions, &head, device);
        Self { convolutions, head, network, device: device.clone() }
    }

    /// The descriptor of an image, of unit length.
    ///
    /// # Errors
    /// If the image has no pixels or the device fails.
    pub fn describe(&self, image: &RgbImage) -> Result<Vec<f32>, TrainingError> {
        let features = self.network.features(tensor(std::slice::from_ref(image), &self.device)?);
        values(self.network.head.descriptors(features))
    }

    /// The network and what its card says of it.
    ///
    /// # Errors
    /// [`TrainingError::Onnx`], a defect of ours.
    pub fn to_onnx(&self) -> Result<(OnnxModel, ModelCard), TrainingError> {
        let mut graph = GraphBuilder::new("paper");
        let side = Dimension::Fixed(SIDE_PX);
        let image = graph.input(&input_card().name, &[Dimension::Batch, Dimension::Fixed(3), side, side]);
        let mut maps = add_normalisation(&mut graph, &image);
        for filters in &self.convolutions {
            let weight = graph.weight("filters", &filters.shape(), &filters.weights);
            let bias = graph.weight("biases", &[filters.biases.len()], &filters.biases);
            let filtered = graph.node("Conv", &[&maps, &weight, &bias], &[]);
            let positive = graph.node("Relu", &[&filtered], &[]);
            maps = graph.node("MaxPool", &[&positive], &square(2));
        }
        let pooled = graph.node("AveragePool", &[&maps], &square(3));
        let features = graph.node("Flatten", &[&pooled], &[("axis", Attribute::Int(1))]);
        self.head.add_to(&mut graph, &features)?;
        Ok((graph.finish(), self.card()))
    }

    fn card(&self) -> ModelCard {
        ModelCard {
            name: "paper".to_owned(),
            version: "1".to_owned(),
            description: format!(
                "Three convolutions and a fully connected layer, trained from nothing on {} places.",
                self.head.class_count()
            ),
            licence: "NOASSERTION".to_owned(),
            source: "trained here".to_owned(),
            recipe: String::new(),
            sha256: String::new(),
            input: input_card(),
            descriptor: self.head.descriptor_card(),
            decision: NOTHING_RECOGNISED,
            fusion: FusionCard::default(),
            training: TrainingCard { data: "No other images.".to_owned() },
            metrics: BTreeMap::new(),
            classes: Vec::new(),
        }
    }
}

/// Kernel and stride of a pooling over squares of that side.
fn square(side: i64) -> [(&'static str, Attribute); 2] {
    [("kernel_shape", Attribute::Ints(vec![side; 2])), ("strides", Attribute::Ints(vec![side; 2]))]
}

/// Each image with mean 0 and deviation 1.
fn add_normalisation(graph: &mut GraphBuilder, images: &Value) -> Value {
    let axes = [("axes", Attribute::Ints(vec![1, 2, 3])), ("keepdims", Attribute::Int(1))];
    let mean = graph.node("ReduceMean", &[images], &axes);
    let centred = graph.node("Sub", &[images, &mean], &[]);
    let squares = graph.node("Mul", &[&centred, &centred], &[]);
    let variance = graph.node("ReduceMean", &[&squares], &axes);
    let least = graph.weight("least variance", &[1], &[LEAST_VARIANCE]);
    let variance = graph.node("Add", &[&variance, &least], &[]);
    let deviation = graph.node("Sqrt", &[&variance], &[]);
    graph.node("Div", &[&centred, &deviation], &[])
}

/// Filters by He et al. ("Delving Deep into Rectifiers", ICCV 2015), and a head, all drawn.
fn untrained(classes: usize, options: &PaperOptions) -> (Vec<Filters>, Head) {
    let mut random = Pcg64::new(u128::from(options.fit.seed), 0);
    let mut drawn = |count: usize, most: f32| -> Vec<f32> {
        (0..count).map(|_| random.random_range(-most..most)).collect()
    };
    let mut channels = 3;
    let convolutions = FILTERS.map(|filters| {
        let fan_in = 4 * channels;
        channels = filters;
        let weights = drawn(filters * fan_in, (6.0 / fan_in as f32).sqrt());
        Filters { weights, biases: vec![0.0; filters] }
    });
    let head = Head {
        width: WIDTH,
        projection: drawn(WIDTH * options.dimensions, (3.0 / WIDTH as f32).sqrt()),
        classes: drawn(classes * options.dimensions, 1.0),
        scale: options.fit.loss.scale(),
        epoch: 0,
        recall: 0.0,
        epochs: Vec::new(),
    };
    (convolutions.into(), head)
}

/// Images in maps, of which the whole CNN is to make something.
struct PictureLesson<'a> {
    pictures: &'a Pictures<'a>,
    /// Of what is learnt.
    classes: Vec<usize>,
    variation: &'a Variation,
    options: &'a PaperOptions,
    device: Device,
}

impl PictureLesson<'_> {
    fn image(&self, picture: Picture) -> Result<RgbImage, TrainingError> {
        self.pictures.image(picture)
    }
}

impl Lesson for PictureLesson<'_> {
    type Network = Network;

    fn classes(&self) -> &[usize] {
        &self.classes
    }

    fn cosines(
        &self,
        network: &Network,
        batch: &[usize],
        random: &mut Pcg64,
    ) -> Result<Tensor<2>, TrainingError> {
        let images =
            batch.iter().map(|&index| self.variation.vary(&self.image(self.pictures.learnt[index])?, random));
        let images = images.collect::<Result<Vec<_>, TrainingError>>()?;
        Ok(network.head.cosines(network.features(tensor(&images, &self.device)?)))
    }

    /// Each image as it is and, where they are varied, as it might look another time: the same one after every epoch.
    fn glance(&self, network: &Network) -> Result<Glance, TrainingError> {
        let (projection, directions) = network.head.matrices()?;
        let mut features = Labelled::new(WIDTH);
        let mut random = Pcg64::new(u128::from(self.options.fit.seed), u128::MAX);
        for part in self.pictures.checked.chunks(CHECKED_AT_ONCE) {
            let mut images =
                part.iter().map(|&picture| self.image(picture)).collect::<Result<Vec<_>, _>>()?;
            if !self.variation.is_none() {
                let varied = images.iter().map(|image| self.variation.vary(image, &mut random));
                let varied = varied.collect::<Result<Vec<_>, _>>()?;
                images.extend(varied);
            }
            let values = values(network.features(tensor(&images, &self.device)?))?;
            for (vector, picture) in values.chunks_exact(WIDTH).zip(part.iter().cycle()) {
                features.push(vector, picture.class);
            }
        }
        let projected = features.projected(&projection);
        let glance = projected.glance(&directions, self.options.fit.loss.scale());
        Ok(glance.of_all((projected.len(), features.len())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cnn::{DescriptorModel, installed_runtime, save_model};
    use crate::place_map::PlaceMap;
    use crate::source::thumbnail_jpeg;
    use crate::training::scripted_map::scripted_map;
    use crate::training::{ClusterRules, Clusters, Gathered};

    /// Stripes that lie otherwise in every class, in a light of their own.
    fn image(class: usize, random: &mut Pcg64) -> RgbImage {
        let light = random.random_range(0.2..1.0_f32);
        let phase = random.random_range(0..8);
        let pixel = |x: usize, y: usize| {
            let along = [x, y, x + y][class] + phase;
            let value = if (along / 8).is_multiple_of(2) { 200.0 } else { 60.0 };
            (value * light) as u8
        };
        let pixels = (0..64 * 64).flat_map(|at| [pixel(at % 64, at / 64); 3]).collect();
        RgbImage::from_pixels(64, 64, pixels).unwrap()
    }

    /// A map of three places that were seen so many times each.
    fn map(times: usize) -> PlaceMap {
        let mut random = Pcg64::new(1, 1);
        scripted_map(&[times; 3], |class| thumbnail_jpeg(&image(class, &mut random)))
    }

    fn go_on() -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn train(pictures: &Pictures<'_>, seed: u64) -> PaperCnn {
        let fit = FitOptions { epochs: 4, batch: 8, learning_rate: 3e-3, seed, ..FitOptions::default() };
        let options = PaperOptions { dimensions: 16, fit };
        let pictures = (pictures, &Variation::default());
        PaperCnn::train(pictures, 3, &options, (&Device::flex(), None), &mut |_| go_on()).unwrap()
    }

    #[test]
    fn the_papers_cnn_learns_places_in_changing_light_and_onnx_runtime_computes_what_it_does() {
        let map = map(12);
        let maps = [&map];
        let rules = ClusterRules { min_samples: 6, ..ClusterRules::default() };
        let mut clusters = Clusters::of(&maps, &rules).unwrap();
        let pictures = Pictures::of(&maps, &mut clusters, &mut go_on).unwrap();
        assert_eq!((pictures.len(), pictures.held_out.len()), (36, 9));
        let cnn = train(&pictures, 0);
        let mut describe = |image: &RgbImage| cnn.describe(image).map(Some);
        let descriptors = Gathered::of(&pictures, 16, &mut describe, &mut go_on).unwrap();
        assert!(descriptors.held_out.recall(&cnn.head.classes) > 0.8, "{:?}", cnn.head.epochs);
        let Some(runtime) = installed_runtime() else { return };
        let (network, mut card) = cnn.to_onnx().unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("paper");
        save_model(&path, &mut card, &network.to_bytes(), "").unwrap();
        let mut opened = DescriptorModel::open(&path, &runtime, 1).unwrap();
        let half = network.stored_as_half().to_bytes();
        let mut half = DescriptorModel::from_onnx(&card, &half, &runtime, 1).unwrap();
        let grey = RgbImage::new(40, 30);
        for image in [image(0, &mut Pcg64::new(7, 7)), image(2, &mut Pcg64::new(8, 8)), grey] {
            let (got, expected) = (opened.describe(&image), cnn.describe(&image).unwrap());
            let got = got.unwrap();
            assert!(got.cosine(&half.describe(&image).unwrap()) > 0.9999);
            for (got, expected) in got.as_slice().iter().zip(expected) {
                assert!((got - expected).abs() < 1e-4, "{got} for {expected}");
            }
        }
    }

    #[test]
    fn the_same_seed_trains_the_same_cnn_and_one_place_alone_is_nothing_to_learn() {
        let map = map(6);
        let maps = [&map];
        let rules = ClusterRules { min_samples: 6, ..ClusterRules::default() };
        let mut clusters = Clusters::of(&maps, &rules).unwrap();
        let pictures = Pictures::of(&maps, &mut clusters, &mut go_on).unwrap();
        let (one, same, other) = (train(&pictures, 0), train(&pictures, 0), train(&pictures, 1));
        assert_eq!((&one.convolutions, &one.head), (&same.convolutions, &same.head));
        assert_ne!(one.convolutions, other.convolutions);
        let learnt = (&pictures, &Variation::default());
        let device = (&Device::flex(), None);
        let alone = PaperCnn::train(learnt, 1, &PaperOptions::default(), device, &mut |_| go_on());
        assert_eq!(alone.unwrap_err().to_string(), "a training needs two places at least, not 1");
    }
}
