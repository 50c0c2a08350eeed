//! Training by hierarchical k-medians: every node's descriptors are split into k clusters around
//! binary centres, level by level; leaves become words, weighted by how few images show them.
//!
//! The images may be larger than memory: the tree grows from a uniform sample of their descriptors, weights
//! and figures come from passes over all of them. Every core takes part, and the same images and seed give
//! the same file whatever their number: each node has a random stream of its own, and all sums are of
//! integers.

mod clustering;
mod corpus;
mod sample;
mod tree_growth;
mod word_statistics;

pub use corpus::{Corpus, CorpusImage, MemoryCorpus, TrainingFile};

use std::path::Path;

use super::format::{self, Counts};
use super::{Vocabulary, VocabularyError, Weighting};
use crate::feature::Descriptor;

/// Most descriptors that a tree grows from: no word is empty of them and no node but the root has a single
/// child, so that its nodes are at most twice as many, which is what a file can hold.
const MAX_SAMPLE: u64 = format::MAX_NODES as u64 / 2;

/// Settings of the training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrainingOptions {
    /// Children a node (k), 2 to 32; default 10.
    pub branching: u32,
    /// Levels below the root (L), 1 to 8; default 5.
    pub depth: u32,
    /// Seed of the random choice of first centres and of the sample; default 1.
    pub seed: u64,
    /// Most descriptors that the tree grows from, 32 bytes of memory each and as many again while they are
    /// sorted; default 8,388,608, and more are never taken.
    pub most_descriptors: u64,
}

impl Default for TrainingOptions {
    fn default() -> Self {
        Self { branching: 10, depth: 5, seed: 1, most_descriptors: MAX_SAMPLE }
    }
}

impl TrainingOptions {
    /// Whether a tree can be grown so.
    ///
    /// # Errors
    /// If branching or depth is out of bounds.
    pub fn check(&self) -> Result<(), VocabularyError> {
        let Self { branching, depth, .. } = *self;
        if (2..=32).contains(&branching) && (1..=8).contains(&depth) {
            return Ok(());
        }
        Err(VocabularyError::BadShape { branching, depth })
    }
}

/// How far a training is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrainingProgress {
    /// Descriptors that found their cluster, of as many times the depth.
    Growing {
        /// So many.
        done: u64,
        /// Of so many.
        total: u64,
    },
    /// Images whose words were counted.
    Weighing {
        /// So many.
        done: u64,
        /// Of so many.
        total: u64,
    },
}

/// Whoever wants to know how far a training is, and may end it; `()` does neither.
pub trait TrainingWatcher: Sync {
    /// Takes note, from any thread.
    fn note(&self, _progress: TrainingProgress) {}

    /// Whether the training goes on; asked again within seconds.
    fn goes_on(&self) -> bool {
        true
    }
}

impl TrainingWatcher for () {}

/// A vocabulary, and how well it fits what it was trained on.
#[derive(Debug)]
pub struct Trained {
    /// The vocabulary.
    pub vocabulary: Vocabulary,
    /// Descriptors of all images.
    pub descriptors: u64,
    /// Descriptors that the tree grew from.
    pub sampled_descriptors: u64,
    /// Words that no descriptor falls into.
    pub empty_words: u32,
    /// Median number of descriptors in a word.
    pub median_occupancy: u32,
    /// Largest number of descriptors in a word.
    pub max_occupancy: u32,
    /// Mean Hamming distance of a descriptor to the centre of its word, in bits.
    pub mean_distortion_bits: f64,
}

/// Learns a vocabulary from the descriptors of each training image.
///
/// # Errors
/// If there is no descriptor at all, or the options make no tree.
pub fn train(images: &[Vec<Descriptor>], options: TrainingOptions) -> Result<Vocabulary, VocabularyError> {
    Ok(train_on(&MemoryCorpus::from(images), options, &())?.vocabulary)
}

