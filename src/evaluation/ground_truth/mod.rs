//! Ground truth: which frames show the same place.
//!
//! Most kinds say where each frame was taken (a [`Spot`]) and when two spots are one place; loop
//! matrices say it of pairs of frames. About some frames they say nothing, and those are not scored.

mod error;
pub(in crate::evaluation) mod file;
pub mod loop_matrix;
mod mat;
mod npy;
mod pickle;
pub mod position;
mod rows;
mod table;

pub use error::{GroundTruthError, Rows};
pub use loop_matrix::LoopMatrix;
pub use rows::{RowFilter, RowFilterError};
pub use table::{Table, TableRow, TableSpots};

/// Where a frame was taken, in the terms of its ground truth.
#[derive(Clone, Debug, PartialEq)]
pub enum Spot {
    /// Nothing is said about the frame.
    Unscored,
    /// The places that the frame shows, by number; sorted.
    Places(Vec<u32>),
    /// Share of a lap, in [0, 1).
    LapPhase(f64),
    /// Position in a plane, in metres.
    Metres([f64; 2]),
    /// Number along an aligned route.
    Ordinal(i64),
}

/// How far apart two spots of one place may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Between lap phases, as a share of a lap; default 0.05.
    pub lap_share: f64,
    /// Between positions, in metres; default 25.
    pub radius_metres: f64,
    /// Between ordinals; default 0.
    pub ordinals: i64,
}

impl Default for Tolerance {
    fn default() -> Self {
        Self { lap_share: 0.05, radius_metres: 25.0, ordinals: 0 }
    }
}

/// What the ground truth says of two frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relation {
    /// They show the same place.
    Same,
    /// They show different places.
    Different,
    /// Nothing is said.
    Unsaid,
}

impl Spot {
    /// Whether this and `other` are one place.
    #[must_use]
    pub fn relation(&self, other: &Self, tolerance: &Tolerance) -> Relation {
        let is_same = match (self, other) {
            (Self::Places(a), Self::Places(b)) => a.iter().any(|place| b.contains(place)),
            (Self::LapPhase(a), Self::LapPhase(b)) => {
                let apart = (a - b).rem_euclid(1.0);
                apart.min(1.0 - apart) <= tolerance.lap_share
            }
            (Self::Metres(a), Self::Metres(b)) => (a[0] - b[0]).hypot(a[1] - b[1]) <= tolerance.radius_metres,
            (Self::Ordinal(a), Self::Ordinal(b)) => a.abs_diff(*b) <= tolerance.ordinals.unsigned_abs(),
            _ => return Relation::Unsaid,
        };
        if is_same { Relation::Same } else { Relation::Different }
    }
}

/// How the ground truth relates query frames and reference frames.
#[derive(Clone, Debug, PartialEq)]
pub enum Rule {
    /// By where each was taken.
    Spots {
        /// A spot a query frame.
        query: Vec<Spot>,
        /// A spot a reference frame.
        reference: Vec<Spot>,
        /// How far apart one place reaches.
        tolerance: Tolerance,
    },
    /// By lists of reference frames.
    Pairs {
        /// Those that each query frame shows the same place as, sorted; `None` if nothing is said about it.
        matches: Vec<Option<Vec<u32>>>,
        /// Those about which nothing is said; sorted.
        unsaid: Vec<u32>,
    },
    /// The reference shows none of the query's places.
    Strangers,
    /// Frames of the same group, by number, say nothing; those of different groups show different places.
    Groups {
        /// A group a query frame.
        query: Vec<u32>,
        /// A group a reference frame.
        reference: Vec<u32>,
    },
}

/// Which frames of a query traverse and a reference traverse show the same place.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruth {
    /// When two frames show the same place, as a sentence.
    pub definition: String,
    /// SHA-256 of the file it was read from.
    pub sha256: Option<String>,
    /// How.
    pub rule: Rule,
}

