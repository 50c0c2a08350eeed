//! Training by hierarchical k-medians: every node's descriptors are split into k clusters around
//! binary centres, level by level; leaves become words, weighted by how few images show them.

use std::collections::VecDeque;
use std::path::Path;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::format::{self, Counts, Link};
use super::{Vocabulary, VocabularyError};
use crate::feature::Descriptor;

/// Rounds of k-medians after which a split is taken as it is. Splits settle in 5 to 20 rounds; this
/// only bounds one that goes back and forth between equally good answers.
const MAX_ROUNDS: usize = 100;

/// Settings of the training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrainingOptions {
    /// Children a node (k), 2 to 32; default 10.
    pub branching: u32,
    /// Levels below the root (L), 1 to 8; default 5.
    pub depth: u32,
    /// Seed of the random choice of first centres; default 1.
    pub seed: u64,
}

impl Default for TrainingOptions {
    fn default() -> Self {
        Self { branching: 10, depth: 5, seed: 1 }
    }
}

/// Learns a vocabulary from the descriptors of each training image.
///
/// # Errors
/// If there is no descriptor at all, or the options make no tree.
pub fn train(images: &[Vec<Descriptor>], options: TrainingOptions) -> Result<Vocabulary, VocabularyError> {
    let TrainingOptions { branching, depth, seed } = options;
    if !(2..=32).contains(&branching) || !(1..=8).contains(&depth) {
        return Err(VocabularyError::BadShape { branching, depth });
    }
    let descriptors: Vec<Descriptor> = images.iter().flatten().copied().collect();
    if descriptors.is_empty() {
        return Err(VocabularyError::NothingToLearn);
    }
    let mut tree = Tree::grow(descriptors, options, Pcg64::seed_from_u64(seed));
    let words = tree.number_the_words();
    let counts = Counts {
        branching,
        depth,
        nodes: tree.links.len() as u32,
        words,
        images: images.len() as u32,
        weighting: super::Weighting::TfIdf,
        luminance: None,
    };
    let unweighted = format::encode(&counts, &tree.centres, &tree.links, &vec![0.0; words as usize]);
    let path = Path::new("the trained vocabulary");
    let vocabulary = Vocabulary::from_bytes(unweighted, path)?;
    let weights = inverse_document_frequencies(&vocabulary, images);
    Vocabulary::from_bytes(format::encode(&counts, &tree.centres, &tree.links, &weights), path)
}

/// ln(N / Nᵢ): N images in all, Nᵢ of them show word i.
fn inverse_document_frequencies(vocabulary: &Vocabulary, images: &[Vec<Descriptor>]) -> Vec<f64> {
    let mut images_with_word = vec![0_u32; vocabulary.word_count() as usize];
    for image in images {
        let mut words: Vec<u32> =
            image.iter().map(|descriptor| vocabulary.quantise(descriptor).word.0).collect();
        words.sort_unstable();
        words.dedup();
        for word in words {
            images_with_word[word as usize] += 1;
        }
    }
    let total = images.len() as f64;
    let weight = |&count: &u32| if count == 0 { 0.0 } else { (total / f64::from(count)).ln() };
    images_with_word.iter().map(weight).collect()
}

/// A node whose descriptors, a run of the training set, may still be split.
struct Unsplit {
    node: usize,
    start: usize,
    end: usize,
    level: u32,
}

/// The growing tree, node 0 its root.
struct Tree {
    centres: Vec<[u8; 32]>,
    links: Vec<Link>,
}

const LEAF: Link = Link::Word(0);

impl Tree {
    fn grow(mut descriptors: Vec<Descriptor>, options: TrainingOptions, mut random: Pcg64) -> Self {
        let mut tree = Self { centres: vec![[0; 32]], links: vec![LEAF] };
        let mut queue = VecDeque::from([Unsplit { node: 0, start: 0, end: descriptors.len(), level: 0 }]);
        while let Some(Unsplit { node, start, end, level }) = queue.pop_front() {
            if level == options.depth || (end - start < 2 && node != 0) {
                continue;
            }
            let run = &mut descriptors[start..end];
            let split = split(run, options.branching as usize, &mut random);
            tree.links[node] =
                Link::Children { first: tree.links.len() as u32, children: split.len() as u32 };
            let mut start = start;
            for Cluster { centre, size } in split {
                queue.push_back(Unsplit {
                    node: tree.links.len(),
                    start,
                    end: start + size,
                    level: level + 1,
                });
                tree.centres.push(centre.0);
                tree.links.push(LEAF);
                start += size;
            }
        }
        tree
    }

    /// Gives every leaf its word, in the order of the nodes; answers how many there are.
    fn number_the_words(&mut self) -> u32 {
        let mut words = 0;
        for link in &mut self.links {
            if let Link::Word(word) = link {
                *word = words;
                words += 1;
            }
        }
        words
    }
}

/// A cluster of a split: its centre and how many descriptors it took.
#[derive(Debug)]
struct Cluster {
    centre: Descriptor,
    size: usize,
}

