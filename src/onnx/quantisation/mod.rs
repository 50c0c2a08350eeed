//! Networks quantised to 8 bits for faster arithmetic and a quarter of the bytes.
//!
//! The graph stays one of f32 operators, with `QuantizeLinear` and `DequantizeLinear` (QDQ) around them; ONNX Runtime
//! fuses each such group into one integer operator. Activations are u8 with a scale and a zero point each, weights s8
//! with one scale a channel, biases int32, as in Jacob et al., "Quantization and Training of Neural Networks for
//! Efficient Integer-Arithmetic-Only Inference", CVPR 2018. [`OnnxModel::observed`] is the network that says how large
//! activations become, [`OnnxModel::quantised`] the one in 8 bits.

mod affine;
mod constants;
mod plan;
mod rewriting;

use std::collections::BTreeMap;

use self::plan::Plan;
use super::builder::Attribute;
use super::error::OnnxError;
use super::half::QUANTISATION_STEPS;
use super::model::{OLDEST_OPSET, OnnxModel, is_standard, prune};
use super::proto::NodeProto;

/// Key of the ONNX metadata property that says in what the weights are stored.
pub const STORAGE_KEY: &str = "loci.storage";

/// Least and greatest value that an activation takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// The least.
    pub least: f32,
    /// The greatest.
    pub greatest: f32,
}

/// The ranges of a network's activations, by the names of the graph's values.
pub type Ranges = BTreeMap<String, Range>;

impl OnnxModel {
    /// The model that computes, in place of its own outputs, the least and the greatest value of every activation that
    /// [`quantised`](Self::quantised) will want the range of; and the names of those activations. The outputs are f32
    /// scalars over all axes, two for each name and in the order of the names: least, greatest.
    ///
    /// # Errors
    /// [`OnnxError::OldOperators`], [`OnnxError::BadWeight`], or [`OnnxError::NothingToQuantise`].
    pub fn observed(&self) -> Result<(Self, Vec<String>), OnnxError> {
        let plan = self.plan()?;
        let names: Vec<String> = plan.measured().map(str::to_owned).collect();
        let model = self.clone().grafted(|graph| {
            for name in &names {
                let activation = graph.value(name)?;
                for (operator, what) in [("ReduceMin", "least"), ("ReduceMax", "greatest")] {
                    let extreme = graph.node(operator, &[&activation], &[("keepdims", Attribute::Int(0))]);
                    graph.output(&format!("{what} of {name}"), &extreme, &[])?;
                }
            }
            Ok(())
        })?;
        Ok((model, names))
    }

    /// The model in 8 bits: every `Conv`, and every `Gemm` and `MatMul` with constant weights behind which an
    /// activation function or a `Conv` follows. Products behind which none does are the network's head; they decide
    /// the direction of a descriptor and stay as they are. So does a `Conv` of at most 32 channels, which would add
    /// more noise than it saves time, and every layer whose weights are not constant f32 values (stored as f16 or not)
    /// of its own. `ranges` are those of the names that [`observed`](Self::observed) gives.
    ///
    /// # Errors
    /// [`OnnxError::OldOperators`], [`OnnxError::BadWeight`], [`OnnxError::BadRange`], or
    /// [`OnnxError::NothingToQuantise`].
    pub fn quantised(&self, ranges: &Ranges) -> Result<Self, OnnxError> {
        let plan = self.plan()?;
        let mut model = self.clone();
        if let Some(graph) = &mut model.proto.graph {
            rewriting::rewrite(graph, &plan, ranges)?;
            prune(graph);
        }
        model.describe(STORAGE_KEY, "int8");
        Ok(model)
    }

    /// Whether it computes in integers, be it in part, whoever quantised it.
    #[must_use]
    pub fn is_quantised(&self) -> bool {
        let is_step = |node: &NodeProto| is_standard(node) && QUANTISATION_STEPS.contains(&node.op_type());
        self.proto.graph.iter().flat_map(|graph| &graph.node).any(is_step)
    }

    fn plan(&self) -> Result<Plan, OnnxError> {
        if self.opset() < OLDEST_OPSET {
            return Err(OnnxError::OldOperators { got: self.opset(), needed: OLDEST_OPSET });
        }
        let plan = self.proto.graph.as_ref().map(Plan::of).transpose()?;
        plan.filter(|plan| !plan.layers.is_empty()).ok_or(OnnxError::NothingToQuantise)
    }
}

#[cfg(test)]
mod tests;
