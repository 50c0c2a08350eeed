//! The CNN: one image in, one descriptor of the place out.
//!
//! A model is a folder with `model.onnx` and `card.toml` ([`ModelCard`]). ONNX Runtime executes it; the
//! library is not linked but looked for on the computer ([`find_runtime`]), checked before a line of it
//! runs, and loaded ([`OnnxRuntime`]). [`DescriptorModel`] then turns an [`RgbImage`] into a
//! [`Descriptor`]: resize and normalise ([`Preprocessor`]), run, L2-normalise. Two descriptors are compared
//! by their cosine, and [`ModelCard::probability`] says how likely that cosine means the same place.
//!
//! Everything here compiles without the feature `cnn` too; then opening a runtime answers
//! [`CnnError::NotBuilt`], so that callers need no conditional code.
//!
//! [`RgbImage`]: crate::raster::RgbImage

mod card;
mod compact;
mod descriptor;
#[cfg(feature = "cnn")]
mod engine;
#[cfg(not(feature = "cnn"))]
#[path = "engine_absent.rs"]
mod engine;
mod error;
#[cfg(feature = "train")]
mod generator;
mod library;
mod model;
#[cfg(feature = "train")]
mod observer;
mod preprocess;
mod runtime;
#[cfg(feature = "train")]
mod saving;
mod search;
mod signature;

#[cfg(all(test, feature = "cnn"))]
pub(crate) use model::tests::{MEANS, model_folder, runtime as installed_runtime, toy_network};

pub use card::{ClassCard, DecisionCard, DescriptorCard, FusionCard, InputCard, ModelCard, TrainingCard};
pub use compact::CompactDescriptor;
pub use descriptor::Descriptor;
#[cfg(feature = "train")]
pub(crate) use descriptor::dot;
pub use error::CnnError;
#[cfg(feature = "train")]
pub use generator::{ImageGenerator, PixelRange, RANGE_KEY};
pub use library::{LibraryFault, OLDEST_RUNTIME, RuntimeVersion};
pub use model::{CARD_FILE, DescriptorModel, MODEL_FILE};
#[cfg(feature = "train")]
pub use observer::Observer;
pub use preprocess::Preprocessor;
pub use runtime::OnnxRuntime;
#[cfg(feature = "train")]
pub use saving::save_model;
pub use search::{FoundLibrary, SearchedPlace, Surroundings, find_runtime};
