//! Matrices from MATLAB 5 files (`save -v7` and older), as loop closure data sets publish their ground
//! truth: full or sparse, of any numeric class or logical, compressed or not.
//!
//! Read here rather than by the crate `matfile`, which leaves sparse matrices out and bounds nothing.
//! Format: MathWorks, *MAT-File Format*, level 5.

use std::io::Read;

use flate2::read::ZlibDecoder;

use super::loop_matrix::{MAX_PAIRS, too_many_pairs};

/// Most bytes that all compressed variables of a file together may unpack to.
const MAX_UNPACKED_BYTES: u64 = 512 << 20;
/// Most rows or columns of a matrix: a million frames.
const MAX_FRAMES: usize = 1 << 20;
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
    /// Row and column of every element that is not zero, by columns; or why it is no loop matrix.
    pub(super) nonzero: Result<Vec<(u32, u32)>, String>,
    /// The elements by columns, of a full matrix of two rows or columns.
    pub(super) pairs: Option<Vec<f64>>,
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
    let mut unpacked_left = MAX_UNPACKED_BYTES;
    let mut rest = Elements { bytes: &bytes[HEADER_BYTES..], endian };
    while let Some(element) = rest.next()? {
        match element.kind {
            TYPE_MATRIX => matrices.extend(matrix(element.bytes, endian)?),
            TYPE_COMPRESSED => {
                let unpacked = unpack(element.bytes, unpacked_left)?;
                unpacked_left -= unpacked.len() as u64;
                let mut inside = Elements { bytes: &unpacked, endian };
                if let Some(element) = inside.next()?.filter(|element| element.kind == TYPE_MATRIX) {
                    matrices.extend(matrix(element.bytes, endian)?);
                }
            }
            _ => {}
        }
        let pairs = matrices.iter().filter_map(|matrix| matrix.nonzero.as_ref().ok()).map(Vec::len);
        if pairs.sum::<usize>() > MAX_PAIRS {
            return Err(too_many_pairs());
        }
    }
    Ok(matrices)
}

/// What a compressed variable unpacks to, if that is not more than `most_bytes`.
fn unpack(bytes: &[u8], most_bytes: u64) -> Result<Vec<u8>, String> {
    let mut unpacked = Vec::new();
    ZlibDecoder::new(bytes)
        .take(most_bytes + 1)
        .read_to_end(&mut unpacked)
        .map_err(|error| format!("a variable cannot be unpacked: {error}"))?;
    if unpacked.len() as u64 > most_bytes {
        let most = MAX_UNPACKED_BYTES >> 20;
        return Err(format!("it unpacks to more than {most} MiB; save the loop matrix alone"));
    }
    Ok(unpacked)
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

/// The numbers of an element, converted one by one: all at once they may take eight times its bytes.
#[derive(Clone, Copy)]
struct Numbers<'a> {
    bytes: &'a [u8],
    endian: Endian,
    width: usize,
    convert: fn(u64) -> f64,
}

impl<'a> Numbers<'a> {
    fn of(element: &Element<'a>, endian: Endian) -> Result<Self, String> {
        let (width, convert): (usize, fn(u64) -> f64) = match element.kind {
            1 => (1, |bits| f64::from(bits as u8 as i8)),
            2 => (1, |bits| bits as f64),
            3 => (2, |bits| f64::from(bits as u16 as i16)),
            4 => (2, |bits| bits as f64),
            5 => (4, |bits| f64::from(bits as u32 as i32)),
            6 => (4, |bits| bits as f64),
            7 => (4, |bits| f64::from(f32::from_bits(bits as u32))),
            9 => (8, f64::from_bits),
            12 => (8, |bits| bits as i64 as f64),
            13 => (8, |bits| bits as f64),
            other => return Err(format!("data of type {other} are not numbers")),
        };
        Ok(Self { bytes: element.bytes, endian, width, convert })
    }

    fn len(&self) -> usize {
        self.bytes.len() / self.width
    }

    fn get(&self, index: usize) -> Option<f64> {
        let start = index.checked_mul(self.width)?;
        let bytes = self.bytes.get(start..start.checked_add(self.width)?)?;
        Some((self.convert)(self.endian.unsigned(bytes)))
    }

