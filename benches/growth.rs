//! How a query grows with the map: `cargo bench --no-default-features --bench growth -- 1000 10000 50000`.
//!
//! Images are made up: 1,000 words each, drawn as often as the vocabulary's training images showed them. Every place is
//! shown by one of them, or by 20 that have half their words in common. A query shows half the words of an image, those
//! that its place has in common, and must find the place. Images are added one by one, as a robot does; more than
//! 50,000 at once, as when a map is opened.

use std::path::Path;
use std::time::Instant;

use loci::retrieval::{BowVector, InvertedIndex, Retrieved};
use loci::vocabulary::{Vocabulary, WordId};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

const WORDS: usize = 1000;
/// Most images that are added one by one.
const ONE_BY_ONE: usize = 50_000;
const QUERIES: usize = 200;
/// Images of a place.
const SHOWN: [usize; 2] = [1, 20];

fn main() {
    let arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let mut sizes: Vec<usize> = arguments.filter_map(|argument| argument.parse().ok()).collect();
    if sizes.is_empty() {
        sizes = vec![1000, 10_000];
    }
    // A place must be there that 20 images show.
    sizes.retain(|&size| size >= SHOWN[1]);
    let world = World::new();
    println!(
        "| Images | Of a place | Postings | MB | Query, median, ms | 99 of 100, ms | Slowest addition, ms |\n\
         |---:|---:|---:|---:|---:|---:|---:|"
    );
    for size in sizes {
        SHOWN.iter().for_each(|&shown| measure(size, shown, &world));
    }
}

/// What images may show.
struct World {
    vocabulary: Vocabulary,
    /// Sums of the words' frequencies, each with those before it.
    sums: Vec<f64>,
}

impl World {
    fn new() -> Self {
        let vocabulary = Vocabulary::open(Path::new("vocab/default.lvoc")).expect("the shipped vocabulary");
        // A word of idf ln(N / n) was shown by n of N images.
        let frequencies = (0..vocabulary.word_count()).map(|word| (-vocabulary.weight(WordId(word))).exp());
        let sums = frequencies.scan(0.0, |sum, frequency| {
            *sum += frequency;
            Some(*sum)
        });
        Self { sums: sums.collect(), vocabulary }
    }

    /// Half the words of an image.
    fn half(&self, seed: usize) -> impl Iterator<Item = WordId> {
        let mut random = Pcg64::seed_from_u64(seed as u64);
        (0..WORDS / 2).map(move |_| {
            let drawn = random.random_range(0.0..self.sums[self.sums.len() - 1]);
            WordId(self.sums.partition_point(|&sum| sum <= drawn) as u32)
        })
    }

    /// A view of a place.
    fn image(&self, place: usize, view: usize) -> BowVector {
        BowVector::new(self.half(2 * place).chain(self.half(2 * view + 1)), &self.vocabulary)
    }
}

/// A query by a name of its own, so that `benches/instructions.py` finds it.
#[inline(never)]
fn ask(index: &mut InvertedIndex, bow: &BowVector) -> impl std::ops::Deref<Target = [Retrieved]> {
    index.query(bow, |_| true)
}

/// Queries an index of so many images, so many `shown` of every place.
fn measure(images: usize, shown: usize, world: &World) {
    let mut index = InvertedIndex::default();
    let (mut postings, mut slowest_ms) = (0, 0.0_f64);
    for view in 0..images {
        let bow = world.image(view / shown, view);
        postings += bow.entries().len();
        let started = Instant::now();
        index.add(&bow);
        if images <= ONE_BY_ONE || view + 1 == images {
            // Asked for nothing, it puts the image where it is found.
            index.query(&BowVector::default(), |_| true);
        }
        slowest_ms = slowest_ms.max(started.elapsed().as_secs_f64() * 1e3);
    }
    let mut random = Pcg64::seed_from_u64(u64::MAX);
    let mut times_ms: Vec<f64> = (0..QUERIES)
        .map(|query| {
            let place = random.random_range(0..images / shown);
            let bow = world.image(place, images + query);
            let started = Instant::now();
            let found = ask(&mut index, &bow);
            let ms = started.elapsed().as_secs_f64() * 1e3;
            assert_eq!(found[0].document.0 as usize / shown, place);
            ms
        })
        .collect();
    times_ms.sort_by(f64::total_cmp);
    let [median, most] = [QUERIES / 2, QUERIES * 99 / 100].map(|rank| times_ms[rank]);
    let mb = index.memory_bytes() as f64 / 1e6;
    println!("| {images} | {shown} | {postings} | {mb:.1} | {median:.3} | {most:.3} | {slowest_ms:.1} |");
}
