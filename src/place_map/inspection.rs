//! The records of one segment, whatever its version, looked at one by one: what each says, or what is wrong with it.

use std::path::Path;
use std::sync::Arc;

use super::contents::{Contents, Location};
use super::format::{
    self, EXPERIENCE, ExperienceRecord, FEATURES, FeaturesRecord, KIND, PLACE, THINNED, THUMBNAIL,
};
use super::journal::segment_identity;
use super::replay::{apply, apply_version_1};
use super::version_1;
use crate::feature::Features;
use crate::storage::{AppendFile, Envelope, RecordLog, StorageError, Surveyed, log_kind};

/// What stands at one place of a segment.
pub(super) struct Inspected<'a> {
    pub(super) offset: u64,
    pub(super) length_bytes: u64,
    pub(super) found: Result<Said<'a>, Flaw<'a>>,
}

/// A record whose checksum is right.
pub(super) enum Said<'a> {
    Now(Envelope, &'a [u8]),
    Version1(&'a [u8]),
}

/// What is wrong.
pub(super) enum Flaw<'a> {
    /// The record is sound, what it needs is not.
    Doubtful {
        said: Said<'a>,
        reason: String,
    },
    /// There is no sound record; what it was, if at least that can be told.
    Bad {
        envelope: Option<Envelope>,
        reason: String,
    },
    TornTail,
}

impl Said<'_> {
    /// Adds what it says to `contents`.
    pub(super) fn apply(
        &self,
        contents: &mut Contents,
        location: Location,
        length_bytes: u64,
    ) -> Result<(), String> {
        match *self {
            Self::Now(envelope, payload) => apply(contents, location, (envelope, payload), length_bytes),
            Self::Version1(payload) => {
                apply_version_1(contents, location, length_bytes, version_1::Record::decode(payload)?)
            }
        }
    }

    /// What it is, for people.
    pub(super) fn name(&self) -> &'static str {
        match *self {
            Self::Now(envelope, _) => name_of(Some(envelope)),
            Self::Version1(_) => "record of version 1",
        }
    }
}

fn name_of(envelope: Option<Envelope>) -> &'static str {
    match envelope {
        Some(PLACE) => "record of a place",
        Some(EXPERIENCE) => "record of an experience",
        Some(FEATURES) => "features of a keyframe",
        Some(THUMBNAIL) => "thumbnail of an experience",
        Some(THINNED) => "record of experiences given up",
        _ => "record of an unknown kind",
    }
}

/// Hands everything that stands in the segment `number`, which is `file`, to `visit`. What is bad in its first
/// `durable_bytes` is no torn tail.
///
/// # Errors
/// If it is no segment of a version that can be read, or the medium fails.
pub(super) fn inspect(
    (number, file, path): (u32, &Arc<dyn AppendFile>, &Path),
    durable_bytes: u64,
    visit: &mut dyn FnMut(Inspected<'_>),
) -> Result<(), StorageError> {
    if log_kind(file.as_ref(), path)? == (KIND.magic, version_1::VERSION) {
        return inspect_version_1(file, path, visit);
    }
    let mut parts = Parts::default();
    RecordLog::survey(file.clone(), segment_identity(number, path), durable_bytes, &mut |surveyed| {
        let (offset, length_bytes, found) = match surveyed {
            Surveyed::Whole(record) => {
                let (envelope, payload) = (record.envelope, record.payload.unwrap_or_default());
                let said = Said::Now(envelope, payload);
                let found = match parts.check(record.offset, envelope, payload) {
                    Ok(()) => Ok(said),
                    Err(reason) => {
                        let reason = format!("{}: {reason}", said.name());
                        Err(Flaw::Doubtful { said, reason })
                    }
                };
                (record.offset, record.length_bytes, found)
            }
            Surveyed::Bad { offset, envelope, length_bytes } => {
                parts.note(offset, envelope);
                let reason = match envelope {
                    Some(_) => format!("{}: its checksum is wrong", name_of(envelope)),
                    None => format!("no whole record in {length_bytes} bytes from here on"),
                };
                (offset, length_bytes, Err(Flaw::Bad { envelope, reason }))
            }
            Surveyed::Torn { offset, length_bytes } => (offset, length_bytes, Err(Flaw::TornTail)),
        };
        visit(Inspected { offset, length_bytes, found });
    })
}

fn inspect_version_1(
    file: &Arc<dyn AppendFile>,
    path: &Path,
    visit: &mut dyn FnMut(Inspected<'_>),
) -> Result<(), StorageError> {
    let mut seen = |offset, length_bytes, payload: Option<&[u8]>| {
        let found = payload.map(Said::Version1);
        let reason = || format!("no whole record in {length_bytes} bytes from here on");
        let bad = || Flaw::Bad { envelope: None, reason: reason() };
        visit(Inspected { offset, length_bytes, found: found.ok_or_else(bad) });
    };
    let torn = version_1::Journal::survey(file.clone(), path, &mut seen)?;
    if let Some((offset, length_bytes)) = torn {
        visit(Inspected { offset, length_bytes, found: Err(Flaw::TornTail) });
    }
    Ok(())
}

/// The latest records that an experience may point back to: its features and its thumbnail stand right before it.
#[derive(Default)]
struct Parts([Option<(u64, Option<Envelope>)>; 2]);

impl Parts {
    /// A record whose kind may be unknown.
    fn note(&mut self, offset: u64, envelope: Option<Envelope>) {
        self.0 = [self.0[1], Some((offset, envelope))];
    }

    /// Whether a record, and for an experience its way back to its parts, is sound beyond what replaying needs.
    fn check(&mut self, offset: u64, envelope: Envelope, payload: &[u8]) -> Result<(), String> {
        match envelope {
            FEATURES => {
                self.note(offset, Some(FEATURES));
                FeaturesRecord::unpack(payload, &mut Features::default())
            }
            THUMBNAIL => {
                self.note(offset, Some(THUMBNAIL));
                Ok(())
            }
            EXPERIENCE => {
                let record: ExperienceRecord = format::decode(payload)?;
                if let Some(keyframe) = record.keyframe {
                    self.check_way(offset, keyframe.features_back_bytes, FEATURES)?;
                    keyframe.unpacked()?;
                }
                match record.thumbnail_back_bytes {
                    0 => Ok(()),
                    back_bytes => self.check_way(offset, back_bytes, THUMBNAIL),
                }
            }
            _ => Ok(()),
        }
    }

    fn check_way(&self, offset: u64, back_bytes: u32, expected: Envelope) -> Result<(), String> {
        let part = offset.checked_sub(u64::from(back_bytes));
        let is_there =
            self.0.iter().flatten().any(|&(at, envelope)| {
                Some(at) == part && envelope.is_none_or(|envelope| envelope == expected)
            });
        if is_there { Ok(()) } else { Err(format!("no {} where it points to", name_of(Some(expected)))) }
    }
}
