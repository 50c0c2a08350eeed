//! What a person at the terminal sees: lines, and of a stream a line a frame, a progress bar, a summary.

use std::fmt::Display;
use std::io::{self, IsTerminal, Write};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use loci::cnn::{CnnError, ModelCard};
use loci::pipeline::{RunSummary, Watcher};
use loci::place_map::MapError;
use loci::recognition::{Candidate, Decision, Recognition, Rejection};
use loci::source::SourceError;
use loci::telemetry::{FrameRecord, RecognitionSink, TelemetryError};

use super::Outcome;

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
pub(super) struct HumanLines<W>(pub(super) W);

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
        Ok(writeln!(self.0, "{}", line.trim_end())?)
    }

    fn finish(&mut self) -> Result<(), TelemetryError> {
        Ok(self.0.flush()?)
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
    /// Whether the run was asked to learn.
    is_learning: bool,
}

impl Reporter {
    /// A reporter, of a run that is to learn or not, with a progress bar over `frames` if stderr is a terminal that
    /// nothing else fills.
    pub(super) fn new(frames: Option<u64>, lines_on_stdout: bool, is_learning: bool) -> Self {
        let hidden = lines_on_stdout && io::stdout().is_terminal();
        let target = if hidden { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        Self { progress: progress_bar(frames, "frames", target), is_learning }
    }

    /// Clears the progress bar.
    pub(super) fn finish(&self) {
        self.progress.finish_and_clear();
    }
}

/// A bar over `length` of `unit` with count and remaining time; a spinner where the length is unknown.
pub(super) fn progress_bar(length: Option<u64>, unit: &str, target: ProgressDrawTarget) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(length, target);
    // The template is tried by every run with a terminal.
    if let Ok(style) = ProgressStyle::with_template(&format!(
        "{{spinner}} {{prefix}}{{wide_bar}} {{pos}}/{{len}} {unit}, {{eta}} left"
    )) {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(250));
    bar
}

/// Shows that something goes on whose length is not known.
pub(super) fn spinner(message: &'static str) -> ProgressBar {
    let spinner = ProgressBar::new_spinner().with_message(message);
    spinner.enable_steady_tick(Duration::from_millis(250));
    spinner
}

impl Watcher for Reporter {
    fn skipped(&self, error: &SourceError) {
        self.progress.suspend(|| eprintln!("loci: skipped: {error}"));
        self.progress.inc(1);
    }

    fn cnn_failed(&self, frame_name: &str, error: &CnnError) {
        self.progress.suspend(|| eprintln!("loci: {frame_name}: {error}; decided by BoW+HV alone"));
    }

    fn map_failed(&self, failure: &MapError, goes_on_learning: bool) {
        let is_turn = self.is_learning && !goes_on_learning;
        let consequence = if is_turn { "; going on read-only, nothing more is learnt" } else { "" };
        self.progress.suspend(|| eprintln!("loci: {failure}{consequence}"));
    }

    fn model_changed(&self, card: &ModelCard, frame_index: u64, described_anew: usize) {
        let anew = counted(described_anew, "keyframe");
        let line =
            format!("model {} is in use from frame {frame_index} on ({anew} described anew)", card.name);
        self.progress.suspend(|| eprintln!("loci: {line}"));
    }

    fn model_refused(&self, reason: &str, in_use: &ModelCard) {
        let name = &in_use.name;
        self.progress.suspend(|| eprintln!("loci: new model refused: {reason}; going on with {name}"));
    }

    fn decided(&self, _: &FrameRecord) {
        self.progress.inc(1);
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
            counted(summary.skipped, "frame"),
            summary.cnn_failures,
            counted(summary.map_failures, "failure"),
        );
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
    for stage in summary.latency() {
        text += &format!(" {} {:.1} ms", stage.stage, stage.p50_us as f64 / 1e3);
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
