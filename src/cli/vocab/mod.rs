//! `loci vocab`: train, import, inspect and time visual vocabularies.

mod bench;
mod extraction;
mod progress;
mod train;

use std::fmt;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use loci::storage::check_replaceable;
use loci::vocabulary::import::VocabularyFormat;
use loci::vocabulary::{self, Corpus, Vocabulary, VocabularyError, WordId, weigh_on};
use serde::Serialize;

use self::extraction::{extract, frame_files};
use self::progress::{Progress, explained};
use super::console::{counted, say};
use super::stream::stop_flag;
use super::{Outcome, WrongArgument};

/// Commands of `loci vocab`.
#[derive(Subcommand)]
pub(super) enum VocabCommand {
    /// Learn a vocabulary from images
    Train(train::TrainArguments),
    /// What a vocabulary file holds
    Info(InfoArguments),
    /// Turn a vocabulary of ORB-SLAM, DBoW2, DBoW3 or FBoW, or an older one of Loci, into a .lvoc file
    Import(ImportArguments),
    /// What a vocabulary costs on this computer: time and memory
    Bench(bench::BenchArguments),
}

/// Arguments of `loci vocab import`.
#[derive(Args)]
#[command(after_help = "Examples:\n  loci vocab import ORBvoc.txt --out orb.lvoc\n  \
    loci vocab import orb.fbow --weights-from photos/hall --out hall.lvoc")]
pub(super) struct ImportArguments {
    /// ORB-SLAM text, DBoW2 YAML (.yml, .yml.gz), DBoW3 binary, FBoW, or an older .lvoc
    file: PathBuf,
    /// Weigh the words anew by how many of these images show them: folders, videos, synthetic:… worlds.
    /// Words that none of them shows weigh nothing from then on
    #[arg(long, value_name = "IMAGES", num_args = 1..)]
    weights_from: Vec<String>,
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
    /// Words that never count: every image that they were weighed on shows them, none does, or their weight is
    /// unknown.
    weightless_words: usize,
    weighting: &'static str,
    /// 0 if unknown.
    images: u32,
    /// Mean luminance of those images, 0 to 255.
    mean_luminance: Option<f32>,
    /// Of the file.
    bytes: usize,
    /// Of the file's format.
    version: u32,
    verified: bool,
}

/// Runs a command of `loci vocab`.
pub(super) fn run(command: VocabCommand) -> anyhow::Result<Outcome> {
    match command {
        VocabCommand::Train(arguments) => train::run(&arguments),
        VocabCommand::Info(arguments) => info(&arguments),
        VocabCommand::Import(arguments) => import(&arguments),
        VocabCommand::Bench(arguments) => bench::run(&arguments),
    }
}

fn import(arguments: &ImportArguments) -> anyhow::Result<Outcome> {
    let images = arguments.weights_from.iter().map(Path::new);
    check_output(&arguments.out, images.chain([arguments.file.as_path()]))?;
    let (format, vocabulary) = vocabulary::import::import(&arguments.file)?;
    let outcome = if arguments.weights_from.is_empty() {
        vocabulary.save(&arguments.out)?;
        Outcome::Done
    } else {
        weigh(&vocabulary, arguments)?
    };
    if !arguments.json {
        say(&format!("imported    {} ({})", arguments.file.display(), format.as_str()))?;
    }
    let info = describe_written(&arguments.out)?;
    if info.weightless_words == info.words as usize {
        eprintln!("loci: no word of the file weighs anything, so nothing is found by it: use --weights-from");
    } else if format == VocabularyFormat::Fbow
        && arguments.weights_from.is_empty()
        && info.weightless_words > 0
    {
        eprintln!(
            "loci: {} of the file without weight: FBoW loses up to four; --weights-from weighs them anew",
            counted(info.weightless_words, "word")
        );
    }
    print(&info, arguments.json)?;
    Ok(outcome)
}

/// Refuses an output that cannot be written, or that would take the place of one of the inputs.
fn check_output<'a>(out: &Path, inputs: impl Iterator<Item = &'a Path>) -> anyhow::Result<()> {
    check_replaceable(out)?;
    let Ok(existing) = out.canonicalize() else { return Ok(()) };
    for input in inputs.filter_map(|input| input.canonicalize().ok()) {
        if frame_files(&input).iter().any(|file| file.canonicalize().is_ok_and(|file| file == existing)) {
            let argument = format!("--out {}", out.display());
            return Err(WrongArgument(format!("{argument} would replace an input; name another file")).into());
        }
    }
    Ok(())
}

/// Saves `vocabulary` with weights from the images that were named.
fn weigh(vocabulary: &Vocabulary, arguments: &ImportArguments) -> anyhow::Result<Outcome> {
    let stop = stop_flag()?;
    let corpus = extract(&arguments.weights_from, &arguments.out, &stop)?;
    let weighted = weigh_on(vocabulary, &corpus, &Progress::new(&stop));
    if matches!(weighted, Err(VocabularyError::NothingRare)) {
        // Kept, it would be in the way of the images that are tried next.
        corpus.remove()?;
        return Err(VocabularyError::NothingRare.into());
    }
    let weighted = weighted.map_err(|error| explained(error, &corpus, &arguments.out))?;
    weighted.save(&arguments.out)?;
    let outcome = if corpus.frame_count() == corpus.image_count() { Outcome::Done } else { Outcome::Lost };
    corpus.remove()?;
    Ok(outcome)
}

fn info(arguments: &InfoArguments) -> anyhow::Result<Outcome> {
    let vocabulary = Vocabulary::open(&arguments.file)?;
    if arguments.verify {
        vocabulary.verify(&arguments.file)?;
    }
    // A file of version 1 is verified whenever it is opened.
    let verified = arguments.verify || vocabulary.version() == 1;
    print(&describe(&vocabulary, arguments.file.display().to_string(), verified), arguments.json)?;
    Ok(Outcome::Done)
}

/// The file that was just written, read anew.
fn describe_written(path: &Path) -> anyhow::Result<Info> {
    let written = Vocabulary::open(path)?;
    written.verify(path)?;
    Ok(describe(&written, path.display().to_string(), true))
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
        version: vocabulary.version(),
        verified,
    }
}

fn print(info: &Info, json: bool) -> anyhow::Result<()> {
    say(&if json { serde_json::to_string(info)? } else { info.to_string() })
}

impl fmt::Display for Info {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "vocabulary  {}", self.file)?;
        writeln!(f, "tree        branching {}, depth {}, {} nodes", self.branching, self.depth, self.nodes)?;
        let (words, weightless) = (self.words, self.weightless_words);
        writeln!(f, "words       {words}, {weightless} of them without weight; {}", self.weighting)?;
        match (self.images, self.mean_luminance) {
            (0, _) => writeln!(f, "weighed on  unknown images")?,
            (images, None) => writeln!(f, "weighed on  {}", counted(images, "image"))?,
            (images, Some(light)) => {
                writeln!(f, "weighed on  {} of mean luminance {light:.1}", counted(images, "image"))?;
            }
        }
        writeln!(f, "size        {} bytes, version {}", self.bytes, self.version)?;
        write!(f, "checksum    {}", if self.verified { "right" } else { "not checked (use --verify)" })
    }
}
