//! The features of many images, on all cores: what a vocabulary is trained on or weighted by.
//!
//! What was extracted is kept in `OUT.training` until the vocabulary is written, so that the same command
//! goes on where it was cut off.

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressDrawTarget};
use loci::feature::{OrbExtractor, OrbOptions};
use loci::frame::Frame;
use loci::source::{self, SourceError};
use loci::vocabulary::{CorpusImage, TrainingFile};
use rayon::prelude::*;

use crate::cli::console::progress_bar;

/// Frames that are held in memory for each core.
const FRAMES_PER_CORE: usize = 4;

/// The descriptors of every frame of the sources, those that an earlier run extracted included.
pub(super) fn extract(names: &[String], out: &Path) -> anyhow::Result<TrainingFile> {
    let mut sources: Vec<_> =
        names.iter().map(|source| source::open(source, None)).collect::<Result<_, _>>()?;
    let counts: Vec<Option<u64>> = sources.iter().map(|source| source.frame_count()).collect();
    let of = format!("Loci {}: {names:?} {counts:?}", env!("CARGO_PKG_VERSION"));
    let path = PathBuf::from(format!("{}.training", out.display()));
    let mut corpus = TrainingFile::open(&path, &of)?;
    let known = corpus.frame_count();
    if known > 0 {
        eprintln!("loci: going on with the {known} frames in {}", path.display());
    }
    let progress = progress_bar(counts.into_iter().sum(), "frames", ProgressDrawTarget::stderr());
    let frames = sources.iter_mut().flat_map(|source| std::iter::from_fn(|| source.next_frame()));
    let extracted = Extraction { extractor: OrbExtractor::new(OrbOptions::default()), progress: &progress };
    extracted.run(frames.inspect(|_| progress.inc(1)).skip(known as usize), &mut corpus)?;
    progress.finish_and_clear();
    Ok(corpus)
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
