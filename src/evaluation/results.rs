//! What an evaluation found: the schema of the JSON report, and all that the other reports show.
//!
//! The schema is stable: fields may be added, none changes its meaning while [`SCHEMA`] stays.

use std::collections::BTreeMap;

use serde::Serialize;

use super::definitions::DEFINITIONS;
use super::metrics::{Calibration, Estimate, PrecisionRecall};
use crate::proportion::Proportion;

/// Name and version of the schema.
pub const SCHEMA: &str = "loci-evaluation-1";

/// The outcome of one command.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// What is needed to get the same figures again.
    pub header: Header,
    /// What each figure means, by its field name.
    pub definitions: BTreeMap<&'static str, &'static str>,
    /// One a query traverse.
    pub experiments: Vec<Experiment>,
}

impl Report {
    /// A report of what was found.
    #[must_use]
    pub fn new(header: Header, experiments: Vec<Experiment>) -> Self {
        Self { schema: SCHEMA, header, definitions: DEFINITIONS.into_iter().collect(), experiments }
    }
}

/// What is needed to get the same figures again.
#[derive(Clone, Debug, Serialize)]
pub struct Header {
    /// Version of Loci.
    pub loci: String,
    /// The command line.
    pub command: String,
    /// The processor as the system names it.
    pub cpu: String,
    /// Hardware threads that this process may use.
    pub cpu_threads: usize,
    /// What runs the CNN and the kernels.
    pub backend: String,
    /// The visual vocabularies; more than one are switched by light.
    pub vocabularies: Vec<Asset>,
    /// The CNN, if one ran.
    pub model: Option<Asset>,
    /// The suite that says what is asked, if it was not asked for in arguments.
    pub suite: Option<Asset>,
    /// Every setting that bears on a decision, by name.
    pub settings: BTreeMap<String, String>,
}

/// A file that the figures depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Asset {
    /// Its name.
    pub name: String,
    /// SHA-256 of its bytes, in hexadecimal.
    pub sha256: String,
}

/// One query traverse, answered by every method.
#[derive(Clone, Debug, Serialize)]
pub struct Experiment {
    /// What is asked.
    pub name: String,
    /// What a reader should know about it.
    pub note: Option<String>,
    /// The traverse that is known; `None` where a sequence is compared with its own past.
    pub reference: Option<TraverseSummary>,
    /// The traverse that is asked about.
    pub query: TraverseSummary,
    /// Frames of places that the reference does not show.
    pub unknown: Option<TraverseSummary>,
    /// What counts as right.
    pub ground_truth: GroundTruthSummary,
    /// Every setting of this experiment alone, by name.
    pub settings: BTreeMap<String, String>,
    /// What makes these figures doubtful.
    pub warnings: Vec<String>,
    /// One a method and database.
    pub results: Vec<MethodResult>,
    /// The protocol of the paper's tables, if it was asked for.
    pub paper: Option<PaperProtocol>,
    /// What others reach on the same data.
    pub baselines: Vec<Baseline>,
    /// Time a frame takes in each stage.
    pub latency: Vec<StageLatency>,
    /// Largest resident memory of this process, evaluation included, in bytes.
    pub peak_memory_bytes: Option<u64>,
}

/// Frames of a traverse.
#[derive(Clone, Debug, Serialize)]
pub struct TraverseSummary {
    /// Its name.
    pub name: String,
    /// Frames that were read.
    pub frames: u64,
    /// Frames that could not be read.
    pub skipped: u64,
}

/// What counts as right.
#[derive(Clone, Debug, Serialize)]
pub struct GroundTruthSummary {
    /// When two frames show the same place, as a sentence.
    pub definition: String,
    /// SHA-256 of the file it was read from, in hexadecimal.
    pub sha256: Option<String>,
    /// Scored query frames whose place the reference shows.
    pub known: u64,
    /// Scored query frames whose place the reference does not show.
    pub unknown: u64,
    /// Query frames that the ground truth says nothing about.
    pub unscored: u64,
}

/// Who answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub enum Method {
    /// The CNN alone.
    #[serde(rename = "cnn")]
    Cnn,
    /// Bag of words and Hough voting alone.
    #[serde(rename = "bow_hv")]
    BowHv,
    /// The decision of `loci run`.
    #[serde(rename = "cnn+bow_hv")]
    CnnBowHv,
}

impl Method {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Cnn, Self::BowHv, Self::CnnBowHv];

    /// The name in arguments and reports.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cnn => "cnn",
            Self::BowHv => "bow_hv",
            Self::CnnBowHv => "cnn+bow_hv",
        }
    }
}

/// What is searched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Database {
    /// Every reference frame, as the field's benchmarks do.
    Frames,
    /// The places and keyframes that Loci founds by itself, as a robot does.
    Map,
}

impl Database {
    /// The name in reports.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Map => "map",
        }
    }
}

/// What one method reached.
#[derive(Clone, Debug, Serialize)]
pub struct MethodResult {
    /// Who answered.
    pub method: Method,
    /// What was searched.
    pub database: Database,
    /// The figures.
    pub figures: Figures,
    /// Precision and recall at every threshold.
    pub precision_recall: PrecisionRecall,
    /// How the confidence compares with how often the answer is right.
    pub calibration: Calibration,
    /// Which place was taken for which, where the ground truth knows places.
    pub confusion: Option<Confusion>,
    /// The worst false accepts and misses.
    pub worst: Vec<ImagePair>,
    /// Every answer, given or not.
    #[serde(skip)]
    pub answers: Vec<AnswerRecord>,
}

