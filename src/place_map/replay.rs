//! What each record of a journal adds to the contents of a map.

use super::contents::{Contents, Location};
use super::format::{
    self, EXPERIENCE, ExperienceRecord, FEATURES, KeyframeRecord, PLACE, PlaceRecord, THINNED, THUMBNAIL,
    ThinnedRecord,
};
use super::version_1;
use super::{Experience, ExperienceId};
use crate::storage::Envelope;

/// Adds what a record of `length_bytes` at `location` says to `contents`.
pub(super) fn apply(
    contents: &mut Contents,
    location: Location,
    (envelope, payload): (Envelope, &[u8]),
    length_bytes: u64,
) -> Result<(), String> {
    match envelope {
        PLACE => contents.put_place(format::decode(payload)?, location, length_bytes),
        EXPERIENCE => {
            contents.put_experience(Experience::new(&format::decode(payload)?, location, length_bytes)?);
        }
        THINNED => {
            for id in format::decode::<ThinnedRecord>(payload)?.experiences {
                contents.remove_experience(ExperienceId(id));
            }
        }
        FEATURES | THUMBNAIL => {}
        Envelope { kind, version } => {
            return Err(format!("it is of kind {kind}, version {version}: update Loci"));
        }
    }
    Ok(())
}

/// Adds what a record of version 1 says.
pub(super) fn apply_version_1(
    contents: &mut Contents,
    location: Location,
    length_bytes: u64,
    record: version_1::Record,
) -> Result<(), String> {
    let place_record = |place, name| PlaceRecord { place, name, merged_into: None, neighbours: Vec::new() };
    match record {
        version_1::Record::Founded => {
            let place = contents.places.len() as u32;
            contents.put_place(place_record(place, None), location, length_bytes);
        }
        version_1::Record::Named { place, name } => {
            contents.put_place(place_record(place, Some(name)), location, length_bytes);
        }
        record => {
            let Some((old, mean_luminance)) = record.into_experience() else { return Ok(()) };
            old.features()?;
            let mut new = version_1_experience(old, mean_luminance)?;
            new.experience = contents.next_experience;
            contents.put_experience(Experience::new(&new, location, length_bytes)?);
        }
    }
    Ok(())
}

/// An experience of version 1 as one of today, but for its number, which was its position.
pub(super) fn version_1_experience(
    old: version_1::ExperienceRecord,
    mean_luminance: Option<f32>,
) -> Result<ExperienceRecord, String> {
    let appearance =
        old.appearance.map(|(model, values)| format::packed_appearance(model, values)).transpose()?;
    Ok(ExperienceRecord {
        experience: 0,
        place: old.place,
        frame_index: old.frame_index,
        frame_name: old.frame_name,
        capture_nanos: old.capture_nanos,
        pose: old.pose,
        mean_luminance,
        view: 0,
        thumbnail_back_bytes: 0,
        keyframe: old.is_keyframe.then(|| KeyframeRecord::new(0, &[], appearance.as_ref())),
    })
}
