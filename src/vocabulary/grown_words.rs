//! Words learnt online, where the vocabulary covers badly what the robot sees (García-Fidalgo & Ortiz,
//! *iBoW-LCD*, 2018).
//!
//! A descriptor far from the centre of its word has little in common with what the word was learnt from; seen
//! again, slightly changed, it may end in any other. Such a descriptor becomes a word itself, looked for
//! among those that grew under the same node near the root, where small changes do not lead astray. What no
//! second image shows soon was noise: it goes back into the word that it grew out of.

use std::collections::HashMap;

use super::{NodeId, Quantised, Vocabulary, WordId};
use crate::feature::Descriptor;
use crate::kernel;

/// Farthest that a descriptor may lie from its word, in bits of 256: verification takes descriptors farther
/// apart than this for different points as well.
const COVERED_BITS: u32 = 64;

/// Images after which a word must have been seen again.
const TRIAL_IMAGES: u64 = 2;

/// Most words; at 64 bytes each, 8 MiB.
const MAX_WORDS: usize = 1 << 17;

/// A word with the one of the vocabulary that it grew out of and weighs as much as; one that did not grow is
/// its own origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offshoot {
    /// The word.
    pub word: WordId,
    /// The word of the vocabulary.
    pub origin: WordId,
}

/// The words that grew out of those of one vocabulary.
#[derive(Debug)]
pub struct GrownWords {
    nodes: HashMap<NodeId, GrownNode>,
    /// Numbers are never given twice.
    next_word: u32,
    live_words: usize,
    images: u64,
}

/// The words under a node: their descriptors apart, so that they lie side by side.
#[derive(Debug, Default)]
struct GrownNode {
    descriptors: Vec<[u8; 32]>,
    words: Vec<GrownWord>,
}

#[derive(Clone, Copy, Debug)]
struct GrownWord {
    offshoot: Offshoot,
    /// The image that it was learnt from.
    born: u64,
    /// The image that showed it last.
    last_seen: u64,
    is_confirmed: bool,
}

impl GrownNode {
    /// Position of the word whose descriptor is nearest to `descriptor`, if it is near enough.
    fn find(&self, descriptor: &Descriptor) -> Option<usize> {
        let (nearest, distance_bits) = kernel::nearest(&descriptor.0, &self.descriptors);
        (distance_bits <= COVERED_BITS).then_some(nearest as usize)
    }
}

impl GrownWords {
    /// No words yet but those of `vocabulary`.
    #[must_use]
    pub fn new(vocabulary: &Vocabulary) -> Self {
        Self { nodes: HashMap::new(), next_word: vocabulary.word_count(), live_words: 0, images: 0 }
    }

    /// Number of words that have grown and were not purged.
    #[must_use]
    pub fn word_count(&self) -> usize {
        self.live_words
    }

    /// The words of an image's `descriptors`: that of the vocabulary where it covers them or nothing near has
    /// grown, else the one that grew nearest. `quantised` is what the vocabulary says of each.
    pub fn words_of(
        &self,
        descriptors: &[Descriptor],
        quantised: &[Quantised],
    ) -> impl Iterator<Item = Offshoot> {
        let offshoot = |(descriptor, quantised): (&Descriptor, &Quantised)| {
            let node = self.nodes.get(&quantised.node).filter(|_| !is_covered(quantised));
            let grown = node.and_then(|node| Some(node.words[node.find(descriptor)?].offshoot));
            grown.unwrap_or_else(|| trained(quantised))
        };
        descriptors.iter().zip(quantised).map(offshoot)
    }

    /// The words of an image that is learnt: as [`words_of`](Self::words_of), but what neither `vocabulary`, that
    /// of [`new`](Self::new), nor a grown word covers becomes a new word. [`purge`](Self::purge) follows.
    pub fn learn(
        &mut self,
        descriptors: &[Descriptor],
        quantised: &[Quantised],
        vocabulary: &Vocabulary,
    ) -> Vec<Offshoot> {
        self.images += 1;
        let mut offshoots = Vec::with_capacity(descriptors.len());
        for (descriptor, quantised) in descriptors.iter().zip(quantised) {
            offshoots.push(if is_covered(quantised) {
                trained(quantised)
            } else {
                self.meet(descriptor, quantised, vocabulary)
            });
        }
        offshoots
    }

