//! Somebody who looks on: what is put into records only where a sink shows it.

use crate::place_map::{MapError, PlaceMap};
use crate::recognition::{Decision, Insight, Recogniser, Recognition};
use crate::telemetry::{FrameRecord, MatchedKeyframe};

/// Somebody who looks on.
#[derive(Default)]
pub(super) struct Onlooker {
    /// Memory of what was shown before.
    spare: Option<Box<Insight>>,
}

impl Onlooker {
    /// Adds to `record` what its answer went by and the keyframe that was matched.
    ///
    /// # Errors
    /// If the keyframe cannot be read.
    pub(super) fn show(
        &mut self,
        recogniser: &mut Recogniser,
        record: &mut FrameRecord,
    ) -> Result<(), MapError> {
        let mut insight = self.spare.take().unwrap_or_default();
        recogniser.tell(&record.recognition, &mut insight);
        record.insight = Some(insight);
        record.matched = matched_keyframe(recogniser.map(), &record.recognition)?;
        Ok(())
    }

    /// Takes what was shown, to be written over.
    pub(super) fn take_back(&mut self, shown: Option<Box<Insight>>) {
        self.spare = shown.or(self.spare.take());
    }
}

fn matched_keyframe(map: &PlaceMap, recognition: &Recognition) -> Result<Option<MatchedKeyframe>, MapError> {
    let is_match = matches!(recognition.decision, Decision::Recognised | Decision::Revisited);
    // It may just have been given up.
    let keyframe = recognition.keyframe.filter(|&id| is_match && map.experience(id).is_some());
    let Some(experience) = keyframe else { return Ok(None) };
    let features = map.features(experience)?;
    Ok(Some(MatchedKeyframe {
        experience,
        frame_name: map.origin(experience)?.frame_name,
        width_px: features.width_px,
        height_px: features.height_px,
        thumbnail_jpeg: map.thumbnail_jpeg(experience)?,
    }))
}
