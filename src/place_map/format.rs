//! What the records of a map hold: one bincode payload each, behind the log's envelope.
//!
//! Integers are little-endian and of fixed size. An experience is written in up to three records, one after the
//! other: its features, its thumbnail, and then itself, which points back to both. So recognition reads what it
//! needs, and a power cut between them leaves no half experience.

use std::f32::consts::PI;

use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use bincode::error::DecodeError;
use bincode::{Decode, Encode};

use super::{Appearance, ExperienceId, Traits, VocabularyWords};
use crate::cnn::{self, CompactDescriptor};
use crate::feature::{Descriptor, Features, Keypoint};
use crate::frame::Pose;
use crate::geometry::Point;
use crate::storage::{Envelope, FileKind};
use crate::vocabulary::WordId;

/// Magic, version and name of a segment of the journal.
pub(super) const KIND: FileKind = FileKind { magic: *b"LOCIMAP\0", version: 2, name: "map journal" };

/// A place as it is now; the last record of a place counts.
pub(super) const PLACE: Envelope = Envelope { kind: 1, version: 1 };
/// An experience; the last record of an experience counts.
pub(super) const EXPERIENCE: Envelope = Envelope { kind: 2, version: 1 };
/// The features of a keyframe.
pub(super) const FEATURES: Envelope = Envelope { kind: 3, version: 1 };
/// The thumbnail of an experience: the bytes of a JPEG.
pub(super) const THUMBNAIL: Envelope = Envelope { kind: 4, version: 1 };
/// Experiences that were given up.
pub(super) const THINNED: Envelope = Envelope { kind: 5, version: 1 };

/// Whether this program knows what such a record says.
pub(super) fn is_known(envelope: Envelope) -> bool {
    [PLACE, EXPERIENCE, FEATURES, THUMBNAIL, THINNED].contains(&envelope)
}

/// Longest payload in bytes; a hostile length stops here instead of allocating.
const MAX_PAYLOAD_BYTES: usize = 16 << 20;
/// Positions are stored in eighths of a pixel, which covers 8,192 px.
const STEPS_PER_PX: f32 = 8.0;
/// Angles are stored in 1/32,768 of half a turn.
const STEPS_PER_HALF_TURN: f32 = 32_768.0;
/// Scales are stored as powers of the eighth root of 1.2, so that those of the usual pyramid are exact; step 96 is
/// scale 1, step 0 is 0.11, step 255 is 37.
const STEPS_PER_OCTAVE: f32 = 8.0;
const OCTAVE: f32 = 1.2;
const STEP_OF_ONE: f32 = 96.0;

fn configuration() -> Configuration<LittleEndian, Fixint, Limit<MAX_PAYLOAD_BYTES>> {
    bincode::config::standard().with_fixed_int_encoding().with_limit()
}

/// Packs a record.
pub(super) fn encode(record: &impl Encode) -> Result<Vec<u8>, String> {
    bincode::encode_to_vec(record, configuration()).map_err(|error| error.to_string())
}

/// A record from its payload, whose checksum was right; an error means that it is not what it says to be.
pub(super) fn decode<R: Decode<()>>(payload: &[u8]) -> Result<R, String> {
    let (record, read) =
        bincode::decode_from_slice(payload, configuration()).map_err(|error| reason(&error))?;
    match payload.len() - read {
        0 => Ok(record),
        rest => Err(format!("{rest} bytes too many")),
    }
}

fn reason(error: &DecodeError) -> String {
    match error {
        DecodeError::UnexpectedEnd { .. } => "it ends too early".to_owned(),
        error => error.to_string(),
    }
}

/// Takes the next of many records that stand one after the other off the front of `bytes`.
pub(super) fn take<R: Decode<()>>(bytes: &mut &[u8]) -> Result<R, String> {
    let (record, read) =
        bincode::decode_from_slice(bytes, configuration()).map_err(|error| reason(&error))?;
    *bytes = &bytes[read..];
    Ok(record)
}

#[derive(Clone, Debug, Encode, Decode, PartialEq)]
pub(super) struct PlaceRecord {
    pub(super) place: u32,
    pub(super) name: Option<String>,
    /// The place that it turned out to be.
    pub(super) merged_into: Option<u32>,
    /// The places next to it along the way, the latest last.
    pub(super) neighbours: Vec<u32>,
}

