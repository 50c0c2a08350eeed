//! The stages of recognition, each on the frames of a synthetic street.
#![expect(missing_docs, reason = "criterion's macro writes a public function")]

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use loci::cnn::{ModelCard, Preprocessor};
use loci::feature::{Features, OrbExtractor, OrbOptions};
use loci::frame::Frame;
use loci::kernel;
use loci::retrieval::{BowVector, InvertedIndex};
use loci::source;
use loci::verification::{MatchingView, VerificationOptions, verify};
use loci::vocabulary::Vocabulary;

fn frames(count: usize) -> Vec<Frame> {
    let world = "synthetic:street?laps=1&light=noon&frames=60&seed=7";
    let mut source = source::open(world, None).expect("a known world");
    std::iter::from_fn(|| source.next_frame()).take(count).map(|frame| frame.expect("rendered")).collect()
}

/// By a name of its own, so that `benches/instructions.py` finds it.
#[inline(never)]
fn bag_of_words(features: &Features, vocabulary: &Vocabulary) -> BowVector {
    let quantised = vocabulary.quantise_all(&features.descriptors);
    BowVector::new(quantised.iter().map(|quantised| quantised.word), vocabulary)
}

fn stages(criterion: &mut Criterion) {
    let vocabulary = Vocabulary::open(Path::new("vocab/default.lvoc")).expect("the shipped vocabulary");
    let mut extractor = OrbExtractor::new(OrbOptions::default());
    let frames = frames(20);
    let jpeg = source::jpeg(&frames[0].colour);
    criterion.bench_function("source/jpeg_of_640x480", |bencher| {
        bencher.iter(|| source::decode(black_box(&jpeg), "frame"));
    });
    criterion.bench_function("kernel/luma_of_640x480", |bencher| {
        bencher.iter(|| kernel::luma(black_box(&frames[0].colour)));
    });
    criterion.bench_function("cnn/input_of_640x480", |bencher| {
        let card =
            ModelCard::read(Path::new("models/efficientnet-lite0/card.toml")).expect("the shipped model");
        let mut preprocessor = Preprocessor::new(&card.input);
        bencher.iter(|| preprocessor.tensor(black_box(&frames[0].colour)).map(<[f32]>::len));
    });
    criterion.bench_function("features/orb_1000_of_640x480", |bencher| {
        bencher.iter(|| extractor.extract(black_box(&frames[0].grey)));
    });

    let features: Vec<Features> = frames.iter().map(|frame| extractor.extract(&frame.grey)).collect();
    criterion.bench_function("vocabulary/bow_of_1000", |bencher| {
        bencher.iter(|| bag_of_words(black_box(&features[0]), &vocabulary));
    });

    let vectors: Vec<BowVector> =
        features.iter().map(|features| bag_of_words(features, &vocabulary)).collect();
    let mut index = InvertedIndex::default();
    for vector in vectors.iter().cycle().take(1000) {
        index.add(vector);
    }
    criterion.bench_function("retrieval/query_of_1000_images", |bencher| {
        bencher.iter(|| index.query(black_box(&vectors[0]), |_| true));
    });

    let groups: Vec<Vec<u32>> = features
        .iter()
        .map(|features| features.descriptors.iter().map(|d| vocabulary.quantise(d).node.0).collect())
        .collect();
    let view = |image: usize| MatchingView { features: &features[image], groups: &groups[image] };
    let options = VerificationOptions::default();
    for (name, other) in [("next_frame", 1), ("far_frame", 15)] {
        criterion.bench_function(&format!("verification/{name}"), |bencher| {
            bencher.iter(|| verify(black_box(view(0)), view(other), &options));
        });
    }
}

criterion_group!(benches, stages);
criterion_main!(benches);
