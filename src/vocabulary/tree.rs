//! The vocabulary as it is used: from descriptors to words, straight from the mapped file.

use std::path::Path;

use super::format::{self, Counts, KIND, Link, MAX_DEPTH, Tables};
use super::import::VocabularyFormat;
use super::{NodeId, VocabularyError, Weighting, WordId, version_1};
use crate::feature::Descriptor;
use crate::kernel;
use crate::storage::{FileBytes, StorageError, replace_file};

/// The level whose nodes serve as direct index, counted from the root.
const DIRECT_INDEX_LEVEL: u32 = 2;

/// Least weight that is not as good as none.
const LEAST_WEIGHT: f64 = 1e-30;

/// Largest weight that is believed; ln(N / Nᵢ) of a billion images is 21.
const MAX_WEIGHT: f64 = 1e6;

/// Bytes by which a foreign format is told, compressed or not.
const FORMAT_BYTES: usize = 512;

/// What the tree says of a descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quantised {
    /// Its visual word.
    pub word: WordId,
    /// The node it passed near the root.
    pub node: NodeId,
    /// Hamming distance to the centre of its word, in bits.
    pub distance_bits: u16,
}

/// A vocabulary tree, memory-mapped or just made.
#[derive(Debug)]
pub struct Vocabulary {
    bytes: FileBytes,
    counts: Counts,
    version: u32,
    file_bytes: usize,
}

impl Vocabulary {
    /// Maps the vocabulary file at `path`; nothing is copied. Header, counts and links are checked,
    /// the checksum only by [`verify`](Self::verify). A file of version 1 is read whole, checksum and
    /// all, and rewritten in memory.
    ///
    /// # Errors
    /// If the file cannot be read, is of another kind, newer, or damaged.
    pub fn open(path: &Path) -> Result<Self, VocabularyError> {
        Self::check(FileBytes::map(path)?, path)
    }

