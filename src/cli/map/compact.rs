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
#[command(after_help = "Examples:\n  loci map compact maps/site\n  loci map compact maps/site --repair\n\n\
    Nothing is lost if it is interrupted. While it runs, the map takes up to twice its size, and no run can write \
    it. A torn last record is cut off, and what is damaged of single experiences is given up; the exit code is then 3. \
    Where more is damaged the map is left alone; with --repair it is read around that, and what cannot be read is gone \
    for good, so copy the folder first.")]
pub(in crate::cli) struct CompactArguments {
    /// Folder of the map
    map: PathBuf,
    /// The --map-disk of the runs with this map: it says how long the journal's segments become, and nothing is given
    /// up for it [default: 4GiB]
    #[arg(long, env = "LOCI_MAP_DISK", value_name = "SIZE")]
    map_disk: Option<Size>,
    /// Also where the map is too damaged to be opened: keep what can be read of it, and give up the rest
    #[arg(long)]
    repair: bool,
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
    let options = stream::map_options(&settings)?;
    let mut map = match arguments.repair {
        true => PlaceMap::open_damaged(&arguments.map, options)?,
        false => PlaceMap::open_existing(&arguments.map, options)?,
    };
    let before = map.summary();
    // Before anything is given up: if this is interrupted, nobody could say it afterwards.
    if let Some(passed_over) = map.passed_over() {
        eprintln!("loci: {passed_over}; to be given up");
    }
    let outcome = report_cut_off(before.torn_bytes);
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
    Ok(if loss.is_some() || before.passed_over > 0 { Outcome::Lost } else { outcome })
}