/// What one method found for one query frame.
#[derive(Clone, Debug, Serialize)]
pub struct AnswerRecord {
    /// Name of the frame that was asked about.
    pub query: String,
    /// Whether the reference shows its place; `None` where it is not scored.
    pub is_known: Option<bool>,
    /// Whether an answer was given at the shipped threshold.
    pub is_given: bool,
    /// Confidence in the best candidate, 0 to 1.
    pub confidence: f64,
    /// Name of the best candidate: the reference frame, or the keyframe of the place.
    pub reference: Option<String>,
    /// The place it belongs to, where a map was searched.
    pub place: Option<u64>,
    /// Whether the best candidate is right; `None` where the ground truth says nothing of it.
    pub is_right: Option<bool>,
    /// Why the method answered so.
    pub reason: String,
}

/// The figures of one method; `null` where there is nothing to count.
#[derive(Clone, Debug, Default, Serialize)]
#[expect(missing_docs, reason = "DEFINITIONS has a sentence for each, which every report prints")]
pub struct Figures {
    pub recognition_rate: Option<Proportion>,
    pub precision: Option<Proportion>,
    pub recall: Option<Proportion>,
    pub keyframe_precision: Option<Proportion>,
    pub recall_at_1: Option<Proportion>,
    pub recall_at_5: Option<Proportion>,
    pub recall_at_10: Option<Proportion>,
    pub auc: Option<Estimate>,
    pub recall_at_full_precision: Option<Proportion>,
    pub false_accepts: Option<Proportion>,
    pub unjudged_answers: Option<u64>,
    pub auroc: Option<Estimate>,
    pub expected_calibration_error: Option<Estimate>,
    pub purity: Option<Proportion>,
    pub false_merges: Option<Proportion>,
    pub places_founded: Option<u64>,
    pub true_places: Option<u64>,
}

/// Which true place was taken for which, over the answers given.
#[derive(Clone, Debug, Serialize)]
pub struct Confusion {
    /// Number of true places; rows and columns of the matrix, in order of first appearance.
    pub true_places: u32,
    /// Row (true place of the query), column (true place of the matched keyframe) and number of answers.
    /// The right answers lie on the diagonal, the wrong ones beside it.
    pub cells: Vec<(u32, u32, u64)>,
    /// Answers to frames of places that the reference does not show: wrong, and in no row.
    pub of_unknown: u64,
    /// Wrong answers whose keyframe bears the label of the query's place, though it lies too far from the
    /// query itself: in no cell.
    pub near_misses: u64,
}

/// Why a pair of images is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Mistake {
    /// The answer was given and is wrong.
    FalseAccept,
    /// The reference shows the place, and no answer was given.
    Miss,
}

/// A query frame beside the reference frame it was, or should have been, matched with.
#[derive(Clone, Debug, Serialize)]
pub struct ImagePair {
    /// Why it is shown.
    pub mistake: Mistake,
    /// The frame that was asked about.
    pub query: Picture,
    /// The frame that was taken for the same place, or truly shows it.
    pub reference: Picture,
    /// Confidence of the answer, 0 to 1.
    pub confidence: f64,
    /// Why the method answered so.
    pub reason: String,
    /// Effective inliers between the two.
    pub effective_inliers: u32,
    /// Inlier pairs: x, y in the query and x, y in the reference, as shares of width and height.
    #[serde(skip)]
    pub inliers: Vec<[f32; 4]>,
}

/// One image of a pair.
#[derive(Clone, Debug, Serialize)]
pub struct Picture {
    /// Name of the frame.
    pub name: String,
    /// A small JPEG of it.
    #[serde(skip)]
    pub jpeg: Vec<u8>,
    /// Its width in pixels.
    #[serde(skip)]
    pub width_px: u32,
    /// Its height in pixels.
    #[serde(skip)]
    pub height_px: u32,
}

/// The protocol of the paper's Tables I and II: clusters of one traverse train a classifier that
/// rates another; every frame is answered, and there is no unknown class.
#[derive(Clone, Debug, Serialize)]
pub struct PaperProtocol {
    /// Clusters that BoW+HV formed on the training traverse.
    pub clusters_founded: u64,
    /// Clusters that became classes.
    pub classes: u64,
    /// Training frames that the classes hold / all training frames.
    pub training_share: Option<Proportion>,
    /// What the classifier is.
    pub classifier: String,
    /// Test frames that the CNN puts into a class of the same place / all test frames.
    pub cnn: Option<Proportion>,
    /// Test frames that BoW+HV matches with a frame of the same place / all test frames.
    pub bow_hv: Option<Proportion>,
    /// The paper's own row.
    pub published: PublishedRow,
}

/// A row of the paper's Table II, and what its section IV.B says of the classifier behind it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PublishedRow {
    /// The traverse that was rated.
    pub traverse: &'static str,
    /// Recognition rate of the CNN, in percent.
    pub cnn_percent: f64,
    /// Recognition rate of BoW+HV, in percent.
    pub bow_hv_percent: f64,
    /// Number of classes.
    pub classes: u64,
    /// Training frames that the classes hold, in percent.
    pub training_percent: f64,
}

/// What others reach on the same data.
#[derive(Clone, Debug, Serialize)]
pub struct Baseline {
    /// How.
    pub method: String,
    /// What.
    pub figure: String,
}

/// Time of one stage in microseconds.
#[derive(Clone, Debug, Serialize)]
pub struct StageLatency {
    /// Name of the stage.
    pub stage: &'static str,
    /// Frames that were timed.
    pub n: u64,
    /// Median.
    pub p50_us: u64,
    /// 90th percentile.
    pub p90_us: u64,
    /// 99th percentile.
    pub p99_us: u64,
}
