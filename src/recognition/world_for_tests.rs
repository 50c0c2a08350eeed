//! A made-up world for the tests of recognition: places are random features, looks are CNN descriptors that have
//! nothing in common.

use std::path::Path;
use std::sync::Arc;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::{Look, Recogniser, Recognition, RecognitionOptions};
use crate::cnn;
use crate::feature::{Descriptor, Features, Keypoint};
use crate::frame::Frame;
use crate::geometry::Point;
use crate::place_map::{Appearance, MapOptions, NewExperience, PlaceId, PlaceMap, Traits};
use crate::vocabulary::{LightSwitch, MemoryCorpus, TrainingOptions, VocabularySet, train, train_on};

pub(super) const DIMENSIONS: usize = 16;

/// Features of every place, enough to fill a keyframe.
const FEATURES: usize = 260;

pub(super) fn in_memory() -> PlaceMap {
    PlaceMap::in_memory(MapOptions::default()).unwrap()
}

pub(super) fn opened(folder: &Path) -> PlaceMap {
    PlaceMap::open(folder, MapOptions::default()).unwrap()
}

/// Adds a place whose keyframes show the features of one place and the looks of another each.
pub(super) fn place_of(map: &mut PlaceMap, keyframes: &[(u64, usize)]) -> PlaceId {
    let mut place = None;
    for (index, &(of, look)) in (0..).zip(keyframes) {
        place = Some(learn(map, place, (index, of, look)));
    }
    place.unwrap()
}

pub(super) fn learn(
    map: &mut PlaceMap,
    place: Option<PlaceId>,
    (index, of, look): (u64, u64, usize),
) -> PlaceId {
    let descriptor = (&appearance(look)).into();
    let appearance = Some(Appearance { model: card().sha256, descriptor });
    let traits = Traits { words: Vec::new(), appearance };
    let keyframe = Some((&features(of), &traits));
    map.learn(place, &NewExperience { keyframe, ..new(&Frame::numbered(index)) }).unwrap().place
}

pub(super) fn new(frame: &Frame) -> NewExperience<'_> {
    NewExperience { frame, view: 0, mean_luminance: 120.0, thumbnail_jpeg: &[], keyframe: None }
}

/// The features that are seen at a made-up place.
pub(super) fn features(place: u64) -> Features {
    let mut random = Pcg64::seed_from_u64(place);
    let mut features = Features { width_px: 640, height_px: 480, ..Features::default() };
    for _ in 0..FEATURES {
        let point = Point { x: random.random_range(0.0..640.0), y: random.random_range(0.0..480.0) };
        features.keypoints.push(Keypoint { point, scale: 1.0, angle_radians: 0.0, response: 20 });
        features.descriptors.push(Descriptor(random.random()));
    }
    features
}

/// A CNN descriptor that has nothing in common with that of another look below [`DIMENSIONS`].
pub(super) fn appearance(look: usize) -> cnn::Descriptor {
    cnn::Descriptor::from_values((0..DIMENSIONS).map(|i| f32::from(i == look)).collect()).unwrap()
}

pub(super) fn card() -> cnn::ModelCard {
    let text = "
        name = 'test'\nversion = '1'\ndescription = ''\nlicence = ''\nsource = ''\nrecipe = ''
        sha256 = '0000000000000000000000000000000000000000000000000000000000000000'
        input = { name = 'image', width_px = 32, height_px = 32, mean = 0.0, scale = 1.0 }
        descriptor = { name = 'descriptor', dimensions = 16 }
        decision = { recognise_above = 0.8, calibration_slope = 20.0, calibration_offset = -15.0 }
        training = { data = '' }\nmetrics = {}";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("card.toml");
    std::fs::write(&path, text).unwrap();
    cnn::ModelCard::read(&path).unwrap()
}

/// No frame joins a place unasked.
pub(super) fn no_interval() -> RecognitionOptions {
    RecognitionOptions { place_interval: 0, ..RecognitionOptions::default() }
}

/// A robot in a made-up world.
pub(super) struct Robot {
    pub(super) recogniser: Recogniser,
    light: LightSwitch,
    frames: u64,
}

impl Robot {
    pub(super) fn new(model: Option<cnn::ModelCard>, options: RecognitionOptions, map: PlaceMap) -> Self {
        let images: Vec<Vec<Descriptor>> = (0..8).map(|place| features(place).descriptors).collect();
        let vocabulary =
            train(&images, TrainingOptions { branching: 6, depth: 3, ..TrainingOptions::default() }).unwrap();
        let recogniser = Recogniser::new(Arc::new(vocabulary.into()), map, model, options).unwrap();
        Self { recogniser, light: LightSwitch::default(), frames: 0 }
    }

    pub(super) fn with_cnn() -> Self {
        Self::new(Some(card()), no_interval(), in_memory())
    }

    pub(super) fn without_cnn() -> Self {
        Self::new(None, no_interval(), in_memory())
    }

    /// A robot with two vocabularies, for the light of 40 and of 120.
    pub(super) fn by_day_and_night() -> Self {
        let vocabulary = |places: std::ops::Range<u64>, luminance: f32| {
            let images: Vec<Vec<Descriptor>> = places.map(|place| features(place).descriptors).collect();
            let corpus = MemoryCorpus { images: &images, mean_luminance: Some(luminance) };
            let options = TrainingOptions { branching: 6, depth: 3, ..TrainingOptions::default() };
            (format!("{luminance}").into(), train_on(&corpus, options, &()).unwrap().vocabulary)
        };
        let set = VocabularySet::new(vec![vocabulary(0..8, 120.0), vocabulary(100..108, 40.0)]).unwrap();
        let map = in_memory();
        let recogniser = Recogniser::new(Arc::new(set), map, Some(card()), no_interval()).unwrap();
        Self { recogniser, light: LightSwitch::default(), frames: 0 }
    }

    /// Looks at the features of one place and the CNN descriptor of a look, if there is a CNN.
    pub(super) fn see(&mut self, place: u64, look: usize) -> Recognition {
        self.see_in(120.0, place, look)
    }

    /// The same in a frame of that luminance.
    pub(super) fn see_in(&mut self, mean_luminance: f32, place: u64, look: usize) -> Recognition {
        self.see_features(mean_luminance, features(place), look)
    }

    /// The same of a frame that shows only a few features, for it is blurred.
    pub(super) fn see_blurred(&mut self, place: u64, look: usize) -> Recognition {
        self.see_features(120.0, features(place).foremost(FEATURES / 4), look)
    }

    fn see_features(&mut self, mean_luminance: f32, features: Features, look: usize) -> Recognition {
        let frame = self.frame();
        self.frames += 1;
        let appearance = self.recogniser.has_cnn().then(|| appearance(look));
        let vocabularies = self.recogniser.vocabularies();
        let light = self.light.follow(vocabularies, mean_luminance);
        let thumbnail = look as u8;
        let look = Look::new(features, (vocabularies, light), appearance);
        self.recogniser.recognise(&frame, &look, || vec![thumbnail])
    }

    pub(super) fn frame(&self) -> Frame {
        Frame::numbered(self.frames)
    }

    /// Goes to a place that no test looks at.
    pub(super) fn leave(&mut self) {
        self.see(7, 15);
    }

    pub(super) fn keyframes(&self) -> usize {
        self.recogniser.map().summary().keyframes
    }
}
