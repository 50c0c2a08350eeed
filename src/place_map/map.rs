//! The map itself: opened from its journal, grown record by record.

use std::fs;
use std::path::{Path, PathBuf};

use super::format::{ExperienceRecord, JOURNAL_NAME, KIND, PackedKeypoint, Record};
use super::{Appearance, Experience, ExperienceId, Keyframe, MapError, Place, PlaceId};
use crate::cnn;
use crate::feature::Features;
use crate::frame::{Frame, Pose};
use crate::storage::{FileLog, LogStore, MemoryLog, RecordLog, Recovery, StorageError, WriterLock};

/// Records after which the journal is synced to the medium: what a power cut may lose at most.
const SYNC_EVERY_RECORDS: u32 = 16;

/// An experience to be added to a place.
#[derive(Clone, Copy)]
pub struct NewExperience<'a> {
    /// The frame it comes from.
    pub frame: &'a Frame,
    /// Its ORB features.
    pub features: &'a Features,
    /// Its CNN descriptor, if a CNN is running.
    pub appearance: Option<&'a Appearance>,
    /// Mean luminance of the frame, 0 to 255.
    pub mean_luminance: f32,
    /// A small JPEG for retraining and for people.
    pub thumbnail_jpeg: &'a [u8],
    /// Whether the place is to be recognised by it.
    pub is_keyframe: bool,
}

/// What is in a map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapSummary {
    /// Number of places.
    pub places: usize,
    /// Number of places with a name.
    pub named_places: usize,
    /// Number of experiences.
    pub experiences: usize,
    /// Number of those by which places are recognised.
    pub keyframes: usize,
    /// Length of the journal in bytes.
    pub journal_bytes: u64,
    /// Bytes of a torn last record that opening found.
    pub torn_bytes: u64,
    /// Hashes of the models whose descriptors it holds, sorted.
    pub models: Vec<String>,
}

/// A growing map.
pub struct PlaceMap {
    contents: Contents,
    journal: RecordLog,
    unsynced_records: u32,
    recovery: Recovery,
    /// Kept for as long as the map may be written.
    _lock: Option<WriterLock>,
}

impl PlaceMap {
    /// A map in memory, gone with the process.
    ///
    /// # Errors
    /// Never in practice: memory takes every record.
    pub fn in_memory() -> Result<Self, MapError> {
        Self::replay(Box::new(MemoryLog::default()), Path::new("map in memory"), None, true)
    }

    /// Opens the map in `folder` for writing, or makes one. A torn last record is cut off.
    ///
    /// # Errors
    /// If the folder cannot be written, another process writes it, or the journal is damaged.
    pub fn open(folder: &Path) -> Result<Self, MapError> {
        fs::create_dir_all(folder).map_err(StorageError::io("create map folder", folder))?;
        let lock = WriterLock::acquire(folder)?;
        let path = folder.join(JOURNAL_NAME);
        let store = FileLog::open(&path, true)?;
        Self::replay(Box::new(store), &path, Some(lock), true)
    }

    /// Opens the map in `folder` for reading; other processes may read and one may write it.
    ///
    /// # Errors
    /// If there is no map or the journal is damaged.
    pub fn open_read_only(folder: &Path) -> Result<Self, MapError> {
        let path: PathBuf = folder.join(JOURNAL_NAME);
        if !path.exists() {
            return Err(MapError::Missing { path: folder.to_owned() });
        }
        let store = FileLog::open(&path, false)?;
        Self::replay(Box::new(store), &path, None, false)
    }

    fn replay(
        store: Box<dyn LogStore>,
        path: &Path,
        lock: Option<WriterLock>,
        writable: bool,
    ) -> Result<Self, MapError> {
        let mut contents = Contents::default();
        let (journal, recovery) = RecordLog::open(store, &KIND, path, writable, |offset, payload| {
            Record::decode(payload).and_then(|record| contents.apply(record, offset)).map_err(|reason| {
                let reason = format!("record at byte {offset}: {reason}");
                StorageError::Damaged { path: path.to_owned(), reason }
            })
        })?;
        Ok(Self { contents, journal, unsynced_records: 0, recovery, _lock: lock })
    }

