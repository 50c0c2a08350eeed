//! Loop matrices: a row a query frame, a column a reference frame, not zero where both show the same
//! place. HTMap, iBoW-LCD and FAB-MAP publish them as MATLAB files, others as text or NumPy arrays;
//! VPR-Bench lists the reference frames of each query instead.

use std::path::Path;

use super::error::GroundTruthError;
use super::file;
use super::mat::{self, MatMatrix};
use super::npy::{self, Npy};

/// Most pairs of one place that a matrix may have: a hundred for each frame of the longest known sequences.
pub(super) const MAX_PAIRS: usize = 16 << 20;
/// What variables that hold the ground truth are called, in published files.
const NAMES: [&str; 5] = ["truth", "gt", "gt_loops", "groundtruth", "ground_truth"];

/// Which reference frames show the same place as each query frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoopMatrix {
    columns: Option<usize>,
    matches: Vec<Vec<u32>>,
}

impl LoopMatrix {
    /// Reads the matrix at `path`: `.txt` or `.csv` (numbers separated by spaces, tabs or commas), `.mat`
    /// or `.npy`.
    ///
    /// # Errors
    /// If it cannot be read or is none; the error says which rows.
    pub fn read(path: &Path) -> Result<Self, GroundTruthError> {
        let malformed = |reason: String| GroundTruthError::malformed(path, reason);
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        match extension.as_str() {
            "txt" | "csv" => Self::of_text(path, &file::read_text(path, file::MAX_MATRIX_BYTES)?),
            "mat" => {
                let bytes = file::read(path, file::MAX_MATRIX_BYTES)?;
                Self::of_mat(mat::read(&bytes).map_err(malformed)?).map_err(malformed)
            }
            "npy" => {
                let bytes = file::read(path, file::MAX_MATRIX_BYTES)?;
                Ok(match npy::read(&bytes).map_err(malformed)? {
                    Npy::Lists(matches) => Self { columns: None, matches },
                    Npy::Dense { columns, matches } => Self { columns: Some(columns), matches },
                })
            }
            _ => Err(malformed("no ground truth; it should be .csv, .txt, .mat or .npy".to_owned())),
        }
    }

    fn of_text(path: &Path, text: &str) -> Result<Self, GroundTruthError> {
        let (mut columns, mut pairs) = (None, 0);
        let (mut matches, mut wrong, mut ragged) = (Vec::new(), Vec::new(), Vec::new());
        for (line, text) in (1..).zip(text.lines()).filter(|(_, text)| !text.trim().is_empty()) {
            let Some((row, length)) = row_of_text(text) else {
                wrong.push(line);
                continue;
            };
            if *columns.get_or_insert(length) != length {
                ragged.push(line);
            }
            pairs += row.len();
            if pairs > MAX_PAIRS {
                return Err(GroundTruthError::malformed(path, too_many_pairs()));
            }
            matches.push(row);
        }
        let columns = columns.unwrap_or(0);
        if !wrong.is_empty() {
            Err(GroundTruthError::rows(path, wrong, "not all of it are numbers"))
        } else if columns == 0 {
            Err(GroundTruthError::malformed(path, "it holds no numbers"))
        } else if !ragged.is_empty() {
            Err(GroundTruthError::rows(path, ragged, format!("not {columns} numbers as in the first row")))
        } else {
            Ok(Self { columns: Some(columns), matches })
        }
    }

    fn of_mat(matrices: Vec<MatMatrix>) -> Result<Self, String> {
        let names: Vec<String> = matrices.iter().map(|matrix| matrix.name.clone()).collect();
        let mut candidates: Vec<MatMatrix> =
            matrices.into_iter().filter(|matrix| matrix.rows > 1 && matrix.columns > 1).collect();
        if candidates.len() > 1 {
            candidates.retain(|matrix| NAMES.contains(&matrix.name.to_ascii_lowercase().as_str()));
        }
        let [matrix] = candidates.as_mut_slice() else {
            return Err(format!(
                "which of its variables is the loop matrix? It has {}; call it truth",
                if names.is_empty() { "no matrix".to_owned() } else { names.join(", ") }
            ));
        };
        let mut matches = vec![Vec::new(); matrix.rows];
        let nonzero = std::mem::replace(&mut matrix.nonzero, Ok(Vec::new()));
        for (row, column) in nonzero.map_err(|reason| format!("{}: {reason}", matrix.name))? {
            matches[row as usize].push(column);
        }
        matches.iter_mut().for_each(|row| row.sort_unstable());
        Ok(Self { columns: Some(matrix.columns), matches })
    }

