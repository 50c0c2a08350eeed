//! One experiment: look at the frames once, let every method answer from every database, and count.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::EvaluationError;
use super::alignment::misalignment;
use super::answer::Answer;
use super::frames::FrameDatabase;
use super::ground_truth::{GroundTruth, Relation};
use super::judgement::{Judged, Search, judge_strangers};
use super::machine;
use super::map::Robot;
use super::metrics::{self, Proportion};
use super::paper;
use super::results::{
    Baseline, Confusion, Database, Experiment, GroundTruthSummary, Method, MethodResult, StageLatency,
};
use super::score::{confusion, score};
use super::traverse::{Eyes, Traverse, TraversePlan};
use super::truth_plan::TruthPlan;
use super::worst;
use crate::pipeline::Watcher;
use crate::recognition::RecognitionOptions;

/// What to find out.
#[derive(Clone, Debug)]
pub struct ExperimentPlan {
    /// What is asked.
    pub name: String,
    /// What a reader should know about it.
    pub note: Option<String>,
    /// The traverses and what counts as right.
    pub frames: PlannedFrames,
    /// Who answers.
    pub methods: Vec<Method>,
    /// What is searched.
    pub databases: Vec<Database>,
    /// Whether the paper's protocol is followed as well.
    pub paper: bool,
    /// How many frames back the past begins, where a sequence is compared with its own past.
    pub recent: usize,
    /// What others reach on the same data.
    pub baselines: Vec<Baseline>,
}

/// Traverses that were not looked at yet, and what counts as right.
#[derive(Clone, Debug)]
pub struct PlannedFrames {
    /// The traverse that is known; `None` for the query's own past.
    pub reference: Option<TraversePlan>,
    /// The traverse that is asked about.
    pub query: TraversePlan,
    /// Frames of places that the reference does not show.
    pub unknown: Option<TraversePlan>,
    /// What counts as right.
    pub truth: TruthPlan,
}

/// Runs experiments, one after the other.
pub struct Evaluator<'a> {
    eyes: Eyes,
    options: RecognitionOptions,
    keeps_pictures: bool,
    stop: &'a AtomicBool,
    watcher: &'a dyn Watcher,
    /// Traverses that were looked at, by where their frames come from.
    seen: Vec<(String, Arc<Traverse>)>,
}

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
    unknown: Vec<Answer>,
    /// The reference frames of each place that was founded, where a map was searched.
    places: Vec<Vec<usize>>,
    /// Time of retrieval and of verification and decision, where a map was searched.
    latency_us: Vec<(u64, u64)>,
}

impl<'a> Evaluator<'a> {
    /// An evaluator that looks with `eyes` and decides by `options`. With `keeps_pictures` it keeps what
    /// the report needs to show mistakes.
    #[must_use]
    pub fn new(
        eyes: Eyes,
        options: RecognitionOptions,
        keeps_pictures: bool,
        (stop, watcher): (&'a AtomicBool, &'a dyn Watcher),
    ) -> Self {
        Self { eyes, options, keeps_pictures, stop, watcher, seen: Vec::new() }
    }

    /// What looks at the frames.
    #[must_use]
    pub fn eyes(&self) -> &Eyes {
        &self.eyes
    }

    /// Runs one experiment.
    ///
    /// # Errors
    /// If frames cannot be read, the ground truth does not fit them, or it was interrupted.
    pub fn run(&mut self, plan: &ExperimentPlan) -> Result<Experiment, EvaluationError> {
        machine::forget_peak_memory();
        let query = self.look_at(&plan.frames.query)?;
        let reference = plan.frames.reference.as_ref().map(|plan| self.look_at(plan)).transpose()?;
        let unknown = plan.frames.unknown.as_ref().map(|plan| self.look_at(plan)).transpose()?;
        let searched = reference.as_ref().unwrap_or(&query);
        let truth = plan.frames.truth.complete(&query, searched)?;
        let recent = reference.is_none().then_some(plan.recent);
        let search = Search { truth: &truth, reference_frames: searched.len(), recent };
        let scene = Scene {
            reference: searched,
            query: &query,
            unknown: unknown.as_deref(),
            truth: &truth,
            search,
            known: (0..query.len()).map(|query| truth.is_scored(query) && search.is_known(query)).collect(),
            labels: metrics::true_places(searched.len(), |a, b| truth.are_one_place(a, b)),
        };
        let all = self.answers(&scene, plan)?;
        let paper = if plan.paper { Some(paper::protocol(&scene, &self.eyes, &self.options)?) } else { None };
        Ok(Experiment {
            name: plan.name.clone(),
            note: plan.note.clone(),
            reference: reference.as_ref().map(|traverse| traverse.summary()),
            query: query.summary(),
            unknown: unknown.as_ref().map(|traverse| traverse.summary()),
            ground_truth: summary(&scene),
            settings: std::collections::BTreeMap::new(),
            warnings: warnings(&scene, &all, self.eyes.model.is_some()),
            results: all.iter().map(|answers| self.result(&scene, answers)).collect(),
            paper,
            baselines: plan.baselines.clone(),
            latency: latency(&query, &all),
            peak_memory_bytes: machine::peak_memory_bytes(),
        })
    }

