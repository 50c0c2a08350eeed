//! How often each word is seen, in how many images, and how well the words fit.

use std::ops::ControlFlow;

use rayon::prelude::*;

use super::corpus::Corpus;
use super::{TrainingProgress, TrainingWatcher};
use crate::feature::Descriptor;
use crate::vocabulary::{Quantised, Vocabulary, VocabularyError};

/// Images that are quantised side by side.
const BATCH_IMAGES: usize = 256;

/// Counts over a corpus.
pub(super) struct WordStatistics {
    /// Images that show each word.
    images_with: Vec<u32>,
    /// Descriptors in each word.
    occupancy: Vec<u32>,
    images: u64,
    descriptors: u64,
    distortion_bits: u64,
}

/// Quantises every image of `corpus`, on all cores.
pub(super) fn count(
    vocabulary: &Vocabulary,
    corpus: &dyn Corpus,
    watcher: &dyn TrainingWatcher,
) -> Result<WordStatistics, VocabularyError> {
    let words = vocabulary.word_count() as usize;
    let mut statistics = WordStatistics {
        images_with: vec![0; words],
        occupancy: vec![0; words],
        images: 0,
        descriptors: 0,
        distortion_bits: 0,
    };
    let total = corpus.image_count();
    let mut batch: Vec<Vec<Descriptor>> = Vec::with_capacity(BATCH_IMAGES);
    let mut count = |batch: &mut Vec<Vec<Descriptor>>| {
        let quantised: Vec<Vec<Quantised>> =
            batch.par_iter().map(|image| vocabulary.quantise_all(image)).collect();
        quantised.into_iter().for_each(|image| statistics.add(image));
        batch.clear();
        watcher.note(TrainingProgress::Weighing { done: statistics.images, total });
    };
    corpus.visit(&mut |image| {
        if !watcher.goes_on() {
            return ControlFlow::Break(());
        }
        batch.push(image.to_vec());
        if batch.len() == BATCH_IMAGES {
            count(&mut batch);
        }
        ControlFlow::Continue(())
    })?;
    count(&mut batch);
    if watcher.goes_on() { Ok(statistics) } else { Err(VocabularyError::Interrupted) }
}

impl WordStatistics {
    fn add(&mut self, mut image: Vec<Quantised>) {
        self.images += 1;
        self.descriptors += image.len() as u64;
        self.distortion_bits += image.iter().map(|quantised| u64::from(quantised.distance_bits)).sum::<u64>();
        image.sort_unstable_by_key(|quantised| quantised.word);
        for run in image.chunk_by(|a, b| a.word == b.word) {
            let word = run[0].word.0 as usize;
            self.images_with[word] += 1;
            self.occupancy[word] = self.occupancy[word].saturating_add(run.len() as u32);
        }
    }

    /// ln(N / Nᵢ) of every word: N images in all, Nᵢ of them show it; 0 if none does.
    pub(super) fn inverse_document_frequencies(&self) -> Vec<f64> {
        let total = self.images as f64;
        let weight = |&count: &u32| if count == 0 { 0.0 } else { (total / f64::from(count)).ln() };
        self.images_with.iter().map(weight).collect()
    }

    pub(super) fn empty_words(&self) -> u32 {
        self.occupancy.iter().filter(|&&descriptors| descriptors == 0).count() as u32
    }

    pub(super) fn median_occupancy(&self) -> u32 {
        let mut occupancy = self.occupancy.clone();
        let middle = occupancy.len() / 2;
        *occupancy.select_nth_unstable(middle).1
    }

    pub(super) fn max_occupancy(&self) -> u32 {
        self.occupancy.iter().copied().max().unwrap_or(0)
    }

    pub(super) fn mean_distortion_bits(&self) -> f64 {
        self.distortion_bits as f64 / self.descriptors as f64
    }
}
