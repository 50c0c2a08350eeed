//! Arguments of `loci train`.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, ValueEnum, value_parser};
use loci::training::{DeviceChoice, FitOptions, Loss, PaperOptions};
use serde::Serialize;

/// Arguments of `loci train`.
#[derive(Args)]
#[command(after_help = "Examples:\n  loci train maps/site --out models/site\n  \
    loci train maps/hall maps/yard --out models/site2 --min-samples 30 --epochs 50\n  \
    loci train maps/site --architecture paper --out models/site-paper\n\n\
    The places of the maps are the classes. At least the latest fifth of every place is held out: a model that does \
    not do as well on it as the one that it is to take the place of, or as class means without any training, is kept \
    aside, in OUT.rejected. The exit code is 3 then, and where something was skipped. A training that is interrupted \
    goes on with the same command. Places of several maps are told apart: merge maps of one site first.")]
pub(in crate::cli) struct TrainArguments {
    /// Folders of maps
    #[arg(required = true, value_name = "MAP")]
    pub(super) maps: Vec<PathBuf>,
    /// Folder of the model to make; it must not be there yet
    #[arg(long, value_name = "DIR")]
    pub(super) out: PathBuf,
    /// What is trained
    #[arg(long, value_enum, default_value = "trunk")]
    pub(super) architecture: Architecture,
    /// Folder of the CNN that the trunk is; one in 8 bits stays so [default: models/efficientnet-lite0]
    #[arg(long, value_name = "DIR")]
    pub(super) backbone: Option<PathBuf>,
    /// Folder of the CNN that the new one is to take the place of [default: models/efficientnet-lite0]
    #[arg(long, env = "LOCI_MODEL", value_name = "DIR")]
    pub(super) model: Option<PathBuf>,
    /// ONNX Runtime library [default: looked for]
    #[arg(long, env = "LOCI_ONNXRUNTIME", value_name = "PATH")]
    pub(super) onnxruntime: Option<PathBuf>,
    /// Fewest experiences of a place that is learnt; fewer than 3 count as 3
    #[arg(long, value_name = "N", default_value = "20")]
    pub(super) min_samples: NonZeroUsize,
    /// Values of the descriptor, at most 8192; of a trunk, more than those of the backbone's count as so many
    #[arg(long, value_name = "N", default_value = "256", value_parser = value_parser!(u16).range(1..=8192))]
    dimensions: u16,
    /// Times that every place is gone through [default: 30 of a trunk, 15 of the paper's]
    #[arg(long, value_name = "N")]
    epochs: Option<NonZeroUsize>,
    /// What is asked of a descriptor
    #[arg(long, value_enum, default_value = "cosface")]
    loss: LossName,
    /// Copies of every image in other light, weather and view, for a trunk; the paper's CNN sees another one each
    /// time; 0 for none
    #[arg(long, value_name = "N", default_value = "2", value_parser = value_parser!(u16).range(0..=100))]
    augment: u16,
    /// An ONNX network that makes an image of an image, such as a GAN's generator: half of the copies go through it
    #[arg(long, value_name = "FILE")]
    pub(super) augment_model: Option<PathBuf>,
    /// In what the model computes
    #[arg(long, value_enum, default_value = "auto")]
    pub(super) precision: Precision,
    /// What computes: cpu, cuda, cuda:NUMBER, or auto: a graphics processor if there is one and the build knows CUDA
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    pub(super) device: DeviceChoice,
    /// Settles every draw
    #[arg(long, value_name = "N", default_value = "0")]
    pub(super) seed: u64,
    /// Take the model even where it does not do as well as what it is compared with
    #[arg(long)]
    pub(super) accept: bool,
    /// Leave out experiences that cannot be read; without it they end the training
    #[arg(long)]
    pub(super) skip_unreadable: bool,
    /// Print JSON
    #[arg(long)]
    pub(super) json: bool,
}

/// What is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Architecture {
    /// A projection of a frozen backbone's features, and a direction for each place
    Trunk,
    /// The paper's three convolutions and a fully connected layer, from nothing
    Paper,
}

/// In what a model computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub(super) enum Precision {
    /// int8 where that recognises as much of what training merely looks at, give or take what chance may do; else f32
    Auto,
    /// 32 bits
    F32,
    /// 8 bits, two thirds of the time
    Int8,
}

impl Precision {
    pub(super) fn as_str(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::F32 => "f32",
            Self::Int8 => "int8",
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum LossName {
    /// Its own class is the likeliest by a margin
    Cosface,
    /// Its own class is the likeliest
    CrossEntropy,
}

impl TrainArguments {
    pub(super) fn dimensions(&self) -> usize {
        self.dimensions.into()
    }

    /// Copies of every image.
    pub(super) fn copies(&self) -> usize {
        self.augment.into()
    }

    /// How a head is trained.
    pub(super) fn fit_options(&self) -> FitOptions {
        self.settle(FitOptions::default())
    }

    /// How the paper's CNN is trained.
    pub(super) fn paper_options(&self) -> PaperOptions {
        let defaults = PaperOptions::default();
        PaperOptions { dimensions: self.dimensions(), fit: self.settle(defaults.fit) }
    }

    fn settle(&self, defaults: FitOptions) -> FitOptions {
        let loss = match self.loss {
            LossName::Cosface => defaults.loss,
            LossName::CrossEntropy => Loss::CrossEntropy { scale: defaults.loss.scale() },
        };
        let epochs = self.epochs.map_or(defaults.epochs, NonZeroUsize::get);
        FitOptions { epochs, loss, seed: self.seed, ..defaults }
    }
}
