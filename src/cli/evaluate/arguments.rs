//! What `loci evaluate` can be asked, and the experiments that follow from it.

use std::num::NonZero;
use std::path::PathBuf;

use clap::{Args, ValueHint};
use loci::evaluation::{ExperimentSpec, FramesSpec, TruthSettings};

use crate::cli::WrongArgument;
use crate::cli::settings::{StreamSettings, Switch};
use crate::cli::size::Size;

/// The suite that is run when none is named.
pub(super) const SUITE: &str = "tests/suite/suite.toml";

/// What makes an experiment, by the names of the arguments: a suite says it itself.
const EXPERIMENT: [&str; 15] = [
    "queries",
    "reference",
    "unknown",
    "query_rows",
    "reference_rows",
    "layout",
    "camera",
    "spacing",
    "truth",
    "radius",
    "lap_tolerance",
    "place_tolerance",
    "recent",
    "methods",
    "databases",
];

/// Arguments of `loci evaluate`.
#[derive(Args)]
#[command(after_help = EXAMPLES, after_long_help = format!("{LONG_HELP}\n\n{EXAMPLES}"))]
pub(in crate::cli) struct EvaluateArguments {
    /// Traverses to ask about: folders of images, video files, synthetic worlds
    #[arg(value_name = "QUERY", value_hint = ValueHint::AnyPath)]
    queries: Vec<String>,
    #[command(flatten)]
    frames: FrameArguments,
    #[command(flatten)]
    truth: TruthArguments,
    #[command(flatten)]
    pub(super) output: OutputArguments,
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
    /// Keep frames at least this far apart, where positions are known [default: the layout's]
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
    /// A query's own past begins this many frames back, counted before sampling [default: 20 times
    /// --sample-interval; kitti: at least 300]
    #[arg(long, value_name = "FRAMES")]
    recent: Option<u64>,
}

#[derive(Args)]
#[command(next_help_heading = "Output")]
pub(super) struct OutputArguments {
    /// Who answers: cnn, bow_hv, cnn+bow_hv, paper [default: the first three]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    methods: Vec<String>,
    /// What is searched: frames, map [default: both]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    databases: Vec<String>,
    /// Print JSON instead of Markdown
    #[arg(long)]
    pub(super) json: bool,
    /// Write one self-contained HTML page with curves and mistakes
    #[arg(long, value_name = "FILE.html")]
    pub(super) report: Option<PathBuf>,
    /// Write every answer as a row of this table
    #[arg(long, value_name = "FILE.csv")]
    pub(super) answers: Option<PathBuf>,
    /// Run all experiments of a suite [default: tests/suite/suite.toml, which writes BENCHMARKS.md]
    #[arg(long, value_name = "FILE.toml", num_args = 0..=1, default_missing_value = SUITE,
          conflicts_with_all = EXPERIMENT)]
    pub(super) suite: Option<PathBuf>,
    /// Folder that the paths of a suite start from [env: LOCI_DATA=] [default: what the suite says]
    #[arg(long, value_name = "DIR")]
    pub(super) data: Option<PathBuf>,
    /// Write the Markdown to this file
    #[arg(long, value_name = "FILE.md")]
    pub(super) markdown: Option<PathBuf>,
}

