//! The CNNs that a training begins with, opened and looked at before any image is.

use std::fs;
use std::path::Path;

use loci::cnn::{DescriptorModel, MODEL_FILE, OnnxRuntime};
use loci::onnx::{OnnxError, OnnxModel};

use super::super::{WrongArgument, assets};
use super::arguments::{Architecture, Precision, TrainArguments};

/// The CNNs that a training begins with.
pub(super) struct Models {
    /// The one that the new one is to take the place of.
    pub(super) current: DescriptorModel,
    /// The trunk; the paper's CNN has none.
    pub(super) backbone: Option<Backbone>,
}

/// The CNN that a trunk is.
pub(super) struct Backbone {
    pub(super) model: DescriptorModel,
    pub(super) network: OnnxModel,
    /// Whether it is the one that the new one is to take the place of.
    pub(super) is_current: bool,
}

impl Models {
    pub(super) fn open(arguments: &TrainArguments, runtime: &OnnxRuntime) -> anyhow::Result<Self> {
        let folder = assets::find(arguments.model.as_deref(), assets::MODEL, "--model")?;
        let current = opened(&folder, runtime)?;
        let backbone = match arguments.architecture {
            Architecture::Trunk => Some(Backbone::open(arguments, &folder, runtime)?),
            Architecture::Paper => None,
        };
        Ok(Self { current, backbone })
    }
}

impl Backbone {
    fn open(arguments: &TrainArguments, current: &Path, runtime: &OnnxRuntime) -> anyhow::Result<Self> {
        let folder = assets::find(arguments.backbone.as_deref(), assets::MODEL, "--backbone")?;
        let model = opened(&folder, runtime)?;
        let file = folder.join(MODEL_FILE);
        let of_file = |reason: &dyn std::fmt::Display| anyhow::anyhow!("{}: {reason}", file.display());
        let bytes = fs::read(&file).map_err(|error| of_file(&error))?;
        let network = OnnxModel::read(&bytes).map_err(|error| of_file(&error))?;
        if network.is_quantised() && arguments.precision == Precision::F32 {
            let reason =
                "computes in 8 bits, and so does what is trained on it; name another --backbone than this";
            return Err(WrongArgument(format!("{} {reason}, or no --precision f32", folder.display())).into());
        }
        takes_what_is_wanted(&network, &model, arguments.precision).map_err(|error| of_file(&error))?;
        let is_current = fs::canonicalize(&folder)? == fs::canonicalize(current)?;
        Ok(Self { model, network, is_current })
    }
}

/// Whether the network takes a head, and 8 bits where they are a must.
fn takes_what_is_wanted(
    network: &OnnxModel,
    model: &DescriptorModel,
    precision: Precision,
) -> Result<(), OnnxError> {
    let descriptor = &model.card().descriptor.name;
    network.clone().grafted(|graph| graph.value(descriptor).map(drop))?;
    if precision == Precision::Int8 && !network.is_quantised() {
        network.observed()?;
    }
    Ok(())
}

fn opened(folder: &Path, runtime: &OnnxRuntime) -> anyhow::Result<DescriptorModel> {
    Ok(DescriptorModel::open(folder, runtime, 2)?)
}
