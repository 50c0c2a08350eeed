//! A scene: the traverses of an experiment, looked at, with what is true of them; and what one method
//! answered about them.

use super::answer::Answer;
use super::ground_truth::{GroundTruth, Relation};
use super::judgement::{Asked, Judged, Search, judge_strangers};
use super::metrics;
use super::results::{AnswerRecord, Confusion, Database, GroundTruthSummary, Method};
use super::score::confusion;
use super::traverse::{Observation, Traverse};

/// The frames of an experiment, looked at.
pub(super) struct Scene<'a> {
    pub(super) reference: &'a Traverse,
    pub(super) query: &'a Traverse,
    pub(super) unknown: Option<&'a Traverse>,
    pub(super) truth: &'a GroundTruth,
    pub(super) search: Search<'a>,
    /// Whether the reference shows the place of each query frame.
    pub(super) known: Vec<bool>,
    /// The true place of each reference frame, where the ground truth knows places.
    labels: Vec<Option<u32>>,
}

/// What one method answered from one database.
pub(super) struct Answers {
    pub(super) method: Method,
    pub(super) database: Database,
    pub(super) query: Vec<Answer>,
    pub(super) unknown: Vec<Answer>,
    /// The reference frames of each place that was founded, where a map was searched.
    pub(super) places: Vec<Vec<usize>>,
    /// Time of retrieval and of verification and decision, where a map was searched.
    pub(super) latency_us: Vec<(u64, u64)>,
}

impl Answers {
    pub(super) fn of(&self, asked: Asked) -> Option<&Answer> {
        match asked {
            Asked::Query(query) => self.query.get(query),
            Asked::Stranger(stranger) => self.unknown.get(stranger),
        }
    }
}

impl<'a> Scene<'a> {
    /// The scene of these traverses.
    pub(super) fn new(
        (reference, query, unknown): (&'a Traverse, &'a Traverse, Option<&'a Traverse>),
        search: Search<'a>,
    ) -> Self {
        let truth = search.truth;
        Self {
            reference,
            query,
            unknown,
            truth,
            search,
            known: (0..query.len()).map(|query| truth.is_scored(query) && search.is_known(query)).collect(),
            labels: metrics::true_places(reference.len(), |a, b| truth.are_one_place(a, b)),
        }
    }

    /// The frame that was asked about.
    pub(super) fn observation(&self, asked: Asked) -> Option<&'a Observation> {
        match asked {
            Asked::Query(query) => self.query.observations.get(query),
            Asked::Stranger(stranger) => self.unknown?.observations.get(stranger),
        }
    }

    /// The answers held against the ground truth.
    pub(super) fn judged(&self, answers: &Answers) -> Vec<Judged> {
        let mut judged = self.search.judge(&answers.query, &self.known, &answers.places);
        judged.extend(judge_strangers(&answers.unknown));
        judged
    }

    /// How many places the reference truly shows, where the ground truth knows places.
    pub(super) fn true_places(&self) -> Option<u64> {
        self.labels.iter().flatten().max().map(|&last| u64::from(last) + 1)
    }

    /// Which true place was taken for which, over the answers given.
    pub(super) fn confusion(&self, answers: &Answers, judged: &[Judged]) -> Option<Confusion> {
        let places = self.true_places()?;
        let answered = judged.iter().filter(|judged| judged.is_given && judged.best != Relation::Unsaid);
        let cells = answered.filter_map(|judged| {
            let truth = match judged.asked {
                Asked::Query(query) if judged.is_known => {
                    Some(self.labels[self.search.matches(query).next()?]?)
                }
                _ => None,
            };
            // A right answer stays on the diagonal, though the place reaches across a border between labels.
            let named = match (judged.best, truth) {
                (Relation::Same, Some(truth)) => truth,
                _ => self.labels[answers.of(judged.asked)?.candidates.first()?.reference]?,
            };
            Some((truth, named, judged.best == Relation::Same))
        });
        Some(confusion(u32::try_from(places).ok()?, cells))
    }

    /// Every answer, with what the ground truth says of it.
    pub(super) fn records(&self, answers: &Answers, judged: &[Judged]) -> Vec<AnswerRecord> {
        let mut verdicts = judged.iter().peekable();
        let queries = (0..answers.query.len()).map(Asked::Query);
        let strangers = (0..answers.unknown.len()).map(Asked::Stranger);
        let record = |asked: Asked| {
            let verdict = verdicts.next_if(|judged| judged.asked == asked);
            let answer = answers.of(asked)?;
            let best = answer.candidates.first();
            Some(AnswerRecord {
                query: self.observation(asked)?.name.clone(),
                is_known: verdict.map(|verdict| verdict.is_known),
                is_given: answer.is_given,
                confidence: answer.confidence,
                reference: best.map(|best| self.reference.observations[best.reference].name.clone()),
                place: best.and_then(|best| best.place).map(|place| place as u64),
                is_right: verdict.filter(|_| best.is_some()).and_then(|verdict| match verdict.best {
                    Relation::Same => Some(true),
                    Relation::Different => Some(false),
                    Relation::Unsaid => None,
                }),
                reason: best.map(|best| best.reason.clone()).unwrap_or_default(),
            })
        };
        queries.chain(strangers).filter_map(record).collect()
    }

    /// What reports say of the ground truth.
    pub(super) fn summary(&self) -> GroundTruthSummary {
        let scored = (0..self.query.len()).filter(|&query| self.truth.is_scored(query)).count() as u64;
        let known = self.known.iter().filter(|&&known| known).count() as u64;
        GroundTruthSummary {
            definition: self.truth.definition.clone(),
            sha256: self.truth.sha256.clone(),
            known,
            unknown: scored - known,
            unscored: self.query.len() as u64 - scored,
        }
    }
}
