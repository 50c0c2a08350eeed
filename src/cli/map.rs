//! `loci map`: look after a map.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use loci::place_map::PlaceMap;
use serde::Serialize;

use super::console::say;
use super::{Anything, Outcome, not_built};

/// Commands of `loci map`.
#[derive(Subcommand)]
pub(super) enum MapCommand {
    /// How many places and experiences a map holds
    Info(InfoArguments),
    /// Check every record (not built yet)
    Verify(Anything),
    /// Write JSON, CSV or Parquet (not built yet)
    Export(Anything),
    /// Name a place (not built yet)
    Rename(Anything),
    /// Join two maps (not built yet)
    Merge(Anything),
    /// Rewrite a map without what was replaced (not built yet)
    Compact(Anything),
}

/// Arguments of `loci map info`.
#[derive(Args)]
#[command(after_help = "Example:\n  loci map info maps/site")]
pub(super) struct InfoArguments {
    /// Folder of the map
    map: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Info {
    places: usize,
    named_places: usize,
    experiences: usize,
    keyframes: usize,
    journal_bytes: u64,
    torn_bytes: u64,
    models: Vec<String>,
}

/// Runs a command of `loci map`.
pub(super) fn run(command: MapCommand) -> anyhow::Result<Outcome> {
    match command {
        MapCommand::Info(arguments) => info(&arguments),
        MapCommand::Verify(_) => not_built("map verify"),
        MapCommand::Export(_) => not_built("map export"),
        MapCommand::Rename(_) => not_built("map rename"),
        MapCommand::Merge(_) => not_built("map merge"),
        MapCommand::Compact(_) => not_built("map compact"),
    }
}

fn info(arguments: &InfoArguments) -> anyhow::Result<Outcome> {
    let map = PlaceMap::open_read_only(&arguments.map)?;
    let summary = map.summary();
    let info = Info {
        places: summary.places,
        named_places: summary.named_places,
        experiences: summary.experiences,
        keyframes: summary.keyframes,
        journal_bytes: summary.journal_bytes,
        torn_bytes: summary.torn_bytes,
        models: summary.models,
    };
    if arguments.json {
        say(&serde_json::to_string(&info)?)?;
    } else {
        say(&format!("map          {}", arguments.map.display()))?;
        say(&format!("places       {} ({} named)", info.places, info.named_places))?;
        say(&format!("experiences  {} ({} keyframes)", info.experiences, info.keyframes))?;
        say(&format!("journal      {} bytes", info.journal_bytes))?;
        for model in &info.models {
            say(&format!("CNN model    {model}"))?;
        }
    }
    if info.torn_bytes == 0 {
        return Ok(Outcome::Done);
    }
    eprintln!(
        "loci: {} bytes of a torn last record; the next run with this map cuts them off",
        info.torn_bytes
    );
    Ok(Outcome::Lost)
}
