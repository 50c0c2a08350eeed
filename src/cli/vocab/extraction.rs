//! The features of many images, on all cores: what a vocabulary is trained on or weighted by.
//!
//! What was extracted is kept in `OUT.training` until the vocabulary is written, so that the same command
//! goes on where it was cut off.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressDrawTarget};
use loci::feature::{OrbExtractor, OrbOptions};
use loci::frame::Frame;
use loci::source::{self, SourceError};
use loci::vocabulary::{Corpus, CorpusImage, TrainingFile, VocabularyError};
use rayon::prelude::*;

use crate::cli::console::progress_bar;

/// Frames that are held in memory for each core.
const FRAMES_PER_CORE: usize = 4;

/// The descriptors of every frame of the sources, those that an earlier run extracted included.
pub(super) fn extract(names: &[String], out: &Path) -> anyhow::Result<TrainingFile> {
    let mut sources: Vec<_> =
        names.iter().map(|source| source::open(source, None)).collect::<Result<_, _>>()?;
    let counts = sources.iter().map(|source| source.frame_count());
    let identities: Vec<String> = names.iter().map(|name| identity(name)).collect();
    let of = format!("Loci {}: {}", env!("CARGO_PKG_VERSION"), identities.join("; "));
    let path = PathBuf::from(format!("{}.training", out.display()));
    let mut corpus = TrainingFile::open(&path, &of)?;
    let known = corpus.frame_count();
    if known > 0 {
        eprintln!("loci: going on with the {known} frames in {}", path.display());
    }
    let progress = progress_bar(counts.sum(), "frames", ProgressDrawTarget::stderr());
    let frames = sources.iter_mut().flat_map(|source| std::iter::from_fn(|| source.next_frame()));
    let extracted = Extraction { extractor: OrbExtractor::new(OrbOptions::default()), progress: &progress };
    extracted.run(frames.inspect(|_| progress.inc(1)).skip(known as usize), &mut corpus)?;
    progress.finish_and_clear();
    if corpus.descriptor_count() == 0 {
        corpus.remove()?;
        return Err(VocabularyError::NothingToLearn.into());
    }
    Ok(corpus)
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
fn frame_files(path: &Path) -> Vec<PathBuf> {
    // A folder without images is no source: there is nothing to know it by.
    if path.is_dir() { source::image_files(path).unwrap_or_default() } else { vec![path.to_owned()] }
}

type Read = Result<Frame, SourceError>;

struct Extraction<'a> {
    extractor: OrbExtractor,
    progress: &'a ProgressBar,
}

impl Extraction<'_> {
    /// Reads the next frames while the features of the last ones are extracted.
    fn run(
        &self,
        mut frames: impl Iterator<Item = Read> + Send,
        corpus: &mut TrainingFile,
    ) -> anyhow::Result<()> {
        let at_once = FRAMES_PER_CORE * rayon::current_num_threads();
        let mut batch: Vec<Read> = frames.by_ref().take(at_once).collect();
        while !batch.is_empty() {
            let (images, next) = rayon::join(
                || batch.par_iter().map(|frame| self.image(frame)).collect::<Vec<_>>(),
                || frames.by_ref().take(at_once).collect(),
            );
            for image in images {
                corpus.push(image.as_ref())?;
            }
            batch = next;
        }
        Ok(())
    }

    fn image(&self, frame: &Read) -> Option<CorpusImage> {
        match frame {
            Ok(frame) => Some(CorpusImage {
                mean_luminance: frame.grey.mean_luminance(),
                descriptors: self.extractor.extract(&frame.grey).descriptors,
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

    use super::*;

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
