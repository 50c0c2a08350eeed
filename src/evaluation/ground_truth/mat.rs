//! Matrices from MATLAB 5 files (`save -v7` and older), as loop closure data sets publish their ground
//! truth: full or sparse, of any numeric class or logical, compressed or not.
//!
//! Read here rather than by the crate `matfile`, which leaves sparse matrices out and bounds nothing.
//! Numbers stay as they are stored until they are asked for: a few bytes may stand for very many.
//! Format: MathWorks, *MAT-File Format*, level 5.

use std::io::Read;

use flate2::read::ZlibDecoder;

/// Most bytes that all compressed variables of a file together may unpack to.
const MAX_UNPACKED_BYTES: u64 = 256 << 20;
/// Most variables in a file.
const MAX_VARIABLES: usize = 10_000;
const HEADER_BYTES: usize = 128;
const TYPE_MATRIX: u32 = 14;
const TYPE_COMPRESSED: u32 = 15;
const CLASS_SPARSE: u8 = 5;
/// Longest element that stands in its tag.
const MAX_SMALL_BYTES: u32 = 4;

/// The variables of a file, unpacked.
pub(super) struct MatFile<'a> {
    endian: Endian,
    variables: Vec<Variable<'a>>,
}

enum Variable<'a> {
    /// The bytes of a matrix.
    Plain(&'a [u8]),
    /// A data element.
    Unpacked(Vec<u8>),
}

/// A variable that is a matrix of numbers.
pub(super) struct MatMatrix<'a> {
    /// Its name.
    pub(super) name: String,
    /// Number of rows.
    pub(super) rows: usize,
    /// Number of columns.
    pub(super) columns: usize,
    elements: Elements<'a>,
}

enum Elements<'a> {
    /// All of them, by columns.
    Full(Numbers<'a>),
    Sparse(Sparse<'a>),
}

impl<'a> MatFile<'a> {
    /// Reads the bytes of a file.
    pub(super) fn read(bytes: &'a [u8]) -> Result<Self, String> {
        Self::read_within(bytes, MAX_UNPACKED_BYTES)
    }

    /// Reads the bytes of a file whose compressed variables may unpack to `most_bytes`.
    fn read_within(bytes: &'a [u8], most_bytes: u64) -> Result<Self, String> {
        let endian = endian(bytes)?;
        let mut bytes_left = most_bytes;
        let mut variables = Vec::new();
        let mut rest = Parts { bytes: &bytes[HEADER_BYTES..], endian };
        while let Some(part) = rest.next()? {
            match part.kind {
                TYPE_MATRIX => variables.push(Variable::Plain(part.bytes)),
                TYPE_COMPRESSED => {
                    let unpacked = unpack(part.bytes, bytes_left)?.ok_or_else(|| {
                        format!(
                            "its variables unpack to more than {most_bytes} bytes; save the ground truth only"
                        )
                    })?;
                    bytes_left -= unpacked.len() as u64;
                    variables.push(Variable::Unpacked(unpacked));
                }
                _ => {}
            }
            if variables.len() > MAX_VARIABLES {
                return Err(format!("more than {MAX_VARIABLES} variables; save the ground truth only"));
            }
        }
        Ok(Self { endian, variables })
    }

    /// Those variables that are matrices of numbers.
    pub(super) fn matrices(&self) -> Result<Vec<MatMatrix<'_>>, String> {
        let mut matrices = Vec::new();
        for variable in &self.variables {
            let bytes = match variable {
                Variable::Plain(bytes) => bytes,
                Variable::Unpacked(bytes) => match (Parts { bytes, endian: self.endian }).next()? {
                    Some(Part { kind: TYPE_MATRIX, bytes }) => bytes,
                    _ => continue,
                },
            };
            matrices.extend(matrix(Parts { bytes, endian: self.endian })?);
        }
        Ok(matrices)
    }
}