/// Learns a vocabulary from `corpus`, on all cores, and tells `watcher` how far it is.
///
/// # Errors
/// If there is no descriptor at all, the options make no tree, the corpus cannot be read, or `watcher` ends it.
pub fn train_on(
    corpus: &dyn Corpus,
    options: TrainingOptions,
    watcher: &dyn TrainingWatcher,
) -> Result<Trained, VocabularyError> {
    let TrainingOptions { branching, depth, seed, most_descriptors } = options;
    options.check()?;
    let sample = sample::draw(corpus, (most_descriptors.min(MAX_SAMPLE), seed), watcher)?;
    if sample.is_empty() {
        return Err(VocabularyError::NothingToLearn);
    }
    let sampled_descriptors = sample.len() as u64;
    let tree = tree_growth::grow(sample, &options, watcher)?;
    let counts = Counts {
        branching,
        depth,
        nodes: tree.links.len() as u32,
        words: tree.words,
        images: 0,
        weighting: Weighting::TfIdf,
        luminance: None,
    };
    let file = format::encode(&counts, &tree.centres, &tree.links, &vec![0.0; tree.words as usize]);
    let unweighted = Vocabulary::from_bytes(file, Path::new("the trained vocabulary"))?;
    let statistics = word_statistics::count(&unweighted, corpus, watcher)?;
    Ok(Trained {
        vocabulary: weighted(&unweighted, corpus, &statistics.inverse_document_frequencies())?,
        descriptors: corpus.descriptor_count(),
        sampled_descriptors,
        empty_words: statistics.empty_words(),
        median_occupancy: statistics.median_occupancy(),
        max_occupancy: statistics.max_occupancy(),
        mean_distortion_bits: statistics.mean_distortion_bits(),
    })
}

/// The tree of `vocabulary` with the tf-idf weights that its words have in `corpus`: a vocabulary that came
/// without weights, or from other surroundings, learns which words are rare here. Words that no image shows weigh
/// nothing from then on, as in DBoW2's training.
///
/// # Errors
/// If there is no descriptor at all, no word would weigh anything, the corpus cannot be read, or `watcher` ends it.
pub fn weigh_on(
    vocabulary: &Vocabulary,
    corpus: &dyn Corpus,
    watcher: &dyn TrainingWatcher,
) -> Result<Vocabulary, VocabularyError> {
    if corpus.descriptor_count() == 0 {
        return Err(VocabularyError::NothingToLearn);
    }
    let weights = word_statistics::count(vocabulary, corpus, watcher)?.inverse_document_frequencies();
    if weights.iter().all(|&weight| weight == 0.0) {
        return Err(VocabularyError::NothingRare);
    }
    weighted(vocabulary, corpus, &weights)
}

