//! What a person at the terminal sees: lines, and of a stream a line a frame, a progress bar, a summary.

use std::fmt::{self, Display};
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use loci::cnn::{CnnError, ModelCard};
use loci::pipeline::{ANSWER, RunSummary, Watcher};
use loci::place_map::MapError;
use loci::recognition::{Candidate, Decision, Recognition, Rejection};
use loci::source::{FrameSource, SourceError};
use loci::telemetry::{Flow, FrameRecord, Losses, RecognitionSink, TelemetryError, Waiting};

use super::Outcome;
use super::voice::{Repeated, Voice};

/// Writes a line to stdout. Whoever reads it may have seen enough and gone: that is no failure.
pub(super) fn say(line: &str) -> anyhow::Result<()> {
    match writeln!(io::stdout(), "{line}") {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(anyhow::anyhow!("cannot write to stdout: {error}"))
        }
        _ => Ok(()),
    }
}

/// So many of a thing, in the singular where it is one.
pub(super) fn counted(count: impl Display, thing: &str) -> String {
    let count = count.to_string();
    let ending = if count == "1" { "" } else { "s" };
    format!("{count} {thing}{ending}")
}

/// Writes a line a frame for people.
pub(super) struct HumanLines<W> {
    output: W,
    /// What stands below the lines meanwhile.
    status: ProgressBar,
}

impl<W: Write + Send> RecognitionSink for HumanLines<W> {
    fn record(&mut self, record: &FrameRecord) -> Result<(), TelemetryError> {
        let recognition = &record.recognition;
        let place = recognition.place.map_or("-".to_owned(), |place| place.0.to_string());
        let name = recognition.name.as_deref().unwrap_or_default();
        let line = format!(
            "{:>6}  {:<20}  {:<10}  place {place:>4} {name}  {:.2}  {}",
            record.frame.index,
            record.frame.name,
            recognition.decision.as_str(),
            recognition.confidence,
            evidence(recognition),
        );
        let line = line.trim_end();
        // Only there do lines and status meet. Elsewhere nobody may wait for whoever reads the lines.
        match io::stdout().is_terminal() {
            true => Ok(self.status.suspend(|| writeln!(self.output, "{line}"))?),
            false => Ok(writeln!(self.output, "{line}")?),
        }
    }

    fn finish(&mut self) -> Result<(), TelemetryError> {
        Ok(self.output.flush()?)
    }
}

/// What decided, and whom it overruled.
fn evidence(recognition: &Recognition) -> String {
    let mut text = match (recognition.by, recognition.inliers) {
        (Some(by), Some(inliers)) => format!("{} {inliers} inliers", by.as_str()),
        (Some(by), None) => by.as_str().to_owned(),
        (None, _) => String::new(),
    };
    let is_overruled =
        |candidate: &&Candidate| matches!(candidate.rejected, Some(Rejection::Overruled { .. }));
    if let Some(overruled) = recognition.candidates.iter().find(is_overruled) {
        text += &format!(", overrules the CNN, which is sure of place {}", overruled.place.0);
    }
    text
}

/// Reports on stderr what happens while a stream runs.
pub(super) struct Reporter {
    progress: ProgressBar,
    voice: Voice,
    /// Frames of a camera that were damaged.
    damage: Mutex<Repeated>,
    /// Whether the run was asked to learn.
    is_learning: bool,
    /// Of a live stream, how it keeps pace.
    pace: Arc<Mutex<String>>,
    is_live: AtomicBool,
}

impl Reporter {
    /// A reporter, of a run that is to learn or not, which shows nothing yet.
    pub(super) fn new(is_learning: bool) -> anyhow::Result<Self> {
        let progress = ProgressBar::hidden();
        Ok(Self {
            voice: Voice::above(progress.clone())?,
            progress,
            damage: Mutex::default(),
            is_learning,
            pace: Arc::default(),
            is_live: AtomicBool::new(false),
        })
    }

    /// Lines for people on stdout, above whatever this reporter shows.
    pub(super) fn lines(&self) -> HumanLines<io::Stdout> {
        HumanLines { output: io::stdout(), status: self.progress.clone() }
    }

