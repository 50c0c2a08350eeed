//! `loci vocab train`: a vocabulary of the features of many images.

use std::fmt;
use std::path::{Path, PathBuf};

use clap::{Args, value_parser};
use loci::vocabulary::{Corpus, Trained, TrainingOptions, VocabularyError, train_on};
use serde::Serialize;

use super::extraction::extract;
use super::progress::{Progress, explained};
use super::{Info, check_output, describe_written};
use crate::cli::Outcome;
use crate::cli::console::say;
use crate::cli::stream::stop_flag;

/// Arguments of `loci vocab train`.
#[derive(Args)]
#[command(
    after_help = "Example:\n  loci vocab train photos/hall photos/yard --branching 10 --depth 5 --out site.lvoc\n\n\
    A training that was cut off goes on where it was with the same command: what was extracted is kept in \
    FILE.training until FILE is written."
)]
pub(in crate::cli) struct TrainArguments {
    /// Folders of images, videos, or synthetic:… worlds
    #[arg(required = true)]
    sources: Vec<String>,
    /// Children a node, 2 to 32
    #[arg(long, default_value_t = 10, value_parser = value_parser!(u32).range(2..=32))]
    branching: u32,
    /// Levels below the root, 1 to 8
    #[arg(long, default_value_t = 5, value_parser = value_parser!(u32).range(1..=8))]
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
    check_output(&arguments.out, arguments.sources.iter().map(Path::new))?;
    let stop = stop_flag()?;
    let corpus = extract(&arguments.sources, &arguments.out, &stop)?;
    let trained = train_on(&corpus, options, &Progress::new(&stop));
    let trained = trained.map_err(|error| explained(error, &corpus, &arguments.out))?;
    trained.vocabulary.save(&arguments.out)?;
    let written = describe_written(&arguments.out)?;
    let report = report(written, &trained, corpus.frame_count() - corpus.image_count());
    corpus.remove()?;
    if report.vocabulary.weightless_words == report.vocabulary.words as usize {
        eprintln!("loci: {}", VocabularyError::NothingRare);
    }
    show(&report, arguments.json)?;
    Ok(if report.unreadable_frames == 0 { Outcome::Done } else { Outcome::Lost })
}

fn report(vocabulary: Info, trained: &Trained, unreadable_frames: u64) -> Report {
    let words = f64::from(trained.vocabulary.word_count());
    Report {
        vocabulary,
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
    say(&if json { serde_json::to_string(report)? } else { report.to_string() })
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.vocabulary)?;
        let (descriptors, sampled) = (self.descriptors, self.sampled_descriptors);
        writeln!(f, "descriptors {descriptors}, the tree grew from {sampled} of them")?;
        writeln!(
            f,
            "occupancy   {:.1} descriptors a word on average, median {}, at most {}; {} words empty",
            self.mean_occupancy, self.median_occupancy, self.max_occupancy, self.empty_words
        )?;
        let distortion = self.mean_distortion_bits;
        write!(f, "distortion  {distortion:.2} bits on average from a descriptor to its word")
    }
}