    /// The grown word of a descriptor that the vocabulary does not cover, new if need be. Out of a word that
    /// weighs nothing none grows: it would weigh nothing either.
    fn meet(&mut self, descriptor: &Descriptor, quantised: &Quantised, vocabulary: &Vocabulary) -> Offshoot {
        let image = self.images;
        let node = self.nodes.entry(quantised.node).or_default();
        if let Some(position) = node.find(descriptor) {
            let word = &mut node.words[position];
            word.is_confirmed |= word.last_seen != image;
            word.last_seen = image;
            return word.offshoot;
        }
        let may_grow = self.live_words < MAX_WORDS && vocabulary.weight(quantised.word) > 0.0;
        let Some(after) = self.next_word.checked_add(1).filter(|_| may_grow) else {
            return trained(quantised);
        };
        let offshoot = Offshoot { word: WordId(self.next_word), origin: quantised.word };
        self.next_word = after;
        self.live_words += 1;
        node.descriptors.push(descriptor.0);
        node.words.push(GrownWord { offshoot, born: image, last_seen: image, is_confirmed: false });
        offshoot
    }

    /// Forgets the words that no image shows any more.
    pub fn retain(&mut self, is_shown: impl Fn(WordId) -> bool) {
        self.nodes.retain(|_, node| {
            let grown = std::mem::take(node);
            for (descriptor, word) in grown.descriptors.into_iter().zip(grown.words) {
                if is_shown(word.offshoot.word) {
                    node.descriptors.push(descriptor);
                    node.words.push(word);
                }
            }
            !node.words.is_empty()
        });
        self.live_words = self.nodes.values().map(|node| node.words.len()).sum();
    }

    /// Forgets the words that only one image showed and whose trial of two more images is over; answers
    /// which, in rising order. Whatever showed them shows their origins again, unless another word grows nearby.
    pub fn purge(&mut self) -> Vec<Offshoot> {
        let images = self.images;
        let fails = |word: &GrownWord| !word.is_confirmed && images - word.born >= TRIAL_IMAGES;
        let mut purged = Vec::new();
        for node in self.nodes.values_mut() {
            if !node.words.iter().any(fails) {
                continue;
            }
            let grown = std::mem::take(node);
            for (descriptor, word) in grown.descriptors.into_iter().zip(grown.words) {
                if fails(&word) {
                    purged.push(word.offshoot);
                } else {
                    node.descriptors.push(descriptor);
                    node.words.push(word);
                }
            }
        }
        self.live_words -= purged.len();
        // Nodes come in any order; a run that is replayed must give the same sums.
        purged.sort_unstable_by_key(|offshoot| offshoot.word);
        purged
    }
}

fn trained(quantised: &Quantised) -> Offshoot {
    Offshoot { word: quantised.word, origin: quantised.word }
}