    /// Shows on stderr, if that is a terminal, how far the frames of `source` got; of a live one how it keeps pace.
    /// Where `others_write` to the same terminal, nothing.
    pub(super) fn begin(&self, source: &dyn FrameSource, others_write: bool) {
        self.is_live.store(source.is_live(), Ordering::Relaxed);
        if others_write && io::stdout().is_terminal() {
            return;
        }
        self.progress.set_draw_target(ProgressDrawTarget::stderr());
        if source.is_live() {
            let pace = Arc::clone(&self.pace);
            let shown = move |_: &ProgressState, line: &mut dyn fmt::Write| {
                let _ = line.write_str(&pace.lock().unwrap_or_else(PoisonError::into_inner));
            };
            dress(&self.progress, "{spinner} {pace}", |style| style.with_key("pace", shown));
            return;
        }
        if let Some(frames) = source.frame_count() {
            self.progress.set_length(frames);
        }
        dress(&self.progress, &bar_template("frames"), |style| style);
    }

    /// Says what is still to be said and clears the progress bar.
    pub(super) fn finish(self) {
        drop(self.voice);
        self.progress.finish_and_clear();
    }

    fn is_live(&self) -> bool {
        self.is_live.load(Ordering::Relaxed)
    }

    /// Says a line; of a live stream it is left out where nobody reads.
    fn say(&self, line: String) {
        self.voice.say(line, self.is_live());
    }
}

/// A bar over `length` of `unit` with count and remaining time; a spinner where the length is unknown.
pub(super) fn progress_bar(length: Option<u64>, unit: &str, target: ProgressDrawTarget) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(length, target);
    dress(&bar, &bar_template(unit), |style| style);
    bar
}

fn bar_template(unit: &str) -> String {
    format!("{{spinner}} {{prefix}}{{wide_bar}} {{pos}}/{{len}} {unit}, {{eta}} left")
}

fn dress(bar: &ProgressBar, template: &str, with_keys: impl FnOnce(ProgressStyle) -> ProgressStyle) {
    // The template is tried by every run with a terminal.
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(with_keys(style));
    }
    bar.enable_steady_tick(Duration::from_millis(250));
}

/// How a stream keeps pace, in one line: from capture to the answer, what waits for features, the CNN, recognition and
/// the slowest sink, and what was lost.
fn pace(record: &FrameRecord) -> String {
    let Waiting { features, cnn, recognition, sinks } = record.flow.waiting;
    let milliseconds = record.latency.answer_us as f64 / 1e3;
    let queues = format!("waiting {features} {cnn} {recognition} {sinks}");
    let frame = record.frame.index;
    format!("frame {frame}: capture to answer {milliseconds:.1} ms, {queues}, {}", losses(&record.flow))
}

/// What did not come through.
fn losses(flow: &Flow) -> String {
    let Flow { losses: Losses { lost, dropped, spared, .. }, missed_records, .. } = flow;
    format!("frames lost {lost}, dropped {dropped}, spared {spared}, records missed {missed_records}")
}

/// Shows that something goes on whose length is not known.
pub(super) fn spinner(message: &'static str) -> ProgressBar {
    let spinner = ProgressBar::new_spinner().with_message(message);
    spinner.enable_steady_tick(Duration::from_millis(250));
    spinner
}

impl Watcher for Reporter {
    fn skipped(&self, error: &SourceError) {
        if !self.is_live() {
            self.progress.inc(1);
        }
        let mut damage = self.damage.lock().unwrap_or_else(PoisonError::into_inner);
        let untold = match error {
            SourceError::DamagedFrame { .. } => damage.came(Instant::now()),
            _ => Some(0),
        };
        match untold {
            None => {}
            Some(0) => self.say(format!("skipped: {error}")),
            Some(more) => self.say(format!("skipped: {error} ({more} more before it)")),
        }
    }

    fn cnn_failed(&self, frame_name: &str, error: &CnnError) {
        self.say(format!("{frame_name}: {error}; decided by BoW+HV alone"));
    }

    fn map_failed(&self, failure: &MapError, goes_on_learning: bool) {
        let is_turn = self.is_learning && !goes_on_learning;
        let consequence = if is_turn { "; going on read-only, nothing more is learnt" } else { "" };
        self.say(format!("{failure}{consequence}"));
    }

    fn model_changed(&self, card: &ModelCard, frame_index: u64, described_anew: usize) {
        let anew = counted(described_anew, "keyframe");
        self.say(format!(
            "model {} is in use from frame {frame_index} on ({anew} described anew)",
            card.name
        ));
    }

