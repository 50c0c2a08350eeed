//! Weights read as f32 values, whether they are stored as f32 or as f16.

use std::collections::{BTreeMap, BTreeSet};

use crate::onnx::error::OnnxError;
use crate::onnx::half::{f16_values, f32_values};
use crate::onnx::model::is_standard;
use crate::onnx::proto::tensor_proto::DataType;
use crate::onnx::proto::{GraphProto, NodeProto, TensorProto};

/// f32 values, row-major.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Constant {
    /// Length along each axis, none of them 0.
    pub(super) shape: Vec<usize>,
    pub(super) values: Vec<f32>,
}

/// What of a graph never changes.
pub(super) struct Constants<'a> {
    tensors: BTreeMap<&'a str, &'a TensorProto>,
    /// What widens or passes on one value, by the name that it gives.
    passed_on: BTreeMap<&'a str, &'a str>,
}

impl<'a> Constants<'a> {
    pub(super) fn of(graph: &'a GraphProto) -> Self {
        let inputs: BTreeSet<&str> = graph.input.iter().map(|input| input.name()).collect();
        // A weight that is an input, too, may be another one in every run.
        let fixed = graph.initializer.iter().filter(|weight| !inputs.contains(weight.name()));
        let mut tensors: BTreeMap<&str, &TensorProto> = fixed.map(|weight| (weight.name(), weight)).collect();
        let mut passed_on = BTreeMap::new();
        for node in &graph.node {
            let [output] = node.output.as_slice() else { continue };
            match (node.op_type(), node.input.as_slice()) {
                ("Constant", []) if is_standard(node) => {
                    let mut attributes = node.attribute.iter();
                    let value = attributes.find(|a| a.name() == "value").and_then(|value| value.t.as_ref());
                    tensors.extend(value.map(|value| (output.as_str(), value)));
                }
                ("Identity" | "Cast", [from]) if passes_f32_on(node) => {
                    passed_on.insert(output.as_str(), from.as_str());
                }
                _ => {}
            }
        }
        Self { tensors, passed_on }
    }

    /// The name under which the values of `name` are stored, if they are constant.
    pub(super) fn stored_as(&self, name: &str) -> Option<&'a str> {
        let mut name = name;
        // As many steps as there are nodes to take, for a graph that is no graph may run in a circle.
        for _ in 0..=self.passed_on.len() {
            match self.tensors.get_key_value(name) {
                Some((&stored, _)) => return Some(stored),
                None => name = self.passed_on.get(name)?,
            }
        }
        None
    }

    /// The values of `name`; nothing if they are not constant or of another type.
    ///
    /// # Errors
    /// [`OnnxError::BadWeight`] if they do not fit their shape, or if one is not finite.
    pub(super) fn read(&self, name: &str) -> Result<Option<Constant>, OnnxError> {
        let Some(tensor) = self.stored_as(name).and_then(|stored| self.tensors.get(stored)) else {
            return Ok(None);
        };
        let Some(values) = f32_values(tensor).or_else(|| f16_values(tensor)) else { return Ok(None) };
        let refuse = |reason: String| OnnxError::BadWeight { name: tensor.name().to_owned(), reason };
        let lengths =
            tensor.dims.iter().map(|&length| usize::try_from(length).ok().filter(|&length| length > 0));
        let shape: Option<Vec<usize>> = lengths.collect();
        let count =
            |shape: &Vec<usize>| shape.iter().try_fold(1_usize, |count, &length| count.checked_mul(length));
        match shape {
            Some(shape) if count(&shape) == Some(values.len()) => {
                if values.iter().all(|value| value.is_finite()) {
                    Ok(Some(Constant { shape, values }))
                } else {
                    Err(refuse("has a value that is not finite".to_owned()))
                }
            }
            _ => Err(refuse(format!("has {} values, which do not make up {:?}", values.len(), tensor.dims))),
        }
    }
}

/// Whether what the node gives is what it takes, as f32.
fn passes_f32_on(node: &NodeProto) -> bool {
    let mut attributes = node.attribute.iter();
    let to = attributes.find(|attribute| attribute.name() == "to").map(|to| to.i());
    is_standard(node) && (node.op_type() == "Identity" || to == Some(DataType::Float as i64))
}
