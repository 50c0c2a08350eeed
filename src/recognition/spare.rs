//! Memory of answers that nobody needs any more, for the next ones.

use heapless::Vec as FixedVec;

use super::Recognition;
use super::candidate::{MAX_CANDIDATES, Verifications};
use super::grounds::PlaceGrounds;
use crate::verification::Verification;

/// Lists of grounds that are kept: as many as answers come back before the next frame is decided, if sinks are slow.
const MOST_GROUNDS: usize = 8;

/// Lists, each empty or of no use any more.
#[derive(Default)]
pub(super) struct Spare {
    /// Two times as many as a frame has, for some come back with answers.
    verifications: FixedVec<Verification, { 2 * MAX_CANDIDATES }>,
    grounds: FixedVec<Vec<PlaceGrounds>, MOST_GROUNDS>,
}

impl Spare {
    /// A verification to be written over.
    pub(super) fn verification(&mut self) -> Verification {
        self.verifications.pop().unwrap_or_default()
    }

    /// An empty list of grounds.
    pub(super) fn grounds(&mut self) -> Vec<PlaceGrounds> {
        let mut grounds = self.grounds.pop().unwrap_or_default();
        grounds.clear();
        grounds
    }

    /// Takes verifications; what there is no room for is freed.
    pub(super) fn take_verifications(&mut self, verifications: Verifications) {
        for verification in verifications {
            let _ = self.verifications.push(verification);
        }
    }

    /// Takes an answer; what there is no room for is freed.
    pub(super) fn take(&mut self, answer: Recognition) {
        if let Some(verification) = answer.verification {
            let _ = self.verifications.push(verification);
        }
        let _ = self.grounds.push(answer.grounds.places);
    }
}