    fn look_at(&mut self, plan: &TraversePlan) -> Result<Arc<Traverse>, EvaluationError> {
        let key = format!("{:?} {}", plan.frames, plan.sample_interval);
        if let Some((_, traverse)) = self.seen.iter().find(|(known, _)| *known == key) {
            return Ok(Arc::clone(traverse));
        }
        let traverse = plan.observe(&mut self.eyes, self.keeps_pictures, (self.stop, self.watcher))?;
        let traverse = Arc::new(traverse);
        self.seen.push((key, Arc::clone(&traverse)));
        Ok(traverse)
    }

    fn answers(&self, scene: &Scene<'_>, plan: &ExperimentPlan) -> Result<Vec<Answers>, EvaluationError> {
        let has_cnn = self.eyes.model.is_some();
        let methods: Vec<Method> =
            plan.methods.iter().copied().filter(|&method| has_cnn || method == Method::BowHv).collect();
        let mut all = Vec::new();
        for &database in &plan.databases {
            match database {
                Database::Frames => all.extend(self.answers_of_frames(scene, &methods)?),
                Database::Map => {
                    for &method in &methods {
                        self.go_on()?;
                        all.push(self.answers_of_map(scene, method)?);
                    }
                }
            }
        }
        Ok(all)
    }

    fn go_on(&self) -> Result<(), EvaluationError> {
        if self.stop.load(Ordering::Relaxed) { Err(EvaluationError::Interrupted) } else { Ok(()) }
    }

    fn answers_of_frames(
        &self,
        scene: &Scene<'_>,
        methods: &[Method],
    ) -> Result<Vec<Answers>, EvaluationError> {
        let card = self.eyes.model.as_ref().map(|model| model.card());
        let mut database = FrameDatabase::new(scene.reference, &self.eyes.vocabulary, card, &self.options);
        let answers = |method: &Method| Answers {
            method: *method,
            database: Database::Frames,
            query: Vec::new(),
            unknown: Vec::new(),
            places: Vec::new(),
            latency_us: Vec::new(),
        };
        let mut all: Vec<Answers> = methods.iter().map(answers).collect();
        for (index, query) in scene.query.observations.iter().enumerate() {
            self.go_on()?;
            let answered = database.answer(query, scene.search.horizon(index), methods);
            all.iter_mut().zip(answered).for_each(|(all, answer)| all.query.push(answer));
        }
        for stranger in scene.unknown.iter().flat_map(|traverse| &traverse.observations) {
            self.go_on()?;
            let answered = database.answer(stranger, scene.reference.len(), methods);
            all.iter_mut().zip(answered).for_each(|(all, answer)| all.unknown.push(answer));
        }
        Ok(all)
    }

    fn answers_of_map(&self, scene: &Scene<'_>, method: Method) -> Result<Answers, EvaluationError> {
        let mut robot = Robot::new(method, &self.eyes, &self.options)?;
        let learnt = robot.walk(scene.reference)?;
        let places = robot.places();
        let mut robot = robot.reading_only();
        let run = if scene.search.recent.is_some() { learnt } else { robot.walk(scene.query)? };
        let unknown = match scene.unknown {
            Some(traverse) => robot.walk(traverse)?.answers,
            None => Vec::new(),
        };
        let (query, latency_us) = (run.answers, run.latency_us);
        Ok(Answers { method, database: Database::Map, query, unknown, places, latency_us })
    }

    fn result(&self, scene: &Scene<'_>, answers: &Answers) -> MethodResult {
        let judged = judged(scene, answers);
        let mut score = score(&judged);
        if answers.database == Database::Map {
            let one_place = |a: usize, b: usize| scene.truth.are_one_place(a, b);
            score.figures.purity = metrics::purity(&answers.places, one_place);
            score.figures.places_founded = Some(answers.places.len() as u64);
            score.figures.true_places = true_places(scene);
        }
        MethodResult {
            method: answers.method,
            database: answers.database,
            figures: score.figures,
            precision_recall: score.precision_recall,
            calibration: score.calibration,
            answers: Vec::new(),
            confusion: confused_places(scene, answers, &judged),
            worst: if self.keeps_pictures {
                worst::mistakes(scene, answers, &judged, &self.options)
            } else {
                Vec::new()
            },
        }
    }
}

