//! A graph with quantisation written into it.

use std::collections::{BTreeMap, BTreeSet};

use super::affine::{Affine, Integers};
use super::plan::{Layer, Plan};
use super::{Range, Ranges};
use crate::onnx::builder::{Attribute, packed};
use crate::onnx::error::OnnxError;
use crate::onnx::names::Names;
use crate::onnx::proto::tensor_proto::DataType;
use crate::onnx::proto::{GraphProto, NodeProto, TensorProto};

/// Quantises what `plan` says. What the graph computed before and needs no more is still there.
pub(super) fn rewrite(graph: &mut GraphProto, plan: &Plan, ranges: &Ranges) -> Result<(), OnnxError> {
    let mut writer = Writer { names: Names::of(graph), nodes: Vec::new(), weights: Vec::new() };
    let mut activations = BTreeMap::new();
    for (name, origin) in &plan.activations {
        let affine = affine(origin, ranges.get(origin))?;
        activations.insert(name.clone(), (affine, writer.names.fresh(&format!("{name} of u8"))));
    }
    let nodes = std::mem::take(&mut graph.node);
    // What no node gives is an input.
    let given: BTreeSet<String> = nodes.iter().flat_map(|node| node.output.iter().cloned()).collect();
    for (name, (affine, restored)) in activations.iter().filter(|(name, _)| !given.contains(*name)) {
        writer.pass_through_u8(name, *affine, restored);
    }
    for (index, mut node) in nodes.into_iter().enumerate() {
        if let (Some(layer), Some((affine, _))) =
            (plan.layers.get(&index), node.input.first().and_then(|input| activations.get(input)))
        {
            writer.quantise(&mut node, layer, affine.scale)?;
        }
        let takes_integers = plan.takes_integers(index, &node);
        for input in node.input.iter_mut().filter(|_| takes_integers) {
            if let Some((_, restored)) = activations.get(input) {
                input.clone_from(restored);
            }
        }
        let outputs = node.output.clone();
        writer.nodes.push(node);
        for (name, (affine, restored)) in
            outputs.iter().filter_map(|output| activations.get_key_value(output))
        {
            writer.pass_through_u8(name, *affine, restored);
        }
    }
    graph.node = writer.nodes;
    graph.initializer.extend(writer.weights);
    Ok(())
}

fn affine(name: &str, range: Option<&Range>) -> Result<Affine, OnnxError> {
    let refuse = |reason: &str| OnnxError::BadRange { name: name.to_owned(), reason: reason.to_owned() };
    let range = *range.ok_or_else(|| refuse("was not measured"))?;
    Affine::covering(range)
        .ok_or_else(|| refuse(&format!("from {} to {} is not finite", range.least, range.greatest)))
}

/// What is written so far.
struct Writer {
    names: Names,
    nodes: Vec<NodeProto>,
    weights: Vec<TensorProto>,
}

impl Writer {
    /// Quantises the value `name` and makes it f32 again, under the name `restored`.
    fn pass_through_u8(&mut self, name: &str, affine: Affine, restored: &str) {
        let scale =
            self.weight(&format!("{name} scale"), &[], DataType::Float, affine.scale.to_le_bytes().into());
        let zero = self.weight(&format!("{name} zero point"), &[], DataType::Uint8, vec![affine.zero_point]);
        let quantised = self.names.fresh(&format!("{name} as u8"));
        self.node("QuantizeLinear", [name, &scale, &zero], &quantised, None);
        self.node("DequantizeLinear", [&quantised, &scale, &zero], restored, None);
    }

    /// Makes a layer, whose input has the scale `input_scale`, take its weights and biases from integers.
    fn quantise(&mut self, node: &mut NodeProto, layer: &Layer, input_scale: f32) -> Result<(), OnnxError> {
        let [_, weights, rest @ ..] = node.input.as_mut_slice() else { return Ok(()) };
        let Some(integers) = Integers::of(layer, input_scale) else {
            let reason = "has values that are too large to be quantised".to_owned();
            return Err(OnnxError::BadWeight { name: weights.clone(), reason });
        };
        let scales = integers.weight_scales;
        let channels = scales.len();
        let raw = integers.weights.iter().map(|&weight| weight as u8).collect();
        let stored = self.weight(&format!("{weights} as s8"), &layer.weights.shape, DataType::Int8, raw);
        let zeros =
            self.weight(&format!("{weights} zero points"), &[channels], DataType::Int8, vec![0; channels]);
        let of_weights = self.scales(weights, scales.iter().copied());
        let restored = self.names.fresh(&format!("{weights} of s8"));
        self.node("DequantizeLinear", [&stored, &of_weights, &zeros], &restored, Some(layer.axis));
        *weights = restored;
        if let (Some(biases), Some(name)) = (integers.biases, rest.first_mut()) {
            let raw = biases.iter().flat_map(|bias| bias.to_le_bytes()).collect();
            let stored = self.weight(&format!("{name} as int32"), &[channels], DataType::Int32, raw);
            let of_biases = self.scales(name, scales.iter().map(|scale| scale * input_scale));
            let restored = self.names.fresh(&format!("{name} of int32"));
            self.node("DequantizeLinear", [&stored, &of_biases], &restored, Some(0));
            *name = restored;
        }
        Ok(())
    }

    /// One scale a channel, for what is called `name`.
    fn scales(&mut self, name: &str, scales: impl ExactSizeIterator<Item = f32>) -> String {
        let shape = [scales.len()];
        let raw = scales.flat_map(|scale| scale.to_le_bytes()).collect();
        self.weight(&format!("{name} scales"), &shape, DataType::Float, raw)
    }

    /// Adds a weight called `name`, or like it; answers what it is called.
    fn weight(&mut self, name: &str, shape: &[usize], kind: DataType, raw: Vec<u8>) -> String {
        let name = self.names.fresh(name);
        self.weights.push(TensorProto {
            name: Some(name.clone()),
            dims: shape.iter().map(|&length| length as i64).collect(),
            data_type: Some(kind as i32),
            raw_data: Some(raw),
            ..Default::default()
        });
        name
    }

    fn node<const N: usize>(&mut self, operator: &str, inputs: [&str; N], output: &str, axis: Option<usize>) {
        let axis = axis.map(|axis| packed("axis", &Attribute::Int(axis as i64)));
        self.nodes.push(NodeProto {
            name: Some(output.to_owned()),
            op_type: Some(operator.to_owned()),
            input: inputs.map(str::to_owned).into(),
            output: vec![output.to_owned()],
            attribute: axis.into_iter().collect(),
            ..Default::default()
        });
    }
}