    /// A vocabulary from the bytes of a file; `path` only serves messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_bytes(bytes: Vec<u8>, path: &Path) -> Result<Self, VocabularyError> {
        Self::check(FileBytes::Owned(bytes), path)
    }

    pub(super) fn check(mut bytes: FileBytes, path: &Path) -> Result<Self, VocabularyError> {
        if let Some(format) = VocabularyFormat::of(&bytes[..bytes.len().min(FORMAT_BYTES)])
            && format != VocabularyFormat::Loci
        {
            return Err(VocabularyError::NotImported { path: path.to_owned(), format: format.as_str() });
        }
        let file_bytes = bytes.len();
        let (version, body) = KIND.body(&bytes, path)?;
        if version < KIND.version {
            KIND.verify(&bytes, path)?;
            let damaged = |reason| StorageError::Damaged { path: path.to_owned(), reason };
            bytes = FileBytes::Owned(version_1::rewritten(body).map_err(damaged)?);
        }
        let counts = format::check(&bytes, KIND.body(&bytes, path)?.1, path)?;
        Ok(Self { bytes, counts, version, file_bytes })
    }

    /// Compares the whole file with the checksum in its header.
    ///
    /// # Errors
    /// If they differ; `path` serves the message.
    pub fn verify(&self, path: &Path) -> Result<(), StorageError> {
        KIND.verify(&self.bytes, path)
    }

    /// Writes the vocabulary to `path`, whole or not at all.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), StorageError> {
        replace_file(path, &[&self.bytes])
    }

    /// The same tree with tf-idf `weights`, one a word, learnt from `images` of that mean luminance.
    pub(super) fn weighted(
        &self,
        (images, luminance): (u32, Option<f32>),
        weights: &[f64],
    ) -> Result<Self, VocabularyError> {
        let counts = Counts { images, luminance, weighting: Weighting::TfIdf, ..self.counts };
        let tables = self.tables();
        let links: Vec<Link> = tables.links.iter().copied().map(Link::from_bytes).collect();
        let file = format::encode(&counts, tables.descriptors, &links, weights);
        Self::from_bytes(file, Path::new("the weighted vocabulary"))
    }

    /// Most children a node.
    #[must_use]
    pub fn branching(&self) -> u32 {
        self.counts.branching
    }

    /// Most levels below the root.
    #[must_use]
    pub fn depth(&self) -> u32 {
        self.counts.depth
    }

    /// Number of nodes, the root included.
    #[must_use]
    pub fn node_count(&self) -> u32 {
        self.counts.nodes
    }

    /// Number of words.
    #[must_use]
    pub fn word_count(&self) -> u32 {
        self.counts.words
    }

    /// Number of images that its weights were learnt from; 0 if its source does not say.
    #[must_use]
    pub fn image_count(&self) -> u32 {
        self.counts.images
    }

    /// How its words weigh in a bag of words.
    #[must_use]
    pub fn weighting(&self) -> Weighting {
        self.counts.weighting
    }

    /// Mean luminance of the images that its weights were learnt from, 0 to 255, if it is known.
    #[must_use]
    pub fn luminance(&self) -> Option<f32> {
        self.counts.luminance
    }

    /// Length in bytes of the file that it was read from.
    #[must_use]
    pub fn length_bytes(&self) -> usize {
        self.file_bytes
    }

    /// Version of the file that it was read from.
    #[must_use]
    pub fn version(&self) -> u32 {
        self.version
    }

    /// What tells it from other vocabularies: its words mean the same under the same fingerprint.
    #[must_use]
    pub fn fingerprint(&self) -> u64 {
        u64::from(KIND.checksum(&self.bytes)) << 32 | u64::from(self.counts.nodes)
    }

    /// Weight of a word of this vocabulary, for tf-idf its inverse document frequency ln(N / Nᵢ). 0, as if
    /// every image showed it, for any other word, and where a damaged file says no sensible number.
    #[must_use]
    pub fn weight(&self, word: WordId) -> f64 {
        self.weights().of(word)
    }

    /// The weights of many words.
    pub(crate) fn weights(&self) -> Weights<'_> {
        Weights(self.tables().weights)
    }

    /// The word of `descriptor`: at every node the nearest child, of equally near ones the first.
    #[must_use]
    pub fn quantise(&self, descriptor: &Descriptor) -> Quantised {
        let mut descent = Descent::default();
        for level in 0..=MAX_DEPTH {
            if descent.step(self.tables(), descriptor, level) {
                break;
            }
        }
        descent.end()
    }

    /// The words of all `descriptors`, in their order: faster than one [`quantise`](Self::quantise) after the
    /// other, because while one descent waits for memory the others go on.
    #[must_use]
    pub fn quantise_all(&self, descriptors: &[Descriptor]) -> Vec<Quantised> {
        let mut quantised = Vec::with_capacity(descriptors.len());
        self.quantise_into(descriptors, &mut quantised);
        quantised
    }

    /// As [`quantise_all`](Self::quantise_all), written over what is in `quantised`.
    pub fn quantise_into(&self, descriptors: &[Descriptor], quantised: &mut Vec<Quantised>) {
        let tables = self.tables();
        quantised.clear();
        for descriptors in descriptors.chunks(SIDE_BY_SIDE) {
            let descents = &mut [Descent::default(); SIDE_BY_SIDE][..descriptors.len()];
            for level in 0..=MAX_DEPTH {
                if level >= NEAR_LEVELS {
                    descents.iter().for_each(|descent| descent.prefetch(tables));
                }
                let mut is_over = true;
                for (descent, descriptor) in descents.iter_mut().zip(descriptors) {
                    is_over &= descent.step(tables, descriptor, level);
                }
                if is_over {
                    break;
                }
            }
            quantised.extend(descents.iter().copied().map(Descent::end));
        }
    }

    /// Writes over what is in `groups` the number of the node near the root of every descriptor, as in
    /// [`Quantised::node`], without going on to its word: features under one node are compared.
    pub fn groups_into(&self, descriptors: &[Descriptor], groups: &mut Vec<u32>) {
        let tables = self.tables();
        let group = |descriptor| {
            let mut descent = Descent::default();
            for level in 0..DIRECT_INDEX_LEVEL {
                descent.step(tables, descriptor, level);
            }
            descent.node
        };
        groups.clear();
        groups.extend(descriptors.iter().map(group));
    }

    fn tables(&self) -> Tables<'_> {
        self.counts.tables(&self.bytes)
    }
}

/// Weights of words, in the order of the words.
pub(crate) struct Weights<'a>(&'a [[u8; 8]]);

impl Weights<'_> {
    /// As [`Vocabulary::weight`].
    #[inline]
    pub(crate) fn of(&self, word: WordId) -> f64 {
        let weight = self.0.get(word.0 as usize).map_or(0.0, |&bytes| f64::from_le_bytes(bytes));
        if (LEAST_WEIGHT..MAX_WEIGHT).contains(&weight) { weight } else { 0.0 }
    }
}

/// Descents that go side by side: so many that memory answers the last before the first is asked again, and so few that
/// what it brought is still near.
const SIDE_BY_SIDE: usize = 64;

/// So many levels from the root stay in the nearest cache by themselves, for all descents go through them.
const NEAR_LEVELS: u32 = 2;

/// A descriptor on its way down.
#[derive(Clone, Copy, Default)]
struct Descent {
    node: u32,
    word: Option<u32>,
    direct_index_node: u32,
    distance_bits: u16,
}

impl Descent {
    /// Has the children among which the next step chooses brought near.
    #[inline]
    fn prefetch(&self, tables: Tables<'_>) {
        if self.word.is_none()
            && let Link::Children { first, children } = Link::from_bytes(tables.links[self.node as usize])
        {
            kernel::prefetch(&tables.descriptors[first as usize..(first + children) as usize], usize::MAX);
        }
    }