fn judged(scene: &Scene<'_>, answers: &Answers) -> Vec<Judged> {
    let mut judged = scene.search.judge(&answers.query, &scene.known, &answers.places);
    judged.extend(judge_strangers(&answers.unknown));
    judged
}

fn true_places(scene: &Scene<'_>) -> Option<u64> {
    scene.labels.iter().flatten().max().map(|&last| u64::from(last) + 1)
}

/// Which true place was taken for which, over the answers to known frames.
fn confused_places(scene: &Scene<'_>, answers: &Answers, judged: &[Judged]) -> Option<Confusion> {
    let places = true_places(scene)?;
    let answered = judged.iter().filter(|judged| judged.is_given && judged.best != Relation::Unsaid);
    let cells = answered.filter_map(|judged| {
        let query = judged.query?;
        let truth = scene.labels[scene.search.matches(query).next()?]?;
        // A right answer stays on the diagonal, though the place reaches across a border between labels.
        let named = match judged.best {
            Relation::Same => truth,
            _ => scene.labels[answers.query[query].candidates.first()?.reference]?,
        };
        Some((truth, named))
    });
    Some(confusion(u32::try_from(places).ok()?, cells))
}

fn summary(scene: &Scene<'_>) -> GroundTruthSummary {
    let scored = (0..scene.query.len()).filter(|&query| scene.truth.is_scored(query)).count() as u64;
    let known = scene.known.iter().filter(|&&known| known).count() as u64;
    GroundTruthSummary {
        definition: scene.truth.definition.clone(),
        sha256: scene.truth.sha256.clone(),
        known,
        unknown: scored - known,
        unscored: scene.query.len() as u64 - scored,
    }
}

fn warnings(scene: &Scene<'_>, all: &[Answers], has_cnn: bool) -> Vec<String> {
    let mut warnings = Vec::new();
    if !has_cnn {
        warnings.push("no CNN ran: only bow_hv is reported".to_owned());
    }
    let mut traverses = vec![scene.query];
    traverses.extend(scene.search.recent.is_none().then_some(scene.reference));
    traverses.extend(scene.unknown);
    for traverse in traverses.into_iter().filter(|traverse| traverse.skipped > 0) {
        let Traverse { name, skipped, .. } = traverse;
        warnings.push(format!("{skipped} frames of {name} could not be read and are in no figure"));
    }
    let frames = all.iter().find(|answers| answers.database == Database::Frames);
    warnings.extend(frames.and_then(|answers| misalignment(&scene.search, &answers.query)));
    warnings
}

/// Time of each stage over the query frames; the last stages as the most complete method took them.
fn latency(query: &Traverse, all: &[Answers]) -> Vec<StageLatency> {
    let seen = |of: fn(&crate::pipeline::PerceptionLatency) -> u64| -> Vec<u64> {
        query.observations.iter().map(|observation| of(&observation.latency)).collect()
    };
    let mut stages = vec![
        ("decode", seen(|latency| latency.decode_us)),
        ("features", seen(|latency| latency.features_us)),
        ("cnn", seen(|latency| latency.cnn_us)),
    ];
    let complete = all.iter().filter(|answers| !answers.latency_us.is_empty()).max_by_key(|a| a.method);
    if let Some(answers) = complete {
        let decided = &answers.latency_us;
        stages.push(("retrieval", decided.iter().map(|latency| latency.0).collect()));
        stages.push(("verification", decided.iter().map(|latency| latency.1).collect()));
        let total = query.observations.iter().zip(decided).map(|(seen, decided)| {
            let seen = seen.latency;
            seen.decode_us + seen.features_us.max(seen.cnn_us) + decided.0 + decided.1
        });
        stages.push(("total", total.collect()));
    }
    stages.into_iter().filter_map(|(stage, micros)| stage_latency(stage, micros)).collect()
}

fn stage_latency(stage: &'static str, mut micros: Vec<u64>) -> Option<StageLatency> {
    micros.sort_unstable();
    let at = |share| metrics::quantile(&micros, share);
    Some(StageLatency {
        stage,
        n: micros.len() as u64,
        p50_us: at(0.5)?,
        p90_us: at(0.9)?,
        p99_us: at(0.99)?,
    })
}

/// The share of frames for which `which` holds.
pub(super) fn share_of(frames: impl Iterator<Item = bool>) -> Option<Proportion> {
    let (n, successes) = frames.fold((0, 0), |(n, right), is_right| (n + 1, right + u64::from(is_right)));
    Proportion::new(successes, n)
}
