//! `loci demo`: the main job on a synthetic drive whose true places are known, told for newcomers.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::sync::{Arc, Mutex};

use clap::Args;
use loci::recognition::Decision;
use loci::telemetry::{FrameRecord, JsonLines, RecognitionSink, TelemetryError};

use super::console::{Reporter, outcome, summary_text};
use super::settings::StreamSettings;
use super::{Outcome, stream};

/// The drive: two laps of a street, at noon and at dusk.
const WORLD: &str = "synthetic:street?laps=2&light=noon,dusk&seed=7";
/// Frames of one lap of [`WORLD`].
const FRAMES_PER_LAP: u64 = 60;
/// A named place is the right one if it was seen this many true places away at most: from one true
/// place to the next the view hardly changes.
const TOLERANCE_PLACES: u32 = 1;

/// Arguments of `loci demo`.
#[derive(Args)]
#[command(after_help = "Examples:\n  loci demo\n  loci demo --rerun save=demo.rrd")]
pub(super) struct DemoArguments {
    #[command(flatten)]
    settings: StreamSettings,
    /// Print a JSON object a frame; the summary then goes to stderr
    #[arg(long)]
    json: bool,
}

/// Drives, recognises, and says how well it went.
pub(super) fn run(arguments: DemoArguments) -> anyhow::Result<Outcome> {
    let settings = arguments.settings.completed(None)?;
    let score = Arc::new(Mutex::new(Score::default()));
    let mut sinks: Vec<Box<dyn RecognitionSink>> = vec![Box::new(ScoreSink(Arc::clone(&score)))];
    if arguments.json {
        sinks.push(Box::new(JsonLines::new(std::io::stdout())));
    }
    let stop = stream::stop_flag()?;
    let pipeline = stream::pipeline(WORLD, &settings, sinks)?;
    eprintln!("loci: driving two laps of a street that exists only in this program …");
    let reporter = Reporter::new(true)?;
    reporter.begin(pipeline.source.as_ref(), false);
    let summary = pipeline.run(&stop, &reporter)?;
    reporter.finish();
    let score = score.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let text = format!("{}\n\n{}\n\n{NEXT}", score.text(), summary_text(&summary));
    if arguments.json {
        eprintln!("{text}");
    } else {
        writeln!(std::io::stdout(), "{text}")?;
    }
    Ok(outcome(&summary))
}

const NEXT: &str = "Next: loci run FOLDER_OF_IMAGES --map my_map       your own images\n      \
                    loci demo --rerun save=demo.rrd              the same drive as pictures, for rerun";

/// How the decisions of the second lap compare with the truth.
#[derive(Debug, Default)]
struct Score {
    /// The true places at which each place of the map was seen.
    seen_at: BTreeMap<u32, BTreeSet<u32>>,
    places_of_first_lap: usize,
    frames: u64,
    named: u64,
    right: u64,
}

impl Score {
    fn count(&mut self, record: &FrameRecord) {
        self.frames += u64::from(record.frame.index >= FRAMES_PER_LAP);
        let (Some(place), Some(truth)) = (record.recognition.place, record.frame.true_place) else { return };
        let is_named = matches!(record.recognition.decision, Decision::Recognised | Decision::Revisited);
        if record.frame.index < FRAMES_PER_LAP {
            self.seen_at.entry(place.0).or_default().insert(truth);
            self.places_of_first_lap = self.seen_at.len();
            return;
        }
        if is_named {
            self.named += 1;
            let near = truth.saturating_sub(TOLERANCE_PLACES)..=truth + TOLERANCE_PLACES;
            let seen_at = self.seen_at.get(&place.0);
            self.right += u64::from(seen_at.is_some_and(|places| places.range(near).next().is_some()));
        }
    }

    fn text(&self) -> String {
        let percent = |part: u64, whole: u64| 100.0 * part as f64 / whole.max(1) as f64;
        format!(
            "Lap 1, noon: everything was new; Loci founded {} places by itself, without labels or GPS.\n\
             Lap 2, dusk: {} frames; {} named a place of lap 1 or their own ({:.0} %), and {} of those \
             named the right one ({:.0} %).",
            self.places_of_first_lap,
            self.frames,
            self.named,
            percent(self.named, self.frames),
            self.right,
            percent(self.right, self.named),
        )
    }
}

/// Keeps the score while records pass.
struct ScoreSink(Arc<Mutex<Score>>);

impl RecognitionSink for ScoreSink {
    fn record(&mut self, record: &FrameRecord) -> Result<(), TelemetryError> {
        self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner).count(record);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), TelemetryError> {
        Ok(())
    }
}