    /// Goes one level down; whether a word is reached.
    #[inline]
    fn step(&mut self, tables: Tables<'_>, descriptor: &Descriptor, level: u32) -> bool {
        if self.word.is_some() {
            return true;
        }
        if level <= DIRECT_INDEX_LEVEL {
            self.direct_index_node = self.node;
        }
        match Link::from_bytes(tables.links[self.node as usize]) {
            Link::Word(word) => self.word = Some(word),
            Link::Children { first, children } => {
                let run = &tables.descriptors[first as usize..(first + children) as usize];
                let (nearest, distance) = kernel::nearest(&descriptor.0, run);
                self.node = first + nearest;
                self.distance_bits = distance as u16;
            }
        }
        self.word.is_some()
    }

    /// A tree deeper than [`MAX_DEPTH`], which only a damaged file holds, ends in word 0.
    fn end(self) -> Quantised {
        let Self { word, direct_index_node, distance_bits, .. } = self;
        Quantised { word: WordId(word.unwrap_or(0)), node: NodeId(direct_index_node), distance_bits }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VERSION_1: &[u8] = include_bytes!("../../tests/data/vocabulary/version_1.lvoc");

    /// The word of `descriptor` and its weight by the description of version 1, link by link.
    fn by_version_1(descriptor: &Descriptor) -> (u32, f32) {
        let u32_at = |offset: usize| u32::from_le_bytes(VERSION_1[offset..offset + 4].try_into().unwrap());
        let nodes = u32_at(40) as usize;
        let link = |node: usize| (u32_at(64 + 32 * nodes + 8 * node), u32_at(64 + 32 * nodes + 8 * node + 4));
        let centre = |node: usize| Descriptor(VERSION_1[64 + 32 * node..][..32].try_into().unwrap());
        let mut node = 0;
        while link(node).1 > 0 {
            let (first, children) = link(node);
            let run = first as usize..(first + children) as usize;
            node = run.min_by_key(|&child| descriptor.distance(&centre(child))).unwrap();
        }
        let word = link(node).0;
        (word, f32::from_bits(u32_at(64 + 40 * nodes + 4 * word as usize)))
    }

    #[test]
    fn a_file_of_version_1_opens_with_the_words_and_weights_that_it_had() {
        let vocabulary = Vocabulary::from_bytes(VERSION_1.to_vec(), Path::new("v1")).unwrap();
        assert_eq!((vocabulary.node_count(), vocabulary.word_count()), (121, 81));
        let mut words = std::collections::BTreeSet::new();
        for seed in 0..=255_u8 {
            let descriptor = Descriptor(std::array::from_fn(|i| seed.wrapping_mul(i as u8 ^ 91) ^ seed));
            let (word, weight) = by_version_1(&descriptor);
            assert_eq!(vocabulary.quantise(&descriptor).word, WordId(word));
            assert_eq!(vocabulary.weight(WordId(word)), f64::from(weight));
            words.insert(word);
        }
        assert!(words.len() > 20, "{} words", words.len());
    }

    #[test]
    fn many_descriptors_have_the_words_that_each_has_alone() {
        let vocabulary = Vocabulary::from_bytes(VERSION_1.to_vec(), Path::new("v1")).unwrap();
        let descriptor = |seed: usize| {
            Descriptor(std::array::from_fn(|i| (seed.wrapping_mul(i ^ 2_654_435_761) >> 7) as u8))
        };
        for count in [0, 1, SIDE_BY_SIDE - 1, SIDE_BY_SIDE, SIDE_BY_SIDE + 1, 10 * SIDE_BY_SIDE + 3] {
            let descriptors: Vec<Descriptor> = (0..count).map(descriptor).collect();
            let alone: Vec<Quantised> = descriptors.iter().map(|one| vocabulary.quantise(one)).collect();
            assert_eq!(vocabulary.quantise_all(&descriptors), alone);
        }
    }

    #[test]
    fn a_bit_flipped_in_a_file_of_version_1_is_found_at_opening() {
        let mut bytes = VERSION_1.to_vec();
        bytes[1000] ^= 1;
        let error = Vocabulary::from_bytes(bytes, Path::new("old.lvoc")).unwrap_err().to_string();
        assert!(error.starts_with("old.lvoc is damaged: expected checksum"), "{error}");
    }

    #[test]
    fn a_newer_file_says_so_in_one_line() {
        let mut bytes = VERSION_1.to_vec();
        bytes[8] = 3;
        let error = Vocabulary::from_bytes(bytes, Path::new("new.lvoc")).unwrap_err().to_string();
        assert!(error.contains("of version 3, this Loci reads up to 2: update Loci"), "{error}");
    }
}
