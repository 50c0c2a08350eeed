//! NumPy's `.npy` files: numeric matrices, and the pickled object arrays of VPR-Bench, whose rows are a
//! query index and a list of reference indices (`ground_truth_new.npy`).
//!
//! Format: NumPy, NEP 1.

use std::collections::HashSet;

use super::error::{Fault, Rows};
use super::file::{self, MAX_FRAMES, MAX_PAIRS};
use super::pickle::{Pickle, Value, ValueId};

/// Longest header, in bytes; NumPy itself reads no longer ones.
const MAX_HEADER_BYTES: usize = 10_000;

/// What such a file may hold.
pub(super) enum Npy<'a> {
    /// A matrix of numbers.
    Dense(Dense<'a>),
    /// For each query, by index, its reference indices; sorted.
    Lists(Vec<Vec<u32>>),
}

/// A matrix of numbers as they are stored, row by row; at least one.
pub(super) struct Dense<'a> {
    /// Number of columns.
    pub(super) columns: usize,
    body: &'a [u8],
    width: usize,
    convert: fn(u64) -> f64,
}

impl Dense<'_> {
    /// The numbers of each row.
    pub(super) fn rows(&self) -> impl Iterator<Item = impl Iterator<Item = f64>> {
        let unsigned =
            |bytes: &[u8]| bytes.iter().rev().fold(0_u64, |bits, byte| bits << 8 | u64::from(*byte));
        let number = move |bytes: &[u8]| (self.convert)(unsigned(bytes));
        let rows = self.body.chunks_exact(self.columns * self.width);
        rows.map(move |row| row.chunks_exact(self.width).map(number))
    }
}

/// Reads the bytes of a file.
pub(super) fn read(bytes: &[u8]) -> Result<Npy<'_>, Fault> {
    let (header, body) = split(bytes)?;
    let header = std::str::from_utf8(header).map_err(|_| "its header is no text")?;
    let kind = field(header, "descr").ok_or("its header has no type")?.trim_matches(['\'', '"']);
    if field(header, "fortran_order") != Some("False") {
        return Err("it is stored by columns; save numpy.ascontiguousarray of it".into());
    }
    let shape = shape(header)?;
    if kind == "|O" {
        lists(body, &shape, MAX_PAIRS).map(Npy::Lists)
    } else {
        Ok(Npy::Dense(dense(body, kind, &shape)?))
    }
}

/// The header and what follows it.
fn split(bytes: &[u8]) -> Result<(&[u8], &[u8]), String> {
    let torn = "it is too short for a .npy file; copy it again";
    if !bytes.starts_with(b"\x93NUMPY") {
        return Err("it is no .npy file".to_owned());
    }
    let wide = *bytes.get(6).ok_or(torn)? > 1;
    let width = if wide { 4 } else { 2 };
    let length = bytes.get(8..8 + width).ok_or(torn)?;
    let length = length.iter().rev().fold(0_usize, |length, byte| length << 8 | usize::from(*byte));
    if length > MAX_HEADER_BYTES {
        return Err(format!("its header has {length} bytes, which no matrix needs"));
    }
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

fn dense<'a>(body: &'a [u8], kind: &str, shape: &[usize]) -> Result<Dense<'a>, String> {
    let &[rows, columns] = shape else { return Err(format!("it has {} dimensions, not 2", shape.len())) };
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
    if rows == 0 || columns == 0 {
        return Err(format!("it is empty, {rows} × {columns}"));
    }
    let expected = rows.checked_mul(columns).and_then(|count| count.checked_mul(width));
    if expected != Some(body.len()) {
        return Err(format!("it has {} bytes for {rows} × {columns} numbers of {width} bytes", body.len()));
    }
    Ok(Dense { columns, body, width, convert })
}

