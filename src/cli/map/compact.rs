//! `loci map compact`: rewrites a map without what does not count any more.

use std::path::PathBuf;

use clap::Args;
use loci::place_map::PlaceMap;
use serde::Serialize;

use super::report_cut_off;
use crate::cli::console::{counted, say, spinner};
use crate::cli::settings::StreamSettings;
use crate::cli::size::Size;
use crate::cli::{Outcome, stream};

/// Arguments of `loci map compact`.
#[derive(Args)]
#[command(after_help = "Example:\n  loci map compact maps/site\n\n\
    Nothing is lost if it is interrupted. While it runs, the map takes up to twice its size, and no run can write \
    it. A torn last record is cut off, and what is damaged is given up; the exit code is then 3.")]
pub(in crate::cli) struct CompactArguments {
    /// Folder of the map
    map: PathBuf,
    /// The --map-disk of the runs with this map: it says how long the journal's segments become, and nothing is given
    /// up for it [default: 4GiB]
    #[arg(long, env = "LOCI_MAP_DISK", value_name = "SIZE")]
    map_disk: Option<Size>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    /// Of the journal.
    bytes_before: u64,
    bytes_after: u64,
}

/// Compacts the map and says what it gained.
pub(super) fn run(arguments: &CompactArguments) -> anyhow::Result<Outcome> {
    let settings = StreamSettings { map_disk: arguments.map_disk, ..StreamSettings::default() };
    let mut map = PlaceMap::open_damaged(&arguments.map, stream::map_options(&settings)?)?;
    let before = map.summary();
    let spinner = spinner("rewriting what counts");
    let compacted = map.compact();
    spinner.finish_and_clear();
    // Also where it failed then: what was given up is gone.
    let loss = map.take_loss();
    if let Some(loss) = &loss {
        eprintln!("loci: {loss}");
    }
    compacted?;
    let report = Report { bytes_before: before.journal_bytes, bytes_after: map.summary().journal_bytes };
    let Report { bytes_before, bytes_after } = report;
    say(&match arguments.json {
        true => serde_json::to_string(&report)?,
        false => format!("journal  {} before, {bytes_after} after", counted(bytes_before, "byte")),
    })?;
    let outcome = report_cut_off(before.torn_bytes);
    Ok(if loss.is_some() { Outcome::Lost } else { outcome })
}