    /// Founds a place.
    ///
    /// # Errors
    /// If the journal cannot be written.
    pub fn found_place(&mut self) -> Result<PlaceId, MapError> {
        self.write(Record::Founded)?;
        Ok(PlaceId(self.contents.places.len() as u32 - 1))
    }

    /// Adds an experience to `place`.
    ///
    /// # Errors
    /// If there is no such place, the frame cannot be stored or the journal not be written.
    pub fn add_experience(
        &mut self,
        place: PlaceId,
        new: &NewExperience<'_>,
    ) -> Result<ExperienceId, MapError> {
        let record = ExperienceRecord {
            place: place.0,
            is_keyframe: new.is_keyframe,
            frame_index: new.frame.index,
            frame_name: new.frame.name.clone(),
            capture_nanos: new.frame.capture_nanos,
            pose: new.frame.pose.map(pack_pose),
            width_px: new.features.width_px,
            height_px: new.features.height_px,
            keypoints: new.features.keypoints.iter().map(PackedKeypoint::from).collect(),
            descriptors: new.features.descriptors.iter().map(|descriptor| descriptor.0).collect(),
            appearance: new.appearance.map(|a| (a.model.clone(), a.descriptor.as_slice().to_vec())),
            thumbnail_jpeg: new.thumbnail_jpeg.to_vec(),
        };
        self.write(Record::ExperiencedInLight(new.mean_luminance, Box::new(record)))?;
        Ok(ExperienceId(self.contents.experiences.len() as u32 - 1))
    }

    /// Gives `place` a name, or another one.
    ///
    /// # Errors
    /// If there is no such place or the journal cannot be written.
    pub fn name_place(&mut self, place: PlaceId, name: &str) -> Result<(), MapError> {
        self.write(Record::Named { place: place.0, name: name.to_owned() })
    }

    /// Returns when everything added so far would survive a power cut.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn sync(&mut self) -> Result<(), MapError> {
        self.unsynced_records = 0;
        Ok(self.journal.sync()?)
    }

    /// All places, oldest first; `places()[id.0]` is the place `id`.
    #[must_use]
    pub fn places(&self) -> &[Place] {
        &self.contents.places
    }

    /// All experiences, oldest first.
    #[must_use]
    pub fn experiences(&self) -> &[Experience] {
        &self.contents.experiences
    }

    /// The place numbered `id`.
    #[must_use]
    pub fn place(&self, id: PlaceId) -> Option<&Place> {
        self.contents.places.get(id.0 as usize)
    }

    /// The experience numbered `id`.
    #[must_use]
    pub fn experience(&self, id: ExperienceId) -> Option<&Experience> {
        self.contents.experiences.get(id.0 as usize)
    }

    /// The thumbnail of an experience, read from the journal: the bytes of a JPEG.
    ///
    /// # Errors
    /// If there is no such experience or its record cannot be read.
    pub fn thumbnail_jpeg(&self, id: ExperienceId) -> Result<Vec<u8>, MapError> {
        let unreadable = |reason: String| MapError::Unreadable { experience: id.0, reason };
        let experience = self.experience(id).ok_or_else(|| unreadable("it is not in the map".to_owned()))?;
        match Record::decode(&self.journal.read(experience.record_offset)?) {
            Ok(Record::Experienced(record) | Record::ExperiencedInLight(_, record)) => {
                Ok(record.thumbnail_jpeg)
            }
            Ok(_) => Err(unreadable("its record is another one".to_owned())),
            Err(reason) => Err(unreadable(reason)),
        }
    }

    /// What is in the map.
    #[must_use]
    pub fn summary(&self) -> MapSummary {
        let keyframes = || self.experiences().iter().filter_map(|experience| experience.keyframe.as_ref());
        let mut models: Vec<String> =
            keyframes().filter_map(|k| k.appearance.as_ref()).map(|a| a.model.clone()).collect();
        models.sort_unstable();
        models.dedup();
        MapSummary {
            places: self.places().len(),
            named_places: self.places().iter().filter(|place| place.name.is_some()).count(),
            experiences: self.experiences().len(),
            keyframes: keyframes().count(),
            journal_bytes: self.journal.length_bytes(),
            torn_bytes: self.recovery.torn_bytes,
            models,
        }
    }

    fn write(&mut self, record: Record) -> Result<(), MapError> {
        let unstorable = |reason| MapError::Unstorable { reason };
        self.contents.check(&record).map_err(unstorable)?;
        let offset = self.journal.append(&record.encode().map_err(unstorable)?)?;
        self.contents.apply(record, offset).map_err(unstorable)?;
        self.unsynced_records += 1;
        if self.unsynced_records >= SYNC_EVERY_RECORDS {
            self.sync()?;
        }
        Ok(())
    }
}

