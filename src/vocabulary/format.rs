//! The vocabulary file `.lvoc`, used in place from a memory map.
//!
//! After the common header of [`crate::storage`], all numbers little-endian:
//!
//! | Offset | Bytes | Field |
//! |---|---|---|
//! | 32 | 4 | branching: most children a node |
//! | 36 | 4 | depth: most levels below the root |
//! | 40 | 4 | n: nodes, the root included |
//! | 44 | 4 | w: words |
//! | 48 | 4 | images it was trained on |
//! | 52 | 12 | zero |
//! | 64 | 32 n | descriptors of the nodes; node 0 is the root, its descriptor zero |
//! | 64 + 32 n | 8 n | links: first child (u32), children (u32); a leaf has its word and 0 |
//! | 64 + 40 n | 4 w | inverse document frequencies, f32 |
//!
//! Nodes stand level by level, the children of a node side by side, so a descent reads one run of
//! descriptors a level. A child always stands behind its parent: a descent ends.

use std::path::Path;

use super::VocabularyError;
use crate::storage::{FileKind, HEADER_BYTES, StorageError};

/// Magic, version and name of the file.
pub(super) const KIND: FileKind = FileKind { magic: *b"LOCIVOC\0", version: 1, name: "vocabulary (.lvoc)" };
/// Length of the counts that precede the descriptors, in bytes.
const COUNTS_BYTES: usize = 32;
/// Deepest tree that is read; bounds a descent.
pub(super) const MAX_DEPTH: u32 = 16;

/// What stands at the head of the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) branching: u32,
    pub(super) depth: u32,
    pub(super) nodes: u32,
    pub(super) words: u32,
    pub(super) images: u32,
}

/// First child and number of children of a node; a leaf has its word and no children.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Link {
    pub(super) first: u32,
    pub(super) children: u32,
}

impl Link {
    pub(super) fn from_bytes(bytes: [u8; 8]) -> Self {
        let [a, b, c, d, e, f, g, h] = bytes;
        Self { first: u32::from_le_bytes([a, b, c, d]), children: u32::from_le_bytes([e, f, g, h]) }
    }

    fn to_bytes(self) -> [u8; 8] {
        let ([a, b, c, d], [e, f, g, h]) = (self.first.to_le_bytes(), self.children.to_le_bytes());
        [a, b, c, d, e, f, g, h]
    }
}

/// The three tables of the file.
#[derive(Clone, Copy)]
pub(super) struct Tables<'a> {
    pub(super) descriptors: &'a [[u8; 32]],
    pub(super) links: &'a [[u8; 8]],
    pub(super) weights: &'a [[u8; 4]],
}

impl Counts {
    /// The tables of `file`, whose length was checked against these counts.
    pub(super) fn tables<'a>(&self, file: &'a [u8]) -> Tables<'a> {
        let (nodes, words) = (self.nodes as usize, self.words as usize);
        let (descriptors, rest) = file[HEADER_BYTES + COUNTS_BYTES..].split_at(nodes * 32);
        let (links, rest) = rest.split_at(nodes * 8);
        let weights = &rest[..words * 4];
        Tables {
            descriptors: descriptors.as_chunks().0,
            links: links.as_chunks().0,
            weights: weights.as_chunks().0,
        }
    }

    fn body_bytes(&self) -> u64 {
        COUNTS_BYTES as u64 + u64::from(self.nodes) * 40 + u64::from(self.words) * 4
    }
}

/// Reads the counts of `file` and checks that every table lies inside it and every link inside its
/// table, so that a descent can neither leave the file nor run in circles.
pub(super) fn check(file: &[u8], path: &Path) -> Result<Counts, VocabularyError> {
    let (_, body) = KIND.body(file, path)?;
    let damaged = |reason: String| StorageError::Damaged { path: path.to_owned(), reason };
    let Some(head) = body.first_chunk::<COUNTS_BYTES>() else {
        return Err(damaged("the counts are missing".to_owned()).into());
    };
    let fields = head.as_chunks::<4>().0;
    let field = |index: usize| u32::from_le_bytes(fields[index]);
    let counts =
        Counts { branching: field(0), depth: field(1), nodes: field(2), words: field(3), images: field(4) };
    if counts.body_bytes() != body.len() as u64 {
        let reason = format!("{} nodes and {} words do not fill its length", counts.nodes, counts.words);
        return Err(damaged(reason).into());
    }
    if counts.nodes == 0 || counts.words == 0 || counts.depth == 0 || counts.depth > MAX_DEPTH {
        return Err(damaged("it holds no tree".to_owned()).into());
    }
    check_links(&counts, file).map_err(damaged)?;
    Ok(counts)
}

fn check_links(counts: &Counts, file: &[u8]) -> Result<(), String> {
    let tables = counts.tables(file);
    for (node, bytes) in tables.links.iter().enumerate() {
        let link = Link::from_bytes(*bytes);
        let end = u64::from(link.first) + u64::from(link.children);
        let good = match link.children {
            0 => link.first < counts.words,
            _ => link.first as usize > node && end <= u64::from(counts.nodes),
        };
        if !good {
            return Err(format!("node {node} points outside the tree"));
        }
    }
    let weights = tables.weights.iter().map(|&bytes| f32::from_le_bytes(bytes));
    match weights.into_iter().position(|weight| !(0.0..1e6).contains(&weight)) {
        Some(word) => Err(format!("word {word} has an impossible weight")),
        None => Ok(()),
    }
}

/// The whole file for a tree; `links` and `descriptors` are equally long.
pub(super) fn encode(counts: &Counts, descriptors: &[[u8; 32]], links: &[Link], weights: &[f32]) -> Vec<u8> {
    let mut body = Vec::with_capacity(counts.body_bytes() as usize);
    for value in [counts.branching, counts.depth, counts.nodes, counts.words, counts.images, 0, 0, 0] {
        body.extend_from_slice(&value.to_le_bytes());
    }
    body.extend(descriptors.as_flattened());
    body.extend(links.iter().flat_map(|link| link.to_bytes()));
    body.extend(weights.iter().flat_map(|weight| weight.to_le_bytes()));
    [&KIND.header(&body)[..], &body].concat()
}
