//! Recordings that are made afterwards, for people who look over what is there: of a whole map, or of the log of a run.

mod log;
mod map;
mod run;
mod succession;

pub use map::{Finding, Reviewed, review_map};
pub use run::{ReviewedRun, review_run};

pub(super) use map::PLACE_TIMELINE;

use std::fs;
use std::path::Path;

use ::rerun::{RecordingStream, RecordingStreamError};

use super::file::RecordingFile;
use super::place_graph::PlaceGraph;
use super::rotation::Rotation;
use super::{file, one_line};
use crate::place_map::{MapError, PlaceMap};
use crate::recognition::{Insight, PlaceSketch};

/// Frames, places or experiences after which the disk is waited for.
const SETTLED_AFTER: usize = 256;

/// Why there is no review, or none that is whole.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReviewError {
    /// The recording cannot be written.
    #[error("review {path}: {reason}")]
    Recording {
        /// The file.
        path: String,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// The map cannot be read at all.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The log is none, or cannot be read.
    #[error("line {line}: {reason}")]
    Log {
        /// The line, from 1.
        line: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// Somebody stopped it.
    #[error("interrupted: the recording is not whole")]
    Interrupted,
}

/// Why it breaks off.
enum Failure {
    Review(ReviewError),
    /// The reason, without the file.
    File(String),
}

impl From<RecordingStreamError> for Failure {
    fn from(error: RecordingStreamError) -> Self {
        Self::File(error.to_string())
    }
}

impl From<MapError> for Failure {
    fn from(error: MapError) -> Self {
        Self::Review(ReviewError::Map(error))
    }
}

/// Has `write` log a recording that takes the place of the file at `path` when it is whole.
fn recorded<T>(
    path: &Path,
    write: impl FnOnce(RecordingStream) -> Result<T, Failure>,
) -> Result<T, ReviewError> {
    if path.is_dir() {
        let reason = "that is a folder; name a file in it".to_owned();
        return Err(ReviewError::Recording { path: path.display().to_string(), reason });
    }
    // What is not whole never has the name.
    let part = path.with_extension("rrd.part");
    let written = record(&part, write).and_then(|written| {
        fs::rename(&part, path).map_err(|error| Failure::File(error.to_string()))?;
        Ok(written)
    });
    written.map_err(|failure| {
        let _ = fs::remove_file(&part);
        match failure {
            Failure::Review(error) => error,
            Failure::File(reason) => {
                ReviewError::Recording { path: path.display().to_string(), reason: one_line(&reason) }
            }
        }
    })
}

fn record<T>(part: &Path, write: impl FnOnce(RecordingStream) -> Result<T, Failure>) -> Result<T, Failure> {
    let mut recording = RecordingFile::new(part, Rotation::default()).map_err(Failure::File)?;
    let stream = recording.begin().map_err(Failure::File)?;
    stream.set_log_time_enabled(false);
    stream.set_log_tick_enabled(false);
    let written = write(stream.clone())?;
    let flushed = file::written(&stream);
    drop(stream);
    flushed.map_err(Failure::File)?;
    recording.check_end().map_err(Failure::File)?;
    Ok(written)
}

/// Waits for the disk now and then, so that no more is held back than it takes in a while, and a full one is noticed.
fn settle(stream: &RecordingStream, shown: usize) -> Result<(), Failure> {
    if shown.is_multiple_of(SETTLED_AFTER) { file::written(stream).map_err(Failure::File) } else { Ok(()) }
}

/// What was read, or nothing where it is damaged.
fn readable<T>(read: Result<T, MapError>) -> Result<Option<T>, Failure> {
    match read {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.is_damage() => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// All places of `map` become nodes, which lie where they were seen first if that is known.
fn learn_map(graph: &mut PlaceGraph, map: &PlaceMap) -> Result<(), Failure> {
    let places = map.living_places().map(|place| PlaceSketch::of(place, map)).collect();
    graph.learn_places(&Insight { places, is_whole_map: true, ..Insight::default() });
    for place in map.living_places() {
        let first = place.experiences.first().map(|&first| readable(map.origin(first))).transpose()?;
        if let Some(pose) = first.flatten().and_then(|origin| origin.pose) {
            graph.put(place.id, &pose);
        }
    }
    Ok(())
}