    fn model_refused(&self, reason: &str, in_use: &ModelCard) {
        self.say(format!("new model refused: {reason}; going on with {}", in_use.name));
    }

    fn noticed(&self, notice: &str) {
        self.say(notice.to_owned());
    }

    fn sink_failed(&self, error: &TelemetryError) {
        self.say(format!("{error}; going on without it"));
    }

    fn decided(&self, record: &FrameRecord) {
        if !self.is_live() {
            return self.progress.inc(1);
        }
        // A live stream does not wait for whoever draws the line, not even for its terminal.
        if let Ok(mut shown) = self.pace.try_lock() {
            *shown = pace(record);
        }
    }
}

/// How a run ended. What could not be read of the map was reported when it was opened.
pub(super) fn outcome(summary: &RunSummary) -> Outcome {
    let was_whole = summary.map.as_ref().is_none_or(|map| map.torn_bytes == 0 && map.passed_over == 0);
    if summary.lost_something() || !was_whole { Outcome::Lost } else { Outcome::Done }
}

/// The summary of a run, for people.
pub(super) fn summary_text(summary: &RunSummary) -> String {
    let count = |decision| summary.decided(decision);
    let mut text = format!(
        "{}: {} recognised by the CNN, {} revisited by BoW+HV, {} within a place just founded, {}, {} unknown",
        counted(summary.frames, "frame"),
        count(Decision::Recognised),
        count(Decision::Revisited),
        count(Decision::SamePlace),
        counted(count(Decision::NewPlace), "new place"),
        count(Decision::Unknown),
    );
    if summary.lost_something() {
        text += &format!(
            "\n{} skipped, {} without the CNN's answer, {} of the map",
            counted(summary.flow.losses.unreadable, "frame"),
            summary.cnn_failures,
            counted(summary.map_failures, "failure"),
        );
    }
    if summary.sink_failures > 0 {
        text += &format!(", {} of outputs", summary.sink_failures);
    }
    if let Some(map) = &summary.map {
        let mib = map.journal_bytes as f64 / f64::from(1 << 20);
        text += &format!(
            "\nmap: {}, {} ({}), {mib:.1} MiB",
            counted(map.places, "place"),
            counted(map.experiences, "experience"),
            counted(map.keyframes, "keyframe"),
        );
    }
    text += "\nmedian time a frame:";
    let latency = summary.latency();
    for stage in latency.iter().filter(|stage| stage.stage != ANSWER) {
        text += &format!(" {} {:.1} ms", stage.stage, stage.p50_us as f64 / 1e3);
    }
    if let Some(answer) = latency.iter().find(|stage| stage.stage == ANSWER && summary.is_live) {
        let [median, most] = [answer.p50_us, answer.p99_us].map(|micros| micros as f64 / 1e3);
        let losses = losses(&summary.flow);
        text += &format!("\ncapture to answer: {median:.1} ms, {most:.1} ms for 99 of 100; {losses}");
    }
    text
}

#[cfg(test)]
mod tests {
    use loci::place_map::{ExperienceId, PlaceId};
    use loci::recognition::{Candidates, Evidence, Grounds};

    use super::*;

    #[test]
    fn a_line_says_whom_geometry_overrules() {
        let (place, keyframe) = (PlaceId(7), ExperienceId(70));
        let rejected = Some(Rejection::Overruled { by: PlaceId(3), inliers: 41 });
        let by = Evidence::Cnn;
        let (votes, inliers, probability) = (None, None, 0.1);
        let overruled = Candidate { place, keyframe, by, score: 0.95, votes, inliers, probability, rejected };
        let mut recognition = Recognition {
            decision: Decision::Revisited,
            by: Some(Evidence::BowHv),
            place: Some(PlaceId(3)),
            name: None,
            keyframe: None,
            experience: None,
            confidence: 0.9,
            inliers: Some(41),
            candidates: Candidates::new(),
            verification: None,
            grounds: Grounds::default(),
        };
        assert_eq!(evidence(&recognition), "bow_hv 41 inliers");
        recognition.candidates.push(overruled).unwrap();
        let said = evidence(&recognition);
        assert_eq!(said, "bow_hv 41 inliers, overrules the CNN, which is sure of place 7");
    }

    #[test]
    fn one_is_no_plural() {
        assert_eq!(
            [0, 1, 2, 11].map(|n| counted(n, "place")),
            ["0 places", "1 place", "2 places", "11 places"]
        );
    }
}
