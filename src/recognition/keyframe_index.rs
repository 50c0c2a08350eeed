//! The keyframes as BoW+HV needs them: found by their words, compared within vocabulary nodes, in every light.

use std::sync::Arc;

use heapless::Vec as FixedVec;

use super::recogniser::Look;
use crate::feature::Features;
use crate::place_map::{ExperienceId, PlaceId};
use crate::retrieval::{BowVector, InvertedIndex, MAX_RETRIEVED};
use crate::vocabulary::{ConditionId, VocabularySet};

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
    inverted_indices: Vec<InvertedIndex>,
    keyframes: Vec<IndexedKeyframe>,
}

impl KeyframeIndex {
    pub(super) fn new(vocabularies: Arc<VocabularySet>) -> Self {
        let inverted_indices = vocabularies.conditions().map(|_| InvertedIndex::default()).collect();
        Self { vocabularies, inverted_indices, keyframes: Vec::new() }
    }

    pub(super) fn vocabularies(&self) -> &Arc<VocabularySet> {
        &self.vocabularies
    }

    /// Makes a keyframe findable. Experiences come in the order of their numbers.
    pub(super) fn add(&mut self, place: PlaceId, experience: ExperienceId, features: &Features) {
        let mut groups = Vec::with_capacity(self.inverted_indices.len());
        for (condition, index) in self.vocabularies.conditions().zip(&mut self.inverted_indices) {
            let vocabulary = self.vocabularies.vocabulary(condition);
            let quantised = vocabulary.quantise_all(&features.descriptors);
            index.add(&BowVector::new(quantised.iter().map(|q| q.word), vocabulary));
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
        let Self { vocabularies, inverted_indices, keyframes } = self;
        let condition = look.light.condition;
        let words = look.quantised.iter().map(|quantised| quantised.word);
        let bow = BowVector::new(words, vocabularies.vocabulary(condition));
        let Some(index) = inverted_indices.get_mut(usize::from(condition.0)) else { return FixedVec::new() };
        let retrieved = index.query(&bow, |id| Some(keyframes[id.0 as usize].place) != unwanted);
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
