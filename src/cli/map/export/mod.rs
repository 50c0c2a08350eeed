//! `loci map export`: what a map holds as a table that other programs read, one row an experience.

mod as_csv;
mod as_json;
mod as_parquet;
mod output;
mod row;
mod rows;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use loci::place_map::PlaceMap;
use serde::Serialize;

use self::output::Output;
use self::rows::Rows;
use super::{folder_of, real_path, refuse_inside, report_losses};
use crate::cli::console::{counted, say};
use crate::cli::{Outcome, WrongArgument, stream};

/// Where an export goes that goes to stdout.
const STDOUT: &str = "-";

/// Arguments of `loci map export`.
#[derive(Args)]
#[command(after_help = "Examples:\n  loci map export maps/site --out site.csv\n  \
    loci map export maps/site --out site.parquet --thumbnails pictures\n  \
    loci map export maps/site --out - --format json | jq '.places[].name'\n\n\
    A row is an experience; JSON has the places, too. A run may write the map meanwhile. What cannot be read is \
    skipped and reported; the exit code is then 3.")]
pub(in crate::cli) struct ExportArguments {
    /// Folder of the map
    map: PathBuf,
    /// File to write, not in the map; its ending (.json, .csv, .parquet) says the format. - is stdout
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Format, whatever the file's ending [default of stdout: json]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Write the thumbnails, too, as JPEG files into this folder, named by their experiences; made if need be, not in
    /// the map
    #[arg(long, value_name = "DIR")]
    thumbnails: Option<PathBuf>,
    /// Print as JSON what was written, and where; with --out - nothing but the export is printed
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
enum Format {
    Json,
    Csv,
    Parquet,
}

impl Format {
    fn of(arguments: &ExportArguments) -> Result<Self, WrongArgument> {
        let is_stdout = arguments.out == Path::new(STDOUT);
        let ending = arguments.out.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
        let by_name = if is_stdout { Some(Self::Json) } else { Self::from_str(ending, true).ok() };
        match arguments.format.or(by_name) {
            Some(Self::Parquet) if is_stdout => {
                Err(WrongArgument("Parquet goes to a file, not to stdout: --out FILE.parquet".to_owned()))
            }
            Some(format) => Ok(format),
            None => {
                let out = arguments.out.display();
                Err(WrongArgument(format!(
                    "--out {out} ends neither in .json, .csv nor .parquet: add --format"
                )))
            }
        }
    }
}

/// What was written.
#[derive(Serialize)]
struct Report {
    file: String,
    format: Format,
    experiences: u64,
    thumbnails: u64,
    /// What could not be read.
    skipped: u64,
}

/// Writes the map's contents.
pub(super) fn run(arguments: &ExportArguments) -> anyhow::Result<Outcome> {
    let format = Format::of(arguments)?;
    refuse_the_map(arguments)?;
    let map = PlaceMap::open_read_only(&arguments.map)?;
    let stop = stream::stop_flag()?;
    let mut output = Output::create(&arguments.out, stop.clone())?;
    let mut rows = Rows::new(&map, arguments.thumbnails.as_deref(), stop)?;
    let written = match format {
        Format::Json => as_json::write(&mut output, &map, &mut rows),
        Format::Csv => as_csv::write(&mut output, &mut rows),
        Format::Parquet => as_parquet::write(&mut output, &mut rows),
    };
    let counts = rows.finish();
    if !output.finish(written)? {
        return Ok(Outcome::Done);
    }
    let counts = counts?;
    let report = Report {
        file: arguments.out.display().to_string(),
        format,
        experiences: counts.rows,
        thumbnails: counts.thumbnails,
        skipped: counts.skipped,
    };
    if arguments.out != Path::new(STDOUT) {
        say(&if arguments.json { serde_json::to_string(&report)? } else { described(&report) })?;
    }
    let torn = report_losses(&map, &arguments.map);
    Ok(if report.skipped > 0 { Outcome::Lost } else { torn })
}

fn described(report: &Report) -> String {
    let Report { file, experiences, thumbnails, .. } = report;
    let exported = format!("exported  {} to {file}", counted(experiences, "experience"));
    match thumbnails {
        0 => exported,
        _ => format!("{exported}, and {}", counted(thumbnails, "thumbnail")),
    }
}

/// An export must not stand among the files of the map, and least of all replace one of them.
fn refuse_the_map(arguments: &ExportArguments) -> Result<(), WrongArgument> {
    let ExportArguments { map, out, thumbnails, .. } = arguments;
    if out != Path::new(STDOUT) {
        refuse_inside(map, folder_of(out), &format!("--out {}", out.display()))?;
    }
    let Some(folder) = thumbnails else { return Ok(()) };
    if real_path(folder) == real_path(out) {
        let folder = folder.display();
        return Err(WrongArgument(format!("{folder} cannot be both --out and --thumbnails; name a folder")));
    }
    refuse_inside(map, folder, &format!("--thumbnails {}", folder.display()))
}
