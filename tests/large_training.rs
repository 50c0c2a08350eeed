//! The memory that a large training needs, in a process of its own: `make test-large`.

use loci::feature::Descriptor;
use loci::vocabulary::{CorpusImage, TrainingFile, TrainingOptions, train_on};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

const IMAGES: u64 = 100_000;
const DESCRIPTORS_AN_IMAGE: usize = 1_000;
const MOST_KIB: u64 = 4 << 20;

/// Most memory that this process ever had at once, in KiB; mapped files included.
fn peak_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    peak.split_whitespace().next().unwrap().parse().unwrap()
}

/// One of a few thousand kinds of corner, an eighth of its bits flipped.
fn descriptor(kinds: &[[u64; 4]], random: &mut Pcg64) -> Descriptor {
    let kind = kinds[random.random_range(0..kinds.len())];
    let mut seen = [0; 32];
    for (bytes, bits) in seen.as_chunks_mut::<8>().0.iter_mut().zip(kind) {
        let flips: u64 = random.random::<u64>() & random.random::<u64>() & random.random::<u64>();
        *bytes = (bits ^ flips).to_le_bytes();
    }
    Descriptor(seen)
}

#[test]
#[ignore = "takes minutes and 3.3 GB of disk: `make test-large`"]
fn a_hundred_million_descriptors_need_less_than_four_gibibytes() {
    let folder = tempfile::tempdir().unwrap();
    let mut corpus = TrainingFile::open(&folder.path().join("v.training"), "made up").unwrap();
    let mut random = Pcg64::seed_from_u64(1);
    let kinds: Vec<[u64; 4]> = (0..4096).map(|_| random.random()).collect();
    for _ in 0..IMAGES {
        let descriptors = (0..DESCRIPTORS_AN_IMAGE).map(|_| descriptor(&kinds, &mut random)).collect();
        corpus.push(Some(&CorpusImage { mean_luminance: 100.0, descriptors })).unwrap();
    }
    let options = TrainingOptions { depth: 6, ..TrainingOptions::default() };
    let trained = train_on(&corpus, options, &()).unwrap();
    let peak_kib = peak_kib();
    println!(
        "{} descriptors, {} words, distortion {:.2} bits, peak {peak_kib} KiB",
        trained.descriptors,
        trained.vocabulary.word_count(),
        trained.mean_distortion_bits
    );
    assert_eq!(trained.descriptors, 100_000_000);
    assert_eq!(trained.sampled_descriptors, options.most_descriptors);
    // A descriptor lies 32 bits from its kind and 128 from the others: most must end near their kind.
    assert!(trained.mean_distortion_bits < 64.0);
    assert!(peak_kib < MOST_KIB, "{peak_kib} KiB");
}
