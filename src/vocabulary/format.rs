//! The vocabulary file `.lvoc`, version 2, used in place from a memory map.
//!
//! After the common header of [`crate::storage`], all numbers little-endian:
//!
//! | Offset | Bytes | Field |
//! |---|---|---|
//! | 32 | 4 | branching: most children a node, at most 127 |
//! | 36 | 4 | depth: most levels below the root, at most 16 |
//! | 40 | 4 | n: nodes, the root included, at most 2²⁴ |
//! | 44 | 4 | w: words |
//! | 48 | 4 | images that its weights were learnt from; 0 if unknown |
//! | 52 | 4 | weighting: 0 tf-idf, 1 tf, 2 idf, 3 binary |
//! | 56 | 4 | f32: mean luminance of those images, 0 to 255; negative if unknown |
//! | 60 | 4 | zero |
//! | 64 | 32 n | descriptors of the nodes; node 0 is the root, its descriptor zero |
//! | 64 + 32 n | 4 n | links of the nodes, see below |
//! | 64 + 36 n | 0 or 4 | zero, so that the weights stand at a multiple of eight |
//! | after it | 8 w | weights of the words, f64 |
//!
//! The link of an inner node is its first child (bits 0 to 23) and its number of children (bits 24 to 30),
//! that of a leaf bit 31 and its word.
//!
//! Nodes stand level by level, the children of a node side by side and each at a multiple of 32
//! bytes, so a descent reads one aligned run of descriptors a level. A child always stands behind its
//! parent. Weights are f64 because DBoW2's are: an imported vocabulary gives the same vectors to the last bit.

use std::path::Path;

use super::{VocabularyError, Weighting};
use crate::storage::{FileKind, HEADER_BYTES, StorageError};

/// Magic, version and name of the file.
pub(super) const KIND: FileKind = FileKind { magic: *b"LOCIVOC\0", version: 2, name: "vocabulary (.lvoc)" };
/// Length of the counts that precede the descriptors, in bytes.
pub(super) const COUNTS_BYTES: usize = 32;
/// Deepest tree that is read; bounds a descent.
pub(super) const MAX_DEPTH: u32 = 16;
/// Most children a node may have: what a link can say.
pub(super) const MAX_BRANCHING: u32 = 0x7f;
/// Most nodes of a tree: what a link can say.
pub(super) const MAX_NODES: u32 = 1 << CHILDREN_SHIFT;

const LEAF: u32 = 1 << 31;
const CHILDREN_SHIFT: u32 = 24;

/// What stands at the head of the body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Counts {
    pub(super) branching: u32,
    pub(super) depth: u32,
    pub(super) nodes: u32,
    pub(super) words: u32,
    pub(super) images: u32,
    pub(super) weighting: Weighting,
    /// Mean luminance of the images that its weights were learnt from, 0 to 255.
    pub(super) luminance: Option<f32>,
}

/// Where a descent goes on from a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Link {
    /// It ends in this word.
    Word(u32),
    /// To one of `children` nodes from `first` on.
    Children { first: u32, children: u32 },
}

impl Link {
    pub(super) fn from_bytes(bytes: [u8; 4]) -> Self {
        let bits = u32::from_le_bytes(bytes);
        if bits & LEAF != 0 {
            return Self::Word(bits & !LEAF);
        }
        Self::Children { first: bits & (MAX_NODES - 1), children: bits >> CHILDREN_SHIFT }
    }

    fn to_bytes(self) -> [u8; 4] {
        let bits = match self {
            Self::Word(word) => LEAF | word,
            Self::Children { first, children } => children << CHILDREN_SHIFT | first,
        };
        bits.to_le_bytes()
    }
}

/// The three tables of the file.
#[derive(Clone, Copy)]
pub(super) struct Tables<'a> {
    pub(super) descriptors: &'a [[u8; 32]],
    pub(super) links: &'a [[u8; 4]],
    pub(super) weights: &'a [[u8; 8]],
}

impl Counts {
    /// The tables of `file`, whose length was checked against these counts.
    pub(super) fn tables<'a>(&self, file: &'a [u8]) -> Tables<'a> {
        let nodes = self.nodes as usize;
        let (descriptors, rest) = file[HEADER_BYTES + COUNTS_BYTES..].split_at(nodes * 32);
        let (links, rest) = rest.split_at(nodes * 4);
        let weights = &rest[self.padding_bytes()..];
        Tables {
            descriptors: descriptors.as_chunks().0,
            links: links.as_chunks().0,
            weights: weights.as_chunks().0,
        }
    }

    fn padding_bytes(&self) -> usize {
        self.nodes as usize % 2 * 4
    }

    fn body_bytes(&self) -> u64 {
        let nodes = u64::from(self.nodes) * 36 + self.padding_bytes() as u64;
        COUNTS_BYTES as u64 + nodes + u64::from(self.words) * 8
    }

    fn to_bytes(self) -> [u8; COUNTS_BYTES] {
        let luminance = self.luminance.unwrap_or(-1.0).to_bits();
        let Self { branching, depth, nodes, words, images, weighting, .. } = self;
        let fields = [branching, depth, nodes, words, images, weighting as u32, luminance, 0];
        let mut bytes = [0; COUNTS_BYTES];
        for (place, field) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(fields) {
            *place = field.to_le_bytes();
        }
        bytes
    }

    fn from_bytes(bytes: &[u8; COUNTS_BYTES]) -> Result<Self, String> {
        let fields = bytes.as_chunks::<4>().0;
        let field = |index: usize| u32::from_le_bytes(fields[index]);
        let weighting = Weighting::from_number(field(5));
        let luminance = f32::from_bits(field(6));
        Ok(Self {
            branching: field(0),
            depth: field(1),
            nodes: field(2),
            words: field(3),
            images: field(4),
            weighting: weighting.ok_or_else(|| format!("there is no weighting {}", field(5)))?,
            luminance: (0.0..=255.0).contains(&luminance).then_some(luminance),
        })
    }
}

