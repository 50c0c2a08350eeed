//! The visual vocabulary: a tree of binary words over ORB descriptors (Gálvez-López & Tardós, *Bags
//! of Binary Words for Fast Place Recognition in Image Sequences*, 2012).
//!
//! A descriptor goes down the tree, at each node to the child nearest in Hamming distance; the leaf
//! it ends in is its visual word. A word weighs the more the fewer training images showed it.

mod format;
mod training;
mod tree;

pub use training::{TrainingOptions, train};
pub use tree::{Quantised, Vocabulary};

use crate::storage::StorageError;

/// A visual word: a leaf of the vocabulary tree, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct WordId(pub u32);

/// A node near the root, under which a few percent of all words lie. Features under the same node
/// look alike enough to be worth comparing: DBoW2's direct index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub u32);

/// Why a vocabulary could not be read or trained.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VocabularyError {
    /// The file could not be read.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// Nothing to learn from.
    #[error("no features in the training images: use sharper or larger ones")]
    NothingToLearn,
    /// The settings make no tree.
    #[error("a vocabulary needs a branching of 2 to 32 and a depth of 1 to 8, got {branching} and {depth}")]
    BadShape {
        /// Children a node.
        branching: u32,
        /// Levels below the root.
        depth: u32,
    },
}
