//! One experiment: look at the frames once, let every method answer from every database, and count.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::EvaluationError;
use super::alignment::misalignment;
use super::frames::FrameDatabase;
use super::judgement::{Search, horizons_of_past};
use super::machine;
use super::map::{Robot, RobotOptions};
use super::metrics;
use super::paper;
use super::results::{Baseline, Database, Experiment, Method, MethodResult, StageLatency};
use super::scene::{Answers, Scene};
use super::score::score;
use super::traverse::{Eyes, Traverse, TraversePlan};
use super::truth_plan::TruthPlan;
use super::worst;
use crate::pipeline::Watcher;
use crate::proportion::Proportion;

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
    /// How many frames back the past begins, where a sequence is compared with its own past; counted before
    /// sampling.
    pub recent_frames: u64,
    /// What else was asked for and bears on the figures, by name.
    pub options: BTreeMap<String, String>,
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

impl ExperimentPlan {
    /// Whether nothing can be found out without a CNN.
    #[must_use]
    pub fn needs_cnn(&self) -> bool {
        self.paper || !self.methods.contains(&Method::BowHv)
    }

    /// Every setting of this experiment alone, by name.
    fn settings(&self) -> BTreeMap<String, String> {
        let mut settings = self.options.clone();
        if self.frames.reference.is_none() {
            settings.insert("recent_frames".to_owned(), self.recent_frames.to_string());
        }
        if self.paper {
            settings.extend(paper::settings());
        }
        settings
    }
}

impl PlannedFrames {
    /// All traverses.
    pub fn traverses(&self) -> impl Iterator<Item = &TraversePlan> {
        [Some(&self.query), self.reference.as_ref(), self.unknown.as_ref()].into_iter().flatten()
    }
}

/// Runs experiments, one after the other.
pub struct Evaluator<'a> {
    eyes: Eyes,
    options: RobotOptions,
    keeps_pictures: bool,
    stop: &'a AtomicBool,
    watcher: &'a dyn Watcher,
    /// Traverses that were looked at, by where their frames come from.
    seen: Vec<(String, Arc<Traverse>)>,
}