#[derive(Clone, Debug, Encode, Decode)]
pub(super) struct ExperienceRecord {
    pub(super) experience: u32,
    pub(super) place: u32,
    pub(super) frame_index: u64,
    pub(super) frame_name: String,
    pub(super) capture_nanos: i64,
    /// Position x y z, then orientation x y z w.
    pub(super) pose: Option<[f64; 7]>,
    /// 0 to 255.
    pub(super) mean_luminance: Option<f32>,
    /// Difference hash of the frame.
    pub(super) view: u64,
    /// Bytes from the thumbnail's record to this one; 0 if there is none.
    pub(super) thumbnail_back_bytes: u32,
    pub(super) keyframe: Option<KeyframeRecord>,
}

/// How many bytes before an experience's record that of its features begins, 0 if it has none: what is behind this in
/// `payload` is not looked at, and nothing is copied.
pub(super) fn features_back_bytes(payload: &[u8]) -> Result<u32, String> {
    type Front<'a> = (u32, u32, u64, &'a str, i64, Option<[f64; 7]>, Option<f32>, u64, u32, Option<u32>);
    let (front, _): (Front<'_>, usize) =
        bincode::borrow_decode_from_slice(payload, configuration()).map_err(|error| reason(&error))?;
    Ok(front.9.unwrap_or(0))
}

#[derive(Clone, Debug, Encode, Decode)]
pub(super) struct KeyframeRecord {
    /// Bytes from the features' record to this one.
    pub(super) features_back_bytes: u32,
    /// By vocabulary.
    pub(super) words: Vec<(u64, Vec<u32>)>,
    /// Model; values in steps, each an `i8` as a byte: bytes are read at once.
    pub(super) appearance: Option<(String, Vec<u8>)>,
}

#[derive(Clone, Debug, Encode)]
pub(super) struct FeaturesRecord {
    width_px: u32,
    height_px: u32,
    keypoints: Vec<PackedKeypoint>,
    descriptors: Vec<[u8; 32]>,
}

#[derive(Clone, Debug, Encode, Decode)]
pub(super) struct ThinnedRecord {
    pub(super) experiences: Vec<u32>,
}

#[derive(Debug, Clone, Copy, Encode, Decode)]
struct PackedKeypoint {
    x_steps: u16,
    y_steps: u16,
    angle_steps: i16,
    scale_steps: u8,
}

impl From<&Keypoint> for PackedKeypoint {
    fn from(keypoint: &Keypoint) -> Self {
        Self {
            x_steps: (keypoint.point.x * STEPS_PER_PX).round() as u16,
            y_steps: (keypoint.point.y * STEPS_PER_PX).round() as u16,
            angle_steps: (keypoint.angle_radians / PI * STEPS_PER_HALF_TURN).round() as i16,
            scale_steps: (keypoint.scale.log(OCTAVE) * STEPS_PER_OCTAVE + STEP_OF_ONE).round() as u8,
        }
    }
}

impl From<&PackedKeypoint> for Keypoint {
    /// The response served to choose the feature and is not kept.
    fn from(packed: &PackedKeypoint) -> Self {
        let octaves = (f32::from(packed.scale_steps) - STEP_OF_ONE) / STEPS_PER_OCTAVE;
        Self {
            point: Point {
                x: f32::from(packed.x_steps) / STEPS_PER_PX,
                y: f32::from(packed.y_steps) / STEPS_PER_PX,
            },
            scale: OCTAVE.powf(octaves),
            angle_radians: f32::from(packed.angle_steps) / STEPS_PER_HALF_TURN * PI,
            response: 0,
        }
    }
}

impl From<&Features> for FeaturesRecord {
    fn from(features: &Features) -> Self {
        Self {
            width_px: features.width_px,
            height_px: features.height_px,
            keypoints: features.keypoints.iter().map(PackedKeypoint::from).collect(),
            descriptors: features.descriptors.iter().map(|descriptor| descriptor.0).collect(),
        }
    }
}

