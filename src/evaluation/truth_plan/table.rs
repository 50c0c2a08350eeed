//! Plans from a ground-truth table: a row for every frame.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::{Kind, Pairs, TruthPlan, hash_of};
use crate::evaluation::ground_truth::{GroundTruthError, Spot, Table, TableSpots, Tolerance, file};
use crate::evaluation::traverse::{Frames, TraversePlan};

/// Most frames without a row that an error lists.
const MAX_LISTED: usize = 5;

/// A `.csv` file whose first line does not consist of numbers is a table, not a matrix.
pub(super) fn is_table(path: &Path) -> Result<bool, GroundTruthError> {
    if path.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("csv")) {
        return Ok(false);
    }
    let text = file::read_text(path)?;
    let first = text.lines().next().unwrap_or_default();
    let mut words = first.split([',', ';', ' ', '\t']);
    Ok(words.any(|word| !word.is_empty() && word.parse::<f64>().is_err()))
}

/// The plan over the rows that the frames have in `table`.
pub(super) fn of_table(
    table: &Table,
    tolerance: Tolerance,
    query: &TraversePlan,
    reference: Option<&TraversePlan>,
) -> Result<TruthPlan, GroundTruthError> {
    let query_rows = rows_of(table, query)?;
    let reference_rows = reference.map(|plan| rows_of(table, plan)).transpose()?;
    let kind = match table.spots(tolerance.ordinals > 0)? {
        TableSpots::Spots(spots) => {
            let pick = |rows: &[usize]| rows.iter().map(|&row| spots[row].clone()).collect::<Vec<_>>();
            let query = pick(&query_rows);
            let reference = reference_rows.as_deref().map_or_else(|| query.clone(), pick);
            Kind::Spots { query, reference, tolerance }
        }
        TableSpots::Earlier { rows, is_scored } => {
            let references = reference_rows.as_deref().unwrap_or(&query_rows);
            Kind::Pairs(pairs(&mutual(&rows), &is_scored, &query_rows, references))
        }
    };
    Ok(TruthPlan { definition: definition(table, &kind), sha256: hash_of(table.path())?, kind })
}

/// For each row all rows of the same place, whichever of both names the other; sorted.
fn mutual(earlier: &[Vec<u32>]) -> Vec<Vec<u32>> {
    let mut mutual = earlier.to_vec();
    for (row, others) in (0_u32..).zip(earlier) {
        others.iter().for_each(|&other| mutual[other as usize].push(row));
    }
    mutual.iter_mut().for_each(|row| row.sort_unstable());
    mutual
}

/// Matching rows as matching frame numbers of the traverses that these rows make.
fn pairs(matching: &[Vec<u32>], is_scored: &[bool], queries: &[usize], references: &[usize]) -> Pairs {
    let number: HashMap<u32, u32> =
        (0..).zip(references).map(|(number, &row)| (row as u32, number)).collect();
    let numbers = |row: usize| {
        let mut numbers: Vec<u32> = matching[row].iter().filter_map(|row| number.get(row).copied()).collect();
        numbers.sort_unstable();
        numbers
    };
    let unsaid = (0..).zip(references).filter(|&(_, &row)| !is_scored[row]).map(|(number, _)| number);
    Pairs {
        matches: queries.iter().map(|&row| is_scored[row].then(|| numbers(row))).collect(),
        unsaid: unsaid.collect(),
        references: Some(references.len()),
    }
}

fn definition(table: &Table, kind: &Kind) -> String {
    let file = table.path().file_name().unwrap_or_default().to_string_lossy();
    let Kind::Spots { query, tolerance, .. } = kind else {
        return format!("the pairs in {file}");
    };
    match query.iter().find(|spot| **spot != Spot::Unscored) {
        Some(Spot::LapPhase(_)) => {
            format!("lap phases of {file} within {} % of a lap", 100.0 * tolerance.lap_share)
        }
        Some(Spot::Metres(_)) => format!("positions of {file} within {} m", tolerance.radius_metres),
        Some(Spot::Ordinal(_)) => format!("place numbers of {file} at most {} apart", tolerance.ordinals),
        _ => format!("a place in common in {file}"),
    }
}

/// The row of every frame of a traverse.
fn rows_of(table: &Table, plan: &TraversePlan) -> Result<Vec<usize>, GroundTruthError> {
    if let Some(rows) = &plan.table_rows {
        return Ok(rows.clone());
    }
    let Frames::Files(files) = &plan.frames else {
        let reason = format!("{} needs image files, and {} has none", table.path().display(), plan.name);
        return Err(GroundTruthError::Mismatch(reason));
    };
    let canonical = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let column = table.file_column(None)?;
    let row_of: HashMap<PathBuf, usize> =
        (0..).zip(table.files(column)?).map(|(row, file)| (canonical(&file), row)).collect();
    let rows: Vec<Option<usize>> = files.iter().map(|file| row_of.get(&canonical(file)).copied()).collect();
    let without: Vec<String> = files
        .iter()
        .zip(&rows)
        .filter(|(_, row)| row.is_none())
        .map(|(file, _)| file.file_name().unwrap_or_default().to_string_lossy().into_owned())
        .collect();
    if !without.is_empty() {
        let listed = without.iter().take(MAX_LISTED).cloned().collect::<Vec<_>>().join(", ");
        let reason = format!(
            "{} of the {} frames of {} have no row ({listed}…)",
            without.len(),
            files.len(),
            plan.name
        );
        return Err(GroundTruthError::malformed(table.path(), reason));
    }
    Ok(rows.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_hold_whichever_of_both_frames_names_the_other() {
        // Row 2 names row 0, row 3 names rows 1 and 2.
        let matching = mutual(&[vec![], vec![], vec![0], vec![1, 2]]);
        assert_eq!(matching, [vec![2], vec![3], vec![0, 3], vec![1, 2]]);
        let pairs = pairs(&matching, &[true, false, true, true], &[0, 1, 2], &[3, 1]);
        assert_eq!(pairs.matches, [Some(vec![]), None, Some(vec![0])]);
        assert_eq!(pairs.unsaid, [1], "row 1 is not scored");
    }

    #[test]
    fn a_first_line_of_numbers_makes_a_matrix_and_anything_else_a_table() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.csv");
        for (text, expected) in [
            ("0,1\n", false),
            ("1e-3, 2E5\n", false),
            ("\u{feff}0;1\r\n", false),
            ("file,place\n", true),
            ("7a\n", true),
        ] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(is_table(&path).unwrap(), expected, "{text:?}");
        }
    }
}
