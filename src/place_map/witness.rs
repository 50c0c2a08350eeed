//! Whether a snapshot is of the journal beside it: whoever copies maps about may bring together what was never one.
//!
//! The segment in which it was taken says so, read anew up to there: it must be what the snapshot says. Where damage
//! hides that, the latest experience which the snapshot knows, and of which the journal can tell, does instead.

use std::collections::BTreeMap;

use super::Experience;
use super::contents::{Contents, Location};
use super::format::{self, FEATURES, THINNED, THUMBNAIL, ThinnedRecord};
use super::journal::{Journal, Position, Segment, segment_name};
use super::replay::apply;
use super::snapshot::{self, Snapshot};
use super::{ExperienceId, PlaceId};
use crate::storage::{Footing, LOG_HEADER_BYTES, LoggedRecord, Reading, RecordLog, StorageError};

/// Experiences that are asked, one after the other, until the record of one can be read.
const MOST_WITNESSES: usize = 8;

/// What the journal says of a snapshot.
enum Testimony {
    /// The same; and perhaps a byte of the snapshot's segment, before its position, where a record begins.
    Same { boundary: Option<u64> },
    /// Something else: what, for people.
    Other(String),
}

/// What a part of a segment says.
#[derive(Default)]
struct Retold {
    contents: Contents,
    given_up: Vec<ExperienceId>,
}

impl Journal {
    /// Why `snapshot` cannot be of this journal, if it cannot.
    ///
    /// # Errors
    /// If it is, and the journal has lost or damaged what the snapshot stands for; or the medium fails.
    pub(super) fn disowns(&self, snapshot: &Snapshot) -> Result<Option<String>, StorageError> {
        let Position { segment, offset } = snapshot.position;
        if segment < self.oldest_number() {
            return Ok(Some(format!("it is older than {}", segment_name(self.oldest_number()))));
        }
        if snapshot.contents.locations().any(|location| location >= Location::new(segment, offset)) {
            return Ok(Some("it speaks of what was not yet written when it was taken".to_owned()));
        }
        let testimony = match self.retelling(snapshot)? {
            Some(testimony) => testimony,
            None => self.witness_of(snapshot)?,
        };
        let boundary = match testimony {
            Testimony::Other(reason) => return Ok(Some(reason)),
            Testimony::Same { boundary } => boundary,
        };
        if let Some(reason) = self.contradiction(snapshot)? {
            return Ok(Some(reason));
        }
        let ahead = |reason| StorageError::Ahead { path: self.folder.path().join(snapshot::NAME), reason };
        let name = segment_name(segment);
        let length = match self.segments.get(&segment) {
            None => return Err(ahead(format!("{name} is missing"))),
            Some(Segment::Version1(_)) => {
                return Ok(Some(format!("it was taken in {name}, of which none is taken")));
            }
            Some(Segment::Log(log)) => log.length_bytes(),
        };
        if offset > length {
            return Err(ahead(format!(
                "{name} ends after {length} bytes, but had {offset} when it was taken"
            )));
        }
        match self.footing(Location::new(segment, offset), boundary.unwrap_or(0))? {
            Footing::Boundary => Ok(None),
            // What is damaged there the snapshot knows.
            Footing::Hidden { .. } if boundary.is_some() => Ok(None),
            Footing::Within => {
                Ok(Some(format!("it was taken at byte {offset} of {name}, where no record begins")))
            }
            Footing::Hidden { by } => {
                let reason = format!("bad record at byte {by}");
                Err(StorageError::Damaged { path: self.path_of(segment), reason })
            }
        }
    }

    /// What the segment says in which `snapshot` was taken, or the one before if nothing is in that one yet; `None` if
    /// that cannot be told, since the segment is gone, damaged or of version 1, no record ends there, or it lost all
    /// that the snapshot speaks of.
    fn retelling(&self, snapshot: &Snapshot) -> Result<Option<Testimony>, StorageError> {
        let Position { segment, offset } = snapshot.position;
        let (number, until) =
            if offset > LOG_HEADER_BYTES { (segment, offset) } else { (segment.saturating_sub(1), u64::MAX) };
        let Some(Segment::Log(log)) = self.segments.get(&number) else { return Ok(None) };
        let end = Location::new(number, log.length_bytes());
        let retold = match Retold::read(log, number, until.min(end.offset())) {
            Err(StorageError::Damaged { .. }) => return Ok(None),
            retold => retold?,
        };
        if number == segment && until > end.offset() {
            return Ok(match retold.agreement(&snapshot.contents, end) {
                Err(reason) => Some(Testimony::Other(reason)),
                Ok(true) => Some(Testimony::Same { boundary: None }),
                Ok(false) => None,
            });
        }
        let boundary = (number == segment).then_some(offset);
        let testimony = retold.difference(&snapshot.contents, number).map(Testimony::Other);
        Ok(Some(testimony.unwrap_or(Testimony::Same { boundary })))
    }

    /// What a segment says otherwise of its first experience in `snapshot`: files without numbers may have changed
    /// names.
    fn contradiction(&self, snapshot: &Snapshot) -> Result<Option<String>, StorageError> {
        let mut firsts: BTreeMap<u32, &Experience> = BTreeMap::new();
        for experience in snapshot.contents.experiences.values() {
            let first = firsts.entry(experience.location.segment()).or_insert(experience);
            if experience.location < first.location {
                *first = experience;
            }
        }
        for first in firsts.into_values() {
            if self.bears_out(first)? == Some(false) {
                return Ok(Some(says_otherwise(first)));
            }
        }
        Ok(None)
    }

