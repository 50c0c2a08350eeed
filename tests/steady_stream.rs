//! Which memory a whole stream asks for, all its threads together, while a robot goes round where it knows its way.

use std::alloc::System;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::Duration;

use loci::cnn::CnnError;
use loci::feature::{OrbExtractor, OrbOptions};
use loci::frame::Frame;
use loci::pipeline::{Pipeline, RunSummary, Watcher};
use loci::place_map::{MapError, MapOptions, PlaceMap};
use loci::raster::{GreyImage, RgbImage};
use loci::recognition::{Decision, Recogniser, RecognitionOptions};
use loci::source::{self, FrameSource, SourceError};
use loci::telemetry::{FrameRecord, RecognitionSink, TelemetryError};
use loci::vocabulary::{Vocabulary, VocabularySet};
use stats_alloc::{INSTRUMENTED_SYSTEM, StatsAlloc};

#[global_allocator]
static HEAP: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Rounds that are made before it is counted, and in all.
const WARM_ROUNDS: usize = 2;
const ROUNDS: usize = 5;
/// From one frame of a camera to the next.
const INTERVAL: Duration = Duration::from_millis(15);

/// Frames again and again, each in the memory of one that nobody needs any more, as a camera's are.
struct Round {
    frames: Vec<Frame>,
    index: usize,
    rounds: usize,
    is_live: bool,
}

impl FrameSource for Round {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        self.next_frame_in(None)
    }

    fn next_frame_in(&mut self, spare: Option<Frame>) -> Option<Result<Frame, SourceError>> {
        if self.is_live {
            sleep(INTERVAL);
        }
        let shown = &self.frames[self.index % self.frames.len()];
        self.index += 1;
        if self.index > self.rounds * self.frames.len() {
            return None;
        }
        let Some(Frame { mut name, colour, grey, .. }) = spare else { return Some(Ok(shown.clone())) };
        name.clone_from(&shown.name);
        let (mut colours, mut greys) = (colour.into_pixels(), grey.into_pixels());
        colours.clear();
        colours.extend_from_slice(shown.colour.pixels());
        greys.clear();
        greys.extend_from_slice(shown.grey.pixels());
        let (width, height) = (shown.grey.width(), shown.grey.height());
        Some(Ok(Frame {
            index: self.index as u64,
            capture_nanos: shown.capture_nanos,
            name,
            colour: RgbImage::from_pixels(width, height, colours)?,
            grey: GreyImage::from_pixels(width, height, greys)?,
            jpeg: None,
            pose: None,
            true_place: None,
        }))
    }

    fn frame_count(&self) -> Option<u64> {
        None
    }

    fn is_live(&self) -> bool {
        self.is_live
    }
}

/// Notes how often memory was asked for until each record came; in memory that it has already.
struct Counting(Arc<Mutex<Vec<usize>>>);

impl RecognitionSink for Counting {
    fn record(&mut self, _: &FrameRecord) -> Result<(), TelemetryError> {
        let stats = HEAP.stats();
        self.0.lock().unwrap().push(stats.allocations + stats.reallocations);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), TelemetryError> {
        Ok(())
    }
}

struct Nobody;

impl Watcher for Nobody {
    fn skipped(&self, error: &SourceError) {
        panic!("{error}");
    }
    fn cnn_failed(&self, _: &str, error: &CnnError) {
        panic!("{error}");
    }
    fn map_failed(&self, failure: &MapError, _: bool) {
        panic!("{failure}");
    }
}

fn run(
    round: Round,
    (vocabularies, map): (&Arc<VocabularySet>, PlaceMap),
    sinks: Vec<Box<dyn RecognitionSink>>,
) -> RunSummary {
    let options = RecognitionOptions { read_only: round.rounds > 1, ..RecognitionOptions::default() };
    let pipeline = Pipeline {
        source: Box::new(round),
        extractor: OrbExtractor::new(OrbOptions::default()),
        model: None,
        model_folder: None,
        recogniser: Recogniser::new(Arc::clone(vocabularies), map, None, options).unwrap(),
        sinks,
        budget: None,
    };
    let stop = AtomicBool::new(false);
    let summary = pipeline.run(&stop, &Nobody).unwrap();
    assert!(!stop.load(Ordering::Relaxed));
    summary
}

/// One test, for other threads would be counted, too.
#[test]
fn a_stream_in_which_nothing_is_new_takes_no_memory() {
    let vocabulary = Path::new(env!("CARGO_MANIFEST_DIR")).join("vocab/default.lvoc");
    let vocabularies = Arc::new(VocabularySet::from(Vocabulary::open(&vocabulary).unwrap()));
    let mut street = source::open("synthetic:street?laps=1&light=noon&frames=20&seed=7", None).unwrap();
    let frames: Vec<Frame> = std::iter::from_fn(|| street.next_frame()).map(Result::unwrap).collect();
    let folder = tempfile::tempdir().unwrap();
    let map = PlaceMap::open(folder.path(), MapOptions::default()).unwrap();
    let first = Round { frames: frames.clone(), index: 0, rounds: 1, is_live: false };
    run(first, (&vocabularies, map), Vec::new());
    for is_live in [false, true] {
        let map = PlaceMap::open_read_only(folder.path()).unwrap();
        count_rounds(
            Round { frames: frames.clone(), index: 0, rounds: ROUNDS, is_live },
            (&vocabularies, map),
        );
    }
}

/// The rounds of a robot that knows its way.
fn count_rounds(rounds: Round, known: (&Arc<VocabularySet>, PlaceMap)) {
    let a_round = rounds.frames.len();
    let counts = Arc::new(Mutex::new(Vec::with_capacity(ROUNDS * a_round)));
    let sink = Box::new(Counting(Arc::clone(&counts)));
    let summary = run(rounds, known, vec![sink]);
    let known = summary.decided(Decision::Revisited);
    assert!(10 * known > 9 * summary.frames, "{:?}", summary.decisions);
    let counts = counts.lock().unwrap();
    // Of a camera some frames give way. The end of the stream takes some memory, and that of the source is known before
    // its last records are delivered.
    let share = |rounds: usize| counts.len() * rounds / ROUNDS;
    let counted = &counts[share(WARM_ROUNDS)..share(ROUNDS - 1)];
    assert!(counted.len() > a_round / 2, "too few frames came: {}", counts.len());
    assert_eq!(counted[counted.len() - 1] - counted[0], 0, "allocations over {} frames", counted.len());
}
