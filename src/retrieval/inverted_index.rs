//! The inverted index: for every word the images that show it.

use std::cmp::Reverse;
use std::ops::Range;

use heapless::Vec as FixedVec;

use super::BowVector;
use super::block::{Block, BlockImage, MOST_IMAGES, Sums};
use super::block_building::{NewPosting, Renames, merged, of_images};
use super::bow::WeighedWord;
use super::query::{Query, inverse_length};
use crate::vocabulary::WordId;

/// Most documents that a query answers with.
pub const MAX_RETRIEVED: usize = 16;

/// An indexed image, counted from 0 in the order of adding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DocumentId(pub u32);

/// An image that shares words with the query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Retrieved {
    /// Which.
    pub document: DocumentId,
    /// L1 score in (0, 1].
    pub score: f32,
}

/// Images, and their postings, that wait about at most while many are added in a row.
const MOST_PENDING: usize = MOST_IMAGES / 16;
const MOST_PENDING_POSTINGS: usize = 1 << 20;
/// Images of a small block, which takes new ones in one by one.
const SMALL: usize = MOST_IMAGES.div_ceil(256).next_multiple_of(4);
/// Most postings of a block, in numbers of 16 bits: their positions are 32 bits wide.
const MOST_POSTINGS: usize = u32::MAX as usize;
/// Scores that are looked at together: few documents are better than the best ones so far.
const SCORES_AT_ONCE: usize = 64;
/// Share of the documents, and fewest, that may be removed before their postings are swept out.
const SWEEP_SHARE: usize = 8;
const FEWEST_SWEPT: usize = 64;

/// Images, each under its words.
///
/// They lie in blocks that do not change: new images make a small block, and a block becomes one with those behind it
/// once they are as large together (as in O'Neil et al., *The log-structured merge-tree*, 1996), so that there are few,
/// and old postings move seldom.
#[derive(Default)]
pub struct InvertedIndex {
    /// In the order of adding.
    blocks: Vec<Block>,
    pending: Pending,
    /// By document.
    is_removed: Vec<bool>,
    /// Documents that were removed and still have postings.
    unswept: Vec<u32>,
    /// Numbers of swept documents, to be given again, the lowest last.
    free: Vec<u32>,
    query: Query,
    /// Of the images of a block; all zero between queries.
    sums: Vec<f32>,
}

/// The newest images, which are in no block yet.
#[derive(Default)]
struct Pending {
    images: Vec<BlockImage>,
    /// In the order of adding.
    postings: Vec<NewPosting>,
}

impl InvertedIndex {
    /// Indexes an image. Numbers of removed ones are given again. A word must weigh the same in all images, and in
    /// those that are asked for, before their vectors are made as long as one another.
    pub fn add(&mut self, bow: &BowVector) -> DocumentId {
        let document = self.free.pop().unwrap_or(self.is_removed.len() as u32);
        match self.is_removed.get_mut(document as usize) {
            Some(is_removed) => *is_removed = false,
            None => self.is_removed.push(false),
        }
        let Pending { images, postings } = &mut self.pending;
        let image = images.len() as u16;
        images.push(BlockImage { document, inverse_length: inverse_length(bow) });
        let posting =
            |word: WeighedWord| NewPosting { word: word.word, image, repetitions: word.repetitions };
        postings.extend(bow.weighed_words().map(posting));
        if images.len() == MOST_PENDING || postings.len() >= MOST_PENDING_POSTINGS {
            self.settle();
        }
        DocumentId(document)
    }

    /// Puts what is pending into a block, and makes one block of several while there are enough.
    fn settle(&mut self) {
        let Pending { images, postings } = std::mem::take(&mut self.pending);
        if images.is_empty() {
            return;
        }
        self.blocks.push(of_images(images, &sorted(postings)));
        while let Some(range) = next_merged(&self.blocks) {
            let block = merged(&self.blocks[range.clone()], |_| true, &Renames::new());
            self.blocks.splice(range, [block]);
        }
    }

    /// Forgets an image: it is not found any more. Its postings go when there are many such; answers whether they
    /// did.
    pub fn remove(&mut self, document: DocumentId) -> bool {
        let Some(is_removed) = self.is_removed.get_mut(document.0 as usize).filter(|removed| !**removed)
        else {
            return false;
        };
        *is_removed = true;
        self.unswept.push(document.0);
        let is_due = self.unswept.len() >= FEWEST_SWEPT.max(self.len() / SWEEP_SHARE);
        if is_due {
            self.sweep();
        }
        is_due
    }

