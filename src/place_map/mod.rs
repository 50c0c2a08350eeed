//! The map: places, and the visual experiences by which the robot knows them.
//!
//! A place is a cluster of experiences. Those by which it is recognised are its keyframes; the others
//! are kept for retraining. Everything goes through one journal: the map in memory is what replaying
//! the journal gives, whether a record was just written or read after a restart.

mod format;
mod map;

pub use map::{MapSummary, NewExperience, PlaceMap};

use std::path::PathBuf;

use crate::cnn;
use crate::feature::Features;
use crate::frame::Pose;
use crate::storage::StorageError;

/// A place, counted from 0 in the order of founding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PlaceId(pub u32);

/// A visual experience, counted from 0 over the whole map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ExperienceId(pub u32);

/// A place: experiences that show the same surroundings.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Its number.
    pub id: PlaceId,
    /// What people call it, once somebody named it.
    pub name: Option<String>,
    /// Its experiences, oldest first.
    pub experiences: Vec<ExperienceId>,
}

/// One look at a place.
#[derive(Clone, Debug, PartialEq)]
pub struct Experience {
    /// Its number.
    pub id: ExperienceId,
    /// The place it shows.
    pub place: PlaceId,
    /// Index of the frame in its stream.
    pub frame_index: u64,
    /// Name of the frame.
    pub frame_name: String,
    /// Time of capture in nanoseconds.
    pub capture_nanos: i64,
    /// Where the robot was, if something told us.
    pub pose: Option<Pose>,
    /// Mean luminance of the frame, 0 to 255, if it was noted.
    pub mean_luminance: Option<f32>,
    /// What recognition needs of it, if the place is recognised by it.
    pub keyframe: Option<Keyframe>,
    /// Where its record, with thumbnail and features, is in the journal.
    record_offset: u64,
}

/// What a place is recognised by.
#[derive(Clone, Debug, PartialEq)]
pub struct Keyframe {
    /// ORB features, for BoW+HV.
    pub features: Features,
    /// CNN descriptor, if a CNN was running, with the model that made it.
    pub appearance: Option<Appearance>,
}

/// A CNN descriptor and the model that made it: descriptors of two models must not be compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Appearance {
    /// Identity of the model: the hash in its card.
    pub model: String,
    /// The descriptor.
    pub descriptor: cnn::Descriptor,
}

/// Why a map could not be opened or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapError {
    /// The journal could not be read or written.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The folder holds no map.
    #[error("no map in {}: `loci run SOURCE --map FOLDER` makes one", path.display())]
    Missing {
        /// The folder.
        path: PathBuf,
    },
    /// The record could not be packed.
    #[error("an experience cannot be stored: {reason}")]
    Unstorable {
        /// What does not fit.
        reason: String,
    },
    /// An experience could not be read again.
    #[error("experience {experience} cannot be read: {reason}")]
    Unreadable {
        /// Its number.
        experience: u32,
        /// What is wrong.
        reason: String,
    },
}