impl FeaturesRecord {
    /// Unpacks the record in `payload`, whose checksum was right, over what is in `features`; an error if it is not
    /// what it says to be, or if keypoints and descriptors are not equally many.
    pub(super) fn unpack(mut payload: &[u8], features: &mut Features) -> Result<(), String> {
        let bytes = &mut payload;
        features.clear();
        (features.width_px, features.height_px) = (take(bytes)?, take(bytes)?);
        let count: u64 = take(bytes)?;
        for _ in 0..count {
            features.keypoints.push(Keypoint::from(&take::<PackedKeypoint>(bytes)?));
        }
        if take::<u64>(bytes)? != count {
            return Err("its features do not fit together".to_owned());
        }
        for _ in 0..count {
            features.descriptors.push(Descriptor(take(bytes)?));
        }
        match bytes.len() {
            0 => Ok(()),
            rest => Err(format!("{rest} bytes too many")),
        }
    }
}

impl KeyframeRecord {
    pub(super) fn new(
        features_back_bytes: u32,
        words: &[VocabularyWords],
        appearance: Option<&Appearance>,
    ) -> Self {
        let words =
            words.iter().map(|words| (words.vocabulary, words.words.iter().map(|word| word.0).collect()));
        let bytes =
            |a: &Appearance| a.descriptor.values().iter().map(|value| value.cast_unsigned()).collect();
        let appearance = appearance.map(|a| (a.model.clone(), bytes(a)));
        Self { features_back_bytes, words: words.collect(), appearance }
    }

    /// What the keyframe is found by; an error if its CNN descriptor is none.
    pub(super) fn unpacked(self) -> Result<Traits, String> {
        let words = self.words.into_iter().map(|(vocabulary, words)| VocabularyWords {
            vocabulary,
            words: words.into_iter().map(WordId).collect(),
        });
        let mut traits = Traits { words: words.collect(), appearance: None };
        if let Some((model, values)) = self.appearance {
            let values = values.into_iter().map(u8::cast_signed).collect();
            let descriptor =
                CompactDescriptor::from_values(values).ok_or("its CNN descriptor has no direction")?;
            traits.appearance = Some(Appearance { model, descriptor });
        }
        Ok(traits)
    }
}

/// The descriptor of before, packed as it is now.
pub(super) fn packed_appearance(model: String, values: Vec<f32>) -> Result<Appearance, String> {
    let descriptor = cnn::Descriptor::from_values(values).ok_or("its CNN descriptor has no direction")?;
    Ok(Appearance { model, descriptor: CompactDescriptor::from(&descriptor) })
}

pub(super) fn pack_pose(pose: Pose) -> [f64; 7] {
    let ([x, y, z], [qx, qy, qz, qw]) = (pose.position_metres, pose.orientation);
    [x, y, z, qx, qy, qz, qw]
}

pub(super) fn unpack_pose([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Pose {
    Pose { position_metres: [x, y, z], orientation: [qx, qy, qz, qw] }
}

impl ThinnedRecord {
    pub(super) fn new(experiences: &[ExperienceId]) -> Self {
        Self { experiences: experiences.iter().map(|id| id.0).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_of_an_experience_says_where_its_features_are_whatever_it_holds() {
        let keyframe = KeyframeRecord {
            features_back_bytes: 9000,
            words: vec![(3, vec![1, 2])],
            appearance: Some(("model".to_owned(), vec![7; 5])),
        };
        for (pose, mean_luminance, keyframe) in [
            (None, None, None),
            (None, Some(3.0), Some(keyframe.clone())),
            (Some([2.0; 7]), None, Some(keyframe)),
        ] {
            let expected = keyframe.as_ref().map_or(0, |keyframe| keyframe.features_back_bytes);
            let record = ExperienceRecord {
                experience: 1,
                place: 2,
                frame_index: 3,
                frame_name: "frame".to_owned(),
                capture_nanos: -4,
                pose,
                mean_luminance,
                view: 5,
                thumbnail_back_bytes: 6,
                keyframe,
            };
            let payload = encode(&record).unwrap();
            assert_eq!(features_back_bytes(&payload), Ok(expected));
        }
    }
}
