//! Networks that make an image of an image, such as the generator of a GAN that turns day into night.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::card::{InputCard, read_bounded};
use super::engine::Network;
use super::error::CnnError;
use super::model::LARGEST_MODEL_BYTES;
use super::preprocess::Preprocessor;
use super::runtime::OnnxRuntime;
use super::signature::Port;
use crate::raster::RgbImage;

/// Key of the ONNX metadata property that says which values black and white are, as a [`PixelRange`].
pub const RANGE_KEY: &str = "loci.range";

/// Longest side of an image that a generator may ask for, in pixels.
const LONGEST_SIDE_PX: usize = 2048;
/// Where a network leaves a side open, it gets the image's own, rounded to a multiple of this many pixels: networks
/// that halve an image up to five times and double it again give back no other size.
const SIDE_STEP_PX: usize = 32;
/// Longest side that a network gets where it leaves that open, in pixels.
const LONGEST_OPEN_SIDE_PX: usize = 1024;
/// Side of the picture by which a network is tried, in pixels.
const TRIAL_SIDE_PX: usize = 256;
/// What a network whose last layer is a tanh never exceeds, and others rarely by more than this factor.
const BEYOND_RANGE: f32 = 1.5;

/// Which values black and white are, going in and coming out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelRange {
    /// From −1 to 1, as generators have it whose last layer is a tanh (pix2pix, CycleGAN and most after them).
    #[default]
    Signed,
    /// From 0 to 1.
    Unit,
    /// From 0 to 255.
    Byte,
}

impl PixelRange {
    /// Values of black and white.
    fn ends(self) -> (f32, f32) {
        match self {
            Self::Signed => (-1.0, 1.0),
            Self::Unit => (0.0, 1.0),
            Self::Byte => (0.0, 255.0),
        }
    }
}

impl fmt::Display for PixelRange {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (black, white) = self.ends();
        write!(formatter, "{black}..{white}")
    }
}

impl FromStr for PixelRange {
    type Err = String;

    /// Reads `-1..1`, `0..1` or `0..255`.
    fn from_str(text: &str) -> Result<Self, String> {
        let known = [Self::Signed, Self::Unit, Self::Byte];
        let named = known.into_iter().find(|range| range.to_string() == text.trim());
        named.ok_or_else(|| {
            format!("`{}` is no range of values; write -1..1, 0..1 or 0..255", text.escape_debug())
        })
    }
}

/// A network that makes an image of an image: one input and one output of 32-bit floats, `[1, 3, height, width]`,
/// planes of red, green and blue. Height and width may be fixed or open. Black is −1 and white 1, on both sides, unless
/// the model's metadata property [`RANGE_KEY`] says `0..1` or `0..255`.
#[derive(Debug)]
pub struct ImageGenerator {
    path: PathBuf,
    network: Network,
    input: String,
    output: String,
    /// Height and width of the input in pixels; none where the network leaves one open.
    sides: [Option<usize>; 2],
    range: PixelRange,
}

impl ImageGenerator {
    /// Opens the network in the file at `path` to run on `threads` threads (one at least), and tries it once, so that
    /// what does not fit shows now and not in the middle of a training.
    ///
    /// # Errors
    /// [`CnnError::Unreadable`] if it is no regular file of at most 512 MiB, or [`CnnError::UnfitGenerator`] with what
    /// to change: no network, not one image in and one out, a range that is not one of the three or, where none is
    /// said, obviously not −1 to 1.
    pub fn open(path: &Path, runtime: &OnnxRuntime, threads: usize) -> Result<Self, CnnError> {
        let unfit = |reason| CnnError::UnfitGenerator { path: path.to_path_buf(), reason };
        let bytes = read_bounded(path, LARGEST_MODEL_BYTES)?;
        let network = Network::from_onnx(&runtime.library, &bytes, threads.max(1)).map_err(unfit)?;
        let (input, sides) = only_image("input", &network.inputs()).map_err(unfit)?;
        let (output, _) = only_image("output", &network.outputs()).map_err(unfit)?;
        let said = network.described(RANGE_KEY).map(|text| text.parse()).transpose();
        let said = said.map_err(|reason| unfit(format!("metadata property `{RANGE_KEY}`: {reason}")))?;
        let range = said.unwrap_or_default();
        let mut generator = Self { path: path.to_path_buf(), network, input, output, sides, range };
        let (_, values) = generator.run(&trial_picture()).map_err(|error| match error {
            CnnError::Inference { reason, .. } => unfit(reason),
            other => other,
        })?;
        if said.is_none() {
            check_range(&values).map_err(unfit)?;
        }
        Ok(generator)
    }