/// What replaying the journal gives.
#[derive(Default)]
struct Contents {
    places: Vec<Place>,
    experiences: Vec<Experience>,
}

impl Contents {
    /// Whether `record` fits the map so far.
    fn check(&self, record: &Record) -> Result<(), String> {
        let place = match record {
            Record::Founded => return Ok(()),
            Record::Named { place, .. } => *place,
            Record::Experienced(record) | Record::ExperiencedInLight(_, record) => record.place,
        };
        if (place as usize) < self.places.len() { Ok(()) } else { Err(format!("there is no place {place}")) }
    }

    fn apply(&mut self, record: Record, offset: u64) -> Result<(), String> {
        self.check(&record)?;
        match record {
            Record::Founded => {
                let id = PlaceId(self.places.len() as u32);
                self.places.push(Place { id, name: None, experiences: Vec::new() });
            }
            Record::Named { place, name } => self.places[place as usize].name = Some(name),
            Record::Experienced(record) => self.apply_experience(*record, None, offset)?,
            Record::ExperiencedInLight(mean_luminance, record) => {
                self.apply_experience(*record, Some(mean_luminance), offset)?;
            }
        }
        Ok(())
    }

    fn apply_experience(
        &mut self,
        record: ExperienceRecord,
        mean_luminance: Option<f32>,
        offset: u64,
    ) -> Result<(), String> {
        let id = ExperienceId(self.experiences.len() as u32);
        let features = record.features().ok_or("its features do not fit together")?;
        let appearance = record.appearance.map(unpack_appearance).transpose()?;
        self.places[record.place as usize].experiences.push(id);
        self.experiences.push(Experience {
            id,
            place: PlaceId(record.place),
            frame_index: record.frame_index,
            frame_name: record.frame_name,
            capture_nanos: record.capture_nanos,
            pose: record.pose.map(unpack_pose),
            mean_luminance,
            keyframe: record.is_keyframe.then_some(Keyframe { features, appearance }),
            record_offset: offset,
        });
        Ok(())
    }
}

fn unpack_appearance((model, values): (String, Vec<f32>)) -> Result<Appearance, String> {
    let descriptor = cnn::Descriptor::from_values(values).ok_or("its CNN descriptor has no direction")?;
    Ok(Appearance { model, descriptor })
}

fn pack_pose(pose: Pose) -> [f64; 7] {
    let ([x, y, z], [qx, qy, qz, qw]) = (pose.position_metres, pose.orientation);
    [x, y, z, qx, qy, qz, qw]
}

