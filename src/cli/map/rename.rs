//! `loci map rename`: names a place.

use std::collections::BTreeSet;
use std::path::PathBuf;

use clap::Args;
use loci::place_map::{MapError, MapOptions, Place, PlaceId, PlaceMap};
use serde::Serialize;

use super::report_cut_off;
use crate::cli::console::say;
use crate::cli::{Outcome, WrongArgument};

/// Longest name in characters.
const MAX_NAME_CHARS: usize = 200;

/// Arguments of `loci map rename`.
#[derive(Args)]
#[command(after_help = "Examples:\n  loci map rename maps/site 17 \"dock 3\"\n  \
    loci map rename maps/site \"dock 3\" \"dock 4\"\n\n\
    Runs say the name with every frame that shows the place. No run may be writing the map meanwhile.")]
pub(in crate::cli) struct RenameArguments {
    /// Folder of the map
    map: PathBuf,
    /// The place: its number or its name; of a place that was merged into another one, the old number or name
    place: String,
    /// Its new name: up to 200 characters, no number, not the name of another place
    name: String,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    place: u32,
    name: &'a str,
    name_before: Option<&'a str>,
}

/// Names the place.
pub(super) fn run(arguments: &RenameArguments) -> anyhow::Result<Outcome> {
    let name = arguments.name.as_str();
    check_name(name)?;
    let mut map = PlaceMap::open_existing(&arguments.map, MapOptions::default())?;
    let Place { id, name: name_before, .. } = find_place(&map, &arguments.place)?.clone();
    if let Some(other) = called(&map, name).into_iter().find(|&other| other != id) {
        anyhow::bail!("place {} is called {name:?} already; rename that one first", other.0);
    }
    map.name_place(id, name)?;
    map.sync()?;
    let report = Report { place: id.0, name, name_before: name_before.as_deref() };
    let before = report.name_before.map(|before| format!(", before {before:?}")).unwrap_or_default();
    say(&match arguments.json {
        true => serde_json::to_string(&report)?,
        false => format!("place {} is called {name:?}{before}", id.0),
    })?;
    Ok(report_cut_off(map.summary().torn_bytes))
}

fn check_name(name: &str) -> Result<(), WrongArgument> {
    let fault = if name.trim().is_empty() {
        "it is empty"
    } else if name.trim() != name {
        "it begins or ends with a space"
    } else if name.chars().count() > MAX_NAME_CHARS {
        "it has more than 200 characters"
    } else if !name.chars().all(is_seen) {
        "it has line breaks or other characters that nobody sees"
    } else if name.parse::<u32>().is_ok() {
        "it is a number, and would be taken for a place's number"
    } else {
        return Ok(());
    };
    Err(WrongArgument(format!("{name:?} cannot name a place: {fault}; name it like \"dock 3\"")))
}

/// Whether `character` is neither a control character nor one of format, such as those that turn the direction of
/// writing: Rust, too, spells these out. Within a text, for at its beginning it spells out lone accents, too.
fn is_seen(character: char) -> bool {
    ['"', '\'', '\\'].contains(&character) || format!("a{character}").escape_debug().count() == 2
}

/// The place that `text` means: a number, or else a name.
fn find_place<'a>(map: &'a PlaceMap, text: &str) -> anyhow::Result<&'a Place> {
    let number = text.parse().ok().map(PlaceId);
    if let Some(place) = number.and_then(|number| map.place(number)) {
        return Ok(place);
    }
    let called = meant_by(map, text);
    match (called.iter().copied().next().and_then(|id| map.place(id)), called.len(), number) {
        (Some(place), 1, _) => Ok(place),
        (_, 0, Some(PlaceId(place))) => Err(MapError::NoPlace { place }.into()),
        (_, 0, None) => anyhow::bail!("no place in the map is called {text:?}"),
        _ => {
            let numbers: Vec<String> = called.iter().map(|id| id.0.to_string()).collect();
            anyhow::bail!("places {} are called {text:?}; give the number", numbers.join(", "))
        }
    }
}

/// The places called `name`. A place that was merged into another one is called what that one is.
fn called(map: &PlaceMap, name: &str) -> BTreeSet<PlaceId> {
    let living = map.living_places();
    living.filter(|place| place.name.as_deref() == Some(name)).map(|place| place.id).collect()
}

/// The places called `name`, or else what became of those that were called so before they were merged.
fn meant_by(map: &PlaceMap, name: &str) -> BTreeSet<PlaceId> {
    let called = called(map, name);
    if !called.is_empty() {
        return called;
    }
    let named = map.places().filter(|place| place.name.as_deref() == Some(name));
    named.filter_map(|place| map.place(place.id)).map(|place| place.id).collect()
}