impl GroundTruth {
    /// What is said of query frame `query` and reference frame `reference`, counted from 0.
    #[must_use]
    pub fn relation(&self, query: usize, reference: usize) -> Relation {
        match &self.rule {
            Rule::Spots { query: queries, reference: references, tolerance } => {
                match (queries.get(query), references.get(reference)) {
                    (Some(a), Some(b)) => a.relation(b, tolerance),
                    _ => Relation::Unsaid,
                }
            }
            Rule::Pairs { matches, unsaid } => {
                let lists = |list: &[u32]| list.binary_search(&(reference as u32)).is_ok();
                match matches.get(query).and_then(Option::as_deref) {
                    Some(_) if lists(unsaid) => Relation::Unsaid,
                    Some(row) if lists(row) => Relation::Same,
                    Some(_) => Relation::Different,
                    None => Relation::Unsaid,
                }
            }
            Rule::Strangers => Relation::Different,
            Rule::Groups { query: queries, reference: references } => {
                match (queries.get(query), references.get(reference)) {
                    (Some(a), Some(b)) if a != b => Relation::Different,
                    _ => Relation::Unsaid,
                }
            }
        }
    }

    /// Whether anything is said about a query frame.
    #[must_use]
    pub fn is_scored(&self, query: usize) -> bool {
        match &self.rule {
            Rule::Spots { query: queries, .. } => {
                queries.get(query).is_some_and(|spot| *spot != Spot::Unscored)
            }
            Rule::Pairs { matches, .. } => matches.get(query).is_some_and(Option::is_some),
            Rule::Strangers | Rule::Groups { .. } => true,
        }
    }

    /// Whether two reference frames show the same place; `None` where that is not said.
    #[must_use]
    pub fn are_one_place(&self, a: usize, b: usize) -> Option<bool> {
        let Rule::Spots { reference, tolerance, .. } = &self.rule else { return None };
        match reference.get(a)?.relation(reference.get(b)?, tolerance) {
            Relation::Same => Some(true),
            Relation::Different => Some(false),
            Relation::Unsaid => None,
        }
    }

    /// Whether two reference frames are known to show different places; of frames of one group that is not known.
    /// `None` where nothing is ever said of either.
    #[must_use]
    pub fn are_apart(&self, a: usize, b: usize) -> Option<bool> {
        match &self.rule {
            Rule::Groups { reference, .. } => Some(reference.get(a)? != reference.get(b)?),
            _ => self.are_one_place(a, b).map(|is_one| !is_one),
        }
    }

