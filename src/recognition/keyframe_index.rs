//! The keyframes as BoW+HV needs them: found by their words, compared within vocabulary nodes, in every light.

use std::sync::Arc;

use heapless::Vec as FixedVec;

use super::recogniser::Look;
use crate::feature::{Descriptor, Features};
use crate::place_map::{ExperienceId, PlaceId};
use crate::retrieval::{BowVector, InvertedIndex, MAX_RETRIEVED};
use crate::vocabulary::{ConditionId, GrownWords, Offshoot, Quantised, Vocabulary, VocabularySet, WordId};

/// A keyframe that shares words with a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RetrievedKeyframe {
    pub(super) place: PlaceId,
    pub(super) experience: ExperienceId,
    /// L1 score in (0, 1].
    pub(super) score: f32,
}

/// A keyframe; its position in the list is its document in the inverted indices.
struct IndexedKeyframe {
    place: PlaceId,
    experience: ExperienceId,
    /// The node of each feature, by condition.
    groups: Vec<Vec<u32>>,
}

/// All keyframes, each under the words of every condition.
pub(super) struct KeyframeIndex {
    vocabularies: Arc<VocabularySet>,
    /// One a condition.
    words: Vec<WordIndex>,
    keyframes: Vec<IndexedKeyframe>,
}

/// The keyframes under the words of one condition.
struct WordIndex {
    inverted: InvertedIndex,
    /// The words that grew where the vocabulary covers the keyframes badly, if any may.
    grown: Option<GrownWords>,
}

impl WordIndex {
    /// Indexes an image with these features.
    fn add(&mut self, descriptors: &[Descriptor], quantised: &[Quantised], vocabulary: &Vocabulary) {
        let Some(grown) = &mut self.grown else {
            self.inverted.add(&BowVector::new(trained_words(quantised), vocabulary));
            return;
        };
        self.inverted.add(&grown_bow(&grown.learn(descriptors, quantised), vocabulary));
        for Offshoot { word, origin } in grown.purge() {
            self.inverted.merge(word, origin);
        }
    }

    /// The bag of words of `look`.
    fn bow(&self, look: &Look, vocabulary: &Vocabulary) -> BowVector {
        match &self.grown {
            None => BowVector::new(trained_words(&look.quantised), vocabulary),
            Some(grown) => {
                grown_bow(&grown.words_of(&look.features.descriptors, &look.quantised), vocabulary)
            }
        }
    }
}

fn trained_words(quantised: &[Quantised]) -> impl Iterator<Item = WordId> {
    quantised.iter().map(|quantised| quantised.word)
}

fn grown_bow(offshoots: &[Offshoot], vocabulary: &Vocabulary) -> BowVector {
    let weighted = offshoots.iter().map(|offshoot| (offshoot.word, vocabulary.weight(offshoot.origin)));
    BowVector::weighted(weighted, vocabulary.weighting())
}

impl KeyframeIndex {
    /// No keyframes yet. If the vocabularies are `growing`, keyframes that they cover badly bring words of
    /// their own.
    pub(super) fn new(vocabularies: Arc<VocabularySet>, growing: bool) -> Self {
        let word_index = |condition| WordIndex {
            inverted: InvertedIndex::default(),
            grown: growing.then(|| GrownWords::new(vocabularies.vocabulary(condition))),
        };
        let words = vocabularies.conditions().map(word_index).collect();
        Self { vocabularies, words, keyframes: Vec::new() }
    }

    pub(super) fn vocabularies(&self) -> &Arc<VocabularySet> {
        &self.vocabularies
    }

    /// Makes a keyframe findable. Experiences come in the order of their numbers.
    pub(super) fn add(&mut self, place: PlaceId, experience: ExperienceId, features: &Features) {
        let mut groups = Vec::with_capacity(self.words.len());
        for (condition, index) in self.vocabularies.conditions().zip(&mut self.words) {
            let vocabulary = self.vocabularies.vocabulary(condition);
            let quantised = vocabulary.quantise_all(&features.descriptors);
            index.add(&features.descriptors, &quantised, vocabulary);
            groups.push(quantised.iter().map(|q| q.node.0).collect());
        }
        self.keyframes.push(IndexedKeyframe { place, experience, groups });
    }

    /// The keyframes that share the most and rarest words with `look`, but for those of the place
    /// `unwanted`; best first.
    pub(super) fn query(
        &mut self,
        look: &Look,
        unwanted: Option<PlaceId>,
    ) -> FixedVec<RetrievedKeyframe, MAX_RETRIEVED> {
        let Self { vocabularies, words, keyframes } = self;
        let condition = look.light.condition;
        let Some(index) = words.get_mut(usize::from(condition.0)) else { return FixedVec::new() };
        let bow = index.bow(look, vocabularies.vocabulary(condition));
        let retrieved = index.inverted.query(&bow, |id| Some(keyframes[id.0 as usize].place) != unwanted);
        let keyframe = |retrieved: &crate::retrieval::Retrieved| {
            let IndexedKeyframe { place, experience, .. } = keyframes[retrieved.document.0 as usize];
            RetrievedKeyframe { place, experience, score: retrieved.score }
        };
        retrieved.iter().map(keyframe).collect()
    }

    /// The node of each feature of a keyframe under `condition`.
    pub(super) fn groups(&self, keyframe: ExperienceId, condition: ConditionId) -> Option<&[u32]> {
        let position = self.keyframes.binary_search_by_key(&keyframe, |indexed| indexed.experience).ok()?;
        self.keyframes[position].groups.get(usize::from(condition.0)).map(Vec::as_slice)
    }
}
