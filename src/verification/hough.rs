//! Hough voting for a similarity transform (the paper's section III.A, eqs. 1–4).
//!
//! Every correspondence votes for the bin of its transform (x, y, log s, θ) at L resolutions; the bin
//! of a coarser level is the finer index halved. A finest bin scores
//! Σₗ 2^(−α l) · votes(bₗ), bₗ being the bin of level l that contains it (eq. 4).

use std::f32::consts::{PI, TAU};

use heapless::Vec as FixedVec;

use crate::geometry::{Point, Similarity};

/// Most hypotheses that are verified.
pub(super) const MAX_HYPOTHESES: usize = 10;

/// How the space of transforms is divided, into 256 bins an axis at most; COLMAP's values, with translations relative
/// to the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoughOptions {
    /// Resolutions L, at most 8; default 3.
    pub levels: u32,
    /// α of eq. 4: a level weighs 2^(−α l); default 1.
    pub level_decay: f32,
    /// Bins along x and along y over ± one image diagonal at the finest level; default 64.
    pub translation_bins: u32,
    /// Bins of log s over ± log 10 at the finest level; default 32.
    pub scale_bins: u32,
    /// Bins of θ over one turn at the finest level; default 8.
    pub rotation_bins: u32,
}

impl Default for HoughOptions {
    fn default() -> Self {
        Self { levels: 3, level_decay: 1.0, translation_bins: 64, scale_bins: 32, rotation_bins: 8 }
    }
}

const MAX_LOG_SCALE: f32 = std::f32::consts::LN_10;

/// Most bins an axis, so that an index has so many bits.
const MOST_BINS: u32 = 1 << INDEX_BITS;
const INDEX_BITS: u32 = 8;

/// A bin of the finest level: x, y, log s and θ indices.
type Bin = [u32; 4];

/// A transform that many vote for.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Hypothesis<'a> {
    /// Eq. 4.
    pub(super) score: f32,
    /// The mean of its bin.
    pub(super) transform: Similarity,
    /// The ranks of its votes.
    bin: &'a [u64],
}

impl Hypothesis<'_> {
    /// Indices of the transforms in its bin.
    pub(super) fn pairs(&self) -> impl Iterator<Item = u32> + Clone {
        votes(self.bin)
    }
}

/// Counts votes, and keeps its memory for the next ones.
#[derive(Debug, Default)]
pub(super) struct Ballot {
    /// Of every vote the path to its bin, and behind that its index.
    ranks: Vec<u64>,
    /// Eq. 4 of the bin of every vote.
    scores: Vec<f32>,
}

impl Ballot {
    /// The hypotheses of the best bins, best first, where every correspondence votes for the transform that it speaks
    /// for.
    pub(super) fn hypotheses(
        &mut self,
        transforms: &[Similarity],
        diagonal_px: f32,
        options: &HoughOptions,
    ) -> FixedVec<Hypothesis<'_>, MAX_HYPOTHESES> {
        let Self { ranks, scores } = self;
        let paths = Paths::new(options.levels);
        let rank = |(vote, transform): (u32, &Similarity)| {
            let bin = bin_of(transform, diagonal_px, options)?;
            Some(u64::from(paths.to(bin)) << u32::BITS | u64::from(vote))
        };
        ranks.clear();
        ranks.extend((0..).zip(transforms).filter_map(rank));
        ranks.sort_unstable();
        let mut best: FixedVec<(f32, &[u64]), MAX_HYPOTHESES> = FixedVec::new();
        for (score, bin) in scored(ranks, options, scores) {
            // Of bins that score the same those come first whose paths do.
            let position = best.partition_point(|kept| kept.0 >= score);
            if position < MAX_HYPOTHESES {
                if best.is_full() {
                    best.pop();
                }
                // Cannot fail: there is room, and the position lies within.
                let _ = best.insert(position, (score, bin));
            }
        }
        let hypothesis = |(score, bin)| {
            let transform = mean_transform(votes(bin).map(|vote| &transforms[vote as usize]));
            Hypothesis { score, transform, bin }
        };
        best.into_iter().map(hypothesis).collect()
    }
}

/// The votes of these ranks.
fn votes(bin: &[u64]) -> impl Iterator<Item = u32> + Clone {
    bin.iter().map(|&rank| rank as u32)
}

/// Paths to bins: the indices of the coarsest bin, and behind them one bit an axis for every finer level. So, of votes
/// that are sorted by their paths, those of one bin stand side by side, on every level.
struct Paths {
    /// Levels below the coarsest.
    finer: u32,
    /// What the finer bits of an index are in a path, the last axis'.
    spread: [u32; 1 << (INDEX_BITS - 1)],
}

impl Paths {
    fn new(levels: u32) -> Self {
        let finer = levels.clamp(1, INDEX_BITS) - 1;
        let bit = |index: usize, level: u32| (index as u32 >> level & 1) << (4 * level);
        let spread = std::array::from_fn(|index| (0..finer).fold(0, |path, level| path | bit(index, level)));
        Self { finer, spread }
    }

    #[inline]
    fn to(&self, bin: Bin) -> u32 {
        let [mut coarse, mut fine] = [0, 0];
        for index in bin {
            coarse = coarse << (INDEX_BITS - self.finer) | index >> self.finer;
            fine = fine << 1 | self.spread[(index & ((1 << self.finer) - 1)) as usize];
        }
        coarse << (4 * self.finer) | fine
    }
}