fn is_covered(quantised: &Quantised) -> bool {
    u32::from(quantised.distance_bits) <= COVERED_BITS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vocabulary::{TrainingOptions, train};
    use proptest::prelude::*;

    fn vocabulary() -> Vocabulary {
        let images: Vec<Vec<Descriptor>> = (0..4_u8).map(|i| vec![Descriptor([i; 32]); 3]).collect();
        train(&images, TrainingOptions { branching: 4, depth: 1, ..TrainingOptions::default() }).unwrap()
    }

    fn quantised(node: u32, distance_bits: u16) -> Quantised {
        Quantised { word: WordId(node), node: NodeId(node), distance_bits }
    }

    fn words(offshoots: &[Offshoot]) -> Vec<WordId> {
        offshoots.iter().map(|offshoot| offshoot.word).collect()
    }

    /// A descriptor whose first `ones` bits are set.
    fn descriptor(ones: usize) -> Descriptor {
        Descriptor(std::array::from_fn(|byte| match ones.saturating_sub(8 * byte) {
            0 => 0,
            left @ 1..8 => 0xff_u8 << (8 - left),
            _ => 0xff,
        }))
    }

    /// Learns an image of these descriptors, all under node 1 and badly covered.
    fn learn(grown: &mut GrownWords, ones: &[usize]) -> Vec<WordId> {
        let descriptors: Vec<Descriptor> = ones.iter().map(|&ones| descriptor(ones)).collect();
        words(&grown.learn(&descriptors, &vec![quantised(1, 100); ones.len()], &vocabulary()))
    }

    fn purge(grown: &mut GrownWords) -> Vec<WordId> {
        words(&grown.purge())
    }

    #[test]
    fn what_the_vocabulary_covers_keeps_its_word() {
        let vocabulary = vocabulary();
        let mut grown = GrownWords::new(&vocabulary);
        assert_eq!(words(&grown.learn(&[descriptor(9)], &[quantised(1, 64)], &vocabulary)), [WordId(1)]);
        assert_eq!(grown.word_count(), 0);
    }

    #[test]
    fn out_of_a_word_that_weighs_nothing_no_word_grows() {
        let (everywhere, rare) = (Descriptor([0; 32]), Descriptor([255; 32]));
        let images = [vec![everywhere, rare], vec![everywhere]];
        let options = TrainingOptions { branching: 2, depth: 1, ..TrainingOptions::default() };
        let vocabulary = train(&images, options).unwrap();
        let far_from = |known: &Descriptor| Quantised {
            word: vocabulary.quantise(known).word,
            node: NodeId(1),
            distance_bits: 100,
        };
        let (weightless, weighty) = (far_from(&everywhere), far_from(&rare));
        assert_eq!(vocabulary.weight(weightless.word), 0.0);
        let mut grown = GrownWords::new(&vocabulary);
        let learnt = grown.learn(&[descriptor(100)], &[weightless], &vocabulary);
        assert_eq!((learnt[0].word, grown.word_count()), (weightless.word, 0));
        let learnt = grown.learn(&[descriptor(100)], &[weighty], &vocabulary);
        assert_eq!((learnt[0].origin, grown.word_count()), (weighty.word, 1));
        assert_eq!(grown.learn(&[descriptor(90)], &[weightless], &vocabulary), learnt, "near one that grew");
    }

    #[test]
    fn what_it_does_not_cover_becomes_a_word_and_is_found_again() {
        let vocabulary = vocabulary();
        let mut grown = GrownWords::new(&vocabulary);
        let learnt = learn(&mut grown, &[0, 100, 164]);
        let first = vocabulary.word_count();
        assert_eq!(learnt, [WordId(first), WordId(first + 1), WordId(first + 1)], "164 is 64 bits from 100");
        let seen = |node, ones| grown.words_of(&[descriptor(ones)], &[quantised(node, 100)]).next().unwrap();
        let offshoot = Offshoot { word: learnt[1], origin: WordId(1) };
        assert_eq!([seen(1, 60), seen(1, 90)], [offshoot; 2]);
        assert_eq!(seen(1, 165).word, WordId(1), "too far from all that grew");
        assert_eq!(seen(2, 100).word, WordId(2), "grown under another node");
    }

    #[test]
    fn a_word_that_no_second_image_shows_is_purged_after_two_more() {
        let mut grown = GrownWords::new(&vocabulary());
        let learnt = learn(&mut grown, &[0, 0, 100, 250]);
        assert!(grown.purge().is_empty());
        learn(&mut grown, &[120]);
        assert!(grown.purge().is_empty(), "the trial is not over");
        learn(&mut grown, &[]);
        let purged = purge(&mut grown);
        assert_eq!(purged, [learnt[0], learnt[3]], "seeing a word twice in one image confirms nothing");
        assert_eq!(grown.word_count(), 1);
        for _ in 0..5 {
            learn(&mut grown, &[]);
            assert!(grown.purge().is_empty(), "a confirmed word stays");
        }
    }

    #[test]
    fn numbers_are_never_given_twice() {
        let mut grown = GrownWords::new(&vocabulary());
        let before = learn(&mut grown, &[0]);
        for _ in 0..2 {
            learn(&mut grown, &[]);
        }
        assert_eq!(purge(&mut grown), before);
        assert_ne!(learn(&mut grown, &[0]), before);
    }

    proptest! {
        #[test]
        fn learning_equals_a_list_that_is_searched_from_end_to_end(
            images in proptest::collection::vec(
                proptest::collection::vec((0..256_usize, 0..2_u32, 60..70_u16), 0..8), 1..12),
        ) {
            let vocabulary = vocabulary();
            let mut grown = GrownWords::new(&vocabulary);
            // Descriptor, node, number and the images that showed it.
            let mut list: Vec<(Descriptor, u32, u32, Vec<usize>)> = Vec::new();
            let mut next = vocabulary.word_count();
            for (image, features) in images.iter().enumerate() {
                let descriptors: Vec<Descriptor> = features.iter().map(|f| descriptor(f.0)).collect();
                let seen: Vec<Quantised> = features.iter().map(|f| quantised(f.1, f.2)).collect();
                let learnt = grown.learn(&descriptors, &seen, &vocabulary);
                for ((descriptor, feature), offshoot) in descriptors.iter().zip(features).zip(learnt) {
                    prop_assert_eq!(offshoot.origin, WordId(feature.1));
                    if feature.2 <= 64 {
                        prop_assert_eq!(offshoot.word, offshoot.origin);
                        continue;
                    }
                    let near = list.iter_mut().filter(|w| w.1 == feature.1 && descriptor.distance(&w.0) <= 64);
                    let expected = match near.min_by_key(|w| (descriptor.distance(&w.0), w.2)) {
                        Some(known) => {
                            known.3.push(image);
                            known.2
                        }
                        None => {
                            list.push((*descriptor, feature.1, next, vec![image]));
                            next += 1;
                            next - 1
                        }
                    };
                    prop_assert_eq!(offshoot.word, WordId(expected));
                }
                let (kept, gone): (Vec<_>, Vec<_>) = list.into_iter()
                    .partition(|w| w.3[0] != *w.3.last().unwrap() || image - w.3[0] < 2);
                list = kept;
                prop_assert_eq!(purge(&mut grown), gone.iter().map(|w| WordId(w.2)).collect::<Vec<_>>());
                prop_assert_eq!(grown.word_count(), list.len());
            }
        }
    }
}