    /// What is said of a frame that was seen just before the query frame. Lists hold loop closures: a pair
    /// of neighbours that they lack may well show the same place.
    #[must_use]
    pub fn relation_just_now(&self, query: usize, reference: usize) -> Relation {
        match (&self.rule, self.relation(query, reference)) {
            (Rule::Pairs { .. }, Relation::Different) => Relation::Unsaid,
            (_, relation) => relation,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const EXACT: Tolerance = Tolerance { lap_share: 0.05, radius_metres: 25.0, ordinals: 2 };

    #[test]
    fn laps_close_upon_themselves() {
        let relation = |a, b| Spot::LapPhase(a).relation(&Spot::LapPhase(b), &EXACT);
        assert_eq!(relation(0.98, 0.02), Relation::Same);
        assert_eq!(relation(0.98, 0.04), Relation::Different);
        assert_eq!(relation(0.5, 0.45), Relation::Same);
    }

    #[test]
    fn a_radius_reaches_exactly_so_far() {
        let relation = |x: f64| Spot::Metres([0.0, 0.0]).relation(&Spot::Metres([x * 0.6, x * 0.8]), &EXACT);
        assert_eq!(relation(25.0), Relation::Same);
        assert_eq!(relation(25.001), Relation::Different);
    }

    #[test]
    fn ordinals_are_the_same_place_up_to_the_tolerance_and_not_one_further() {
        let relation = |a, b| Spot::Ordinal(a).relation(&Spot::Ordinal(b), &EXACT);
        assert_eq!([relation(10, 12), relation(10, 8)], [Relation::Same; 2]);
        assert_eq!([relation(10, 13), relation(10, 7)], [Relation::Different; 2]);
        assert_eq!(relation(i64::MIN, i64::MAX), Relation::Different);
    }

    #[test]
    fn frames_that_show_a_place_in_common_show_the_same_place() {
        let relation =
            |a: &[u32], b: &[u32]| Spot::Places(a.to_vec()).relation(&Spot::Places(b.to_vec()), &EXACT);
        assert_eq!(relation(&[1, 4], &[4, 9]), Relation::Same);
        assert_eq!(relation(&[1, 4], &[2]), Relation::Different);
    }

    #[test]
    fn nothing_is_said_of_unscored_frames_nor_of_frames_that_do_not_exist() {
        let spots = vec![Spot::Ordinal(1), Spot::Unscored];
        let truth = GroundTruth {
            definition: String::new(),
            sha256: None,
            rule: Rule::Spots { query: spots.clone(), reference: spots, tolerance: EXACT },
        };
        assert_eq!(truth.relation(0, 0), Relation::Same);
        assert_eq!([truth.relation(0, 1), truth.relation(1, 0), truth.relation(0, 2)], [Relation::Unsaid; 3]);
        assert_eq!([0, 1, 2].map(|query| truth.is_scored(query)), [true, false, false]);
    }

    #[test]
    fn reference_frames_are_known_to_be_apart_by_their_spots_or_groups_and_never_by_lists() {
        let truth = |rule| GroundTruth { definition: String::new(), sha256: None, rule };
        let spots = vec![Spot::Ordinal(1), Spot::Ordinal(9), Spot::Unscored];
        let by_spots = truth(Rule::Spots { query: Vec::new(), reference: spots, tolerance: EXACT });
        assert_eq!(
            [0, 1, 2, 3].map(|other| by_spots.are_apart(0, other)),
            [Some(false), Some(true), None, None]
        );
        let by_groups = truth(Rule::Groups { query: Vec::new(), reference: vec![4, 4, 7] });
        assert_eq!([1, 2, 3].map(|other| by_groups.are_apart(0, other)), [Some(false), Some(true), None]);
        let by_lists = truth(Rule::Pairs { matches: vec![Some(vec![0])], unsaid: Vec::new() });
        assert_eq!(by_lists.are_apart(0, 1), None);
    }

    #[test]
    fn lists_say_nothing_of_rows_they_leave_out_nor_of_neighbours_they_lack() {
        let rule = Rule::Pairs { matches: vec![Some(vec![0, 2]), None], unsaid: vec![2, 3] };
        let truth = GroundTruth { definition: String::new(), sha256: None, rule };
        let relations = [0, 1, 2, 3].map(|reference| truth.relation(0, reference));
        assert_eq!(relations, [Relation::Same, Relation::Different, Relation::Unsaid, Relation::Unsaid]);
        assert_eq!(truth.relation(1, 0), Relation::Unsaid);
        assert_eq!([0, 1, 2].map(|query| truth.is_scored(query)), [true, false, false]);
        assert_eq!([0, 1].map(|near| truth.relation_just_now(0, near)), [Relation::Same, Relation::Unsaid]);
    }

    proptest! {
        #[test]
        fn being_the_same_place_is_mutual(a in 0.0..1.0_f64, b in 0.0..1.0_f64) {
            for (a, b) in [
                (Spot::LapPhase(a), Spot::LapPhase(b)),
                (Spot::Metres([a * 90.0, b]), Spot::Metres([b * 90.0, a])),
            ] {
                prop_assert_eq!(a.relation(&b, &EXACT), b.relation(&a, &EXACT));
                prop_assert_eq!(a.relation(&a, &EXACT), Relation::Same);
            }
        }
    }
}
