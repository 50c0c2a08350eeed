//! Matrices from MATLAB 5 files (`save -v7` and older), as loop closure data sets publish their ground
//! truth: full or sparse, of any numeric class or logical, compressed or not.
//!
//! Read here rather than by the crate `matfile`, which leaves sparse matrices out and bounds nothing.
//! Format: MathWorks, *MAT-File Format*, level 5.

use std::io::Read;

use flate2::read::ZlibDecoder;

/// Most bytes that one compressed variable may unpack to.
const MAX_UNPACKED_BYTES: u64 = 1 << 30;
const HEADER_BYTES: usize = 128;
const TYPE_MATRIX: u32 = 14;
const TYPE_COMPRESSED: u32 = 15;
const CLASS_SPARSE: u8 = 5;

/// A variable that is a matrix of numbers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MatMatrix {
    /// Its name.
    pub(super) name: String,
    /// Number of rows.
    pub(super) rows: usize,
    /// Number of columns.
    pub(super) columns: usize,
    /// Row and column of every element that is not zero, by columns.
    pub(super) nonzero: Vec<(u32, u32)>,
    /// The elements by columns, where they were all stored.
    pub(super) dense: Option<Vec<f64>>,
}

/// The matrices in the bytes of a file; other variables are left out.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<MatMatrix>, String> {
    if bytes.starts_with(b"MATLAB 7.3") || bytes.get(..4) == Some(b"\x89HDF") {
        return Err("it is a MATLAB 7.3 (HDF5) file; save it again with -v7".to_owned());
    }
    let header = bytes.get(..HEADER_BYTES).ok_or("it is too short for a MATLAB file")?;
    let endian = match &header[126..] {
        b"IM" => Endian::Little,
        b"MI" => Endian::Big,
        _ => return Err("it is no MATLAB 5 file; save it with -v7".to_owned()),
    };
    let mut matrices = Vec::new();
    let mut rest = Elements { bytes: &bytes[HEADER_BYTES..], endian };
    while let Some(element) = rest.next()? {
        match element.kind {
            TYPE_MATRIX => matrices.extend(matrix(element.bytes, endian)?),
            TYPE_COMPRESSED => {
                let mut unpacked = Vec::new();
                let decoder = ZlibDecoder::new(element.bytes).take(MAX_UNPACKED_BYTES + 1);
                let mut decoder = decoder;
                decoder
                    .read_to_end(&mut unpacked)
                    .map_err(|error| format!("a variable cannot be unpacked: {error}"))?;
                if unpacked.len() as u64 > MAX_UNPACKED_BYTES {
                    return Err(format!("a variable unpacks to more than {MAX_UNPACKED_BYTES} bytes"));
                }
                let mut inside = Elements { bytes: &unpacked, endian };
                if let Some(element) = inside.next()?.filter(|element| element.kind == TYPE_MATRIX) {
                    matrices.extend(matrix(element.bytes, endian)?);
                }
            }
            _ => {}
        }
    }
    Ok(matrices)
}

#[derive(Clone, Copy)]
enum Endian {
    Little,
    Big,
}

impl Endian {
    /// The number in at most 8 bytes.
    fn unsigned(self, bytes: &[u8]) -> u64 {
        let fold = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        match self {
            Self::Little => bytes.iter().rev().fold(0, fold),
            Self::Big => bytes.iter().fold(0, fold),
        }
    }
}

struct Element<'a> {
    kind: u32,
    bytes: &'a [u8],
}

/// Data elements, one after the other.
struct Elements<'a> {
    bytes: &'a [u8],
    endian: Endian,
}

impl<'a> Elements<'a> {
    fn next(&mut self) -> Result<Option<Element<'a>>, String> {
        if self.bytes.is_empty() {
            return Ok(None);
        }
        let torn = || "a data element is torn".to_owned();
        let word = |at: usize| self.bytes.get(at..at + 4).map(|word| self.endian.unsigned(word) as u32);
        let first = word(0).ok_or_else(torn)?;
        // Up to four bytes stand in the tag itself, their number in its upper half.
        let (kind, start, length, padded) = match first >> 16 {
            0 => {
                let length = word(4).ok_or_else(torn)? as usize;
                let padded = if first == TYPE_COMPRESSED { length } else { length.next_multiple_of(8) };
                (first, 8, length, 8 + padded)
            }
            small => (first & 0xFFFF, 4, small as usize, 8),
        };
        let bytes = self.bytes.get(start..start + length).ok_or_else(torn)?;
        self.bytes = self.bytes.get(padded..).unwrap_or_default();
        Ok(Some(Element { kind, bytes }))
    }

    fn expect(&mut self) -> Result<Element<'a>, String> {
        self.next()?.ok_or_else(|| "a matrix is torn".to_owned())
    }
}

/// The numbers of an element of a numeric type.
fn numbers(element: &Element<'_>, endian: Endian) -> Result<Vec<f64>, String> {
    let of = |width: usize, convert: fn(u64) -> f64| -> Vec<f64> {
        element.bytes.chunks_exact(width).map(|bytes| convert(endian.unsigned(bytes))).collect()
    };
    Ok(match element.kind {
        1 => of(1, |bits| f64::from(bits as u8 as i8)),
        2 => of(1, |bits| bits as f64),
        3 => of(2, |bits| f64::from(bits as u16 as i16)),
        4 => of(2, |bits| bits as f64),
        5 => of(4, |bits| f64::from(bits as u32 as i32)),
        6 => of(4, |bits| bits as f64),
        7 => of(4, |bits| f64::from(f32::from_bits(bits as u32))),
        9 => of(8, f64::from_bits),
        12 => of(8, |bits| bits as i64 as f64),
        13 => of(8, |bits| bits as f64),
        other => return Err(format!("data of type {other} are not numbers")),
    })
}

