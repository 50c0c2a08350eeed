//! `loci map verify`: reads a map to its last byte and lists everything that is wrong with it.

use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressDrawTarget;
use loci::place_map::{PlaceMap, Problem, SnapshotState, Verification};
use serde::Serialize;

use crate::cli::Outcome;
use crate::cli::console::{counted, progress_bar, say};

/// Arguments of `loci map verify`.
#[derive(Args)]
#[command(after_help = "Examples:\n  loci map verify maps/site\n  loci map verify maps/site --json\n\n\
    Exit codes: 0 sound, also where only the snapshot is of no use; 3 sound up to a torn last record; 1 damaged. \
    Nothing is changed; a run may write the map meanwhile.")]
pub(in crate::cli) struct VerifyArguments {
    /// Folder of the map
    map: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    segments: usize,
    records: u64,
    bytes: u64,
    snapshot: &'static str,
    snapshot_fault: Option<String>,
    damaged: bool,
    problems: Vec<ReportedProblem>,
    /// Problems beyond those that are listed.
    further_problems: u64,
}

#[derive(Serialize)]
struct ReportedProblem {
    file: String,
    offset: Option<u64>,
    reason: String,
    torn_tail: bool,
}

/// Prints what was checked and what is wrong.
pub(super) fn run(arguments: &VerifyArguments) -> anyhow::Result<Outcome> {
    let bar = progress_bar(None, "bytes", ProgressDrawTarget::stderr());
    let found = PlaceMap::verify(&arguments.map, &|done, total| {
        bar.set_length(total);
        bar.set_position(done);
    })?;
    bar.finish_and_clear();
    if arguments.json {
        say(&serde_json::to_string(&report(&found))?)?;
    } else {
        print(&found)?;
    }
    let map = arguments.map.display();
    let count = found.problems.len() as u64 + found.further_problems;
    match (found.is_damaged(), found.refusal, found.snapshot_fault) {
        (true, Some(refusal), _) => {
            anyhow::bail!("{map} cannot be used as it is, problems found: {count}; {refusal}")
        }
        (true, None, _) => anyhow::bail!(
            "{map} is damaged, problems found: {count}; `loci map compact` gives up what cannot be read"
        ),
        (false, _, Some(fault)) if found.snapshot == SnapshotState::Wrong => anyhow::bail!(fault),
        (false, Some(refusal), _) => anyhow::bail!(refusal),
        (false, None, Some(fault)) => eprintln!("loci: {fault}"),
        (false, None, None) => {}
    }
    if found.problems.is_empty() {
        return Ok(Outcome::Done);
    }
    eprintln!("loci: the last record of {map} is torn; the next run with this map cuts it off");
    Ok(Outcome::Lost)
}

fn print(found: &Verification) -> anyhow::Result<()> {
    let Verification { segments, records, bytes, .. } = found;
    let (segments, records) = (counted(segments, "segment"), counted(records, "whole record"));
    say(&format!("checked   {segments}, {records}, {}", counted(bytes, "byte")))?;
    let snapshot = match found.snapshot {
        SnapshotState::Missing => "none; the journal has everything",
        SnapshotState::Right => "says the same as the journal",
        SnapshotState::Useless => "not used; the journal has everything",
        SnapshotState::Wrong => "says otherwise than the journal",
        SnapshotState::NotCompared => "not compared, for the journal is damaged",
    };
    say(&format!("snapshot  {snapshot}"))?;
    for problem in &found.problems {
        say(&format!("problem   {problem}"))?;
    }
    if found.further_problems > 0 {
        say(&format!("          and {} more", counted(found.further_problems, "problem")))?;
    }
    Ok(())
}

fn report(found: &Verification) -> Report {
    let reported = |problem: &Problem| ReportedProblem {
        file: problem.path.display().to_string(),
        offset: problem.offset,
        reason: problem.reason.clone(),
        torn_tail: problem.is_torn_tail,
    };
    Report {
        segments: found.segments,
        records: found.records,
        bytes: found.bytes,
        snapshot: match found.snapshot {
            SnapshotState::Missing => "missing",
            SnapshotState::Right => "right",
            SnapshotState::Useless => "useless",
            SnapshotState::Wrong => "wrong",
            SnapshotState::NotCompared => "not_compared",
        },
        snapshot_fault: found.snapshot_fault.clone(),
        damaged: found.is_damaged(),
        problems: found.problems.iter().map(reported).collect(),
        further_problems: found.further_problems,
    }
}
