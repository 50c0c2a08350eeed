//! `loci vocab bench`: what a vocabulary costs on this computer.

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Instant;
use std::{fmt, fs};

use clap::Args;
use loci::feature::{Descriptor, OrbExtractor, OrbOptions};
use loci::retrieval::BowVector;
use loci::source;
use loci::vocabulary::{Vocabulary, VocabularyError};
use serde::Serialize;

use crate::cli::Outcome;
use crate::cli::console::say;

/// Descriptors that are looked up at once: about a frame's.
const DESCRIPTORS: usize = 1000;
const OPENINGS: usize = 25;
const LOOK_UPS: usize = 200;

/// Arguments of `loci vocab bench`.
#[derive(Args)]
#[command(after_help = AFTER_HELP)]
pub(in crate::cli) struct BenchArguments {
    /// A vocabulary file (.lvoc)
    file: PathBuf,
    /// Look up the features of these images: a folder, a video or a synthetic:… world
    #[arg(long, value_name = "IMAGES", default_value = "synthetic:street?laps=1&frames=24")]
    images: String,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

const AFTER_HELP: &str = "\
Measured on one thread, with the file in the page cache: opening the file until the first word is known, and turning \
1,000 descriptors into a weighted vector, the next 1,000 each time: the same ones again would be found in the \
processor's cache. The first 200,000 are taken, and fewer are gone through again and again: few images flatter a large \
tree.

Example:
  loci vocab bench vocab/default.lvoc --images photos/hall";

/// What is printed: medians.
#[derive(Serialize)]
struct Report {
    file: String,
    words: u32,
    bytes: usize,
    /// From opening the file to the word of one descriptor.
    open_to_first_word_us: f64,
    /// From descriptors to a weighted vector.
    bow_us: f64,
    /// Of each vector.
    descriptors: usize,
    /// How many times as many are looked up in turn.
    different_sets: usize,
    /// Private memory of the vocabulary beyond the page cache, where the system says it.
    private_bytes: Option<u64>,
}

/// Times a vocabulary on one thread.
pub(super) fn run(arguments: &BenchArguments) -> anyhow::Result<Outcome> {
    // Before the images, which take their time.
    Vocabulary::open(&arguments.file)?;
    let (sets, outcome) = descriptor_sets(&arguments.images)?;
    let first = &sets[0][0];
    // Once before anything is measured: what the process itself needs for it is not the vocabulary's.
    first_word(&arguments.file, first)?;
    let before = private_bytes();
    let vocabulary = Vocabulary::open(&arguments.file)?;
    // One by one, without the scratch space of many at once.
    sets.iter().flatten().for_each(|descriptor| {
        black_box(vocabulary.quantise(descriptor));
    });
    let private_bytes = before.zip(private_bytes()).map(|(before, after)| after.saturating_sub(before));
    let mut in_turn = sets.iter().cycle();
    let bow = || {
        let descriptors = in_turn.next().map_or(&[][..], Vec::as_slice);
        let words = vocabulary.quantise_all(descriptors).into_iter().map(|quantised| quantised.word);
        black_box(BowVector::new(words, &vocabulary));
        Ok(())
    };
    let report = Report {
        file: arguments.file.display().to_string(),
        words: vocabulary.word_count(),
        bytes: vocabulary.length_bytes(),
        open_to_first_word_us: median_us(OPENINGS, || first_word(&arguments.file, first))?,
        bow_us: median_us(LOOK_UPS, bow)?,
        descriptors: DESCRIPTORS,
        different_sets: sets.len(),
        private_bytes,
    };
    say(&if arguments.json { serde_json::to_string(&report)? } else { report.to_string() })?;
    Ok(outcome)
}

fn first_word(file: &Path, descriptor: &Descriptor) -> Result<(), VocabularyError> {
    black_box(Vocabulary::open(file)?.quantise(descriptor));
    Ok(())
}

/// The first descriptors of a source, [`DESCRIPTORS`] a set, at most [`LOOK_UPS`] sets; repeated if they do not fill
/// one. Frames that cannot be read are named and skipped.
fn descriptor_sets(images: &str) -> anyhow::Result<(Vec<Vec<Descriptor>>, Outcome)> {
    let mut extractor = OrbExtractor::new(OrbOptions::default());
    let mut source = source::open(images, None)?;
    let mut outcome = Outcome::Done;
    let mut descriptors = Vec::new();
    while descriptors.len() < LOOK_UPS * DESCRIPTORS
        && let Some(frame) = source.next_frame()
    {
        match frame {
            Ok(frame) => descriptors.extend(extractor.extract(&frame.grey).descriptors),
            Err(error) => {
                eprintln!("loci: skipped: {error}");
                outcome = Outcome::Lost;
            }
        }
    }
    anyhow::ensure!(!descriptors.is_empty(), "no features in {images}: use sharper or larger images");
    let mut sets: Vec<Vec<Descriptor>> =
        descriptors.chunks_exact(DESCRIPTORS).take(LOOK_UPS).map(<[Descriptor]>::to_vec).collect();
    if sets.is_empty() {
        sets.push(descriptors.iter().copied().cycle().take(DESCRIPTORS).collect());
    }
    Ok((sets, outcome))
}

/// Median time of `runs` runs in microseconds.
fn median_us(
    runs: usize,
    mut run: impl FnMut() -> Result<(), VocabularyError>,
) -> Result<f64, VocabularyError> {
    let mut times = Vec::with_capacity(runs);
    for _ in 0..runs {
        let started = Instant::now();
        run()?;
        times.push(started.elapsed().as_secs_f64() * 1e6);
    }
    let middle = runs / 2;
    Ok(*times.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Memory that is this process's alone, in bytes, as Linux counts it.
fn private_bytes() -> Option<u64> {
    let rollup = fs::read_to_string("/proc/self/smaps_rollup").ok()?;
    let line = rollup.lines().find_map(|line| line.strip_prefix("Anonymous:"))?;
    Some(line.split_whitespace().next()?.parse::<u64>().ok()? * 1024)
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "vocabulary  {}, {} words, {} bytes", self.file, self.words, self.bytes)?;
        let (open_ms, bow_ms) = (self.open_to_first_word_us / 1e3, self.bow_us / 1e3);
        writeln!(f, "open        {open_ms:.3} ms until the first word, median of {OPENINGS}")?;
        let (descriptors, sets) = (self.descriptors, self.different_sets);
        write!(
            f,
            "look up     {bow_ms:.3} ms from {descriptors} descriptors to a vector, median of {LOOK_UPS}, \
             {sets} different ones in turn"
        )?;
        match self.private_bytes {
            Some(bytes) => write!(f, "\nmemory      {} KiB private, beyond the page cache", bytes / 1024),
            None => Ok(()),
        }
    }
}
