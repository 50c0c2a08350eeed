//! `loci vocab train`: features of many images, on all cores, then a vocabulary of them.
//!
//! What was extracted is kept in `OUT.training` until the vocabulary is written, so that the same command
//! goes on where it was cut off.

use std::path::PathBuf;

use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget};
use loci::feature::{OrbExtractor, OrbOptions};
use loci::frame::Frame;
use loci::source::{self, SourceError};
use loci::storage::check_replaceable;
use loci::vocabulary::{
    Corpus, CorpusImage, Trained, TrainingFile, TrainingOptions, TrainingProgress, train_on,
};
use rayon::prelude::*;
use serde::Serialize;

use super::{Info, describe, print};
use crate::cli::Outcome;
use crate::cli::console::progress_bar;

/// Frames that are held in memory for each core.
const FRAMES_PER_CORE: usize = 4;

/// Arguments of `loci vocab train`.
#[derive(Args)]
#[command(
    after_help = "Example:\n  loci vocab train photos/hall photos/yard --branching 10 --depth 5 --out site.lvoc"
)]
pub(in crate::cli) struct TrainArguments {
    /// Folders of images, videos, or synthetic:… worlds
    #[arg(required = true)]
    sources: Vec<String>,
    /// Children a node, 2 to 32
    #[arg(long, default_value_t = 10)]
    branching: u32,
    /// Levels below the root, 1 to 8
    #[arg(long, default_value_t = 5)]
    depth: u32,
    /// Seed of the random choice of first centres
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// File to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What is printed at the end.
#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    vocabulary: Info,
    unreadable_frames: u64,
    descriptors: u64,
    /// Descriptors that the tree grew from.
    sampled_descriptors: u64,
    empty_words: u32,
    mean_occupancy: f64,
    median_occupancy: u32,
    max_occupancy: u32,
    mean_distortion_bits: f64,
}

/// Trains a vocabulary.
pub(super) fn run(arguments: &TrainArguments) -> anyhow::Result<Outcome> {
    let options = TrainingOptions {
        branching: arguments.branching,
        depth: arguments.depth,
        seed: arguments.seed,
        ..TrainingOptions::default()
    };
    options.check()?;
    check_replaceable(&arguments.out)?;
    let corpus = extract(arguments)?;
    let trained = grow(&corpus, options)?;
    trained.vocabulary.save(&arguments.out)?;
    let report = report(arguments, &trained, corpus.frame_count() - corpus.image_count());
    corpus.remove()?;
    show(&report, arguments.json)?;
    Ok(if report.unreadable_frames == 0 { Outcome::Done } else { Outcome::Lost })
}

/// The descriptors of every frame of the sources, those that an earlier run extracted included.
fn extract(arguments: &TrainArguments) -> anyhow::Result<TrainingFile> {
    let mut sources: Vec<_> =
        arguments.sources.iter().map(|source| source::open(source, None)).collect::<Result<_, _>>()?;
    let counts: Vec<Option<u64>> = sources.iter().map(|source| source.frame_count()).collect();
    let of = format!("Loci {}: {:?} {counts:?}", env!("CARGO_PKG_VERSION"), arguments.sources);
    let path = PathBuf::from(format!("{}.training", arguments.out.display()));
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

fn grow(corpus: &TrainingFile, options: TrainingOptions) -> anyhow::Result<Trained> {
    let bar = |length: u64, unit: &str| progress_bar(Some(length), unit, ProgressDrawTarget::stderr());
    let growing =
        bar(corpus.descriptor_count() * u64::from(options.depth), "descriptors sorted into the tree");
    let weighing = bar(corpus.image_count(), "images weighed");
    let trained = train_on(corpus, options, &|progress| match progress {
        TrainingProgress::Growing { done, total } => {
            growing.set_length(total);
            growing.set_position(done);
        }
        TrainingProgress::Weighing { done, .. } => {
            growing.finish_and_clear();
            weighing.set_position(done);
        }
    })?;
    weighing.finish_and_clear();
    Ok(trained)
}

fn report(arguments: &TrainArguments, trained: &Trained, unreadable_frames: u64) -> Report {
    let words = f64::from(trained.vocabulary.word_count());
    Report {
        vocabulary: describe(&trained.vocabulary, arguments.out.display().to_string(), true),
        unreadable_frames,
        descriptors: trained.descriptors,
        sampled_descriptors: trained.sampled_descriptors,
        empty_words: trained.empty_words,
        mean_occupancy: trained.descriptors as f64 / words,
        median_occupancy: trained.median_occupancy,
        max_occupancy: trained.max_occupancy,
        mean_distortion_bits: trained.mean_distortion_bits,
    }
}

fn show(report: &Report, json: bool) -> anyhow::Result<()> {
    if json {
        println!("{}", serde_json::to_string(report)?);
        return Ok(());
    }
    print(&report.vocabulary, false)?;
    println!("descriptors {}, the tree grew from {} of them", report.descriptors, report.sampled_descriptors);
    println!(
        "occupancy   {:.1} descriptors a word on average, median {}, at most {}; {} words empty",
        report.mean_occupancy, report.median_occupancy, report.max_occupancy, report.empty_words
    );
    println!("distortion  {:.2} bits on average from a descriptor to its word", report.mean_distortion_bits);
    Ok(())
}
