//! How a query grows with the map: `cargo bench --no-default-features --bench growth -- 1000 10000 50000`.
//!
//! Images are made up: 1,000 words each, drawn as often as the vocabulary's training images showed them. Every query
//! shows half the words of a known image, and must find it.

use std::path::Path;
use std::time::Instant;

use loci::retrieval::{BowVector, InvertedIndex};
use loci::vocabulary::{Vocabulary, WordId};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

const WORDS: usize = 1000;
const QUERIES: usize = 200;

fn main() {
    let arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let mut sizes: Vec<usize> = arguments.filter_map(|argument| argument.parse().ok()).collect();
    if sizes.is_empty() {
        sizes = vec![1000, 10_000];
    }
    let vocabulary = Vocabulary::open(Path::new("vocab/default.lvoc")).expect("the shipped vocabulary");
    // A word of idf ln(N / n) was shown by n of N images.
    let frequency = |word| (-vocabulary.weight(WordId(word))).exp();
    let sums = (0..vocabulary.word_count()).scan(0.0, |sum, word| {
        *sum += frequency(word);
        Some(*sum)
    });
    let sums: Vec<f64> = sums.collect();
    println!("| Images | Postings | Query, median, ms | 99 of 100, ms |\n|---:|---:|---:|---:|");
    sizes.into_iter().for_each(|size| measure(size, &vocabulary, &sums));
}

/// Queries an index of so many images; `sums` of the words' frequencies, each with those before it.
fn measure(images: usize, vocabulary: &Vocabulary, sums: &[f64]) {
    let image = |number: usize| {
        let mut random = Pcg64::seed_from_u64(number as u64);
        let mut word = || sums.partition_point(|&sum| sum <= random.random_range(0.0..sums[sums.len() - 1]));
        (0..WORDS).map(|_| WordId(word() as u32)).collect::<Vec<_>>()
    };
    let mut index = InvertedIndex::default();
    let mut postings = 0;
    for number in 0..images {
        let bow = BowVector::new(image(number), vocabulary);
        postings += bow.entries().len();
        index.add(&bow);
    }
    let mut random = Pcg64::seed_from_u64(u64::MAX);
    let mut times_ms: Vec<f64> = (0..QUERIES)
        .map(|query| {
            let known = random.random_range(0..images);
            let mut words = image(known);
            words.truncate(WORDS / 2);
            words.extend_from_slice(&image(images + query)[WORDS / 2..]);
            let bow = BowVector::new(words, vocabulary);
            let started = Instant::now();
            let found = index.query(&bow, |_| true);
            let ms = started.elapsed().as_secs_f64() * 1e3;
            assert_eq!(found[0].document.0 as usize, known);
            ms
        })
        .collect();
    times_ms.sort_by(f64::total_cmp);
    let [median, most] = [QUERIES / 2, QUERIES * 99 / 100].map(|rank| times_ms[rank]);
    println!("| {images} | {postings} | {median:.3} | {most:.3} |");
}
