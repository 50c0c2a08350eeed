//! `loci evaluate`: asks every method about every query frame, and says how often it was right.

mod arguments;
mod header;

use std::fs::File;
use std::io::{Read, Write};
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressDrawTarget};
use loci::cnn::CnnError;
use loci::evaluation::layout::LayoutError;
use loci::evaluation::results::{Asset, Experiment, Report};
use loci::evaluation::{self, EvaluationError, Evaluator, ExperimentPlan, RobotOptions, Suite, report};
use loci::kernel;
use loci::pipeline::{Seen, Watcher};
use loci::place_map::{MapError, MapOptions};
use loci::source::SourceError;
use loci::storage::{check_replaceable, replace_file};

pub(super) use self::arguments::EvaluateArguments;
use self::arguments::{OutputArguments, SUITE};
use super::console::progress_bar;
use super::settings::StreamSettings;
use super::{Outcome, WrongArgument, assets, stream};

/// Where the figures of the shipped suite go by default.
const BENCHMARKS: &str = "BENCHMARKS.md";

/// The line that a part of BENCHMARKS.md begins with that people write: a new report leaves it as it is.
const KEPT: &str = "\n<!-- From here on written by hand: `loci evaluate` keeps it. -->\n";
/// Bytes of a file in which such a part is looked for.
const MAX_KEPT_BYTES: u64 = 1 << 24;

/// Runs the experiments and says what came of them.
pub(super) fn run(arguments: EvaluateArguments) -> anyhow::Result<Outcome> {
    let settings = arguments.stream_settings()?;
    let files = OutputFiles::of(&arguments.output)?;
    // All of them before any frame is looked at: a wrong ground truth shows at once.
    let (plans, suite) = plans(&arguments, &settings)?;
    let stop = stream::stop_flag()?;
    let report = evaluate(&plans, suite, &settings, (files.report.is_some(), &stop))?;
    let is_doubtful = report.experiments.iter().any(|experiment| !experiment.warnings.is_empty());
    files.deliver(&report, arguments.output.json)?;
    Ok(if is_doubtful { Outcome::Lost } else { Outcome::Done })
}

/// The plans of the experiments, and the suite that they stand in.
fn plans(
    arguments: &EvaluateArguments,
    settings: &StreamSettings,
) -> anyhow::Result<(Vec<ExperimentPlan>, Option<Asset>)> {
    let Some(path) = &arguments.output.suite else {
        if arguments.output.data.is_some() {
            return Err(WrongArgument("--data is about a --suite, and none is given".to_owned()).into());
        }
        let specs = arguments.specs(settings.sample_interval)?;
        let plans = specs.iter().map(|spec| spec.plan(Path::new("")).map_err(wrong_argument));
        return Ok((plans.collect::<Result<_, _>>()?, None));
    };
    if settings.sample_interval.is_some() {
        let reason = "a suite says itself every how many frames one is looked at; leave sample-interval out";
        return Err(WrongArgument(reason.to_owned()).into());
    }
    let suite = Suite::read(path)?;
    let named = arguments.output.data.clone().or_else(|| std::env::var_os("LOCI_DATA").map(PathBuf::from));
    let plans = suite.plans(named.as_deref()).map_err(wrong_argument)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    Ok((plans, Some(evaluation::asset(name, path)?)))
}

/// What was asked for and makes no sense is a wrong argument; what fails is not.
fn wrong_argument(error: EvaluationError) -> anyhow::Error {
    match error {
        EvaluationError::Wrong(_)
        | EvaluationError::PaperNeedsReference
        | EvaluationError::Layout(LayoutError::BadOption { .. }) => WrongArgument(error.to_string()).into(),
        error => error.into(),
    }
}