fn unpack_pose([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Pose {
    Pose { position_metres: [x, y, z], orientation: [qx, qy, qz, qw] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::{Descriptor, Keypoint};
    use crate::geometry::Point;
    use crate::raster::{GreyImage, RgbImage};

    fn frame(index: u64) -> Frame {
        Frame {
            index,
            capture_nanos: index as i64 * 1_000,
            name: format!("{index:03}.jpg"),
            colour: RgbImage::new(4, 4),
            grey: GreyImage::new(4, 4),
            jpeg: None,
            pose: Some(Pose { position_metres: [1.0, 2.0, index as f64], orientation: [0.0, 0.0, 0.0, 1.0] }),
            true_place: None,
        }
    }

    fn features() -> Features {
        let keypoint =
            Keypoint { point: Point { x: 3.5, y: 2.25 }, scale: 1.2, angle_radians: 0.5, response: 40 };
        Features {
            width_px: 4,
            height_px: 4,
            keypoints: vec![keypoint],
            descriptors: vec![Descriptor([7; 32])],
        }
    }

    fn add(map: &mut PlaceMap, place: PlaceId, index: u64, is_keyframe: bool) -> ExperienceId {
        let appearance = Appearance {
            model: "abc".to_owned(),
            descriptor: cnn::Descriptor::from_values(vec![0.6, 0.8]).unwrap(),
        };
        let new = NewExperience {
            frame: &frame(index),
            features: &features(),
            appearance: Some(&appearance),
            mean_luminance: 80.0,
            thumbnail_jpeg: &[index as u8; 9],
            is_keyframe,
        };
        map.add_experience(place, &new).unwrap()
    }

    #[test]
    fn a_map_reopened_is_the_map_that_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let mut map = PlaceMap::open(folder.path()).unwrap();
        let (dock, hall) = (map.found_place().unwrap(), map.found_place().unwrap());
        add(&mut map, dock, 0, true);
        add(&mut map, hall, 1, true);
        let last = add(&mut map, dock, 2, false);
        map.name_place(dock, "dock 3").unwrap();
        let (places, experiences, summary) =
            (map.places().to_vec(), map.experiences().to_vec(), map.summary());
        drop(map);
        let reopened = PlaceMap::open_read_only(folder.path()).unwrap();
        assert_eq!(reopened.places(), places);
        assert_eq!(reopened.experiences(), experiences);
        assert_eq!(reopened.summary(), summary);
        assert_eq!((summary.places, summary.experiences, summary.keyframes), (2, 3, 2));
        assert_eq!(reopened.place(dock).unwrap().name.as_deref(), Some("dock 3"));
        assert_eq!(reopened.thumbnail_jpeg(last).unwrap(), [2; 9]);
    }

    #[test]
    fn a_torn_last_record_costs_that_record_alone() {
        let folder = tempfile::tempdir().unwrap();
        let mut map = PlaceMap::open(folder.path()).unwrap();
        let place = map.found_place().unwrap();
        add(&mut map, place, 0, true);
        add(&mut map, place, 1, true);
        drop(map);
        let path = folder.path().join(JOURNAL_NAME);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() - 3]).unwrap();
        let mut map = PlaceMap::open(folder.path()).unwrap();
        assert_eq!(map.experiences().len(), 1);
        assert!(map.summary().torn_bytes > 0);
        add(&mut map, place, 2, true);
        drop(map);
        assert_eq!(PlaceMap::open(folder.path()).unwrap().experiences().len(), 2);
    }

    #[test]
    fn crash_during_append_keeps_earlier_places() {
        let folder = tempfile::tempdir().unwrap();
        let mut map = PlaceMap::open(folder.path()).unwrap();
        map.found_place().unwrap();
        map.found_place().unwrap();
        drop(map);
        let path = folder.path().join(JOURNAL_NAME);
        let mut bytes = fs::read(&path).unwrap();
        bytes.extend([200, 0, 0, 0, 1, 2]);
        fs::write(&path, bytes).unwrap();
        assert_eq!(PlaceMap::open(folder.path()).unwrap().places().len(), 2);
    }

    #[test]
    fn an_experience_from_before_light_was_noted_is_read() {
        let mut map = PlaceMap::in_memory().unwrap();
        let place = map.found_place().unwrap();
        add(&mut map, place, 0, true);
        let offset = map.experiences()[0].record_offset;
        let Ok(Record::ExperiencedInLight(_, record)) = Record::decode(&map.journal.read(offset).unwrap())
        else {
            panic!("another record");
        };
        map.write(Record::Experienced(record)).unwrap();
        let lights: Vec<Option<f32>> = map.experiences().iter().map(|e| e.mean_luminance).collect();
        assert_eq!(lights, [Some(80.0), None]);
        assert_eq!(map.thumbnail_jpeg(ExperienceId(1)).unwrap(), [0; 9]);
    }

    #[test]
    fn a_missing_map_is_named_with_the_command_that_makes_one() {
        let folder = tempfile::tempdir().unwrap();
        let error = PlaceMap::open_read_only(folder.path()).err().unwrap().to_string();
        assert!(
            error.contains(&folder.path().display().to_string()) && error.contains("loci run"),
            "{error}"
        );
    }

    #[test]
    fn an_experience_of_an_unknown_place_is_refused() {
        let mut map = PlaceMap::in_memory().unwrap();
        let new = NewExperience {
            frame: &frame(0),
            features: &features(),
            appearance: None,
            mean_luminance: 80.0,
            thumbnail_jpeg: &[],
            is_keyframe: true,
        };
        let error = map.add_experience(PlaceId(3), &new).unwrap_err().to_string();
        assert_eq!(error, "an experience cannot be stored: there is no place 3");
    }
}
