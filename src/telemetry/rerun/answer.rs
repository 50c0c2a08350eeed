//! The answer, for people: in words, as a line of the log, and as curves over time.

use std::fmt::Write;
use std::iter;

use ::rerun::{
    BarChart, Color, RecordingStream, RecordingStreamResult, Scalars, SeriesLines, SeriesPoints,
    TextDocument, TextLog, TextLogLevel,
};

use super::style;
use super::target::one_line;
use super::told::{Told, ToldCandidate};
use crate::place_map::PlaceId;
use crate::recognition::{Decision, Evidence, Insight};
use crate::telemetry::{CnnStatus, Flow, Losses, StageLatency};

/// Candidates that the answer lists.
const LISTED: usize = 6;
/// Turned down candidates that a line of the log names.
const NAMED: usize = 2;
/// Longest name that is shown whole, in characters.
const MAX_NAME: usize = 60;

/// Names and colours of the curves, for good.
pub(super) fn dress(stream: &RecordingStream) -> RecordingStreamResult<()> {
    let line = |name: &str, colour: Color, width: f32| {
        SeriesLines::new().with_names([name]).with_colors([colour]).with_widths([width])
    };
    stream.log_static(style::PLACE, &line("place", style::FAINT, 1.0))?;
    for decision in style::DECISIONS {
        let points = SeriesPoints::new()
            .with_names([style::words(decision)])
            .with_colors([style::colour(decision)])
            .with_marker_sizes([3.0]);
        stream.log_static(style::place_path(decision), &points)?;
    }
    stream.log_static(style::CONFIDENCE, &line("confidence", style::BLUE, 1.5))?;
    let inliers =
        SeriesPoints::new().with_names(["inliers"]).with_colors([style::GREEN]).with_marker_sizes([3.0]);
    stream.log_static(style::INLIERS, &inliers)?;
    for (path, name, colour) in style::LATENCIES.into_iter().chain(style::FLOW) {
        stream.log_static(path, &line(name, colour, 1.2))?;
    }
    Ok(())
}

/// Shows an answer.
pub(super) fn show(stream: &RecordingStream, told: &Told<'_>) -> RecordingStreamResult<()> {
    if let Some(place) = told.place {
        let place = Scalars::single(f64::from(place.0));
        stream.log(style::PLACE, &place)?;
        stream.log(style::place_path(told.decision), &place)?;
    }
    stream.log(style::CONFIDENCE, &Scalars::single(f64::from(told.confidence)))?;
    if let Some(inliers) = told.inliers {
        stream.log(style::INLIERS, &Scalars::single(f64::from(inliers)))?;
    }
    for ((path, ..), micros) in style::LATENCIES.into_iter().zip(in_order(told.latency)) {
        stream.log(path, &Scalars::single(micros as f64 / 1e3))?;
    }
    for ((path, ..), count) in style::FLOW.into_iter().zip(counts(told.flow)) {
        stream.log(path, &Scalars::single(count as f64))?;
    }
    stream.log(style::NOW, &TextDocument::from_markdown(markdown(told)))?;
    let line = TextLog::new(log_line(told)).with_level(level(told)).with_color(style::colour(told.decision));
    stream.log(style::LOG, &line)
}

/// Shows what is believed: a bar for every place that stands out, and one left of them for none.
pub(super) fn show_belief(stream: &RecordingStream, insight: &Insight) -> RecordingStreamResult<()> {
    let shares = insight.belief.iter().map(|(_, share)| *share);
    let heights: Vec<f32> = iter::once(insight.elsewhere).chain(shares).collect();
    let places = insight.belief.iter().map(|(place, _)| i64::from(place.0));
    // Places that stand out are mostly near each other: a bar at a fixed place would make all of them thin.
    let none = places.clone().min().unwrap_or_default() - 2;
    let positions: Vec<i64> = iter::once(none).chain(places).collect();
    let bars = BarChart::new(heights.as_slice()).with_abscissa(positions.as_slice());
    stream.log(style::BELIEF, &bars.with_color(style::BLUE))
}

/// Says that frames were left out because the viewer is slow.
pub(super) fn show_gap(stream: &RecordingStream, frames: u64) -> RecordingStreamResult<()> {
    let line = format!("{frames} frames are not shown: the viewer was too slow");
    stream.log(style::LOG, &TextLog::new(line).with_level(TextLogLevel::WARN))
}

/// In the order of [`style::LATENCIES`].
fn in_order(latency: StageLatency) -> [u64; 7] {
    let StageLatency { decode_us, features_us, cnn_us, retrieval_us, verification_us, total_us, answer_us } =
        latency;
    [answer_us, total_us, decode_us, features_us, cnn_us, retrieval_us, verification_us]
}

/// In the order of [`style::FLOW`].
fn counts(flow: Flow) -> [u64; 9] {
    let Flow { waiting, losses: Losses { unreadable, lost, dropped, spared }, missed_records } = flow;
    let waiting = [waiting.features, waiting.cnn, waiting.recognition, waiting.sinks];
    let [features, cnn, recognition, sinks] = waiting.map(|count| count as u64);
    [features, cnn, recognition, sinks, unreadable, lost, dropped, spared, missed_records]
}

