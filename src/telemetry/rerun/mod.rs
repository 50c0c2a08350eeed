//! Recognitions as pictures and curves, for the [rerun](https://rerun.io) viewer.
//!
//! A viewer never holds up the stream: one that looks on live is behind the queue of [`live`], which
//! leaves frames out when it is too slow; only a recording to a file waits, for the disk.
//!
//! Everything is logged on two timelines ([`clock`]), both of the frames. Nothing is logged against the computer's
//! clock, so that a repeated run gives the same recording.

mod answer;
mod blueprint;
mod clock;
mod detail;
mod file;
mod gallery;
mod jpeg;
mod layout;
mod live;
mod pictures;
mod place_graph;
mod review;
mod rotation;
mod scene;
mod similarity;
mod style;
mod target;
mod told;
mod trajectory;

#[cfg(test)]
mod target_tests;
#[cfg(test)]
mod tests;

pub use detail::RerunDetail;
pub use review::{Finding, ReviewError, Reviewed, ReviewedRun, review_map, review_run};
pub use rotation::Rotation;
pub use target::RerunTarget;

use std::mem;
use std::path::Path;
use std::time::Duration;

use ::rerun::{RecordingStream, RecordingStreamBuilder, RecordingStreamResult};

use self::clock::Clock;
use self::detail::PicturePace;
use self::file::RecordingFile;
use self::live::{Live, Relay};
use self::place_graph::PlaceGraph;
use self::scene::Scene;
use self::similarity::SimilarityPicture;
use self::target::one_line;
use self::told::Told;
use super::{FrameRecord, RecognitionSink, TelemetryError};

/// The name under which viewers keep layouts of our recordings.
const APPLICATION: &str = "loci";
/// The program that shows recordings.
const VIEWER: &str = "rerun";
/// How long a disk may take for what is left at the end.
const MAX_WRITING: Duration = Duration::from_secs(20);

/// Shows recognitions in rerun.
pub struct RerunSink {
    target: RerunTarget,
    stream: RecordingStream,
    clock: Clock,
    live: Option<Live>,
    /// The file that is written, if one is.
    file: Option<RecordingFile>,
    detail: RerunDetail,
    pace: PicturePace,
    scene: Scene,
    graph: PlaceGraph,
    similarities: SimilarityPicture,
    /// Frames left out since the viewer fell behind.
    frames_left_out: u64,
}

impl RerunSink {
    /// Opens a recording to `target` in this detail; what goes to [`RerunTarget::Off`] is shown to nobody. A file that
    /// is there already is replaced. A viewer to connect to may come later.
    ///
    /// # Errors
    /// If the file cannot be written, the address is taken, or no viewer can be started.
    pub fn open(target: &RerunTarget, detail: RerunDetail) -> Result<Self, TelemetryError> {
        let refused = |reason: String| refusal(target, &reason);
        let mut file = match target {
            RerunTarget::Save(file, rotation) => Some(RecordingFile::new(file, *rotation).map_err(refused)?),
            _ => None,
        };
        let (stream, live) = match &mut file {
            Some(file) => (file.begin().map_err(refused)?, None),
            None => open(target).map_err(refused)?,
        };
        Ok(Self {
            target: target.clone(),
            stream: dressed(stream).map_err(|error| refusal(target, &error.to_string()))?,
            clock: Clock::default(),
            live,
            file,
            detail,
            pace: PicturePace::of(detail),
            scene: Scene::new(detail),
            graph: PlaceGraph::default(),
            similarities: SimilarityPicture::default(),
            frames_left_out: 0,
        })
    }

    fn show(&mut self, record: &FrameRecord) -> RecordingStreamResult<()> {
        self.clock.set(&self.stream, record.frame.index, record.frame.capture_nanos);
        if self.frames_left_out > 0 {
            answer::show_gap(&self.stream, mem::take(&mut self.frames_left_out))?;
        }
        if self.pace.is_due(record.frame.capture_nanos) {
            self.scene.show(&self.stream, record)?;
        }
        if self.detail.shows_evidence() {
            self.show_similarities(record)?;
        }
        self.graph.show(&self.stream, record)?;
        if let Some(insight) = &record.insight {
            answer::show_belief(&self.stream, insight)?;
        }
        answer::show(&self.stream, &Told::from(record))
    }

