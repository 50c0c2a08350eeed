//! The vocabulary as it is used: from descriptors to words, straight from the mapped file.

use std::path::Path;

use super::format::{self, Counts, KIND, Link};
use super::{NodeId, VocabularyError, WordId};
use crate::feature::Descriptor;
use crate::storage::{FileBytes, StorageError, replace_file};

/// The level whose nodes serve as direct index, counted from the root.
const DIRECT_INDEX_LEVEL: u32 = 2;

/// What the tree says of a descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quantised {
    /// Its visual word.
    pub word: WordId,
    /// The node it passed near the root.
    pub node: NodeId,
}

/// A vocabulary tree, memory-mapped or just trained.
#[derive(Debug)]
pub struct Vocabulary {
    bytes: FileBytes,
    counts: Counts,
}

impl Vocabulary {
    /// Maps the vocabulary file at `path`; nothing is copied. Header, counts and links are checked,
    /// the checksum only by [`verify`](Self::verify).
    ///
    /// # Errors
    /// If the file cannot be read, is of another kind, newer, or damaged.
    pub fn open(path: &Path) -> Result<Self, VocabularyError> {
        Self::check(FileBytes::map(path)?, path)
    }

    /// A vocabulary from the bytes of a file; `path` only serves messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_bytes(bytes: Vec<u8>, path: &Path) -> Result<Self, VocabularyError> {
        Self::check(FileBytes::Owned(bytes), path)
    }

    fn check(bytes: FileBytes, path: &Path) -> Result<Self, VocabularyError> {
        let counts = format::check(&bytes, path)?;
        Ok(Self { bytes, counts })
    }

    /// Compares the whole file with the checksum in its header.
    ///
    /// # Errors
    /// If they differ; `path` serves the message.
    pub fn verify(&self, path: &Path) -> Result<(), StorageError> {
        KIND.verify(&self.bytes, path)
    }

    /// Writes the vocabulary to `path`, whole or not at all.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), StorageError> {
        replace_file(path, &[&self.bytes])
    }

    /// Most children a node.
    #[must_use]
    pub fn branching(&self) -> u32 {
        self.counts.branching
    }

    /// Most levels below the root.
    #[must_use]
    pub fn depth(&self) -> u32 {
        self.counts.depth
    }

    /// Number of nodes, the root included.
    #[must_use]
    pub fn node_count(&self) -> u32 {
        self.counts.nodes
    }

    /// Number of words.
    #[must_use]
    pub fn word_count(&self) -> u32 {
        self.counts.words
    }

    /// Number of images that it was trained on.
    #[must_use]
    pub fn image_count(&self) -> u32 {
        self.counts.images
    }

    /// Length of the file in bytes.
    #[must_use]
    pub fn length_bytes(&self) -> usize {
        self.bytes.len()
    }

    /// Inverse document frequency ln(N / Nᵢ) of a word of this vocabulary; 0 for any other.
    #[must_use]
    pub fn weight(&self, word: WordId) -> f32 {
        let weights = self.counts.tables(&self.bytes).weights;
        weights.get(word.0 as usize).map_or(0.0, |&bytes| f32::from_le_bytes(bytes))
    }

    /// The word of `descriptor`: at every node the nearest child, of equally near ones the first.
    #[must_use]
    pub fn quantise(&self, descriptor: &Descriptor) -> Quantised {
        let tables = self.counts.tables(&self.bytes);
        let (mut node, mut level, mut direct_index_node) = (0, 0, 0);
        loop {
            if level <= DIRECT_INDEX_LEVEL {
                direct_index_node = node;
            }
            let link = Link::from_bytes(tables.links[node as usize]);
            if link.children == 0 {
                return Quantised { word: WordId(link.first), node: NodeId(direct_index_node) };
            }
            let run = link.first as usize..(link.first + link.children) as usize;
            let distances =
                tables.descriptors[run].iter().map(|centre| descriptor.distance(&Descriptor(*centre)));
            let nearest = distances.zip(link.first..).min_by_key(|&(distance, _)| distance);
            node = nearest.map_or(link.first, |(_, child)| child);
            level += 1;
        }
    }
}
