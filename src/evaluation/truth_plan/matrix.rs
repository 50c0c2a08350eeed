//! Plans from a matrix or list of matching frames.

use std::path::Path;

use super::{Kind, Pairs, TruthPlan, hash_of};
use crate::evaluation::ground_truth::{GroundTruthError, LoopMatrix};
use crate::evaluation::traverse::TraversePlan;

/// The plan over the pairs of `matrix`, which was read from `path`.
pub(super) fn of_matrix(
    path: &Path,
    matrix: &LoopMatrix,
    query: &TraversePlan,
    reference: Option<&TraversePlan>,
) -> Result<TruthPlan, GroundTruthError> {
    let fits = |what: &str, expected: usize, plan: &TraversePlan| match plan.frame_count() {
        Some(frames) if frames != expected => Err(GroundTruthError::malformed(
            path,
            format!("{expected} {what}, but {} has {frames} frames", plan.name),
        )),
        _ => Ok(()),
    };
    fits("rows", matrix.rows(), query)?;
    let references = reference.unwrap_or(query);
    match matrix.columns() {
        Some(columns) => fits("columns", columns, references)?,
        None => within(path, matrix, references)?,
    }
    let mut matches: Vec<Vec<u32>> = (0..matrix.rows()).map(|row| matrix.matches(row).to_vec()).collect();
    if reference.is_none() {
        matches = earlier_of(&matches);
    }
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    let definition = format!("the pairs in {file}");
    let matches = matches.into_iter().map(Some).collect();
    let pairs = Pairs { matches, unsaid: Vec::new(), references: matrix.columns() };
    Ok(TruthPlan { definition, sha256: hash_of(path)?, kind: Kind::Pairs(pairs) })
}

/// Fails if a list of matches names reference frames that do not exist.
fn within(path: &Path, matrix: &LoopMatrix, plan: &TraversePlan) -> Result<(), GroundTruthError> {
    let Some(frames) = plan.frame_count() else { return Ok(()) };
    let beyond = |row: &usize| matrix.matches(*row).last().is_some_and(|&last| last as usize >= frames);
    let frames_beyond: Vec<u64> = (0..matrix.rows()).filter(beyond).map(|row| row as u64).collect();
    if frames_beyond.is_empty() {
        return Ok(());
    }
    let reason = format!("they name frames beyond the {frames} of {}, counted from 0", plan.name);
    Err(GroundTruthError::queries(path, frames_beyond, reason))
}

/// For each frame the earlier frames of the same place, whichever half of the matrix says so.
fn earlier_of(pairs: &[Vec<u32>]) -> Vec<Vec<u32>> {
    let mut earlier = vec![Vec::new(); pairs.len()];
    for (row, columns) in (0_u32..).zip(pairs) {
        for &column in columns {
            let (first, last) = (row.min(column), row.max(column));
            if first != last
                && let Some(list) = earlier.get_mut(last as usize)
            {
                list.push(first);
            }
        }
    }
    for list in &mut earlier {
        list.sort_unstable();
        list.dedup();
    }
    earlier
}
