//! What of a graph is quantised: layers with weights, and the activations between them.

use std::collections::{BTreeMap, BTreeSet};

use super::constants::{Constant, Constants};
use crate::onnx::error::OnnxError;
use crate::onnx::model::{is_standard, taken_by};
use crate::onnx::proto::{GraphProto, NodeProto};

/// What makes a network more than one matrix.
const ACTIVATION_FUNCTIONS: [&str; 16] = [
    "Relu",
    "Clip",
    "LeakyRelu",
    "PRelu",
    "ThresholdedRelu",
    "Elu",
    "Celu",
    "Selu",
    "Gelu",
    "Mish",
    "Sigmoid",
    "HardSigmoid",
    "HardSwish",
    "Tanh",
    "Erf",
    "Softplus",
];
/// Activation functions that ONNX Runtime takes for part of the quantisation that follows them.
const FOLDED: [&str; 2] = ["Relu", "Clip"];
/// Operators that give no value which they did not take; ONNX Runtime runs them on integers if the scale stays.
const SELECTING: [&str; 6] = ["MaxPool", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Transpose"];

/// Layers with weights.
const WEIGHTED: [&str; 3] = ["Conv", "Gemm", "MatMul"];

/// A convolution with no more channels, coming and going, stays in f32. It stands near the image, has little to compute
/// and little to average what rounding adds, and all that follows works on that.
const NARROW_CHANNELS: usize = 32;

/// A layer that is quantised.
pub(super) struct Layer {
    pub(super) weights: Constant,
    /// Axis of the weights along which the channels of the output lie.
    pub(super) axis: usize,
    /// One a channel.
    pub(super) biases: Option<Constant>,
}

/// What is quantised.
pub(super) struct Plan {
    /// By the place of the node in the graph.
    pub(super) layers: BTreeMap<usize, Layer>,
    /// Values that are quantised, each with the one whose range is its own, too; mostly itself.
    pub(super) activations: BTreeMap<String, String>,
}

impl Plan {
    pub(super) fn of(graph: &GraphProto) -> Result<Self, OnnxError> {
        let layers = layers(graph)?;
        let mut activations = BTreeMap::new();
        let mut add = |name: &str| drop(activations.insert(name.to_owned(), name.to_owned()));
        let takers = takers(graph);
        for (node, input) in
            layers.keys().filter_map(|&index| graph.node[index].input.first().map(|i| (index, i)))
        {
            add(input);
            let node = &graph.node[node];
            if node.op_type() == "Conv" {
                add(end_of(node, graph, &takers));
            }
        }
        // Nodes stand behind those whose values they take.
        for node in graph.node.iter().filter(|node| is_standard(node) && SELECTING.contains(&node.op_type()))
        {
            if let (Some(input), Some(output)) = (node.input.first(), node.output.first())
                && let Some(origin) = activations.get(input).cloned()
                && let Some(entry) = activations.get_mut(output)
            {
                *entry = origin;
            }
        }
        Ok(Self { layers, activations })
    }

    /// Whether `node`, which stands at `index`, takes what is quantised as f32 from integers. A layer that stays in
    /// f32 takes it as it was: ONNX Runtime would quantise the weights of one that stands among integers by itself,
    /// all with one scale.
    pub(super) fn takes_integers(&self, index: usize, node: &NodeProto) -> bool {
        self.layers.contains_key(&index) || !WEIGHTED.contains(&node.op_type())
    }

    /// The activations whose ranges have to be measured, in the order of their names.
    pub(super) fn measured(&self) -> impl Iterator<Item = &str> {
        let origins: BTreeSet<&str> = self.activations.values().map(String::as_str).collect();
        origins.into_iter()
    }
}

/// The nodes that take each value; the end of the graph, which takes its outputs, counts as one behind the last.
fn takers(graph: &GraphProto) -> BTreeMap<String, Vec<usize>> {
    let mut takers: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (index, node) in graph.node.iter().enumerate() {
        taken_by(node).into_iter().for_each(|name| takers.entry(name).or_default().push(index));
    }
    let end = graph.node.len();
    graph.output.iter().for_each(|output| takers.entry(output.name().to_owned()).or_default().push(end));
    takers
}

/// The value at which what `node` computes is quantised: behind the activation function, if that alone takes it.
fn end_of<'a>(node: &'a NodeProto, graph: &'a GraphProto, takers: &BTreeMap<String, Vec<usize>>) -> &'a str {
    let own = node.output.first().map_or("", String::as_str);
    let only =
        takers.get(own).filter(|takers| takers.len() == 1).and_then(|takers| graph.node.get(takers[0]));
    let folded = only.filter(|only| is_standard(only) && FOLDED.contains(&only.op_type()));
    folded.and_then(|folded| folded.output.first()).map_or(own, String::as_str)
}

/// The layers that can be quantised, each with weights of its own.
fn layers(graph: &GraphProto) -> Result<BTreeMap<usize, Layer>, OnnxError> {
    let (constants, inner) = (Constants::of(graph), inner_values(graph));
    let mut taken = BTreeSet::new();
    let mut layers = BTreeMap::new();
    for (index, node) in graph.node.iter().enumerate().filter(|(_, node)| is_standard(node)) {
        let ([input, weights, ..], [output]) = (node.input.as_slice(), node.output.as_slice()) else {
            continue;
        };
        let is_wanted = match node.op_type() {
            "Conv" => true,
            "MatMul" => inner.contains(output),
            "Gemm" => inner.contains(output) && is_plain_product(node),
            _ => false,
        };
        let stored = constants.stored_as(weights).filter(|_| is_wanted && !input.is_empty());
        // What is stored once is quantised once: for the second layer with the same weights it would be a copy.
        if constants.stored_as(input).is_none()
            && let Some(stored) = stored
            && !taken.contains(stored)
            && let Some(layer) = layer(node, &constants)?
        {
            taken.insert(stored);
            layers.insert(index, layer);
        }
    }
    Ok(layers)
}

/// Values from which an activation function or a convolution is still to come. Behind all others lies the head alone.
fn inner_values(graph: &GraphProto) -> BTreeSet<String> {
    let mut inner = BTreeSet::new();
    // Nodes stand behind those whose values they take.
    for node in graph.node.iter().rev() {
        let operator = node.op_type();
        let is_one = is_standard(node) && (operator == "Conv" || ACTIVATION_FUNCTIONS.contains(&operator));
        if is_one || node.output.iter().any(|output| inner.contains(output)) {
            inner.extend(taken_by(node));
        }
    }
    inner
}

/// The node's weights and biases; nothing if they are not constant or not one a channel, or if the layer is too narrow.
fn layer(node: &NodeProto, constants: &Constants<'_>) -> Result<Option<Layer>, OnnxError> {
    let [_, name, rest @ ..] = node.input.as_slice() else { return Ok(None) };
    let Some(weights) = constants.read(name)? else { return Ok(None) };
    let rank = weights.shape.len();
    let axis = match node.op_type() {
        "Conv" if rank < 3 => {
            let reason = format!("of a convolution has shape {:?}", weights.shape);
            return Err(OnnxError::BadWeight { name: name.clone(), reason });
        }
        "Conv" if weights.shape[..2].iter().all(|&channels| channels <= NARROW_CHANNELS) => return Ok(None),
        "Conv" => 0,
        // Matrices of many products at once have no channels.
        _ if rank != 2 => return Ok(None),
        _ => usize::from(integer(node, "transB") == 0),
    };
    let channels = weights.shape[axis];
    let Some(bias) = rest.first().filter(|name| !name.is_empty()) else {
        return Ok(Some(Layer { weights, axis, biases: None }));
    };
    let biases = constants.read(bias)?.filter(|biases| biases.values.len() == channels);
    let biases = biases.filter(|biases| biases.shape.last() == Some(&channels));
    Ok(biases.map(|biases| Layer { weights, axis, biases: Some(biases) }))
}

/// Whether a Gemm multiplies and adds, and nothing else.
fn is_plain_product(node: &NodeProto) -> bool {
    let is_one = |name: &str| {
        let mut attributes = node.attribute.iter();
        attributes.find(|attribute| attribute.name() == name).is_none_or(|attribute| attribute.f() == 1.0)
    };
    integer(node, "transA") == 0 && is_one("alpha") && is_one("beta")
}

/// A whole number among the node's attributes; 0 if it is not there.
fn integer(node: &NodeProto, name: &str) -> i64 {
    node.attribute.iter().find(|attribute| attribute.name() == name).map_or(0, |attribute| attribute.i())
}