    /// Forgets all images that are not `wanted`, and frees their memory.
    pub fn retain(&mut self, wanted: impl Fn(DocumentId) -> bool) {
        for (document, is_removed) in (0..).zip(&mut self.is_removed) {
            if !*is_removed && !wanted(DocumentId(document)) {
                *is_removed = true;
                self.unswept.push(document);
            }
        }
        self.sweep();
    }

    /// Frees the memory of what was removed.
    pub fn sweep(&mut self) {
        self.settle();
        if self.unswept.is_empty() {
            return;
        }
        let is_left = |document: u32| !self.is_removed[document as usize];
        let mut rest = std::mem::take(&mut self.blocks);
        while !rest.is_empty() {
            let left = rest.split_off(most_that_fit(rest.iter(), is_left));
            let is_untouched =
                rest.len() == 1 && rest[0].images().iter().all(|image| is_left(image.document));
            if !is_untouched {
                rest = vec![merged(&rest, is_left, &Renames::new())];
            }
            self.blocks.extend(rest.into_iter().filter(|block| !block.images().is_empty()));
            rest = left;
        }
        self.free.append(&mut self.unswept);
        self.free.sort_unstable_by_key(|&document| Reverse(document));
    }

    /// How many numbers documents have, and all blocks, once nothing is pending or removed.
    pub(super) fn settled(&self) -> (u32, &[Block]) {
        (self.is_removed.len() as u32, &self.blocks)
    }

    /// An index of documents of so many numbers that lie in these blocks; `None` if one lies in two of them.
    pub(super) fn of_blocks(documents: u32, blocks: Vec<Block>) -> Option<Self> {
        let mut is_removed = vec![true; documents as usize];
        for image in blocks.iter().flat_map(Block::images) {
            if !std::mem::take(is_removed.get_mut(image.document as usize)?) {
                return None;
            }
        }
        let free = (0..documents).rev().filter(|&document| is_removed[document as usize]).collect();
        Some(Self { blocks, is_removed, free, ..Self::default() })
    }

    /// Number of postings, but for images that wait to be put into a block: an image has one for each of its words.
    #[must_use]
    pub fn postings(&self) -> usize {
        self.blocks.iter().map(Block::postings_count).sum()
    }

    /// Whether an image of this number is indexed.
    #[must_use]
    pub fn contains(&self, document: DocumentId) -> bool {
        self.is_removed.get(document.0 as usize) == Some(&false)
    }

    /// Whether some image shows `word`.
    #[must_use]
    pub fn shows(&self, word: WordId) -> bool {
        self.blocks.iter().any(|block| !block.postings_of(word).is_empty())
            || self.pending.postings.iter().any(|pending| pending.word == word)
    }

    /// From now on, what was indexed as the first word of a pair counts as the other, which is the first of none, and
    /// weighs what that weighs. If repetitions count (tf-idf, tf), it is as if they had been one from the start;
    /// otherwise (idf, binary), an image that shows both counts it twice.
    pub fn rename(&mut self, words: &[(WordId, WordId)]) {
        if words.is_empty() {
            return;
        }
        self.settle();
        for block in &mut self.blocks {
            let mut renames = Renames::new();
            for &(word, other) in words.iter().filter(|(word, _)| !block.postings_of(*word).is_empty()) {
                renames.entry(other).or_default().push(word);
            }
            if !renames.is_empty() {
                *block = merged(std::slice::from_ref(block), |_| true, &renames);
            }
        }
    }

    /// Number of indexed images.
    #[must_use]
    pub fn len(&self) -> usize {
        self.is_removed.len() - self.free.len() - self.unswept.len()
    }

    /// Whether no image is indexed.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes of memory that the index takes.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        let blocks: usize = self.blocks.iter().map(Block::memory_bytes).sum();
        blocks
            + size_of_val(self.pending.images.as_slice())
            + size_of_val(self.pending.postings.as_slice())
            + size_of_val(self.sums.as_slice())
            + self.is_removed.len()
            + size_of_val(self.free.as_slice())
    }

    /// The images that `wanted` accepts and that score best, best first, at most [`MAX_RETRIEVED`]; of equal ones those
    /// first that were added first.
    ///
    /// For vectors of length one, 1 − ½ Σ|v − w| = Σ min(v, w) over the common words.
    pub fn query(
        &mut self,
        bow: &BowVector,
        wanted: impl Fn(DocumentId) -> bool,
    ) -> FixedVec<Retrieved, MAX_RETRIEVED> {
        self.settle();
        self.query.ask(bow);
        self.sums.resize(MOST_IMAGES, 0.0);
        let mut best = FixedVec::new();
        let Some(sums) = self.sums.first_chunk_mut::<MOST_IMAGES>() else { return best };
        let is_wanted = |id: DocumentId| !self.is_removed[id.0 as usize] && wanted(id);
        for block in &self.blocks {
            if block.score(&mut self.query, worst(&best), sums) {
                collect(block, sums, is_wanted, &mut best);
            }
        }
        best
    }
}

