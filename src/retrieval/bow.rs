//! The bag of words of an image: a sparse vector of weighted words.

use crate::vocabulary::{Vocabulary, Weighting, WordId};

/// A sparse vector of L1 length 1 (or empty), sorted by word.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BowVector {
    entries: Vec<(WordId, f64)>,
    /// How often each of the words counts.
    repetitions: Vec<u16>,
    /// L1 length before it was made 1.
    length: f64,
}

/// A word of an image as it was before the image's vector was made as long as every other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WeighedWord {
    pub(super) word: WordId,
    /// What the word weighs, in every image the same.
    pub(super) weight: f32,
    /// How often it counts.
    pub(super) repetitions: u16,
}

impl BowVector {
    /// The vector of an image that shows `words`, weighted as `vocabulary` says.
    #[must_use]
    pub fn new(words: impl IntoIterator<Item = WordId>, vocabulary: &Vocabulary) -> Self {
        let (mut words, mut bow): (Vec<WordId>, _) = (words.into_iter().collect(), Self::default());
        bow.fill(&mut words, vocabulary);
        bow
    }

    /// From now on the vector of an image that shows `words`, which are put in order, weighted as `vocabulary` says.
    pub fn fill(&mut self, words: &mut [WordId], vocabulary: &Vocabulary) {
        // Sorted without their weights, which then are read in the order in which they lie.
        words.sort_unstable();
        let weights = vocabulary.weights();
        self.fill_weighted(words.iter().map(|&word| (word, weights.of(word))), vocabulary.weighting());
    }

    /// The vector of an image that shows words, each with its weight. Words that weigh nothing,
    /// such as those that every training image shows, are left out.
    ///
    /// Weights are added up and divided in the order of DBoW2, so that the same words give the same vector to
    /// the last bit (for its scorings L1, χ², KL and Bhattacharyya, which all want vectors of L1 length 1).
    #[must_use]
    pub fn weighted(words: impl IntoIterator<Item = (WordId, f64)>, weighting: Weighting) -> Self {
        let mut bow = Self::default();
        bow.fill_weighted(words, weighting);
        bow
    }

    /// From now on the vector that [`weighted`](Self::weighted) makes.
    pub fn fill_weighted(&mut self, words: impl IntoIterator<Item = (WordId, f64)>, weighting: Weighting) {
        let Self { entries, repetitions, length } = self;
        entries.clear();
        entries.extend(words);
        entries.retain(|word| word.1 > 0.0);
        entries.sort_unstable_by_key(|word| word.0);
        repetitions.clear();
        repetitions.extend(entries.first().map(|_| 1));
        entries.dedup_by(|next, kept| {
            let is_again = next.0 == kept.0;
            match repetitions.last_mut() {
                Some(count) if is_again && weighting.counts_repetitions() => {
                    // A sum, not a product: the rounding differs.
                    kept.1 += next.1;
                    *count = count.saturating_add(1);
                }
                _ if is_again => {}
                _ => repetitions.push(1),
            }
            is_again
        });
        *length = entries.iter().map(|entry| entry.1).sum();
        for (_, weight) in entries {
            *weight /= *length;
        }
    }

    /// Words with their weights, sorted by word.
    #[must_use]
    pub fn entries(&self) -> &[(WordId, f64)] {
        &self.entries
    }

    /// L1 length that the weighed words have together.
    pub(super) fn length(&self) -> f64 {
        self.length
    }

    /// The words that weigh something also in 32 bits, sorted by word.
    pub(super) fn weighed_words(&self) -> impl Iterator<Item = WeighedWord> {
        let words = self.entries.iter().zip(&self.repetitions).filter(|((_, share), _)| *share as f32 > 0.0);
        words.map(|(&(word, share), &repetitions)| {
            let weight = (share * self.length / f64::from(repetitions)) as f32;
            WeighedWord { word, weight, repetitions }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::path::Path;

    use super::*;
    use crate::feature::Descriptor;
    use crate::retrieval::InvertedIndex;
    use crate::vocabulary::import;

    const TEXT: &[u8] = include_bytes!("../../tests/data/vocabulary/orb_k8_l3.txt");
    const YAML: &[u8] = include_bytes!("../../tests/data/vocabulary/orb_k8_l3.yml.gz");
    const DBOW3: &[u8] = include_bytes!("../../tests/data/vocabulary/orb_k8_l3.dbow3");
    const QUERIES: &[u8] = include_bytes!("../../tests/data/vocabulary/queries.bin");
    /// What DBoW2 computes of the queries: `tests/data/vocabulary/README.md`.
    const BAGS: &str = include_str!("../../tests/data/vocabulary/bow_dbow2.csv");
    const SCORES: &str = include_str!("../../tests/data/vocabulary/scores_dbow2.csv");

    /// The vectors of the six images by the vocabulary in `file`.
    fn vectors(file: &[u8]) -> Vec<BowVector> {
        let vocabulary = import::from_bytes(file, Path::new("voc")).unwrap().1;
        let (mut vectors, mut rest) = (Vec::new(), QUERIES);
        while let Some((count, tail)) = rest.split_first_chunk::<4>() {
            let (image, tail) = tail.split_at(u32::from_le_bytes(*count) as usize * 32);
            let words = image.as_chunks().0.iter().map(|&bytes| vocabulary.quantise(&Descriptor(bytes)).word);
            vectors.push(BowVector::new(words, &vocabulary));
            rest = tail;
        }
        vectors
    }

    fn dbow2_bags() -> Vec<BTreeMap<u32, f64>> {
        let mut bags = vec![BTreeMap::new(); 6];
        for line in BAGS.lines().skip(1) {
            let fields: Vec<&str> = line.split(',').collect();
            let image: usize = fields[0].parse().unwrap();
            bags[image].insert(fields[1].parse().unwrap(), fields[2].parse().unwrap());
        }
        bags
    }

    fn bag(vector: &BowVector) -> BTreeMap<u32, f64> {
        vector.entries().iter().map(|&(word, value)| (word.0, value)).collect()
    }

    #[test]
    fn vectors_of_an_imported_vocabulary_equal_those_of_dbow2_to_the_last_bit() {
        for file in [TEXT, YAML] {
            assert_eq!(vectors(file).iter().map(bag).collect::<Vec<_>>(), dbow2_bags());
        }
    }

    #[test]
    fn vectors_of_a_dbow3_file_are_those_of_dbow2_but_for_the_digits_of_its_weights() {
        for (vector, expected) in vectors(DBOW3).iter().map(bag).zip(dbow2_bags()) {
            assert!(vector.keys().eq(expected.keys()));
            assert!(vector.iter().all(|(word, value)| (value - expected[word]).abs() < 1e-9));
        }
    }

    #[test]
    fn the_index_scores_as_dbow2_does() {
        let vectors = vectors(DBOW3);
        let mut index = InvertedIndex::default();
        for vector in &vectors {
            index.add(vector);
        }
        let mut compared = 0;
        for line in SCORES.lines().filter(|line| line.starts_with("L1,")) {
            let fields: Vec<&str> = line.split(',').collect();
            let [query, document] = [1, 2].map(|field| fields[field].parse::<usize>().unwrap());
            let found = index.query(&vectors[query], |_| true);
            let found = found.iter().find(|retrieved| retrieved.document.0 as usize == document);
            let (got, expected) = (found.map_or(0.0, |f| f.score), fields[3].parse::<f32>().unwrap());
            assert!((got - expected).abs() < 1e-6, "{line}: {got}");
            compared += 1;
        }
        assert_eq!(compared, 36);
    }
}
