//! Maps of version 1, which still open: one journal, a bincode record an event, without envelope.
//!
//! After 16 bytes of log header each record is its length (u32 little-endian), the CRC-32 of its payload (u32), and the
//! payload. Places and experiences are numbered in the order of their records, and an experience is one record
//! with its features, its CNN descriptor in f32 and its thumbnail. Nothing is ever added to such a journal: what
//! is learnt goes into the next segment.

use std::f32::consts::PI;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use bincode::{Decode, Encode};

use crate::feature::{Descriptor, Features, Keypoint};
use crate::geometry::Point;
use crate::storage::{self, AppendFile, LOG_HEADER_BYTES, Recovery, StorageError};

/// The version that is read here.
pub(super) const VERSION: u32 = 1;

const FRAME_BYTES: u64 = 8;
/// Longest record in bytes; a hostile length stops here instead of allocating.
const MAX_RECORD_BYTES: usize = 16 << 20;
const STEPS_PER_PX: f32 = 8.0;
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
    width_px: u32,
    height_px: u32,
    keypoints: Vec<PackedKeypoint>,
    descriptors: Vec<[u8; 32]>,
    /// Model and descriptor.
    pub(super) appearance: Option<(String, Vec<f32>)>,
    pub(super) thumbnail_jpeg: Vec<u8>,
}

#[derive(Debug, Clone, Copy, Encode, Decode)]
struct PackedKeypoint {
    x_steps: u16,
    y_steps: u16,
    scale: f32,
    angle_steps: i16,
    response: u8,
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
    pub(super) fn decode(payload: &[u8]) -> Result<Self, String> {
        let (record, read) =
            bincode::decode_from_slice(payload, configuration()).map_err(|error| error.to_string())?;
        match payload.len() - read {
            0 => Ok(record),
            rest => Err(format!("{rest} bytes too many")),
        }
    }

    /// The experience and its light, if the record is one.
    pub(super) fn into_experience(self) -> Option<(ExperienceRecord, Option<f32>)> {
        match self {
            Self::Experienced(record) => Some((*record, None)),
            Self::ExperiencedInLight(mean_luminance, record) => Some((*record, Some(mean_luminance))),
            Self::Founded | Self::Named { .. } => None,
        }
    }
}

impl ExperienceRecord {
    /// The features; an error if keypoints and descriptors are not equally many or make no sense.
    pub(super) fn features(&self) -> Result<Features, String> {
        let sound = |keypoint: &PackedKeypoint| keypoint.scale.is_finite() && keypoint.scale > 0.0;
        if self.keypoints.len() != self.descriptors.len() || !self.keypoints.iter().all(sound) {
            return Err("its features do not fit together".to_owned());
        }
        Ok(Features {
            width_px: self.width_px,
            height_px: self.height_px,
            keypoints: self.keypoints.iter().map(Keypoint::from).collect(),
            descriptors: self.descriptors.iter().copied().map(Descriptor).collect(),
        })
    }
}

/// Hears of what stands at an offset, so many bytes long: a payload, or what cannot be read.
type Visit<'a> = dyn FnMut(u64, u64, Option<&[u8]>) + 'a;

/// A journal of version 1.
pub(super) struct Journal {
    file: Arc<dyn AppendFile>,
    path: PathBuf,
    end: u64,
}

impl Journal {
    /// Opens a journal and hands every record from offset `from` on with its offset and length to `visit`. A torn
    /// last record is left out.
    ///
    /// # Errors
    /// If a record before the last is bad, `visit` complains, or the medium fails.
    pub(super) fn open(
        file: Arc<dyn AppendFile>,
        path: &Path,
        from: u64,
        visit: &mut dyn FnMut(u64, u64, Record) -> Result<(), String>,
    ) -> Result<(Self, Recovery), StorageError> {
        let length = file.length_bytes().map_err(StorageError::io("read", path))?;
        let mut journal = Self { file, path: path.to_owned(), end: from.max(LOG_HEADER_BYTES).min(length) };
        let mut recovery = Recovery::default();
        while let Some((payload, next)) = journal.read_frame(journal.end, length)? {
            let offset = journal.end;
            Record::decode(&payload).and_then(|record| visit(offset, next - offset, record)).map_err(
                |reason| {
                    let reason = format!("record at byte {offset}: {reason}");
                    StorageError::Damaged { path: path.to_owned(), reason }
                },
            )?;
            recovery.records += 1;
            journal.end = next;
        }
        recovery.torn_bytes = length - journal.end;
        Ok((journal, recovery))
    }

