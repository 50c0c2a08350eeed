//! A model folder, opened: card, network, preprocessing; image in, descriptor out.

use std::path::Path;

use super::card::{ModelCard, read_bounded};
use super::descriptor::Descriptor;
use super::engine::{Network, PreparedNetwork, sha256_hex};
use super::error::CnnError;
use super::preprocess::Preprocessor;
use super::runtime::OnnxRuntime;
use super::signature;
use crate::raster::RgbImage;

/// Name of the card in a model's folder.
pub const CARD_FILE: &str = "card.toml";
/// Name of the network in a model's folder.
pub const MODEL_FILE: &str = "model.onnx";

/// Largest network that is read, in bytes; one for a robot has a few million.
pub(super) const LARGEST_MODEL_BYTES: u64 = 512 << 20;
/// Small networks gain nothing from more threads.
const MOST_THREADS: usize = 2;

/// A network that describes places.
#[derive(Debug)]
pub struct DescriptorModel {
    card: ModelCard,
    network: PreparedNetwork,
    preprocessor: Preprocessor,
}

impl DescriptorModel {
    /// Opens the model in `folder` to run on `threads` threads (1 or 2; other numbers count as the nearer of
    /// them) and tries it once, so that what does not fit shows now and not in the middle of a drive.
    ///
    /// The bytes that are hashed are the bytes that run: the network is read once and not touched again.
    ///
    /// # Errors
    /// [`CnnError::Unreadable`], [`CnnError::Card`], [`CnnError::HashMismatch`], or
    /// [`CnnError::UnfitNetwork`] if the network is not the one that the card describes.
    pub fn open(folder: &Path, runtime: &OnnxRuntime, threads: usize) -> Result<Self, CnnError> {
        let card = ModelCard::read(&folder.join(CARD_FILE))?;
        let path = folder.join(MODEL_FILE);
        let bytes = read_bounded(&path, LARGEST_MODEL_BYTES)?;
        let got = sha256_hex(&bytes);
        if !got.eq_ignore_ascii_case(&card.sha256) {
            return Err(CnnError::HashMismatch { path, expected: card.sha256, got });
        }
        Self::of(card, &bytes, &path, (runtime, threads))
    }

    /// The network of these bytes of an ONNX file, as `card` has it but whatever hash it names, on `threads` threads as
    /// in [`open`](Self::open).
    ///
    /// # Errors
    /// [`CnnError::UnfitNetwork`] if the network is not the one that the card describes.
    #[cfg(feature = "train")]
    pub fn from_onnx(
        card: &ModelCard,
        network: &[u8],
        runtime: &OnnxRuntime,
        threads: usize,
    ) -> Result<Self, CnnError> {
        Self::of(card.clone(), network, Path::new(MODEL_FILE), (runtime, threads))
    }

    /// Makes the network of `bytes`, which are of the file `path`, and tries it once.
    fn of(
        card: ModelCard,
        bytes: &[u8],
        path: &Path,
        (runtime, threads): (&OnnxRuntime, usize),
    ) -> Result<Self, CnnError> {
        let unfit = |reason| CnnError::UnfitNetwork { path: path.to_path_buf(), reason };
        let network =
            Network::from_onnx(&runtime.library, bytes, threads.clamp(1, MOST_THREADS)).map_err(unfit)?;
        signature::check(&network.inputs(), &network.outputs(), &card).map_err(unfit)?;
        let (input, descriptor) = (&card.input, &card.descriptor);
        let network = network
            .prepared([1, 3, input.height_px, input.width_px], (&descriptor.name, [1, descriptor.dimensions]))
            .map_err(unfit)?;
        let preprocessor = Preprocessor::new(input);
        let mut model = Self { card, network, preprocessor };
        model.run(&RgbImage::new(1, 1), &mut Vec::new()).map_err(|error| match error {
            CnnError::Inference { reason, .. } => unfit(reason),
            other => other,
        })?;
        Ok(model)
    }

    /// The model's card.
    #[must_use]
    pub fn card(&self) -> &ModelCard {
        &self.card
    }

