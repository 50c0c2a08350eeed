//! `loci map`: look after a map.

mod compact;
mod drift;
mod export;
mod eyes;
mod info;
mod merge;
mod rename;
mod verify;

#[cfg(feature = "rerun")]
pub(super) use drift::parts_in_words;
#[cfg(feature = "rerun")]
pub(super) use eyes::Eyes;

use std::path::{Component, Path, PathBuf};

use clap::Subcommand;
use loci::place_map::PlaceMap;

use super::console::counted;
use super::{Outcome, WrongArgument};

/// Commands of `loci map`.
#[derive(Subcommand)]
pub(super) enum MapCommand {
    /// What a map holds
    Info(info::InfoArguments),
    /// Read every record to the last byte and list all that is wrong
    Verify(verify::VerifyArguments),
    /// List the places whose latest looks do not hang together with their first ones
    Drift(drift::DriftArguments),
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
        MapCommand::Drift(arguments) => drift::run(&arguments),
        MapCommand::Export(arguments) => export::run(&arguments),
        MapCommand::Rename(arguments) => rename::run(&arguments),
        MapCommand::Merge(arguments) => merge::run(&arguments),
        MapCommand::Compact(arguments) => compact::run(&arguments),
    }
}

/// Says what of `map`, which is only read, from `folder`, could not be read.
pub(super) fn report_losses(map: &PlaceMap, folder: &Path) -> Outcome {
    if let Some(passed_over) = map.passed_over() {
        eprintln!("loci: {passed_over}; `loci map compact --repair` gives it up");
    }
    let torn_bytes = map.summary().torn_bytes;
    if torn_bytes == 0 {
        return if map.passed_over().is_some() { Outcome::Lost } else { Outcome::Done };
    }
    let torn = counted(torn_bytes, "byte");
    eprintln!(
        "loci: {}: {torn} of a torn last record; the next run with this map cuts them off",
        folder.display()
    );
    Outcome::Lost
}

/// Says whether a torn last record was cut off when the map was opened for writing.
fn report_cut_off(torn_bytes: u64) -> Outcome {
    if torn_bytes == 0 {
        return Outcome::Done;
    }
    eprintln!("loci: cut off from the map: {} of a torn last record", counted(torn_bytes, "byte"));
    Outcome::Lost
}

/// Refuses to write into `folder`, as `argument` asks for, if it lies in the folder of `map`, whatever links and
/// dots lead there.
fn refuse_inside(map: &Path, folder: &Path, argument: &str) -> Result<(), WrongArgument> {
    if real_path(folder).starts_with(real_path(map)) {
        let map = map.display();
        return Err(WrongArgument(format!("{argument} lies in the map {map} itself; choose another folder")));
    }
    Ok(())
}

/// The folder that a file at `path` stands in.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Where `path` leads once its links are followed, also where its last parts are not there yet.
fn real_path(path: &Path) -> PathBuf {
    let mut real = PathBuf::new();
    for part in std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).components() {
        match part {
            Component::ParentDir => drop(real.pop()),
            part => real.push(part),
        }
        real = real.canonicalize().unwrap_or(real);
    }
    real
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dots_and_links_lead_to_the_folder_that_they_mean_also_where_nothing_is_yet() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        let map = root.join("map");
        std::fs::create_dir(&map).unwrap();
        std::os::unix::fs::symlink(&map, root.join("link")).unwrap();
        for inside in ["map", "map/.", "map/new/newer", "link", "link/new", "gone/../map", "map/gone/.."] {
            assert!(real_path(&root.join(inside)).starts_with(&map), "{inside}");
        }
        for outside in ["", "maps", "map/..", "link/../new", "gone", "map/../gone"] {
            assert!(!real_path(&root.join(outside)).starts_with(&map), "{outside}");
        }
    }
}
