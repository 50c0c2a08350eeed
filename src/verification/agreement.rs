//! Which correspondences agree with a transform: tested side by side, several at once.

use std::f32::consts::PI;
use std::mem;

use super::{Correspondence, VerificationOptions};
use crate::geometry::{Affine, Similarity};
use crate::kernel::for_every_processor;

/// Correspondences, number by number.
#[derive(Debug, Default)]
pub(super) struct Columns {
    query: [Vec<f32>; 2],
    keyframe: [Vec<f32>; 2],
    /// Cosine and sine of the angle by which each is turned.
    turn: [Vec<f32>; 2],
    /// By how much each is larger in the keyframe.
    growth: Vec<f32>,
    /// 1 for each that agrees with the transform that was asked about last, else 0.
    agree: Vec<u8>,
}

/// What agrees with a transform.
#[derive(Debug)]
struct Limits {
    keyframe_from_query: [f32; 6],
    query_from_keyframe: [f32; 6],
    max_keyframe_px_squared: f32,
    max_query_px_squared: f32,
    turn: [f32; 2],
    min_turn_cosine: f32,
    growths: [f32; 2],
}

impl Columns {
    /// From now on those of `pairs`, each of which alone speaks for one of the `transforms`.
    pub(super) fn fill(&mut self, pairs: &[Correspondence], transforms: &[Similarity]) {
        let write = |column: &mut Vec<f32>, value: fn(&Correspondence) -> f32| {
            column.clear();
            column.extend(pairs.iter().map(value));
        };
        let Self { query: [query_x, query_y], keyframe: [keyframe_x, keyframe_y], .. } = self;
        write(query_x, |pair| pair.query_point.point.x);
        write(query_y, |pair| pair.query_point.point.y);
        write(keyframe_x, |pair| pair.keyframe_point.point.x);
        write(keyframe_y, |pair| pair.keyframe_point.point.y);
        let [cosines, sines] = &mut self.turn;
        cosines.clear();
        sines.clear();
        self.growth.clear();
        for transform in transforms {
            let (sine, cosine) = transform.rotation_radians.sin_cos();
            cosines.push(cosine);
            sines.push(sine);
            self.growth.push(transform.scale);
        }
    }

    /// Writes over `inliers` the pairs that turn and grow as the transform does and whose transfer errors, to the
    /// keyframe and back, stay within `tolerances_px`.
    pub(super) fn inliers(
        &mut self,
        keyframe_from_query: &Affine,
        (tolerances_px, options): ([f32; 2], &VerificationOptions),
        inliers: &mut Vec<u32>,
    ) {
        inliers.clear();
        let Some(query_from_keyframe) = keyframe_from_query.inverse() else { return };
        let growth = keyframe_from_query.growth();
        let (sine, cosine) = keyframe_from_query.rotation_radians().sin_cos();
        let limits = Limits {
            keyframe_from_query: coefficients(keyframe_from_query),
            query_from_keyframe: coefficients(&query_from_keyframe),
            max_keyframe_px_squared: tolerances_px[0].powi(2),
            max_query_px_squared: tolerances_px[1].powi(2),
            turn: [cosine, sine],
            min_turn_cosine: min_cosine(options.max_turn_radians),
            growths: [growth / options.max_growth_ratio, growth * options.max_growth_ratio],
        };
        let mut agree = mem::take(&mut self.agree);
        agree.resize(self.growth.len(), 0);
        compare(self, &limits, &mut agree);
        // Most do not agree, and which do cannot be foreseen: every index is written, and some are kept.
        inliers.resize(agree.len(), 0);
        let mut count = 0;
        for (index, &agrees) in (0..).zip(&agree) {
            inliers[count] = index;
            count += usize::from(agrees);
        }
        inliers.truncate(count);
        self.agree = agree;
    }
}

