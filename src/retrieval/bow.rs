//! The bag of words of an image: a sparse tf-idf vector.

use crate::vocabulary::{Vocabulary, WordId};

/// A sparse tf-idf vector of L1 length 1 (or empty), sorted by word.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BowVector {
    entries: Vec<(WordId, f32)>,
}

impl BowVector {
    /// The vector of an image that shows `words`. Words that every training image shows weigh nothing
    /// and are left out.
    #[must_use]
    pub fn new(words: impl IntoIterator<Item = WordId>, vocabulary: &Vocabulary) -> Self {
        let mut words: Vec<WordId> = words.into_iter().collect();
        words.sort_unstable();
        let mut entries: Vec<(WordId, f32)> = words
            .chunk_by(|a, b| a == b)
            .map(|run| (run[0], run.len() as f32 * vocabulary.weight(run[0])))
            .filter(|&(_, weight)| weight > 0.0)
            .collect();
        let length: f32 = entries.iter().map(|entry| entry.1).sum();
        for (_, weight) in &mut entries {
            *weight /= length;
        }
        Self { entries }
    }

    /// Words with their weights, sorted by word.
    #[must_use]
    pub fn entries(&self) -> &[(WordId, f32)] {
        &self.entries
    }
}