/// Reads the counts from the body of a file of this version and checks that every table lies inside it
/// and every link inside its table, so that a descent can neither leave the file nor run in circles.
pub(super) fn check(file: &[u8], body: &[u8], path: &Path) -> Result<Counts, VocabularyError> {
    let damaged = |reason: String| StorageError::Damaged { path: path.to_owned(), reason };
    let Some(head) = body.first_chunk::<COUNTS_BYTES>() else {
        return Err(damaged("the counts are missing".to_owned()).into());
    };
    let counts = Counts::from_bytes(head).map_err(damaged)?;
    if counts.body_bytes() != body.len() as u64 {
        let reason = format!("{} nodes and {} words do not fill its length", counts.nodes, counts.words);
        return Err(damaged(reason).into());
    }
    let is_tree = (1..=MAX_NODES).contains(&counts.nodes) && counts.words > 0;
    let has_shape =
        (1..=MAX_DEPTH).contains(&counts.depth) && (1..=MAX_BRANCHING).contains(&counts.branching);
    if !is_tree || !has_shape {
        return Err(damaged("it holds no tree".to_owned()).into());
    }
    let links = counts.tables(file).links;
    if !are_bounded(links, &counts) {
        let node = (0..).zip(links).find(|&(node, &link)| !is_bounded(node, link, &counts));
        let node = node.map_or(0, |(node, _)| node);
        return Err(damaged(format!("node {node} points outside the tree")).into());
    }
    Ok(counts)
}

/// Whether every link stays inside the tree. Without a branch in the loop, because a program waits for it
/// whenever it starts: a million links take a fraction of a millisecond.
fn are_bounded(links: &[[u8; 4]], counts: &Counts) -> bool {
    (0..).zip(links).fold(true, |all, (node, &link)| all & is_bounded(node, link, counts))
}

fn is_bounded(node: u32, link: [u8; 4], counts: &Counts) -> bool {
    let bits = u32::from_le_bytes(link);
    let (first, children) = (bits & (MAX_NODES - 1), (bits & !LEAF) >> CHILDREN_SHIFT);
    let is_word = (bits & LEAF != 0) & (bits & !LEAF < counts.words);
    let has_children = (bits & LEAF == 0) & (first > node) & (first + children <= counts.nodes);
    is_word | (has_children & (children != 0))
}

/// The whole file for a tree; `links` and `descriptors` are equally long.
pub(super) fn encode(counts: &Counts, descriptors: &[[u8; 32]], links: &[Link], weights: &[f64]) -> Vec<u8> {
    let mut file = Vec::with_capacity(HEADER_BYTES + counts.body_bytes() as usize);
    file.extend_from_slice(&[0; HEADER_BYTES]);
    file.extend_from_slice(&counts.to_bytes());
    file.extend_from_slice(descriptors.as_flattened());
    file.extend(links.iter().flat_map(|link| link.to_bytes()));
    file.extend(std::iter::repeat_n(0, counts.padding_bytes()));
    file.extend(weights.iter().flat_map(|weight| weight.to_le_bytes()));
    let header = KIND.header(&file[HEADER_BYTES..]);
    file[..HEADER_BYTES].copy_from_slice(&header);
    file
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_link_comes_back_from_its_four_bytes(
            word in 0..1_u32 << 31, first in 1..MAX_NODES, children in 1..=MAX_BRANCHING,
        ) {
            for link in [Link::Word(word), Link::Children { first, children }] {
                prop_assert_eq!(Link::from_bytes(link.to_bytes()), link);
            }
        }
    }

    #[test]
    fn tables_of_odd_and_even_trees_stand_aligned() {
        for nodes in [4, 5] {
            let counts = Counts {
                branching: 4,
                depth: 1,
                nodes,
                words: nodes - 1,
                images: 1,
                weighting: Weighting::TfIdf,
                luminance: None,
            };
            let mut links = vec![Link::Children { first: 1, children: nodes - 1 }];
            links.extend((0..nodes - 1).map(Link::Word));
            let weights: Vec<f64> = (0..nodes - 1).map(f64::from).collect();
            let file = encode(&counts, &vec![[7; 32]; nodes as usize], &links, &weights);
            let tables = counts.tables(&file);
            let offset = |table: &[u8]| table.as_ptr().addr() - file.as_ptr().addr();
            assert_eq!(offset(tables.descriptors.as_flattened()), 64);
            assert_eq!(offset(tables.weights.as_flattened()) % 8, 0);
            assert_eq!(tables.weights[2], 2.0_f64.to_le_bytes());
            let path = Path::new("f");
            assert_eq!(check(&file, KIND.body(&file, path).unwrap().1, path).unwrap(), counts);
        }
    }
}
