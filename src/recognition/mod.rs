//! The decision: which place does this frame show?
//!
//! The CNN and geometry each name places; what they say of one together is its log odds, and what was believed before
//! turns that into a probability (`fusion`, `belief`). The likeliest place above the threshold is `recognised`, or
//! `revisited` where geometry says more than the CNN. Else the frame founds a new place, unless the place we are in was
//! founded a moment ago (Algorithm 1 of the paper), or is `unknown`, where the map is read-only or only one frame says
//! so. Every candidate that was turned down says why.
//!
//! A pure state machine: the same frames give the same decisions, whatever the clock says.

mod appearance;
mod belief;
mod by_place;
mod candidate;
mod comparison;
mod decision;
mod drift;
mod fusion;
mod grounds;
mod identity;
mod insight;
mod joining;
mod keyframe_index;
mod learning;
mod look;
mod options;
mod purity;
mod recogniser;
mod renewal;
#[cfg(test)]
mod sequence_tests;
mod spare;
mod visits;
mod working_set;
#[cfg(test)]
mod world_for_tests;

pub use candidate::{Candidate, Candidates, Evidence, MAX_CANDIDATES, Rejection, Verifications};
pub use drift::Drift;
pub use fusion::Clues;
pub use grounds::{Grounds, PlaceGrounds, Thresholds};
pub use insight::{Insight, MatchedKeyframe, PlaceSketch};
pub use joining::{Join, Support};
pub use look::Look;
pub use options::RecognitionOptions;
pub use purity::Purity;
pub use recogniser::Recogniser;
pub use renewal::{Exhibit, Walk};

use std::sync::Arc;

use crate::place_map::{ExperienceId, PlaceId};
use crate::verification::Verification;

/// What was decided about a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Decision {
    /// A known place, above all by the CNN.
    Recognised,
    /// A known place, above all by a keyframe that BoW+HV, the fallback, matched and verified.
    Revisited,
    /// The place we are in was founded within the place interval δ_ep; the frame joins it.
    SamePlace,
    /// Nothing matched: a place was founded.
    NewPlace,
    /// Nothing matched, and the map is read-only or a single frame is not enough: after a known place, or a poor one.
    Unknown,
}

impl Decision {
    /// The word for it in records and logs.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Recognised => "recognised",
            Self::Revisited => "revisited",
            Self::SamePlace => "same_place",
            Self::NewPlace => "new_place",
            Self::Unknown => "unknown",
        }
    }
}

/// The answer for one frame.
#[derive(Clone, Debug)]
pub struct Recognition {
    /// What was decided.
    pub decision: Decision,
    /// Which evidence decided, unless nothing matched.
    pub by: Option<Evidence>,
    /// The place, unless unknown.
    pub place: Option<PlaceId>,
    /// The place's name, if it has one.
    pub name: Option<Arc<str>>,
    /// The keyframe that was matched, or that a new place was founded with.
    pub keyframe: Option<ExperienceId>,
    /// What the frame became in the map, unless that learnt nothing from it.
    pub experience: Option<ExperienceId>,
    /// Probability that the decision is right, 0 to 1.
    pub confidence: f32,
    /// Effective inliers of the accepted match, if it was verified.
    pub inliers: Option<u32>,
    /// What was considered, the accepted one first, then the best of the rejected.
    pub candidates: Candidates,
    /// The geometry of the accepted match, if it was verified.
    pub verification: Option<Verification>,
    /// What was thought of each place.
    pub grounds: Grounds,
}
