//! NumPy's `.npy` files: numeric matrices, and the pickled object arrays of VPR-Bench, whose rows are a
//! query index and a list of reference indices (`ground_truth_new.npy`).
//!
//! Format: NumPy, NEP 1.

use super::loop_matrix::{MAX_PAIRS, too_many_pairs};
use super::pickle::{Pickle, Value, ValueId};

/// What such a file may hold.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Npy {
    /// A matrix of numbers.
    Dense {
        /// How many stand in a row.
        columns: usize,
        /// For each row the columns that are not zero.
        matches: Vec<Vec<u32>>,
    },
    /// For each query, by index, its reference indices.
    Lists(Vec<Vec<u32>>),
}

/// Reads the bytes of a file.
pub(super) fn read(bytes: &[u8]) -> Result<Npy, String> {
    let (header, body) = split(bytes)?;
    let header = std::str::from_utf8(header).map_err(|_| "its header is no text")?;
    let kind = field(header, "descr").ok_or("its header has no type")?.trim_matches(['\'', '"']);
    if field(header, "fortran_order") != Some("False") {
        return Err("it is stored by columns; save it with order='C'".to_owned());
    }
    let shape = shape(header)?;
    if kind == "|O" { lists(body, &shape).map(Npy::Lists) } else { dense(body, kind, &shape) }
}

/// The header and what follows it.
fn split(bytes: &[u8]) -> Result<(&[u8], &[u8]), String> {
    let torn = "it is too short for a .npy file";
    if !bytes.starts_with(b"\x93NUMPY") {
        return Err("it is no .npy file".to_owned());
    }
    let wide = *bytes.get(6).ok_or(torn)? > 1;
    let width = if wide { 4 } else { 2 };
    let length = bytes.get(8..8 + width).ok_or(torn)?;
    let length = length.iter().rev().fold(0_usize, |length, byte| length << 8 | usize::from(*byte));
    let rest = &bytes[8 + width..];
    rest.split_at_checked(length).ok_or_else(|| torn.to_owned())
}

/// The value of a key in the header, which is a Python dictionary.
fn field<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let (_, after) = header.split_once(&format!("'{key}':"))?;
    let after = after.trim_start();
    let end = if after.starts_with('(') { after.find(')')? + 1 } else { after.find([',', '}'])? };
    Some(after[..end].trim())
}

fn shape(header: &str) -> Result<Vec<usize>, String> {
    let text = field(header, "shape").ok_or("its header has no shape")?;
    let sizes = text.trim_matches(['(', ')']).split(',').map(str::trim).filter(|size| !size.is_empty());
    sizes.map(|size| size.parse().map_err(|_| format!("its shape {text} makes no sense"))).collect()
}

fn dense(body: &[u8], kind: &str, shape: &[usize]) -> Result<Npy, String> {
    let &[rows, columns] = shape else { return Err(format!("it has {} dimensions, not 2", shape.len())) };
    let unsigned = |bytes: &[u8]| bytes.iter().rev().fold(0_u64, |bits, byte| bits << 8 | u64::from(*byte));
    let (width, convert): (usize, fn(u64) -> f64) = match kind {
        "|b1" | "|u1" => (1, |bits| bits as f64),
        "|i1" => (1, |bits| f64::from(bits as u8 as i8)),
        "<i2" => (2, |bits| f64::from(bits as u16 as i16)),
        "<u2" => (2, |bits| bits as f64),
        "<i4" => (4, |bits| f64::from(bits as u32 as i32)),
        "<u4" => (4, |bits| bits as f64),
        "<i8" => (8, |bits| bits as i64 as f64),
        "<u8" => (8, |bits| bits as f64),
        "<f4" => (4, |bits| f64::from(f32::from_bits(bits as u32))),
        "<f8" => (8, f64::from_bits),
        other => return Err(format!("numbers of type {other} are not read; save it as uint8")),
    };
    let expected = rows.checked_mul(columns).and_then(|count| count.checked_mul(width));
    if expected != Some(body.len()) {
        return Err(format!("it has {} bytes for {rows} × {columns} numbers of {width} bytes", body.len()));
    }
    if rows == 0 || columns == 0 {
        return Err(format!("it has {rows} × {columns} numbers: nothing"));
    }
    let mut matches = Vec::with_capacity(rows);
    let mut pairs = 0;
    for (row, bytes) in body.chunks_exact(columns * width).enumerate() {
        let numbers = || bytes.chunks_exact(width).map(|bytes| convert(unsigned(bytes)));
        if numbers().any(f64::is_nan) {
            return Err(format!("query frame {row}, counted from 0, has a NaN; it should have 0 or 1"));
        }
        let row: Vec<u32> =
            (0..).zip(numbers()).filter(|(_, value)| *value != 0.0).map(|(at, _)| at).collect();
        pairs += row.len();
        if pairs > MAX_PAIRS {
            return Err(too_many_pairs());
        }
        matches.push(row);
    }
    Ok(Npy::Dense { columns, matches })
}