    fn show_similarities(&mut self, record: &FrameRecord) -> RecordingStreamResult<()> {
        let Some(insight) = &record.insight else { return Ok(()) };
        if self.similarities.add(&insight.similarities, &record.recognition) {
            self.similarities.show(&self.stream)?;
        }
        Ok(())
    }

    /// Closes the recording; whatever is recorded afterwards is shown to nobody.
    fn close(&mut self) -> Result<(), String> {
        let stream = mem::replace(&mut self.stream, RecordingStream::disabled());
        let flushed = file::written(&stream);
        drop(stream);
        if let Some(live) = self.live.take() {
            return if live.close() {
                Ok(())
            } else {
                Err("no viewer answered; start one with `rerun`".to_owned())
            };
        }
        let Some(file) = &self.file else { return Ok(()) };
        flushed?;
        file.check_end()
    }

    /// Goes on in a new file where the one before is full or old.
    fn rotate(&mut self, capture_nanos: i64) -> Result<(), String> {
        if !self.file.as_mut().is_some_and(|file| file.is_over(capture_nanos)) {
            return Ok(());
        }
        self.close()?;
        let Some(file) = &mut self.file else { return Ok(()) };
        self.stream = dressed(file.begin()?).map_err(|error| error.to_string())?;
        self.scene = Scene::new(self.detail);
        self.pace = PicturePace::of(self.detail);
        self.graph.begin_anew();
        self.similarities.begin_anew();
        Ok(())
    }
}

impl RecognitionSink for RerunSink {
    fn record(&mut self, record: &FrameRecord) -> Result<(), TelemetryError> {
        self.graph.learn(record);
        if self.live.as_ref().is_some_and(Live::is_behind) {
            self.frames_left_out += 1;
            return Ok(());
        }
        if self.stream.is_enabled() {
            self.rotate(record.frame.capture_nanos).map_err(|reason| refusal(&self.target, &reason))?;
        }
        self.show(record).map_err(|error| refusal(&self.target, &error.to_string()))
    }

    fn finish(&mut self) -> Result<(), TelemetryError> {
        if !self.stream.is_enabled() {
            return Ok(());
        }
        self.close().map_err(|reason| refusal(&self.target, &reason))
    }

    fn looks_on(&self) -> bool {
        self.stream.is_enabled()
    }

    fn shows_matched_keyframe(&self) -> bool {
        self.stream.is_enabled() && self.detail.shows_evidence()
    }
}

fn open(target: &RerunTarget) -> Result<(RecordingStream, Option<Live>), String> {
    let builder = RecordingStreamBuilder::new(APPLICATION);
    if !matches!(target, RerunTarget::Off) {
        check_switch()?;
    }
    match target {
        RerunTarget::Off | RerunTarget::Save(..) => Ok((RecordingStream::disabled(), None)),
        RerunTarget::Spawn => look_on(builder, live::spawn(VIEWER)?),
        RerunTarget::Connect(address) => look_on(builder, live::connect(address)?),
        RerunTarget::Serve(address) => look_on(builder, live::serve(*address)?),
    }
}

/// Refuses where rerun's own switch, the variable RERUN, is off: all would be lost without a word.
fn check_switch() -> Result<(), String> {
    if ::rerun::decide_logging_enabled(true) {
        return Ok(());
    }
    Err("the environment switches rerun off; unset RERUN".to_owned())
}

/// With what is shown all the time; times come from the frames alone.
fn dressed(stream: RecordingStream) -> RecordingStreamResult<RecordingStream> {
    stream.set_log_time_enabled(false);
    stream.set_log_tick_enabled(false);
    answer::dress(&stream)?;
    Ok(stream)
}

fn look_on(
    builder: RecordingStreamBuilder,
    (relay, live): (Relay, Live),
) -> Result<(RecordingStream, Option<Live>), String> {
    let stream = builder.buffered().map_err(|error| error.to_string())?;
    stream.set_sink(Box::new(relay));
    Ok((stream, Some(live)))
}

/// Opens the recording `file` in a viewer, which stays open.
///
/// # Errors
/// If no viewer is installed or it cannot be started.
pub fn open_viewer(file: &Path) -> Result<(), TelemetryError> {
    let named = |reason| TelemetryError::Rerun { target: file.display().to_string(), reason };
    live::open(VIEWER, file).map_err(named)
}

fn refusal(target: &RerunTarget, reason: &str) -> TelemetryError {
    TelemetryError::Rerun { target: target.to_string(), reason: one_line(reason) }
}
