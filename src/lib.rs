//! Loci: on-device visual place recognition.
//!
//! A frame enters as a [`frame::Frame`], its ORB features become visual words, its CNN descriptor
//! is compared with the places of the map, and a [`recognition::Recogniser`] decides which place
//! the robot sees. ARCHITECTURE.md walks through the floors below, from top to bottom.

#[cfg(feature = "evaluation")]
pub mod evaluation;
#[cfg(feature = "train")]
pub mod training;

pub mod pipeline;

pub mod source;
pub mod telemetry;

pub mod recognition;

pub mod place_map;
pub mod retrieval;

pub mod verification;
pub mod vocabulary;

pub mod cnn;
pub mod feature;

pub mod codec;
pub mod kernel;
#[cfg(feature = "train")]
pub mod onnx;
pub mod storage;

pub mod frame;
pub mod geometry;
#[cfg(any(feature = "evaluation", feature = "train"))]
pub mod proportion;
pub mod raster;