/// The reference indices of every query, `most_pairs` in all. Queries may stand in any order, each once.
fn lists(body: &[u8], shape: &[usize], most_pairs: usize) -> Result<Vec<Vec<u32>>, Fault> {
    let &[rows, 2] = shape else {
        return Err("it is no VPR-Bench ground truth: not rows of a query and its references".into());
    };
    if rows > MAX_FRAMES {
        return Err(file::too_many_frames().into());
    }
    let pickle = Pickle::read(body)?;
    let cells = match array(&pickle, pickle.root()) {
        Some(Array::Objects(cells)) => cells,
        _ => return Err("its pickle is no object array; save it with allow_pickle=True".into()),
    };
    if rows == 0 || cells.len() != 2 * rows {
        return Err(format!("it has {} cells for {rows} rows of 2", cells.len()).into());
    }
    let entries = || cells.chunks_exact(2).map(|pair| (pair[0], pair[1]));
    let queries: Vec<Option<u32>> = entries().map(|(query, _)| index(&pickle, query)).collect();
    refuse(queries.iter().map(Option::is_none), "the query is no index")?;
    let beyond = |query: &Option<u32>| query.is_some_and(|query| query as usize >= rows);
    refuse(
        queries.iter().map(beyond),
        format!("the query is none of 0 to {}; there must be an entry for each", rows - 1),
    )?;
    let mut seen = HashSet::new();
    refuse(queries.iter().map(|query| !seen.insert(*query)), "the query has an earlier entry already")?;
    let mut lists = vec![Vec::new(); rows];
    let (mut pairs_left, mut wrong) = (most_pairs, vec![false; rows]);
    for (entry, (query, (_, references))) in queries.into_iter().flatten().zip(entries()).enumerate() {
        match indices(&pickle, references, &mut pairs_left)? {
            Some(list) => lists[query as usize] = list,
            None => wrong[entry] = true,
        }
    }
    refuse(wrong.into_iter(), "the references are no indices, counted from 0")?;
    Ok(lists)
}

/// Fails with the entries that are wrong, if there are any.
fn refuse(wrong: impl Iterator<Item = bool>, reason: impl Into<String>) -> Result<(), Fault> {
    let entries: Vec<u64> = (0..).zip(wrong).filter(|(_, wrong)| *wrong).map(|(entry, _)| entry).collect();
    if entries.is_empty() { Ok(()) } else { Err(Fault::of(Rows::Entries(entries), reason)) }
}