    /// Which values black and white are for this network.
    #[must_use]
    pub fn range(&self) -> PixelRange {
        self.range
    }

    /// The image that the network makes of `image`, of the same size; the network itself sees it stretched to its own.
    /// Values beyond black and white count as these.
    ///
    /// # Errors
    /// [`CnnError::EmptyImage`], or [`CnnError::Inference`] if the network fails or gives anything but finite values of
    /// one RGB image.
    pub fn generate(&mut self, image: &RgbImage) -> Result<RgbImage, CnnError> {
        let ([height_px, width_px], values) = self.run(image)?;
        let made = from_planes((width_px, height_px), &values, self.range.ends());
        if (made.width(), made.height()) == (image.width(), image.height()) {
            return Ok(made);
        }
        let own = InputCard {
            name: String::new(),
            width_px: image.width(),
            height_px: image.height(),
            mean: 0.0,
            scale: 1.0,
        };
        let planes = Preprocessor::new(&own).tensor(&made)?.to_vec();
        Ok(from_planes((image.width(), image.height()), &planes, PixelRange::Byte.ends()))
    }

    /// Height and width of the network's raw output for one image, and its values, which are finite.
    fn run(&mut self, image: &RgbImage) -> Result<([usize; 2], Vec<f32>), CnnError> {
        let [height_px, width_px] = [(self.sides[0], image.height()), (self.sides[1], image.width())]
            .map(|(fixed, own)| fixed.unwrap_or_else(|| open_side_px(own)));
        let (black, white) = self.range.ends();
        let scale = (white - black) / 255.0;
        let card = InputCard { name: self.input.clone(), width_px, height_px, mean: -black / scale, scale };
        let mut preprocessor = Preprocessor::new(&card);
        let tensor = preprocessor.tensor(image)?;
        let fail = |reason| CnnError::Inference { model: self.path.display().to_string(), reason };
        let shape = [1, 3, height_px, width_px];
        let (shape, values) =
            self.network.run_shaped((&self.input, shape, tensor), &self.output).map_err(fail)?;
        let &[1, 3, height, width] = shape.as_slice() else {
            return Err(fail(format!("shape {shape:?} came out, expected [1, 3, height, width]")));
        };
        if values.is_empty() || values.iter().any(|value| !value.is_finite()) {
            return Err(fail("what came out is not finite; the network does not suit this image".to_owned()));
        }
        Ok(([height, width].map(|side| side as usize), values))
    }
}

/// The side in pixels that a network gets of an image's own where it leaves that open.
fn open_side_px(own_px: usize) -> usize {
    (own_px.saturating_add(SIDE_STEP_PX / 2) / SIDE_STEP_PX * SIDE_STEP_PX)
        .clamp(SIDE_STEP_PX, LONGEST_OPEN_SIDE_PX)
}

/// Name, height and width of the only port, if it holds one RGB image.
fn only_image(kind: &str, ports: &[Port]) -> Result<(String, [Option<usize>; 2]), String> {
    let [port] = ports else {
        return Err(format!(
            "it has {} {kind}s, expected one image; export the generator alone",
            ports.len()
        ));
    };
    let name = &port.name;
    let Some(shape) = &port.float_shape else {
        return Err(format!("{kind} `{name}` is not a tensor of 32-bit floats; export it in those"));
    };
    let side = |length: i64| match usize::try_from(length) {
        Ok(length) if (1..=LONGEST_SIDE_PX).contains(&length) => Some(Some(length)),
        Ok(_) => None,
        Err(_) => Some(None),
    };
    if let &[-1 | 1, -1 | 3, height, width] = shape.as_slice()
        && let (Some(height), Some(width)) = (side(height), side(width))
    {
        return Ok((name.clone(), [height, width]));
    }
    Err(format!(
        "{kind} `{name}` has shape {shape:?}, expected [1, 3, height, width] of an RGB image with sides of at most \
         {LONGEST_SIDE_PX} px; export it so (−1 stands for any length)"
    ))
}

