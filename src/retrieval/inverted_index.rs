//! The inverted index: for every word the images that show it.

use heapless::Vec as FixedVec;

use super::BowVector;
use super::posting_lists::{Posting, PostingLists};
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

/// Postings that wait at most, while many images are added in a row: 12 bytes each, and as many again while they are
/// sorted.
const MOST_PENDING: usize = if cfg!(test) { 50 } else { 1 << 19 };
/// Scores that are looked at together: few documents are better than the best ones so far.
const SCORES_AT_ONCE: usize = 64;
/// Share of the documents, and fewest, that may be removed before their postings are swept out.
const SWEEP_SHARE: usize = 8;
const FEWEST_SWEPT: usize = 64;

/// Images, each under its words.
#[derive(Default)]
pub struct InvertedIndex {
    /// Each sorted by document.
    postings: PostingLists,
    /// Postings of the newest documents that are not in the lists yet: those lie far apart in memory, and each is
    /// visited once for many images.
    pending: Vec<(WordId, Posting)>,
    /// Score of each document in the query under way; all zero in between.
    accumulators: Vec<f32>,
    is_removed: Vec<bool>,
    /// Documents that were removed and still have postings.
    unswept: Vec<u32>,
    /// Numbers of swept documents, to be given again.
    free: Vec<u32>,
}

impl InvertedIndex {
    /// Indexes an image. Numbers of removed ones are given again.
    pub fn add(&mut self, bow: &BowVector) -> DocumentId {
        let reused = self.free.pop();
        let document = reused.unwrap_or(self.accumulators.len() as u32);
        let postings = weights(bow).map(|(word, weight)| (word, Posting { document, weight }));
        if reused.is_some() {
            // Nothing is pending while numbers are free: what freed them has settled it.
            self.is_removed[document as usize] = false;
            for (word, posting) in postings {
                let postings = self.postings.get_mut(word);
                let position = postings.partition_point(|known| known.document < document);
                postings.insert(position, posting);
            }
        } else {
            self.accumulators.push(0.0);
            self.is_removed.push(false);
            self.pending.extend(postings);
            if self.pending.len() >= MOST_PENDING {
                self.settle();
            }
        }
        DocumentId(document)
    }

