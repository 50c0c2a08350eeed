//! Frames that two traverses have in common: what is known may not be what is asked about, or it finds
//! itself.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::EvaluationError;
use super::traverse::{Frames, TraversePlan};

/// Most frames that the error lists.
const MAX_LISTED: usize = 3;

/// Fails if the same frame is in both.
pub(super) fn refuse_overlap(one: &TraversePlan, other: &TraversePlan) -> Result<(), EvaluationError> {
    let common = match (&one.frames, &other.frames) {
        (Frames::Files(a), Frames::Files(b)) => common_files(a, b),
        (Frames::Video { path, frames }, Frames::Video { path: other, frames: others }) => {
            let is_one = canonical(path) == canonical(other);
            let both = frames.iter().filter(|frame| is_one && others.binary_search(frame).is_ok());
            both.map(|frame| format!("{}#{frame}", file_name(path))).collect()
        }
        (Frames::Source { address, .. }, Frames::Source { address: other, .. }) if address == other => {
            vec![address.clone()]
        }
        _ => Vec::new(),
    };
    if common.is_empty() {
        return Ok(());
    }
    let listed = common.iter().take(MAX_LISTED).cloned().collect::<Vec<_>>().join(", ");
    let more = if common.len() > MAX_LISTED { "…" } else { "" };
    Err(EvaluationError::Wrong(format!(
        "{} and {} have frames in common ({listed}{more}), which would find themselves; leave them out of one",
        one.name, other.name
    )))
}

fn common_files(a: &[PathBuf], b: &[PathBuf]) -> Vec<String> {
    let known: HashSet<PathBuf> = b.iter().map(|path| canonical(path)).collect();
    a.iter().filter(|path| known.contains(&canonical(path))).map(|path| file_name(path)).collect()
}

fn canonical(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
