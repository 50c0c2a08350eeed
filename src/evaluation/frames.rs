//! The field's database: every reference frame can be found.
//!
//! The CNN ranks all of them by cosine; BoW+HV ranks those that share the most words by their effective inliers;
//! together they decide by probability, as `loci run` does of a frame that nothing comes before. But no frame has to be
//! ahead of others here, for those next to it show the same.

use std::collections::BTreeMap;

use super::answer::{Answer, Candidate, MAX_CANDIDATES};
use super::results::Method;
use super::traverse::{Observation, Traverse};
use crate::cnn::ModelCard;
use crate::feature::Features;
use crate::recognition::{Clues, RecognitionOptions};
use crate::retrieval::{BowVector, InvertedIndex};
use crate::verification::{MatchingView, Verification, VerificationOptions, verify};
use crate::vocabulary::{Quantised, Vocabulary, VocabularySet};

/// Cosine of a reference frame, and which one.
type Alike = (f32, usize);
/// Effective inliers of a reference frame, and which one.
type Verified = (u32, usize);

/// All frames of a traverse, ready to be searched.
pub struct FrameDatabase<'a> {
    reference: &'a Traverse,
    /// What a map would keep of every reference frame's features.
    keyframes: Vec<Features>,
    vocabularies: &'a VocabularySet,
    model: Option<&'a ModelCard>,
    options: &'a RecognitionOptions,
    /// One a condition, with every reference frame under the words of that condition.
    indices: Vec<InvertedIndex>,
}

/// The geometry between a query frame and a keyframe, by the vocabulary of the query's light.
#[must_use]
pub fn geometry(
    query: &Observation,
    keyframe: &Features,
    (vocabularies, options): (&VocabularySet, &VerificationOptions),
) -> Verification {
    let vocabulary = vocabularies.vocabulary(query.look.light.condition);
    let query_groups: Vec<u32> = query.look.quantised.iter().map(|quantised| quantised.node.0).collect();
    let mut keyframe_groups = Vec::new();
    vocabulary.groups_into(&keyframe.descriptors, &mut keyframe_groups);
    let query = MatchingView { features: &query.look.features, groups: &query_groups };
    let keyframe = MatchingView { features: keyframe, groups: &keyframe_groups };
    verify(query, keyframe, options)
}

impl<'a> FrameDatabase<'a> {
    /// A database of all frames of `reference`.
    #[must_use]
    pub fn new(
        reference: &'a Traverse,
        vocabularies: &'a VocabularySet,
        model: Option<&'a ModelCard>,
        options: &'a RecognitionOptions,
    ) -> Self {
        let kept = |seen: &Observation| seen.look.features.foremost(options.keyframe_features);
        let keyframes: Vec<Features> = reference.observations.iter().map(kept).collect();
        let index = |condition| {
            let vocabulary = vocabularies.vocabulary(condition);
            let mut index = InvertedIndex::default();
            for features in &keyframes {
                index.add(&bow(&vocabulary.quantise_all(&features.descriptors), vocabulary));
            }
            index
        };
        let indices = vocabularies.conditions().map(index).collect();
        Self { reference, keyframes, vocabularies, model, options, indices }
    }

    /// What each of `methods` finds for `query` among the first `horizon` reference frames.
    pub fn answer(&mut self, query: &Observation, horizon: usize, methods: &[Method]) -> Vec<Answer> {
        let asks = |wanted: Method| methods.iter().any(|&m| m == wanted || m == Method::CnnBowHv);
        let alike = if asks(Method::Cnn) { self.alike(query, horizon) } else { Vec::new() };
        let verified = if asks(Method::BowHv) { self.verified(query, horizon) } else { Vec::new() };
        let answer = |method: &Method| match method {
            Method::Cnn => self.by_cnn(&alike),
            Method::BowHv => self.by_bow_hv(&verified),
            Method::CnnBowHv => self.together(query, (&alike, &verified)),
        };
        methods.iter().map(answer).collect()
    }

    /// The frames that the CNN finds most alike, with their cosines, best first.
    fn alike(&self, query: &Observation, horizon: usize) -> Vec<(f32, usize)> {
        let mut found: Vec<(f32, usize)> = (0..horizon.min(self.keyframes.len()))
            .filter_map(|at| Some((self.cosine(query, at)?, at)))
            .collect();
        let best_first = |a: &(f32, usize), b: &(f32, usize)| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
        if found.len() > MAX_CANDIDATES {
            found.select_nth_unstable_by(MAX_CANDIDATES - 1, best_first);
            found.truncate(MAX_CANDIDATES);
        }
        found.sort_unstable_by(best_first);
        found
    }