    /// Number of values of a descriptor.
    #[must_use]
    pub fn dimensions(&self) -> usize {
        self.card.descriptor.dimensions
    }

    /// Describes one image, of any size: the L2-normalised output of the network.
    ///
    /// # Errors
    /// [`CnnError::EmptyImage`], [`CnnError::Inference`], or [`CnnError::Degenerate`] if the output has no
    /// finite length above zero.
    pub fn describe(&mut self, image: &RgbImage) -> Result<Descriptor, CnnError> {
        self.describe_reusing(image, None)
    }

    /// As [`describe`](Self::describe), in the memory of a descriptor that nobody needs any more, if there is one:
    /// images of one size then take none.
    ///
    /// # Errors
    /// As [`describe`](Self::describe).
    pub fn describe_reusing(
        &mut self,
        image: &RgbImage,
        spare: Option<Descriptor>,
    ) -> Result<Descriptor, CnnError> {
        let mut values = spare.map_or_else(Vec::new, Descriptor::into_values);
        self.run(image, &mut values)?;
        Descriptor::from_values(values).ok_or_else(|| CnnError::Degenerate { model: self.card.name.clone() })
    }

    /// Writes the network's raw output for one image over what is in `values`.
    fn run(&mut self, image: &RgbImage, values: &mut Vec<f32>) -> Result<(), CnnError> {
        self.preprocessor.write_tensor(image, self.network.input())?;
        let fail = |reason| CnnError::Inference { model: self.card.name.clone(), reason };
        self.network.run(values).map_err(fail)
    }
}

#[cfg(all(test, feature = "cnn"))]
pub(super) mod tests {
    use std::path::PathBuf;

    use tempfile::TempDir;

    use super::super::card::tests::CARD;
    use super::*;

    /// This computer's runtime, which `make deps` installs; `None` where a person has said to do without.
    pub(crate) fn runtime() -> Option<OnnxRuntime> {
        match OnnxRuntime::open(None) {
            Ok(runtime) => Some(runtime),
            Err(_) if std::env::var_os("LOCI_WITHOUT_ONNXRUNTIME").is_some_and(|value| value == "1") => None,
            Err(error) => panic!("{error}; or set LOCI_WITHOUT_ONNXRUNTIME=1 to leave these tests out"),
        }
    }

    /// Protocol buffers, as much as a toy needs: a field that holds a number, and one that holds bytes.
    fn number(field: u8, value: u8) -> Vec<u8> {
        vec![field << 3, value]
    }

    fn message(field: u8, parts: &[Vec<u8>]) -> Vec<u8> {
        let body = parts.concat();
        [vec![field << 3 | 2, (body.len() as u8 & 0x7f) | 0x80, (body.len() >> 7) as u8], body].concat()
    }

    fn text(field: u8, text: &str) -> Vec<u8> {
        message(field, &[text.as_bytes().to_vec()])
    }

    /// A float tensor's name and shape: ValueInfoProto.
    fn value_info(field: u8, name: &str, shape: &[u8]) -> Vec<u8> {
        let dimensions: Vec<_> = shape.iter().map(|&size| message(1, &[number(1, size)])).collect();
        let tensor = message(1, &[number(1, 1), message(2, &dimensions)]);
        message(field, &[text(1, name), message(2, &[tensor])])
    }

    /// An ONNX network of one to four operators in a row, from `image` [1, 3, 16, 16] to `output` [1, 3].
    pub(crate) fn toy_network(operators: &[&str], output: &str) -> Vec<u8> {
        let name = |i: usize| match i {
            0 => "image".to_owned(),
            i if i == operators.len() => output.to_owned(),
            i => format!("step{i}"),
        };
        let mut graph: Vec<_> = operators
            .iter()
            .enumerate()
            .map(|(i, operator)| message(1, &[text(1, &name(i)), text(2, &name(i + 1)), text(4, operator)]))
            .collect();
        graph.extend([
            text(2, "toy"),
            value_info(11, "image", &[1, 3, 16, 16]),
            value_info(12, output, &[1, 3]),
        ]);
        [number(1, 8), message(7, &graph), message(8, &[number(2, 17)])].concat()
    }

