//! An export as JSON: an object of places and experiences, each on a line of its own.

use std::io::Write;

use loci::place_map::{Place, PlaceMap};
use serde::Serialize;

use super::rows::Rows;

#[derive(Serialize)]
struct PlaceEntry<'a> {
    id: u32,
    name: Option<&'a str>,
    merged_into: Option<u32>,
    neighbours: Vec<u32>,
    experiences: Vec<u32>,
}

impl<'a> From<&'a Place> for PlaceEntry<'a> {
    fn from(place: &'a Place) -> Self {
        Self {
            id: place.id.0,
            name: place.name.as_deref(),
            merged_into: place.merged_into.map(|place| place.0),
            neighbours: place.neighbours.iter().map(|place| place.0).collect(),
            experiences: place.experiences.iter().map(|experience| experience.0).collect(),
        }
    }
}

/// Writes all places and rows.
pub(super) fn write(output: &mut dyn Write, map: &PlaceMap, rows: &mut Rows<'_>) -> anyhow::Result<()> {
    output.write_all(b"{\"places\":[")?;
    for (index, place) in map.places().enumerate() {
        write_entry(output, index, &PlaceEntry::from(place))?;
    }
    output.write_all(b"\n],\"experiences\":[")?;
    let mut index = 0;
    while let Some(row) = rows.next()? {
        write_entry(output, index, &row)?;
        index += 1;
    }
    Ok(output.write_all(b"\n]}\n")?)
}

fn write_entry(output: &mut dyn Write, index: usize, entry: &impl Serialize) -> anyhow::Result<()> {
    output.write_all(if index == 0 { b"\n" } else { b",\n" })?;
    Ok(serde_json::to_writer(output, entry)?)
}
