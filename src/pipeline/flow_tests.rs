//! Streams whose sinks are slow, hang or fail, and sources that are faster than what looks at their frames.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};
use std::{io, thread};

use super::*;
use crate::cnn::CnnError;
use crate::feature::OrbOptions;
use crate::frame::Frame;
use crate::place_map::{MapError, MapOptions, PlaceMap};
use crate::raster::{GreyImage, RgbImage};
use crate::recognition::RecognitionOptions;
use crate::source::{SourceError, wall_nanos};
use crate::telemetry::{FrameRecord, Losses};
use crate::vocabulary::VocabularySet;

/// So many frames, one every so often, of a camera or of a file.
struct Ticking {
    index: u64,
    frames: u64,
    every: Duration,
    is_live: bool,
}

impl FrameSource for Ticking {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        if self.index == self.frames {
            return None;
        }
        sleep(self.every);
        let capture_nanos = wall_nanos();
        let (grey, colour) = (GreyImage::new(48, 48), RgbImage::new(48, 48));
        let frame = Frame { capture_nanos, grey, colour, ..Frame::numbered(self.index) };
        self.index += 1;
        Some(Ok(frame))
    }

    fn frame_count(&self) -> Option<u64> {
        Some(self.frames)
    }

    fn is_live(&self) -> bool {
        self.is_live
    }

    fn lost_frames(&self) -> u64 {
        5
    }

    fn take_notice(&mut self) -> Option<String> {
        (self.index == 3).then(|| "three came".to_owned())
    }
}

/// Takes a record in its own way.
struct Sink<F>(F);

impl<F: FnMut(&FrameRecord) -> Result<(), TelemetryError> + Send> RecognitionSink for Sink<F> {
    fn record(&mut self, record: &FrameRecord) -> Result<(), TelemetryError> {
        self.0(record)
    }

    fn finish(&mut self) -> Result<(), TelemetryError> {
        Ok(())
    }
}

fn sink(
    take: impl FnMut(&FrameRecord) -> Result<(), TelemetryError> + Send + 'static,
) -> Box<dyn RecognitionSink> {
    Box::new(Sink(take))
}

/// A sink that counts, and the count.
fn counting() -> (Box<dyn RecognitionSink>, Arc<AtomicU64>) {
    let count = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&count);
    let count_one = move |_: &FrameRecord| {
        counted.fetch_add(1, Ordering::Relaxed);
        Ok(())
    };
    (sink(count_one), count)
}

#[derive(Default)]
struct Heard {
    said: Mutex<Vec<String>>,
    /// How long a decision is held up.
    hold: Duration,
}

impl Watcher for Heard {
    fn skipped(&self, error: &SourceError) {
        self.said.lock().unwrap().push(error.to_string());
    }
    fn cnn_failed(&self, _: &str, _: &CnnError) {}
    fn map_failed(&self, _: &MapError, _: bool) {}
    fn noticed(&self, notice: &str) {
        self.said.lock().unwrap().push(notice.to_owned());
    }
    fn sink_failed(&self, error: &TelemetryError) {
        self.said.lock().unwrap().push(error.to_string());
    }
    fn decided(&self, _: &FrameRecord) {
        sleep(self.hold);
    }
}

fn run(
    source: Ticking,
    sinks: Vec<Box<dyn RecognitionSink>>,
    (budget, heard): (Option<&str>, &Heard),
) -> Result<RunSummary, PipelineError> {
    let vocabulary = concat!(env!("CARGO_MANIFEST_DIR"), "/vocab/default.lvoc");
    let vocabularies = Arc::new(VocabularySet::open(&[vocabulary.into()]).unwrap());
    let map = PlaceMap::in_memory(MapOptions::default()).unwrap();
    let pipeline = Pipeline {
        source: Box::new(source),
        extractor: OrbExtractor::new(OrbOptions::default()),
        model: None,
        model_folder: None,
        recogniser: Recogniser::new(vocabularies, map, None, RecognitionOptions::default()).unwrap(),
        sinks,
        budget: budget.map(|budget| budget.parse().unwrap()),
    };
    pipeline.run(&AtomicBool::new(false), heard)
}

fn camera(frames: u64, every_ms: u64) -> Ticking {
    Ticking { index: 0, frames, every: Duration::from_millis(every_ms), is_live: true }
}

fn file(frames: u64) -> Ticking {
    Ticking { is_live: false, ..camera(frames, 0) }
}

