//! `loci evaluate`: how often the answers are right.

use std::collections::BTreeMap;
use std::io::Write;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use clap::{Args, ValueHint};
use indicatif::{ProgressBar, ProgressDrawTarget};
use loci::cnn::{CnnError, ModelCard};
use loci::evaluation::results::{Experiment, Header, Report};
use loci::evaluation::{
    EvaluationError, Evaluator, ExperimentPlan, ExperimentSpec, Eyes, FramesSpec, Suite, TruthSettings,
    machine, report,
};
use loci::pipeline::{Seen, Watcher};
use loci::recognition::RecognitionOptions;
use loci::source::SourceError;
use loci::storage::replace_file;

use super::console::progress_bar;
use super::settings::StreamSettings;
use super::{Outcome, WrongArgument, assets, stream};

/// The suite that is run where none is named.
const SUITE: &str = "tests/suite/suite.toml";
/// Where a suite's figures go by default.
const BENCHMARKS: &str = "BENCHMARKS.md";

/// Arguments of `loci evaluate`.
#[derive(Args)]
#[command(after_help = EXAMPLES, after_long_help = LONG_HELP)]
pub(super) struct EvaluateArguments {
    /// Traverses to ask about: folders of images, video files, synthetic worlds
    #[arg(value_name = "QUERY", value_hint = ValueHint::AnyPath)]
    queries: Vec<String>,
    #[command(flatten)]
    frames: FrameArguments,
    #[command(flatten)]
    truth: TruthArguments,
    #[command(flatten)]
    output: OutputArguments,
    #[command(flatten)]
    settings: SettingArguments,
}

#[derive(Args)]
#[command(next_help_heading = "Frames")]
struct FrameArguments {
    /// The traverse that is known [default: what QUERY showed before]
    #[arg(long, value_name = "SOURCE")]
    reference: Option<String>,
    /// Frames of places that the reference does not show
    #[arg(long, value_name = "SOURCE")]
    unknown: Option<String>,
    /// Ask about these rows of the ground-truth table: lap=3.. or mean_luminance=..30%
    #[arg(long, value_name = "ROWS")]
    query_rows: Option<String>,
    /// Know these rows of the ground-truth table
    #[arg(long, value_name = "ROWS")]
    reference_rows: Option<String>,
    /// How the folders are laid out: images, st-lucia, city-centre, new-college, kitti, nordland,
    /// gardens-point [default: images]
    #[arg(long, value_name = "NAME")]
    layout: Option<String>,
    /// Camera of a layout that has two: left or right [default: left]
    #[arg(long, value_name = "SIDE")]
    camera: Option<String>,
    /// Keep frames at least this far apart, where a layout knows positions [default: the layout's]
    #[arg(long, value_name = "METRES")]
    spacing: Option<f64>,
    /// Look at every N-th frame [default: 1]
    #[arg(long, env = "LOCI_SAMPLE_INTERVAL", value_name = "N")]
    sample_interval: Option<NonZero<u32>>,
}

#[derive(Args)]
#[command(next_help_heading = "Ground truth")]
struct TruthArguments {
    /// Table or loop matrix (.csv .txt .mat .npy), frames=N, radius=METRES, places=N, folders, none
    /// [default: the layout's]
    #[arg(long, value_name = "TRUTH")]
    truth: Option<String>,
    /// Positions of one place lie within this [default: 25]
    #[arg(long, value_name = "METRES")]
    radius: Option<f64>,
    /// Lap phases of one place lie within this share of a lap [default: 0.05]
    #[arg(long, value_name = "SHARE")]
    lap_tolerance: Option<f64>,
    /// Numbers of one place differ by at most this [default: 0]
    #[arg(long, value_name = "N")]
    place_tolerance: Option<i64>,
    /// A query's own past begins this many frames back [default: 20; kitti: 300]
    #[arg(long, value_name = "FRAMES")]
    recent: Option<usize>,
}