    /// Number of query frames.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.matches.len()
    }

    /// Number of reference frames, unless only matches are listed.
    #[must_use]
    pub fn columns(&self) -> Option<usize> {
        self.columns
    }

    /// The reference frames that show the same place as query frame `row`; sorted.
    #[must_use]
    pub fn matches(&self, row: usize) -> &[u32] {
        self.matches.get(row).map_or(&[], Vec::as_slice)
    }

    /// The matrix of every second frame, from `first` (0 or 1) on: where two cameras take turns.
    #[must_use]
    pub fn every_second(&self, first: u32) -> Self {
        let row = |row: &Vec<u32>| {
            row.iter().filter(|&&column| column % 2 == first).map(|column| column / 2).collect()
        };
        let matches = self.matches.iter().skip(first as usize).step_by(2).map(row).collect();
        let columns = self.columns.map(|columns| columns.saturating_sub(first as usize).div_ceil(2));
        Self { columns, matches }
    }
}

/// The columns of a line that are not zero, and how many numbers it has; `None` if not all are numbers.
fn row_of_text(text: &str) -> Option<(Vec<u32>, usize)> {
    let (mut row, mut length) = (Vec::new(), 0);
    for word in text.split([' ', '\t', ',', ';']).filter(|word| !word.is_empty()) {
        let number = word.parse::<f64>().ok().filter(|number| number.is_finite())?;
        if number != 0.0 {
            row.push(u32::try_from(length).ok()?);
        }
        length += 1;
    }
    Some((row, length))
}

pub(super) fn too_many_pairs() -> String {
    format!("it has more than {MAX_PAIRS} pairs of one place; is it the right matrix?")
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn read(name: &str, content: &str) -> Result<LoopMatrix, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        fs::write(&path, content).unwrap();
        let shown = path.display().to_string();
        LoopMatrix::read(&path).map_err(|error| error.to_string().replace(&shown, name))
    }

    fn fixture(name: &str) -> Result<LoopMatrix, String> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/ground_truth");
        LoopMatrix::read(&folder.join(name)).map_err(|error| error.to_string())
    }

    #[test]
    fn text_is_read_however_it_is_separated() {
        for text in [
            "\u{feff}0 0 1\n1 0 0\n",
            "0 0 1\n1 0 0\n",
            "0,0,1\n1,0,0",
            "0\t0\t1\r\n1\t0\t0\r\n\n",
            "0.0 0 2e0\n1 0 0\n",
        ] {
            let matrix = read("loops.txt", text).unwrap();
            assert_eq!((matrix.rows(), matrix.columns()), (2, Some(3)), "{text:?}");
            assert_eq!([matrix.matches(0), matrix.matches(1), matrix.matches(2)], [&[2][..], &[0], &[]]);
        }
    }

    #[test]
    fn rows_that_are_wrong_are_named_by_their_lines() {
        assert_eq!(
            read("m.csv", "0,1\n1,x\n\n1,nan\n").unwrap_err(),
            "m.csv, rows 2, 4: not all of it are numbers"
        );
        assert_eq!(
            read("m.txt", "0 1\n1 0 1\n").unwrap_err(),
            "m.txt, row 2: not 2 numbers as in the first row"
        );
        assert_eq!(read("m.txt", "\n").unwrap_err(), "m.txt: it holds no numbers");
        assert!(read("m.xls", "0").unwrap_err().contains(".csv, .txt, .mat or .npy"));
    }

    #[test]
    fn matlab_and_numpy_files_hold_the_same_matrix() {
        let truth = fixture("double.mat").unwrap();
        assert_eq!((truth.rows(), truth.columns()), (4, Some(5)));
        assert_eq!([truth.matches(0), truth.matches(2), truth.matches(3)], [&[4][..], &[0], &[0, 1]]);
        for name in ["packed.mat", "logical.mat", "sparse.mat", "uint8.mat", "named.mat"] {
            assert_eq!(fixture(name).as_ref(), Ok(&truth), "{name}");
        }
        let lists = fixture("lists.npy").unwrap();
        assert_eq!((lists.rows(), lists.columns(), lists.matches(1)), (3, None, &[1, 2][..]));
        let message = fixture("nan.npy").unwrap_err();
        assert!(message.contains("query frame 1, counted from 0, has a NaN"), "{message}");
        let message = fixture("nan.mat").unwrap_err();
        assert!(message.contains("query frame 2, counted from 0, has a NaN"), "{message}");
        let message = fixture("several.mat").unwrap_err();
        assert!(message.contains("It has here, there; call it truth"), "{message}");
    }

    #[test]
    fn of_two_cameras_that_take_turns_one_is_kept() {
        let matrix = read("m.txt", "0 0 0 0 0\n0 0 0 0 0\n1 0 0 0 0\n0 1 0 0 0\n1 1 0 0 0\n").unwrap();
        let (left, right) = (matrix.every_second(0), matrix.every_second(1));
        assert_eq!(
            (left.rows(), left.columns(), left.matches(1), left.matches(2)),
            (3, Some(3), &[0][..], &[0][..])
        );
        assert_eq!((right.rows(), right.columns(), right.matches(1)), (2, Some(2), &[0][..]));
    }
}