/// Keeps the best images of a block that are wanted, and empties `sums`, their scores.
fn collect(
    block: &Block,
    sums: &mut Sums,
    is_wanted: impl Fn(DocumentId) -> bool,
    best: &mut FixedVec<Retrieved, MAX_RETRIEVED>,
) {
    for (images, scores) in block.images().chunks(SCORES_AT_ONCE).zip(sums.chunks_mut(SCORES_AT_ONCE)) {
        let most = scores.iter().fold(0.0, |most: f32, &score| most.max(score));
        if most > worst(best) {
            for (image, &score) in images.iter().zip(&*scores) {
                let document = DocumentId(image.document);
                if score > worst(best) && is_wanted(document) {
                    insert_sorted(best, Retrieved { document, score });
                }
            }
        }
        scores.fill(0.0);
    }
}

/// The score that is to be beaten.
fn worst(best: &FixedVec<Retrieved, MAX_RETRIEVED>) -> f32 {
    best.last().filter(|_| best.is_full()).map_or(0.0, |worst| worst.score)
}

/// The blocks that are to become one, if any: the two newest while they are small; else the newest that are not, each
/// as large at most as all behind it, as many as fit into one.
fn next_merged(blocks: &[Block]) -> Option<Range<usize>> {
    let len = |block: &Block| block.images().len();
    if let [.., before, last] = blocks
        && len(before) + len(last) <= SMALL
    {
        return Some(blocks.len() - 2..blocks.len());
    }
    // The last one waits until it is no longer small.
    let end = blocks.len() - usize::from(blocks.last().is_some_and(|last| len(last) < SMALL));
    let mut behind = 0;
    let is_small_enough = |block: &&Block| {
        let is_small_enough = behind == 0 || len(block) <= behind;
        behind += len(block);
        is_small_enough
    };
    let newest = blocks[..end].iter().rev().take_while(is_small_enough);
    let count = most_that_fit(newest, |_| true);
    (count > 1).then(|| end - count..end)
}

/// How many of the first blocks fit into one with their images that are `wanted`, at least one.
fn most_that_fit<'a>(blocks: impl Iterator<Item = &'a Block>, wanted: impl Fn(u32) -> bool) -> usize {
    let (mut images, mut postings) = (0, 0);
    let fits = |block: &&Block| {
        images += block.images().iter().filter(|image| wanted(image.document)).count();
        postings += block.postings_len();
        images <= MOST_IMAGES && postings <= MOST_POSTINGS
    };
    blocks.take_while(fits).count().max(1)
}

/// The same postings by word; those of one word stay in their order.
fn sorted(mut pending: Vec<NewPosting>) -> Vec<NewPosting> {
    let most = pending.iter().map(|posting| posting.word.0).max().unwrap_or(0);
    let digit_bits = (u32::BITS - most.leading_zeros()).div_ceil(2);
    let mut sorted = pending.clone();
    let mut ends = vec![0; (1 << digit_bits) + 1];
    for shift in [0, digit_bits] {
        let digit = |word: WordId| (word.0 >> shift) as usize & ((1 << digit_bits) - 1);
        ends.fill(0);
        pending.iter().for_each(|posting| ends[digit(posting.word) + 1] += 1);
        (1..ends.len()).for_each(|digit| ends[digit] += ends[digit - 1]);
        for &next in &pending {
            let end = &mut ends[digit(next.word)];
            sorted[*end] = next;
            *end += 1;
        }
        std::mem::swap(&mut pending, &mut sorted);
    }
    pending
}