#[test]
fn of_a_camera_that_is_too_fast_the_newest_frames_are_decided_and_the_others_counted() {
    let last = Arc::new(AtomicU64::new(0));
    let kept = Arc::clone(&last);
    let keep = move |record: &FrameRecord| {
        kept.store(record.frame.index, Ordering::Relaxed);
        Ok(())
    };
    let heard = Heard { hold: Duration::from_millis(30), ..Heard::default() };
    let summary = run(camera(200, 3), vec![sink(keep)], (None, &heard)).unwrap();
    let (flow, losses) = (summary.flow, summary.flow.losses);
    assert_eq!(summary.frames + losses.dropped, 200, "{flow:?}");
    assert!(losses.dropped > 100, "{flow:?}");
    assert_eq!((losses.lost, losses.spared, flow.missed_records), (5, 0, 0));
    assert_eq!(last.load(Ordering::Relaxed), 199, "the newest is always decided");
    assert_eq!(*heard.said.lock().unwrap(), ["three came"]);
}

#[test]
fn of_a_file_no_frame_is_dropped_and_no_record_missed() {
    let (counting, count) = counting();
    let slow = sink(|_| {
        sleep(Duration::from_millis(2));
        Ok(())
    });
    let summary = run(file(60), vec![slow, counting], (None, &Heard::default())).unwrap();
    assert_eq!((summary.frames, count.load(Ordering::Relaxed)), (60, 60));
    assert_eq!((summary.flow.losses.dropped, summary.flow.missed_records), (0, 0));
}

#[test]
fn a_sink_that_hangs_holds_up_neither_a_cameras_frames_nor_the_other_sinks_nor_the_end() {
    let hanging = sink(|_| {
        loop {
            thread::park();
        }
    });
    let (counting, count) = counting();
    let started = Instant::now();
    let summary = run(camera(80, 20), vec![hanging, counting], (None, &Heard::default())).unwrap();
    let flow = summary.flow;
    assert!(started.elapsed() < Duration::from_secs(20), "{:?}", started.elapsed());
    // On a busy machine the other one misses some, too.
    let came = count.load(Ordering::Relaxed);
    assert!(came > 0 && came + flow.missed_records >= summary.frames, "{came} {flow:?}");
    assert_eq!(summary.sink_failures, 1, "it took nothing any more");
    assert!(flow.missed_records > 0 && flow.waiting.sinks > 0, "{flow:?}");
}

#[test]
fn a_sink_that_fails_ends_a_file_but_no_camera() {
    let failing = || sink(|_| Err(TelemetryError::Write(io::Error::other("disk full"))));
    let (counting, count) = counting();
    let heard = Heard::default();
    let summary = run(camera(30, 1), vec![failing(), counting], (None, &heard)).unwrap();
    let came = count.load(Ordering::Relaxed);
    assert!(came > 0 && came + summary.flow.missed_records >= summary.frames, "{came}");
    assert_eq!(summary.sink_failures, 1);
    assert!(summary.lost_something());
    assert!(heard.said.lock().unwrap().contains(&"cannot write the output: disk full".to_owned()));
    let error = run(file(30), vec![failing()], (None, &heard)).unwrap_err();
    assert_eq!(error.to_string(), "cannot write the output: disk full");
}

#[test]
fn whoever_reads_the_output_may_go_and_the_stream_ends() {
    for source in [camera(1000, 1), file(1000)] {
        let gone = sink(|_| Err(TelemetryError::ReaderGone));
        let summary = run(source, vec![gone], (None, &Heard::default())).unwrap();
        assert!(summary.frames < 500 && !summary.lost_something(), "{}", summary.frames);
    }
}

#[test]
fn within_a_budget_a_camera_misses_frames_and_a_file_takes_its_time() {
    let summary = run(camera(100, 30), Vec::new(), (Some("1%"), &Heard::default())).unwrap();
    let Losses { spared, dropped, .. } = summary.flow.losses;
    assert!(spared > 20 && summary.frames > 0, "{spared} {}", summary.frames);
    assert_eq!(summary.frames + spared + dropped, 100);
    // Other tests take processor time as well, but nobody is blind for long.
    let started = Instant::now();
    let summary = run(file(4), Vec::new(), (Some("1%"), &Heard::default())).unwrap();
    assert_eq!((summary.frames, summary.flow.losses.spared), (4, 0));
    assert!(started.elapsed() > Duration::from_secs(1), "it did not wait");
}
