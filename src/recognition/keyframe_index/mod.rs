//! The keyframes as BoW+HV finds them: by their words, in every light.

mod snapshot;

use std::collections::HashMap;
use std::sync::Arc;

use heapless::Vec as FixedVec;

use super::look::Look;
use crate::feature::{Descriptor, Features};
use crate::place_map::{ExperienceId, PlaceId, VocabularyWords};
use crate::retrieval::{BowVector, DocumentId, InvertedIndex, MAX_RETRIEVED};
use crate::vocabulary::{GrownWords, Offshoot, Quantised, Vocabulary, VocabularySet, WordId};

/// A keyframe that shares words with a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RetrievedKeyframe {
    pub(super) place: PlaceId,
    pub(super) experience: ExperienceId,
    /// L1 score in (0, 1].
    pub(super) score: f32,
}

/// Memory of a posting: two bytes, and two more where a keyframe shows a word again.
const POSTING_BYTES: usize = 3;
/// Memory of a keyframe besides its postings.
const KEYFRAME_BYTES: usize = 56;

#[derive(Clone, Copy)]
struct IndexedKeyframe {
    place: PlaceId,
    experience: ExperienceId,
    postings: u32,
}

/// Keyframes, each under the words of every condition.
pub(super) struct KeyframeIndex {
    vocabularies: Arc<VocabularySet>,
    /// One a condition; all number their documents alike.
    words: Vec<WordIndex>,
    /// By document.
    keyframes: Vec<IndexedKeyframe>,
    documents: HashMap<ExperienceId, DocumentId>,
    /// Words of all keyframes together, in every condition.
    postings: usize,
    asked: Asked,
}

/// The frame that was asked for last; its memory serves the next one.
#[derive(Default)]
struct Asked {
    words: Vec<WordId>,
    bow: BowVector,
}

/// The keyframes under the words of one condition.
struct WordIndex {
    inverted: InvertedIndex,
    /// The words that grew where the vocabulary covers the keyframes badly, if any may.
    grown: Option<GrownWords>,
}

impl WordIndex {
    /// Indexes a keyframe; answers its document and how many postings it has.
    fn add(&mut self, bow: &BowVector) -> (DocumentId, usize) {
        (self.inverted.add(bow), bow.entries().len())
    }

    /// Indexes a keyframe with these features, whose words grow where the vocabulary covers them badly.
    fn add_growing(&mut self, descriptors: &[Descriptor], vocabulary: &Vocabulary) -> (DocumentId, usize) {
        let quantised = vocabulary.quantise_all(descriptors);
        let Some(grown) = &mut self.grown else {
            return self.add(&BowVector::new(trained_words(&quantised), vocabulary));
        };
        let learnt = grown.learn(descriptors, &quantised, vocabulary);
        let words = weighted(learnt.into_iter(), vocabulary);
        let document = self.add(&BowVector::weighted(words, vocabulary.weighting()));
        let Some(grown) = &mut self.grown else { return document };
        let purged = grown.purge();
        let renamed: Vec<_> = purged.iter().map(|offshoot| (offshoot.word, offshoot.origin)).collect();
        self.inverted.rename(&renamed);
        document
    }

    /// Makes the bag of words of `look`.
    fn fill(&self, Asked { words, bow }: &mut Asked, look: &Look, vocabulary: &Vocabulary) {
        match &self.grown {
            None => {
                words.clear();
                words.extend(trained_words(&look.quantised));
                bow.fill(words, vocabulary);
            }
            Some(grown) => {
                let offshoots = grown.words_of(&look.features.descriptors, &look.quantised);
                bow.fill_weighted(weighted(offshoots, vocabulary), vocabulary.weighting());
            }
        }
    }
}

fn trained_words(quantised: &[Quantised]) -> impl Iterator<Item = WordId> {
    quantised.iter().map(|quantised| quantised.word)
}

