//! ONNX models made and changed: a network written node by node, a head grafted onto a backbone, weights stored in
//! half the bytes, a network quantised to 8 bits.
//!
//! The format is compiled from `onnx.proto` as ONNX 1.23 publishes it (Apache-2.0). What a model computes is ONNX
//! Runtime's business; here its graph alone is looked at.

mod builder;
mod error;
mod half;
mod model;
mod names;
mod quantisation;

pub use builder::{Attribute, Dimension, GraphBuilder, Value};
pub use error::OnnxError;
pub use model::{OPSET, OnnxModel};
pub use quantisation::{Range, Ranges, STORAGE_KEY};

/// The messages of the format, as prost makes them.
#[allow(missing_docs, unreachable_pub, clippy::all, clippy::pedantic)]
mod proto {
    include!(concat!(env!("OUT_DIR"), "/onnx.rs"));
}

#[cfg(test)]
mod tests;
