//! `loci vocab`: train, import and inspect visual vocabularies.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use indicatif::ProgressDrawTarget;
use loci::feature::{Descriptor, OrbExtractor, OrbOptions};
use loci::source;
use loci::storage::check_replaceable;
use loci::vocabulary::{self, TrainingOptions, Vocabulary, WordId, train};
use serde::Serialize;

use super::console::progress_bar;
use super::{Anything, Outcome, not_built};

/// Commands of `loci vocab`.
#[derive(Subcommand)]
pub(super) enum VocabCommand {
    /// Learn a vocabulary from images
    Train(TrainArguments),
    /// What a vocabulary file holds
    Info(InfoArguments),
    /// Turn a vocabulary of ORB-SLAM, DBoW2, DBoW3 or FBoW, or an older one of Loci, into a .lvoc file
    Import(ImportArguments),
    /// Time a vocabulary (not built yet)
    Bench(Anything),
}

/// Arguments of `loci vocab train`.
#[derive(Args)]
#[command(
    after_help = "Example:\n  loci vocab train photos/hall photos/yard --branching 10 --depth 5 --out site.lvoc"
)]
pub(super) struct TrainArguments {
    /// Folders of images, or synthetic:… worlds
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

/// Arguments of `loci vocab import`.
#[derive(Args)]
#[command(after_help = "Example:\n  loci vocab import ORBvoc.txt --out orb.lvoc")]
pub(super) struct ImportArguments {
    /// ORB-SLAM text, DBoW2 YAML (.yml, .yml.gz), DBoW3 binary, FBoW, or an older .lvoc
    file: PathBuf,
    /// File to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Arguments of `loci vocab info`.
#[derive(Args)]
#[command(after_help = "Example:\n  loci vocab info vocab/default.lvoc --verify")]
pub(super) struct InfoArguments {
    /// A vocabulary file (.lvoc)
    file: PathBuf,
    /// Compare the whole file with its checksum, too
    #[arg(long)]
    verify: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Info {
    file: String,
    branching: u32,
    depth: u32,
    nodes: u32,
    words: u32,
    /// Words that never count, because every training image shows them or their weight is unknown.
    weightless_words: usize,
    weighting: &'static str,
    /// 0 if unknown.
    images: u32,
    /// Mean luminance of those images, 0 to 255.
    mean_luminance: Option<f32>,
    bytes: usize,
    verified: bool,
}

/// Runs a command of `loci vocab`.
pub(super) fn run(command: VocabCommand) -> anyhow::Result<Outcome> {
    match command {
        VocabCommand::Train(arguments) => learn(&arguments),
        VocabCommand::Info(arguments) => info(&arguments),
        VocabCommand::Import(arguments) => import(&arguments),
        VocabCommand::Bench(_) => not_built("vocab bench"),
    }
}

fn learn(arguments: &TrainArguments) -> anyhow::Result<Outcome> {
    let (images, skipped) = descriptors(&arguments.sources)?;
    let options =
        TrainingOptions { branching: arguments.branching, depth: arguments.depth, seed: arguments.seed };
    let vocabulary = train(&images, options)?;
    vocabulary.save(&arguments.out)?;
    print(&describe(&vocabulary, arguments.out.display().to_string(), true), arguments.json)?;
    Ok(if skipped == 0 { Outcome::Done } else { Outcome::Lost })
}

/// The descriptors of every image of `sources`, and how many images could not be read.
fn descriptors(sources: &[String]) -> anyhow::Result<(Vec<Vec<Descriptor>>, usize)> {
    let extractor = OrbExtractor::new(OrbOptions::default());
    let mut sources: Vec<_> =
        sources.iter().map(|source| source::open(source, None)).collect::<Result<_, _>>()?;
    let frames = sources.iter().map(|source| source.frame_count()).sum();
    let progress = progress_bar(frames, ProgressDrawTarget::stderr());
    let (mut images, mut skipped) = (Vec::new(), 0);
    for source in &mut sources {
        while let Some(frame) = source.next_frame() {
            match frame {
                Ok(frame) => images.push(extractor.extract(&frame.grey).descriptors),
                Err(error) => {
                    skipped += 1;
                    progress.suspend(|| eprintln!("loci: skipped: {error}"));
                }
            }
            progress.inc(1);
        }
    }
    progress.finish_and_clear();
    Ok((images, skipped))
}

fn import(arguments: &ImportArguments) -> anyhow::Result<Outcome> {
    check_replaceable(&arguments.out)?;
    let (format, vocabulary) = vocabulary::import::import(&arguments.file)?;
    vocabulary.save(&arguments.out)?;
    if !arguments.json {
        println!("imported    {} ({})", arguments.file.display(), format.as_str());
    }
    print(&describe(&vocabulary, arguments.out.display().to_string(), true), arguments.json)?;
    Ok(Outcome::Done)
}

fn info(arguments: &InfoArguments) -> anyhow::Result<Outcome> {
    let vocabulary = Vocabulary::open(&arguments.file)?;
    if arguments.verify {
        vocabulary.verify(&arguments.file)?;
    }
    print(&describe(&vocabulary, arguments.file.display().to_string(), arguments.verify), arguments.json)?;
    Ok(Outcome::Done)
}

fn describe(vocabulary: &Vocabulary, file: String, verified: bool) -> Info {
    let words = vocabulary.word_count();
    Info {
        file,
        branching: vocabulary.branching(),
        depth: vocabulary.depth(),
        nodes: vocabulary.node_count(),
        words,
        weightless_words: (0..words).filter(|&word| vocabulary.weight(WordId(word)) == 0.0).count(),
        weighting: vocabulary.weighting().as_str(),
        images: vocabulary.image_count(),
        mean_luminance: vocabulary.luminance(),
        bytes: vocabulary.length_bytes(),
        verified,
    }
}

fn light(mean_luminance: Option<f32>) -> String {
    mean_luminance.map(|mean| format!(" of mean luminance {mean:.1}")).unwrap_or_default()
}

fn print(info: &Info, json: bool) -> anyhow::Result<()> {
    if json {
        println!("{}", serde_json::to_string(info)?);
        return Ok(());
    }
    println!("vocabulary  {}", info.file);
    println!("tree        branching {}, depth {}, {} nodes", info.branching, info.depth, info.nodes);
    println!(
        "words       {}, {} of them without weight; {}",
        info.words, info.weightless_words, info.weighting
    );
    match info.images {
        0 => println!("trained on  unknown images"),
        images => println!("trained on  {images} images{}", light(info.mean_luminance)),
    }
    println!("size        {} bytes", info.bytes);
    println!("checksum    {}", if info.verified { "right" } else { "not checked (use --verify)" });
    Ok(())
}
