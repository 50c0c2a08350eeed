//! Records that are written together or not at all.

use super::format::{
    self, EXPERIENCE, ExperienceRecord, FEATURES, FeaturesRecord, KeyframeRecord, THUMBNAIL,
};
use super::map::NewExperience;
use super::{ExperienceId, MapError, PlaceId};
use crate::storage::{Envelope, RecordLog};

/// Records that are written together or not at all.
#[derive(Default)]
pub(super) struct Batch(pub(super) Vec<(Envelope, Vec<u8>)>);

impl Batch {
    pub(super) fn add(
        &mut self,
        envelope: Envelope,
        payload: Result<Vec<u8>, String>,
    ) -> Result<(), MapError> {
        self.0.push((envelope, payload.map_err(|reason| MapError::Unstorable { reason })?));
        Ok(())
    }

    /// Bytes that it takes in the journal.
    pub(super) fn length_bytes(&self) -> u64 {
        self.0.iter().map(|(_, payload)| RecordLog::framed_bytes(payload)).sum()
    }

    pub(super) fn add_experience(
        &mut self,
        id: ExperienceId,
        place: PlaceId,
        new: &NewExperience<'_>,
    ) -> Result<(), MapError> {
        let features = match new.keyframe {
            Some((features, _)) => Some(
                format::encode(&FeaturesRecord::from(features))
                    .map_err(|reason| MapError::Unstorable { reason })?,
            ),
            None => None,
        };
        let record = ExperienceRecord {
            experience: id.0,
            place: place.0,
            frame_index: new.frame.index,
            frame_name: new.frame.name.clone(),
            capture_nanos: new.frame.capture_nanos,
            pose: new.frame.pose.map(format::pack_pose),
            mean_luminance: Some(new.mean_luminance),
            view: new.view,
            thumbnail_back_bytes: 0,
            keyframe: new
                .keyframe
                .map(|(_, traits)| KeyframeRecord::new(0, &traits.words, traits.appearance.as_ref())),
        };
        self.add_parts(record, features, new.thumbnail_jpeg.to_vec())
    }

    /// An experience behind its parts, to which it will point.
    pub(super) fn add_parts(
        &mut self,
        mut record: ExperienceRecord,
        features: Option<Vec<u8>>,
        thumbnail_jpeg: Vec<u8>,
    ) -> Result<(), MapError> {
        let has_thumbnail = !thumbnail_jpeg.is_empty();
        let thumbnail_bytes = if has_thumbnail { RecordLog::framed_bytes(&thumbnail_jpeg) } else { 0 };
        let features_bytes = features.as_ref().map_or(0, |features| RecordLog::framed_bytes(features));
        record.thumbnail_back_bytes = thumbnail_bytes as u32;
        if let (Some(keyframe), Some(features)) = (&mut record.keyframe, features) {
            keyframe.features_back_bytes = (features_bytes + thumbnail_bytes) as u32;
            self.add(FEATURES, Ok(features))?;
        }
        if has_thumbnail {
            self.add(THUMBNAIL, Ok(thumbnail_jpeg))?;
        }
        self.add(EXPERIENCE, format::encode(&record))
    }
}