fn endian(bytes: &[u8]) -> Result<Endian, String> {
    if bytes.starts_with(b"MATLAB 7.3") || bytes.starts_with(b"\x89HDF") {
        return Err("it is a MATLAB 7.3 (HDF5) file; save it again with -v7".to_owned());
    }
    let header = bytes.get(..HEADER_BYTES).ok_or("it is too short for a MATLAB file; copy it again")?;
    match &header[126..] {
        b"IM" => Ok(Endian::Little),
        b"MI" => Ok(Endian::Big),
        _ => Err("it is no MATLAB 5 file; save it with -v7".to_owned()),
    }
}

/// The bytes that were packed, unless they are more than `most_bytes`.
fn unpack(packed: &[u8], most_bytes: u64) -> Result<Option<Vec<u8>>, String> {
    let mut bytes = Vec::new();
    ZlibDecoder::new(packed)
        .take(most_bytes + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| format!("a variable cannot be unpacked ({error}); copy the file again"))?;
    Ok((bytes.len() as u64 <= most_bytes).then_some(bytes))
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

/// A data element, as the format calls it.
struct Part<'a> {
    kind: u32,
    bytes: &'a [u8],
}

/// Data elements, one after the other.
struct Parts<'a> {
    bytes: &'a [u8],
    endian: Endian,
}

impl<'a> Parts<'a> {
    fn next(&mut self) -> Result<Option<Part<'a>>, String> {
        if self.bytes.is_empty() {
            return Ok(None);
        }
        let torn = || "a data element is torn; copy the file again".to_owned();
        let word = |at: usize| self.bytes.get(at..at + 4).map(|word| self.endian.unsigned(word) as u32);
        let first = word(0).ok_or_else(torn)?;
        // Up to four bytes stand in the tag itself, their number in its upper half.
        let (kind, start, length, padded) = match first >> 16 {
            0 => {
                let length = word(4).ok_or_else(torn)? as usize;
                let padded = if first == TYPE_COMPRESSED { length } else { length.next_multiple_of(8) };
                (first, 8, length, 8 + padded)
            }
            small if small <= MAX_SMALL_BYTES => (first & 0xFFFF, 4, small as usize, 8),
            _ => return Err(torn()),
        };
        let bytes = self.bytes.get(start..start + length).ok_or_else(torn)?;
        self.bytes = self.bytes.get(padded..).unwrap_or_default();
        Ok(Some(Part { kind, bytes }))
    }

    fn expect(&mut self) -> Result<Part<'a>, String> {
        self.next()?.ok_or_else(|| "a matrix is torn; copy the file again".to_owned())
    }

    fn numbers(&mut self) -> Result<Numbers<'a>, String> {
        let part = self.expect()?;
        let (width, convert): (usize, fn(u64) -> f64) = match part.kind {
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
            other => return Err(format!("data of type {other} are not numbers; save it with -v7")),
        };
        Ok(Numbers { bytes: part.bytes, endian: self.endian, width, convert })
    }
}

/// The numbers of a data element of a numeric type, as they are stored.
#[derive(Clone, Copy)]
struct Numbers<'a> {
    bytes: &'a [u8],
    endian: Endian,
    width: usize,
    convert: fn(u64) -> f64,
}

impl Numbers<'_> {
    fn len(&self) -> usize {
        self.bytes.len() / self.width
    }

    fn get(&self, index: usize) -> Option<f64> {
        let start = index.checked_mul(self.width)?;
        let bytes = self.bytes.get(start..start.checked_add(self.width)?)?;
        Some((self.convert)(self.endian.unsigned(bytes)))
    }

    /// The number at `index`, if it is one to count with.
    fn count(&self, index: usize) -> Option<usize> {
        self.get(index)
            .filter(|number| number.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(number))
            .map(|number| number as usize)
    }
}

