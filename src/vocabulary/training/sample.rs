//! A uniform sample of the descriptors of a corpus, in their order.

use std::ops::ControlFlow;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::TrainingWatcher;
use super::corpus::Corpus;
use crate::feature::Descriptor;
use crate::vocabulary::VocabularyError;

/// At most `most` descriptors, every set of so many equally likely (selection sampling: Knuth, *The Art of
/// Computer Programming* 2, 3.4.2 S).
pub(super) fn draw(
    corpus: &dyn Corpus,
    (most, seed): (u64, u64),
    watcher: &dyn TrainingWatcher,
) -> Result<Vec<Descriptor>, VocabularyError> {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut left = corpus.descriptor_count();
    let mut wanted = left.min(most);
    let mut sample = Vec::with_capacity(wanted as usize);
    corpus.visit(&mut |image| {
        if !watcher.goes_on() {
            return ControlFlow::Break(());
        }
        for &descriptor in image {
            if wanted == left || random.random_range(0..left) < wanted {
                sample.push(descriptor);
                wanted -= 1;
            }
            left -= 1;
        }
        ControlFlow::Continue(())
    })?;
    if watcher.goes_on() { Ok(sample) } else { Err(VocabularyError::Interrupted) }
}

#[cfg(test)]
mod tests {
    use super::super::corpus::MemoryCorpus;
    use super::*;

    #[test]
    fn every_descriptor_is_as_likely_to_be_drawn() {
        let images: Vec<Vec<Descriptor>> = (0..10_u8)
            .map(|image| (0..6).map(|index| Descriptor([image * 6 + index; 32])).collect())
            .collect();
        let mut drawn = [0; 60];
        for seed in 0..2000 {
            let sample = draw(&MemoryCorpus::from(&images[..]), (15, seed), &()).unwrap();
            assert_eq!(sample.len(), 15);
            sample.iter().for_each(|descriptor| drawn[usize::from(descriptor.0[0])] += 1);
        }
        // 500 expected with a standard deviation of 19.
        assert!(drawn.iter().all(|count| (400..600).contains(count)), "{drawn:?}");
    }

    #[test]
    fn a_corpus_that_fits_is_taken_whole() {
        let images = [vec![Descriptor([1; 32])], vec![], vec![Descriptor([2; 32]), Descriptor([3; 32])]];
        assert_eq!(draw(&MemoryCorpus::from(&images[..]), (100, 1), &()).unwrap(), images.concat());
    }
}
