//! A trained network in 8 bits: its ranges measured on images of the place, and how far it agrees with itself in f32.

use rand_pcg::Pcg64;

use super::error::TrainingError;
use super::gathering::descriptor;
use super::pictures::Pictures;
use super::variation::Variation;
use crate::cnn::{DescriptorModel, ModelCard, Observer, OnnxRuntime};
use crate::onnx::{OnnxModel, Range, Ranges};
use crate::raster::RgbImage;

/// `network`, which takes what `card` says, in 8 bits ([`OnnxModel::quantised`]): the ranges of its activations are
/// those that `images` need. Some fifty images of the place in all its light are enough. An error among the images
/// ends it.
///
/// # Errors
/// [`TrainingError::NoImages`]; [`TrainingError::Onnx`] or [`TrainingError::Cnn`] if the network cannot be quantised
/// or run; or what an image's place holds.
pub fn quantise(
    network: &OnnxModel,
    card: &ModelCard,
    runtime: &OnnxRuntime,
    images: impl IntoIterator<Item = Result<RgbImage, TrainingError>>,
) -> Result<OnnxModel, TrainingError> {
    let (observed, names) = network.observed()?;
    let mut observer = Observer::open(card, &observed.to_bytes(), runtime)?;
    let mut seen = Vec::new();
    for image in images {
        seen.push(observer.observe(&image?)?);
    }
    if seen.is_empty() {
        return Err(TrainingError::NoImages);
    }
    Ok(network.quantised(&ranges(&names, &seen))?)
}

/// Some `count` images that are learnt, from all over the map; every second one in other light, settled by `seed`.
pub fn in_all_light<'a>(
    (pictures, variation): (&'a Pictures<'a>, &'a Variation),
    count: usize,
    seed: u64,
) -> impl Iterator<Item = Result<RgbImage, TrainingError>> + 'a {
    let step = pictures.learnt.len().div_ceil(count.max(1)).max(1);
    let mut random = Pcg64::new(u128::from(seed), u128::MAX);
    pictures.learnt.iter().step_by(step).enumerate().map(move |(number, &picture)| {
        let image = pictures.image(picture);
        let vary = |image: RgbImage| variation.vary(&image, &mut random);
        if number % 2 == 1 { image.and_then(vary) } else { image }
    })
}

/// The range of each activation: the least of the least and the greatest of the greatest values of all images.
fn ranges(names: &[String], seen: &[Vec<f32>]) -> Ranges {
    let range = |index: usize| {
        let extremes = |at: usize| seen.iter().filter_map(move |image| image.get(at).copied());
        Range {
            least: extremes(2 * index).fold(f32::INFINITY, f32::min),
            greatest: extremes(2 * index + 1).fold(f32::NEG_INFINITY, f32::max),
        }
    };
    names.iter().enumerate().map(|(index, name)| (name.clone(), range(index))).collect()
}

/// How far two models give the same descriptors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Images that both could describe.
    pub images: usize,
    /// Mean cosine between the two descriptors of an image.
    pub mean_cosine: f64,
    /// The least of those cosines.
    pub worst_cosine: f64,
}

