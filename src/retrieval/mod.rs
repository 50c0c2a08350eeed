//! Retrieval: which keyframes share the most, and the rarest, visual words with a frame.
//!
//! Images are tf-idf vectors over the vocabulary, normalised to L1 length one; the score of two is
//! 1 − ½ Σ|vᵢ − wᵢ| (Nistér & Stewénius 2006), between 0 for nothing in common and 1 for equal. The
//! inverted index visits only the postings of the words that the frame shows.

mod block;
mod block_building;
mod bow;
mod inverted_index;
mod numbers;
mod query;
mod snapshot;

pub use bow::BowVector;
pub use inverted_index::{DocumentId, InvertedIndex, MAX_RETRIEVED, Retrieved};
pub use snapshot::SnapshotReader;
