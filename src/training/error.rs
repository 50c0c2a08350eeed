//! Why a training ended without a model.

use super::device::DeviceChoice;
use crate::cnn::CnnError;
use crate::onnx::OnnxError;
use crate::place_map::MapError;
use crate::storage::StorageError;

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
    /// There is nothing to judge a model by.
    #[error(
        "no image that can be looked at is held out to judge a model by; let the robot see more of its places"
    )]
    NothingHeldOut,
    /// There is nothing to fit a threshold on.
    #[error("all places that can be looked at are next to each other: no frame shows what is none of them")]
    NothingElse,
    /// There is nothing to see how large activations become, or how far two models agree.
    #[error("not one image that can be looked at; a quantisation needs some of the place")]
    NoImages,
    /// The loss is no number any more.
    #[error("the loss of epoch {epoch} is not finite; what the epochs before came to is kept")]
    NotFinite {
        /// The epoch, counted from 1.
        epoch: usize,
    },
    /// There is no such device.
    #[error("no device {wanted}: {reason}")]
    NoSuchDevice {
        /// What was wanted.
        wanted: DeviceChoice,
        /// Why there is none, and what helps.
        reason: &'static str,
    },
    /// The device did not give back what it computed.
    #[error("the device fails: {reason}")]
    Device {
        /// What it says.
        reason: String,
    },
    /// An image was there when the training began, and is not any more.
    #[error("an image of the map cannot be read any more; begin the training again")]
    ImageGone,
    /// Somebody wanted no more of it.
    #[error("interrupted")]
    Interrupted,
    /// An image could not be described.
    #[error(transparent)]
    Cnn(#[from] CnnError),
    /// A map cannot be read.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The model cannot be written.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The backbone takes no head.
    #[error(transparent)]
    Onnx(#[from] OnnxError),
}