/// Splits `run` into at most `k` clusters and reorders it so that each is one run, in their order.
fn split(run: &mut [Descriptor], k: usize, random: &mut Pcg64) -> Vec<Cluster> {
    let mut centres = first_centres(run, k, random);
    let mut assignment = vec![usize::MAX; run.len()];
    for _ in 0..MAX_ROUNDS {
        if !assign(run, &centres, &mut assignment) {
            break;
        }
        centres = medians(run, &assignment, &centres);
    }
    let mut order: Vec<usize> = (0..run.len()).collect();
    order.sort_by_key(|&index| assignment[index]);
    let reordered: Vec<Descriptor> = order.iter().map(|&index| run[index]).collect();
    run.copy_from_slice(&reordered);
    let size = |cluster| assignment.iter().filter(|&&assigned| assigned == cluster).count();
    let clusters = centres.into_iter().enumerate();
    clusters.map(|(index, centre)| Cluster { centre, size: size(index) }).filter(|c| c.size > 0).collect()
}

/// k-means++ seeding: each further centre is drawn with probability proportional to the squared
/// distance to the nearest one so far. Fewer than `k` where the descriptors repeat.
fn first_centres(run: &[Descriptor], k: usize, random: &mut Pcg64) -> Vec<Descriptor> {
    let mut centres = vec![run[random.random_range(0..run.len())]];
    let mut nearest: Vec<u64> = vec![u64::MAX; run.len()];
    while centres.len() < k {
        let newest = centres[centres.len() - 1];
        for (distance, descriptor) in nearest.iter_mut().zip(run) {
            *distance = (*distance).min(u64::from(descriptor.distance(&newest)).pow(2));
        }
        let total: u64 = nearest.iter().sum();
        if total == 0 {
            break;
        }
        let mut drawn = random.random_range(0..total);
        let chosen = nearest.iter().position(|&distance| {
            let here = drawn < distance;
            drawn = drawn.saturating_sub(distance);
            here
        });
        centres.extend(chosen.map(|index| run[index]));
    }
    centres
}

/// Gives every descriptor its nearest centre, the first of equally near ones; whether any changed.
fn assign(run: &[Descriptor], centres: &[Descriptor], assignment: &mut [usize]) -> bool {
    let mut changed = false;
    for (descriptor, assigned) in run.iter().zip(assignment) {
        let distances = centres.iter().map(|centre| descriptor.distance(centre));
        let nearest = distances.zip(0..).min_by_key(|&(distance, _)| distance).map_or(0, |(_, index)| index);
        changed |= nearest != *assigned;
        *assigned = nearest;
    }
    changed
}

/// The bitwise majority of every cluster, a tie setting the bit; an empty cluster keeps its centre.
fn medians(run: &[Descriptor], assignment: &[usize], centres: &[Descriptor]) -> Vec<Descriptor> {
    let mut ones = vec![[0_u32; 256]; centres.len()];
    let mut sizes = vec![0_u32; centres.len()];
    for (descriptor, &cluster) in run.iter().zip(assignment) {
        sizes[cluster] += 1;
        for (byte, counters) in descriptor.0.iter().zip(ones[cluster].as_chunks_mut::<8>().0) {
            for (bit, counter) in counters.iter_mut().enumerate() {
                *counter += u32::from(byte >> bit & 1);
            }
        }
    }
    let median = |cluster: usize| {
        let mut bytes = [0; 32];
        for (byte, counters) in bytes.iter_mut().zip(ones[cluster].as_chunks::<8>().0) {
            for (bit, &counter) in counters.iter().enumerate() {
                *byte |= u8::from(counter >= sizes[cluster].div_ceil(2)) << bit;
            }
        }
        Descriptor(bytes)
    };
    (0..centres.len()).map(|c| if sizes[c] == 0 { centres[c] } else { median(c) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::Rng;

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
        TrainingOptions { branching, depth, seed: 3 }
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
    fn no_descriptors_and_bad_shapes_are_refused() {
        assert!(matches!(train(&[Vec::new()], options(4, 2)), Err(VocabularyError::NothingToLearn)));
        assert!(matches!(train(&images(2, 1), options(1, 2)), Err(VocabularyError::BadShape { .. })));
        assert!(matches!(train(&images(2, 1), options(4, 9)), Err(VocabularyError::BadShape { .. })));
    }

    proptest! {
        #[test]
        fn a_median_is_never_farther_from_its_cluster_than_any_member(
            run in proptest::collection::vec(any::<[u8; 32]>().prop_map(Descriptor), 1..12),
        ) {
            let median = medians(&run, &vec![0; run.len()], &run[..1])[0];
            let cost = |centre: &Descriptor| run.iter().map(|d| d.distance(centre)).sum::<u32>();
            prop_assert!(run.iter().all(|member| cost(&median) <= cost(member)));
        }

        #[test]
        fn a_split_keeps_every_descriptor_and_gives_each_its_nearest_centre(
            descriptors in proptest::collection::vec(any::<[u8; 32]>().prop_map(Descriptor), 2..60),
            k in 2..8_usize,
        ) {
            let mut run = descriptors.clone();
            let clusters = split(&mut run, k, &mut Pcg64::seed_from_u64(1));
            let mut start = 0;
            for cluster in &clusters {
                for descriptor in &run[start..start + cluster.size] {
                    let nearest = clusters.iter().map(|c| descriptor.distance(&c.centre)).min();
                    prop_assert_eq!(Some(descriptor.distance(&cluster.centre)), nearest);
                }
                start += cluster.size;
            }
            prop_assert_eq!(start, run.len());
            let sorted = |mut v: Vec<Descriptor>| { v.sort_by_key(|d| d.0); v };
            prop_assert_eq!(sorted(run), sorted(descriptors));
        }

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