/// The reference indices of every query. Queries may stand in any order, each once.
fn lists(body: &[u8], shape: &[usize]) -> Result<Vec<Vec<u32>>, String> {
    let &[rows, 2] = shape else {
        return Err("it is no VPR-Bench ground truth: not rows of a query and its references".to_owned());
    };
    let pickle = Pickle::read(body)?;
    let cells = array(&pickle, pickle.root()).and_then(|array| match array {
        Array::Objects(cells) => Some(cells),
        Array::Numbers(_) => None,
    });
    let cells = cells.ok_or("its pickle is no object array")?;
    if Some(cells.len()) != rows.checked_mul(2) {
        return Err(format!("it has {} cells for {rows} rows of 2", cells.len()));
    }
    let mut lists: Vec<Option<Vec<u32>>> = vec![None; rows];
    let mut pairs = 0;
    for (row, cells) in cells.chunks_exact(2).enumerate() {
        let query = index(&pickle, cells[0])
            .ok_or_else(|| format!("row {row}, counted from 0: its query is no index"))?;
        let list = indices(&pickle, cells[1])
            .ok_or_else(|| format!("row {row}, counted from 0: its references are no indices"))?;
        pairs += list.len();
        if pairs > MAX_PAIRS {
            return Err(too_many_pairs());
        }
        let slot = lists.get_mut(query as usize).ok_or_else(|| {
            format!("row {row}, counted from 0: query {query} of {rows}; queries too are counted from 0, a row each")
        })?;
        if slot.replace(list).is_some() {
            return Err(format!("row {row}, counted from 0: query {query} has an earlier row already"));
        }
    }
    Ok(lists.into_iter().flatten().collect())
}

/// A NumPy array in a pickle.
enum Array<'a> {
    Objects(&'a [ValueId]),
    Numbers(Vec<u32>),
}

/// The array whose state `id` is: version, shape, type, order, data.
fn array(pickle: &Pickle, id: ValueId) -> Option<Array<'_>> {
    let Value::State(state) = pickle.value(id) else { return None };
    let &[_, shape, _, _, data] = pickle.items(*state)? else { return None };
    match pickle.value(data) {
        Value::Sequence(items) => Some(Array::Objects(items)),
        Value::Bytes(bytes) => {
            let sizes = pickle.items(shape)?;
            let count =
                sizes.iter().try_fold(1_usize, |n, &size| n.checked_mul(index(pickle, size)? as usize))?;
            let width = bytes.len().checked_div(count).unwrap_or(8);
            if width == 0 || bytes.len() != count * width {
                return None;
            }
            bytes.chunks_exact(width).map(little).collect::<Option<Vec<u32>>>().map(Array::Numbers)
        }
        _ => None,
    }
}

/// A little-endian integer that is an index.
fn little(bytes: &[u8]) -> Option<u32> {
    let (low, high) = bytes.split_at(bytes.len().min(4));
    let number = low.iter().rev().fold(0_u64, |number, byte| number << 8 | u64::from(*byte));
    if high.iter().any(|byte| *byte != 0) { None } else { u32::try_from(number).ok() }
}