    /// A model folder with that network and a card for it: each mean of R, G, B, minus 100.
    pub(crate) fn model_folder(network: &[u8]) -> TempDir {
        let folder = TempDir::new().unwrap();
        let card = CARD
            .replace("width_px = 224", "width_px = 16")
            .replace("height_px = 160", "height_px = 16")
            .replace("mean = 127", "mean = 100")
            .replace("dimensions = 1280", "dimensions = 3")
            .replace(&"0".repeat(64), &sha256_hex(network));
        std::fs::write(folder.path().join(CARD_FILE), card).unwrap();
        std::fs::write(folder.path().join(MODEL_FILE), network).unwrap();
        folder
    }

    fn error_of(folder: &TempDir, runtime: &OnnxRuntime) -> String {
        let error = DescriptorModel::open(folder.path(), runtime, 1).unwrap_err().to_string();
        assert!(error.contains(folder.path().to_str().unwrap()) && !error.contains('\n'), "{error}");
        error
    }

    fn plain(colour: [u8; 3]) -> RgbImage {
        RgbImage::from_pixels(5, 4, colour.repeat(20)).unwrap()
    }

    pub(crate) const MEANS: [&str; 2] = ["GlobalAveragePool", "Flatten"];

    #[test]
    fn sha256_is_the_standard_one() {
        assert_eq!(sha256_hex(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    #[test]
    fn a_descriptor_is_the_networks_output_scaled_to_unit_length() {
        let Some(runtime) = runtime() else { return };
        let folder = model_folder(&toy_network(&MEANS, "descriptor"));
        let mut model = DescriptorModel::open(folder.path(), &runtime, 1).unwrap();
        let descriptor = model.describe(&plain([130, 140, 100])).unwrap();
        let expected = [0.6, 0.8, 0.0];
        let off = descriptor.as_slice().iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < 1e-5, "{descriptor:?}");
    }

    #[test]
    fn an_output_without_direction_or_not_finite_is_an_error() {
        let Some(runtime) = runtime() else { return };
        let folder = model_folder(&toy_network(&MEANS, "descriptor"));
        let mut model = DescriptorModel::open(folder.path(), &runtime, 1).unwrap();
        assert!(matches!(model.describe(&plain([100; 3])), Err(CnnError::Degenerate { .. })));
        let folder = model_folder(&toy_network(&["GlobalAveragePool", "Flatten", "Log"], "descriptor"));
        let mut model = DescriptorModel::open(folder.path(), &runtime, 1).unwrap();
        assert!(matches!(model.describe(&plain([9; 3])), Err(CnnError::Degenerate { .. })));
        assert!(model.describe(&plain([200; 3])).is_ok());
    }

    #[test]
    fn an_image_without_pixels_is_an_error_and_the_next_one_works() {
        let Some(runtime) = runtime() else { return };
        let folder = model_folder(&toy_network(&MEANS, "descriptor"));
        let mut model = DescriptorModel::open(folder.path(), &runtime, 2).unwrap();
        assert!(matches!(model.describe(&RgbImage::new(0, 0)), Err(CnnError::EmptyImage { .. })));
        assert!(model.describe(&plain([1, 2, 3])).is_ok());
    }

    #[test]
    fn a_network_that_is_not_the_cards_is_refused_in_one_line() {
        let Some(runtime) = runtime() else { return };
        let folder = model_folder(b"this is no network\n");
        assert!(error_of(&folder, &runtime).contains("not a network that fits its model card"));
        let folder = model_folder(b"");
        assert!(error_of(&folder, &runtime).contains("not a network that fits its model card"));
        let folder = model_folder(&toy_network(&MEANS, "scores"));
        assert!(error_of(&folder, &runtime).contains("no output `descriptor`"));
        let folder = model_folder(&toy_network(&["GlobalAveragePool", "NoSuchOperator"], "descriptor"));
        assert!(error_of(&folder, &runtime).contains("NoSuchOperator"));
    }

    #[test]
    fn a_changed_network_is_refused_by_its_hash() {
        let Some(runtime) = runtime() else { return };
        let folder = model_folder(&toy_network(&MEANS, "descriptor"));
        std::fs::write(folder.path().join(MODEL_FILE), b"another").unwrap();
        let error = error_of(&folder, &runtime);
        assert!(
            error.contains("model.onnx: sha256 is") && error.contains("rebuild or fetch the model again"),
            "{error}"
        );
    }

    #[test]
    fn a_missing_card_or_network_is_reported_by_name() {
        let Some(runtime) = runtime() else { return };
        for file in [CARD_FILE, MODEL_FILE] {
            let folder = model_folder(&toy_network(&MEANS, "descriptor"));
            std::fs::remove_file(folder.path().join(file)).unwrap();
            assert!(error_of(&folder, &runtime).contains(file));
            std::fs::create_dir(folder.path().join(file)).unwrap();
            assert!(error_of(&folder, &runtime).contains("not a regular file"));
        }
    }

    #[test]
    fn the_runtime_loads_again_in_one_process_and_another_one_is_refused() {
        let Some(runtime) = runtime() else { return };
        let again = OnnxRuntime::open(Some(runtime.path())).unwrap();
        assert_eq!((again.path(), again.version()), (runtime.path(), runtime.version()));
        let folder = TempDir::new().unwrap();
        let copy = folder.path().canonicalize().unwrap().join("libonnxruntime.so");
        std::fs::copy(runtime.path(), &copy).unwrap();
        let error = OnnxRuntime::open(Some(&copy)).unwrap_err();
        assert!(matches!(error, CnnError::AnotherRuntimeLoaded { .. }), "{error}");
    }

    fn default_model(runtime: &OnnxRuntime, threads: usize) -> DescriptorModel {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("models/efficientnet-lite0");
        DescriptorModel::open(&folder, runtime, threads).unwrap()
    }

    /// A made-up scene: sky, ground, and boxes whose place and colour follow from `seed`.
    fn scene(seed: usize) -> RgbImage {
        let (width, height) = (320, 240);
        let mut pixels = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let in_box = (0..6).find(|i| {
                    let (left, top) = ((seed * 37 + i * 61) % 250, (seed * 53 + i * 29) % 180);
                    (left..left + 40 + 7 * i).contains(&x) && (top..top + 60).contains(&y)
                });
                let ground = if y < 120 { [150, 180, 220] } else { [90, 80 + (x % 16) as u8, 60] };
                pixels
                    .extend(in_box.map_or(ground, |i| {
                        [(40 * i) as u8, (seed * 80 + 30 * i) as u8, 200 - 30 * i as u8]
                    }));
            }
        }
        RgbImage::from_pixels(width, height, pixels).unwrap()
    }

