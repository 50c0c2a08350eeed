//! The grounds of a decision: what was thought of each place before a frame and after it.

use super::fusion::Clues;
use crate::place_map::PlaceId;

/// What was thought of a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceGrounds {
    /// The place.
    pub place: PlaceId,
    /// What was found of it in the frame; `None` where it was only expected.
    pub clues: Option<Clues>,
    /// Log odds that what was found makes it the right one.
    pub log_odds: Option<f32>,
    /// Probability before the frame, by where the robot was; that of turning up there from anywhere comes on top.
    pub before: f32,
    /// Probability after it.
    pub after: f32,
    /// The same with the places next to it: what has to pass the threshold; 0 if one of these is likelier and may be
    /// it.
    pub around: f32,
    /// Probability of its twins, which geometry verifies beyond doubt as it does this place. It counts where the place
    /// is accepted, and not for how sure that is: they may be others that look alike.
    pub twins: f32,
    /// Whether the frame itself says enough for it.
    pub may_be: bool,
}

/// What a place has to reach.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Thresholds {
    /// Probability, with those next to it, at which a place is taken for the right one.
    pub probability: f32,
    /// Log odds that the frame has to give it itself.
    pub log_odds: f32,
    /// Effective inliers from which on geometry verifies a place.
    pub inliers: u32,
    /// Features below which the frame is poor: it founds no place unless the one before was poor, too.
    pub features: usize,
    /// Cosine from which on the CNN alone is sure, if one takes part.
    pub cnn_alone: Option<f32>,
}

/// Why a frame was decided as it was.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grounds {
    /// The places that something was found of, or that were expected, the likeliest first.
    pub places: Vec<PlaceGrounds>,
    /// Probability to be in no place of the map before the frame, and after it.
    pub elsewhere: [f32; 2],
    /// What was needed.
    pub thresholds: Thresholds,
}

impl Grounds {
    /// What was thought of a place.
    #[must_use]
    pub fn of(&self, place: PlaceId) -> Option<&PlaceGrounds> {
        self.places.iter().find(|grounds| grounds.place == place)
    }

    /// Probability of a place with the places next to it.
    #[must_use]
    pub fn around(&self, place: PlaceId) -> f32 {
        self.of(place).map_or(0.0, |grounds| grounds.around)
    }

    pub(super) fn may_be(&self, place: PlaceId) -> bool {
        self.of(place).is_some_and(|grounds| grounds.may_be)
    }

    /// Whether the frame itself shows the place, being likelier by it than `log_odds`.
    pub(super) fn shows(&self, place: PlaceId, log_odds: f32) -> bool {
        self.of(place).and_then(|grounds| grounds.log_odds).is_some_and(|said| said >= log_odds)
    }
}
