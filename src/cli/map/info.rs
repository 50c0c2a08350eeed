//! `loci map info`: what a map holds.

use std::fmt;
use std::path::PathBuf;

use clap::Args;
use loci::place_map::{MapSummary, PlaceMap};
use serde::Serialize;

use super::report_losses;
use crate::cli::Outcome;
use crate::cli::console::{counted, say};

/// Arguments of `loci map info`.
#[derive(Args)]
#[command(after_help = "Examples:\n  loci map info maps/site\n  loci map info maps/site --json\n\n\
    A run may write the map meanwhile. The exit code is 3 where something cannot be read, the torn last \
    record included.")]
pub(in crate::cli) struct InfoArguments {
    /// Folder of the map
    map: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Info {
    #[serde(skip)]
    map: String,
    #[serde(flatten)]
    known: Known,
    #[serde(flatten)]
    files: Files,
    /// Hashes of the CNN models whose descriptors it holds.
    models: Vec<String>,
}

#[derive(Serialize)]
struct Known {
    places: usize,
    named_places: usize,
    merged_places: usize,
    experiences: usize,
    keyframes: usize,
    unreadable_keyframes: usize,
}

#[derive(Serialize)]
struct Files {
    segments: usize,
    journal_bytes: u64,
    /// Bytes of those records that count.
    live_bytes: u64,
    torn_bytes: u64,
    /// Records that cannot be read.
    passed_over: usize,
    snapshot_bytes: u64,
    /// Why the snapshot could not be used.
    snapshot_fault: Option<String>,
}

/// Prints what the map holds.
pub(super) fn run(arguments: &InfoArguments) -> anyhow::Result<Outcome> {
    let map = PlaceMap::open_read_only(&arguments.map)?;
    let MapSummary { places, named_places, merged_places, experiences, keyframes, .. } = map.summary();
    let MapSummary { segments, journal_bytes, live_bytes, torn_bytes, snapshot_bytes, .. } = map.summary();
    let passed_over = map.summary().passed_over;
    let (models, unreadable) = map.models()?;
    let unreadable_keyframes = unreadable.as_ref().map_or(0, |unreadable| unreadable.keyframes);
    let snapshot_fault = map.snapshot_fault().map(ToString::to_string);
    let info = Info {
        map: arguments.map.display().to_string(),
        known: Known { places, named_places, merged_places, experiences, keyframes, unreadable_keyframes },
        files: Files {
            segments,
            journal_bytes,
            live_bytes,
            torn_bytes,
            passed_over,
            snapshot_bytes,
            snapshot_fault,
        },
        models,
    };
    say(&if arguments.json { serde_json::to_string(&info)? } else { info.to_string() })?;
    let torn = report_losses(&map, &arguments.map);
    Ok(unreadable.map_or(torn, |unreadable| {
        eprintln!("loci: {unreadable}");
        Outcome::Lost
    }))
}

impl fmt::Display for Info {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { known, files, .. } = self;
        writeln!(f, "map          {}", self.map)?;
        let Known { places, named_places, merged_places, .. } = known;
        let merged = counted(merged_places, "other");
        writeln!(f, "places       {places} ({named_places} named), {merged} merged into them")?;
        writeln!(f, "experiences  {} ({})", known.experiences, counted(known.keyframes, "keyframe"))?;
        let Files { segments, journal_bytes, live_bytes, snapshot_bytes, .. } = files;
        let (bytes, segments) = (counted(journal_bytes, "byte"), counted(segments, "segment"));
        writeln!(f, "journal      {bytes} in {segments}, {live_bytes} of them count")?;
        match (&files.snapshot_fault, snapshot_bytes) {
            (Some(fault), _) => write!(f, "snapshot     not used: {fault}")?,
            (None, 0) => write!(f, "snapshot     none; the next run writes one")?,
            (None, bytes) => write!(f, "snapshot     {bytes} bytes")?,
        }
        self.models.iter().try_for_each(|model| write!(f, "\nCNN model    {model}"))
    }
}