fn weighted(
    offshoots: impl Iterator<Item = Offshoot>,
    vocabulary: &Vocabulary,
) -> impl Iterator<Item = (WordId, f64)> {
    offshoots.map(|offshoot| (offshoot.word, vocabulary.weight(offshoot.origin)))
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
        Self {
            vocabularies,
            words,
            keyframes: Vec::new(),
            documents: HashMap::new(),
            postings: 0,
            asked: Asked::default(),
        }
    }

    pub(super) fn vocabularies(&self) -> &Arc<VocabularySet> {
        &self.vocabularies
    }

    /// Whether keyframes that the vocabularies cover badly bring words of their own.
    fn may_grow(&self) -> bool {
        self.words.iter().any(|index| index.grown.is_some())
    }

    /// Of the vocabularies.
    fn fingerprints(&self) -> impl Iterator<Item = u64> {
        self.vocabularies.conditions().map(|condition| self.vocabularies.vocabulary(condition).fingerprint())
    }

    pub(super) fn contains(&self, keyframe: ExperienceId) -> bool {
        self.documents.contains_key(&keyframe)
    }

    /// All keyframes, in no order.
    pub(super) fn experiences(&self) -> impl Iterator<Item = ExperienceId> {
        self.documents.keys().copied()
    }

    /// The words of a keyframe in every condition.
    pub(super) fn words_of(&self, features: &Features) -> Vec<VocabularyWords> {
        let words = |condition| {
            let vocabulary = self.vocabularies.vocabulary(condition);
            let quantised = vocabulary.quantise_all(&features.descriptors);
            let mut words: Vec<WordId> = trained_words(&quantised).collect();
            words.sort_unstable();
            VocabularyWords { vocabulary: vocabulary.fingerprint(), words }
        };
        self.vocabularies.conditions().map(words).collect()
    }

    /// Whether `words` are all that [`add`](Self::add) needs: those of every vocabulary, and none may grow.
    pub(super) fn is_satisfied_by(&self, words: &[VocabularyWords]) -> bool {
        let may_grow = self.words.iter().any(|index| index.grown.is_some());
        !may_grow
            && self
                .fingerprints()
                .all(|fingerprint| words.iter().any(|words| words.vocabulary == fingerprint))
    }

    /// Makes a keyframe findable by its words.
    pub(super) fn add(&mut self, keyframe: (PlaceId, ExperienceId), words: &[VocabularyWords]) {
        let mut added = Vec::with_capacity(self.words.len());
        for (condition, index) in self.vocabularies.conditions().zip(&mut self.words) {
            let vocabulary = self.vocabularies.vocabulary(condition);
            let fingerprint = vocabulary.fingerprint();
            let known = words.iter().find(|words| words.vocabulary == fingerprint);
            let words = known.into_iter().flat_map(|words| words.words.iter().copied());
            added.push(index.add(&BowVector::new(words, vocabulary)));
        }
        self.note(&added, keyframe);
    }

    /// Makes a keyframe findable by its features, whose words may grow.
    pub(super) fn add_growing(&mut self, keyframe: (PlaceId, ExperienceId), features: &Features) {
        let mut added = Vec::with_capacity(self.words.len());
        for (condition, index) in self.vocabularies.conditions().zip(&mut self.words) {
            let vocabulary = self.vocabularies.vocabulary(condition);
            added.push(index.add_growing(&features.descriptors, vocabulary));
        }
        self.note(&added, keyframe);
    }

    /// Notes what the words of every condition have added; all of them gave it the same number.
    fn note(&mut self, added: &[(DocumentId, usize)], (place, experience): (PlaceId, ExperienceId)) {
        let Some(&(document, _)) = added.first() else { return };
        let postings = added.iter().map(|(_, postings)| *postings as u32).sum();
        self.postings += postings as usize;
        let keyframe = IndexedKeyframe { place, experience, postings };
        match self.keyframes.get_mut(document.0 as usize) {
            Some(taken) => *taken = keyframe,
            None => self.keyframes.push(keyframe),
        }
        self.documents.insert(experience, document);
    }

    /// Forgets a keyframe, if it is there.
    pub(super) fn remove(&mut self, keyframe: ExperienceId) {
        let Some(document) = self.documents.remove(&keyframe) else { return };
        self.postings -= self.keyframes[document.0 as usize].postings as usize;
        for WordIndex { inverted, grown } in &mut self.words {
            let is_swept = inverted.remove(document);
            if let Some(grown) = grown.as_mut().filter(|_| is_swept) {
                grown.retain(|word| inverted.shows(word));
            }
        }
    }

    /// Forgets all keyframes that are not `wanted`, and frees their memory.
    fn retain(&mut self, wanted: impl Fn(ExperienceId) -> bool) {
        self.documents.retain(|&keyframe, _| wanted(keyframe));
        let Self { words, keyframes, documents, .. } = self;
        for index in words {
            let is_left =
                |document: DocumentId| documents.contains_key(&keyframes[document.0 as usize].experience);
            index.inverted.retain(is_left);
        }
        let postings = |document: &DocumentId| self.keyframes[document.0 as usize].postings as usize;
        self.postings = self.documents.values().map(postings).sum();
    }

    /// Frees the memory of what was removed.
    pub(super) fn sweep(&mut self) {
        for WordIndex { inverted, grown } in &mut self.words {
            inverted.sweep();
            if let Some(grown) = grown {
                grown.retain(|word| inverted.shows(word));
            }
        }
    }

    /// From now on the keyframe is one of `place`.
    pub(super) fn rename(&mut self, keyframe: ExperienceId, place: PlaceId) {
        if let Some(document) = self.documents.get(&keyframe) {
            self.keyframes[document.0 as usize].place = place;
        }
    }

    /// Bytes of memory that the keyframes take, roughly. Lists of words come on top, 8 bytes a word that a block shows:
    /// a few MB in all of the small blocks, and a tenth of the postings in full ones.
    pub(super) fn memory_bytes(&self) -> usize {
        self.postings * POSTING_BYTES + self.documents.len() * KEYFRAME_BYTES
    }

    /// Bytes of memory that a keyframe with so many postings takes.
    pub(super) fn keyframe_bytes(postings: usize) -> usize {
        postings * POSTING_BYTES + KEYFRAME_BYTES
    }

    /// The keyframes that share the most and rarest words with `look`, but for those of the place
    /// `unwanted`; best first.
    pub(super) fn query(
        &mut self,
        look: &Look,
        unwanted: Option<PlaceId>,
    ) -> FixedVec<RetrievedKeyframe, MAX_RETRIEVED> {
        let Self { vocabularies, words, keyframes, asked, .. } = self;
        let condition = look.light.condition;
        let Some(index) = words.get_mut(usize::from(condition.0)) else { return FixedVec::new() };
        index.fill(asked, look, vocabularies.vocabulary(condition));
        let retrieved =
            index.inverted.query(&asked.bow, |id| Some(keyframes[id.0 as usize].place) != unwanted);
        let keyframe = |retrieved: &crate::retrieval::Retrieved| {
            let IndexedKeyframe { place, experience, .. } = keyframes[retrieved.document.0 as usize];
            RetrievedKeyframe { place, experience, score: retrieved.score }
        };
        retrieved.iter().map(keyframe).collect()
    }
}
