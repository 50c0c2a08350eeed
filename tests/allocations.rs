//! Which memory a robot asks for while it looks at one frame after the other.

use std::alloc::System;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use loci::cnn::{Descriptor, ModelCard};
use loci::feature::{OrbExtractor, OrbOptions};
use loci::frame::Frame;
use loci::place_map::{MapOptions, PlaceMap};
use loci::recognition::{Decision, Look, Recogniser, RecognitionOptions};
use loci::source;
use loci::vocabulary::{LightSwitch, Vocabulary, VocabularySet};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static HEAP: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Allocations of every step, those that grew included, over all frames.
#[derive(Debug, Default, PartialEq)]
struct Counts(BTreeMap<&'static str, usize>);

impl Counts {
    fn of<T>(&mut self, step: &'static str, work: impl FnOnce() -> T) -> T {
        let region = Region::new(HEAP);
        let answer = work();
        let change = region.change();
        *self.0.entry(step).or_default() += change.allocations + change.reallocations;
        answer
    }

    /// The steps that took memory.
    fn taking(&self) -> Vec<(&'static str, usize)> {
        self.0.iter().map(|(&step, &count)| (step, count)).filter(|step| step.1 > 0).collect()
    }
}

fn shipped(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// A descriptor of what the frame looks like from afar, for a build without a CNN.
fn appearance(frame: &Frame, spare: Option<Descriptor>) -> Descriptor {
    let mut values = spare.map_or_else(Vec::new, Descriptor::into_values);
    values.clear();
    let (width, height) = (frame.grey.width(), frame.grey.height());
    for y in (0..height).step_by(30) {
        values.extend((0..width).step_by(30).map(|x| f32::from(frame.grey.row(y)[x]) - 128.0));
    }
    Descriptor::from_values(values).unwrap()
}

/// What sees and decides, and what it keeps from frame to frame, as the stages of the pipeline do.
struct Robot {
    extractor: OrbExtractor,
    light: LightSwitch,
    recogniser: Recogniser,
    look: Look,
}

impl Robot {
    fn new(vocabularies: &Arc<VocabularySet>, map: PlaceMap, options: RecognitionOptions) -> Self {
        let card = ModelCard::read(&shipped("models/efficientnet-lite0/card.toml")).unwrap();
        let recogniser = Recogniser::new(Arc::clone(vocabularies), map, Some(card), options).unwrap();
        let extractor = OrbExtractor::new(OrbOptions::default());
        Self { extractor, light: LightSwitch::default(), recogniser, look: Look::default() }
    }

    /// How many of the frames show a place that is known.
    fn see_all(&mut self, frames: &[Frame], counts: &mut Counts) -> usize {
        let is_known = |decision| matches!(decision, Decision::Recognised | Decision::Revisited);
        frames.iter().filter(|frame| is_known(self.see(frame, counts))).count()
    }

    fn see(&mut self, frame: &Frame, counts: &mut Counts) -> Decision {
        let Self { extractor, light, recogniser, look } = self;
        let vocabularies = Arc::clone(recogniser.vocabularies());
        look.light = light.follow(&vocabularies, frame.grey.mean_luminance());
        counts.of("features", || extractor.extract_into(&frame.grey, &mut look.features));
        counts.of("words", || {
            let vocabulary = vocabularies.vocabulary(look.light.condition);
            vocabulary.quantise_into(&look.features.descriptors, &mut look.quantised);
        });
        look.appearance = Some(appearance(frame, look.appearance.take()));
        let mut candidates = counts.of("retrieve", || recogniser.retrieve(look));
        let verified = counts.of("verify", || recogniser.verify(look, &mut candidates));
        let answer = counts.of("decide", || recogniser.decide(frame, look, (candidates, verified), Vec::new));
        let decision = answer.decision;
        recogniser.reuse(answer);
        decision
    }
}

/// Has the shipped network describe frames, where there is a runtime for it.
#[cfg(feature = "cnn")]
fn describe(frames: &[Frame], counts: &mut Counts) {
    let runtime = match loci::cnn::OnnxRuntime::open(None) {
        Ok(runtime) => runtime,
        Err(_) if std::env::var_os("LOCI_WITHOUT_ONNXRUNTIME").is_some_and(|value| value == "1") => return,
        Err(error) => panic!("{error}; or set LOCI_WITHOUT_ONNXRUNTIME=1 to leave the CNN out"),
    };
    let folder = shipped("models/efficientnet-lite0");
    let mut model = loci::cnn::DescriptorModel::open(&folder, &runtime, 1).unwrap();
    let mut spare = Some(model.describe(&frames[0].colour).unwrap());
    for frame in &frames[1..] {
        let descriptor = counts.of("describe", || model.describe_reusing(&frame.colour, spare.take()));
        spare = Some(descriptor.unwrap());
    }
}

/// A robot that goes round a street, and the frames of its second round.
fn second_round(folder: &Path, vocabularies: &Arc<VocabularySet>) -> Vec<Frame> {
    let mut street = source::open("synthetic:street?laps=2&light=noon&frames=20&seed=7", None).unwrap();
    let mut frames: Vec<Frame> = std::iter::from_fn(|| street.next_frame()).map(Result::unwrap).collect();
    let second = frames.split_off(frames.len() / 2);
    let mut map = PlaceMap::open(folder, MapOptions::default()).unwrap();
    let mut robot = Robot::new(vocabularies, map, RecognitionOptions::default());
    robot.see_all(&frames, &mut Counts::default());
    map = robot.recogniser.into_map();
    let places: Vec<_> = map.places().map(|place| place.id).collect();
    places.iter().for_each(|&place| map.name_place(place, "somewhere along the street").unwrap());
    map.close().unwrap();
    second
}

/// One test, for other threads would be counted, too.
#[test]
fn frames_of_known_places_take_no_memory() {
    let vocabulary = Vocabulary::open(&shipped("vocab/default.lvoc")).unwrap();
    let vocabularies = Arc::new(VocabularySet::from(vocabulary));
    let folder = tempfile::tempdir().unwrap();
    let frames = second_round(folder.path(), &vocabularies);
    let mut counts = Counts::default();
    #[cfg(feature = "cnn")]
    describe(&frames, &mut counts);
    let map = PlaceMap::open_read_only(folder.path()).unwrap();
    let options = RecognitionOptions { read_only: true, ..RecognitionOptions::default() };
    let mut robot = Robot::new(&vocabularies, map, options);
    robot.see_all(&frames, &mut Counts::default());
    let known = robot.see_all(&frames, &mut counts);
    assert!(known > frames.len() / 2, "{known} of {} frames are known", frames.len());
    assert_eq!(counts.taking(), [], "allocations over {} frames", frames.len());

    // Of what is learnt only the records are kept anew; a robot that stands still needs no more keyframes.
    let map = PlaceMap::open(folder.path(), MapOptions::default()).unwrap();
    let mut robot = Robot::new(&vocabularies, map, RecognitionOptions::default());
    let still: Vec<Frame> = (0..20).map(|_| frames[0].clone()).collect();
    robot.see_all(&still, &mut Counts::default());
    let (mut counts, before) = (Counts::default(), robot.recogniser.map().experiences_ever());
    robot.see_all(&still, &mut counts);
    assert!(robot.recogniser.map().experiences_ever() > before, "something was learnt");
    counts.0.remove("decide");
    assert_eq!(counts.taking(), [], "allocations over {} frames that may be learnt", frames.len());
}
