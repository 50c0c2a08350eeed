//! `loci map merge`: joins two maps into a third one, by recognising the keyframes of the one in the other.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use loci::place_map::{Durability, MapError, MapOptions, MapSummary, PlaceId, PlaceMap};
use loci::recognition::{Join, Recogniser, Support};
use loci::storage::{DiskFolder, Folder, WriterLock};
use serde::Serialize;

use super::eyes::Eyes;
use super::{folder_of, refuse_inside, report_losses};
use crate::cli::console::{counted, say, spinner};
use crate::cli::settings::StreamSettings;
use crate::cli::size::Size;
use crate::cli::{Outcome, WrongArgument, stream};

/// Arguments of `loci map merge`.
#[derive(Args)]
#[command(after_help = "Examples:\n  \
    loci map merge maps/robot1 maps/robot2 --dry-run\n  \
    loci map merge maps/robot1 maps/robot2 --out maps/both\n\n\
    Both maps stay as they are: to undo a merge, delete what it made. Places of A keep their numbers; place n of B \
    becomes n plus the number of places of A, those that were merged into others counted, and that number goes on \
    meaning it where it turned out to be one of A. Experiences are numbered anew. A name that only the place of B has \
    goes along; where both have one, A's stays.\n\n\
    A place of B is joined to one of A if both say so: at least two keyframes of each, or the only one, match the \
    other strongly and better than any other place; so do at least half of the keyframes of either; and most keyframes \
    of B's place that match anything match A's. A match is strong by geometry with twice the inliers that `loci run` \
    asks for, or with just those where the CNN descriptors that the maps hold agree. Where the model's folder is \
    missing, geometry decides alone.")]
pub(in crate::cli) struct MergeArguments {
    /// The map whose places keep their numbers
    a: PathBuf,
    /// The map whose places are recognised in it
    b: PathBuf,
    /// Folder of the map that is made, needed unless --dry-run; it must not be there yet, nor lie in A or B
    #[arg(long, value_name = "DIR", required_unless_present = "dry_run")]
    out: Option<PathBuf>,
    /// Only list which places would be joined, and why
    #[arg(long, conflicts_with = "out")]
    dry_run: bool,
    /// Visual vocabulary; given again, a set that is switched by light [default: vocab/default.lvoc]
    #[arg(long, value_name = "FILE")]
    vocab: Vec<PathBuf>,
    /// Folder of the CNN whose descriptors the maps hold, of which only the card is read, or none [default:
    /// models/efficientnet-lite0]
    #[arg(long, env = "LOCI_MODEL", value_name = "DIR")]
    model: Option<PathBuf>,
    /// Most bytes of the map that is made; what tells least is given up [default: 4GiB]
    #[arg(long, env = "LOCI_MAP_DISK", value_name = "SIZE")]
    map_disk: Option<Size>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    joins: Vec<JoinLine>,
    /// Of the map that was made.
    #[serde(skip_serializing_if = "Option::is_none")]
    places: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    experiences: Option<usize>,
}

#[derive(Serialize)]
struct JoinLine {
    /// In A.
    place: u32,
    /// In B.
    other: u32,
    /// What the keyframes of B's place say.
    #[serde(flatten)]
    there: SupportLine,
    /// What those of A's place say.
    back: SupportLine,
}

#[derive(Serialize)]
struct SupportLine {
    matched_keyframes: usize,
    keyframes: usize,
    inliers: u32,
    cosine: Option<f32>,
}

impl From<&Join> for JoinLine {
    fn from(join: &Join) -> Self {
        let (there, back) = (join.there.into(), join.back.into());
        Self { place: join.place.0, other: join.other.0, there, back }
    }
}

impl From<Support> for SupportLine {
    fn from(Support { matched, keyframes, inliers, cosine }: Support) -> Self {
        Self { matched_keyframes: matched, keyframes, inliers, cosine }
    }
}

/// Finds the joins, makes the map unless that is not wanted, and lists what was joined and why.
pub(super) fn run(arguments: &MergeArguments) -> anyhow::Result<Outcome> {
    let settings = StreamSettings {
        vocab: arguments.vocab.clone(),
        model: arguments.model.clone(),
        map_disk: arguments.map_disk,
        ..StreamSettings::default()
    }
    .completed(None)?;
    let options = MapOptions { durability: Durability::None, ..stream::map_options(&settings)? };
    check_folders(arguments)?;
    let stop = stream::stop_flag()?;
    let eyes = Eyes::new(&settings)?;
    let (mut a, mut b) = (eyes.open(&arguments.a)?, eyes.open(&arguments.b)?);
    eyes.report_foreign(&[&a, &b]);
    go_on(&stop)?;
    let spinner = spinner("recognising the keyframes of each in the other");
    let joins = a.joins(&mut b, &stop);
    spinner.finish_and_clear();
    let joins = unless_stopped(&stop, joins)?;
    let unreadable = [&mut a, &mut b].map(Recogniser::take_map_failure);
    let maps = (a.map(), b.map());
    let made = arguments.out.as_deref().map(|out| make(out, options, maps, &joins, &stop)).transpose()?;
    let (made, left_out) = made.map_or((None, unreadable), |(made, left_out)| (Some(made), left_out));
    let report = Report {
        joins: joins.iter().map(JoinLine::from).collect(),
        places: made.as_ref().map(|made| made.places),
        experiences: made.as_ref().map(|made| made.experiences),
    };
    if arguments.json {
        say(&serde_json::to_string(&report)?)?;
    } else {
        report.joins.iter().try_for_each(|join| say(&sentence(join)))?;
        say(&conclusion(&report, arguments))?;
    }
    left_out.iter().flatten().for_each(report_left_out);
    let torn = [(a.map(), &arguments.a), (b.map(), &arguments.b)].map(|(map, at)| report_losses(map, at));
    let is_lost = left_out.iter().any(Option::is_some) || torn.contains(&Outcome::Lost);
    Ok(if is_lost { Outcome::Lost } else { Outcome::Done })
}