/// How far `one` and `other` agree on `images`. What either finds nothing in is left out; an error among the images
/// ends it.
///
/// # Errors
/// [`TrainingError::NoImages`], [`TrainingError::Cnn`] if a model fails, or what an image's place holds.
pub fn agreement(
    one: &mut DescriptorModel,
    other: &mut DescriptorModel,
    images: impl IntoIterator<Item = Result<RgbImage, TrainingError>>,
) -> Result<Agreement, TrainingError> {
    let mut cosines = Vec::new();
    for image in images {
        let image = image?;
        if let (Some(one), Some(other)) = (descriptor(one, &image)?, descriptor(other, &image)?) {
            cosines.push(f64::from(one.cosine(&other)));
        }
    }
    if cosines.is_empty() {
        return Err(TrainingError::NoImages);
    }
    let images = cosines.len();
    Ok(Agreement {
        images,
        mean_cosine: cosines.iter().sum::<f64>() / images as f64,
        worst_cosine: cosines.into_iter().fold(f64::INFINITY, f64::min),
    })
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::cnn::{CARD_FILE, MODEL_FILE, installed_runtime};
    use crate::onnx::{Attribute, Dimension, GraphBuilder, Value};
    use crate::source::synthetic::SyntheticSource;

    const SIDE_PX: usize = 16;
    const CHANNELS: usize = 40;
    const DIMENSIONS: usize = 8;

    fn card() -> ModelCard {
        let card = "name = 'toy'\nversion = '1'\ndescription = ''\nlicence = 'MIT'\n\
            source = ''\nrecipe = ''\nsha256 = ''\n\
            [input]\nname = 'image'\nwidth_px = 16\nheight_px = 16\nmean = 127.0\nscale = 0.0078125\n\
            [descriptor]\nname = 'descriptor'\ndimensions = 8\n\
            [decision]\nrecognise_above = 0.5\ncalibration_slope = 1.0\ncalibration_offset = 0.0\n\
            [training]\ndata = ''\n[metrics]\n";
        toml::from_str(card).unwrap()
    }

    /// A network whose weights are random.
    struct Toy {
        graph: GraphBuilder,
        random: Pcg64,
        /// What the weights of the first convolution go through.
        first: fn(usize, &mut [f32]),
    }

    impl Toy {
        fn weight(&mut self, name: &str, shape: &[usize]) -> Value {
            let fan_in: usize = shape.iter().skip(1).product();
            let spread = if name == "bias" { 0.01 } else { (3.0 / fan_in as f32).sqrt() };
            let count = shape.iter().product();
            let mut values: Vec<f32> =
                (0..count).map(|_| self.random.random_range(-spread..spread)).collect();
            if name == "first" {
                (self.first)(fan_in, &mut values);
            }
            self.graph.weight(name, shape, &values)
        }

        /// conv → ReLU → depthwise conv → Clip → conv → pool → Gemm → ReLU → MatMul.
        fn network(first: fn(usize, &mut [f32])) -> OnnxModel {
            let mut toy = Self { graph: GraphBuilder::new("toy"), random: Pcg64::seed_from_u64(5), first };
            let padded = ("pads", Attribute::Ints(vec![1; 4]));
            let side = Dimension::Fixed(SIDE_PX);
            let image = toy.graph.input("image", &[Dimension::Batch, Dimension::Fixed(3), side, side]);
            let (kernel, bias) = (toy.weight("first", &[CHANNELS, 3, 3, 3]), toy.weight("bias", &[CHANNELS]));
            let value = toy.graph.node("Conv", &[&image, &kernel, &bias], std::slice::from_ref(&padded));
            let value = toy.graph.node("Relu", &[&value], &[]);
            let kernel = toy.weight("depthwise", &[CHANNELS, 1, 3, 3]);
            let grouped = [padded, ("group", Attribute::Int(CHANNELS as i64))];
            let value = toy.graph.node("Conv", &[&value, &kernel], &grouped);
            let [least, greatest] = [-0.2, 6.0].map(|bound| toy.graph.weight("bound", &[], &[bound]));
            let value = toy.graph.node("Clip", &[&value, &least, &greatest], &[]);
            let kernel = toy.weight("pointwise", &[CHANNELS, CHANNELS, 1, 1]);
            let value = toy.graph.node("Conv", &[&value, &kernel], &[]);
            let pool =
                [("kernel_shape", Attribute::Ints(vec![8, 8])), ("strides", Attribute::Ints(vec![8, 8]))];
            let value = toy.graph.node("AveragePool", &[&value], &pool);
            let value = toy.graph.node("Flatten", &[&value], &[]);
            let (matrix, bias) = (toy.weight("matrix", &[16, 4 * CHANNELS]), toy.weight("bias", &[16]));
            let value = toy.graph.node("Gemm", &[&value, &matrix, &bias], &[("transB", Attribute::Int(1))]);
            let value = toy.graph.node("Relu", &[&value], &[]);
            let head = toy.weight("head", &[16, DIMENSIONS]);
            let value = toy.graph.node("MatMul", &[&value, &head], &[]);
            let shape = [Dimension::Batch, Dimension::Fixed(DIMENSIONS)];
            toy.graph.output("descriptor", &value, &shape).unwrap();
            toy.graph.finish()
        }
    }

    /// Coarse patterns in all colours.
    fn patterns(seed: u64, count: usize) -> impl Iterator<Item = Result<RgbImage, TrainingError>> {
        let mut random = Pcg64::seed_from_u64(seed);
        (0..count).map(move |_| {
            let pixels = (0..3 * 36).map(|_| random.random()).collect();
            Ok(RgbImage::from_pixels(6, 6, pixels).unwrap())
        })
    }

    fn opened(network: &OnnxModel, runtime: &OnnxRuntime) -> DescriptorModel {
        DescriptorModel::from_onnx(&card(), &network.to_bytes(), runtime, 1).unwrap()
    }

    /// How far a network agrees with itself in 8 bits on images that it was not calibrated on.
    fn agreement_of(network: &OnnxModel, runtime: &OnnxRuntime) -> Agreement {
        let int8 = quantise(network, &card(), runtime, patterns(1, 30)).unwrap();
        agreement(&mut opened(network, runtime), &mut opened(&int8, runtime), patterns(2, 30)).unwrap()
    }

    #[test]
    fn a_network_agrees_with_itself_in_8_bits() {
        let Some(runtime) = installed_runtime() else { return };
        let network = Toy::network(|_, _| {});
        for network in [network.clone(), network.stored_as_half()] {
            let agreement = agreement_of(&network, &runtime);
            assert_eq!(agreement.images, 30);
            assert!(agreement.mean_cosine > 0.99 && agreement.worst_cosine > 0.97, "{agreement:?}");
        }
    }

    /// Makes each channel up to 100 times as strong as the one before.
    fn uneven(fan_in: usize, values: &mut [f32]) {
        for (channel, kernel) in values.chunks_mut(fan_in).enumerate() {
            kernel.iter_mut().for_each(|value| *value *= [0.03, 3.0][channel % 2]);
        }
    }

    #[test]
    fn one_scale_a_channel_tells_more_than_one_for_all_where_channels_differ_a_hundredfold() {
        let Some(runtime) = installed_runtime() else { return };
        let weak_alone = |fan_in, values: &mut [f32]| {
            uneven(fan_in, values);
            values.chunks_mut(fan_in).skip(1).step_by(2).flatten().for_each(|value| *value = 0.0);
        };
        let one_scale = |fan_in, values: &mut [f32]| {
            uneven(fan_in, values);
            let scale = values.iter().fold(0.0_f32, |largest, value| largest.max(value.abs())) / 127.0;
            values.iter_mut().for_each(|value| *value = (*value / scale).round() * scale);
            values.chunks_mut(fan_in).skip(1).step_by(2).flatten().for_each(|value| *value = 0.0);
        };
        let own_scales = agreement_of(&Toy::network(weak_alone), &runtime);
        let (mut whole, mut rounded) =
            (opened(&Toy::network(weak_alone), &runtime), opened(&Toy::network(one_scale), &runtime));
        let one_scale = agreement(&mut whole, &mut rounded, patterns(2, 30)).unwrap();
        assert!(own_scales.mean_cosine > 0.99, "{own_scales:?}");
        assert!(own_scales.mean_cosine > one_scale.mean_cosine, "{own_scales:?}, {one_scale:?}");
    }

    #[test]
    fn dead_channels_do_no_harm() {
        let Some(runtime) = installed_runtime() else { return };
        let network = Toy::network(|fan_in, values| values[..fan_in * CHANNELS / 3].fill(0.0));
        let agreement = agreement_of(&network, &runtime);
        assert!(agreement.mean_cosine > 0.99, "{agreement:?}");
        let dead = Toy::network(|_, values| values.fill(0.0));
        let int8 = quantise(&dead, &card(), &runtime, patterns(1, 3)).unwrap();
        let black = RgbImage::new(4, 4);
        let (expected, got) =
            (opened(&dead, &runtime).describe(&black), opened(&int8, &runtime).describe(&black));
        assert!(expected.unwrap().cosine(&got.unwrap()) > 0.98);
    }

    #[test]
    fn without_an_image_there_is_no_range_and_no_agreement_and_an_error_among_them_ends_it() {
        let Some(runtime) = installed_runtime() else { return };
        let network = Toy::network(|_, _| {});
        let error = quantise(&network, &card(), &runtime, []).unwrap_err();
        assert!(matches!(error, TrainingError::NoImages), "{error}");
        let interrupted = patterns(1, 3).chain([Err(TrainingError::Interrupted)]);
        let error = quantise(&network, &card(), &runtime, interrupted).unwrap_err();
        assert!(matches!(error, TrainingError::Interrupted), "{error}");
        let (mut one, mut other) = (opened(&network, &runtime), opened(&network, &runtime));
        assert!(matches!(agreement(&mut one, &mut other, []), Err(TrainingError::NoImages)));
        let same = agreement(&mut one, &mut other, patterns(1, 3)).unwrap();
        assert!(same.worst_cosine > 0.999_99, "{same:?}");
    }

    #[test]
    fn a_network_agrees_with_itself_when_its_weights_are_stored_as_half() {
        let Some(runtime) = installed_runtime() else { return };
        let network = Toy::network(|_, _| {});
        let half = network.clone().stored_as_half();
        assert!(half.to_bytes().len() * 10 < network.to_bytes().len() * 7);
        let agreement =
            agreement(&mut opened(&network, &runtime), &mut opened(&half, &runtime), patterns(2, 30))
                .unwrap();
        assert!(agreement.worst_cosine > 0.9999, "{agreement:?}");
    }

    #[test]
    fn the_shipped_model_agrees_with_itself_in_8_bits_and_a_part_of_its_bytes() {
        let Some(runtime) = installed_runtime() else { return };
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/efficientnet-lite0");
        let card = ModelCard::read(&folder.join(CARD_FILE)).unwrap();
        let network = OnnxModel::read(&fs::read(folder.join(MODEL_FILE)).unwrap()).unwrap();
        let frames = |spec: &str| {
            let source = SyntheticSource::open(spec.parse().unwrap(), 1);
            (0..20).map(move |index| Ok(source.render(index).unwrap().colour))
        };
        let known = frames("street?laps=1&frames=20&size=320x240&seed=3");
        let int8 = quantise(&network, &card, &runtime, known).unwrap();
        let (whole_bytes, int8_bytes) = (network.to_bytes(), int8.to_bytes());
        assert!(
            int8_bytes.len() * 10 < whole_bytes.len() * 7,
            "{} of {}",
            int8_bytes.len(),
            whole_bytes.len()
        );
        let [mut whole, mut int8] = [whole_bytes, int8_bytes]
            .map(|bytes| DescriptorModel::from_onnx(&card, &bytes, &runtime, 1).unwrap());
        let unknown = frames("street?laps=1&frames=20&size=320x240&seed=4");
        let agreement = agreement(&mut whole, &mut int8, unknown).unwrap();
        assert!(agreement.mean_cosine > 0.98 && agreement.worst_cosine > 0.95, "{agreement:?}");
    }
}
