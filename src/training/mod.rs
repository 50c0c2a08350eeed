//! Offline retraining: the places that a robot founded by itself are the classes that its next CNN learns, so nobody
//! labels anything.
//!
//! [`Clusters`] are the classes and what is known of each, parted by time into what is learnt and what is held out;
//! [`Pictures`] are their images, and a [`Variation`] makes further ones of them. Either a [`Head`] is trained on the
//! features that a frozen backbone has of them, or a [`PaperCnn`] on the images themselves. The [`TrainedModel`] is
//! the network with its card, and knows how it stands on what was held out.

mod augmentation;
mod calibration;
mod checkpoint;
mod clusters;
mod device;
mod error;
mod fitting;
mod gathering;
mod graph;
mod head;
mod labelled;
mod paper;
mod pictures;
mod principal;
mod quantisation;
mod report;
#[cfg(test)]
mod scripted_map;
mod standing;
mod trained_model;
mod variation;

pub use augmentation::Augmentation;
pub use burn::tensor::Device;
pub use calibration::Calibration;
pub use checkpoint::Checkpoint;
pub use clusters::{Class, ClusterRules, Clusters, Sample, Stranger, Unreadable};
pub use device::DeviceChoice;
pub use error::TrainingError;
pub use fitting::{Epoch, FitOptions, Loss, Step};
pub use gathering::{Describe, Gathered, described, varied};
pub use head::Head;
pub use labelled::Labelled;
pub use paper::{Filters, PaperCnn, PaperOptions};
pub use pictures::{Picture, Pictures};
pub use quantisation::{Agreement, agreement, in_all_light, quantise};
pub use report::TrainingReport;
pub use standing::{Rivals, Standing, figure};
pub use trained_model::TrainedModel;
pub use variation::Variation;
