//! Hough voting for a similarity transform (the paper's section III.A, eqs. 1–4).
//!
//! Every correspondence votes for the bin of its transform (x, y, log s, θ) at L resolutions; the bin
//! of a coarser level is the finer index halved. A finest bin scores
//! Σₗ 2^(−α l) · votes(bₗ), bₗ being the bin of level l that contains it (eq. 4).

use std::collections::HashMap;
use std::f32::consts::{PI, TAU};

use heapless::Vec as FixedVec;

use super::Correspondence;
use crate::geometry::{Point, Similarity};

/// Most hypotheses that are verified.
pub(super) const MAX_HYPOTHESES: usize = 10;

/// How the space of transforms is divided; COLMAP's values, with translations relative to the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoughOptions {
    /// Resolutions L; default 3.
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

/// A bin of the finest level: x, y, log s and θ indices.
type Bin = [u32; 4];

/// The mean transforms of the best bins with their votes (eq. 4), best first.
pub(super) fn hypotheses(
    correspondences: &[Correspondence],
    diagonal_px: f32,
    options: &HoughOptions,
) -> FixedVec<(f32, Similarity), MAX_HYPOTHESES> {
    let votes: Vec<(Bin, Similarity)> = correspondences
        .iter()
        .filter_map(|pair| {
            let transform = Similarity::between(pair.query_point, pair.keyframe_point);
            Some((bin_of(&transform, diagonal_px, options)?, transform))
        })
        .collect();
    let mut scored: Vec<(f32, Bin)> = scores(&votes, options).into_iter().map(|(bin, s)| (s, bin)).collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let best = scored.into_iter().take(MAX_HYPOTHESES);
    let of_bin = |bin| votes.iter().filter(move |vote| vote.0 == bin).map(|vote| vote.1);
    best.map(|(score, bin)| (score, mean_transform(of_bin(bin)))).collect()
}

/// The finest bin of `transform`; `None` out of range.
fn bin_of(transform: &Similarity, diagonal_px: f32, options: &HoughOptions) -> Option<Bin> {
    let index = |fraction: f32, bins: u32| {
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

/// Eq. 4 for every finest bin that got a vote.
fn scores(votes: &[(Bin, Similarity)], options: &HoughOptions) -> HashMap<Bin, f32> {
    let mut scores: HashMap<Bin, f32> = votes.iter().map(|vote| (vote.0, 0.0)).collect();
    for level in 0..options.levels {
        let coarse = |bin: &Bin| bin.map(|index| index >> level);
        let mut counts: HashMap<Bin, u32> = HashMap::new();
        for (bin, _) in votes {
            *counts.entry(coarse(bin)).or_default() += 1;
        }
        let weight = (-options.level_decay * level as f32).exp2();
        for (bin, score) in &mut scores {
            *score += weight * counts[&coarse(bin)] as f32;
        }
    }
    scores
}

/// The mean of translations and log scales, and the circular mean of angles.
fn mean_transform(transforms: impl Iterator<Item = Similarity> + Clone) -> Similarity {
    let count = transforms.clone().count().max(1) as f32;
    let mean = |value: fn(&Similarity) -> f32| transforms.clone().map(|t| value(&t)).sum::<f32>() / count;
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
    fn score_by_definition(votes: &[(Bin, Similarity)], bin: Bin, options: &HoughOptions) -> f32 {
        let mut score = 0.0;
        for level in 0..options.levels {
            let same = votes.iter().filter(|vote| (0..4).all(|d| vote.0[d] >> level == bin[d] >> level));
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
        ) {
            let options = HoughOptions::default();
            let votes: Vec<(Bin, Similarity)> = raw.iter().map(|&(x, y, s, r)| {
                let vote = transform(x, y, s, r);
                (bin_of(&vote, 500.0, &options).unwrap(), vote)
            }).collect();
            for (bin, score) in scores(&votes, &options) {
                prop_assert!((score - score_by_definition(&votes, bin, &options)).abs() < 1e-4);
            }
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
        assert!(mean_transform(turned.into_iter()).rotation_radians.abs() > 3.0);
    }
}
