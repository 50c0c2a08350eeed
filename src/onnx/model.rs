//! A model: read, looked at, extended, and written.

use std::collections::BTreeSet;

use prost::Message;

use super::builder::GraphBuilder;
use super::error::OnnxError;
use super::proto::tensor_proto::DataLocation;
use super::proto::{GraphProto, ModelProto, NodeProto, OperatorSetIdProto, StringStringEntryProto};

/// Version of the operators of a model made here.
pub const OPSET: i64 = 17;
/// Version of the format that belongs to it.
const IR_VERSION: i64 = 8;
/// From this version on, every operator that a head is made of means the same.
pub(super) const OLDEST_OPSET: i64 = 13;
/// Name of the set of the standard's own operators.
const STANDARD: [&str; 2] = ["", "ai.onnx"];

/// An ONNX model.
#[derive(Clone, Debug, PartialEq)]
pub struct OnnxModel {
    pub(super) proto: ModelProto,
}

impl OnnxModel {
    /// A model of `graph` alone.
    pub(super) fn new(graph: GraphProto) -> Self {
        let opset = OperatorSetIdProto { version: Some(OPSET), ..Default::default() };
        let proto = ModelProto {
            ir_version: Some(IR_VERSION),
            producer_name: Some("loci".to_owned()),
            producer_version: Some(env!("CARGO_PKG_VERSION").to_owned()),
            opset_import: vec![opset],
            graph: Some(graph),
            ..Default::default()
        };
        Self { proto }
    }

    /// Reads a model.
    ///
    /// # Errors
    /// [`OnnxError::NotOnnx`] or [`OnnxError::ExternalWeights`].
    pub fn read(bytes: &[u8]) -> Result<Self, OnnxError> {
        let not_onnx = |reason: String| OnnxError::NotOnnx { reason };
        let proto = ModelProto::decode(bytes).map_err(|error| not_onnx(error.to_string()))?;
        let Some(graph) = &proto.graph else { return Err(not_onnx("it has no graph".to_owned())) };
        if graph.output.is_empty() {
            return Err(not_onnx("its graph has no output".to_owned()));
        }
        let mut weights = graph.initializer.iter();
        match weights.find(|weight| weight.data_location() == DataLocation::External) {
            Some(weight) => Err(OnnxError::ExternalWeights { name: weight.name().to_owned() }),
            None => Ok(Self { proto }),
        }
    }

    /// The bytes of its file.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        self.proto.encode_to_vec()
    }

    /// Names of its outputs.
    pub fn outputs(&self) -> impl Iterator<Item = &str> {
        self.proto.graph.iter().flat_map(|graph| graph.output.iter().map(|output| output.name()))
    }

    /// Version of the standard's operators that it is made of; 0 if it does not say.
    #[must_use]
    pub fn opset(&self) -> i64 {
        let sets = self.proto.opset_import.iter();
        sets.filter(|set| STANDARD.contains(&set.domain())).map(|set| set.version()).max().unwrap_or(0)
    }

    /// Says something of the model, for whoever opens it: `value` under `key`.
    pub fn describe(&mut self, key: &str, value: &str) {
        let entries = &mut self.proto.metadata_props;
        entries.retain(|entry| entry.key() != key);
        entries.push(StringStringEntryProto { key: Some(key.to_owned()), value: Some(value.to_owned()) });
    }

    /// What is said of the model under `key`.
    #[must_use]
    pub fn described(&self, key: &str) -> Option<&str> {
        let mut entries = self.proto.metadata_props.iter();
        entries.find(|entry| entry.key() == key).map(|entry| entry.value())
    }

    /// The model with a head: what `graft` adds goes on from the model's own values, the outputs that it names take the
    /// place of the model's, and whatever leads to none of them is dropped.
    ///
    /// # Errors
    /// [`OnnxError::OldOperators`], or what `graft` answers.
    pub fn grafted(
        mut self,
        graft: impl FnOnce(&mut GraphBuilder) -> Result<(), OnnxError>,
    ) -> Result<Self, OnnxError> {
        if self.opset() < OLDEST_OPSET {
            return Err(OnnxError::OldOperators { got: self.opset(), needed: OLDEST_OPSET });
        }
        let mut builder = GraphBuilder::on(self.proto.graph.take().unwrap_or_default());
        graft(&mut builder)?;
        let mut graph = builder.into_graph();
        prune(&mut graph);
        self.proto.graph = Some(graph);
        Ok(self)
    }
}

/// Drops every node, weight and note that no output needs. The inputs stay.
pub(super) fn prune(graph: &mut GraphProto) {
    let mut needed: BTreeSet<String> = graph.output.iter().map(|output| output.name().to_owned()).collect();
    let mut kept = vec![false; graph.node.len()];
    // Nodes stand behind those whose values they take.
    for (node, kept) in graph.node.iter().zip(&mut kept).rev() {
        *kept = node.output.iter().any(|output| needed.contains(output));
        if *kept {
            // One that was left out has no name.
            needed.extend(taken_by(node).into_iter().filter(|name| !name.is_empty()));
        }
    }
    let mut kept = kept.into_iter();
    graph.node.retain(|_| kept.next().unwrap_or_default());
    graph.initializer.retain(|weight| needed.contains(weight.name()));
    graph
        .sparse_initializer
        .retain(|weight| weight.values.as_ref().is_some_and(|values| needed.contains(values.name())));
    graph.value_info.retain(|value| needed.contains(value.name()));
    graph.quantization_annotation.retain(|note| needed.contains(note.tensor_name()));
}

/// Whether the node's operator is one of the standard's own.
pub(super) fn is_standard(node: &NodeProto) -> bool {
    STANDARD.contains(&node.domain())
}

/// Names of the values that a node takes, those included that graphs within it take from around it.
pub(super) fn taken_by(node: &NodeProto) -> Vec<String> {
    let mut taken = node.input.clone();
    for attribute in &node.attribute {
        for graph in attribute.g.iter().chain(&attribute.graphs) {
            taken.extend(graph.node.iter().flat_map(taken_by));
            taken.extend(graph.output.iter().map(|output| output.name().to_owned()));
        }
    }
    taken
}
