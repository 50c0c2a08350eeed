//! A map of made-up keyframes: 256 features and a CNN descriptor of 256 values each, five a place.

use std::path::Path;

use loci::cnn;
use loci::feature::{Descriptor, Features, Keypoint};
use loci::frame::Frame;
use loci::geometry::Point;
use loci::place_map::{Appearance, Durability, MapOptions, NewExperience, PlaceMap, Traits, VocabularyWords};
use loci::raster::{GreyImage, RgbImage};
use loci::vocabulary::{Vocabulary, WordId};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

const KEYFRAMES_A_PLACE: u64 = 5;
const FEATURES: usize = 256;
const DESCRIPTOR_DIMENSIONS: usize = 256;

pub(crate) fn frame(index: u64) -> Frame {
    Frame {
        index,
        capture_nanos: index as i64,
        name: format!("{index:06}.jpg"),
        colour: RgbImage::new(1, 1),
        grey: GreyImage::new(1, 1),
        jpeg: None,
        pose: None,
        true_place: None,
    }
}

pub(crate) fn features(random: &mut Pcg64) -> Features {
    let keypoint = |random: &mut Pcg64| Keypoint {
        point: Point { x: random.random_range(0.0..640.0), y: random.random_range(0.0..480.0) },
        scale: 1.0,
        angle_radians: random.random_range(-3.0..3.0),
        response: 20,
    };
    Features {
        width_px: 640,
        height_px: 480,
        keypoints: (0..FEATURES).map(|_| keypoint(random)).collect(),
        descriptors: (0..FEATURES).map(|_| Descriptor(random.random())).collect(),
    }
}

fn appearance(model: &str, random: &mut Pcg64) -> Appearance {
    let values = (0..DESCRIPTOR_DIMENSIONS).map(|_| random.random_range(-1.0..1.0)).collect();
    let descriptor = cnn::Descriptor::from_values(values).expect("a direction");
    Appearance { model: model.to_owned(), descriptor: (&descriptor).into() }
}

/// Writes a map of so many keyframes to `folder`, their descriptors as if by the model of that hash.
pub(crate) fn write(folder: &Path, keyframes: u64, vocabulary: &Vocabulary, model: &str) {
    let options = MapOptions { durability: Durability::None, ..MapOptions::default() };
    let mut map = PlaceMap::open(folder, options).expect("a new map");
    let mut random = Pcg64::seed_from_u64(1);
    let mut place = None;
    for index in 0..keyframes {
        let features = features(&mut random);
        let quantised = vocabulary.quantise_all(&features.descriptors);
        let mut words: Vec<WordId> = quantised.iter().map(|quantised| quantised.word).collect();
        words.sort_unstable();
        let traits = Traits {
            words: vec![VocabularyWords { vocabulary: vocabulary.fingerprint(), words }],
            appearance: Some(appearance(model, &mut random)),
        };
        let new = NewExperience {
            frame: &frame(index),
            view: index,
            mean_luminance: 100.0,
            thumbnail_jpeg: &[],
            keyframe: Some((&features, &traits)),
        };
        let learnt = map.learn(place.filter(|_| index % KEYFRAMES_A_PLACE > 0), &new).expect("room");
        place = Some(learnt.place);
    }
    map.close().expect("a snapshot");
}
