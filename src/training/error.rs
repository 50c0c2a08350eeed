//! Why a training ended without a model.

use crate::onnx::OnnxError;

/// Why a training ended without a model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainingError {
    /// There is nothing to tell apart.
    #[error("a training needs two places at least, not {classes}")]
    TooFewClasses {
        /// How many there are.
        classes: usize,
    },
    /// The loss is no number any more.
    #[error("the loss of epoch {epoch} is not finite; try a smaller learning rate")]
    NotFinite {
        /// The epoch, counted from 1.
        epoch: usize,
    },
    /// Somebody wanted no more of it.
    #[error("interrupted")]
    Interrupted,
    /// The backbone takes no head.
    #[error(transparent)]
    Onnx(#[from] OnnxError),
}
