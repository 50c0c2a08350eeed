//! An image that is asked for: its words, the rarest first.

use super::BowVector;
use super::block::{Block, Span};
use super::bow::WeighedWord;

/// The words of the image that is looked for; keeps its memory from query to query.
#[derive(Debug, Default)]
pub(super) struct Query {
    /// In rising order.
    words: Vec<WeighedWord>,
    /// Weights and positions of the words, in an order that can be sorted by.
    ranks: Vec<u64>,
    /// Positions of the words, those first that weigh most.
    rarest_first: Vec<u32>,
    /// Which share of the weight of all words those have that follow, by position in `rarest_first`; 0 at its end.
    left: Vec<f32>,
    /// 1 / L1 length of the words; 0 if there are none.
    pub(super) inverse_length: f32,
    /// Positions of the lists of the words in the block that was looked up last.
    lists: Vec<Option<u32>>,
    /// Where it has their postings.
    spans: Vec<Span>,
}

impl Query {
    /// Asks for `bow` from now on.
    pub(super) fn ask(&mut self, bow: &BowVector) {
        self.words.clear();
        self.words.extend(bow.weighed_words());
        self.inverse_length = inverse_length(bow);
        // Numbers that are not negative are in the order of their bits.
        let rank = |word: &WeighedWord| u64::from(!word.weight.to_bits());
        self.ranks.clear();
        self.ranks.extend((0..).zip(&self.words).map(|(at, word)| rank(word) << 32 | at));
        self.ranks.sort_unstable();
        self.rarest_first.clear();
        self.rarest_first.extend(self.ranks.iter().map(|&rank| rank as u32));
        self.left.clear();
        self.left.resize(self.words.len() + 1, 0.0);
        for (position, &word) in self.rarest_first.iter().enumerate().rev() {
            let WeighedWord { weight, repetitions, .. } = self.words[word as usize];
            let share = weight * f32::from(repetitions) * self.inverse_length;
            self.left[position] = self.left[position + 1] + share;
        }
    }

    /// Number of words.
    pub(super) fn len(&self) -> usize {
        self.words.len()
    }

    /// Finds the lists of `block`.
    pub(super) fn look_up(&mut self, block: &Block) {
        let mut finder = block.finder();
        // Each of the two lies anywhere in memory, so all of the first are asked for before the second.
        self.lists.clear();
        self.lists.extend(self.words.iter().map(|word| finder.find(word.word)));
        self.spans.clear();
        self.spans
            .extend(self.lists.iter().map(|list| list.map_or_else(Span::default, |list| block.span(list))));
    }

    /// How many words, the rarest first, leave at most `share` of the weight to the others.
    pub(super) fn split(&self, share: f32) -> usize {
        self.left.partition_point(|&left| left > share).min(self.len())
    }

    /// Which share of the weight the words have that follow the first so many of the rarest.
    pub(super) fn left(&self, count: usize) -> f32 {
        self.left[count]
    }

    /// The word at `position`, the rarest first, and where the block has its postings.
    #[inline]
    pub(super) fn word(&self, position: usize) -> (WeighedWord, Span) {
        let word = self.rarest_first[position] as usize;
        (self.words[word], self.spans[word])
    }
}

/// 1 / L1 length of the words of `bow`; 0 if there are none, or none that weighs something in 32 bits.
pub(super) fn inverse_length(bow: &BowVector) -> f32 {
    let inverse_length = (1.0 / bow.length()) as f32;
    if inverse_length.is_finite() { inverse_length } else { 0.0 }
}
