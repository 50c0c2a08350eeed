//! Opening, using and training a vocabulary of a million descriptors: `tower_walk` at LOCI_DATA, 1,010 frames
//! of 640×360. Everything is timed on one thread.
#![expect(missing_docs, reason = "criterion's macro writes a public function")]

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{env, fs};

use criterion::{Criterion, criterion_group, criterion_main};
use loci::feature::{Descriptor, OrbExtractor, OrbOptions};
use loci::retrieval::BowVector;
use loci::source;
use loci::vocabulary::{MemoryCorpus, TrainingOptions, Vocabulary, train_on};

/// The descriptors of every frame; `None` where there are no data.
fn images() -> Option<Vec<Vec<Descriptor>>> {
    let root = env::var_os("LOCI_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
    let mut floors: Vec<PathBuf> =
        fs::read_dir(root.join("tower_walk")).ok()?.flatten().map(|entry| entry.path()).collect();
    floors.retain(|path| path.is_dir());
    floors.sort();
    let mut extractor = OrbExtractor::new(OrbOptions::default());
    let of_floor = |floor: &PathBuf| {
        let mut source = source::open(&floor.to_string_lossy(), None).expect("a folder of images");
        let frames = std::iter::from_fn(|| source.next_frame()).map(|frame| frame.expect("an image"));
        frames.map(|frame| extractor.extract(&frame.grey).descriptors).collect::<Vec<_>>()
    };
    Some(floors.iter().flat_map(of_floor).collect())
}

/// Private memory of this process in KiB.
fn private_kib() -> u64 {
    let rollup = fs::read_to_string("/proc/self/smaps_rollup").expect("Linux");
    let fields = rollup.lines().filter(|line| line.starts_with("Anonymous:"));
    fields.filter_map(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok()).sum()
}

fn use_of_a_large_one(criterion: &mut Criterion, images: &[Vec<Descriptor>], path: &Path) {
    let options = TrainingOptions { depth: 6, ..TrainingOptions::default() };
    let trained = train_on(&MemoryCorpus::from(images), options, &()).expect("a vocabulary");
    trained.vocabulary.save(path).expect("room for the vocabulary");
    println!(
        "k 10, L 6 of {} descriptors: {} words, {} bytes, distortion {:.2} bits",
        trained.descriptors,
        trained.vocabulary.word_count(),
        trained.vocabulary.length_bytes(),
        trained.mean_distortion_bits,
    );
    drop(trained);
    let before = private_kib();
    let vocabulary = Vocabulary::open(path).expect("the vocabulary just saved");
    images.iter().flatten().take(1000).for_each(|descriptor| {
        black_box(vocabulary.quantise(descriptor));
    });
    println!("private memory of the open vocabulary: {} KiB", private_kib().saturating_sub(before));

    criterion.bench_function("large_vocabulary/open_to_first_query", |bencher| {
        bencher.iter(|| {
            let vocabulary = Vocabulary::open(black_box(path)).expect("the vocabulary just saved");
            vocabulary.quantise(&images[0][0])
        });
    });
    let thousands: Vec<Vec<Descriptor>> = images.iter().filter(|i| i.len() >= 1000).cloned().collect();
    let mut next = thousands.iter().cycle();
    criterion.bench_function("large_vocabulary/bow_of_1000", |bencher| {
        bencher.iter(|| {
            let Some(image) = next.next() else { return BowVector::default() };
            let words = vocabulary.quantise_all(&image[..1000]).into_iter().map(|quantised| quantised.word);
            BowVector::new(words, &vocabulary)
        });
    });
}

fn training(criterion: &mut Criterion, images: &[Vec<Descriptor>]) {
    let all: Vec<Descriptor> = images.concat();
    let sample: Vec<Descriptor> = (0..200_000).map(|index| all[index * all.len() / 200_000]).collect();
    let sample = [sample];
    let options = TrainingOptions { depth: 4, ..TrainingOptions::default() };
    let train = || train_on(&MemoryCorpus::from(&sample[..]), options, &()).expect("a vocabulary");
    println!("k 10, L 4 of 200,000 descriptors: distortion {:.2} bits", train().mean_distortion_bits);
    let mut group = criterion.benchmark_group("vocabulary_training");
    group.sample_size(10).measurement_time(Duration::from_secs(20));
    group.bench_function("200k_k10_l4", |bencher| bencher.iter(train));
    group.finish();
}

fn vocabulary(criterion: &mut Criterion) {
    let Some(images) = images() else {
        println!("no tower_walk at LOCI_DATA: nothing to measure");
        return;
    };
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("the first pool of this process");
    let folder = tempfile::tempdir().expect("a temporary folder");
    use_of_a_large_one(criterion, &images, &folder.path().join("large.lvoc"));
    training(criterion, &images);
}

criterion_group!(benches, vocabulary);
criterion_main!(benches);
