//! A whole frame, from its JPEG to the decision, in a map of 10,000 places, two threads:
//! `cargo bench --no-default-features --features cnn --bench frame -- [MODEL] [IMAGES]`.
//!
//! The map is made up, so that no frame is of a place in it; frames are of the synthetic street unless JPEGs are named.

mod made_up_map;

use std::error::Error;
use std::fs;
use std::path::Path;
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::Instant;

use loci::cnn::{DescriptorModel, OnnxRuntime};
use loci::feature::{OrbExtractor, OrbOptions};
use loci::frame::Frame;
use loci::kernel;
use loci::place_map::PlaceMap;
use loci::recognition::{Look, Recogniser, RecognitionOptions};
use loci::source;
use loci::vocabulary::{Light, Vocabulary, VocabularySet};

const KEYFRAMES: u64 = 50_000;
const LEAST_FRAMES: usize = 600;
const MODEL: &str = "models/efficientnet-lite0";
const VOCABULARY: &str = "vocab/default.lvoc";

/// What a frame goes through.
struct Robot {
    model: DescriptorModel,
    extractor: OrbExtractor,
    vocabularies: Arc<VocabularySet>,
    recogniser: Recogniser,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let model = arguments.next().unwrap_or_else(|| MODEL.to_owned());
    let mut jpegs = arguments.map(fs::read).collect::<Result<Vec<_>, _>>()?;
    if jpegs.is_empty() {
        jpegs = street()?;
    }
    let folder = tempfile::tempdir()?;
    let mut robot = Robot::new(Path::new(&model), folder.path())?;
    let rounds = LEAST_FRAMES.div_ceil(jpegs.len());
    let mut times_ms = Vec::new();
    for jpeg in jpegs.iter().cycle().take(rounds * jpegs.len()) {
        let started = Instant::now();
        robot.decide(jpeg)?;
        times_ms.push(started.elapsed().as_secs_f64() * 1e3);
    }
    println!("{} frames, {model}: {}", times_ms.len(), told(times_ms));
    println!("its CNN alone: {}", told(robot.describe_alone(&jpegs)?));
    println!("one frame after the other: {:.0} a second", robot.frames_a_second(&jpegs)?);
    Ok(())
}

fn told(mut times_ms: Vec<f64>) -> String {
    times_ms.sort_by(f64::total_cmp);
    let at = |percent: usize| times_ms[times_ms.len() * percent / 100];
    format!("median {:.1} ms, 99 of 100 {:.1} ms", at(50), at(99))
}

fn street() -> Result<Vec<Vec<u8>>, Box<dyn Error>> {
    let mut street = source::open("synthetic:street?laps=1&light=noon&frames=60&seed=7", None)?;
    let mut jpegs = Vec::new();
    while let Some(frame) = street.next_frame() {
        jpegs.push(source::jpeg(&frame?.colour));
    }
    Ok(jpegs)
}

fn frame_of(jpeg: &[u8]) -> Result<Frame, Box<dyn Error>> {
    let colour = source::decode(jpeg, "frame")?;
    Ok(Frame { grey: kernel::luma(&colour), colour, ..made_up_map::frame(0) })
}

impl Robot {
    fn new(model: &Path, folder: &Path) -> Result<Self, Box<dyn Error>> {
        let model = DescriptorModel::open(model, &OnnxRuntime::open(None)?, 1)?;
        made_up_map::write(
            folder,
            KEYFRAMES,
            &Vocabulary::open(Path::new(VOCABULARY))?,
            &model.card().sha256,
        );
        let vocabularies = Arc::new(VocabularySet::open(&[VOCABULARY.into()])?);
        let options = RecognitionOptions { read_only: true, ..RecognitionOptions::default() };
        let (map, card) = (PlaceMap::open_read_only(folder)?, model.card().clone());
        let recogniser = Recogniser::new(Arc::clone(&vocabularies), map, Some(card), options)?;
        Ok(Self { model, extractor: OrbExtractor::new(OrbOptions::default()), vocabularies, recogniser })
    }

    /// Milliseconds that the CNN takes for each image, nothing else being done.
    fn describe_alone(&mut self, jpegs: &[Vec<u8>]) -> Result<Vec<f64>, Box<dyn Error>> {
        let mut times_ms = Vec::new();
        for jpeg in jpegs {
            let colour = source::decode(jpeg, "frame")?;
            let started = Instant::now();
            self.model.describe(&colour)?;
            times_ms.push(started.elapsed().as_secs_f64() * 1e3);
        }
        Ok(times_ms)
    }

    /// Frames that are decided about in a second while the CNN already looks at the next one.
    fn frames_a_second(&mut self, jpegs: &[Vec<u8>]) -> Result<f64, Box<dyn Error>> {
        let Self { model, extractor, vocabularies, recogniser } = self;
        let (to_cnn, frames) = mpsc::sync_channel::<Arc<Frame>>(1);
        let (described, descriptors) = mpsc::sync_channel(2);
        let started = Instant::now();
        thread::scope(|scope| {
            scope.spawn(move || {
                frames.iter().try_for_each(|frame| described.send(model.describe(&frame.colour)))
            });
            let mut before: Option<(Arc<Frame>, Look)> = None;
            for jpeg in jpegs {
                let frame = Arc::new(frame_of(jpeg)?);
                to_cnn.send(Arc::clone(&frame))?;
                let features = extractor.extract(&frame.grey);
                let look = Look::new(features, (vocabularies, Light::default()), None);
                if let Some((frame, look)) = before.replace((frame, look)) {
                    let look = Look { appearance: Some(descriptors.recv()??), ..look };
                    recogniser.recognise(&frame, &look, Vec::new);
                }
            }
            drop(to_cnn);
            descriptors.recv()??;
            Ok((jpegs.len() - 1) as f64 / started.elapsed().as_secs_f64())
        })
    }

    fn decide(&mut self, jpeg: &[u8]) -> Result<(), Box<dyn Error>> {
        let Self { model, extractor, vocabularies, recogniser } = self;
        let frame = frame_of(jpeg)?;
        let (look, described) = thread::scope(|scope| {
            let describing = scope.spawn(|| model.describe(&frame.colour));
            let features = extractor.extract(&frame.grey);
            let look = Look::new(features, (vocabularies, Light::default()), None);
            (look, describing.join())
        });
        let appearance = Some(described.map_err(|_| "the CNN's thread failed")??);
        recogniser.recognise(&frame, &Look { appearance, ..look }, Vec::new);
        Ok(())
    }
}