/// The least cosine of angles up to so many radians; of half a turn on, any will do.
fn min_cosine(max_radians: f32) -> f32 {
    if max_radians < PI { max_radians.max(0.0).cos() } else { f32::NEG_INFINITY }
}

/// a, b, x, c, d and y of (x, y) ↦ (a·x + b·y + tx, c·x + d·y + ty).
fn coefficients(affine: &Affine) -> [f32; 6] {
    let [a, b, c, d] = affine.linear;
    [a, b, affine.translation.x, c, d, affine.translation.y]
}

for_every_processor! {
    /// Writes 1 where a correspondence is within the limits, else 0.
    fn compare(columns: &Columns, limits: &Limits, agree: &mut [u8]) = compare_all
}

#[inline(always)]
fn compare_all(columns: &Columns, limits: &Limits, agree: &mut [u8]) {
    let count = agree.len();
    let [qx, qy] = [&columns.query[0][..count], &columns.query[1][..count]];
    let [kx, ky] = [&columns.keyframe[0][..count], &columns.keyframe[1][..count]];
    let [cosines, sines] = [&columns.turn[0][..count], &columns.turn[1][..count]];
    let growths = &columns.growth[..count];
    for index in 0..count {
        let to = squared_error(&limits.keyframe_from_query, [qx[index], qy[index]], [kx[index], ky[index]]);
        let back = squared_error(&limits.query_from_keyframe, [kx[index], ky[index]], [qx[index], qy[index]]);
        let turn_cosine = limits.turn[0] * cosines[index] + limits.turn[1] * sines[index];
        agree[index] = u8::from(to <= limits.max_keyframe_px_squared)
            & u8::from(back <= limits.max_query_px_squared)
            & u8::from(turn_cosine >= limits.min_turn_cosine)
            & u8::from(growths[index] >= limits.growths[0])
            & u8::from(growths[index] <= limits.growths[1]);
    }
}