    /// Hands everything that stands in a journal to `visit`, with its offset and length: payloads whose checksums are
    /// right, and `None` for what cannot be read. Answers where a torn tail begins and how long it is.
    ///
    /// # Errors
    /// If the medium fails.
    pub(super) fn survey(
        file: Arc<dyn AppendFile>,
        path: &Path,
        visit: &mut Visit<'_>,
    ) -> Result<Option<(u64, u64)>, StorageError> {
        let length = file.length_bytes().map_err(StorageError::io("read", path))?;
        let journal = Self { file, path: path.to_owned(), end: length };
        let mut offset = LOG_HEADER_BYTES.min(length);
        while offset < length {
            let next = match journal.read_frame(offset, length) {
                Ok(Some((payload, next))) => {
                    visit(offset, next - offset, Some(&payload));
                    next
                }
                Ok(None) => return Ok(Some((offset, length - offset))),
                Err(StorageError::Damaged { .. }) => {
                    let next = journal.behind_bad(offset, length)?;
                    visit(offset, next - offset, None);
                    next
                }
                Err(error) => return Err(error),
            };
            offset = next;
        }
        Ok(None)
    }

    /// Where the record behind the bad one at `offset` begins, if the bad one's length can be believed; else the end.
    fn behind_bad(&self, offset: u64, length: u64) -> Result<u64, StorageError> {
        let mut frame = [0; 4];
        self.file.read_at(offset, &mut frame).map_err(StorageError::io("read", &self.path))?;
        let payload_bytes = u32::from_le_bytes(frame);
        let is_likely = (1..=MAX_RECORD_BYTES).contains(&(payload_bytes as usize));
        Ok(if is_likely { length.min(offset + FRAME_BYTES + u64::from(payload_bytes)) } else { length })
    }

    /// The record at `offset`.
    ///
    /// # Errors
    /// If there is no good record or the medium fails.
    pub(super) fn read(&self, offset: u64) -> Result<Record, StorageError> {
        let Some((payload, _)) = self.read_frame(offset, self.end)? else { return Err(self.damaged(offset)) };
        let damaged = |reason| StorageError::Damaged { path: self.path.clone(), reason };
        Record::decode(&payload).map_err(|reason| damaged(format!("record at byte {offset}: {reason}")))
    }

    /// Returns when all of it would survive a power cut.
    ///
    /// # Errors
    /// If the medium fails.
    pub(super) fn sync(&self) -> Result<(), StorageError> {
        self.file.sync().map_err(StorageError::io("sync", &self.path))
    }

    /// The file, for those who look whether it still has a name.
    pub(super) fn file(&self) -> Arc<dyn AppendFile> {
        Arc::clone(&self.file)
    }

    /// Length in bytes.
    pub(super) fn length_bytes(&self) -> u64 {
        self.end
    }

    /// The payload at `offset` and where the next record is; `None` where there is no whole one any more.
    fn read_frame(&self, offset: u64, length: u64) -> Result<Option<(Vec<u8>, u64)>, StorageError> {
        if length.saturating_sub(offset) < FRAME_BYTES {
            return Ok(None);
        }
        let read = |at, buffer: &mut [u8]| {
            self.file.read_at(at, buffer).map_err(StorageError::io("read", &self.path))
        };
        let mut frame = [0; FRAME_BYTES as usize];
        read(offset, &mut frame)?;
        let [l0, l1, l2, l3, checksum @ ..] = frame;
        let payload_bytes = u32::from_le_bytes([l0, l1, l2, l3]);
        if payload_bytes == 0 || payload_bytes as usize > MAX_RECORD_BYTES {
            return if self.is_zero(offset, length)? { Ok(None) } else { Err(self.damaged(offset)) };
        }
        let next = offset + FRAME_BYTES + u64::from(payload_bytes);
        if next > length {
            return Ok(None);
        }
        let mut payload = vec![0; payload_bytes as usize];
        read(offset + FRAME_BYTES, &mut payload)?;
        match (storage::checksum(&payload) == u32::from_le_bytes(checksum), next == length) {
            (true, _) => Ok(Some((payload, next))),
            (false, true) => Ok(None),
            (false, false) => Err(self.damaged(offset)),
        }
    }

    /// A file system may lengthen a file before it writes the bytes: a tail of zeros is torn, too.
    fn is_zero(&self, from: u64, length: u64) -> Result<bool, StorageError> {
        let mut chunk = [0; 4096];
        let mut offset = from;
        while offset < length {
            let part = &mut chunk[..(length - offset).min(4096) as usize];
            self.file.read_at(offset, part).map_err(StorageError::io("read", &self.path))?;
            if part.iter().any(|&byte| byte != 0) {
                return Ok(false);
            }
            offset += part.len() as u64;
        }
        Ok(true)
    }

    fn damaged(&self, offset: u64) -> StorageError {
        let reason = format!("bad record at byte {offset}");
        StorageError::Damaged { path: self.path.clone(), reason }
    }
}