    /// What the record says of the latest experience of `snapshot` that would lie within the journal, or of one of
    /// those before it if that cannot be told.
    fn witness_of(&self, snapshot: &Snapshot) -> Result<Testimony, StorageError> {
        let Position { segment, offset } = self.end();
        let end = Location::new(segment, offset);
        let experiences = snapshot.contents.experiences.values();
        let mut witnesses: Vec<_> = experiences.filter(|experience| experience.location < end).collect();
        witnesses.sort_unstable_by_key(|experience| std::cmp::Reverse(experience.location));
        for witness in witnesses.into_iter().take(MOST_WITNESSES) {
            match self.bears_out(witness)? {
                Some(false) => return Ok(Testimony::Other(says_otherwise(witness))),
                Some(true) => {
                    let is_near = witness.location.segment() == snapshot.position.segment;
                    return Ok(Testimony::Same { boundary: is_near.then(|| witness.location.offset()) });
                }
                None => {}
            }
        }
        Ok(Testimony::Same { boundary: None })
    }

    /// Whether the journal has the record of `witness` where the snapshot says; `None` if that cannot be told, since
    /// the segment is gone, damaged, or of a version that does not number its experiences.
    fn bears_out(&self, witness: &Experience) -> Result<Option<bool>, StorageError> {
        let Some(Segment::Log(_)) = self.segments.get(&witness.location.segment()) else { return Ok(None) };
        match self.experience(witness.location) {
            Ok(record) => {
                let is_same = (record.experience, record.place, record.view)
                    == (witness.id.0, witness.learnt_as.0, witness.view);
                Ok(Some(is_same))
            }
            Err(StorageError::Damaged { .. }) => {
                let footing = self.footing(witness.location, 0)?;
                Ok((footing == Footing::Within).then_some(false))
            }
            Err(error) => Err(error),
        }
    }

    fn footing(&self, location: Location, from: u64) -> Result<Footing, StorageError> {
        match self.segments.get(&location.segment()) {
            Some(Segment::Log(log)) => log.footing(from, location.offset()),
            _ => Err(self.missing(location.segment())),
        }
    }
}

fn says_otherwise(experience: &Experience) -> String {
    format!("it says otherwise of experience {}", experience.id.0)
}

impl Retold {
    /// What the records of the segment `number` say that stand before byte `until`, where one must end.
    fn read(log: &RecordLog, number: u32, until: u64) -> Result<Self, StorageError> {
        let Self { mut contents, mut given_up } = Self::default();
        let mut visit = |record: LoggedRecord<'_>| {
            let LoggedRecord { offset, envelope, payload, length_bytes } = record;
            let Some(payload) = payload else { return Ok(()) };
            if envelope == THINNED {
                let ThinnedRecord { experiences } = format::decode(payload)?;
                given_up.extend(experiences.into_iter().map(ExperienceId));
            }
            apply(&mut contents, Location::new(number, offset), (envelope, payload), length_bytes)
        };
        let wanted = |envelope| envelope != FEATURES && envelope != THUMBNAIL;
        log.reread(until, Reading { from: 0, wanted, visit: &mut visit })?;
        Ok(Self { contents, given_up })
    }

    /// Whether `known`, which knows more than this beginning of a segment up to `end`, says the same of anything that
    /// it speaks of; what it says otherwise, if no record behind `end` can explain that.
    fn agreement(&self, known: &Contents, end: Location) -> Result<bool, String> {
        let mut agrees = false;
        for (id, place) in &self.contents.places {
            match known.places.get(id) {
                Some(known) if (known.location, known.record()) == (place.location, place.record()) => {
                    agrees = true
                }
                Some(known) if known.location >= end => {}
                _ => return Err(format!("it says otherwise of place {}", id.0)),
            }
        }
        for (id, said) in &self.contents.experiences {
            let facts = |e: &Experience| (e.location, e.learnt_as, e.view);
            match known.experiences.get(id) {
                Some(known) if facts(known) == facts(said) => agrees = true,
                Some(known) if known.location >= end => {}
                // It may have been given up since.
                None if id.0 < known.next_experience => {}
                _ => return Err(format!("it says otherwise of experience {}", id.0)),
            }
        }
        match self.given_up.iter().find(|id| known.experiences.contains_key(id)) {
            Some(id) => Err(format!("it says otherwise of experience {}", id.0)),
            None => Ok(agrees),
        }
    }

    /// What `known` says otherwise of what this part of the segment `number` speaks of.
    fn difference(&self, known: &Contents, number: u32) -> Option<String> {
        let place = |contents: &Contents, id: &PlaceId| {
            contents.places.get(id).map(|place| (place.location, place.record()))
        };
        let experience = |contents: &Contents, id: &ExperienceId| {
            contents.experiences.get(id).map(|e| (e.location, e.learnt_as, e.view))
        };
        let said = &self.contents;
        if let Some(id) = said.places.keys().find(|id| place(said, id) != place(known, id)) {
            return Some(format!("it says otherwise of place {}", id.0));
        }
        let mut experiences = said.experiences.keys().chain(&self.given_up);
        if let Some(id) = experiences.find(|id| experience(said, id) != experience(known, id)) {
            return Some(format!("it says otherwise of experience {}", id.0));
        }
        let known_there = known.locations().filter(|location| location.segment() == number).count();
        (known_there != said.locations().count())
            .then(|| format!("it speaks of what is not in {}", segment_name(number)))
    }
}
