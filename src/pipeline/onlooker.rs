//! Somebody who looks on: what is put into records only where a sink shows it.

use crate::place_map::MapError;
use crate::recognition::{Insight, Recogniser};
use crate::telemetry::FrameRecord;

/// Records after which the whole map is told again at the earliest.
const TOLD_AGAIN: u64 = 300;

/// Somebody who looks on.
#[derive(Default)]
pub(super) struct Onlooker {
    /// Whether the matched keyframe is shown, too.
    shows_matched: bool,
    /// Memory of what was shown before.
    spare: Option<Box<Insight>>,
    /// Records that a sink had missed when the map was last told anew, and records since then.
    missed: u64,
    records: u64,
}

impl Onlooker {
    /// Somebody who sees the matched keyframe, too, or not.
    pub(super) fn new(shows_matched: bool) -> Self {
        Self { shows_matched, ..Self::default() }
    }

    /// Adds to `record` what its answer went by and the keyframe that was matched.
    ///
    /// # Errors
    /// If the keyframe cannot be read.
    pub(super) fn show(
        &mut self,
        recogniser: &mut Recogniser,
        record: &mut FrameRecord,
    ) -> Result<(), MapError> {
        self.records += 1;
        let mut insight = self.spare.take().unwrap_or_default();
        recogniser.tell(&record.recognition, &mut insight);
        record.insight = Some(insight);
        if self.shows_matched {
            record.matched = recogniser.matched_keyframe(&record.recognition)?;
        }
        Ok(())
    }

    /// A sink that missed records, `missed` of them by now, missed what was new of the map: it is told whole again, now
    /// and then.
    pub(super) fn make_up_for(&mut self, missed: u64, recogniser: &mut Recogniser) {
        if missed > self.missed && self.records >= TOLD_AGAIN {
            (self.missed, self.records) = (missed, 0);
            recogniser.keep_insight();
        }
    }

    /// Takes what was shown, to be written over.
    pub(super) fn take_back(&mut self, shown: Option<Box<Insight>>) {
        self.spare = shown.or(self.spare.take());
    }
}
