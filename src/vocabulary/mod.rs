//! The visual vocabulary: a tree of binary words over ORB descriptors (Gálvez-López & Tardós, *Bags
//! of Binary Words for Fast Place Recognition in Image Sequences*, 2012).
//!
//! A descriptor goes down the tree, at each node to the child nearest in Hamming distance; the leaf
//! it ends in is its visual word. A word weighs the more the fewer training images showed it.

mod format;
mod grown_words;
pub mod import;
mod set;
mod training;
mod tree;
mod version_1;

pub use grown_words::{GrownWords, Offshoot};
pub use set::{ConditionId, Light, LightSwitch, VocabularySet};
pub use training::{
    Corpus, CorpusImage, MemoryCorpus, Trained, TrainingFile, TrainingOptions, TrainingProgress,
    TrainingWatcher, train, train_on, weigh_on,
};
pub use tree::{Quantised, Vocabulary};

use std::path::PathBuf;

use crate::storage::StorageError;

/// A visual word: a leaf of the vocabulary tree, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct WordId(pub u32);

/// A node near the root, under which a few percent of all words lie. Features under the same node
/// look alike enough to be worth comparing: DBoW2's direct index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub u32);

/// How words weigh in a bag of words; DBoW2's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weighting {
    /// How often the image shows the word, times the word's inverse document frequency.
    TfIdf = 0,
    /// How often the image shows the word.
    Tf = 1,
    /// The inverse document frequency of every word that the image shows.
    Idf = 2,
    /// One for every word that the image shows.
    Binary = 3,
}

impl Weighting {
    /// The name for people and records.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::TfIdf => "tf-idf",
            Self::Tf => "tf",
            Self::Idf => "idf",
            Self::Binary => "binary",
        }
    }

    /// Whether a word weighs the more the oftener an image shows it.
    #[must_use]
    pub fn counts_repetitions(self) -> bool {
        matches!(self, Self::TfIdf | Self::Tf)
    }

    /// DBoW2's number, read back.
    fn from_number(number: u32) -> Option<Self> {
        [Self::TfIdf, Self::Tf, Self::Idf, Self::Binary].get(number as usize).copied()
    }
}

/// Why a vocabulary could not be read or trained.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VocabularyError {
    /// The file could not be read.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The file is of no kind that can be imported.
    #[error(
        "{} is no vocabulary that Loci knows; expected .lvoc, ORB-SLAM text, DBoW2 YAML (.yml, .yml.gz), \
         DBoW3 binary or FBoW", path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// These vocabularies make no set.
    #[error("a set of vocabularies is switched by light, but {reason}")]
    BadSet {
        /// What is wrong with them.
        reason: String,
    },
    /// The file is one that can be imported, but was not.
    #[error("{} is another library's ({format}): turn it into a .lvoc file with `loci vocab import`", path.display())]
    NotImported {
        /// The file.
        path: PathBuf,
        /// What it begins as.
        format: &'static str,
    },
    /// A foreign file does not hold what its kind says.
    #[error("{} is damaged ({format}): at {place}: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What it begins as.
        format: &'static str,
        /// Where it was noticed: a byte or a line.
        place: String,
        /// What is wrong there.
        reason: String,
    },
    /// A training was cut off, and another one wants its file.
    #[error(
        "{} was left behind by a training of other images, or by another version of Loci: delete it",
        path.display()
    )]
    OtherImages {
        /// The file.
        path: PathBuf,
    },
    /// The file of a training that was cut off is damaged. It has no copy and needs none.
    #[error("{} is damaged: {reason}; delete it, and the training begins anew", path.display())]
    DamagedTraining {
        /// The file.
        path: PathBuf,
        /// What does not fit, and where.
        reason: String,
    },
    /// Nothing to learn from.
    #[error("no features in the training images: use sharper or larger ones")]
    NothingToLearn,
    /// All words are in every image that shows any, so that none counts.
    #[error(
        "no word weighs anything: each one that these images show is in all of them; add images of other scenes"
    )]
    NothingRare,
    /// Whoever watched the training ended it.
    #[error("interrupted")]
    Interrupted,
    /// The settings make no tree.
    #[error("a vocabulary needs a branching of 2 to 32 and a depth of 1 to 8, got {branching} and {depth}")]
    BadShape {
        /// Children a node.
        branching: u32,
        /// Levels below the root.
        depth: u32,
    },
}