#[derive(Args)]
#[command(next_help_heading = "Output")]
struct OutputArguments {
    /// Who answers: cnn, bow_hv, cnn+bow_hv, paper [default: the first three]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    methods: Vec<String>,
    /// What is searched: frames, map [default: both]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    databases: Vec<String>,
    /// Print JSON instead of Markdown
    #[arg(long)]
    json: bool,
    /// Write one self-contained HTML page with curves and mistakes
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Run all experiments of a suite [default: tests/suite/suite.toml] and write BENCHMARKS.md
    #[arg(long, value_name = "FILE.toml", num_args = 0..=1, default_missing_value = SUITE,
          conflicts_with = "queries")]
    suite: Option<PathBuf>,
    /// Folder that the paths of a suite start from [default: what the suite says]
    #[arg(long, env = "LOCI_DATA", value_name = "DIR")]
    data: Option<PathBuf>,
    /// Write the Markdown to this file [default with --suite: BENCHMARKS.md]
    #[arg(long, value_name = "FILE.md")]
    markdown: Option<PathBuf>,
}

#[derive(Args)]
#[command(next_help_heading = "Settings")]
struct SettingArguments {
    /// Visual vocabulary [default: vocab/default.lvoc]
    #[arg(long, env = "LOCI_VOCAB", value_name = "FILE")]
    vocab: Option<PathBuf>,
    /// Folder of the CNN with its card [default: models/efficientnet-lite0]
    #[arg(long, env = "LOCI_MODEL", value_name = "DIR")]
    model: Option<PathBuf>,
    /// ONNX Runtime library [default: looked for; `loci doctor` says where]
    #[arg(long, env = "LOCI_ONNXRUNTIME", value_name = "PATH")]
    onnxruntime: Option<PathBuf>,
    /// δ_ep: processed frames that join a place unasked after its founding [default: 5]
    #[arg(long, env = "LOCI_PLACE_INTERVAL", value_name = "N")]
    place_interval: Option<u32>,
    /// Threads of the CNN [default: 1]
    #[arg(long, env = "LOCI_THREADS", value_name = "N")]
    threads: Option<NonZero<u32>>,
    /// Read settings from this TOML file; its keys are the flags' names
    #[arg(long, env = "LOCI_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
}

const EXAMPLES: &str = "Examples:\n  \
    loci evaluate 'synthetic:street?laps=2&light=dusk' --reference 'synthetic:street?laps=1&light=noon'\n  \
    loci evaluate monday --truth monday/ground_truth.csv --report monday.html\n  \
    loci evaluate night --reference day --layout nordland --json\n  \
    loci evaluate --suite";

const LONG_HELP: &str = "\
Ground-truth tables have a row a frame. Column `file` or `image` names it, relative to the table; where it\n\
was taken stands in the first of these columns that there is: `same_place_as` (earlier files of the same\n\
place, separated by spaces), `lap_phase`, `easting` and `northing`, `latitude` and `longitude`, `place`, any\n\
that ends in `_visible` (places in view, separated by spaces). A `reliable` or `usable` of 0 leaves a row\n\
unscored.\n\
\n\
Loop matrices have a row a query frame and a column a reference frame: text, MATLAB (save with -v7), NumPy,\n\
or VPR-Bench's ground_truth_new.npy.\n\
\n\
Rows of a table are chosen by COLUMN=VALUE, COLUMN=FROM..TO or COLUMN=FROM%..TO% (percentiles within each\n\
`place`), joined by commas; files=COLUMN says which column names the files.";