/// Says what of one of both maps nothing was made of, and what helps.
fn report_left_out(left_out: &MapError) {
    match left_out {
        MapError::GaveUp { .. } => eprintln!("loci: {left_out}; `loci map compact` gives it up there, too"),
        _ => eprintln!("loci: {left_out}"),
    }
}

/// Refuses folders that make no sense: one map given twice, and a new map where there is something already.
fn check_folders(arguments: &MergeArguments) -> Result<(), WrongArgument> {
    let MergeArguments { a, b, out, .. } = arguments;
    if let (Ok(one), Ok(other)) = (a.canonicalize(), b.canonicalize())
        && one == other
    {
        let (a, b) = (a.display(), b.display());
        return Err(WrongArgument(format!("{a} and {b} are one map; name two different ones")));
    }
    let Some(out) = out else { return Ok(()) };
    let argument = format!("--out {}", out.display());
    if out.exists() {
        return Err(WrongArgument(format!("{argument} is there already")));
    }
    [a, b].into_iter().try_for_each(|map| refuse_inside(map, folder_of(out), &argument))
}

/// Fails once the user wants no more of it.
fn go_on(stop: &AtomicBool) -> anyhow::Result<()> {
    anyhow::ensure!(!stop.load(Ordering::Relaxed), "interrupted: no map was made");
    Ok(())
}

/// What came of it, unless the user wants no more of it.
fn unless_stopped<T>(stop: &AtomicBool, result: Result<T, MapError>) -> anyhow::Result<T> {
    go_on(stop)?;
    Ok(result?)
}

/// Makes the joint map, whole or not at all; answers also what was left out of either since it is damaged.
fn make(
    out: &Path,
    options: MapOptions,
    maps: (&PlaceMap, &PlaceMap),
    joins: &[Join],
    stop: &AtomicBool,
) -> anyhow::Result<(MapSummary, [Option<MapError>; 2])> {
    remove_leftovers(out);
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let beside = out.with_file_name(name);
    let spinner = spinner("writing the map that holds both");
    let made = fill(&beside, options, maps, joins, stop).and_then(|(map, left_out)| {
        let parent = DiskFolder::new(out.parent().unwrap_or(Path::new("")));
        fs::rename(&beside, out)
            .and_then(|()| parent.sync())
            .map_err(|error| anyhow::anyhow!("cannot make {}: {error}", out.display()))?;
        Ok((map.summary(), left_out))
    });
    if made.is_err() {
        // The failure itself is what matters; a leftover would only add to it.
        let _ = fs::remove_dir_all(&beside);
    }
    spinner.finish_and_clear();
    made
}

fn fill(
    folder: &Path,
    options: MapOptions,
    (a, b): (&PlaceMap, &PlaceMap),
    joins: &[Join],
    stop: &AtomicBool,
) -> anyhow::Result<(PlaceMap, [Option<MapError>; 2])> {
    let mut map = PlaceMap::open(folder, options)?;
    let (_, without_a) = unless_stopped(stop, map.absorb(a, stop))?;
    let (first, without_b) = unless_stopped(stop, map.absorb(b, stop))?;
    for join in joins {
        go_on(stop)?;
        map.merge_places(PlaceId(first.0 + join.other.0), join.place)?;
    }
    map.close()?;
    go_on(stop)?;
    Ok((map, [without_a, without_b]))
}

/// Deletes what merges to `out` left behind that were ended at once, unless they still go on. What cannot be deleted
/// is in nobody's way.
fn remove_leftovers(out: &Path) {
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    let is_leftover = |found: &str| {
        let process =
            found.strip_prefix(&*name).and_then(|rest| rest.strip_prefix('.')?.strip_suffix(".part"));
        process.is_some_and(|process| process.parse::<u32>().is_ok())
    };
    for entry in fs::read_dir(folder_of(out)).into_iter().flatten().flatten() {
        if is_leftover(&entry.file_name().to_string_lossy())
            && let Ok(_unused) = WriterLock::acquire(&entry.path())
        {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

fn sentence(JoinLine { place, other, there, back }: &JoinLine) -> String {
    let mut text = format!(
        "place {other} of B is place {place} of A: {} of {} recognised, and {} of {} the other way round, by geometry \
         with up to {} effective inliers",
        there.matched_keyframes,
        counted(there.keyframes, "keyframe"),
        back.matched_keyframes,
        back.keyframes,
        there.inliers.max(back.inliers),
    );
    if let Some(cosine) = there.cosine.into_iter().chain(back.cosine).reduce(f32::max) {
        text += &format!(", by the CNN up to {cosine:.3}");
    }
    text
}

fn conclusion(report: &Report, arguments: &MergeArguments) -> String {
    let joins = counted(report.joins.len(), "place");
    match (&arguments.out, report.places, report.experiences) {
        (Some(out), Some(places), Some(experiences)) => {
            let (places, experiences) = (counted(places, "place"), counted(experiences, "experience"));
            format!("{joins} joined; {} has {places}, {experiences}", out.display())
        }
        _ => format!("{joins} would be joined; nothing was written"),
    }
}