    fn iter(self) -> impl Iterator<Item = f64> + 'a {
        self.bytes.chunks_exact(self.width).map(move |bytes| (self.convert)(self.endian.unsigned(bytes)))
    }
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
    let sizes: Vec<f64> = Numbers::of(&parts.expect()?, endian)?.iter().take(3).collect();
    let &[rows, columns] = sizes.as_slice() else { return Ok(None) };
    let size = |size: f64| (0.0..=MAX_FRAMES as f64).contains(&size).then_some(size as usize);
    let name = String::from_utf8_lossy(parts.expect()?.bytes).into_owned();
    let too_large = || format!("{name} has {rows} × {columns} elements, more than {MAX_FRAMES} in a row");
    let (rows, columns) = size(rows).zip(size(columns)).ok_or_else(too_large)?;
    let mut numbers = || Numbers::of(&parts.expect()?, endian);
    if class == CLASS_SPARSE {
        let (row_indices, column_starts, values) = (numbers()?, numbers()?, numbers()?);
        let nonzero = sparse(row_indices, column_starts, values, (rows, columns));
        return Ok(Some(MatMatrix { name, rows, columns, nonzero, pairs: None }));
    }
    let values = numbers()?;
    if Some(values.len()) != rows.checked_mul(columns) {
        return Err(format!("{name} has {} elements, not {rows} × {columns}", values.len()));
    }
    let has_pairs = rows == 2 || columns == 2;
    let pairs = has_pairs.then(|| values.iter().collect());
    Ok(Some(MatMatrix { name, rows, columns, nonzero: positions(values, rows), pairs }))
}

fn positions(values: Numbers<'_>, rows: usize) -> Result<Vec<(u32, u32)>, String> {
    let mut nonzero = Vec::new();
    for (index, value) in values.iter().enumerate().filter(|(_, value)| *value != 0.0) {
        push(&mut nonzero, ((index % rows) as u32, (index / rows) as u32), value)?;
    }
    Ok(nonzero)
}

fn push(nonzero: &mut Vec<(u32, u32)>, at: (u32, u32), value: f64) -> Result<(), String> {
    if value.is_nan() {
        return Err(format!("query frame {}, counted from 0, has a NaN; it should have 0 or 1", at.0));
    }
    if nonzero.len() == MAX_PAIRS {
        return Err(too_many_pairs());
    }
    nonzero.push(at);
    Ok(())
}

/// The positions of a sparse matrix: rows of all elements, and for each column where its own begin.
fn sparse(
    row_indices: Numbers<'_>,
    column_starts: Numbers<'_>,
    values: Numbers<'_>,
    (rows, columns): (usize, usize),
) -> Result<Vec<(u32, u32)>, String> {
    if column_starts.len() != columns + 1 {
        return Err("it has no start for every column".to_owned());
    }
    let mut nonzero = Vec::new();
    for (column, (first, last)) in column_starts.iter().zip(column_starts.iter().skip(1)).enumerate() {
        if !(0.0 <= first && first <= last && last <= row_indices.len() as f64) {
            return Err(format!("column {column} reaches beyond its elements"));
        }
        for element in first as usize..last as usize {
            let row = row_indices.get(element).filter(|row| (0.0..rows as f64).contains(row));
            let row =
                row.ok_or_else(|| format!("column {column} has an element in none of the {rows} rows"))?;
            // A pattern without values counts as all ones.
            let value = values.get(element).unwrap_or(1.0);
            if value != 0.0 {
                push(&mut nonzero, (row as u32, column as u32), value)?;
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
            let mut nonzero = truth.nonzero.clone().unwrap();
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

    #[test]
    fn a_small_file_that_unpacks_to_a_large_one_is_given_up() {
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
        std::io::Write::write_all(&mut encoder, &[0; 1000]).unwrap();
        let packed = encoder.finish().unwrap();
        assert_eq!(unpack(&packed, 1000).unwrap(), [0; 1000]);
        assert!(unpack(&packed, 999).unwrap_err().contains("save the loop matrix alone"));
    }

    #[test]
    fn a_sparse_matrix_of_more_frames_than_there_are_is_refused() {
        let mut bytes = fixture("sparse.mat");
        // Eight bytes of sizes: 4 × 5.
        let sizes = [8, 0, 0, 0, 4, 0, 0, 0, 5, 0, 0, 0];
        let at = 4 + bytes.windows(12).position(|window| window == sizes).expect("its sizes");
        bytes[at..at + 4].copy_from_slice(&0x7FFF_FFFF_u32.to_le_bytes());
        assert!(read(&bytes).unwrap_err().contains("2147483647 × 5 elements, more than 1048576 in a row"));
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