/// Runs the experiments and says what came of them.
pub(super) fn run(arguments: EvaluateArguments) -> anyhow::Result<Outcome> {
    let output = &arguments.output;
    let settings = arguments.settings.stream_settings()?;
    let specs = arguments.specs()?;
    let folder = match &output.suite {
        Some(path) => Suite::read(path)?.data(output.data.as_deref()),
        None => PathBuf::new(),
    };
    // All of them before any frame is looked at: a wrong ground truth shows at once.
    let plans: Vec<ExperimentPlan> =
        specs.iter().map(|spec| spec.plan(&folder).map_err(wrong_argument)).collect::<Result<_, _>>()?;
    let stop = stream::stop_flag()?;
    let report = evaluate(&plans, &settings, output.report.is_some(), &stop)?;
    let lost = report.experiments.iter().any(|experiment| !experiment.warnings.is_empty());
    deliver(&report, output)?;
    Ok(if lost { Outcome::Lost } else { Outcome::Done })
}

impl EvaluateArguments {
    /// The experiments of the suite, or one a query.
    fn specs(&self) -> anyhow::Result<Vec<ExperimentSpec>> {
        if let Some(path) = &self.output.suite {
            return Ok(Suite::read(path)?.experiments);
        }
        if self.queries.is_empty() {
            if self.truth.truth.is_none() {
                let reason =
                    "nothing to evaluate: name a QUERY, a ground-truth table with --truth, or --suite";
                return Err(WrongArgument(reason.to_owned()).into());
            }
            return Ok(vec![self.spec(None)]);
        }
        Ok(self.queries.iter().map(|query| self.spec(Some(query.clone()))).collect())
    }

    fn spec(&self, query: Option<String>) -> ExperimentSpec {
        let frames = FramesSpec {
            query,
            reference: self.frames.reference.clone(),
            unknown: self.frames.unknown.clone(),
            query_rows: self.frames.query_rows.clone(),
            reference_rows: self.frames.reference_rows.clone(),
            layout: self.frames.layout.clone(),
            camera: self.frames.camera.clone(),
            spacing: self.frames.spacing,
            sample_interval: self.frames.sample_interval.map(|interval| u64::from(interval.get())),
        };
        let truth = TruthSettings {
            from: self.truth.truth.clone(),
            radius: self.truth.radius,
            lap_tolerance: self.truth.lap_tolerance,
            place_tolerance: self.truth.place_tolerance,
            recent: self.truth.recent,
        };
        ExperimentSpec {
            frames,
            truth,
            methods: self.output.methods.clone(),
            databases: self.output.databases.clone(),
            ..ExperimentSpec::default()
        }
    }
}

impl SettingArguments {
    fn stream_settings(&self) -> anyhow::Result<StreamSettings> {
        let settings = StreamSettings {
            vocab: self.vocab.clone(),
            model: self.model.clone(),
            onnxruntime: self.onnxruntime.clone(),
            place_interval: self.place_interval,
            threads: self.threads,
            ..StreamSettings::default()
        };
        settings.completed(self.config.as_deref())
    }
}

/// What was asked for and makes no sense is a wrong argument; what fails is not.
fn wrong_argument(error: EvaluationError) -> anyhow::Error {
    match error {
        EvaluationError::Wrong(reason) => WrongArgument(reason).into(),
        error => error.into(),
    }
}

fn evaluate(
    plans: &[ExperimentPlan],
    settings: &StreamSettings,
    keeps_pictures: bool,
    stop: &AtomicBool,
) -> anyhow::Result<Report> {
    let vocabulary_path = assets::find(settings.vocab.as_deref(), assets::VOCABULARY, "--vocab")?;
    let (eyes, runtime) = stream::eyes(&vocabulary_path, settings)?;
    let options = stream::recognition_options(settings);
    let threads = settings.threads.map_or(1, NonZero::get);
    let backend = match runtime {
        Some(version) => {
            format!("ONNX Runtime {version} on the CPU, threads: {threads}; kernels in scalar Rust")
        }
        None => "no CNN; kernels in scalar Rust".to_owned(),
    };
    let header = header(&eyes, &options, &vocabulary_path, backend)?;
    let progress = Progress { bar: progress_bar(None, ProgressDrawTarget::stderr()) };
    let mut evaluator = Evaluator::new(eyes, options, keeps_pictures, (stop, &progress));
    let mut experiments: Vec<Experiment> = Vec::new();
    for plan in plans {
        progress.bar.set_message(plan.name.clone());
        experiments.push(evaluator.run(plan)?);
    }
    progress.bar.finish_and_clear();
    Ok(Report::new(header, experiments))
}

