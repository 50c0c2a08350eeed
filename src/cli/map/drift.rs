//! `loci map drift`: lists the places whose latest looks do not hang together with their first ones any more.

use std::path::PathBuf;

use clap::Args;
use loci::place_map::{ExperienceId, MapError, PlaceMap};
use loci::recognition::Drift;
use serde::Serialize;

use super::eyes::Eyes;
use super::report_losses;
use crate::cli::console::{counted, say, spinner};
use crate::cli::settings::StreamSettings;
use crate::cli::{Outcome, stream};

/// Experiences of a part that are named.
const NAMED: usize = 5;

/// Arguments of `loci map drift`.
#[derive(Args)]
#[command(after_help = "Examples:\n  loci map drift maps/site\n  loci map drift maps/site --json\n\n\
    A place follows slow change, each match bringing a new look; by that it may also have been led astray. It is \
    listed if its first keyframe and its last are not linked, not even through others, or several not to several \
    others. Two keyframes are linked if a frame like the one would join a place with the other alone, or if they \
    were learnt in one go, within five frames. A listed place need not be wrong: look at its experiences, numbered as \
    in `loci map export --thumbnails`. Nothing is changed. Keyframes that cannot be read are left out. The exit code \
    is 0 also where places are listed, and 3 where something could not be read.")]
pub(in crate::cli) struct DriftArguments {
    /// Folder of the map
    map: PathBuf,
    /// Visual vocabulary; given again, a set that is switched by light [default: vocab/default.lvoc]
    #[arg(long, value_name = "FILE")]
    vocab: Vec<PathBuf>,
    /// Folder of the CNN whose descriptors the map holds, of which only the card is read, or none [default:
    /// models/efficientnet-lite0]
    #[arg(long, env = "LOCI_MODEL", value_name = "DIR")]
    model: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    /// Of the map, those that were merged into others left out.
    places: usize,
    drifted: Vec<DriftedPlace>,
}

#[derive(Serialize)]
struct DriftedPlace {
    place: u32,
    name: Option<String>,
    /// Keyframes by the numbers of their experiences, those together that are linked.
    parts: Vec<Vec<u32>>,
}

/// Compares the keyframes of every place, and lists the places that drifted.
pub(super) fn run(arguments: &DriftArguments) -> anyhow::Result<Outcome> {
    let settings = StreamSettings {
        vocab: arguments.vocab.clone(),
        model: arguments.model.clone(),
        ..StreamSettings::default()
    }
    .completed(None)?;
    let stop = stream::stop_flag()?;
    let eyes = Eyes::new(&settings)?;
    let mut recogniser = eyes.open(&arguments.map)?;
    eyes.report_foreign(&[&recogniser]);
    let spinner = spinner("comparing the keyframes of every place");
    let drifted = recogniser.drifted(&stop);
    spinner.finish_and_clear();
    let drifted = match drifted {
        Err(MapError::Interrupted) => anyhow::bail!("interrupted: not all places were compared"),
        drifted => drifted?,
    };
    let unreadable = recogniser.take_map_failure();
    let map = recogniser.map();
    let report = Report {
        places: map.summary().places,
        drifted: drifted.into_iter().map(|drift| DriftedPlace::new(map, drift)).collect(),
    };
    if arguments.json {
        say(&serde_json::to_string(&report)?)?;
    } else {
        report.drifted.iter().try_for_each(|place| say(&place.sentence()))?;
        say(&format!("{} of {} drifted", report.drifted.len(), counted(report.places, "place")))?;
    }
    let losses = report_losses(map, &arguments.map);
    Ok(unreadable.map_or(losses, |unreadable| {
        eprintln!("loci: {unreadable}");
        Outcome::Lost
    }))
}

/// For example `falls into 2 parts: experiences 3, 5; 9`.
#[cfg(feature = "rerun")]
pub(in crate::cli) fn parts_in_words(drift: &Drift) -> String {
    let numbers = |part: &Vec<ExperienceId>| part.iter().map(|id| id.0).collect();
    in_words(&drift.parts.iter().map(numbers).collect::<Vec<_>>())
}

fn in_words(parts: &[Vec<u32>]) -> String {
    let count = parts.len();
    let parts: Vec<String> = parts.iter().map(|part| listed(part)).collect();
    format!("falls into {count} parts: experiences {}", parts.join("; "))
}

impl DriftedPlace {
    fn new(map: &PlaceMap, drift: Drift) -> Self {
        let numbers = |part: Vec<ExperienceId>| part.into_iter().map(|id| id.0).collect();
        let name = map.place(drift.place).and_then(|place| place.name.as_deref()).map(str::to_owned);
        Self { place: drift.place.0, name, parts: drift.parts.into_iter().map(numbers).collect() }
    }

    fn sentence(&self) -> String {
        let name = self.name.as_ref().map_or(String::new(), |name| format!(" ({name})"));
        format!("place {}{name} {}", self.place, in_words(&self.parts))
    }
}

/// The first of so many numbers, and how many more there are.
fn listed(numbers: &[u32]) -> String {
    let named: Vec<String> = numbers.iter().take(NAMED).map(ToString::to_string).collect();
    match numbers.len().saturating_sub(NAMED) {
        0 => named.join(", "),
        more => format!("{} and {more} more", named.join(", ")),
    }
}