    fn mirrored(image: &RgbImage) -> RgbImage {
        let rows = (0..image.height()).flat_map(|y| image.row(y).chunks_exact(3).rev().flatten().copied());
        RgbImage::from_pixels(image.width(), image.height(), rows.collect()).unwrap()
    }

    #[test]
    fn the_default_model_tells_an_image_from_its_mirror_image_and_from_another() {
        let Some(runtime) = runtime() else { return };
        let mut model = default_model(&runtime, 1);
        let image = scene(1);
        let descriptor = model.describe(&image).unwrap();
        assert_eq!(descriptor.dimensions(), model.dimensions());
        let mut cosine = |other: &RgbImage| descriptor.cosine(&model.describe(other).unwrap());
        let (same, mirrored, other) = (cosine(&image), cosine(&mirrored(&image)), cosine(&scene(2)));
        assert!((same - 1.0).abs() < 1e-5, "{same}");
        assert!(mirrored < 0.999 && other < 0.99, "mirrored {mirrored}, other {other}");
    }

    #[test]
    fn two_openings_of_the_default_model_give_identical_descriptors() {
        let Some(runtime) = runtime() else { return };
        let (mut first, mut second) = (default_model(&runtime, 1), default_model(&runtime, 1));
        for seed in 0..3 {
            assert_eq!(first.describe(&scene(seed)).unwrap(), second.describe(&scene(seed)).unwrap());
        }
    }
}
