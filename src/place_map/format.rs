//! What the journal of a map holds: one bincode record an event, behind a version of its own.
//!
//! The file is `journal-000001.loci`, a record log as described in [`crate::storage`]. A payload is one
//! [`Record`] in bincode 2 with little-endian fixed-size integers. Keypoints are packed to 11 bytes.

use std::f32::consts::PI;

use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use bincode::{Decode, Encode};

use crate::feature::{Descriptor, Features, Keypoint};
use crate::geometry::Point;
use crate::storage::FileKind;

/// Magic, version and name of the journal.
pub(super) const KIND: FileKind = FileKind { magic: *b"LOCIMAP\0", version: 1, name: "map journal" };
/// Name of the journal in the map's folder.
pub(super) const JOURNAL_NAME: &str = "journal-000001.loci";

/// Longest record in bytes; a hostile length stops here instead of allocating.
const MAX_RECORD_BYTES: usize = 16 << 20;
/// Positions are stored in eighths of a pixel, which covers 8,192 px.
const STEPS_PER_PX: f32 = 8.0;
/// Angles are stored in 1/32,768 of half a turn.
const STEPS_PER_HALF_TURN: f32 = 32_768.0;

fn configuration() -> Configuration<LittleEndian, Fixint, Limit<MAX_RECORD_BYTES>> {
    bincode::config::standard().with_fixed_int_encoding().with_limit()
}

/// An event in the life of a map.
#[derive(Debug, Encode, Decode)]
pub(super) enum Record {
    /// A place was founded; places are numbered in the order of these records.
    Founded,
    /// A place was given a name.
    Named { place: u32, name: String },
    /// A place got an experience whose light is not known: from before light was noted.
    Experienced(Box<ExperienceRecord>),
    /// A place got an experience, in a frame of this mean luminance.
    ExperiencedInLight(f32, Box<ExperienceRecord>),
}

#[derive(Debug, Encode, Decode)]
pub(super) struct ExperienceRecord {
    pub(super) place: u32,
    pub(super) is_keyframe: bool,
    pub(super) frame_index: u64,
    pub(super) frame_name: String,
    pub(super) capture_nanos: i64,
    /// Position x y z, then orientation x y z w.
    pub(super) pose: Option<[f64; 7]>,
    pub(super) width_px: u32,
    pub(super) height_px: u32,
    pub(super) keypoints: Vec<PackedKeypoint>,
    pub(super) descriptors: Vec<[u8; 32]>,
    /// Model and descriptor.
    pub(super) appearance: Option<(String, Vec<f32>)>,
    pub(super) thumbnail_jpeg: Vec<u8>,
}

#[derive(Debug, Clone, Copy, Encode, Decode)]
pub(super) struct PackedKeypoint {
    x_steps: u16,
    y_steps: u16,
    scale: f32,
    angle_steps: i16,
    response: u8,
}

impl From<&Keypoint> for PackedKeypoint {
    fn from(keypoint: &Keypoint) -> Self {
        Self {
            x_steps: (keypoint.point.x * STEPS_PER_PX).round() as u16,
            y_steps: (keypoint.point.y * STEPS_PER_PX).round() as u16,
            scale: keypoint.scale,
            angle_steps: (keypoint.angle_radians / PI * STEPS_PER_HALF_TURN).round() as i16,
            response: keypoint.response,
        }
    }
}

impl From<&PackedKeypoint> for Keypoint {
    fn from(packed: &PackedKeypoint) -> Self {
        Self {
            point: Point {
                x: f32::from(packed.x_steps) / STEPS_PER_PX,
                y: f32::from(packed.y_steps) / STEPS_PER_PX,
            },
            scale: packed.scale,
            angle_radians: f32::from(packed.angle_steps) / STEPS_PER_HALF_TURN * PI,
            response: packed.response,
        }
    }
}

impl Record {
    pub(super) fn encode(&self) -> Result<Vec<u8>, String> {
        bincode::encode_to_vec(self, configuration()).map_err(|error| error.to_string())
    }

    /// A record from its payload, whose checksum was right; an error means another version's bytes.
    pub(super) fn decode(payload: &[u8]) -> Result<Self, String> {
        let (record, read) =
            bincode::decode_from_slice(payload, configuration()).map_err(|error| error.to_string())?;
        if read == payload.len() {
            Ok(record)
        } else {
            Err(format!("{} bytes too many", payload.len() - read))
        }
    }
}

impl ExperienceRecord {
    /// The features; `None` if keypoints and descriptors are not equally many or make no sense.
    pub(super) fn features(&self) -> Option<Features> {
        let sound = |keypoint: &PackedKeypoint| keypoint.scale.is_finite() && keypoint.scale > 0.0;
        if self.keypoints.len() != self.descriptors.len() || !self.keypoints.iter().all(sound) {
            return None;
        }
        Some(Features {
            width_px: self.width_px,
            height_px: self.height_px,
            keypoints: self.keypoints.iter().map(Keypoint::from).collect(),
            descriptors: self.descriptors.iter().copied().map(Descriptor).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_packed_keypoint_moves_less_than_its_precision(
            x in 0.0..8000.0_f32, y in 0.0..8000.0_f32, angle_radians in -3.1..3.1_f32, response in any::<u8>(),
        ) {
            let keypoint = Keypoint { point: Point { x, y }, scale: 1.44, angle_radians, response };
            let unpacked = Keypoint::from(&PackedKeypoint::from(&keypoint));
            prop_assert!(unpacked.point.distance_squared(keypoint.point).sqrt() <= 0.09);
            prop_assert!((unpacked.angle_radians - angle_radians).abs() < 2e-4);
            prop_assert_eq!((unpacked.scale, unpacked.response), (1.44, response));
        }

        #[test]
        fn foreign_bytes_are_refused_without_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            if let Ok(record) = Record::decode(&bytes) {
                prop_assert_eq!(record.encode().unwrap(), bytes);
            }
        }
    }

    #[test]
    fn a_hostile_length_is_refused_before_it_is_allocated() {
        let mut bytes = Record::Named { place: 0, name: "dock".to_owned() }.encode().unwrap();
        bytes[8..16].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(Record::decode(&bytes).is_err());
    }
}
