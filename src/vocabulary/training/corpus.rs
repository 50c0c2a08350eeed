//! What a vocabulary is trained on: the descriptors of many images, in memory or in a file.
//!
//! The file lets a training be larger than memory and go on where it was cut off. It is a record log
//! ([`crate::storage`]); its first record says which images it is of, and each further one is a frame: the
//! mean luminance (f32) and the descriptors (32 bytes each), or one zero byte for a frame that could not be
//! read.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::feature::Descriptor;
use crate::storage::{
    DiskFile, Envelope, FileKind, LogIdentity, LoggedRecord, Reading, RecordLog, StorageError, Tail,
};
use crate::vocabulary::VocabularyError;

const KIND: FileKind = FileKind { magic: *b"LOCITRN\0", version: 2, name: "training file" };
/// What every record of it is.
const FRAME: Envelope = Envelope { kind: 1, version: 1 };
/// Frames after which the file is synced to the medium: what a power cut may lose at most.
const SYNC_EVERY_FRAMES: usize = 64;
const UNREADABLE: [u8; 1] = [0];
const LUMINANCE_BYTES: usize = 4;

/// Images to train on, too many to be looked at otherwise than one after the other.
pub trait Corpus {
    /// Number of images.
    fn image_count(&self) -> u64;

    /// Number of descriptors of all images.
    fn descriptor_count(&self) -> u64;

    /// Mean luminance of all images, 0 to 255, if it is known.
    fn mean_luminance(&self) -> Option<f32>;

    /// Shows the descriptors of every image, always in the same order, until `visit` breaks off.
    ///
    /// # Errors
    /// If the medium fails.
    fn visit(&self, visit: &mut dyn FnMut(&[Descriptor]) -> ControlFlow<()>) -> Result<(), VocabularyError>;
}

/// Images in memory.
#[derive(Clone, Copy, Debug)]
pub struct MemoryCorpus<'a> {
    /// The descriptors of each.
    pub images: &'a [Vec<Descriptor>],
    /// Their mean luminance, 0 to 255, if it is known.
    pub mean_luminance: Option<f32>,
}

impl<'a> From<&'a [Vec<Descriptor>]> for MemoryCorpus<'a> {
    fn from(images: &'a [Vec<Descriptor>]) -> Self {
        Self { images, mean_luminance: None }
    }
}

impl Corpus for MemoryCorpus<'_> {
    fn image_count(&self) -> u64 {
        self.images.len() as u64
    }

    fn descriptor_count(&self) -> u64 {
        self.images.iter().map(|image| image.len() as u64).sum()
    }

    fn mean_luminance(&self) -> Option<f32> {
        self.mean_luminance
    }

    fn visit(&self, visit: &mut dyn FnMut(&[Descriptor]) -> ControlFlow<()>) -> Result<(), VocabularyError> {
        let _ = self.images.iter().try_for_each(|image| visit(image));
        Ok(())
    }
}

/// What is kept of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct CorpusImage {
    /// Mean luminance, 0 to 255.
    pub mean_luminance: f32,
    /// Descriptors of its features.
    pub descriptors: Vec<Descriptor>,
}

/// Images in a file that grows frame by frame.
pub struct TrainingFile {
    path: PathBuf,
    log: RecordLog,
    /// Offset of the record of every image.
    images: Vec<u64>,
    frames: u64,
    descriptors: u64,
    luminance_sum: f64,
}

impl TrainingFile {
    /// Opens the file at `path`, or makes one, for the images that `of` describes. Frames that it already has
    /// are kept; a torn last one is cut off.
    ///
    /// # Errors
    /// If the file cannot be written, is being written by another process, is damaged, or is of other images.
    pub fn open(path: &Path, of: &str) -> Result<Self, VocabularyError> {
        let file = DiskFile::open(path, true).map_err(StorageError::io("open", path))?.lock(path)?;
        let mut contents = Contents::default();
        let mut visit = |record: LoggedRecord<'_>| {
            contents.add(record.offset, record.payload.unwrap_or_default());
            Ok(())
        };
        let reading = Reading { from: 0, wanted: |_| true, visit: &mut visit };
        let identity = LogIdentity { kind: &KIND, number: 0, path };
        let opened = RecordLog::open(Arc::new(file), identity, Tail::Mended, reading);
        let (log, _) = opened.map_err(|error| match error {
            StorageError::Damaged { path, reason } => VocabularyError::DamagedTraining { path, reason },
            error => error.into(),
        })?;
        let Contents { of: found, images, frames, descriptors, luminance_sum } = contents;
        let mut file = Self { path: path.to_owned(), log, images, frames, descriptors, luminance_sum };
        match found {
            None => {
                file.append(of.as_bytes())?;
            }
            Some(found) if found == of.as_bytes() => {}
            Some(_) => return Err(VocabularyError::OtherImages { path: path.to_owned() }),
        }
        Ok(file)
    }

    /// Frames that it has, those that could not be read included.
    #[must_use]
    pub fn frame_count(&self) -> u64 {
        self.frames
    }

    /// Adds a frame; `None` for one that could not be read.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn push(&mut self, image: Option<&CorpusImage>) -> Result<(), VocabularyError> {
        match image {
            None => {
                self.append(&UNREADABLE)?;
            }
            Some(image) => {
                let mut payload = image.mean_luminance.to_le_bytes().to_vec();
                payload.extend(image.descriptors.iter().flat_map(|descriptor| descriptor.0));
                let offset = self.append(&payload)?;
                self.images.push(offset);
                self.descriptors += image.descriptors.len() as u64;
                self.luminance_sum += f64::from(image.mean_luminance);
            }
        }
        self.frames += 1;
        if self.frames.is_multiple_of(SYNC_EVERY_FRAMES as u64) {
            self.log.sync()?;
        }
        Ok(())
    }

    /// Offset of the new record.
    fn append(&mut self, payload: &[u8]) -> Result<u64, StorageError> {
        Ok(self.log.append(&[(FRAME, payload)])?[0])
    }

    /// Deletes the file: the training is over.
    ///
    /// # Errors
    /// If it cannot be deleted.
    pub fn remove(self) -> Result<(), VocabularyError> {
        Ok(std::fs::remove_file(&self.path).map_err(StorageError::io("delete", &self.path))?)
    }
}