/// A NumPy array in a pickle.
enum Array<'a> {
    Objects(&'a [ValueId]),
    /// Bytes of little-endian integers, and how many each has.
    Integers(&'a [u8], usize),
}

/// The array whose state `id` is: version, shape, type, order, data.
fn array<'a>(pickle: &'a Pickle<'_>, id: ValueId) -> Option<Array<'a>> {
    let Value::Object { state, .. } = pickle.value(id) else { return None };
    let &[_, shape, kind, _, data] = pickle.items(*state)? else { return None };
    match pickle.value(data) {
        Value::Sequence(items) => Some(Array::Objects(items)),
        Value::Bytes(bytes) => {
            let sizes = pickle.items(shape)?;
            let count =
                sizes.iter().try_fold(1_usize, |n, &size| n.checked_mul(index(pickle, size)? as usize))?;
            let width = bytes.len().checked_div(count).unwrap_or(8);
            let is_whole = width > 0 && bytes.len() == count * width && is_integer(pickle, kind);
            is_whole.then_some(Array::Integers(bytes, width))
        }
        _ => None,
    }
}

/// Whether the NumPy type `id` is an integer of the usual byte order: one made from `i8`, say, whose
/// state is a version, `<` or `|`, and more.
fn is_integer(pickle: &Pickle<'_>, id: ValueId) -> bool {
    let Value::Object { arguments: Some(arguments), state } = pickle.value(id) else { return false };
    let text = |list: ValueId, at: usize| match pickle.value(*pickle.items(list)?.get(at)?) {
        // Older pickles quote it.
        Value::Bytes(text) => text.iter().find(|byte| **byte != b'\'').copied(),
        _ => None,
    };
    matches!(text(*arguments, 0), Some(b'i' | b'u')) && matches!(text(*state, 1), Some(b'<' | b'|'))
}

/// A little-endian integer that is an index.
fn little(bytes: &[u8]) -> Option<u32> {
    let (low, high) = bytes.split_at(bytes.len().min(4));
    let number = low.iter().rev().fold(0_u64, |number, byte| number << 8 | u64::from(*byte));
    if high.iter().any(|byte| *byte != 0) { None } else { u32::try_from(number).ok() }
}

/// An index: an integer, a float without a fraction, or a NumPy scalar.
fn index(pickle: &Pickle<'_>, id: ValueId) -> Option<u32> {
    match pickle.value(id) {
        Value::Integer(number) => u32::try_from(*number).ok(),
        Value::Float(number) if number.fract() == 0.0 && (0.0..4e9).contains(number) => Some(*number as u32),
        Value::Call(arguments) => match *pickle.items(*arguments)? {
            [kind, data] if is_integer(pickle, kind) => match pickle.value(data) {
                Value::Bytes(bytes) if bytes.len() <= 8 => little(bytes),
                _ => None,
            },
            _ => None,
        },
        _ => None,
    }
}

/// Sorted indices: of a list, of an array, or a single one. Lists may be shared, so that few bytes
/// stand for many pairs: no more than `pairs_left` are copied out.
fn indices(pickle: &Pickle<'_>, id: ValueId, pairs_left: &mut usize) -> Result<Option<Vec<u32>>, String> {
    let alone = [id];
    let found = match (pickle.value(id), array(pickle, id)) {
        (Value::Sequence(items), _) => Array::Objects(items),
        (_, Some(array)) => array,
        _ => Array::Objects(&alone),
    };
    let count = match found {
        Array::Objects(items) => items.len(),
        Array::Integers(bytes, width) => bytes.len() / width,
    };
    *pairs_left = pairs_left.checked_sub(count).ok_or_else(file::too_many_pairs)?;
    let indices: Option<Vec<u32>> = match found {
        Array::Objects(items) => items.iter().map(|&item| index(pickle, item)).collect(),
        Array::Integers(bytes, width) => bytes.chunks_exact(width).map(little).collect(),
    };
    Ok(indices.map(|mut indices| {
        indices.sort_unstable();
        indices.dedup();
        indices
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::path::Path;

    fn fixture(name: &str) -> Vec<u8> {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/ground_truth/");
        std::fs::read(format!("{folder}{name}")).unwrap()
    }

    fn lists_of(bytes: &[u8]) -> Result<Vec<Vec<u32>>, String> {
        match read(bytes) {
            Ok(Npy::Lists(lists)) => Ok(lists),
            Ok(Npy::Dense(_)) => panic!("a matrix"),
            Err(fault) => Err(fault.at(Path::new("t.npy")).to_string()),
        }
    }

    fn rows_of(bytes: &[u8]) -> Result<Vec<Vec<f64>>, String> {
        match read(bytes) {
            Ok(Npy::Dense(dense)) => Ok(dense.rows().map(Iterator::collect).collect()),
            Ok(Npy::Lists(_)) => panic!("lists"),
            Err(fault) => Err(fault.at(Path::new("t.npy")).to_string()),
        }
    }

    fn npy(kind: &str, shape: &str, body: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
        let length = (header.len() as u16).to_le_bytes();
        [&b"\x93NUMPY\x01\0"[..], &length, header.as_bytes(), body].concat()
    }

    #[test]
    fn ground_truths_of_vpr_bench_are_read_however_numpy_pickled_them() {
        // `make.py` gives query 0 the references 0 and 1, query 1 references 1 and 2, query 2 only 2.
        let expected = vec![vec![0, 1], vec![1, 2], vec![2]];
        for name in ["lists.npy", "arrays.npy", "scalars.npy", "protocol2.npy", "shuffled.npy"] {
            assert_eq!(lists_of(&fixture(name)).as_ref(), Ok(&expected), "{name}");
        }
    }

    #[test]
    fn matrices_of_every_type_are_read() {
        for name in ["bool.npy", "float.npy", "int64.npy"] {
            assert_eq!(rows_of(&fixture(name)).unwrap(), [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], "{name}");
        }
    }

    #[test]
    fn entries_that_make_no_sense_are_named() {
        let message = |name| lists_of(&fixture(name)).unwrap_err();
        assert_eq!(
            message("twice.npy"),
            "t.npy, entry 2 (counted from 0): the query has an earlier entry already"
        );
        assert!(
            message("one_based.npy").starts_with("t.npy, entry 2 (counted from 0): the query is none of")
        );
        assert!(message("negative.npy").contains("entry 1 (counted from 0): the references are no indices"));
        assert!(message("halves.npy").contains("entries 0, 1, 2 (counted from 0): the references are no"));
        assert!(message("masks.npy").contains("entries 0, 1, 2 (counted from 0): the references are no"));
        assert!(message("columns.npy").contains("stored by columns"));
    }

    #[test]
    fn a_list_that_all_queries_share_counts_for_each_of_them() {
        // Two rows with the same list of two, which the pickle holds once.
        let bytes = fixture("shared.npy");
        let (_, body) = split(&bytes).unwrap();
        assert_eq!(lists(body, &[2, 2], 4), Ok(vec![vec![0, 1]; 2]));
        assert!(lists(body, &[2, 2], 3).is_err());
        assert_eq!(lists(body, &[MAX_FRAMES + 1, 2], 4), Err(file::too_many_frames().into()));
    }

    #[test]
    fn sizes_that_are_empty_or_overflow_are_refused() {
        let message = |shape: &str| rows_of(&npy("<f8", shape, &[])).unwrap_err();
        assert_eq!(message("(0, 2305843009213693952)"), "t.npy: it is empty, 0 × 2305843009213693952");
        assert_eq!(message("(5, 0)"), "t.npy: it is empty, 5 × 0");
        assert!(message("(2305843009213693952, 8)").contains("it has 0 bytes for"));
        assert!(message("(-1, 3)").contains("shape (-1, 3) makes no sense"));
        assert!(message("(3,)").contains("1 dimensions, not 2"));
        assert!(lists_of(&npy("|O", "(0, 2)", b"N.")).is_err());
        let long = [&b"\x93NUMPY\x02\0"[..], &u32::MAX.to_le_bytes()].concat();
        assert!(rows_of(&long).unwrap_err().contains("header has 4294967295 bytes"));
    }

    proptest! {
        #[test]
        fn no_header_with_any_body_makes_it_panic(
            kind in "[|<>][bifuO][0-9]{0,2}",
            shape in r"\(-?[0-9]{0,20}(, ?[0-9]{0,20}){0,2},?\)",
            body in proptest::collection::vec(any::<u8>(), 0..100),
        ) {
            match read(&npy(&kind, &shape, &body)) {
                Ok(Npy::Dense(dense)) => prop_assert!(dense.rows().flatten().count() <= body.len()),
                Ok(Npy::Lists(lists)) => prop_assert!(lists.len() <= body.len()),
                Err(_) => {}
            }
        }

        #[test]
        fn a_matrix_is_read_if_its_body_is_whole_and_else_refused(
            (rows, columns) in (0..9_usize, 0..9_usize),
            bytes in 0..81_usize,
        ) {
            let body: Vec<u8> = (0..bytes as u8).collect();
            let read = rows_of(&npy("|u1", &format!("({rows}, {columns})"), &body));
            prop_assert_eq!(read.is_ok(), rows * columns == bytes && bytes > 0);
            if let Ok(read) = read {
                let expected: Vec<Vec<f64>> = body
                    .chunks(columns)
                    .map(|row| row.iter().map(|&byte| f64::from(byte)).collect())
                    .collect();
                prop_assert_eq!(read, expected);
            }
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
            let _ = read(&bytes).map(|_| ());
        }
    }
}
