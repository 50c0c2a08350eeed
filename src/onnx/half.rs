//! Weights stored as f16: half the file, and the same f32 arithmetic, since each is widened where it is used.

use std::collections::BTreeSet;

use half::f16;

use super::model::OnnxModel;
use super::names::Names;
use super::proto::attribute_proto::AttributeType;
use super::proto::tensor_proto::DataType;
use super::proto::{AttributeProto, GraphProto, NodeProto, TensorProto};

/// Fewest values of a weight that is worth a node of its own.
const FEWEST_VALUES: usize = 64;
/// Greatest length of what f16 leaves of a weight, beside the weight's own: twice what rounding alone may leave.
const GREATEST_LOSS: f64 = 1e-3;
/// Operators between f32 values and integers.
pub(super) const QUANTISATION_STEPS: [&str; 2] = ["QuantizeLinear", "DequantizeLinear"];

impl OnnxModel {
    /// The model with its f32 weights stored as f16. A weight that f16 cannot hold, since it would overflow or
    /// vanish, stays, and so do the scales of what is quantised.
    #[must_use]
    pub fn stored_as_half(mut self) -> Self {
        self.proto.graph.iter_mut().for_each(store_as_half);
        self
    }
}

fn store_as_half(graph: &mut GraphProto) {
    let (mut widening, mut names) = (Vec::new(), Names::of(graph));
    let scales = quantisation_scales(graph);
    for weight in graph.initializer.iter_mut().filter(|weight| !scales.contains(weight.name())) {
        let is_input = graph.input.iter().any(|input| input.name() == weight.name());
        let values = f32_values(weight).filter(|values| !is_input && values.len() >= FEWEST_VALUES);
        let Some(halves) = values.and_then(|values| halves(&values)) else { continue };
        let name = weight.name().to_owned();
        let stored = names.fresh(&format!("{name} as half"));
        weight.name = Some(stored.clone());
        weight.data_type = Some(DataType::Float16 as i32);
        weight.float_data.clear();
        weight.raw_data = Some(halves);
        widening.push(widen(stored, name));
    }
    // Before all that take them.
    graph.node.splice(0..0, widening);
}

/// What integers are multiplied by: it is too small for f16, and ONNX Runtime wants to see it in the graph.
fn quantisation_scales(graph: &GraphProto) -> BTreeSet<String> {
    let is_step = |node: &&NodeProto| QUANTISATION_STEPS.contains(&node.op_type());
    graph.node.iter().filter(is_step).filter_map(|node| node.input.get(1).cloned()).collect()
}

/// The values of an f32 weight.
pub(super) fn f32_values(weight: &TensorProto) -> Option<Vec<f32>> {
    if weight.data_type() != DataType::Float as i32 {
        return None;
    }
    match &weight.raw_data {
        Some(raw) => Some(raw.as_chunks::<4>().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect()),
        None => Some(weight.float_data.clone()),
    }
}

/// The values of an f16 weight, widened.
pub(super) fn f16_values(weight: &TensorProto) -> Option<Vec<f32>> {
    if weight.data_type() != DataType::Float16 as i32 {
        return None;
    }
    match &weight.raw_data {
        Some(raw) => {
            Some(raw.as_chunks::<2>().0.iter().map(|&bytes| f16::from_le_bytes(bytes).to_f32()).collect())
        }
        // The format keeps the bits of each in an integer of its own.
        None => Some(weight.int32_data.iter().map(|&bits| f16::from_bits(bits as u16).to_f32()).collect()),
    }
}

/// The values as f16; `None` if one overflows, or all are so small that their digits are lost.
fn halves(values: &[f32]) -> Option<Vec<u8>> {
    let halves: Vec<f16> = values.iter().map(|&value| f16::from_f32(value)).collect();
    let (mut lost, mut whole) = (0.0, 0.0);
    for (half, &value) in halves.iter().zip(values) {
        lost += (half.to_f64() - f64::from(value)).powi(2);
        whole += f64::from(value).powi(2);
    }
    // An overflow has lost more than everything; what is not finite itself compares with nothing.
    let is_kept = lost.sqrt() <= GREATEST_LOSS * whole.sqrt();
    is_kept.then(|| halves.iter().flat_map(|half| half.to_le_bytes()).collect())
}

fn widen(from: String, to: String) -> NodeProto {
    let attribute = AttributeProto {
        name: Some("to".to_owned()),
        r#type: Some(AttributeType::Int as i32),
        i: Some(DataType::Float as i64),
        ..Default::default()
    };
    NodeProto {
        name: Some(to.clone()),
        op_type: Some("Cast".to_owned()),
        input: vec![from],
        output: vec![to],
        attribute: vec![attribute],
        ..Default::default()
    }
}
