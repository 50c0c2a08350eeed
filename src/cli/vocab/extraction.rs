//! The features of many images, on all cores: what a vocabulary is trained on or weighted by.
//!
//! What was extracted is kept in `OUT.training` until the vocabulary is written, so that the same command
//! goes on where it was cut off.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::iter;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget};
use loci::feature::{OrbExtractor, OrbOptions};
use loci::raster::GreyImage;
use loci::source::{self, SourceError};
use loci::vocabulary::{Corpus, CorpusImage, TrainingFile, VocabularyError};
use rayon::prelude::*;

use super::progress::explained;
use crate::cli::console::{counted, progress_bar};

/// Most frames that are looked at side by side, for each core.
const FRAMES_PER_CORE: usize = 4;
/// Bytes of pixels after which no more frames are looked at side by side: memory must not grow with the cores.
const BATCH_BYTES: usize = 128 << 20;

/// The descriptors of every frame of the sources, those that an earlier run extracted included, until `stop`.
pub(super) fn extract(names: &[String], out: &Path, stop: &AtomicBool) -> anyhow::Result<TrainingFile> {
    let announced = names
        .iter()
        .map(|name| Ok(source::open(name, None)?.frame_count()))
        .collect::<Result<Vec<_>, SourceError>>()?;
    let identities: Vec<String> = names.iter().map(|name| identity(name)).collect();
    let of = format!("Loci {}: {}", env!("CARGO_PKG_VERSION"), identities.join("; "));
    let path = training_path(out);
    let mut corpus = TrainingFile::open(&path, &of)?;
    let known = corpus.frame_count();
    if known > 0 {
        eprintln!("loci: going on with the {} in {}", counted(known, "frame"), path.display());
    }
    let progress = progress_bar(announced.into_iter().sum(), "frames", ProgressDrawTarget::stderr());
    let mut pictures = names.iter().flat_map(|name| pictures(name)).inspect(|_| progress.inc(1));
    (0..known).take_while(|_| !stop.load(Ordering::Relaxed)).for_each(|_| drop(pictures.next()));
    Extraction { progress: &progress, stop }.run(pictures, &mut corpus)?;
    progress.finish_and_clear();
    if stop.load(Ordering::Relaxed) {
        return Err(explained(VocabularyError::Interrupted, &corpus, out));
    }
    if corpus.descriptor_count() == 0 {
        corpus.remove()?;
        return Err(VocabularyError::NothingToLearn.into());
    }
    Ok(corpus)
}

/// Where the training of the vocabulary at `out` is kept until that is written.
pub(super) fn training_path(out: &Path) -> PathBuf {
    let mut path = out.as_os_str().to_owned();
    path.push(".training");
    path.into()
}

/// What a source is known by, name, length and time of change of its files included: other images under the
/// same name must not be taken for those that an earlier run extracted.
fn identity(name: &str) -> String {
    let Ok(path) = Path::new(name).canonicalize() else { return name.to_owned() };
    let mut hasher = DefaultHasher::new();
    for file in frame_files(&path) {
        let metadata = file.metadata().ok();
        (&file, metadata.map(|metadata| (metadata.len(), metadata.modified().ok()))).hash(&mut hasher);
    }
    format!("{} {:016x}", path.display(), hasher.finish())
}

/// The files that the frames of a source are read from: what else lies in a folder, the training in progress
/// perhaps, has no say in them.
pub(super) fn frame_files(path: &Path) -> Vec<PathBuf> {
    // A folder without images is no source: there is nothing to know it by.
    if path.is_dir() { source::image_files(path).unwrap_or_default() } else { vec![path.to_owned()] }
}

type Read = Result<GreyImage, SourceError>;

/// What of a source is looked at, frame by frame. It is opened when it is its turn: a hundred videos would be a hundred
/// processes that wait.
fn pictures(name: &str) -> Box<dyn Iterator<Item = Read> + Send> {
    match source::open(name, None) {
        Ok(mut source) => {
            Box::new(iter::from_fn(move || source.next_frame()).map(|frame| frame.map(|frame| frame.grey)))
        }
        Err(error) => Box::new(iter::once(Err(error))),
    }
}

/// The next pictures that are looked at side by side.
fn next_batch(pictures: &mut impl Iterator<Item = Read>, most: usize) -> Vec<Read> {
    let (mut batch, mut bytes) = (Vec::new(), 0);
    while batch.len() < most && bytes < BATCH_BYTES {
        let Some(picture) = pictures.next() else { break };
        bytes += picture.as_ref().map_or(0, |grey| grey.pixels().len());
        batch.push(picture);
    }
    batch
}