/// The matrix of these parts; `None` for variables of another class or with more dimensions.
fn matrix(mut parts: Parts<'_>) -> Result<Option<MatMatrix<'_>>, String> {
    let flags = parts.expect()?.bytes;
    let flags = flags.get(..4).ok_or("a matrix is torn; copy the file again")?;
    let class = parts.endian.unsigned(flags) as u8;
    // Cells, structures, objects and text are no matrices of numbers.
    if !(CLASS_SPARSE..=15).contains(&class) {
        return Ok(None);
    }
    let sizes = parts.numbers()?;
    if sizes.len() != 2 {
        return Ok(None);
    }
    let (rows, columns) = sizes.count(0).zip(sizes.count(1)).ok_or("a matrix has an impossible size")?;
    let name = String::from_utf8_lossy(parts.expect()?.bytes).into_owned();
    let elements = if class == CLASS_SPARSE {
        let sparse = Sparse {
            row_indices: parts.numbers()?,
            column_starts: parts.numbers()?,
            values: parts.numbers()?,
        };
        sparse.check(rows, columns).map_err(|reason| format!("{name} {reason}; save it again"))?;
        Elements::Sparse(sparse)
    } else {
        let values = parts.numbers()?;
        if Some(values.len()) != rows.checked_mul(columns) {
            return Err(format!(
                "{name} has {} elements, not {rows} × {columns}; save it again",
                values.len()
            ));
        }
        Elements::Full(values)
    };
    Ok(Some(MatMatrix { name, rows, columns, elements }))
}

impl MatMatrix<'_> {
    /// The element in `row` and `column`, where all are stored.
    pub(super) fn get(&self, row: usize, column: usize) -> Option<f64> {
        match &self.elements {
            Elements::Full(values) if row < self.rows => values.get(column * self.rows + row),
            _ => None,
        }
    }

    /// Calls `visit` with row, column and value of every stored element, by ascending columns.
    pub(super) fn try_for_each<E>(
        &self,
        mut visit: impl FnMut(u32, u32, f64) -> Result<(), E>,
    ) -> Result<(), E> {
        match &self.elements {
            Elements::Full(values) => {
                // Without rows there are no elements, however many columns are claimed.
                let columns = if self.rows == 0 { 0 } else { self.columns };
                for column in 0..columns {
                    for row in 0..self.rows {
                        let value = values.get(column * self.rows + row).unwrap_or_default();
                        visit(row as u32, column as u32, value)?;
                    }
                }
                Ok(())
            }
            Elements::Sparse(sparse) => sparse.try_for_each(self.columns, visit),
        }
    }
}

/// The elements of a sparse matrix: the row of each, where each column begins among them, and their
/// values; without any values all are ones.
struct Sparse<'a> {
    row_indices: Numbers<'a>,
    column_starts: Numbers<'a>,
    values: Numbers<'a>,
}