impl<'a> Evaluator<'a> {
    /// An evaluator that looks with `eyes` and decides by `options`. With `keeps_pictures` it keeps what
    /// the report needs to show mistakes.
    #[must_use]
    pub fn new(
        eyes: Eyes,
        options: RobotOptions,
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

    /// Runs one experiment. What was seen is kept if one of `later` looks at it again.
    ///
    /// # Errors
    /// If frames cannot be read, the ground truth does not fit them, or it was interrupted.
    pub fn run(
        &mut self,
        plan: &ExperimentPlan,
        later: &[ExperimentPlan],
    ) -> Result<Experiment, EvaluationError> {
        machine::forget_peak_memory();
        let frames = &plan.frames;
        let query = self.look_at(&frames.query)?;
        let reference = frames.reference.as_ref().map(|plan| self.look_at(plan)).transpose()?;
        let unknown = frames.unknown.as_ref().map(|plan| self.look_at(plan)).transpose()?;
        self.forget_all_but(later);
        let searched = reference.as_ref().unwrap_or(&query);
        let truth = frames.truth.complete(&query, searched)?;
        let horizons = match &reference {
            Some(reference) => vec![reference.len(); query.len()],
            None => horizons_of_past(&query.numbers(), plan.recent_frames),
        };
        let search = Search { truth: &truth, horizons: &horizons };
        let scene = Scene::new((searched, &query, unknown.as_deref()), search);
        let all = self.answers(&scene, plan)?;
        let protocol = || paper::protocol(&scene, &self.eyes, &self.options, self.stop);
        Ok(Experiment {
            name: plan.name.clone(),
            note: plan.note.clone(),
            reference: reference.as_ref().map(|traverse| traverse.summary()),
            query: query.summary(),
            unknown: unknown.as_ref().map(|traverse| traverse.summary()),
            ground_truth: scene.summary(),
            settings: plan.settings(),
            warnings: warnings(&scene, &all, self.eyes.model.is_some()),
            results: all.iter().map(|answers| self.result(&scene, answers)).collect(),
            paper: plan.paper.then(protocol).transpose()?,
            baselines: plan.baselines.clone(),
            latency: latency(&query, &all, self.eyes.model.is_some()),
            peak_memory_bytes: machine::peak_memory_bytes(),
        })
    }

    /// Drops the traverses that no later experiment looks at.
    fn forget_all_but(&mut self, later: &[ExperimentPlan]) {
        let is_needed = |key: &String| {
            let traverses = later.iter().flat_map(|plan| plan.frames.traverses());
            traverses.into_iter().any(|plan| seen_key(plan) == *key)
        };
        self.seen.retain(|(key, _)| is_needed(key));
    }

    fn look_at(&mut self, plan: &TraversePlan) -> Result<Arc<Traverse>, EvaluationError> {
        let key = seen_key(plan);
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
                    let is_own_past = plan.frames.reference.is_none();
                    for &method in &methods {
                        all.push(self.answers_of_map(scene, (method, is_own_past))?);
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
        let mut database =
            FrameDatabase::new(scene.reference, &self.eyes.vocabularies, card, &self.options.recognition);
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

    fn answers_of_map(
        &self,
        scene: &Scene<'_>,
        (method, is_own_past): (Method, bool),
    ) -> Result<Answers, EvaluationError> {
        let mut robot = Robot::new(method, &self.eyes, &self.options)?;
        let learnt = robot.walk(scene.reference, self.stop)?;
        let places = robot.places();
        let mut robot = robot.reading_only()?;
        let run = if is_own_past { learnt } else { robot.walk(scene.query, self.stop)? };
        let unknown = match scene.unknown {
            Some(traverse) => robot.walk(traverse, self.stop)?.answers,
            None => Vec::new(),
        };
        let (query, latency_us) = (run.answers, run.latency_us);
        Ok(Answers { method, database: Database::Map, query, unknown, places, latency_us })
    }

    fn result(&self, scene: &Scene<'_>, answers: &Answers) -> MethodResult {
        let judged = scene.judged(answers);
        let mut score = score(&judged);
        if answers.database == Database::Map {
            let one_place = |a: usize, b: usize| scene.truth.are_one_place(a, b);
            score.figures.purity = metrics::purity(&answers.places, one_place);
            score.figures.false_merges =
                metrics::false_merges(&answers.places, |a, b| scene.truth.are_apart(a, b));
            score.figures.places_founded = Some(answers.places.len() as u64);
            score.figures.true_places = scene.true_places();
        }
        let mistakes =
            || worst::mistakes(scene, answers, &judged, (&self.eyes.vocabularies, &self.options.recognition));
        MethodResult {
            method: answers.method,
            database: answers.database,
            figures: score.figures,
            precision_recall: score.precision_recall,
            calibration: score.calibration,
            confusion: scene.confusion(answers, &judged),
            worst: if self.keeps_pictures { mistakes() } else { Vec::new() },
            answers: scene.records(answers, &judged),
        }
    }
}

/// Where the frames of a traverse come from, in a word.
fn seen_key(plan: &TraversePlan) -> String {
    format!("{:?} {}", plan.frames, plan.sample_interval)
}

fn warnings(scene: &Scene<'_>, all: &[Answers], has_cnn: bool) -> Vec<String> {
    let mut warnings = Vec::new();
    if !has_cnn {
        warnings.push("no CNN ran: only bow_hv is reported".to_owned());
    }
    let mut traverses = vec![scene.query];
    traverses.extend(Some(scene.reference).filter(|&reference| !std::ptr::eq(reference, scene.query)));
    traverses.extend(scene.unknown);
    for traverse in traverses.into_iter().filter(|traverse| traverse.skipped > 0) {
        let Traverse { name, skipped, .. } = traverse;
        warnings.push(format!("{skipped} frames of {name} could not be read and are in no figure"));
    }
    let finest = all.iter().min_by_key(|answers| answers.database);
    warnings.extend(finest.and_then(|answers| misalignment(&scene.search, &answers.query)));
    warnings
}

/// Time of each stage over the query frames; the last stages as the most complete method took them.
fn latency(query: &Traverse, all: &[Answers], has_cnn: bool) -> Vec<StageLatency> {
    let seen = |of: fn(&crate::pipeline::PerceptionLatency) -> u64| -> Vec<u64> {
        query.observations.iter().map(|observation| of(&observation.latency)).collect()
    };
    let mut stages = vec![
        ("decode", seen(|latency| latency.decode_us)),
        ("features", seen(|latency| latency.features_us)),
    ];
    if has_cnn {
        stages.push(("cnn", seen(|latency| latency.cnn_us)));
    }
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