fn level(told: &Told<'_>) -> &'static str {
    match told.decision {
        _ if told.cnn == CnnStatus::Failed => TextLogLevel::WARN,
        Decision::Recognised | Decision::Revisited | Decision::NewPlace => TextLogLevel::INFO,
        Decision::SamePlace | Decision::Unknown => TextLogLevel::DEBUG,
    }
}

/// For example `recognised place 17 by cnn, 0.993; not 9: probability 0.004 < 0.500`.
fn log_line(told: &Told<'_>) -> String {
    let mut line = style::words(told.decision).to_owned();
    if let Some(place) = told.place {
        let _ = match told.decision {
            Decision::SamePlace | Decision::NewPlace => write!(line, " {}", place.0),
            _ => write!(line, " place {}", place.0),
        };
    }
    if let Some(name) = told.name {
        let _ = write!(line, " ({})", shortened(name));
    }
    if let Some(by) = told.by.filter(|by| *by != Evidence::PlaceInterval) {
        let _ = write!(line, " by {}", evidence(by));
    }
    let _ = write!(line, ", {:.3}", told.confidence);
    for (place, reason) in turned_down(told).take(NAMED) {
        let _ = write!(line, "; not {}: {reason}", place.0);
    }
    if told.cnn == CnnStatus::Failed {
        line.push_str("; the CNN failed");
    }
    line
}

/// The candidates of other places with what speaks against them, the best first, each place once.
fn turned_down<'t>(told: &'t Told<'_>) -> impl Iterator<Item = (PlaceId, &'t str)> {
    let candidates = &told.candidates;
    candidates.iter().enumerate().filter_map(|(index, candidate)| {
        let is_first = candidates[..index].iter().all(|earlier| earlier.place != candidate.place);
        let is_other = told.place != Some(candidate.place);
        let reason = candidate.rejected.as_deref().filter(|_| is_first && is_other);
        reason.map(|reason| (candidate.place, reason))
    })
}

/// The answer as a page: what was decided, and the candidates with the reasons against them.
fn markdown(told: &Told<'_>) -> String {
    let mut page = match told.place {
        Some(place) => format!("# Place {}", place.0),
        None => "# Unknown".to_owned(),
    };
    if let Some(name) = told.name {
        let _ = write!(page, " · {}", escaped(name));
    }
    let _ = write!(page, "\n\n**{}**", style::words(told.decision));
    if let Some(by) = told.by.filter(|by| *by != Evidence::PlaceInterval) {
        let _ = write!(page, " by {}", evidence(by));
    }
    let _ = write!(page, ", {:.0} % sure", 100.0 * told.confidence);
    if let Some((keyframe, name)) = &told.matched {
        let from = name.as_deref().map_or_else(String::new, |name| format!(" from {}", escaped(name)));
        let _ = write!(page, " · keyframe {}{from}", keyframe.0);
    }
    let _ = write!(page, " · frame {}", escaped(&told.frame_name));
    match told.cnn {
        CnnStatus::Available => {}
        CnnStatus::Unavailable => page.push_str(" · no CNN"),
        CnnStatus::Failed => page.push_str(" · **the CNN failed**"),
    }
    page.push_str("\n\n");
    if !told.candidates.is_empty() {
        page.push_str("| Place | Evidence | Score | Inliers | |\n|---|---|---|---|---|\n");
    }
    for candidate in told.candidates.iter().take(LISTED) {
        push_row(&mut page, candidate);
    }
    page
}

fn push_row(page: &mut String, candidate: &ToldCandidate) {
    let inliers = candidate.inliers.map(|inliers| inliers.to_string()).unwrap_or_default();
    let (place, by, score) = (candidate.place.0, evidence(candidate.by), candidate.score);
    let _ = match &candidate.rejected {
        None => writeln!(page, "| **{place}** | {by} | {score:.3} | {inliers} | **accepted** |"),
        Some(reason) => {
            writeln!(page, "| {place} | {by} | {score:.3} | {inliers} | {} |", escaped_sentence(reason))
        }
    };
}

fn evidence(evidence: Evidence) -> &'static str {
    match evidence {
        Evidence::Cnn => "CNN",
        Evidence::BowHv => "BoW+HV",
        Evidence::PlaceInterval => "place interval",
    }
}

/// A name from outside, on one line and not too long.
fn shortened(name: &str) -> String {
    let name = one_line(name);
    match name.char_indices().nth(MAX_NAME) {
        Some((end, _)) => format!("{}…", &name[..end]),
        None => name,
    }
}

/// The same, with nothing in it that Markdown would take for its own.
pub(super) fn escaped(name: &str) -> String {
    let mut escaped = String::new();
    for character in shortened(name).chars() {
        if character.is_ascii_punctuation() && !matches!(character, '.' | ',' | '/' | ':' | '-') {
            escaped.push('\\');
        }
        escaped.push(character);
    }
    escaped
}

/// A sentence, in which nothing is Markdown.
pub(super) fn escaped_sentence(sentence: &str) -> String {
    let mut escaped = String::new();
    for character in one_line(sentence).chars() {
        if matches!(character, '*' | '|' | '[' | ']' | '!' | '`' | '\\') {
            escaped.push('\\');
        }
        escaped.push(character);
    }
    escaped
}