    fn cosine(&self, query: &Observation, reference: usize) -> Option<f32> {
        let known = self.reference.observations.get(reference)?.look.appearance.as_ref()?;
        Some(query.look.appearance.as_ref().filter(|_| self.model.is_some())?.cosine(known))
    }

    /// The frames that share the most words, with their effective inliers, best first.
    fn verified(&mut self, query: &Observation, horizon: usize) -> Vec<(u32, usize)> {
        let condition = query.look.light.condition;
        let bow = bow(&query.look.quantised, self.vocabularies.vocabulary(condition));
        let retrieved =
            self.indices[usize::from(condition.0)].query(&bow, |document| (document.0 as usize) < horizon);
        let mut found: Vec<(u32, f32, usize)> = retrieved
            .iter()
            .map(|retrieved| {
                let reference = retrieved.document.0 as usize;
                let known = &self.keyframes[reference];
                let verification = geometry(query, known, (self.vocabularies, &self.options.verification));
                (verification.effective_inliers, retrieved.score, reference)
            })
            .collect();
        found.sort_by(|a, b| b.0.cmp(&a.0).then(b.1.total_cmp(&a.1)).then(a.2.cmp(&b.2)));
        found.truncate(MAX_CANDIDATES);
        found.into_iter().map(|(inliers, _, reference)| (inliers, reference)).collect()
    }

    /// What the CNN says by its own threshold.
    fn by_cnn(&self, alike: &[(f32, usize)]) -> Answer {
        let Some(model) = self.model else { return Answer::default() };
        let needed = model.decision.recognise_above;
        let candidate = |&(cosine, reference): &(f32, usize)| Candidate {
            reference,
            place: None,
            probability: f64::from(model.probability(cosine)),
            reason: format!("cosine {cosine:.3} {} {needed:.3}", if cosine >= needed { "≥" } else { "<" }),
        };
        let chosen = alike.first().filter(|best| best.0 >= needed).map(candidate);
        by_best(chosen, alike.iter().map(candidate).collect())
    }

    fn by_bow_hv(&self, verified: &[(u32, usize)]) -> Answer {
        let found =
            verified.iter().map(|&(inliers, reference)| (reference, Clues { inliers, ..Clues::default() }));
        self.by_probability(found.collect())
    }

    /// Both at once, as `loci run` decides about a single frame.
    fn together(&self, query: &Observation, (alike, verified): (&[Alike], &[Verified])) -> Answer {
        let mut clues: BTreeMap<usize, Clues> = BTreeMap::new();
        let references = alike.iter().map(|found| found.1).chain(verified.iter().map(|found| found.1));
        for reference in references {
            let inliers = verified.iter().find(|found| found.1 == reference).map_or(0, |found| found.0);
            clues.insert(
                reference,
                Clues { cosine: self.cosine(query, reference), inliers, ..Clues::default() },
            );
        }
        self.by_probability(clues.into_iter().collect())
    }

    fn by_probability(&self, found: Vec<(usize, Clues)>) -> Answer {
        let needed = f64::from(self.options.accept_above);
        let candidate = |(reference, clues): (usize, Clues)| {
            let probability = f64::from(clues.probability(self.model));
            Candidate { reference, place: None, probability, reason: reason(clues, probability, needed) }
        };
        let mut found: Vec<Candidate> = found.into_iter().map(candidate).collect();
        found.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let chosen = found.first().filter(|best| best.probability >= needed).cloned();
        by_best(chosen, found)
    }
}

/// Why a candidate of which so much is known is accepted, or not.
fn reason(Clues { cosine, inliers, .. }: Clues, probability: f64, needed: f64) -> String {
    let cosine = cosine.map_or(String::new(), |cosine| format!("cosine {cosine:.3}, "));
    let relation = if probability >= needed { "≥" } else { "<" };
    format!("{cosine}{inliers} effective inliers: probability {probability:.3} {relation} {needed:.3}")
}

fn bow(quantised: &[Quantised], vocabulary: &Vocabulary) -> BowVector {
    BowVector::new(quantised.iter().map(|quantised| quantised.word), vocabulary)
}

/// The answer of one kind of evidence, whose best candidate is also the likeliest.
fn by_best(chosen: Option<Candidate>, found: Vec<Candidate>) -> Answer {
    let confidence = found.first().map_or(0.0, |best| best.probability);
    Answer::new(chosen, found, confidence)
}
