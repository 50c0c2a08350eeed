//! The rows of an export, read from the map one by one, so that a map of any size can be exported.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget};
use loci::frame::Pose;
use loci::place_map::{Experience, ExperienceId, MapError, PlaceMap};
use loci::storage::{BESIDE_SUFFIX, DiskFolder, Folder, StorageError};

use super::row::{Row, Value};
use crate::cli::console::progress_bar;

/// What became of the rows.
#[derive(Clone, Copy, Default)]
pub(super) struct Counts {
    pub(super) rows: u64,
    pub(super) thumbnails: u64,
    /// What could not be read, and was reported.
    pub(super) skipped: u64,
}

/// The rows of a map.
pub(super) struct Rows<'a> {
    map: &'a PlaceMap,
    experiences: Box<dyn Iterator<Item = &'a Experience> + 'a>,
    /// Where thumbnails go.
    thumbnails: Option<DiskFolder>,
    stop: Arc<AtomicBool>,
    bar: ProgressBar,
    counts: Counts,
}

impl<'a> Rows<'a> {
    /// The rows of `map`, whose thumbnails go to the folder `thumbnails`, until `stop`.
    pub(super) fn new(
        map: &'a PlaceMap,
        thumbnails: Option<&Path>,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, StorageError> {
        if let Some(folder) = thumbnails {
            fs::create_dir_all(folder).map_err(StorageError::io("create", folder))?;
        }
        let length = map.summary().experiences as u64;
        Ok(Self {
            map,
            experiences: Box::new(map.experiences()),
            thumbnails: thumbnails.map(DiskFolder::new),
            stop,
            bar: progress_bar(Some(length), "experiences", ProgressDrawTarget::stderr()),
            counts: Counts::default(),
        })
    }

    /// The next row. An experience that cannot be read is reported and left out.
    pub(super) fn next(&mut self) -> anyhow::Result<Option<Row>> {
        while let Some(experience) = self.experiences.next() {
            anyhow::ensure!(!self.stop.load(Ordering::Relaxed), "interrupted before everything was exported");
            self.bar.inc(1);
            if let Some(row) = self.row(experience)? {
                self.counts.rows += 1;
                return Ok(Some(row));
            }
        }
        Ok(None)
    }

    /// Brings the names of the thumbnails onto the medium and says what became of the rows.
    pub(super) fn finish(self) -> Result<Counts, StorageError> {
        self.bar.finish_and_clear();
        if let Some(folder) = &self.thumbnails {
            folder.sync().map_err(StorageError::io("sync", folder.path()))?;
        }
        Ok(self.counts)
    }

    fn row(&mut self, experience: &Experience) -> Result<Option<Row>, StorageError> {
        let id = experience.id;
        let Some(origin) = self.or_skip("experience", id, self.map.origin(id)) else { return Ok(None) };
        let traits = self.or_skip("descriptor of experience", id, self.map.traits(id)).unwrap_or_default();
        let features = match experience.is_keyframe {
            true => self
                .or_skip("features of experience", id, self.map.features(id))
                .map(|features| features.len() as u64),
            false => None,
        };
        let place = self.map.place(experience.learnt_as);
        let thumbnail = self.thumbnail(id)?;
        let [x, y, z, qx, qy, qz, qw] = pose_values(origin.pose);
        Ok(Some(Row([
            Value::Count(id.0.into()),
            Value::Count(place.map_or(experience.learnt_as, |place| place.id).0.into()),
            Value::Count(experience.learnt_as.0.into()),
            Value::text(place.and_then(|place| place.name.as_deref()).map(str::to_owned)),
            Value::Flag(experience.is_keyframe),
            Value::Count(origin.frame_index),
            Value::Text(origin.frame_name),
            Value::Signed(origin.capture_nanos),
            x,
            y,
            z,
            qx,
            qy,
            qz,
            qw,
            experience.mean_luminance.map_or(Value::Nothing, Value::Single),
            Value::text(traits.appearance.map(|appearance| appearance.model)),
            features.map_or(Value::Nothing, Value::Count),
            Value::text(thumbnail),
        ])))
    }

    /// Writes the thumbnail of an experience, if they are wanted and it has one; answers the file's name.
    fn thumbnail(&mut self, id: ExperienceId) -> Result<Option<String>, StorageError> {
        if self.thumbnails.is_none() {
            return Ok(None);
        }
        let jpeg = self
            .or_skip("thumbnail of experience", id, self.map.thumbnail_jpeg(id))
            .filter(|jpeg| !jpeg.is_empty());
        let (Some(jpeg), Some(folder)) = (jpeg, &self.thumbnails) else { return Ok(None) };
        let name = format!("{:06}.jpg", id.0);
        let beside = format!("{name}{BESIDE_SUFFIX}");
        let write = || {
            let file = folder.open(&beside, true)?;
            file.truncate(0)?;
            file.append(&jpeg)?;
            folder.rename(&beside, &name)
        };
        write().map_err(StorageError::io("write", &folder.path().join(&name)))?;
        self.counts.thumbnails += 1;
        Ok(Some(name))
    }

    /// What was read; what could not be is reported as `what`, and counted.
    fn or_skip<T>(&mut self, what: &str, id: ExperienceId, read: Result<T, MapError>) -> Option<T> {
        read.map_err(|error| {
            self.counts.skipped += 1;
            self.bar.suspend(|| eprintln!("loci: skipped: {what} {}: {error}", id.0));
        })
        .ok()
    }
}

fn pose_values(pose: Option<Pose>) -> [Value; 7] {
    let Some(Pose { position_metres: [x, y, z], orientation: [qx, qy, qz, qw] }) = pose else {
        return [const { Value::Nothing }; 7];
    };
    [x, y, z, qx, qy, qz, qw].map(Value::Number)
}