/// The finest bin of `transform`; `None` out of range.
fn bin_of(transform: &Similarity, diagonal_px: f32, options: &HoughOptions) -> Option<Bin> {
    let index = |fraction: f32, bins: u32| {
        let bins = bins.clamp(1, MOST_BINS);
        (0.0..1.0).contains(&fraction).then(|| ((fraction * bins as f32) as u32).min(bins - 1))
    };
    let along = |pixels: f32| (pixels / diagonal_px + 1.0) / 2.0;
    Some([
        index(along(transform.translation.x), options.translation_bins)?,
        index(along(transform.translation.y), options.translation_bins)?,
        index((transform.scale.ln() / MAX_LOG_SCALE + 1.0) / 2.0, options.scale_bins)?,
        index((transform.rotation_radians + PI) / TAU, options.rotation_bins)?,
    ])
}

/// Eq. 4 for every finest bin that got a vote, with the ranks of its votes, which are sorted. The score of every vote
/// is written over what is in `scores`.
fn scored<'a>(
    ranks: &'a [u64],
    options: &HoughOptions,
    scores: &mut Vec<f32>,
) -> impl Iterator<Item = (f32, &'a [u64])> {
    scores.clear();
    scores.resize(ranks.len(), 0.0);
    for level in 0..options.levels.min(INDEX_BITS) {
        let weight = (-options.level_decay * level as f32).exp2();
        let finer_bits = u32::BITS + 4 * level;
        let mut first = 0;
        for bin in ranks.chunk_by(|one, next| one >> finer_bits == next >> finer_bits) {
            let last = first + bin.len();
            scores[first..last].iter_mut().for_each(|score| *score += weight * bin.len() as f32);
            first = last;
        }
    }
    let bins = ranks.chunk_by(|one, next| one >> u32::BITS == next >> u32::BITS);
    bins.scan(0, move |first, bin| {
        let score = scores[*first];
        *first += bin.len();
        Some((score, bin))
    })
}

/// The mean of translations and log scales, and the circular mean of angles.
fn mean_transform<'a>(transforms: impl Iterator<Item = &'a Similarity> + Clone) -> Similarity {
    let count = transforms.clone().count().max(1) as f32;
    let mean = |value: fn(&Similarity) -> f32| transforms.clone().map(value).sum::<f32>() / count;
    Similarity {
        scale: mean(|t| t.scale.ln()).exp(),
        rotation_radians: mean(|t| t.rotation_radians.sin()).atan2(mean(|t| t.rotation_radians.cos())),
        translation: Point { x: mean(|t| t.translation.x), y: mean(|t| t.translation.y) },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn transform(x: f32, y: f32, scale: f32, rotation_radians: f32) -> Similarity {
        Similarity { scale, rotation_radians, translation: Point { x, y } }
    }

    /// Eq. 4 word for word: at each level count the votes whose coarse bin is the same.
    fn score_by_definition(bins: &[Bin], bin: Bin, options: &HoughOptions) -> f32 {
        let mut score = 0.0;
        for level in 0..options.levels {
            let same = bins.iter().filter(|other| (0..4).all(|d| other[d] >> level == bin[d] >> level));
            score += 2.0_f32.powf(-options.level_decay * level as f32) * same.count() as f32;
        }
        score
    }

    proptest! {
        #[test]
        fn scores_equal_equation_4(
            raw in proptest::collection::vec(
                (-400.0..400.0_f32, -400.0..400.0_f32, 0.2..5.0_f32, -3.1..3.1_f32), 1..40,
            ),
            levels in 1..=INDEX_BITS,
        ) {
            let options = HoughOptions { levels, ..HoughOptions::default() };
            let transforms: Vec<Similarity> = raw.iter().map(|&(x, y, s, r)| transform(x, y, s, r)).collect();
            let bins: Vec<Bin> = transforms.iter().map(|t| bin_of(t, 500.0, &options).unwrap()).collect();
            let paths = Paths::new(levels);
            let rank = |(vote, &bin): (u64, &Bin)| u64::from(paths.to(bin)) << u32::BITS | vote;
            let mut ranks: Vec<u64> = (0..).zip(&bins).map(rank).collect();
            ranks.sort_unstable();
            let mut seen = 0;
            for (score, of_bin) in scored(&ranks, &options, &mut Vec::new()) {
                let votes: Vec<usize> = votes(of_bin).map(|vote| vote as usize).collect();
                let bin = bins[votes[0]];
                let same: Vec<usize> = (0..bins.len()).filter(|&vote| bins[vote] == bin).collect();
                prop_assert_eq!(&votes, &same);
                prop_assert!((score - score_by_definition(&bins, bin, &options)).abs() < 1e-4);
                seen += votes.len();
            }
            prop_assert_eq!(seen, raw.len());
        }
    }

    #[test]
    fn votes_out_of_range_are_dropped() {
        let options = HoughOptions::default();
        assert!(bin_of(&transform(501.0, 0.0, 1.0, 0.0), 500.0, &options).is_none());
        assert!(bin_of(&transform(0.0, 0.0, 11.0, 0.0), 500.0, &options).is_none());
        assert!(bin_of(&transform(0.0, 0.0, f32::NAN, 0.0), 500.0, &options).is_none());
    }

    #[test]
    fn angles_around_half_a_turn_do_not_average_to_zero() {
        let turned = [transform(0.0, 0.0, 1.0, 3.1), transform(0.0, 0.0, 1.0, -3.1)];
        assert!(mean_transform(turned.iter()).rotation_radians.abs() > 3.0);
    }
}
