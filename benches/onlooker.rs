//! What it costs the thread that decides when rerun looks on at `normal`, in a small map and in one of 10,000 places:
//! `cargo bench --no-default-features --features cnn --bench onlooker`.
//!
//! Two robots see the same frames, of a synthetic street that they drove before, in turn: of one somebody looks on.

mod made_up_map;

use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use loci::cnn::{CARD_FILE, DescriptorModel, ModelCard, OnnxRuntime};
use loci::feature::{OrbExtractor, OrbOptions};
use loci::frame::Frame;
use loci::place_map::{MapOptions, PlaceMap};
use loci::recognition::{Insight, Look, Recogniser, RecognitionOptions};
use loci::source;
use loci::vocabulary::{Light, Vocabulary, VocabularySet};

const MODEL: &str = "models/efficientnet-lite0";
const VOCABULARY: &str = "vocab/default.lvoc";
const STREET: &str = "synthetic:street?laps=2&frames=150&light=noon,dusk&seed=7";
const KEYFRAMES: u64 = 50_000;
/// Frames of the second lap, in which most places are known.
const FIRST_TIMED: usize = 150;

fn main() -> Result<(), Box<dyn Error>> {
    let seen = looks()?;
    let vocabularies = Arc::new(VocabularySet::open(&[VOCABULARY.into()])?);
    let card = ModelCard::read(&Path::new(MODEL).join(CARD_FILE))?;
    for keyframes in [0, KEYFRAMES] {
        let folder = tempfile::tempdir()?;
        let mut robots = Vec::new();
        for robot in ["alone", "watched"] {
            let folder = folder.path().join(robot);
            if keyframes > 0 {
                made_up_map::write(
                    &folder,
                    keyframes,
                    &Vocabulary::open(Path::new(VOCABULARY))?,
                    &card.sha256,
                );
            }
            let map = PlaceMap::open(&folder, MapOptions::default())?;
            let options = RecognitionOptions::default();
            robots.push(Recogniser::new(vocabularies.clone(), map, Some(card.clone()), options)?);
        }
        let [alone_us, told_us, extra_us] = compare(&mut robots, &seen)?;
        println!(
            "{keyframes} keyframes made up, medians of {} frames: {alone_us:.0} us alone, {told_us:.0} us for what is \
             told, {extra_us:.0} us more in all",
            seen.len() - FIRST_TIMED
        );
    }
    Ok(())
}

/// The frames with what is seen in them.
fn looks() -> Result<Vec<(Frame, Look)>, Box<dyn Error>> {
    let mut model = DescriptorModel::open(Path::new(MODEL), &OnnxRuntime::open(None)?, 2)?;
    let mut extractor = OrbExtractor::new(OrbOptions::default());
    let vocabularies = VocabularySet::open(&[VOCABULARY.into()])?;
    let mut street = source::open(STREET, None)?;
    let mut seen = Vec::new();
    while let Some(frame) = street.next_frame() {
        let frame = frame?;
        let features = extractor.extract(&frame.grey);
        let look =
            Look::new(features, (&vocabularies, Light::default()), Some(model.describe(&frame.colour)?));
        seen.push((frame, look));
    }
    Ok(seen)
}

/// How long the first robot takes for a frame, how long what is told of it takes the second one, and how much longer
/// that takes in all, as medians in microseconds.
fn compare(robots: &mut [Recogniser], seen: &[(Frame, Look)]) -> Result<[f64; 3], Box<dyn Error>> {
    let [alone, watched] = robots else { return Err("there are two robots".into()) };
    watched.keep_insight();
    let mut insight = Insight::default();
    let mut times_us: [Vec<f64>; 3] = Default::default();
    for (index, (frame, look)) in seen.iter().enumerate() {
        let thumbnail = source::thumbnail_jpeg(&frame.colour);
        let (mut alone_us, mut watched_us, mut told_us) = (0.0, 0.0, 0.0);
        // Whoever comes second finds the caches warm.
        for is_watched in [index % 2 == 0, index % 2 == 1] {
            let robot = if is_watched { &mut *watched } else { &mut *alone };
            let started = Instant::now();
            let answer = robot.recognise(frame, look, || thumbnail.clone());
            if !is_watched {
                alone_us = micros(started);
                continue;
            }
            let answered = Instant::now();
            robot.tell(&answer, &mut insight);
            robot.matched_keyframe(&answer)?;
            (watched_us, told_us) = (micros(started), micros(answered));
        }
        if index >= FIRST_TIMED {
            let of_frame = [alone_us, told_us, watched_us - alone_us];
            times_us.iter_mut().zip(of_frame).for_each(|(times, time)| times.push(time));
        }
    }
    Ok(times_us.map(median))
}

fn micros(started: Instant) -> f64 {
    started.elapsed().as_secs_f64() * 1e6
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