    /// Puts what is pending into the lists.
    fn settle(&mut self) {
        for run in sorted(std::mem::take(&mut self.pending)).chunk_by(|one, next| one.0 == next.0) {
            self.postings.get_mut(run[0].0).extend(run.iter().map(|&(_, posting)| posting));
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

    /// Frees the memory of what was removed.
    pub fn sweep(&mut self) {
        self.settle();
        let is_removed = &self.is_removed;
        self.postings.retain(|posting| !is_removed[posting.document as usize]);
        self.free.append(&mut self.unswept);
    }

    /// Whether some image shows `word`.
    #[must_use]
    pub fn shows(&self, word: WordId) -> bool {
        !self.postings.get(word).is_empty() || self.pending.iter().any(|pending| pending.0 == word)
    }

    /// From now on, what was indexed as `word` counts as `other`, with the weight that it has; the weights of an
    /// image that shows both are added up. Where repetitions count (tf-idf, tf) and both words weigh the same, that
    /// is as if they had been one from the start; where they do not (idf, binary), such an image counts it twice.
    pub fn merge(&mut self, word: WordId, other: WordId) {
        self.settle();
        for posting in self.postings.take(word) {
            let postings = self.postings.get_mut(other);
            match postings.binary_search_by_key(&posting.document, |known| known.document) {
                Ok(position) => postings[position].weight += posting.weight,
                Err(position) => postings.insert(position, posting),
            }
        }
    }

    /// Number of indexed images.
    #[must_use]
    pub fn len(&self) -> usize {
        self.accumulators.len() - self.free.len() - self.unswept.len()
    }

    /// Whether no image is indexed.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The images that `wanted` accepts and that score best, best first, at most [`MAX_RETRIEVED`].
    ///
    /// For vectors of length one, 1 − ½ Σ|v − w| = Σ min(v, w) over the common words.
    pub fn query(
        &mut self,
        bow: &BowVector,
        wanted: impl Fn(DocumentId) -> bool,
    ) -> FixedVec<Retrieved, MAX_RETRIEVED> {
        self.settle();
        let accumulators = self.accumulators.as_mut_slice();
        for (word, weight) in weights(bow) {
            for posting in self.postings.get(word) {
                accumulators[posting.document as usize] += weight.min(posting.weight);
            }
        }
        // In the order of the documents, so that of equal scores the older one wins.
        let mut best = FixedVec::new();
        for (chunk, scores) in accumulators.chunks_mut(SCORES_AT_ONCE).enumerate() {
            let worst =
                if best.is_full() { best.last().map_or(0.0, |worst: &Retrieved| worst.score) } else { 0.0 };
            let most = scores.iter().fold(0.0, |most: f32, &score| most.max(score));
            if most > worst {
                for (document, &score) in (chunk * SCORES_AT_ONCE..).zip(&*scores) {
                    let found = Retrieved { document: DocumentId(document as u32), score };
                    if score > 0.0 && !self.is_removed[document] && wanted(found.document) {
                        insert_sorted(&mut best, found);
                    }
                }
            }
            scores.fill(0.0);
        }
        best
    }
}

/// The words of an image that weigh something also in 32 bits.
fn weights(bow: &BowVector) -> impl Iterator<Item = (WordId, f32)> {
    bow.entries().iter().map(|&(word, weight)| (word, weight as f32)).filter(|&(_, weight)| weight > 0.0)
}

/// The same postings by word; those of one word stay in their order. So each list is visited once, and the lists in the
/// order in which they lie.
fn sorted(mut pending: Vec<(WordId, Posting)>) -> Vec<(WordId, Posting)> {
    let most = pending.iter().map(|(word, _)| word.0).max().unwrap_or(0);
    let digit_bits = (u32::BITS - most.leading_zeros()).div_ceil(2);
    let mut sorted = pending.clone();
    let mut ends = vec![0; (1 << digit_bits) + 1];
    for shift in [0, digit_bits] {
        let digit = |word: WordId| (word.0 >> shift) as usize & ((1 << digit_bits) - 1);
        ends.fill(0);
        pending.iter().for_each(|&(word, _)| ends[digit(word) + 1] += 1);
        (1..ends.len()).for_each(|digit| ends[digit] += ends[digit - 1]);
        for &next in &pending {
            let end = &mut ends[digit(next.0)];
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
            images in proptest::collection::vec(proptest::collection::vec(0..20_u32, 1..12), 1..30),
            query in proptest::collection::vec(0..20_u32, 1..12),
            unwanted in 0..30_u32,
        ) {
            let vocabulary = vocabulary();
            let bow = |words: &[u32]| BowVector::new(words.iter().copied().map(WordId), &vocabulary);
            let mut index = InvertedIndex::default();
            for image in &images {
                index.add(&bow(image));
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

    #[test]
    fn where_repetitions_count_a_merged_word_counts_as_if_it_had_been_the_other_one_from_the_start() {
        let weighted = |words: &[u32]| {
            BowVector::weighted(words.iter().map(|&word| (WordId(word), 1.0)), Weighting::TfIdf)
        };
        let images: [&[u32]; 4] = [&[1, 2, 3], &[9, 2, 3], &[1, 9, 9], &[9]];
        let (mut merged, mut expected) = (InvertedIndex::default(), InvertedIndex::default());
        for image in images {
            merged.add(&weighted(image));
            let renamed: Vec<u32> = image.iter().map(|&word| if word == 9 { 1 } else { word }).collect();
            expected.add(&weighted(&renamed));
        }
        merged.merge(WordId(9), WordId(1));
        merged.merge(WordId(7), WordId(1));
        for query in [&[1_u32] as &[u32], &[1, 1, 2], &[2, 3], &[9]] {
            assert_eq!(merged.query(&weighted(query), |_| true), expected.query(&weighted(query), |_| true));
        }
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