/// The matrix in an element's bytes; `None` for variables of another class or with more dimensions.
fn matrix(bytes: &[u8], endian: Endian) -> Result<Option<MatMatrix>, String> {
    let mut parts = Elements { bytes, endian };
    let flags = parts.expect()?;
    let class = endian.unsigned(flags.bytes.get(..4).ok_or("a matrix is torn")?) as u8;
    // Cells, structures, objects and text are no matrices of numbers.
    if !(CLASS_SPARSE..=15).contains(&class) {
        return Ok(None);
    }
    let sizes = numbers(&parts.expect()?, endian)?;
    let &[rows, columns] = sizes.as_slice() else { return Ok(None) };
    let size = |size: f64| (0.0..=f64::from(u32::MAX)).contains(&size).then_some(size as usize);
    let (rows, columns) = size(rows).zip(size(columns)).ok_or("a matrix has an impossible size")?;
    let name = String::from_utf8_lossy(parts.expect()?.bytes).into_owned();
    let (nonzero, dense) = if class == CLASS_SPARSE {
        let (row_indices, column_starts) =
            (numbers(&parts.expect()?, endian)?, numbers(&parts.expect()?, endian)?);
        let values = numbers(&parts.expect()?, endian)?;
        (
            sparse(&row_indices, &column_starts, &values, (rows, columns))
                .map_err(|reason| format!("{name} {reason}"))?,
            None,
        )
    } else {
        let values = numbers(&parts.expect()?, endian)?;
        if Some(values.len()) != rows.checked_mul(columns) {
            return Err(format!("{name} has {} elements, not {rows} × {columns}", values.len()));
        }
        (positions(&values, rows), Some(values))
    };
    Ok(Some(MatMatrix { name, rows, columns, nonzero, dense }))
}

fn positions(values: &[f64], rows: usize) -> Vec<(u32, u32)> {
    let nonzero = values.iter().enumerate().filter(|(_, value)| **value != 0.0);
    nonzero.map(|(index, _)| ((index % rows) as u32, (index / rows) as u32)).collect()
}

/// The positions of a sparse matrix: rows of all elements, and for each column where its own begin.
fn sparse(
    row_indices: &[f64],
    column_starts: &[f64],
    values: &[f64],
    (rows, columns): (usize, usize),
) -> Result<Vec<(u32, u32)>, String> {
    if column_starts.len() != columns + 1 || column_starts.windows(2).any(|pair| pair[0] > pair[1]) {
        return Err("has no start for every column".to_owned());
    }
    let mut nonzero = Vec::new();
    for (column, bounds) in column_starts.windows(2).enumerate() {
        let (first, last) = (bounds[0] as usize, bounds[1] as usize);
        let indices = row_indices.get(first..last).ok_or("has a column that reaches beyond its elements")?;
        for (offset, &row) in indices.iter().enumerate() {
            if row < 0.0 || row as usize >= rows {
                return Err(format!("has an element in row {row} of {rows}"));
            }
            // A pattern without values counts as all ones.
            if values.get(first + offset).is_none_or(|value| *value != 0.0) {
                nonzero.push((row as u32, column as u32));
            }
        }
    }
    Ok(nonzero)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fixture(name: &str) -> Vec<u8> {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/ground_truth/");
        std::fs::read(format!("{folder}{name}")).unwrap()
    }

    /// What `make.py` stores in every file: 4 × 5, with these elements other than zero.
    const NONZERO: [(u32, u32); 4] = [(2, 0), (3, 0), (3, 1), (0, 4)];

    #[test]
    fn full_and_sparse_matrices_of_every_class_are_read_packed_or_not() {
        for name in ["double.mat", "packed.mat", "logical.mat", "sparse.mat", "uint8.mat"] {
            let matrices = read(&fixture(name)).unwrap();
            let truth = matrices.iter().find(|matrix| matrix.name == "truth").expect(name);
            assert_eq!((truth.rows, truth.columns), (4, 5), "{name}");
            let mut nonzero = truth.nonzero.clone();
            nonzero.sort_by_key(|&(row, column)| (column, row));
            assert_eq!(nonzero, NONZERO, "{name}");
        }
    }

    #[test]
    fn a_file_of_another_format_is_refused_with_the_fix() {
        assert!(read(b"MATLAB 7.3 MAT-file, Platform").unwrap_err().contains("save it again with -v7"));
        assert!(read(&[0; 200]).unwrap_err().contains("no MATLAB 5 file"));
        assert!(read(b"short").unwrap_err().contains("too short"));
    }

    proptest! {
        #[test]
        fn damaged_files_are_refused_or_read_but_never_panic(
            name in prop_oneof![Just("double.mat"), Just("sparse.mat"), Just("packed.mat")],
            flips in proptest::collection::vec((0..2000_usize, any::<u8>()), 1..6),
            length in 0..2000_usize,
        ) {
            let mut bytes = fixture(name);
            for (at, value) in flips {
                let at = at % bytes.len();
                bytes[at] ^= value;
            }
            bytes.truncate(length.max(130));
            let _ = read(&bytes);
        }
    }
}
