//! `loci map`: look after a map.

mod compact;
mod export;
mod info;
mod merge;
mod rename;
mod verify;

use clap::Subcommand;
use loci::place_map::PlaceMap;

use super::Outcome;

/// Commands of `loci map`.
#[derive(Subcommand)]
pub(super) enum MapCommand {
    /// What a map holds
    Info(info::InfoArguments),
    /// Read every record to the last byte and list all that is wrong
    Verify(verify::VerifyArguments),
    /// Write what a map holds as JSON, CSV or Parquet
    Export(export::ExportArguments),
    /// Name a place
    Rename(rename::RenameArguments),
    /// Join two maps into a third one
    Merge(merge::MergeArguments),
    /// Rewrite a map without what does not count any more
    Compact(compact::CompactArguments),
}

/// Runs a command of `loci map`.
pub(super) fn run(command: MapCommand) -> anyhow::Result<Outcome> {
    match command {
        MapCommand::Info(arguments) => info::run(&arguments),
        MapCommand::Verify(arguments) => verify::run(&arguments),
        MapCommand::Export(arguments) => export::run(&arguments),
        MapCommand::Rename(arguments) => rename::run(&arguments),
        MapCommand::Merge(arguments) => merge::run(&arguments),
        MapCommand::Compact(arguments) => compact::run(&arguments),
    }
}

/// Says whether a power cut tore the last record of `map`.
fn report_torn_tail(map: &PlaceMap) -> Outcome {
    match map.summary().torn_bytes {
        0 => Outcome::Done,
        bytes => {
            eprintln!("loci: {bytes} bytes of a torn last record; the next run with this map cuts them off");
            Outcome::Lost
        }
    }
}
