//! `loci run --explain`: why a frame was decided as it was, for people.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};

use loci::recognition::{Candidate, Clues, Grounds, Look, PlaceGrounds, Thresholds};
use loci::telemetry::{FrameRecord, RecognitionSink, TelemetryError};

/// Least probability with which a place is shown of which nothing was found.
const WORTH_SHOWING: f32 = 0.005;

/// The frames that are to be explained and have not come yet.
#[derive(Clone)]
pub(super) struct Awaited(Arc<Mutex<BTreeSet<u64>>>);

impl Awaited {
    pub(super) fn new(frames: &[u64]) -> Self {
        Self(Arc::new(Mutex::new(frames.iter().copied().collect())))
    }

    fn take(&self, frame: u64) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&frame)
    }

    /// The first one that never came.
    pub(super) fn missed(&self) -> Option<u64> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).first().copied()
    }
}

/// Writes the grounds of the awaited frames, and nothing of the others.
pub(super) struct Explanations<W> {
    pub(super) output: W,
    pub(super) awaited: Awaited,
}

impl<W: Write + Send> RecognitionSink for Explanations<W> {
    fn record(&mut self, record: &FrameRecord) -> Result<(), TelemetryError> {
        if self.awaited.take(record.frame.index) {
            self.output.write_all(explanation(record).as_bytes())?;
            self.output.flush()?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), TelemetryError> {
        Ok(self.output.flush()?)
    }
}

fn explanation(record: &FrameRecord) -> String {
    let recognition = &record.recognition;
    let Grounds { places, elsewhere, thresholds } = &recognition.grounds;
    let mut text =
        format!("frame {}, {}: {}", record.frame.index, record.frame.name, recognition.decision.as_str());
    if let Some(place) = recognition.place {
        let name = recognition.name.as_ref().map_or(String::new(), |name| format!(" ({name})"));
        let _ = write!(text, ", place {}{name}", place.0);
    }
    let _ = writeln!(text, ", probability {:.3}\n", recognition.confidence);
    text += "candidate  by      score   votes  inliers  probability\n";
    recognition.candidates.iter().for_each(|candidate| text += &candidate_row(candidate));
    text += "\n           cosine here     fourth   inliers here      other   log odds   before    after  with next  \
             and twins\n";
    places
        .iter()
        .filter(|place| place.clues.is_some() || place.before.max(place.after) >= WORTH_SHOWING)
        .for_each(|place| text += &place_row(place));
    let [before, after] = elsewhere;
    let _ = writeln!(text, "elsewhere  {:>59}   {before:>6.3}   {after:>6.3}\n", "");
    text + &needed(thresholds) + &richness(&record.look, thresholds.features)
}

fn candidate_row(candidate: &Candidate) -> String {
    let votes = or_dash(candidate.votes.map(|votes| format!("{votes:.2}")));
    let inliers = or_dash(candidate.inliers);
    let verdict = candidate.rejected.map_or("accepted".to_owned(), |rejected| rejected.to_string());
    format!(
        "place {:<5}{:<7}{:>6.3}  {votes:>6}  {inliers:>7}  {:>11.3}  {verdict}\n",
        candidate.place.0,
        candidate.by.as_str(),
        candidate.score,
        candidate.probability,
    )
}

fn place_row(grounds: &PlaceGrounds) -> String {
    let clues = grounds.clues;
    let cosine =
        |of: fn(Clues) -> Option<f32>| or_dash(clues.and_then(of).map(|cosine| format!("{cosine:.3}")));
    let inliers = |of: fn(Clues) -> u32| or_dash(clues.map(of));
    format!(
        "place {:<5}{:>11}  {:>9}   {:>12}  {:>9}   {:>8}   {:>6.3}   {:>6.3}  {:>9.3}  {:>9.3}\n",
        grounds.place.0,
        cosine(|clues| clues.cosine),
        cosine(|clues| clues.rival_cosine),
        inliers(|clues| clues.inliers),
        inliers(|clues| clues.rival_inliers),
        or_dash(grounds.log_odds.map(|log_odds| format!("{log_odds:+.2}"))),
        grounds.before,
        grounds.after,
        grounds.around,
        grounds.around + grounds.twins,
    )
}

fn needed(thresholds: &Thresholds) -> String {
    let alone = thresholds
        .cnn_alone
        .map_or(String::new(), |cosine| format!("; the CNN alone is sure from a cosine of {cosine:.3} on"));
    format!(
        "needed: probability {:.3} with the places next to it, of which none may be likelier, and with its twins, \
         which geometry verifies beyond doubt as well and which are no rivals; log odds {:+.2} from the frame \
         itself{alone}; geometry verifies from {} inliers on\n",
        thresholds.probability, thresholds.log_odds, thresholds.inliers,
    )
}

/// How many features the frame has, and what that means for a place that it would found.
fn richness(look: &Look, needed: usize) -> String {
    let said = match look.is_poor(needed) {
        true => ": it founds no place unless the one before was poor, too",
        false => "",
    };
    format!("features: {}, poor below {needed}{said}\n\n", look.features.len())
}

fn or_dash(value: Option<impl ToString>) -> String {
    value.map_or("-".to_owned(), |value| value.to_string())
}