fn header(
    eyes: &Eyes,
    options: &RecognitionOptions,
    vocabulary: &Path,
    backend: String,
) -> anyhow::Result<Header> {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let card = eyes.model.as_ref().map(|model| model.card());
    Ok(Header {
        loci: env!("CARGO_PKG_VERSION").to_owned(),
        command: command_line(std::env::args().skip(1)),
        cpu: machine::cpu(),
        cpu_threads: machine::cpu_threads(),
        backend,
        vocabulary: loci::evaluation::asset(name(vocabulary), vocabulary)?,
        model: card.map(|card| loci::evaluation::results::Asset {
            name: format!("{} {}", card.name, card.version),
            sha256: card.sha256.clone(),
        }),
        suite: None,
        settings: setting_values(options, card),
    })
}

/// Every setting that bears on a decision.
fn setting_values(options: &RecognitionOptions, card: Option<&ModelCard>) -> BTreeMap<String, String> {
    let verification = &options.verification;
    let mut values = BTreeMap::from([
        ("place_interval".to_owned(), options.place_interval.to_string()),
        ("min_inliers".to_owned(), options.min_inliers.to_string()),
        ("verification.loose_tolerance".to_owned(), verification.loose_tolerance.to_string()),
        ("verification.tight_tolerance".to_owned(), verification.tight_tolerance.to_string()),
        ("verification.max_area_ratio".to_owned(), verification.max_area_ratio.to_string()),
        ("verification.grid_cells".to_owned(), verification.grid_cells.to_string()),
        ("matching.max_distance_bits".to_owned(), verification.matching.max_distance_bits.to_string()),
        ("matching.max_ratio".to_owned(), verification.matching.max_ratio.to_string()),
    ]);
    if let Some(card) = card {
        values.insert("cnn.recognise_above".to_owned(), card.decision.recognise_above.to_string());
    }
    values
}

/// The command line as one would type it again.
fn command_line(arguments: impl Iterator<Item = String>) -> String {
    let quoted = arguments.map(|argument| {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_=./,:%+".contains(c);
        if !argument.is_empty() && argument.chars().all(is_plain) {
            argument
        } else {
            format!("'{}'", argument.replace('\'', "'\\''"))
        }
    });
    std::iter::once("loci".to_owned()).chain(quoted).collect::<Vec<_>>().join(" ")
}

/// Writes the files that were asked for, and the rest to stdout.
fn deliver(report: &Report, output: &OutputArguments) -> anyhow::Result<()> {
    if let Some(path) = &output.report {
        replace_file(path, &[report::html(report)?.as_bytes()])?;
        eprintln!("loci: {} written", path.display());
    }
    let markdown = output.markdown.clone().or_else(|| output.suite.as_ref().map(|_| BENCHMARKS.into()));
    if let Some(path) = &markdown {
        replace_file(path, &[report::markdown(report).as_bytes()])?;
        eprintln!("loci: {} written", path.display());
    }
    if output.json {
        std::io::stdout().write_all(report::json(report)?.as_bytes())?;
    } else if markdown.is_none() {
        std::io::stdout().write_all(report::markdown(report).as_bytes())?;
    }
    Ok(())
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

    fn seen(&self, _: &Seen) {
        self.bar.inc(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_can_be_typed_again() {
        let arguments = ["evaluate", "synthetic:street?laps=2&light=dusk", "it's", "--recent=5"];
        let typed = command_line(arguments.into_iter().map(str::to_owned));
        assert_eq!(typed, "loci evaluate 'synthetic:street?laps=2&light=dusk' 'it'\\''s' --recent=5");
    }
}
