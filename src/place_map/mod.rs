//! The map: places, and the visual experiences by which the robot knows them.
//!
//! A place is a cluster of experiences. Those by which it is recognised are its keyframes; the others
//! are kept for retraining. In memory is only what tells them apart; features, words and thumbnails stay in the
//! journal and are read when they are needed.
//!
//! Everything goes through the journal: the map in memory is what replaying it gives, whether a record was just
//! written or read after a restart. `journal` keeps the segments, `journal_opening` reads them, `snapshot` saves
//! reading them all if `witness` finds that it is theirs, `thinning` says what to give up when the map is to stay
//! within its budget.

mod absorb;
mod batch;
#[cfg(test)]
mod budget_tests;
mod classes;
mod contents;
mod error;
mod format;
mod inspection;
mod journal;
mod journal_opening;
mod kept_index;
mod map;
mod map_opening;
mod options;
#[cfg(test)]
mod power_cut_tests;
mod reading;
#[cfg(test)]
mod refusal_tests;
mod renewal;
mod replay;
mod salvage;
#[cfg(test)]
mod scripted_life;
mod snapshot;
mod syncer;
#[cfg(test)]
mod tests;
mod thinning;
mod upkeep;
mod verify;
mod version_1;
mod witness;

pub use contents::MAX_NEIGHBOURS;
pub use error::{MapError, Unreadable};
pub use journal::FeatureReader;
pub use kept_index::KeptIndex;
pub use map::{Learnt, NewExperience, PlaceMap};
pub use options::{Durability, MapOptions};
pub use reading::MapSummary;
pub use salvage::PassedOver;
pub use syncer::JournalSyncer;
pub use verify::{Problem, SnapshotState, Verification};

use std::sync::Arc;

use contents::Location;
use format::{ExperienceRecord, PlaceRecord};

use crate::cnn::CompactDescriptor;
use crate::frame::Pose;
use crate::vocabulary::WordId;

/// A place, counted from 0 in the order of founding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PlaceId(pub u32);

/// A visual experience, counted from 0 over the whole life of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ExperienceId(pub u32);

/// A place: experiences that show the same surroundings.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Its number.
    pub id: PlaceId,
    /// What people call it, once somebody named it.
    pub name: Option<Arc<str>>,
    /// The place that it turned out to be; then its experiences are there.
    pub merged_into: Option<PlaceId>,
    /// Places next to it along the way, in the order in which they were found to be; at most [`MAX_NEIGHBOURS`].
    pub neighbours: Vec<PlaceId>,
    /// Its experiences, oldest first.
    pub experiences: Vec<ExperienceId>,
    location: Location,
    record_bytes: u32,
}

/// One look at a place, as far as it is always at hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Experience {
    /// Its number.
    pub id: ExperienceId,
    /// The place it was learnt as showing, which may have been merged into another one since.
    pub learnt_as: PlaceId,
    /// Difference hash of the frame.
    pub view: u64,
    /// Mean luminance of the frame, 0 to 255, if it was noted.
    pub mean_luminance: Option<f32>,
    /// Whether the place is recognised by it.
    pub is_keyframe: bool,
    location: Location,
    /// Bytes of its records.
    record_bytes: u32,
}

/// The frame that an experience came from.
#[derive(Clone, Debug, PartialEq)]
pub struct Origin {
    /// Index of the frame in its stream.
    pub frame_index: u64,
    /// Name of the frame.
    pub frame_name: String,
    /// Time of capture in nanoseconds.
    pub capture_nanos: i64,
    /// Where the robot was, if something told us.
    pub pose: Option<Pose>,
}

/// What a keyframe is found by.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Traits {
    /// The visual words of its features, by vocabulary.
    pub words: Vec<VocabularyWords>,
    /// CNN descriptor, if a CNN was running, with the model that made it.
    pub appearance: Option<Appearance>,
}

/// The words that a vocabulary has for the features of a keyframe, one a feature, rising: so a bag of words is
/// made of them quickly.
#[derive(Clone, Debug, PartialEq)]
pub struct VocabularyWords {
    /// Fingerprint of the vocabulary.
    pub vocabulary: u64,
    /// The words.
    pub words: Vec<WordId>,
}

/// A CNN descriptor and the model that made it: descriptors of two models must not be compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Appearance {
    /// Identity of the model: the hash in its card.
    pub model: String,
    /// The descriptor.
    pub descriptor: CompactDescriptor,
}

impl Place {
    /// What the journal says of it.
    fn record(&self) -> PlaceRecord {
        PlaceRecord {
            place: self.id.0,
            name: self.name.as_deref().map(str::to_owned),
            merged_into: self.merged_into.map(|place| place.0),
            neighbours: self.neighbours.iter().map(|place| place.0).collect(),
        }
    }
}

impl Experience {
    /// The experience of a record that takes `length_bytes` at `location`, its parts before it not counted.
    fn new(record: &ExperienceRecord, location: Location, length_bytes: u64) -> Result<Self, String> {
        let features_back = record.keyframe.as_ref().map_or(0, |keyframe| keyframe.features_back_bytes);
        let parts_bytes = u64::from(features_back.max(record.thumbnail_back_bytes));
        if parts_bytes > location.offset() {
            return Err("its parts lie before the journal's beginning".to_owned());
        }
        Ok(Self {
            id: ExperienceId(record.experience),
            learnt_as: PlaceId(record.place),
            view: record.view,
            mean_luminance: record.mean_luminance,
            is_keyframe: record.keyframe.is_some(),
            location,
            record_bytes: u32::try_from(parts_bytes + length_bytes)
                .map_err(|_| "it is too long".to_owned())?,
        })
    }
}
