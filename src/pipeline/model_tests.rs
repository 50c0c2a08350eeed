//! Streams under which a model is replaced: small networks look at plain colours, each of which is a place.

use std::f32::consts::PI;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::*;
use crate::cnn::{
    CARD_FILE, CnnError, MEANS, MODEL_FILE, ModelCard, OnnxRuntime, installed_runtime, model_folder,
    toy_network,
};
use crate::feature::OrbOptions;
use crate::frame::Frame;
use crate::place_map::{MapError, MapOptions, PlaceMap};
use crate::raster::{GreyImage, RgbImage};
use crate::recognition::{Decision, RecognitionOptions};
use crate::source::SourceError;
use crate::telemetry::{CnnStatus, FrameRecord};
use crate::vocabulary::VocabularySet;

/// Colours whose means tell them apart: a lap through as many places.
const PLACES: usize = 20;
/// Longer than anything here takes.
const PATIENCE: Duration = Duration::from_secs(60);

/// Directions from grey that lie far apart from each other, as colours.
fn colour(place: usize) -> [u8; 3] {
    let height = 1.0 - (2 * place + 1) as f32 / PLACES as f32;
    let (radius, turn) = ((1.0 - height * height).sqrt(), place as f32 * PI * (3.0 - 5.0_f32.sqrt()));
    [radius * turn.cos(), radius * turn.sin(), height].map(|value| (100.0 + 90.0 * value) as u8)
}

/// What a stream said and answered.
#[derive(Default)]
struct Heard {
    said: Mutex<Vec<String>>,
    records: Mutex<Vec<FrameRecord>>,
}

impl Heard {
    fn say(&self, line: String) {
        self.said.lock().unwrap().push(line);
    }

    /// How many lines begin so.
    fn count(&self, beginning: &str) -> usize {
        self.said.lock().unwrap().iter().filter(|line| line.starts_with(beginning)).count()
    }
}

impl Watcher for Arc<Heard> {
    fn skipped(&self, error: &SourceError) {
        self.say(format!("skipped {error}"));
    }
    fn cnn_failed(&self, frame_name: &str, error: &CnnError) {
        self.say(format!("failed on {frame_name}: {error}"));
    }
    fn map_failed(&self, failure: &MapError, _: bool) {
        self.say(format!("map {failure}"));
    }
    fn model_changed(&self, card: &ModelCard, _: u64, described_anew: usize) {
        self.say(format!("changed to {} with {described_anew}", &card.sha256[..4]));
    }
    fn model_refused(&self, reason: &str, in_use: &ModelCard) {
        self.say(format!("refused for {}: {reason}", &in_use.sha256[..4]));
    }
    fn decided(&self, record: &FrameRecord) {
        self.records.lock().unwrap().push(record.clone());
    }
}

/// A drive that asks before every frame which colour comes; `None` ends it.
struct Drive<F> {
    index: u64,
    next: F,
    ends_at: Instant,
}

impl<F: FnMut(u64) -> Option<[u8; 3]> + Send> FrameSource for Drive<F> {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        sleep(Duration::from_millis(2));
        assert!(Instant::now() < self.ends_at, "what it waits for does not happen");
        let colour = (self.next)(self.index)?;
        self.index += 1;
        Some(Ok(Frame {
            index: self.index - 1,
            capture_nanos: 0,
            name: format!("{colour:?}"),
            colour: RgbImage::from_pixels(48, 48, colour.repeat(48 * 48)).unwrap(),
            grey: GreyImage::new(48, 48),
            jpeg: None,
            pose: None,
            true_place: None,
        }))
    }

    fn frame_count(&self) -> Option<u64> {
        None
    }
}

/// A robot with a folder for its map and its models.
struct Robot {
    folder: tempfile::TempDir,
    runtime: OnnxRuntime,
}

