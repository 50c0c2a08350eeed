//! Answers: which reference frames a method finds for a query frame, best first, and whether it says so.

use crate::recognition::Evidence;

/// Most candidates that an answer lists.
pub const MAX_CANDIDATES: usize = 10;

/// What a method finds for one query frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answer {
    /// Candidates, the best first.
    pub candidates: Vec<Candidate>,
    /// Whether the best one is accepted at the shipped threshold.
    pub is_given: bool,
}

/// A reference frame that may show the same place.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// The reference frame, counted from 0: a keyframe where a map is searched.
    pub reference: usize,
    /// The place of the map that the frame belongs to, where a map is searched.
    pub place: Option<usize>,
    /// Probability that it shows the same place.
    pub probability: f64,
    /// Why it was accepted or not.
    pub reason: String,
}

impl Candidate {
    /// Why a candidate with such evidence is accepted, or not.
    pub(super) fn reason(by: Evidence, got: f64, needed: f64) -> String {
        let relation = if got >= needed { "≥" } else { "<" };
        match by {
            Evidence::Cnn => format!("cosine {got:.3} {relation} {needed:.3}"),
            _ => format!("{got:.0} effective inliers {relation} {needed:.0}"),
        }
    }
}