struct Extraction<'a> {
    progress: &'a ProgressBar,
    stop: &'a AtomicBool,
}

impl Extraction<'_> {
    /// Reads the next pictures while the features of the last ones are extracted.
    fn run(
        &self,
        mut pictures: impl Iterator<Item = Read> + Send,
        corpus: &mut TrainingFile,
    ) -> anyhow::Result<()> {
        let extractor = || OrbExtractor::new(OrbOptions::default());
        let most = FRAMES_PER_CORE * rayon::current_num_threads();
        let mut batch = next_batch(&mut pictures, most);
        while !batch.is_empty() && !self.stop.load(Ordering::Relaxed) {
            let (images, next) = rayon::join(
                || {
                    batch
                        .par_iter()
                        .map_init(extractor, |extractor, picture| self.image(extractor, picture))
                        .collect::<Vec<_>>()
                },
                || next_batch(&mut pictures, most),
            );
            for image in images {
                corpus.push(image.as_ref())?;
            }
            batch = next;
        }
        Ok(())
    }

    fn image(&self, extractor: &mut OrbExtractor, picture: &Read) -> Option<CorpusImage> {
        match picture {
            Ok(grey) => Some(CorpusImage {
                mean_luminance: grey.mean_luminance(),
                descriptors: extractor.extract(grey).descriptors,
            }),
            Err(error) => {
                self.progress.suspend(|| eprintln!("loci: skipped: {error}"));
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use loci::raster::RgbImage;

    use super::*;

    #[test]
    fn a_batch_holds_few_large_pictures_and_many_small_ones() {
        let batch = |side: usize| {
            let mut pictures = iter::repeat_with(|| Ok(GreyImage::new(side, side)));
            next_batch(&mut pictures, 64).len()
        };
        assert_eq!(batch(100), 64);
        assert_eq!(batch(8192), 2, "64 MiB each");
        assert_eq!(batch(16384), 1, "256 MiB each");
        let mut few = [Err(SourceError::NoImages { path: PathBuf::new() })].into_iter();
        assert_eq!((next_batch(&mut few, 64).len(), next_batch(&mut few, 64).len()), (1, 0));
    }

    #[test]
    fn a_source_is_opened_when_it_is_its_turn() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["a", "b"].map(|name| {
            let path = folder.path().join(name);
            fs::create_dir(&path).unwrap();
            fs::write(path.join("1.jpg"), source::jpeg(&RgbImage::new(40, 40))).unwrap();
            path.to_str().unwrap().to_owned()
        });
        let mut pictures = names.iter().flat_map(|name| pictures(name));
        assert!(pictures.next().unwrap().is_ok());
        fs::remove_dir_all(&names[1]).unwrap();
        assert!(matches!(pictures.next(), Some(Err(SourceError::Io { .. }))));
        assert!(pictures.next().is_none());
    }

    #[test]
    fn a_folder_is_known_by_its_images_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photos");
        fs::create_dir_all(path.join("hall")).unwrap();
        fs::write(path.join("1.jpg"), b"one").unwrap();
        let identity = || identity(path.to_str().unwrap());
        let before = identity();
        for other in ["notes.txt", "site.lvoc.training", "hall/3.jpg"] {
            fs::write(path.join(other), b"no frame of this folder").unwrap();
            assert_eq!(identity(), before, "{other}");
        }
        fs::write(path.join("1.jpg"), b"another").unwrap();
        let changed = identity();
        assert_ne!(changed, before);
        fs::write(path.join("2.jpg"), b"two").unwrap();
        assert_ne!(identity(), changed);
        let dotted = folder.path().join("photos/../photos");
        assert_eq!(super::identity(dotted.to_str().unwrap()), identity(), "the same folder");
    }

    #[test]
    fn a_single_file_is_known_by_itself_and_a_world_by_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let video = folder.path().join("drive.mp4");
        fs::write(&video, b"one").unwrap();
        let identity = || identity(video.to_str().unwrap());
        let before = identity();
        fs::write(folder.path().join("other.mp4"), b"two").unwrap();
        assert_eq!(identity(), before);
        fs::write(&video, b"another").unwrap();
        assert_ne!(identity(), before);
        assert_eq!(super::identity("synthetic:street"), "synthetic:street");
    }
}