impl Robot {
    /// A robot whose model is the network of these operators; `None` where there is no ONNX Runtime.
    fn with_model(operators: &[&str]) -> Option<Self> {
        let robot = Self { folder: tempfile::tempdir().unwrap(), runtime: installed_runtime()? };
        robot.deploy(operators);
        Some(robot)
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Puts the network of these operators where the model is, at once.
    fn deploy(&self, operators: &[&str]) {
        deploy(self.folder.path(), operators);
    }

    fn drive(
        &self,
        options: RecognitionOptions,
        heard: &Arc<Heard>,
        next: impl FnMut(u64) -> Option<[u8; 3]> + Send + 'static,
    ) -> RunSummary {
        let folder = ModelFolder { path: self.at("current"), runtime: self.runtime.clone(), threads: 1 };
        let model = folder.open().unwrap();
        let vocabulary = concat!(env!("CARGO_MANIFEST_DIR"), "/vocab/default.lvoc");
        let vocabularies = Arc::new(VocabularySet::open(&[vocabulary.into()]).unwrap());
        let map = match options.read_only {
            true => PlaceMap::open_read_only(&self.at("map")).unwrap(),
            false => PlaceMap::open(&self.at("map"), MapOptions::default()).unwrap(),
        };
        let card = Some(model.card().clone());
        let recogniser = Recogniser::new(vocabularies, map, card, options).unwrap();
        let pipeline = Pipeline {
            source: Box::new(Drive { index: 0, next, ends_at: Instant::now() + PATIENCE }),
            extractor: OrbExtractor::new(OrbOptions::default()),
            model: Some(model),
            model_folder: Some(folder),
            recogniser,
            sinks: Vec::new(),
            budget: None,
        };
        pipeline.run(&AtomicBool::new(false), heard).unwrap()
    }

    fn models_in_map(&self) -> Vec<String> {
        PlaceMap::open_read_only(&self.at("map")).unwrap().models().unwrap().0
    }
}

/// Every frame founds a place. None has features, and without them none is poor.
fn options() -> RecognitionOptions {
    RecognitionOptions { place_interval: 0, keyframe_features: 0, ..RecognitionOptions::default() }
}

/// Turns the link `current` over to a folder with the network of these operators.
fn deploy(folder: &Path, operators: &[&str]) {
    let made = model_folder(&toy_network(operators, "descriptor"));
    let model = folder.join(made.path().file_name().unwrap());
    fs::rename(made.path(), &model).unwrap();
    let (beside, current) = (folder.join("next"), folder.join("current"));
    symlink(model, &beside).unwrap();
    fs::rename(beside, current).unwrap();
}

fn network_with(last: &[&'static str]) -> Vec<&'static str> {
    [&MEANS[..], last].concat()
}

/// Colours lap by lap, until so many frames were shown after `is_done`.
fn laps_until(
    mut is_done: impl FnMut(u64) -> bool + Send,
    frames_after: u64,
) -> impl FnMut(u64) -> Option<[u8; 3]> + Send {
    let mut done_at = None;
    move |index| {
        if done_at.is_none() && is_done(index) {
            done_at = Some(index);
        }
        let goes_on = done_at.is_none_or(|done_at| index < done_at + frames_after);
        goes_on.then(|| colour(index as usize % PLACES))
    }
}

/// Laps in which, at frame 50, a network that ends in `operators` is deployed, until 60 frames after that was `heard`
/// of.
fn laps_with_deployed(
    robot: &Robot,
    operators: &'static [&'static str],
    (heard, of): (&Arc<Heard>, &'static str),
) -> impl FnMut(u64) -> Option<[u8; 3]> + Send + use<> {
    let (hears, folder) = (Arc::clone(heard), robot.folder.path().to_owned());
    laps_until(
        move |index| {
            if index == 50 {
                deploy(&folder, &network_with(operators));
            }
            hears.count(of) > 0
        },
        60,
    )
}

/// Asserts that every frame was answered once, and from `from` on as the place that its colour is.
fn assert_all_known(heard: &Heard, from: usize) {
    let records = heard.records.lock().unwrap();
    for (index, record) in records.iter().enumerate() {
        assert_eq!(record.frame.index, index as u64);
        let answer = (record.recognition.decision, record.recognition.place.map(|place| place.0));
        let expected = (Decision::Recognised, Some((index % PLACES) as u32));
        assert!(index < from || answer == expected, "frame {index}: {answer:?} {:?}", heard.said);
    }
}

#[test]
fn a_model_that_is_deployed_takes_over_between_two_frames_and_all_of_them_are_answered_by_one_model_each() {
    let Some(robot) = Robot::with_model(&MEANS) else { return };
    let heard = Arc::new(Heard::default());
    // To it every colour is the opposite of what it is to the other one.
    let next = laps_with_deployed(&robot, &["Neg"], (&heard, "changed"));
    let summary = robot.drive(options(), &heard, next);
    assert_all_known(&heard, PLACES);
    assert_eq!(summary.model_changes, 1);
    assert_eq!(heard.said.lock().unwrap().len(), 1, "{:?}", heard.said);
    assert!(heard.said.lock().unwrap()[0].ends_with("with 20"), "{:?}", heard.said);
    let new = ModelCard::read(&robot.at("current").join(CARD_FILE)).unwrap();
    let changed: Vec<u64> = heard
        .records
        .lock()
        .unwrap()
        .iter()
        .filter(|record| record.model.as_ref() == Some(&new.sha256))
        .map(|record| record.frame.index)
        .collect();
    assert_eq!(changed.len(), 1, "the first record that it has part in says so");
    assert_eq!(robot.models_in_map(), [new.sha256], "the map keeps what was described anew");
    // The next start needs nothing of this.
    let again = Arc::new(Heard::default());
    robot.drive(options(), &again, laps_until(|_| true, 40));
    assert_all_known(&again, 0);
    assert_eq!(again.said.lock().unwrap().len(), 0, "{:?}", again.said);
}

#[test]
fn a_network_to_which_all_places_are_alike_is_refused_and_the_old_one_goes_on() {
    let Some(robot) = Robot::with_model(&MEANS) else { return };
    let heard = Arc::new(Heard::default());
    let next = laps_with_deployed(&robot, &["Sign", "Abs"], (&heard, "refused"));
    let summary = robot.drive(options(), &heard, next);
    assert_all_known(&heard, PLACES);
    assert_eq!(summary.model_changes, 0);
    assert_eq!(heard.said.lock().unwrap().len(), 1, "{:?}", heard.said);
    assert!(
        heard.said.lock().unwrap()[0].contains("pairs of different places look alike"),
        "{:?}",
        heard.said
    );
    assert_eq!(robot.models_in_map().len(), 1);
}

#[test]
fn a_model_that_fails_on_the_first_frames_is_taken_back_and_those_frames_are_described_by_the_old_one() {
    let Some(robot) = Robot::with_model(&MEANS) else { return };
    let (heard, folder) = (Arc::new(Heard::default()), robot.folder.path().to_owned());
    let hears = Arc::clone(&heard);
    let bright = [[190, 105, 105], [105, 190, 105], [105, 105, 190]];
    let mut came_back_at = None;
    let next = move |index: u64| {
        if index == 30 {
            // A logarithm, which bright colours alone have.
            deploy(&folder, &network_with(&["Log"]));
        }
        let changes = hears.count("changed");
        came_back_at = came_back_at.or((changes == 2).then_some(index));
        let goes_on = came_back_at.is_none_or(|at| index < at + 30);
        let is_dark = changes == 1 && index.is_multiple_of(2);
        goes_on.then(|| if is_dark { [30, 20, 70] } else { bright[index as usize % 3] })
    };
    let summary = robot.drive(options(), &heard, next);
    let said = heard.said.lock().unwrap();
    assert_eq!((summary.model_changes, summary.cnn_failures, said.len()), (2, 0, 3), "{said:?}");
    assert!(said.iter().any(|line| line.starts_with("refused") && line.contains("it fails on frames")));
    let records = heard.records.lock().unwrap();
    assert!(records.iter().all(|record| record.cnn == CnnStatus::Available));
    // Of a colour that comes for one frame at a time between known ones, nothing is founded.
    let bright = || records.iter().filter(|record| record.frame.name != "[30, 20, 70]");
    let known = bright().filter(|record| record.recognition.decision == Decision::Recognised);
    assert!(known.count() >= bright().count() - 5, "{said:?}");
    drop(records);
    let old = summary.map.map(|map| map.keyframes);
    assert!(old >= Some(3));
}

#[test]
fn a_half_written_folder_and_a_removed_one_are_said_once_each_and_what_comes_after_is_used() {
    let Some(robot) = Robot::with_model(&MEANS) else { return };
    let (heard, folder) = (Arc::new(Heard::default()), robot.folder.path().to_owned());
    let hears = Arc::clone(&heard);
    let mut refused_at = [None; 2];
    let next = laps_until(
        move |index| {
            let network = toy_network(&network_with(&["Neg"]), "descriptor");
            let (current, half) = (folder.join("current"), &network[..network.len() / 2]);
            let refused = hears.count("refused");
            let now = Instant::now();
            let waited =
                |since: &mut Option<Instant>| now - *since.get_or_insert(now) > Duration::from_secs(3);
            match (index, refused) {
                (50, _) => {
                    deploy(&folder, &network_with(&["Neg"]));
                    fs::write(current.join(MODEL_FILE), half).unwrap();
                }
                (_, 1) if current.exists() && waited(&mut refused_at[0]) => fs::remove_file(current).unwrap(),
                (_, 2) if !current.exists() && waited(&mut refused_at[1]) => {
                    deploy(&folder, &network_with(&["Neg"]));
                }
                _ => {}
            }
            hears.count("changed") > 0
        },
        30,
    );
    robot.drive(options(), &heard, next);
    assert_all_known(&heard, PLACES);
    let said = heard.said.lock().unwrap();
    let parts = ["model.onnx: sha256 is", "card.toml: cannot read", "changed"];
    assert_eq!(said.len(), parts.len(), "{said:?}");
    assert!(said.iter().zip(parts).all(|(line, part)| line.contains(part)), "{said:?}");
}

#[test]
fn a_map_of_another_model_is_recognised_by_the_cnn_again_after_a_while_and_keeps_that_if_it_may() {
    let Some(robot) = Robot::with_model(&MEANS) else { return };
    robot.drive(options(), &Arc::new(Heard::default()), laps_until(|_| true, 2 * PLACES as u64));
    let old = robot.models_in_map();
    robot.deploy(&network_with(&["Neg"]));
    let all_recognised = |heard: &Arc<Heard>| {
        let hears = Arc::clone(heard);
        move |_: u64| {
            let records = hears.records.lock().unwrap();
            let lap = records.iter().rev().take(PLACES);
            lap.filter(|record| record.recognition.decision == Decision::Recognised).count() == PLACES
        }
    };
    let heard = Arc::new(Heard::default());
    let read_only = RecognitionOptions { read_only: true, ..options() };
    robot.drive(read_only, &heard, laps_until(all_recognised(&heard), PLACES as u64));
    assert_eq!(heard.records.lock().unwrap()[0].recognition.decision, Decision::Unknown);
    assert_eq!(robot.models_in_map(), old, "who only reads writes nothing");
    let heard = Arc::new(Heard::default());
    robot.drive(options(), &heard, laps_until(all_recognised(&heard), 3 * PLACES as u64));
    assert_ne!(robot.models_in_map(), old);
    assert_eq!(robot.models_in_map().len(), 1);
    assert_eq!(heard.said.lock().unwrap().len(), 0, "{:?}", heard.said);
}