/// What the records of a file come to.
#[derive(Default)]
struct Contents {
    of: Option<Vec<u8>>,
    images: Vec<u64>,
    frames: u64,
    descriptors: u64,
    luminance_sum: f64,
}

impl Contents {
    fn add(&mut self, offset: u64, payload: &[u8]) {
        if self.of.is_none() {
            self.of = Some(payload.to_vec());
            return;
        }
        self.frames += 1;
        if let Some((luminance, descriptors)) = payload.split_first_chunk::<LUMINANCE_BYTES>() {
            self.images.push(offset);
            self.descriptors += descriptors.as_chunks::<32>().0.len() as u64;
            self.luminance_sum += f64::from(f32::from_le_bytes(*luminance));
        }
    }
}

impl Corpus for TrainingFile {
    fn image_count(&self) -> u64 {
        self.images.len() as u64
    }

    fn descriptor_count(&self) -> u64 {
        self.descriptors
    }

    fn mean_luminance(&self) -> Option<f32> {
        (!self.images.is_empty()).then(|| (self.luminance_sum / self.images.len() as f64) as f32)
    }

    fn visit(&self, visit: &mut dyn FnMut(&[Descriptor]) -> ControlFlow<()>) -> Result<(), VocabularyError> {
        for &offset in &self.images {
            let (_, payload) = self.log.read(offset)?;
            let descriptors = payload.get(LUMINANCE_BYTES..).unwrap_or_default().as_chunks().0;
            let descriptors: Vec<Descriptor> = descriptors.iter().copied().map(Descriptor).collect();
            if visit(&descriptors).is_break() {
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(seed: u8, descriptors: u8) -> CorpusImage {
        let descriptors =
            (0..descriptors).map(|index| Descriptor([seed.wrapping_mul(31) ^ index; 32])).collect();
        CorpusImage { mean_luminance: f32::from(seed), descriptors }
    }

    fn visited(file: &TrainingFile) -> Vec<Vec<Descriptor>> {
        let mut images = Vec::new();
        file.visit(&mut |image| {
            images.push(image.to_vec());
            ControlFlow::Continue(())
        })
        .unwrap();
        images
    }

    #[test]
    fn a_training_that_was_cut_off_goes_on_with_the_frames_it_had() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t");
        let mut file = TrainingFile::open(&path, "photos").unwrap();
        file.push(Some(&image(10, 3))).unwrap();
        file.push(None).unwrap();
        file.push(Some(&image(20, 0))).unwrap();
        file.push(Some(&image(60, 5))).unwrap();
        drop(file);
        // The power fails while a frame is written.
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() - 7]).unwrap();
        let mut file = TrainingFile::open(&path, "photos").unwrap();
        assert_eq!((file.frame_count(), file.image_count(), file.descriptor_count()), (3, 2, 3));
        file.push(Some(&image(60, 5))).unwrap();
        assert_eq!(file.mean_luminance(), Some(30.0));
        assert_eq!(visited(&file), [image(10, 3), image(20, 0), image(60, 5)].map(|image| image.descriptors));
    }

    #[test]
    fn a_file_of_other_images_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t");
        drop(TrainingFile::open(&path, "photos").unwrap());
        let error = TrainingFile::open(&path, "videos").err().unwrap().to_string();
        assert!(error.contains("left behind by a training of other images"), "{error}");
    }

    #[test]
    fn a_file_that_is_being_written_or_damaged_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t");
        let mut file = TrainingFile::open(&path, "photos").unwrap();
        file.push(Some(&image(10, 3))).unwrap();
        file.push(Some(&image(10, 3))).unwrap();
        let error = TrainingFile::open(&path, "photos").err().unwrap().to_string();
        assert!(error.contains("another process is writing it"), "{error}");
        drop(file);
        // What was there when the file was opened again is on the medium, and its loss no power cut's.
        TrainingFile::open(&path, "photos").unwrap().push(None).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[50] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let error = TrainingFile::open(&path, "photos").err().unwrap().to_string();
        assert!(error.contains("is damaged: ") && error.contains("; delete it"), "{error}");
    }
}