#[derive(Args)]
#[command(next_help_heading = "Settings")]
struct SettingArguments {
    /// Visual vocabulary; given again, a set that is switched by light [env: LOCI_VOCAB=, parted by ':']
    /// [default: vocab/default.lvoc]
    #[arg(long, value_name = "FILE")]
    vocab: Vec<PathBuf>,
    /// Folder of the CNN with its card [default: models/efficientnet-lite0]
    #[arg(long, env = "LOCI_MODEL", value_name = "DIR")]
    model: Option<PathBuf>,
    /// ONNX Runtime library [default: looked for; `loci doctor` says where]
    #[arg(long, env = "LOCI_ONNXRUNTIME", value_name = "PATH")]
    onnxruntime: Option<PathBuf>,
    /// δ_ep: processed frames that join a place unasked after its founding [default: 5]
    #[arg(long, env = "LOCI_PLACE_INTERVAL", value_name = "N")]
    place_interval: Option<u32>,
    /// Whether what the robot saw before counts, or every frame by itself; frames are always asked about one by one
    /// [default: on]
    #[arg(long, env = "LOCI_SEQUENCE", value_enum, value_name = "WHETHER")]
    sequence: Option<Switch>,
    /// Most bytes of the robot's map; what tells least is given up [default: no bound]
    #[arg(long, env = "LOCI_MAP_DISK", value_name = "SIZE")]
    map_disk: Option<Size>,
    /// Most memory of what is searched and known of the map: index and CNN descriptors of the keyframes that are
    /// searched, places and experiences. The keyframes always get a quarter of it; places not seen for long wait on
    /// the disk [default: 256MiB]
    #[arg(long, env = "LOCI_MAP_MEMORY", value_name = "SIZE")]
    map_memory: Option<Size>,
    /// Learn words online where the vocabulary covers what is seen badly; the map does, frames do not
    #[arg(long, env = "LOCI_GROW_VOCABULARY", num_args = 0..=1, require_equals = true,
          default_missing_value = "true", value_name = "BOOL")]
    grow_vocabulary: Option<bool>,
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
Ground-truth tables have a row a frame. Column `file` or `image` names it, relative to the table; where it \
was taken stands in the first of these columns that there is: `same_place_as` (earlier files of the same \
place, separated by spaces), `lap_phase`, `easting` and `northing`, `latitude` and `longitude`, `place`, any \
that ends in `_visible` (places in view, separated by spaces). A `reliable` or `usable` of 0, or an empty \
`_visible`, leaves a row unscored.

Loop matrices have a row a query frame and a column a reference frame: text, MATLAB (save with -v7), NumPy, \
or VPR-Bench's ground_truth_new.npy.

Rows of a table are chosen by COLUMN=VALUE, COLUMN=FROM..TO or COLUMN=FROM%..TO% (percentiles within each \
`place`), joined by commas; files=COLUMN says which column names the files.

A folder without images of its own gives those of its subfolders, one level deep.";

impl EvaluateArguments {
    /// The settings of looking and deciding.
    pub(super) fn stream_settings(&self) -> anyhow::Result<StreamSettings> {
        let settings = StreamSettings {
            vocab: self.settings.vocab.clone(),
            model: self.settings.model.clone(),
            onnxruntime: self.settings.onnxruntime.clone(),
            sample_interval: self.frames.sample_interval,
            place_interval: self.settings.place_interval,
            sequence: self.settings.sequence,
            map_disk: self.settings.map_disk,
            map_memory: self.settings.map_memory,
            grow_vocabulary: self.settings.grow_vocabulary,
            threads: self.settings.threads,
            ..StreamSettings::default()
        };
        settings.completed(self.settings.config.as_deref())
    }

    /// The experiments, one a query, and every how many frames one is looked at.
    pub(super) fn specs(&self, sample_interval: Option<NonZero<u32>>) -> anyhow::Result<Vec<ExperimentSpec>> {
        if self.queries.is_empty() {
            let names_rows = self.frames.query_rows.is_some() || self.frames.reference_rows.is_some();
            if self.truth.truth.is_none() && !names_rows {
                let reason =
                    "nothing to evaluate: name a QUERY, a ground-truth table with --truth, or --suite";
                return Err(WrongArgument(reason.to_owned()).into());
            }
            return Ok(vec![self.spec(None, sample_interval)]);
        }
        Ok(self.queries.iter().map(|query| self.spec(Some(query.clone()), sample_interval)).collect())
    }

    fn spec(&self, query: Option<String>, sample_interval: Option<NonZero<u32>>) -> ExperimentSpec {
        let frames = FramesSpec {
            query,
            reference: self.frames.reference.clone(),
            unknown: self.frames.unknown.clone(),
            query_rows: self.frames.query_rows.clone(),
            reference_rows: self.frames.reference_rows.clone(),
            layout: self.frames.layout.clone(),
            camera: self.frames.camera.clone(),
            spacing: self.frames.spacing,
            sample_interval: sample_interval.map(|interval| u64::from(interval.get())),
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
