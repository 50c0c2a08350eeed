//! Made-up correspondences, of which some are true: those move by one similarity transform, to within 0.7 px of their
//! pyramid level, 6° and 0.4 of a level (standard deviations); all lie anywhere, at any of eight levels.

use loci::geometry::{OrientedPoint, Point, Similarity, wrap_radians};
use loci::verification::Correspondence;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

const CORRESPONDENCES: usize = 200;
const SIZE_PX: [f32; 2] = [640.0, 480.0];
/// Of the image.
pub(crate) const DIAGONAL_PX: f32 = 800.0;
const LEVELS: i32 = 8;
const LEVEL_FACTOR: f32 = 1.2;

/// 200 correspondences, of which so many are true.
pub(crate) fn correspondences(moved: usize, seed: u64) -> Vec<Correspondence> {
    let random = &mut Pcg64::seed_from_u64(seed);
    let truth = transform(random);
    let mut pairs = Vec::with_capacity(CORRESPONDENCES);
    while pairs.len() < CORRESPONDENCES {
        let (query_level, query) = anywhere(random);
        let keyframe = if pairs.len() < moved {
            seen_from_there(query, query_level, &truth, random)
        } else {
            Some(anywhere(random).1)
        };
        let pair =
            |keyframe_point| Correspondence { query: 0, keyframe: 0, query_point: query, keyframe_point };
        pairs.extend(keyframe.map(pair));
    }
    pairs
}

/// A change of view about the image's centre.
fn transform(random: &mut Pcg64) -> Similarity {
    let (scale, rotation_radians) = (random.random_range(0.7..1.4), random.random_range(-0.4..0.4));
    let about_origin = Similarity { scale, rotation_radians, translation: Point::default() };
    let centre = Point { x: SIZE_PX[0] / 2.0, y: SIZE_PX[1] / 2.0 };
    let moved = about_origin.apply(centre);
    let mut shift = || random.random_range(-60.0..60.0_f32);
    let translation = Point { x: centre.x - moved.x + shift(), y: centre.y - moved.y + shift() };
    Similarity { translation, ..about_origin }
}

/// A feature anywhere, with its pyramid level.
fn anywhere(random: &mut Pcg64) -> (i32, OrientedPoint) {
    let [x, y] = SIZE_PX.map(|side| random.random_range(0.0..side));
    let level = random.random_range(0..LEVELS);
    let angle_radians = random.random_range(-3.1..3.1_f32);
    (level, OrientedPoint { point: Point { x, y }, scale: LEVEL_FACTOR.powi(level), angle_radians })
}

/// The feature as the other image shows it, if it does.
fn seen_from_there(
    feature: OrientedPoint,
    level: i32,
    truth: &Similarity,
    random: &mut Pcg64,
) -> Option<OrientedPoint> {
    let moved = truth.apply(feature.point);
    if !(0.0..SIZE_PX[0]).contains(&moved.x) || !(0.0..SIZE_PX[1]).contains(&moved.y) {
        return None;
    }
    // Twelve even numbers add up to nearly a normal one.
    let mut normal = || (0..12).map(|_| random.random_range(0.0..1.0_f32)).sum::<f32>() - 6.0;
    let level = level as f32 + truth.scale.log(LEVEL_FACTOR) + 0.4 * normal();
    let scale = LEVEL_FACTOR.powi((level.round() as i32).clamp(0, LEVELS - 1));
    let mut near = |pixels: f32| pixels + 0.7 * scale * normal();
    let point = Point { x: near(moved.x), y: near(moved.y) };
    let angle_radians = wrap_radians(feature.angle_radians + truth.rotation_radians + 0.1 * normal());
    Some(OrientedPoint { point, scale, angle_radians })
}