/// From black to white and through colours, so that a network shows what values it gives.
fn trial_picture() -> RgbImage {
    let pixel = |i: usize| {
        let (x, y) = (i % TRIAL_SIDE_PX, i / TRIAL_SIDE_PX);
        let tint = |share: usize| (x * (TRIAL_SIDE_PX - y * share / 4) / TRIAL_SIDE_PX) as u8;
        [tint(0), tint(1), tint(3)]
    };
    let pixels = (0..TRIAL_SIDE_PX * TRIAL_SIDE_PX).flat_map(pixel).collect();
    RgbImage::from_pixels(TRIAL_SIDE_PX, TRIAL_SIDE_PX, pixels).unwrap_or_else(|| RgbImage::new(1, 1))
}

/// Says so if values that came out of a picture from black to white do not look like −1 to 1.
fn check_range(values: &[f32]) -> Result<(), String> {
    let lowest = values.iter().copied().fold(f32::INFINITY, f32::min);
    let highest = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    if lowest < 0.0 && highest.max(-lowest) <= BEYOND_RANGE {
        return Ok(());
    }
    Err(format!(
        "values from {lowest} to {highest} came out, which is hardly a range of -1..1; say in the file which it is: in \
         Python, onnx.helper.set_model_props(model, {{\"{RANGE_KEY}\": \"0..1\"}}), or \"0..255\" or \"-1..1\""
    ))
}