impl Sparse<'_> {
    /// Fails unless every element has a row, a column and a value.
    fn check(&self, rows: usize, columns: usize) -> Result<(), String> {
        if self.column_starts.len() != columns + 1 || self.column_starts.count(0) != Some(0) {
            return Err("has no start for every column".to_owned());
        }
        let mut elements = 0;
        for column in 1..=columns {
            let start = self.column_starts.count(column).filter(|&start| start >= elements);
            elements = start.ok_or("has a column that ends before it begins")?;
        }
        if elements > self.row_indices.len() {
            return Err("has a column that reaches beyond its elements".to_owned());
        }
        if self.values.len() > 0 && elements > self.values.len() {
            return Err(format!("has {} values for {elements} elements", self.values.len()));
        }
        match (0..elements).find(|&element| self.row_indices.count(element).is_none_or(|row| row >= rows)) {
            Some(element) => Err(format!("has an element, number {element}, in none of its {rows} rows")),
            None => Ok(()),
        }
    }

    fn try_for_each<E>(
        &self,
        columns: usize,
        mut visit: impl FnMut(u32, u32, f64) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut start = 0;
        for column in 0..columns {
            let end = self.column_starts.count(column + 1).unwrap_or(start);
            for element in start..end {
                let row = self.row_indices.count(element).unwrap_or_default();
                visit(row as u32, column as u32, self.values.get(element).unwrap_or(1.0))?;
            }
            start = end;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::Compression;
    use flate2::write::ZlibEncoder;
    use proptest::prelude::*;
    use std::io::Write;

    fn fixture(name: &str) -> Vec<u8> {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/ground_truth/");
        std::fs::read(format!("{folder}{name}")).unwrap()
    }

    /// Name, size and elements that are not zero of every matrix in a file.
    type Content = Vec<(String, [usize; 2], Vec<(u32, u32)>)>;

    fn read_within(bytes: &[u8], most_bytes: u64) -> Result<Content, String> {
        let file = MatFile::read_within(bytes, most_bytes)?;
        let content = |matrix: MatMatrix<'_>| {
            let mut nonzero = Vec::new();
            let read = matrix.try_for_each(|row, column, value| {
                nonzero.extend((value != 0.0).then_some((row, column)));
                Ok::<_, String>(())
            });
            read.map(|()| (matrix.name, [matrix.rows, matrix.columns], nonzero))
        };
        file.matrices()?.into_iter().map(content).collect()
    }

    fn read(bytes: &[u8]) -> Result<Content, String> {
        read_within(bytes, MAX_UNPACKED_BYTES)
    }

    /// What `make.py` stores in every file: 4 × 5, with these elements other than zero.
    const NONZERO: [(u32, u32); 4] = [(2, 0), (3, 0), (3, 1), (0, 4)];

    fn part(kind: u32, content: &[u8]) -> Vec<u8> {
        let mut bytes = [kind, content.len() as u32].map(u32::to_le_bytes).concat();
        bytes.extend_from_slice(content);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    fn words(numbers: &[i32]) -> Vec<u8> {
        part(5, &numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>())
    }

    fn matrix(class: u32, [rows, columns]: [i32; 2], elements: &[Vec<u8>]) -> Vec<u8> {
        let flags = part(6, &[class, 0].map(u32::to_le_bytes).concat());
        part(14, &[flags, words(&[rows, columns]), part(1, b"truth"), elements.concat()].concat())
    }

    fn file(variables: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = vec![b' '; 124];
        bytes.extend(*b"\0\x01IM");
        bytes.extend(variables.concat());
        bytes
    }

    fn packed(variable: &[u8]) -> Vec<u8> {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(variable).unwrap();
        let bytes = encoder.finish().unwrap();
        [[15, bytes.len() as u32].map(u32::to_le_bytes).concat(), bytes].concat()
    }

    #[test]
    fn full_and_sparse_matrices_of_every_class_are_read_packed_or_not() {
        for name in ["double.mat", "packed.mat", "logical.mat", "sparse.mat", "uint8.mat"] {
            let matrices = read(&fixture(name)).unwrap();
            let (_, size, nonzero) = matrices.iter().find(|matrix| matrix.0 == "truth").expect(name);
            assert_eq!(*size, [4, 5], "{name}");
            assert_eq!(*nonzero, NONZERO, "{name}");
        }
    }

    #[test]
    fn a_file_of_another_format_is_refused_with_the_fix() {
        assert!(read(b"MATLAB 7.3 MAT-file, Platform").unwrap_err().contains("save it again with -v7"));
        assert!(read(&[0; 200]).unwrap_err().contains("no MATLAB 5 file"));
        assert!(read(b"short").unwrap_err().contains("too short"));
    }

    #[test]
    fn packed_variables_share_one_budget_of_bytes() {
        let variable = matrix(9, [40, 50], &[part(2, &[0; 2000])]);
        let bytes = file(&[packed(&variable), packed(&variable)]);
        let all = 2 * variable.len() as u64;
        assert!(bytes.len() < 400, "{} bytes hold {all}", bytes.len());
        assert_eq!(read_within(&bytes, all).unwrap().len(), 2);
        let message = read_within(&bytes, all - 1).unwrap_err();
        assert_eq!(
            message,
            format!("its variables unpack to more than {} bytes; save the ground truth only", all - 1)
        );
        let many = file(&vec![part(14, &[]); MAX_VARIABLES + 1]);
        assert!(read(&many).unwrap_err().contains("more than 10000 variables"));
    }

    #[test]
    fn sizes_that_no_memory_holds_cost_none() {
        let full = matrix(9, [i32::MAX, i32::MAX], &[part(2, &[1; 8])]);
        assert!(read(&file(&[full])).unwrap_err().contains("8 elements, not 2147483647 × 2147483647"));
        let sparse = matrix(5, [i32::MAX, i32::MAX], &[words(&[0]), words(&[0, 1]), part(2, &[1])]);
        assert!(read(&file(&[sparse])).unwrap_err().contains("truth has no start for every column"));
        let empty = matrix(9, [0, i32::MAX], &[part(2, &[])]);
        assert_eq!(read(&file(&[empty])).unwrap()[0].2, []);
    }

    #[test]
    fn a_sparse_matrix_with_elements_nowhere_or_without_values_is_refused() {
        let sparse = |rows: &[i32], starts: &[i32], values: &[u8]| {
            let parts = [words(rows), words(starts), part(2, values)];
            read(&file(&[matrix(5, [3, 2], &parts)])).map(|matrices| matrices[0].2.clone())
        };
        assert_eq!(sparse(&[1, 2], &[0, 1, 2], &[1, 1]).unwrap(), [(1, 0), (2, 1)]);
        assert_eq!(sparse(&[1, 2], &[0, 1, 2], &[]).unwrap(), [(1, 0), (2, 1)], "a pattern");
        for (rows, starts, values, reason) in [
            (&[1, 3][..], [0, 1, 2], &[1, 1][..], "an element, number 1, in none of its 3 rows"),
            (&[1, -1], [0, 1, 2], &[1, 1], "an element, number 1, in none of its 3 rows"),
            (&[1, 2], [0, 2, 1], &[1, 1], "a column that ends before it begins"),
            (&[1, 2], [1, 1, 2], &[1, 1], "no start for every column"),
            (&[1, 2], [0, 1, 3], &[1, 1, 1], "a column that reaches beyond its elements"),
            (&[1, 2], [0, 1, 2], &[1], "1 values for 2 elements"),
        ] {
            assert_eq!(sparse(rows, &starts, values), Err(format!("truth has {reason}; save it again")));
        }
    }

    proptest! {
        #[test]
        fn a_full_and_a_sparse_matrix_hold_the_same(
            (rows, columns, cells) in (1..6_usize, 1..6_usize).prop_flat_map(|(rows, columns)| {
                (Just(rows), Just(columns), proptest::collection::vec(0..2_u8, rows * columns))
            }),
        ) {
            let (mut indices, mut starts) = (Vec::new(), vec![0]);
            for column in cells.chunks(rows) {
                indices.extend((0..).zip(column).filter(|(_, cell)| **cell != 0).map(|(row, _)| row));
                starts.push(indices.len() as i32);
            }
            let size = [rows as i32, columns as i32];
            let ones = part(9, &1_f64.to_le_bytes().repeat(indices.len()));
            let full = matrix(9, size, &[part(2, &cells)]);
            let sparse = matrix(5, size, &[words(&indices), words(&starts), ones]);
            let read = read(&file(&[full, packed(&sparse)])).unwrap();
            let expected: Vec<(u32, u32)> = (0..cells.len())
                .filter(|&cell| cells[cell] != 0)
                .map(|cell| ((cell % rows) as u32, (cell / rows) as u32))
                .collect();
            prop_assert_eq!(&read[0].2, &expected);
            prop_assert_eq!(&read[1], &read[0]);
        }

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
