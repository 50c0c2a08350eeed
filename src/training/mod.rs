//! Offline retraining: the places that a robot founded by itself are the classes that its next CNN learns, so nobody
//! labels anything.
//!
//! [`Clusters`] are the classes and what is known of each, parted by time into what is learnt and what is held out.
//! A [`Head`] is trained on the [`Labelled`] features that a frozen backbone has of their images, and of what an
//! [`Augmentation`] makes of these.

mod augmentation;
mod calibration;
mod clusters;
mod error;
mod gathering;
mod head;
mod labelled;
mod principal;
mod trained_model;

pub use augmentation::Augmentation;
pub use burn::tensor::Device;
pub use calibration::Calibration;
pub use clusters::{Class, ClusterRules, Clusters, Sample};
pub use error::TrainingError;
pub use gathering::{Gathered, gather};
pub use head::{Epoch, Head, HeadOptions, Loss};
pub use labelled::Labelled;
pub use trained_model::TrainedModel;
