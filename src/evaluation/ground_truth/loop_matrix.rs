//! Loop matrices: a row a query frame, a column a reference frame, not zero where both show the same
//! place. HTMap, iBoW-LCD and FAB-MAP publish them as MATLAB files, others as text or NumPy arrays;
//! VPR-Bench lists the reference frames of each query instead.
//!
//! Matrices are mostly zeros: only the matching columns of each row are ever kept.

use std::collections::BTreeSet;
use std::path::Path;

use super::error::{Fault, GroundTruthError, Rows, listed};
use super::file::{self, MAX_BINARY_BYTES, MAX_FRAMES, MAX_PAIRS};
use super::mat::{MatFile, MatMatrix};
use super::npy::{self, Npy};

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
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let read = match extension.as_str() {
            "txt" | "csv" => Self::of_text(&file::read_text(path)?),
            "mat" => Self::of_mat(&file::read(path, MAX_BINARY_BYTES)?),
            "npy" => Self::of_npy(&file::read(path, MAX_BINARY_BYTES)?),
            _ => Err("no ground truth; it should be .csv, .txt, .mat or .npy".into()),
        };
        read.map_err(|fault| fault.at(path))
    }

    fn of_text(text: &str) -> Result<Self, Fault> {
        let mut matches = Matches::default();
        let (mut columns, mut wrong, mut ragged) = (None, Vec::new(), Vec::new());
        for (line, text) in (1..).zip(text.lines()).filter(|(_, text)| !text.trim().is_empty()) {
            let row = matches.begin_row()?;
            let mut found = 0;
            for word in text.split([' ', '\t', ',', ';']).filter(|word| !word.is_empty()) {
                match word.parse::<f64>().ok().filter(|number| number.is_finite()) {
                    Some(number) => matches.add(row, found, number)?,
                    None if wrong.last() == Some(&line) => {}
                    None => wrong.push(line),
                }
                found += 1;
            }
            if found != *columns.get_or_insert(found) {
                ragged.push(line);
            }
        }
        if !wrong.is_empty() {
            return Err(Fault::of(Rows::Lines(wrong), "not all of it are numbers"));
        }
        let columns = columns.filter(|&columns| columns > 0).ok_or("it holds no numbers")?;
        if !ragged.is_empty() {
            let reason = format!("not {columns} numbers as in the first row");
            return Err(Fault::of(Rows::Lines(ragged), reason));
        }
        matches.into_matrix(columns as usize)
    }

    fn of_npy(bytes: &[u8]) -> Result<Self, Fault> {
        let dense = match npy::read(bytes)? {
            Npy::Lists(matches) => return Ok(Self { columns: None, matches }),
            Npy::Dense(dense) => dense,
        };
        let mut matches = Matches::default();
        for numbers in dense.rows() {
            let row = matches.begin_row()?;
            for (column, number) in (0..).zip(numbers) {
                matches.add(row, column, number)?;
            }
        }
        matches.into_matrix(dense.columns)
    }

    fn of_mat(bytes: &[u8]) -> Result<Self, Fault> {
        let file = MatFile::read(bytes)?;
        let matrices = file.matrices()?;
        let names: Vec<&str> = matrices.iter().map(|matrix| matrix.name.as_str()).collect();
        let mut candidates: Vec<&MatMatrix<'_>> =
            matrices.iter().filter(|matrix| matrix.rows > 1 && matrix.columns > 1).collect();
        if candidates.len() > 1 {
            candidates.retain(|matrix| NAMES.contains(&matrix.name.to_ascii_lowercase().as_str()));
        }
        let [matrix] = candidates.as_slice() else {
            return Err(Fault::from(format!(
                "which of its variables is the loop matrix? It has {}; call it truth",
                if names.is_empty() { "no matrix".to_owned() } else { listed(&names) }
            )));
        };
        let mut matches = Matches::default();
        for _ in 0..matrix.rows {
            matches.begin_row()?;
        }
        matrix.try_for_each(|row, column, value| matches.add(row, column, value))?;
        matches.into_matrix(matrix.columns)
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

/// A loop matrix that is being read, element by element.
struct Matches {
    rows: Vec<Vec<u32>>,
    /// How many more pairs it may have.
    pairs_left: usize,
    /// Rows with elements that are no finite numbers.
    wrong: BTreeSet<u64>,
}

impl Default for Matches {
    fn default() -> Self {
        Self { rows: Vec::new(), pairs_left: MAX_PAIRS, wrong: BTreeSet::new() }
    }
}

impl Matches {
    /// Adds an empty row and says its number.
    fn begin_row(&mut self) -> Result<u32, Fault> {
        if self.rows.len() == MAX_FRAMES {
            return Err(file::too_many_frames().into());
        }
        self.rows.push(Vec::new());
        Ok(self.rows.len() as u32 - 1)
    }

    /// Adds an element; those of a row must come by ascending columns.
    fn add(&mut self, row: u32, column: u32, value: f64) -> Result<(), Fault> {
        if value == 0.0 {
            return Ok(());
        }
        if !value.is_finite() {
            self.wrong.insert(row.into());
            return Ok(());
        }
        let row = &mut self.rows[row as usize];
        // A sparse matrix may hold an element twice.
        if row.last() != Some(&column) {
            self.pairs_left = self.pairs_left.checked_sub(1).ok_or_else(file::too_many_pairs)?;
            row.push(column);
        }
        Ok(())
    }

    fn into_matrix(self, columns: usize) -> Result<LoopMatrix, Fault> {
        if self.wrong.is_empty() {
            return Ok(LoopMatrix { columns: Some(columns), matches: self.rows });
        }
        let rows = Rows::Queries(self.wrong.into_iter().collect());
        Err(Fault::of(rows, "not all of it are numbers; write 0 or 1 instead of NaN and infinity"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::fs;

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
        for text in ["0 0 1\n1 0 0\n", "0,0,1\n1,0,0", "0\t0\t1\r\n1\t0\t0\r\n\n", "0.0 0 2e0\n1 0 0\n"] {
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

    #[test]
    fn a_byte_order_mark_is_no_part_of_the_first_number() {
        let matrix = read("m.txt", "\u{feff}0 1\r\n1 0\r\n").unwrap();
        assert_eq!([matrix.matches(0), matrix.matches(1)], [&[1][..], &[0]]);
    }

    /// A `.npy` file of a matrix of doubles.
    fn npy(rows: &[Vec<f64>]) -> Vec<u8> {
        let shape = (rows.len(), rows[0].len());
        let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape:?}, }}\n");
        let body = rows.iter().flatten().flat_map(|number| number.to_le_bytes());
        let header = [&b"\x93NUMPY\x01\0"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes()];
        header.concat().into_iter().chain(body).collect()
    }

    /// A `.mat` file of a matrix of doubles.
    fn mat(rows: &[Vec<f64>]) -> Vec<u8> {
        let columns = rows[0].len();
        let by_columns = (0..columns).flat_map(|column| rows.iter().map(move |row| row[column]));
        let numbers: Vec<u8> = by_columns.flat_map(f64::to_le_bytes).collect();
        let words = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
        let parts = [
            words(&[6, 8, 6, 0]),
            words(&[5, 8, rows.len() as u32, columns as u32]),
            words(&[1, 2, u32::from(b'g') | u32::from(b't') << 8, 0]),
            words(&[9, numbers.len() as u32]),
            numbers,
        ];
        let matrix = parts.concat();
        [vec![b' '; 126], b"IM".to_vec(), words(&[14, matrix.len() as u32]), matrix].concat()
    }

    #[test]
    fn what_is_no_finite_number_is_no_loop() {
        let message = |fault: Fault| fault.at(Path::new("m")).to_string();
        let rows = vec![vec![0.0, f64::NAN, f64::NAN], vec![1.0, 0.0, 0.0], vec![0.0, f64::INFINITY, 0.0]];
        let expected = "m, query frames 0, 2 (counted from 0): not all of it are numbers; write 0 or 1 \
                        instead of NaN and infinity";
        assert_eq!(message(LoopMatrix::of_npy(&npy(&rows)).unwrap_err()), expected);
        assert_eq!(message(LoopMatrix::of_mat(&mat(&rows)).unwrap_err()), expected);
    }

    #[test]
    fn pairs_and_frames_have_a_bound() {
        let mut matches = Matches { pairs_left: 2, ..Matches::default() };
        let row = matches.begin_row().unwrap();
        for (column, value) in [(0, 1.0), (1, 0.0), (2, 1.0), (2, 1.0)] {
            assert_eq!(matches.add(row, column, value), Ok(()), "column {column}");
        }
        assert_eq!(matches.add(row, 3, 1.0), Err(file::too_many_pairs().into()));
        let text = "0\n".repeat(MAX_FRAMES + 1);
        assert_eq!(LoopMatrix::of_text(&text), Err(file::too_many_frames().into()));
    }

    proptest! {
        #[test]
        fn text_matlab_and_numpy_agree_with_the_matrix_that_was_written(
            rows in (2..6_usize, 2..6_usize).prop_flat_map(|(rows, columns)| {
                let number = prop_oneof![Just(0.0), Just(1.0), Just(-0.0), Just(0.5)];
                proptest::collection::vec(proptest::collection::vec(number, columns), rows)
            }),
        ) {
            let matches = |row: &Vec<f64>| (0..).zip(row).filter(|(_, v)| **v != 0.0).map(|(c, _)| c).collect();
            let expected =
                LoopMatrix { columns: Some(rows[0].len()), matches: rows.iter().map(matches).collect() };
            let line = |row: &Vec<f64>| row.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
            let text = rows.iter().map(line).collect::<Vec<_>>().join("\n");
            prop_assert_eq!(LoopMatrix::of_text(&text), Ok(expected.clone()));
            prop_assert_eq!(LoopMatrix::of_npy(&npy(&rows)), Ok(expected.clone()));
            prop_assert_eq!(LoopMatrix::of_mat(&mat(&rows)), Ok(expected));
        }

        #[test]
        fn text_that_is_no_matrix_never_panics(text in "[0-9a.,; \t\r\n-]{0,60}") {
            let _ = LoopMatrix::of_text(&text);
        }
    }
}
