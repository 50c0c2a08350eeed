//! A map of 50,000 keyframes of 256 features each: what it takes on the disk and in memory, and how long it takes
//! until the first question can be asked. Everything on one thread.
#![expect(missing_docs, reason = "criterion's macro writes a public function")]

mod made_up_map;

use std::fs;
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use criterion::{BatchSize, Bencher, Criterion, criterion_group, criterion_main};
use loci::cnn;
use loci::place_map::{MapOptions, PlaceMap};
use loci::recognition::{Look, Recogniser, RecognitionOptions};
use loci::vocabulary::{Light, Vocabulary, VocabularySet};
use rand::SeedableRng;
use rand_pcg::Pcg64;

const KEYFRAMES: u64 = 50_000;
/// What the hash of the model is made of.
const MODEL: &str = "0";
const INDEX: &str = "index.loci";
const VOCABULARY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/vocab/default.lvoc");

/// Memory of this process in KiB that no file backs.
fn private_kib() -> u64 {
    let rollup = fs::read_to_string("/proc/self/smaps_rollup").expect("Linux");
    let fields = rollup.lines().filter(|line| line.starts_with("Anonymous:"));
    fields.filter_map(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok()).sum()
}

fn opened(folder: &Path, vocabularies: &Arc<VocabularySet>, model: Option<cnn::ModelCard>) -> Recogniser {
    let map = PlaceMap::open_read_only(folder).expect("the map just written");
    let options = RecognitionOptions { read_only: true, ..RecognitionOptions::default() };
    Recogniser::new(Arc::clone(vocabularies), map, model, options).expect("its keyframes")
}

/// Opens the map as a robot does, and closes it; answers how long its index is, in bytes.
fn keep_index(folder: &Path, vocabularies: &Arc<VocabularySet>) -> u64 {
    let map = PlaceMap::open(folder, MapOptions::default()).expect("the map just written");
    let options = RecognitionOptions::default();
    let mut recogniser =
        Recogniser::new(Arc::clone(vocabularies), map, None, options).expect("its keyframes");
    recogniser.close().expect("an index");
    folder.join(INDEX).metadata().expect("an index").len()
}

fn of_fifty_thousand_keyframes(criterion: &mut Criterion) {
    let vocabulary = Vocabulary::open(Path::new(VOCABULARY)).expect("the default vocabulary");
    let folder = tempfile::tempdir().expect("a folder");
    made_up_map::write(folder.path(), KEYFRAMES, &vocabulary, &MODEL.repeat(64));
    let vocabularies = Arc::new(VocabularySet::open(&[VOCABULARY.into()]).expect("the default vocabulary"));
    let card = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/efficientnet-lite0/card.toml");
    let card = cnn::ModelCard::read(&card).expect("the default model");
    let model = cnn::ModelCard { sha256: MODEL.repeat(64), ..card };
    let disk_bytes: u64 = fs::read_dir(folder.path())
        .expect("the map's folder")
        .map(|entry| entry.expect("a file").metadata().expect("its length").len())
        .sum();
    let before = private_kib();
    let recogniser = opened(folder.path(), &vocabularies, Some(model.clone()));
    let kib = private_kib().saturating_sub(before);
    println!(
        "{KEYFRAMES} keyframes: {} bytes each on the disk, {} in memory ({} by our own account), {} places searched",
        disk_bytes / KEYFRAMES,
        kib * 1024 / KEYFRAMES,
        (recogniser.index_bytes() + recogniser.map().memory_bytes()) as u64 / KEYFRAMES,
        recogniser.working_places(),
    );
    drop(recogniser);
    let index_bytes = keep_index(folder.path(), &vocabularies);
    println!("their index: {} bytes each, of which those of postings are mapped", index_bytes / KEYFRAMES);
    let mut group = criterion.benchmark_group("map_of_50000_keyframes");
    group.sample_size(10);
    group.bench_function("open", |bencher| {
        bencher.iter(|| PlaceMap::open_read_only(black_box(folder.path())).expect("the map"));
    });
    let mut random = Pcg64::seed_from_u64(2);
    let look = Look::new(made_up_map::features(&mut random), (&vocabularies, Light::default()), None);
    // Until the first question is answered; closing the map again does not count.
    let open_and_index = |bencher: &mut Bencher<'_>| {
        let open = |()| {
            let mut recogniser = opened(black_box(folder.path()), &vocabularies, Some(model.clone()));
            recogniser.recognise(&made_up_map::frame(0), &look, Vec::new);
            recogniser
        };
        bencher.iter_batched(|| (), open, BatchSize::PerIteration);
    };
    group.bench_function("open_and_first_answer", open_and_index);
    fs::remove_file(folder.path().join(INDEX)).expect("the index");
    group.bench_function("open_and_first_answer_without_index", open_and_index);
    fs::remove_file(folder.path().join("snapshot.loci")).expect("the snapshot");
    group.bench_function("open_and_first_answer_without_index_and_snapshot", open_and_index);
}

criterion_group!(benches, of_fifty_thousand_keyframes);
criterion_main!(benches);
