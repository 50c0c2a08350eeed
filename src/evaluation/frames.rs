//! The field's database: every reference frame can be found.
//!
//! The CNN ranks all of them by cosine; BoW+HV ranks those that share the most words by their effective
//! inliers; together they decide as `loci run` does: what the CNN accepts, else what geometry accepts,
//! else nothing, and the likeliest of both comes first.

use super::answer::{Answer, Candidate, MAX_CANDIDATES};
use super::results::Method;
use super::traverse::{Observation, Traverse};
use crate::cnn::ModelCard;
use crate::feature::Features;
use crate::recognition::{Evidence, RecognitionOptions, doubt, inlier_probability};
use crate::retrieval::{BowVector, InvertedIndex};
use crate::verification::{MatchingView, Verification, VerificationOptions, verify};
use crate::vocabulary::{Quantised, Vocabulary, VocabularySet};

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
    let keyframe_groups: Vec<u32> =
        vocabulary.nodes(&keyframe.descriptors).iter().map(|node| node.0).collect();
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
        let cnn = if asks(Method::Cnn) { self.by_cnn(query, horizon) } else { Answer::default() };
        let bow_hv = if asks(Method::BowHv) { self.by_bow_hv(query, horizon) } else { Answer::default() };
        let answer = |method: &Method| match method {
            Method::Cnn => cnn.clone(),
            Method::BowHv => bow_hv.clone(),
            Method::CnnBowHv => together(&cnn, &bow_hv),
        };
        methods.iter().map(answer).collect()
    }

    fn by_cnn(&self, query: &Observation, horizon: usize) -> Answer {
        let (Some(model), Some(descriptor)) = (self.model, &query.look.appearance) else {
            return Answer::default();
        };
        let mut found: Vec<(f32, usize)> = Vec::new();
        for (reference, observation) in self.reference.observations.iter().take(horizon).enumerate() {
            let Some(known) = &observation.look.appearance else { continue };
            found.push((descriptor.cosine(known), reference));
        }
        let best_first = |a: &(f32, usize), b: &(f32, usize)| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
        if found.len() > MAX_CANDIDATES {
            found.select_nth_unstable_by(MAX_CANDIDATES - 1, best_first);
            found.truncate(MAX_CANDIDATES);
        }
        found.sort_unstable_by(best_first);
        let needed = model.decision.recognise_above;
        let candidate = |&(cosine, reference): &(f32, usize)| Candidate {
            reference,
            place: None,
            probability: f64::from(model.probability(cosine)),
            reason: Candidate::reason(Evidence::Cnn, f64::from(cosine), f64::from(needed)),
        };
        let chosen = found.first().filter(|best| best.0 >= needed).map(candidate);
        by_best(chosen, found.iter().map(candidate).collect())
    }

    fn by_bow_hv(&mut self, query: &Observation, horizon: usize) -> Answer {
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
        let needed = self.options.min_inliers;
        let candidate = |&(inliers, _, reference): &(u32, f32, usize)| Candidate {
            reference,
            place: None,
            probability: f64::from(inlier_probability(inliers)),
            reason: Candidate::reason(Evidence::BowHv, f64::from(inliers), f64::from(needed)),
        };
        let chosen = found.first().filter(|best| best.0 >= needed).map(candidate);
        by_best(chosen, found.iter().map(candidate).collect())
    }
}

fn bow(quantised: &[Quantised], vocabulary: &Vocabulary) -> BowVector {
    BowVector::new(quantised.iter().map(|quantised| quantised.word), vocabulary)
}

/// The answer of one kind of evidence, whose best candidate is also the likeliest.
fn by_best(chosen: Option<Candidate>, found: Vec<Candidate>) -> Answer {
    let confidence = found.first().map_or(0.0, |best| best.probability);
    Answer::new(chosen, found, confidence)
}

/// What the CNN accepts; else what geometry accepts; else the likeliest of both, with the doubt that the
/// decision leaves.
fn together(cnn: &Answer, bow_hv: &Answer) -> Answer {
    let given = [cnn, bow_hv].into_iter().find(|answer| answer.is_given);
    let found = cnn.candidates.iter().chain(&bow_hv.candidates).cloned().collect();
    let chosen = given.and_then(|answer| answer.candidates.first().cloned());
    let likeliest = |answer: &Answer| answer.candidates.first().map(|best| best.probability as f32);
    let doubt = || f64::from(doubt(likeliest(cnn), likeliest(bow_hv)));
    let confidence = given.map_or_else(doubt, |answer| answer.confidence);
    Answer::new(chosen, found, confidence)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(candidates: &[(usize, f64)], is_given: bool) -> Answer {
        let candidate = |&(reference, probability): &(usize, f64)| Candidate {
            reference,
            place: None,
            probability,
            reason: String::new(),
        };
        let confidence = candidates[0].1;
        Answer { candidates: candidates.iter().map(candidate).collect(), confidence, is_given }
    }

    fn order(answer: &Answer) -> Vec<usize> {
        answer.candidates.iter().map(|candidate| candidate.reference).collect()
    }

    #[test]
    fn what_the_cnn_accepts_comes_before_what_geometry_finds_likelier() {
        let both = together(&answer(&[(1, 0.9), (2, 0.3)], true), &answer(&[(3, 0.99), (2, 0.2)], true));
        assert_eq!((order(&both), both.is_given), (vec![1, 3, 2], true));
    }

    #[test]
    fn what_geometry_accepts_comes_before_what_the_cnn_turned_down() {
        let both = together(&answer(&[(1, 0.8)], false), &answer(&[(3, 0.7)], true));
        assert_eq!((order(&both), both.is_given), (vec![3, 1], true));
        assert!((both.confidence - 0.7).abs() < 1e-9);
    }

    #[test]
    fn where_nothing_is_accepted_the_likeliest_comes_first() {
        let both = together(&answer(&[(1, 0.2), (2, 0.1)], false), &answer(&[(3, 0.15), (1, 0.1)], false));
        assert_eq!((order(&both), both.is_given), (vec![1, 3, 2], false));
        assert!((both.confidence - 0.15).abs() < 1e-6, "but geometry says how far to trust it");
    }
}
