//! Votes and verifies 200 correspondences, 60 of them true or none:
//! `cargo bench --no-default-features --bench verification`.

mod made_up;

use std::time::Instant;

use loci::verification::{Verification, VerificationOptions, Verifier};

const PAIRS_OF_IMAGES: u64 = 2000;

fn main() {
    println!("| True | Inliers, least | most | Effective, least | most | Median, µs | 99 of 100, µs |");
    println!("|---:|---:|---:|---:|---:|---:|---:|");
    [60, 0].into_iter().for_each(measure);
}

fn measure(moved: usize) {
    let (mut inliers, mut effective, mut times_us) = (Vec::new(), Vec::new(), Vec::new());
    let (mut verifier, mut found) = (Verifier::default(), Verification::default());
    for seed in 0..PAIRS_OF_IMAGES {
        found.correspondences = made_up::correspondences(moved, seed);
        let started = Instant::now();
        verifier.vote_and_verify([made_up::DIAGONAL_PX; 2], &VerificationOptions::default(), &mut found);
        times_us.push(started.elapsed().as_secs_f64() * 1e6);
        inliers.push(found.inliers.len());
        effective.push(found.effective_inliers);
    }
    inliers.sort_unstable();
    effective.sort_unstable();
    times_us.sort_by(f64::total_cmp);
    let last = times_us.len() - 1;
    println!(
        "| {moved} | {} | {} | {} | {} | {:.1} | {:.1} |",
        inliers[0],
        inliers[last],
        effective[0],
        effective[last],
        times_us[last / 2],
        times_us[last * 99 / 100]
    );
}
