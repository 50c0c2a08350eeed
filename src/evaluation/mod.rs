//! Evaluation: how often the answers are right, by a ground truth, with everything that is needed to get
//! the same figures again.
//!
//! A [`TraversePlan`] says which frames, a [`TruthPlan`] which of them show the same place. The
//! [`Evaluator`] looks at the frames once; then every [`Method`](results::Method) answers about each
//! query frame, from every reference frame ([`frames`], as the field's benchmarks do) and from the map
//! that Loci founds by itself ([`map`], as a robot does). [`judgement`] holds the answers against the
//! ground truth, [`score`] counts, and [`report`] shows.

pub mod alignment;
pub mod answer;
pub mod definitions;
mod experiment;
pub mod frames;
pub mod ground_truth;
pub mod judgement;
pub mod layout;
pub mod machine;
pub mod map;
pub mod metrics;
mod overlap;
mod paper;
pub mod report;
pub mod results;
mod scene;
pub mod score;
mod spec;
mod traverse;
mod truth_plan;
mod worst;

pub use experiment::{Evaluator, ExperimentPlan, PlannedFrames};
pub use map::RobotOptions;
pub use spec::{ExperimentSpec, FramesSpec, Suite, TruthSettings};
pub use traverse::{Eyes, Frames, Observation, Traverse, TraversePlan};
pub use truth_plan::{NamedTolerance, TruthPlan, TruthSpec, TruthSpecError};

use std::io;
use std::path::{Path, PathBuf};

use self::ground_truth::GroundTruthError;
use self::layout::LayoutError;
use self::results::Asset;
use crate::place_map::MapError;
use crate::source::SourceError;

/// Why an evaluation could not be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluationError {
    /// The frames cannot be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A folder is not laid out as it should be.
    #[error(transparent)]
    Layout(#[from] LayoutError),
    /// The ground truth is wrong or does not fit the frames.
    #[error(transparent)]
    GroundTruth(#[from] GroundTruthError),
    /// A map could not grow.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The system has no thread left.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] io::Error),
    /// None of the frames could be read.
    #[error("{name}: no frame could be read")]
    NoFrames {
        /// The traverse.
        name: String,
    },
    /// What is asked for makes no sense.
    #[error("{0}")]
    Wrong(String),
    /// A suite cannot be read.
    #[error("{}: {reason}", path.display())]
    Suite {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// An experiment of a suite cannot be planned.
    #[error("experiment '{name}', data in {}: {error}", data.display())]
    Experiment {
        /// The experiment.
        name: String,
        /// Where its paths start from.
        data: PathBuf,
        /// What is wrong.
        error: Box<EvaluationError>,
    },
    /// The paper's protocol trains on one traverse and tests on another.
    #[error("the paper's protocol trains on one traverse and rates another: name the first with --reference")]
    PaperNeedsReference,
    /// It was interrupted.
    #[error("interrupted; no figure was written")]
    Interrupted,
}

/// The file at `path` as something that figures depend on, under the name that people give it.
///
/// # Errors
/// If it cannot be read.
pub fn asset(name: impl Into<String>, path: &Path) -> io::Result<Asset> {
    Ok(Asset { name: name.into(), sha256: truth_plan::sha256(path)? })
}
