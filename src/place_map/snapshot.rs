//! The snapshot: what a map knew at one point of its journal, so that opening need not read the journal from its
//! beginning.
//!
//! It only saves time: where it is missing or damaged, the journal alone gives the same map. The file is a header
//! (see [`crate::storage`]) and then, packed by bincode one after the other, what the map is in short, its places
//! and its experiences.

use std::io;

use bincode::{Decode, Encode};

use super::contents::{Contents, Location};
use super::format::{self, PlaceRecord};
use super::journal::Position;
use super::{Experience, ExperienceId, PlaceId};
use crate::storage::{self, FileKind, Folder, StorageError};

pub(super) const NAME: &str = "snapshot.loci";
const KIND: FileKind = FileKind { magic: *b"LOCISNP\0", version: 1, name: "map snapshot" };

/// Longest snapshot in bytes.
const MAX_BYTES: u64 = 1 << 30;

/// What a snapshot says.
#[derive(Default)]
pub(super) struct Snapshot {
    /// The point of the journal that the contents stand for.
    pub(super) position: Position,
    pub(super) contents: Contents,
    pub(super) length_bytes: u64,
}

#[derive(Encode, Decode)]
struct Summary {
    /// The journal's position that it stands for.
    segment: u32,
    offset: u64,
    next_experience: u32,
    places: u32,
    experiences: u32,
}

#[derive(Encode, Decode)]
struct PlaceState {
    record: PlaceRecord,
    location: u64,
    record_bytes: u32,
}

#[derive(Encode, Decode)]
struct ExperienceState {
    id: u32,
    learnt_as: u32,
    location: u64,
    record_bytes: u32,
    view: u64,
    mean_luminance: Option<f32>,
    is_keyframe: bool,
}

/// Writes what the map knows at `position` of its journal, all of which must be on the medium; answers the
/// snapshot's length in bytes.
pub(super) fn write(
    folder: &dyn Folder,
    position: Position,
    contents: &Contents,
) -> Result<u64, StorageError> {
    let path = folder.path().join(NAME);
    let error = StorageError::io("write", &path);
    let body = match packed(position, contents) {
        Ok(body) => body,
        Err(reason) => return Err(error(io::Error::other(reason))),
    };
    storage::replace(folder, NAME, &[&KIND.header(&body), &body]).map_err(error)?;
    Ok(body.len() as u64)
}

/// The snapshot in `folder`; `None` if there is none.
///
/// # Errors
/// If it is newer than this program, damaged, or cannot be read.
pub(super) fn read(folder: &dyn Folder) -> Result<Option<Snapshot>, StorageError> {
    let path = folder.path().join(NAME);
    let file = match folder.open(NAME, false) {
        Ok(file) => file,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(StorageError::io("open", &path)(error)),
    };
    let length = file.length_bytes().map_err(StorageError::io("read", &path))?;
    if length > MAX_BYTES {
        let reason = format!("{length} bytes are too many");
        return Err(StorageError::Damaged { path, reason });
    }
    let mut bytes = vec![0; length as usize];
    file.read_at(0, &mut bytes).map_err(StorageError::io("read", &path))?;
    KIND.verify(&bytes, &path)?;
    let (_, body) = KIND.body(&bytes, &path)?;
    match unpacked(body) {
        Ok((position, contents)) => Ok(Some(Snapshot { position, contents, length_bytes: length })),
        Err(reason) => Err(StorageError::Damaged { path, reason }),
    }
}

/// The same for the same contents at the same position.
pub(super) fn packed(position: Position, contents: &Contents) -> Result<Vec<u8>, String> {
    let mut body = format::encode(&Summary {
        segment: position.segment,
        offset: position.offset,
        next_experience: contents.next_experience,
        places: contents.places.len() as u32,
        experiences: contents.experiences.len() as u32,
    })?;
    for place in contents.places.values() {
        body.extend(format::encode(&PlaceState {
            record: place.record(),
            location: place.location.to_bits(),
            record_bytes: place.record_bytes,
        })?);
    }
    for experience in contents.experiences.values() {
        body.extend(format::encode(&ExperienceState {
            id: experience.id.0,
            learnt_as: experience.learnt_as.0,
            location: experience.location.to_bits(),
            record_bytes: experience.record_bytes,
            view: experience.view,
            mean_luminance: experience.mean_luminance,
            is_keyframe: experience.is_keyframe,
        })?);
    }
    Ok(body)
}

fn unpacked(mut body: &[u8]) -> Result<(Position, Contents), String> {
    let summary: Summary = format::take(&mut body)?;
    let mut contents = Contents::default();
    for _ in 0..summary.places {
        let PlaceState { record, location, record_bytes } = format::take(&mut body)?;
        contents.put_place(record, Location::from_bits(location), u64::from(record_bytes));
    }
    for _ in 0..summary.experiences {
        let state: ExperienceState = format::take(&mut body)?;
        contents.put_experience(Experience {
            id: ExperienceId(state.id),
            learnt_as: PlaceId(state.learnt_as),
            location: Location::from_bits(state.location),
            record_bytes: state.record_bytes,
            view: state.view,
            mean_luminance: state.mean_luminance,
            is_keyframe: state.is_keyframe,
        });
    }
    if !body.is_empty() {
        return Err(format!("{} bytes too many", body.len()));
    }
    contents.next_experience = contents.next_experience.max(summary.next_experience);
    Ok((Position { segment: summary.segment, offset: summary.offset }, contents))
}
