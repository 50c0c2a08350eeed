//! `loci run`: the main job.

use std::io;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use clap::Args;
use loci::telemetry::{JsonLines, RecognitionSink};

use super::console::{Reporter, counted, outcome, summary_text};
use super::explain::{Awaited, Explanations};
use super::settings::StreamSettings;
use super::{Outcome, stream};

/// Arguments of `loci run`.
#[derive(Args)]
#[command(after_help = "Examples:\n  \
    loci run recordings/monday --map maps/site\n  \
    loci run recordings/tuesday --map maps/site --read-only --json\n  \
    loci run recordings/tuesday --map maps/site --read-only --explain 412\n  \
    loci run 'synthetic:street?laps=3&light=noon,dusk,night' --rerun save=street.rrd")]
pub(super) struct RunArguments {
    /// A folder of images; a video file; synthetic:WORLD?laps=2&light=noon,dusk&seed=7 (WORLD: street, corridor); or
    /// v4l2:/dev/video0?size=640x480&fps=30&format=mjpg
    source: String,
    #[command(flatten)]
    settings: StreamSettings,
    /// Read settings from this TOML file; its keys are the flags' names
    #[arg(long, env = "LOCI_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print a JSON object a frame instead of a line for people
    #[arg(long)]
    json: bool,
    /// Print why frame FRAME was decided as it was instead of a line a frame; may be given several times
    #[arg(long, value_name = "FRAME", conflicts_with = "json")]
    explain: Vec<u64>,
}

/// Runs the stream and says what came of it.
pub(super) fn run(arguments: RunArguments) -> anyhow::Result<Outcome> {
    let settings = arguments.settings.completed(arguments.config.as_deref())?;
    let awaited = Awaited::new(&arguments.explain);
    let reporter = Reporter::new(settings.read_only != Some(true))?;
    let is_for_people = !arguments.json && arguments.explain.is_empty();
    let lines: Box<dyn RecognitionSink> = if arguments.json {
        Box::new(JsonLines::new(io::stdout()))
    } else if is_for_people {
        Box::new(reporter.lines())
    } else {
        Box::new(Explanations { output: io::stdout(), awaited: awaited.clone() })
    };
    let stop = stream::stop_flag()?;
    let pipeline = stream::pipeline(&arguments.source, &settings, vec![lines])?;
    if settings.map.is_none() {
        eprintln!("loci: no --map: what is learnt is gone at the end");
    }
    reporter.begin(pipeline.source.as_ref(), !(is_for_people && pipeline.source.is_live()));
    let summary = pipeline.run(&stop, &reporter)?;
    reporter.finish();
    eprintln!("{}", summary_text(&summary));
    let unreadable = summary.flow.losses.unreadable;
    if summary.frames == 0 && unreadable > 0 {
        anyhow::bail!("none of {} could be read", counted(unreadable, "frame"));
    }
    if let Some(frame) = awaited.missed().filter(|_| !stop.load(Ordering::Relaxed)) {
        let which = "frames are counted from 0; unreadable ones and those between samples are passed over";
        anyhow::bail!("frame {frame} cannot be explained, for it was not looked at; {which}");
    }
    Ok(outcome(&summary))
}