fn evaluate(
    plans: &[ExperimentPlan],
    suite: Option<Asset>,
    settings: &StreamSettings,
    (keeps_pictures, stop): (bool, &AtomicBool),
) -> anyhow::Result<Report> {
    let vocabularies = assets::find_vocabularies(&settings.vocab)?;
    let (eyes, runtime) = stream::eyes(&vocabularies, settings)?;
    let without_answers = plans.iter().find(|plan| eyes.model.is_none() && plan.needs_cnn());
    if let Some(plan) = without_answers {
        anyhow::bail!(
            "{}: a method that was asked for needs a CNN, and none runs; `loci doctor` helps",
            plan.name
        );
    }
    let options = stream::recognition_options(settings)?;
    let threads = settings.threads.map_or(1, NonZero::get);
    let cnn = match runtime {
        Some(version) => format!("ONNX Runtime {version} on the CPU, threads: {threads}"),
        None => "no CNN".to_owned(),
    };
    let backend = format!("{cnn}; kernels in plain Rust for {}", kernel::instructions());
    let map = match settings.map_disk {
        Some(_) => stream::map_options(settings)?,
        None => MapOptions::unbounded(),
    };
    let options = RobotOptions { recognition: options, map };
    let header = header::header(&eyes, &options, (&vocabularies, suite), backend)?;
    let progress = Progress { bar: progress_bar(None, "frames", ProgressDrawTarget::stderr()) };
    let mut evaluator = Evaluator::new(eyes, options, keeps_pictures, (stop, &progress));
    let mut experiments: Vec<Experiment> = Vec::new();
    for (index, plan) in plans.iter().enumerate() {
        progress.bar.set_message(plan.name.clone());
        experiments.push(evaluator.run(plan, &plans[index + 1..])?);
    }
    progress.bar.finish_and_clear();
    Ok(Report::new(header, experiments))
}

/// Files that a report goes to.
struct OutputFiles<'a> {
    report: Option<&'a Path>,
    markdown: Option<&'a Path>,
    answers: Option<&'a Path>,
}

impl<'a> OutputFiles<'a> {
    /// The files that were asked for, and that can be written: to learn it after the work would be too late.
    fn of(output: &'a OutputArguments) -> anyhow::Result<Self> {
        let is_shipped = output.suite.as_deref() == Some(Path::new(SUITE));
        let by_default = is_shipped.then_some(Path::new(BENCHMARKS));
        let files = Self {
            report: output.report.as_deref(),
            markdown: output.markdown.as_deref().or(by_default),
            answers: output.answers.as_deref(),
        };
        let all: Vec<&Path> = [files.report, files.markdown, files.answers].into_iter().flatten().collect();
        for (index, path) in all.iter().enumerate() {
            if all[..index].contains(path) {
                let reason = format!("{} is asked for twice; name another file", path.display());
                return Err(WrongArgument(reason).into());
            }
            check_replaceable(path)?;
        }
        Ok(files)
    }

    /// Writes the files, and the rest to stdout.
    fn deliver(&self, report: &Report, as_json: bool) -> anyhow::Result<()> {
        let write = |path: Option<&Path>, content: &dyn Fn() -> anyhow::Result<Vec<u8>>| {
            let Some(path) = path else { return Ok(()) };
            replace_file(path, &[&content()?])?;
            eprintln!("loci: {} written", path.display());
            anyhow::Ok(())
        };
        write(self.report, &|| Ok(report::html(report)?.into_bytes()))?;
        let kept = self.markdown.map(kept).unwrap_or_default();
        write(self.markdown, &|| Ok((report::markdown(report) + &kept).into_bytes()))?;
        write(self.answers, &|| Ok(report::answers_csv(report)?))?;
        let text = match (as_json, self.markdown) {
            (true, _) => report::json(report)?,
            (false, None) => report::markdown(report),
            (false, Some(_)) => return Ok(()),
        };
        std::io::stdout().write_all(text.as_bytes()).context("cannot write the report to stdout")
    }
}

/// The part of the report at `path`, if there is one already, that people wrote.
fn kept(path: &Path) -> String {
    let mut text = String::new();
    let read = File::open(path).and_then(|file| file.take(MAX_KEPT_BYTES).read_to_string(&mut text));
    match (read, text.find(KEPT)) {
        (Ok(_), Some(start)) => text.split_off(start),
        _ => String::new(),
    }
}

/// Shows on stderr how many frames were looked at.
struct Progress {
    bar: ProgressBar,
}

impl Watcher for Progress {
    fn skipped(&self, error: &SourceError) {
        self.bar.suspend(|| eprintln!("loci: skipped: {error}"));
    }

    fn cnn_failed(&self, frame_name: &str, error: &CnnError) {
        self.bar.suspend(|| eprintln!("loci: {frame_name}: {error}; answered by BoW+HV alone"));
    }

    fn map_failed(&self, failure: &MapError, _: bool) {
        self.bar.suspend(|| eprintln!("loci: {failure}"));
    }

    fn seen(&self, _: &Seen) {
        self.bar.inc(1);
    }
}