/// The image of planes of red, green and blue.
fn from_planes((width, height): (usize, usize), values: &[f32], (black, white): (f32, f32)) -> RgbImage {
    let mut image = RgbImage::new(width, height);
    let scale = 255.0 / (white - black);
    for (channel, plane) in values.chunks_exact((width * height).max(1)).take(3).enumerate() {
        for (pixel, value) in image.pixels_mut().chunks_exact_mut(3).zip(plane) {
            // The cast rounds down and keeps within 0 and 255.
            pixel[channel] = ((value - black) * scale + 0.5) as u8;
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::super::model::tests::runtime;
    use super::*;
    use crate::onnx::{Dimension, GraphBuilder, Value};

    const IMAGE: [usize; 4] = [1, 3, 32, 32];

    /// A file with a network that `make` writes after its only input, `picture`.
    fn network_file(
        input: &[Dimension],
        output: &[Dimension],
        range: Option<&str>,
        make: impl FnOnce(&mut GraphBuilder, &Value) -> Value,
    ) -> (TempDir, PathBuf) {
        let mut graph = GraphBuilder::new("toy");
        let picture = graph.input("picture", input);
        let made = make(&mut graph, &picture);
        graph.output("made", &made, output).unwrap();
        let mut model = graph.finish();
        range.into_iter().for_each(|range| model.describe(RANGE_KEY, range));
        file(&model.to_bytes())
    }

    fn file(bytes: &[u8]) -> (TempDir, PathBuf) {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("night.onnx");
        std::fs::write(&path, bytes).unwrap();
        (folder, path)
    }

    /// A network of operators without weights or attributes, one after the other.
    fn chain(operators: &[&str], shape: [usize; 4], range: Option<&str>) -> (TempDir, PathBuf) {
        let shape = shape.map(Dimension::Fixed);
        network_file(&shape, &shape, range, |graph, picture| {
            operators.iter().fold(picture.clone(), |value, operator| graph.node(operator, &[&value], &[]))
        })
    }

    fn refusal(path: &Path, runtime: &OnnxRuntime) -> String {
        let error = ImageGenerator::open(path, runtime, 1).unwrap_err().to_string();
        assert!(error.starts_with(path.to_str().unwrap()) && !error.contains('\n'), "{error}");
        error
    }

    fn riddle(width: usize, height: usize) -> RgbImage {
        let byte = |i: usize| ((i as u32).wrapping_mul(2_654_435_761) >> 13) as u8;
        RgbImage::from_pixels(width, height, (0..width * height * 3).map(byte).collect()).unwrap()
    }

    #[test]
    fn a_network_that_negates_inverts_an_image() {
        let Some(runtime) = runtime() else { return };
        let (_folder, path) = chain(&["Neg"], IMAGE, None);
        let mut generator = ImageGenerator::open(&path, &runtime, 1).unwrap();
        assert_eq!(generator.range(), PixelRange::Signed);
        let image = riddle(32, 32);
        let inverted: Vec<u8> = image.pixels().iter().map(|byte| 255 - byte).collect();
        assert_eq!(generator.generate(&image).unwrap().pixels(), inverted);
    }

    #[test]
    fn a_range_that_the_file_says_holds_on_both_sides() {
        let Some(runtime) = runtime() else { return };
        for range in [PixelRange::Signed, PixelRange::Unit, PixelRange::Byte] {
            let (_folder, path) = chain(&["Abs"], IMAGE, Some(&range.to_string()));
            let mut generator = ImageGenerator::open(&path, &runtime, 1).unwrap();
            assert_eq!(generator.range(), range);
            let dark = RgbImage::from_pixels(32, 32, vec![55; 3 * 32 * 32]).unwrap();
            let expected = if range == PixelRange::Signed { 200 } else { 55 };
            assert_eq!(generator.generate(&dark).unwrap().pixels(), vec![expected; 3 * 32 * 32], "{range}");
        }
    }

    #[test]
    fn an_image_keeps_its_size_whatever_the_network_works_in() {
        let Some(runtime) = runtime() else { return };
        let wide = [1, 3, 32, 64].map(Dimension::Fixed);
        let (_folder, path) = network_file(&IMAGE.map(Dimension::Fixed), &wide, None, |graph, picture| {
            graph.node("Concat", &[picture, picture], &[("axis", crate::onnx::Attribute::Int(3))])
        });
        let mut generator = ImageGenerator::open(&path, &runtime, 1).unwrap();
        for (width, height) in [(32, 32), (50, 41), (1, 1), (3, 200)] {
            let plain = RgbImage::from_pixels(width, height, [10, 120, 240].repeat(width * height)).unwrap();
            assert_eq!(generator.generate(&plain).unwrap(), plain);
        }
    }

    #[test]
    fn an_open_side_is_the_images_own_as_far_as_networks_bear_it() {
        let Some(runtime) = runtime() else { return };
        let open = [Dimension::Fixed(1), Dimension::Fixed(3), Dimension::Batch, Dimension::Fixed(64)];
        let (_folder, path) =
            network_file(&open, &open, None, |graph, picture| graph.node("Neg", &[picture], &[]));
        let mut generator = ImageGenerator::open(&path, &runtime, 1).unwrap();
        let image = riddle(64, 96);
        let once = generator.generate(&image).unwrap();
        assert_ne!(once, image);
        assert_eq!(generator.generate(&once).unwrap(), image);
        assert_eq!([1, 47, 48, 320, 5000].map(open_side_px), [32, 32, 64, 320, 1024]);
    }

    #[test]
    fn another_kind_of_network_is_refused_by_what_differs() {
        let Some(runtime) = runtime() else { return };
        for (shape, word) in [
            ([1, 1, 32, 32], "input `picture` has shape [1, 1, 32, 32], expected [1, 3, height, width]"),
            ([2, 3, 32, 32], "[2, 3, 32, 32]"),
            ([1, 3, 32, 5000], "at most 2048 px"),
        ] {
            let (_folder, path) = chain(&["Neg"], shape, None);
            let error = refusal(&path, &runtime);
            assert!(error.contains(word), "{error}");
        }
        let (_folder, path) = chain(&["NoSuchOperator"], IMAGE, None);
        assert!(refusal(&path, &runtime).contains("NoSuchOperator"));
        let pooled = [1, 3, 1, 1].map(Dimension::Fixed);
        let flat = [1, 3].map(Dimension::Fixed);
        for (output, word) in [(&pooled[..], "range"), (&flat[..], "output `made` has shape [1, 3]")] {
            let (_folder, path) =
                network_file(&IMAGE.map(Dimension::Fixed), output, None, |graph, picture| {
                    let pooled = graph.node("GlobalAveragePool", &[picture], &[]);
                    if output.len() == 2 {
                        graph.node("Flatten", &[&pooled], &[])
                    } else {
                        graph.node("Exp", &[&pooled], &[])
                    }
                });
            let error = refusal(&path, &runtime);
            assert!(error.contains(word), "{error}");
        }
    }

    #[test]
    fn a_network_of_two_inputs_is_no_generator() {
        let Some(runtime) = runtime() else { return };
        let shape = IMAGE.map(Dimension::Fixed);
        let (_folder, path) = network_file(&shape, &shape, None, |graph, picture| {
            let style = graph.input("style", &shape);
            graph.node("Add", &[picture, &style], &[])
        });
        let error = refusal(&path, &runtime);
        assert!(error.contains("it has 2 inputs, expected one image; export the generator alone"), "{error}");
    }

    #[test]
    fn values_that_are_hardly_from_minus_one_to_one_are_refused_until_the_file_says_their_range() {
        let Some(runtime) = runtime() else { return };
        let (_folder, path) = chain(&["Sigmoid"], IMAGE, None);
        let error = refusal(&path, &runtime);
        assert!(error.contains("set_model_props(model, {\"loci.range\": \"0..1\"})"), "{error}");
        let (_folder, path) = chain(&["Exp", "Exp"], IMAGE, None);
        assert!(refusal(&path, &runtime).contains("hardly a range of -1..1"));
        let (_folder, path) = chain(&["Sigmoid"], IMAGE, Some("0..1"));
        assert!(ImageGenerator::open(&path, &runtime, 1).is_ok());
        let (_folder, path) = chain(&["Sigmoid"], IMAGE, Some("0..2"));
        let error = refusal(&path, &runtime);
        assert!(error.contains("`loci.range`: `0..2` is no range") && error.contains("0..255"), "{error}");
    }

    #[test]
    fn what_is_not_finite_is_an_error_and_the_next_image_works() {
        let Some(runtime) = runtime() else { return };
        let (_folder, path) = chain(&["Sqrt"], IMAGE, None);
        assert!(refusal(&path, &runtime).contains("not finite"));
        let shape = IMAGE.map(Dimension::Fixed);
        let (_folder, path) = network_file(&shape, &shape, Some("0..1"), |graph, picture| {
            let mean = graph.node("GlobalAveragePool", &[picture], &[]);
            let log = graph.node("Log", &[&mean], &[]);
            graph.node("Add", &[picture, &log], &[])
        });
        let mut generator = ImageGenerator::open(&path, &runtime, 1).unwrap();
        let error = generator.generate(&RgbImage::new(32, 32)).unwrap_err();
        assert!(matches!(error, CnnError::Inference { .. }), "{error}");
        assert!(error.to_string().contains("night.onnx: inference failed"), "{error}");
        assert!(generator.generate(&riddle(32, 32)).is_ok());
    }

    #[test]
    fn what_is_no_network_is_refused_by_name() {
        let Some(runtime) = runtime() else { return };
        for bytes in [&b""[..], b"this is no network\n", &[0xff; 100]] {
            let (_folder, path) = file(bytes);
            assert!(refusal(&path, &runtime).contains("no generator of images"));
        }
        let (folder, path) = file(b"");
        std::fs::remove_file(&path).unwrap();
        assert!(refusal(&path, &runtime).contains("cannot read"));
        assert!(refusal(folder.path(), &runtime).contains("not a regular file"));
    }

    #[test]
    fn an_image_without_pixels_is_an_error() {
        let Some(runtime) = runtime() else { return };
        let (_folder, path) = chain(&["Neg"], IMAGE, None);
        let mut generator = ImageGenerator::open(&path, &runtime, 1).unwrap();
        assert!(matches!(generator.generate(&RgbImage::new(0, 3)), Err(CnnError::EmptyImage { .. })));
    }
}
