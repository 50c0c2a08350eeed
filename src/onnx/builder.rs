//! A graph written node by node.

use std::collections::BTreeMap;

use super::error::OnnxError;
use super::model::OnnxModel;
use super::names::Names;
use super::proto::attribute_proto::AttributeType;
use super::proto::tensor_proto::DataType;
use super::proto::tensor_shape_proto::{self, dimension::Value as Length};
use super::proto::{
    AttributeProto, GraphProto, NodeProto, TensorProto, TensorShapeProto, TypeProto, ValueInfoProto,
    type_proto,
};

/// A value of a graph: an input, a weight, or what a node gives.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Value(String);

/// A length along one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dimension {
    /// Always the same.
    Fixed(usize),
    /// As many as there are images.
    Batch,
}

/// What a node does is settled by.
#[derive(Clone, Debug, PartialEq)]
pub enum Attribute {
    /// A whole number.
    Int(i64),
    /// Whole numbers.
    Ints(Vec<i64>),
    /// A number.
    Float(f32),
}

/// Writes a graph, or goes on with one.
#[derive(Debug)]
pub struct GraphBuilder {
    graph: GraphProto,
    names: Names,
    /// What the outputs of the graph that is gone on with are called now, so that their names are free.
    former_outputs: BTreeMap<String, String>,
}

impl GraphBuilder {
    /// A graph without anything in it.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self::on(GraphProto { name: Some(name.to_owned()), ..Default::default() })
    }

    /// Goes on with `graph`, which has no outputs from now on.
    pub(super) fn on(mut graph: GraphProto) -> Self {
        let names = Names::of(&graph);
        let outputs = std::mem::take(&mut graph.output);
        let mut builder = Self { graph, names, former_outputs: BTreeMap::new() };
        outputs.iter().for_each(|output| builder.free(output.name()));
        builder
    }

    /// Gives what a node calls `name` another name.
    fn free(&mut self, name: &str) {
        if self.graph.node.iter().any(|node| node.output.iter().any(|output| output == name)) {
            let fresh = self.names.fresh(&format!("former {name}"));
            self.graph.node.iter_mut().for_each(|node| rename(node, name, &fresh));
            self.graph.value_info.retain(|value| value.name() != name);
            self.names.give_back(name);
            self.former_outputs.insert(name.to_owned(), fresh);
        }
    }

    /// The value of that name in the graph that is gone on with.
    ///
    /// # Errors
    /// [`OnnxError::NoValue`].
    pub fn value(&self, name: &str) -> Result<Value, OnnxError> {
        match self.former_outputs.get(name).or_else(|| self.names.get(name)) {
            Some(name) => Ok(Value(name.clone())),
            None => Err(OnnxError::NoValue { name: name.to_owned() }),
        }
    }

    /// An input of f32 values.
    pub fn input(&mut self, name: &str, shape: &[Dimension]) -> Value {
        let name = self.names.fresh(name);
        self.graph.input.push(described(&name, shape));
        Value(name)
    }

    /// A weight: f32 values, row-major.
    ///
    /// # Panics
    /// If there are not as many values as `shape` says.
    pub fn weight(&mut self, name: &str, shape: &[usize], values: &[f32]) -> Value {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "values of {name}");
        let name = self.names.fresh(name);
        self.graph.initializer.push(TensorProto {
            name: Some(name.clone()),
            dims: shape.iter().map(|&length| length as i64).collect(),
            data_type: Some(DataType::Float as i32),
            raw_data: Some(values.iter().flat_map(|value| value.to_le_bytes()).collect()),
            ..Default::default()
        });
        Value(name)
    }

    /// A node of one of the standard's operators, which gives one value.
    pub fn node(&mut self, operator: &str, inputs: &[&Value], attributes: &[(&str, Attribute)]) -> Value {
        let name = self.names.fresh(&operator.to_lowercase());
        self.add(operator, inputs, &name);
        if let Some(node) = self.graph.node.last_mut() {
            node.attribute = attributes.iter().map(|(name, attribute)| packed(name, attribute)).collect();
        }
        Value(name)
    }

    /// Makes a value an output called `name`.
    ///
    /// # Errors
    /// [`OnnxError::NameTaken`].
    pub fn output(&mut self, name: &str, value: &Value, shape: &[Dimension]) -> Result<(), OnnxError> {
        if !self.names.take(name) {
            return Err(OnnxError::NameTaken { name: name.to_owned() });
        }
        self.add("Identity", &[value], name);
        self.graph.output.push(described(name, shape));
        Ok(())
    }

    /// The model of this graph.
    #[must_use]
    pub fn finish(self) -> OnnxModel {
        OnnxModel::new(self.graph)
    }

    pub(super) fn into_graph(self) -> GraphProto {
        self.graph
    }

    fn add(&mut self, operator: &str, inputs: &[&Value], output: &str) {
        self.graph.node.push(NodeProto {
            op_type: Some(operator.to_owned()),
            input: inputs.iter().map(|value| value.0.clone()).collect(),
            output: vec![output.to_owned()],
            ..Default::default()
        });
    }
}

/// Calls the value `from` that a node gives or takes `to`, also where graphs within it take it.
fn rename(node: &mut NodeProto, from: &str, to: &str) {
    for name in node.input.iter_mut().chain(&mut node.output).filter(|name| *name == from) {
        to.clone_into(name);
    }
    for attribute in &mut node.attribute {
        for graph in attribute.g.iter_mut().chain(&mut attribute.graphs) {
            graph.node.iter_mut().for_each(|node| rename(node, from, to));
            for output in graph.output.iter_mut().filter(|output| output.name() == from) {
                output.name = Some(to.to_owned());
            }
        }
    }
}

pub(super) fn packed(name: &str, attribute: &Attribute) -> AttributeProto {
    let mut packed = AttributeProto { name: Some(name.to_owned()), ..Default::default() };
    let kind = match attribute {
        &Attribute::Int(value) => {
            packed.i = Some(value);
            AttributeType::Int
        }
        Attribute::Ints(values) => {
            packed.ints.clone_from(values);
            AttributeType::Ints
        }
        &Attribute::Float(value) => {
            packed.f = Some(value);
            AttributeType::Float
        }
    };
    packed.r#type = Some(kind as i32);
    packed
}

/// An input or output of f32 values.
fn described(name: &str, shape: &[Dimension]) -> ValueInfoProto {
    let length = |dimension: &Dimension| match *dimension {
        Dimension::Fixed(length) => Length::DimValue(length as i64),
        Dimension::Batch => Length::DimParam("batch".to_owned()),
    };
    let dim = shape.iter().map(|dimension| tensor_shape_proto::Dimension {
        value: Some(length(dimension)),
        ..Default::default()
    });
    let tensor = type_proto::Tensor {
        elem_type: Some(DataType::Float as i32),
        shape: Some(TensorShapeProto { dim: dim.collect() }),
    };
    let value = Some(type_proto::Value::TensorType(tensor));
    ValueInfoProto {
        name: Some(name.to_owned()),
        r#type: Some(TypeProto { value, ..Default::default() }),
        ..Default::default()
    }
}