fn weighted(
    vocabulary: &Vocabulary,
    corpus: &dyn Corpus,
    weights: &[f64],
) -> Result<Vocabulary, VocabularyError> {
    let images = u32::try_from(corpus.image_count()).unwrap_or(u32::MAX);
    vocabulary.weighted((images, corpus.mean_luminance()), weights)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    /// Images of a world with a few kinds of descriptor, each seen with some bits flipped.
    fn images(count: usize, seed: u64) -> Vec<Vec<Descriptor>> {
        let mut random = Pcg64::seed_from_u64(seed);
        let kinds: Vec<[u8; 32]> = (0..40).map(|_| random.random()).collect();
        let mut seen = |kind: usize| {
            let mut bytes = kinds[kind];
            for _ in 0..8 {
                bytes[random.random_range(0..32)] ^= 1 << random.random_range(0..8);
            }
            Descriptor(bytes)
        };
        (0..count).map(|image| (0..60).map(|index| seen((image * 3 + index) % 40)).collect()).collect()
    }

    fn options(branching: u32, depth: u32) -> TrainingOptions {
        TrainingOptions { branching, depth, seed: 3, ..TrainingOptions::default() }
    }

    #[test]
    fn the_same_seed_trains_the_same_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = |seed: u64, name: &str| {
            let path = folder.path().join(name);
            train(&images(20, 1), TrainingOptions { seed, ..options(4, 3) }).unwrap().save(&path).unwrap();
            std::fs::read(path).unwrap()
        };
        assert_eq!(file(5, "a"), file(5, "b"));
        assert_ne!(file(5, "a"), file(6, "c"));
    }

    #[test]
    fn a_trained_file_is_mapped_and_quantises_alike() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("v.lvoc");
        let images = images(20, 1);
        let trained = train(&images, options(5, 3)).unwrap();
        trained.save(&path).unwrap();
        let mapped = Vocabulary::open(&path).unwrap();
        mapped.verify(&path).unwrap();
        for descriptor in images.iter().flatten() {
            assert_eq!(mapped.quantise(descriptor), trained.quantise(descriptor));
        }
        assert!(mapped.word_count() > 25 && mapped.word_count() <= 125);
    }

    #[test]
    fn similar_descriptors_share_words_more_often_than_others() {
        let images = images(30, 2);
        let vocabulary = train(&images, options(6, 2)).unwrap();
        let word = |image: usize, index: usize| vocabulary.quantise(&images[image][index]).word;
        let same = (0..40).filter(|&i| word(0, i) == word(10, (i + 10) % 40)).count();
        let other = (0..40).filter(|&i| word(0, i) == word(10, (i + 23) % 40)).count();
        assert!(same > 2 * other + 5, "{same} {other}");
    }

    #[test]
    fn rare_words_weigh_more_than_common_ones() {
        let (common, rare) = (Descriptor([0; 32]), Descriptor([255; 32]));
        let images = vec![vec![common, rare], vec![common], vec![common], vec![common, rare]];
        let vocabulary = train(&images, options(2, 1)).unwrap();
        assert_eq!(vocabulary.weight(vocabulary.quantise(&common).word), 0.0);
        assert_eq!(vocabulary.weight(vocabulary.quantise(&rare).word), 2.0_f64.ln());
        assert_eq!(vocabulary.weight(crate::vocabulary::WordId(99)), 0.0);
    }

    #[test]
    fn words_are_weighed_on_other_images_without_a_change_of_the_tree() {
        let vocabulary = train(&images(20, 1), options(5, 3)).unwrap();
        let others = images(31, 1);
        let corpus = MemoryCorpus { images: &others, mean_luminance: Some(70.0) };
        let weighed = weigh_on(&vocabulary, &corpus, &()).unwrap();
        assert_eq!((weighed.image_count(), weighed.luminance()), (31, Some(70.0)));
        let shown = |image: &[Descriptor], word| image.iter().any(|d| vocabulary.quantise(d).word == word);
        for descriptor in &others[0] {
            let quantised = vocabulary.quantise(descriptor);
            assert_eq!(weighed.quantise(descriptor), quantised);
            let images_with = others.iter().filter(|image| shown(image, quantised.word)).count();
            assert_eq!(weighed.weight(quantised.word), (31.0 / images_with as f64).ln());
        }
        let nothing = MemoryCorpus::from(&[][..]);
        assert!(matches!(weigh_on(&vocabulary, &nothing, &()), Err(VocabularyError::NothingToLearn)));
    }

    #[test]
    fn a_word_that_no_image_shows_weighs_nothing_from_then_on() {
        let [one, two, unseen] = [0, 15, 255].map(|byte| Descriptor([byte; 32]));
        let vocabulary = train(&[one, two, unseen].map(|kind| vec![kind]), options(3, 1)).unwrap();
        let others = [vec![one], vec![two]];
        let weighed = weigh_on(&vocabulary, &MemoryCorpus::from(&others[..]), &()).unwrap();
        let weights = |descriptor| {
            let word = vocabulary.quantise(descriptor).word;
            (vocabulary.weight(word), weighed.weight(word))
        };
        assert_eq!(weights(&one), (3.0_f64.ln(), 2.0_f64.ln()));
        assert_eq!(weights(&unseen), (3.0_f64.ln(), 0.0));
    }

    #[test]
    fn images_that_all_show_the_same_words_weigh_none_and_are_refused() {
        let vocabulary = train(&images(20, 1), options(5, 3)).unwrap();
        let alike = vec![images(1, 1).concat(); 2];
        for images in [&alike[..1], &alike] {
            let weighed = weigh_on(&vocabulary, &MemoryCorpus::from(images), &());
            assert!(matches!(weighed, Err(VocabularyError::NothingRare)));
        }
    }

    #[test]
    fn every_node_but_the_root_is_a_word_or_has_several_children() {
        // Many equal descriptors, which no clustering can part.
        let images: Vec<Vec<Descriptor>> =
            (0..50_u8).map(|image| vec![Descriptor([image % 7; 32]), Descriptor([image; 32])]).collect();
        let vocabulary = train(&images, options(3, 8)).unwrap();
        assert_eq!(vocabulary.word_count(), 50);
        assert!(vocabulary.node_count() <= 2 * 50, "{}", vocabulary.node_count());
        let alike = [vec![Descriptor([1; 32]); 9]];
        assert_eq!(train(&alike, options(3, 8)).unwrap().node_count(), 2);
    }

    #[test]
    fn no_descriptors_and_bad_shapes_are_refused() {
        assert!(matches!(train(&[Vec::new()], options(4, 2)), Err(VocabularyError::NothingToLearn)));
        assert!(matches!(train(&images(2, 1), options(1, 2)), Err(VocabularyError::BadShape { .. })));
        assert!(matches!(train(&images(2, 1), options(4, 9)), Err(VocabularyError::BadShape { .. })));
    }

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let images = images(200, 4);
        let trained = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| train_on(&MemoryCorpus::from(&images[..]), options(5, 4), &()).unwrap())
        };
        let (one, three) = (trained(1), trained(3));
        let folder = tempfile::tempdir().unwrap();
        let bytes = |trained: &Trained, name: &str| {
            let path = folder.path().join(name);
            trained.vocabulary.save(&path).unwrap();
            std::fs::read(path).unwrap()
        };
        assert_eq!(bytes(&one, "one"), bytes(&three, "three"));
        assert_eq!(one.mean_distortion_bits, three.mean_distortion_bits);
    }

    #[test]
    fn the_figures_are_those_of_quantising_every_descriptor() {
        let images = images(20, 5);
        let trained = train_on(&MemoryCorpus::from(&images[..]), options(3, 3), &()).unwrap();
        let quantised: Vec<_> = images.iter().flatten().map(|d| trained.vocabulary.quantise(d)).collect();
        let distortion: u64 = quantised.iter().map(|q| u64::from(q.distance_bits)).sum();
        let mut occupancy = vec![0_u32; trained.vocabulary.word_count() as usize];
        quantised.iter().for_each(|q| occupancy[q.word.0 as usize] += 1);
        occupancy.sort_unstable();
        assert_eq!(trained.descriptors, quantised.len() as u64);
        assert!((trained.mean_distortion_bits - distortion as f64 / quantised.len() as f64).abs() < 1e-9);
        assert_eq!(Some(&trained.max_occupancy), occupancy.last());
        assert_eq!(trained.median_occupancy, occupancy[occupancy.len() / 2]);
    }

    #[test]
    fn a_training_ends_where_its_watcher_says_so() {
        struct Impatient(AtomicU32);
        impl TrainingWatcher for Impatient {
            fn goes_on(&self) -> bool {
                self.0.fetch_add(1, Ordering::Relaxed) < 20
            }
        }
        let images = images(40, 6);
        let corpus = MemoryCorpus::from(&images[..]);
        let impatient = Impatient(AtomicU32::new(0));
        assert!(matches!(train_on(&corpus, options(4, 3), &impatient), Err(VocabularyError::Interrupted)));
        assert!(impatient.0.into_inner() < 200, "it was not asked until the end");
        let vocabulary = train(&images, options(4, 3)).unwrap();
        let never = Impatient(AtomicU32::new(20));
        assert!(matches!(weigh_on(&vocabulary, &corpus, &never), Err(VocabularyError::Interrupted)));
    }

    #[test]
    fn a_small_sample_grows_the_tree_and_all_images_weigh_it() {
        let images = images(40, 6);
        let few = TrainingOptions { most_descriptors: 300, ..options(4, 3) };
        let trained = train_on(&MemoryCorpus::from(&images[..]), few, &()).unwrap();
        assert_eq!((trained.sampled_descriptors, trained.descriptors), (300, 2400));
        assert_eq!(trained.vocabulary.image_count(), 40);
        let heaviest =
            (0..trained.vocabulary.word_count()).map(|w| trained.vocabulary.weight(super::super::WordId(w)));
        assert!(heaviest.fold(0.0, f64::max) <= 40.0_f64.ln());
    }

    proptest! {
        #[test]
        fn a_damaged_file_is_refused_or_read_without_panic(
            position in any::<prop::sample::Index>(), flip in 1..=255_u8, cut in any::<prop::sample::Index>(),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("v");
            train(&images(3, 1), options(3, 2)).unwrap().save(&path).unwrap();
            let mut bytes = std::fs::read(&path).unwrap();
            prop_assert!(Vocabulary::from_bytes(bytes[..cut.index(bytes.len())].to_vec(), &path).is_err());
            let position = position.index(bytes.len());
            bytes[position] ^= flip;
            if let Ok(vocabulary) = Vocabulary::from_bytes(bytes, &path) {
                for descriptor in images(1, 9).iter().flatten() {
                    prop_assert!(vocabulary.weight(vocabulary.quantise(descriptor).word).is_finite());
                }
            }
        }
    }
}