/// Keeps `best` sorted by falling score and drops what does not fit.
fn insert_sorted(best: &mut FixedVec<Retrieved, MAX_RETRIEVED>, next: Retrieved) {
    let position = best.partition_point(|kept| kept.score >= next.score);
    if position == MAX_RETRIEVED {
        return;
    }
    if best.is_full() {
        best.pop();
    }
    // Cannot fail: there is room, and the position lies within.
    let _ = best.insert(position, next);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::Descriptor;
    use crate::vocabulary::{TrainingOptions, Vocabulary, Weighting, train};
    use proptest::prelude::*;

    fn vocabulary() -> Vocabulary {
        let images: Vec<Vec<Descriptor>> = (0..30_u8)
            .map(|i| (0..3).map(|j| Descriptor([(i * 3 + j).wrapping_mul(37); 32])).collect())
            .collect();
        train(&images, TrainingOptions { branching: 6, depth: 2, ..TrainingOptions::default() }).unwrap()
    }

    fn score_by_definition(a: &BowVector, b: &BowVector) -> f32 {
        let weight = |bow: &BowVector, word: u32| {
            bow.entries().iter().find(|entry| entry.0 == WordId(word)).map_or(0.0, |entry| entry.1 as f32)
        };
        1.0 - 0.5 * (0..100).map(|word| (weight(a, word) - weight(b, word)).abs()).sum::<f32>()
    }

    proptest! {
        #[test]
        fn the_index_finds_what_comparing_with_every_image_finds(
            images in proptest::collection::vec(proptest::collection::vec(0..20_u32, 1..12), 1..4 * MOST_IMAGES),
            query in proptest::collection::vec(0..20_u32, 1..12),
            unwanted in 0..30_u32,
            asked_in_between in any::<bool>(),
        ) {
            let vocabulary = vocabulary();
            let bow = |words: &[u32]| BowVector::new(words.iter().copied().map(WordId), &vocabulary);
            let mut index = InvertedIndex::default();
            for image in &images {
                index.add(&bow(image));
                if asked_in_between {
                    index.query(&BowVector::default(), |_| true);
                }
            }
            let wanted = |document: DocumentId| document.0 != unwanted;
            let mut expected: Vec<(f32, usize)> = images.iter().enumerate()
                .filter(|&(document, _)| document as u32 != unwanted)
                .map(|(document, image)| (score_by_definition(&bow(&query), &bow(image)), document))
                .filter(|&(score, _)| score > 1e-5).collect();
            expected.sort_by(|a, b| b.0.total_cmp(&a.0));
            for _ in 0..2 {
                let found = index.query(&bow(&query), wanted);
                prop_assert_eq!(found.len(), expected.len().min(MAX_RETRIEVED));
                for (found, expected) in found.iter().zip(&expected) {
                    prop_assert!((found.score - expected.0).abs() < 1e-5);
                    let own = score_by_definition(&bow(&query), &bow(&images[found.document.0 as usize]));
                    prop_assert!((found.score - own).abs() < 1e-5);
                }
            }
        }
    }

    #[test]
    fn of_images_that_score_the_same_the_oldest_are_found_in_their_order() {
        let bow = BowVector::weighted([(WordId(1), 1.0), (WordId(2), 1.0)], Weighting::TfIdf);
        let mut index = InvertedIndex::default();
        for _ in 0..3 * SCORES_AT_ONCE {
            index.add(&bow);
        }
        let found: Vec<u32> = index.query(&bow, |_| true).iter().map(|found| found.document.0).collect();
        assert_eq!(found, (0..MAX_RETRIEVED as u32).collect::<Vec<_>>());
    }

    proptest! {
        #[test]
        fn where_repetitions_count_a_renamed_word_counts_as_if_it_had_been_the_other_one_from_the_start(
            images in proptest::collection::vec(proptest::collection::vec(0..200_u32, 1..12), 1..2 * MOST_IMAGES),
            query in proptest::collection::vec(0..200_u32, 1..12),
        ) {
            // Words of a hundred and more, a third of them rare.
            let others: Vec<_> = (100..200).map(|word| (WordId(word), WordId(word / 3))).collect();
            let weighted = |words: &[u32], other: fn(u32) -> u32| {
                BowVector::weighted(words.iter().map(|&word| (WordId(other(word)), 1.0)), Weighting::TfIdf)
            };
            let (mut renamed, mut expected) = (InvertedIndex::default(), InvertedIndex::default());
            for image in &images {
                renamed.add(&weighted(image, |word| word));
                expected.add(&weighted(image, |word| if word < 100 { word } else { word / 3 }));
            }
            renamed.rename(&others);
            prop_assert!(!(100..200).any(|word| renamed.shows(WordId(word))));
            let query = weighted(&query, |word| word % 100);
            prop_assert_eq!(renamed.query(&query, |_| true), expected.query(&query, |_| true));
        }
    }

    #[test]
    fn blocks_stay_few_however_images_come() {
        let bow = BowVector::weighted([(WordId(1), 1.0)], Weighting::TfIdf);
        for at_once in [1, 3, 5, 17, 1000] {
            let mut index = InvertedIndex::default();
            for image in 0..10 * MOST_IMAGES {
                index.add(&bow);
                if image % at_once == 0 {
                    index.settle();
                }
            }
            let lengths: Vec<usize> = index.blocks.iter().map(|block| block.images().len()).collect();
            assert_eq!(lengths.iter().sum::<usize>() + index.pending.images.len(), 10 * MOST_IMAGES);
            assert!(lengths.iter().all(|&length| length <= MOST_IMAGES), "{lengths:?}");
            // A small one, one of each size from four on, and the full ones, some of which are so but for a few images.
            assert!(lengths.len() <= 1 + 5 + 14, "{lengths:?}");
        }
    }

    #[test]
    fn a_block_none_of_whose_images_is_good_enough_is_not_read_to_its_end() {
        let weighted = |words: &[(u32, f64)]| {
            let words = words.iter().map(|&(word, weight)| (WordId(word), weight));
            BowVector::weighted(words, Weighting::TfIdf)
        };
        // The rare word weighs nine tenths.
        let (both, frequent) = (weighted(&[(1, 9.0), (2, 1.0)]), weighted(&[(2, 1.0), (3, 9.0)]));
        let mut index = InvertedIndex::default();
        index.add(&frequent);
        index.settle();
        let mut query = Query::default();
        query.ask(&both);
        let mut sums = [0.0; MOST_IMAGES];
        assert!(!index.blocks[0].score(&mut query, 0.5, &mut sums));
        assert_eq!(sums, [0.0; MOST_IMAGES]);
        assert!(index.blocks[0].score(&mut query, 0.05, &mut sums), "the frequent word alone reaches it");
        assert!((sums[0] - 0.1).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn what_was_removed_is_found_no_more_and_its_place_is_taken(
            steps in proptest::collection::vec((proptest::collection::vec(0..20_u32, 1..12), 0..3_u32), 1..400),
            query in proptest::collection::vec(0..20_u32, 1..12),
        ) {
            let vocabulary = vocabulary();
            let bow = |words: &[u32]| BowVector::new(words.iter().copied().map(WordId), &vocabulary);
            let mut index = InvertedIndex::default();
            let mut known: Vec<(DocumentId, Vec<u32>)> = Vec::new();
            for (words, removals) in steps {
                for _ in 0..removals.min(known.len() as u32) {
                    let (document, _) = known.remove(words[0] as usize % known.len());
                    index.remove(document);
                    index.remove(document);
                }
                known.push((index.add(&bow(&words)), words));
                prop_assert_eq!(index.len(), known.len());
            }
            let mut expected: Vec<f32> =
                known.iter().map(|(_, words)| score_by_definition(&bow(&query), &bow(words))).collect();
            expected.retain(|&score| score > 1e-5);
            expected.sort_by(|a, b| b.total_cmp(a));
            let found = index.query(&bow(&query), |_| true);
            prop_assert_eq!(found.len(), expected.len().min(MAX_RETRIEVED));
            for (found, expected) in found.iter().zip(&expected) {
                prop_assert!((found.score - expected).abs() < 1e-5);
                let words = &known.iter().find(|(document, _)| *document == found.document).unwrap().1;
                prop_assert!((score_by_definition(&bow(&query), &bow(words)) - expected).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn a_word_that_weighs_next_to_nothing_finds_no_image_twice() {
        let bow = BowVector::weighted([(WordId(1), 1.0), (WordId(2), 1e-300)], Weighting::Idf);
        let mut index = InvertedIndex::default();
        index.add(&BowVector::weighted([(WordId(2), 1e-300), (WordId(3), 1.0)], Weighting::Idf));
        let own = index.add(&bow);
        assert_eq!(index.query(&bow, |_| true).as_slice(), [Retrieved { document: own, score: 1.0 }]);
    }

    #[test]
    fn an_image_scores_one_against_itself_and_leads() {
        let vocabulary = vocabulary();
        let mut index = InvertedIndex::default();
        let one = BowVector::new([1, 2, 3].map(WordId), &vocabulary);
        index.add(&BowVector::new([3, 4, 5].map(WordId), &vocabulary));
        let own = index.add(&one);
        let found = index.query(&one, |_| true);
        assert_eq!(found[0].document, own);
        assert!((found[0].score - 1.0).abs() < 1e-6);
        assert!(index.query(&BowVector::default(), |_| true).is_empty());
    }
}
