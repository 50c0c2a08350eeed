//! Candidate places, and why they were turned down.

use std::fmt;

use heapless::Vec as FixedVec;

use crate::place_map::{ExperienceId, PlaceId};
use crate::verification::Verification;

/// Most candidates of each kind of evidence that are considered for a frame.
pub const MAX_CANDIDATES: usize = 8;

/// Candidates of both kinds.
pub type Candidates = FixedVec<Candidate, { 2 * MAX_CANDIDATES }>;

/// The geometry of candidates.
pub type Verifications = FixedVec<Verification, MAX_CANDIDATES>;

/// What speaks for a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Evidence {
    /// The CNN descriptor.
    Cnn,
    /// Common visual words, verified by Hough voting.
    BowHv,
    /// The place was founded within the place interval.
    PlaceInterval,
}

impl Evidence {
    /// The word for it in records and logs.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cnn => "cnn",
            Self::BowHv => "bow_hv",
            Self::PlaceInterval => "place_interval",
        }
    }
}

/// A place that a frame may show.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// The place.
    pub place: PlaceId,
    /// Its keyframe that is most like the frame.
    pub keyframe: ExperienceId,
    /// What speaks for it.
    pub by: Evidence,
    /// Cosine of the CNN descriptors, or L1 score of the BoW vectors.
    pub score: f32,
    /// Hough votes of the best transform, once verified.
    pub votes: Option<f32>,
    /// Effective inliers, once verified.
    pub inliers: Option<u32>,
    /// Probability that the frame shows the place, by all that it and those before it say of it; 0 until that is asked.
    pub probability: f32,
    /// Why it was turned down; `None` for the one that was accepted.
    pub rejected: Option<Rejection>,
}

/// Why a candidate was turned down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rejection {
    /// It is too unlikely.
    Unlikely {
        /// How likely it is, with the places next to it.
        got: f32,
        /// How likely it would have to be.
        needed: f32,
    },
    /// A place next to it, which shows much the same, is likelier.
    NextIsLikelier,
    /// The frame itself says too little for it, whatever was believed before.
    NotSeen {
        /// Log odds that it gives.
        got: f32,
        /// What it would have to give.
        needed: f32,
    },
    /// It is the place we are in, founded so recently that its frames join it unasked.
    WithinPlaceInterval,
    /// The CNN is sure of it, but geometry verified another place, and the robot is believed to be there.
    Overruled {
        /// Whose place.
        by: PlaceId,
        /// Effective inliers of that.
        inliers: u32,
    },
    /// Another candidate was accepted before it.
    Outdone {
        /// Whose place.
        by: PlaceId,
    },
}

impl fmt::Display for Rejection {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unlikely { got, needed } => write!(formatter, "probability {got:.3} < {needed:.3}"),
            Self::NextIsLikelier => write!(formatter, "a place next to it is likelier"),
            Self::NotSeen { got, needed } => {
                write!(formatter, "the frame itself says too little: log odds {got:+.2}, needed {needed:+.2}")
            }
            Self::WithinPlaceInterval => write!(formatter, "within the place interval"),
            Self::Overruled { by, inliers } => {
                write!(formatter, "geometry overrules the CNN: place {} has {inliers} inliers", by.0)
            }
            Self::Outdone { by } => write!(formatter, "place {} was accepted", by.0),
        }
    }
}