/// An index: an integer, a float without a fraction, or a NumPy scalar.
fn index(pickle: &Pickle, id: ValueId) -> Option<u32> {
    match pickle.value(id) {
        Value::Integer(number) => u32::try_from(*number).ok(),
        Value::Float(number) if number.fract() == 0.0 && (0.0..4e9).contains(number) => Some(*number as u32),
        Value::Call(arguments) => match *pickle.items(*arguments)? {
            [_, data] => match pickle.value(data) {
                Value::Bytes(bytes) if bytes.len() <= 8 => little(bytes),
                _ => None,
            },
            _ => None,
        },
        _ => None,
    }
}

/// Sorted indices: of a list, of an array, or a single one.
fn indices(pickle: &Pickle, id: ValueId) -> Option<Vec<u32>> {
    let of_items = |items: &[ValueId]| items.iter().map(|&item| index(pickle, item)).collect();
    let found: Option<Vec<u32>> = match pickle.value(id) {
        Value::Sequence(items) => of_items(items),
        Value::State(_) => match array(pickle, id)? {
            Array::Objects(items) => of_items(items),
            Array::Numbers(numbers) => Some(numbers),
        },
        _ => index(pickle, id).map(|index| vec![index]),
    };
    let mut found = found?;
    found.sort_unstable();
    found.dedup();
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fixture(name: &str) -> Vec<u8> {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/ground_truth/");
        std::fs::read(format!("{folder}{name}")).unwrap()
    }

    #[test]
    fn ground_truths_of_vpr_bench_are_read_however_numpy_pickled_them() {
        // `make.py` gives query 0 the references 0 and 1, query 1 references 1 and 2, query 2 only 2.
        let expected = Npy::Lists(vec![vec![0, 1], vec![1, 2], vec![2]]);
        for name in ["lists.npy", "arrays.npy", "scalars.npy", "protocol2.npy", "shuffled.npy"] {
            assert_eq!(read(&fixture(name)).as_ref(), Ok(&expected), "{name}");
        }
    }

    #[test]
    fn matrices_of_every_type_are_read() {
        for name in ["bool.npy", "float.npy", "int64.npy"] {
            let expected = Npy::Dense { columns: 3, matches: vec![vec![2], vec![0]] };
            assert_eq!(read(&fixture(name)), Ok(expected), "{name}");
        }
    }

    #[test]
    fn rows_that_make_no_sense_are_named() {
        let message = |name| read(&fixture(name)).unwrap_err();
        assert!(message("twice.npy").contains("row 2, counted from 0: query 1 has an earlier row already"));
        assert!(message("one_based.npy").contains("row 2, counted from 0: query 3 of 3"));
        assert!(message("negative.npy").contains("row 1, counted from 0: its references are no indices"));
        assert!(message("columns.npy").contains("stored by columns"));
    }

    /// A file with this header and body.
    fn file(header: &str, body: &[u8]) -> Vec<u8> {
        [b"\x93NUMPY\x01\0", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), body].concat()
    }

    proptest! {
        #[test]
        fn whatever_a_header_claims_is_read_or_refused(
            kind in prop_oneof![Just("<f8"), Just("|b1"), Just("|O"), Just("<i2")],
            rows in prop_oneof![0..4_u64, any::<u64>()],
            columns in prop_oneof![0..4_u64, any::<u64>()],
            body in proptest::collection::vec(any::<u8>(), 0..40),
        ) {
            let shape = format!("({rows}, {columns})");
            let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
            let read = read(&file(&header, &body));
            let is_dense = matches!(read, Ok(Npy::Dense { .. }));
            prop_assert!(!is_dense || rows * columns > 0);
        }

        #[test]
        fn damaged_files_are_refused_or_read_but_never_panic(
            name in prop_oneof![Just("lists.npy"), Just("arrays.npy"), Just("float.npy")],
            flips in proptest::collection::vec((0..1000_usize, any::<u8>()), 1..6),
            length in 0..1000_usize,
        ) {
            let mut bytes = fixture(name);
            for (at, value) in flips {
                let at = at % bytes.len();
                bytes[at] ^= value;
            }
            bytes.truncate(length.max(12));
            let _ = read(&bytes);
        }
    }
}