#[inline(always)]
fn squared_error(&[a, b, tx, c, d, ty]: &[f32; 6], [x, y]: [f32; 2], [u, v]: [f32; 2]) -> f32 {
    let (du, dv) = (a * x + b * y + tx - u, c * x + d * y + ty - v);
    du * du + dv * dv
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{OrientedPoint, Point, wrap_radians};
    use proptest::prelude::*;

    fn oriented_point() -> impl Strategy<Value = OrientedPoint> {
        (0.0..640.0_f32, 0.0..480.0_f32, 1.0..3.0_f32, -3.1..3.1_f32).prop_map(
            |(x, y, scale, angle_radians)| OrientedPoint { point: Point { x, y }, scale, angle_radians },
        )
    }

    /// Of pairs that each speak for one of the transforms, those that agree with one.
    fn inliers(
        pairs: &[Correspondence],
        transforms: &[Similarity],
        (transform, tolerances_px, options): (&Affine, [f32; 2], &VerificationOptions),
    ) -> Vec<u32> {
        let (mut columns, mut inliers) = (Columns::default(), Vec::new());
        columns.fill(pairs, transforms);
        columns.inliers(transform, (tolerances_px, options), &mut inliers);
        inliers
    }

    /// How far each limit is from being reached, as a share of it; negative where it is exceeded.
    fn margins(
        pair: &Correspondence,
        affine: &Affine,
        px: [f32; 2],
        options: &VerificationOptions,
    ) -> [f32; 4] {
        let (query, keyframe) = (pair.query_point, pair.keyframe_point);
        let to = affine.apply(query.point).distance_squared(keyframe.point).sqrt();
        let back = affine.inverse().unwrap().apply(keyframe.point).distance_squared(query.point).sqrt();
        let turn =
            wrap_radians(keyframe.angle_radians - query.angle_radians - affine.rotation_radians()).abs();
        let growth = (keyframe.scale / query.scale / affine.growth()).ln().abs();
        [
            1.0 - to / px[0],
            1.0 - back / px[1],
            1.0 - turn / options.max_turn_radians,
            1.0 - growth / options.max_growth_ratio.ln(),
        ]
    }

    proptest! {
        #[test]
        fn those_agree_that_are_within_every_limit(
            points in proptest::collection::vec((oriented_point(), oriented_point()), 1..100),
            from in oriented_point(), to in oriented_point(),
        ) {
            let affine = Affine::from(Similarity::between(from, to));
            // Wide limits, each of which some exceed and some do not.
            let (tolerances_px, options) =
                ([400.0, 300.0], VerificationOptions { max_turn_radians: 1.5, ..VerificationOptions::default() });
            let pair = |&(query_point, keyframe_point)| {
                Correspondence { query: 0, keyframe: 0, query_point, keyframe_point }
            };
            let pairs: Vec<Correspondence> = points.iter().map(pair).collect();
            let transforms: Vec<Similarity> = pairs.iter().map(Correspondence::transform).collect();
            let found = inliers(&pairs, &transforms, (&affine, tolerances_px, &options));
            for (index, pair) in (0..).zip(&pairs) {
                let least = margins(pair, &affine, tolerances_px, &options).into_iter().fold(1.0, f32::min);
                // At a limit, rounding decides.
                if least.abs() > 1e-3 {
                    prop_assert_eq!(found.contains(&index), least > 0.0, "{}", index);
                }
            }
        }
    }

    #[test]
    fn from_half_a_turn_on_features_may_be_turned_anyhow() {
        let point = |angle_radians| OrientedPoint { point: Point::default(), scale: 1.0, angle_radians };
        let pairs = [-3.0, -1.0, 0.0, 2.0, 3.1].map(|angle_radians| Correspondence {
            query: 0,
            keyframe: 0,
            query_point: point(0.0),
            keyframe_point: point(angle_radians),
        });
        let transforms = pairs.each_ref().map(|pair| pair.transform());
        let same = Affine { linear: [1.0, 0.0, 0.0, 1.0], translation: Point::default() };
        for (max_turn_radians, expected) in [(0.1, 1), (1.5, 2), (3.05, 4), (PI, 5), (7.0, 5)] {
            let options = VerificationOptions { max_turn_radians, ..VerificationOptions::default() };
            let found = inliers(&pairs, &transforms, (&same, [1.0; 2], &options));
            assert_eq!(found.len(), expected, "{max_turn_radians}");
        }
    }

    #[test]
    fn every_processor_finds_the_same_ones_agree() {
        let point = |seed: f32| OrientedPoint {
            point: Point { x: (seed * 97.0) % 640.0, y: (seed * 61.0) % 480.0 },
            scale: 1.0 + seed % 2.0,
            angle_radians: (seed * 0.7) % 3.0,
        };
        let pairs: Vec<Correspondence> = (0..101_u32)
            .map(|index| {
                let (query_point, keyframe_point) = (point(index as f32), point(index as f32 * 1.1));
                Correspondence { query: index, keyframe: index, query_point, keyframe_point }
            })
            .collect();
        let transforms: Vec<Similarity> = pairs.iter().map(Correspondence::transform).collect();
        let mut columns = Columns::default();
        columns.fill(&pairs, &transforms);
        let same = coefficients(&Affine { linear: [1.0, 0.0, 0.0, 1.0], translation: Point::default() });
        let limits = Limits {
            keyframe_from_query: same,
            query_from_keyframe: same,
            max_keyframe_px_squared: 40_000.0,
            max_query_px_squared: 40_000.0,
            turn: [1.0, 0.0],
            min_turn_cosine: 0.0,
            growths: [0.5, 2.0],
        };
        let [mut found, mut plain] = [vec![0; pairs.len()], vec![0; pairs.len()]];
        compare(&columns, &limits, &mut found);
        compare_all(&columns, &limits, &mut plain);
        assert_eq!(found, plain);
        assert!((10..90).contains(&plain.iter().map(|&agrees| u32::from(agrees)).sum::<u32>()));
    }
}
