//! Vote-and-verify: from the best Hough hypotheses to a count of inliers that can be trusted.
//!
//! A hypothesis, the mean of a coarse bin, is checked loosely; its inliers refit an affine transform,
//! which is checked tightly. Loose voting keeps the true pairs, the tight count rejects the false. What agrees is not
//! only where a feature is, but also which way it is turned and how large it is, as in the voting.
//! Inliers crowded on one object prove little, so what counts are *effective* inliers: the cells of
//! a grid over both images that hold at least one.

use std::mem;

use super::agreement::Columns;
use super::correspondence::Matcher;
use super::hough::{Ballot, HoughOptions};
use super::{Correspondence, MatchingOptions, MatchingView};
use crate::geometry::{Affine, Point, Similarity};

/// Fewest correspondences from which an affine transform is fitted; three would always fit.
const MIN_FIT: usize = 6;

/// Tolerances of the verification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VerificationOptions {
    /// Which descriptors correspond.
    pub matching: MatchingOptions,
    /// How the transforms are binned.
    pub hough: HoughOptions,
    /// Two-way transfer error within which a hypothesis is supported, as a share of the image
    /// diagonal; default 0.05.
    pub loose_tolerance: f32,
    /// The same for the refitted transform; default 0.015.
    pub tight_tolerance: f32,
    /// Largest angle in radians by which a feature may be turned otherwise than the transform turns it, π for any;
    /// default 0.6.
    pub max_turn_radians: f32,
    /// Largest ratio, either way and so at least 1, of how a feature grew to how the transform makes it grow;
    /// default 2.
    pub max_growth_ratio: f32,
    /// Largest change of area between the images, either way; default 6.
    pub max_area_ratio: f32,
    /// Cells along each side of the grid that effective inliers are counted in; default 24.
    pub grid_cells: usize,
}

impl Default for VerificationOptions {
    fn default() -> Self {
        Self {
            matching: MatchingOptions::default(),
            hough: HoughOptions::default(),
            loose_tolerance: 0.05,
            tight_tolerance: 0.015,
            max_turn_radians: 0.6,
            max_growth_ratio: 2.0,
            max_area_ratio: 6.0,
            grid_cells: 24,
        }
    }
}

/// What verification found between a query image and a keyframe.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verification {
    /// All correspondences that were tried.
    pub correspondences: Vec<Correspondence>,
    /// Indices into `correspondences` of those that agree with the best transform.
    pub inliers: Vec<u32>,
    /// Effective inliers: occupied grid cells, the smaller count of the two images.
    pub effective_inliers: u32,
    /// Votes of the hypothesis that became the best transform (eq. 4); 0 if none held.
    pub votes: f32,
    /// The transform from the query image to the keyframe, if any hypothesis held.
    pub keyframe_from_query: Option<Affine>,
}

impl Verification {
    /// Forgets what was found of the correspondences, but for its memory.
    fn begin(&mut self) {
        self.inliers.clear();
        (self.effective_inliers, self.votes, self.keyframe_from_query) = (0, 0.0, None);
    }
}

/// Verifies one pair of images after the other, and keeps its memory.
#[derive(Debug, Default)]
pub struct Verifier {
    matcher: Matcher,
    /// What each correspondence alone says.
    transforms: Vec<Similarity>,
    ballot: Ballot,
    columns: Columns,
    /// What agrees with the hypothesis in hand.
    inliers: Vec<u32>,
    /// Where the inliers are.
    cells: Vec<(i32, i32)>,
}

/// Verifies that `query` and `keyframe` show the same scene.
#[must_use]
pub fn verify(
    query: MatchingView<'_>,
    keyframe: MatchingView<'_>,
    options: &VerificationOptions,
) -> Verification {
    let mut found = Verification::default();
    Verifier::default().verify((query, keyframe), options, &mut found);
    found
}

impl Verifier {
    /// Verifies that `query` and `keyframe` show the same scene; the answer is written over what is in `found`.
    pub fn verify(
        &mut self,
        (query, keyframe): (MatchingView<'_>, MatchingView<'_>),
        options: &VerificationOptions,
        found: &mut Verification,
    ) {
        self.matcher.pair((query, keyframe), &options.matching, &mut found.correspondences);
        self.vote_and_verify([query, keyframe].map(|view| view.features.diagonal_px()), options, found);
    }

    /// Verifies that the correspondences in `found` agree with one transform of the query image into the keyframe;
    /// their diagonals are in pixels. The answer is written over what else is in `found`.
    pub fn vote_and_verify(
        &mut self,
        [query_diagonal_px, keyframe_diagonal_px]: [f32; 2],
        options: &VerificationOptions,
        found: &mut Verification,
    ) {
        found.begin();
        // So that no later pair of images needs more, whichever of the two lists is handed out.
        self.inliers.clear();
        self.inliers.reserve(found.correspondences.capacity());
        found.inliers.reserve(found.correspondences.capacity());
        let pairs = &found.correspondences;
        if pairs.len() < MIN_FIT {
            return;
        }
        self.transforms.clear();
        self.transforms.extend(pairs.iter().map(Correspondence::transform));
        self.columns.fill(pairs, &self.transforms);
        let (columns, inliers) = (&mut self.columns, &mut self.inliers);
        let mut check = Check { pairs, columns, inliers, query_diagonal_px, keyframe_diagonal_px, options };
        let diagonal_px = query_diagonal_px.max(keyframe_diagonal_px);
        for hypothesis in self.ballot.hypotheses(&self.transforms, diagonal_px, &options.hough) {
            // The votes for one transform fall into several bins: it is taken for that one, and not refined from each.
            if hypothesis.pairs().all(|pair| found.inliers.binary_search(&pair).is_ok()) {
                continue;
            }
            // Of equally good hypotheses the first, which got more votes.
            if let Some(transform) = check.refine(hypothesis.transform.into())
                && check.inliers.len() > found.inliers.len()
            {
                mem::swap(check.inliers, &mut found.inliers);
                (found.votes, found.keyframe_from_query) = (hypothesis.score, Some(transform));
            }
        }
        found.effective_inliers = check.effective(&found.inliers, &mut self.cells);
    }
}

/// One pair of images under verification.
struct Check<'a> {
    pairs: &'a [Correspondence],
    columns: &'a mut Columns,
    /// What agrees with the transform in hand.
    inliers: &'a mut Vec<u32>,
    query_diagonal_px: f32,
    keyframe_diagonal_px: f32,
    options: &'a VerificationOptions,
}

impl Check<'_> {
    /// Refits `hypothesis` to its inliers, first loosely, then halfway, then tightly, and counts tightly: answers the
    /// transform if enough agree, and leaves them in `inliers`.
    fn refine(&mut self, hypothesis: Affine) -> Option<Affine> {
        self.agree(&hypothesis, self.options.loose_tolerance);
        let halfway = (self.options.loose_tolerance + self.options.tight_tolerance) / 2.0;
        let mut transform = self.fit()?;
        for tolerance in [halfway, self.options.tight_tolerance] {
            self.agree(&transform, tolerance);
            transform = self.fit()?;
        }
        self.agree(&transform, self.options.tight_tolerance);
        (self.inliers.len() >= MIN_FIT).then_some(transform)
    }

    /// The transform that fits the inliers best, if cameras that see one scene may differ so.
    fn fit(&self) -> Option<Affine> {
        let fitted = fit_affine(self.inliers.iter().map(|&index| &self.pairs[index as usize]))?;
        let ratio = fitted.determinant();
        let max = self.options.max_area_ratio;
        // A negative ratio is a mirror image, which no camera motion makes.
        (ratio >= 1.0 / max && ratio <= max).then_some(fitted)
    }

    /// Finds the pairs that agree with the transform within `tolerance` of the image diagonals.
    fn agree(&mut self, keyframe_from_query: &Affine, tolerance: f32) {
        let tolerances_px = [self.keyframe_diagonal_px, self.query_diagonal_px].map(|px| tolerance * px);
        self.columns.inliers(keyframe_from_query, (tolerances_px, self.options), self.inliers);
    }

    fn effective(&self, inliers: &[u32], cells: &mut Vec<(i32, i32)>) -> u32 {
        let pairs = || inliers.iter().map(|&index| &self.pairs[index as usize]);
        let side = self.options.grid_cells as f32;
        let (query_px, keyframe_px) = (self.query_diagonal_px / side, self.keyframe_diagonal_px / side);
        let in_query = occupied(pairs().map(|pair| pair.query_point.point), query_px, cells);
        let in_keyframe = occupied(pairs().map(|pair| pair.keyframe_point.point), keyframe_px, cells);
        in_query.min(in_keyframe)
    }
}

/// How many cells of `cell_px` hold at least one of the points; which do is written over what is in `cells`.
fn occupied(points: impl Iterator<Item = Point>, cell_px: f32, cells: &mut Vec<(i32, i32)>) -> u32 {
    cells.clear();
    cells.extend(points.map(|point| ((point.x / cell_px) as i32, (point.y / cell_px) as i32)));
    cells.sort_unstable();
    cells.dedup();
    cells.len() as u32
}

/// The affine transform from query to keyframe points with the least sum of squared errors; `None`
/// for too few points or points on a line.
fn fit_affine<'a>(pairs: impl Iterator<Item = &'a Correspondence> + Clone) -> Option<Affine> {
    let count = pairs.clone().count();
    if count < MIN_FIT {
        return None;
    }
    let mean = |value: fn(&Correspondence) -> f32| {
        pairs.clone().map(|pair| f64::from(value(pair))).sum::<f64>() / count as f64
    };
    let (qx, qy) = (mean(|p| p.query_point.point.x), mean(|p| p.query_point.point.y));
    let (kx, ky) = (mean(|p| p.keyframe_point.point.x), mean(|p| p.keyframe_point.point.y));
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    let (mut ux, mut uy, mut vx, mut vy) = (0.0, 0.0, 0.0, 0.0);
    for pair in pairs {
        let (x, y) = (f64::from(pair.query_point.point.x) - qx, f64::from(pair.query_point.point.y) - qy);
        let (u, v) =
            (f64::from(pair.keyframe_point.point.x) - kx, f64::from(pair.keyframe_point.point.y) - ky);
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        (ux, uy, vx, vy) = (ux + u * x, uy + u * y, vx + v * x, vy + v * y);
    }
    let determinant = xx * yy - xy * xy;
    // Points on a line leave the transform across it open.
    if determinant <= 1e-6 * (xx + yy) * (xx + yy) {
        return None;
    }
    let row = |x: f64, y: f64| ((x * yy - y * xy) / determinant, (y * xx - x * xy) / determinant);
    let ((a, b), (c, d)) = (row(ux, uy), row(vx, vy));
    Some(Affine {
        linear: [a as f32, b as f32, c as f32, d as f32],
        translation: Point { x: (kx - a * qx - b * qy) as f32, y: (ky - c * qx - d * qy) as f32 },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::{Descriptor, Features, Keypoint};
    use crate::geometry::wrap_radians;
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    /// A random scene of 200 features, and the same scene under `transform` where so many of them really moved so and
    /// the rest went anywhere.
    fn scene(transform: Similarity, moved: usize, seed: u64) -> (Features, Features) {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut query = Features { width_px: 640, height_px: 480, ..Features::default() };
        let mut keyframe = query.clone();
        for feature in 0..200 {
            let point = Point { x: random.random_range(0.0..640.0), y: random.random_range(0.0..480.0) };
            let keypoint = Keypoint { point, scale: 1.0, angle_radians: 0.3, response: 30 };
            let moved = if feature < moved {
                Keypoint {
                    point: transform.apply(point),
                    scale: transform.scale,
                    angle_radians: wrap_radians(0.3 + transform.rotation_radians),
                    response: 30,
                }
            } else {
                let point = Point { x: random.random_range(0.0..640.0), y: random.random_range(0.0..480.0) };
                Keypoint { point, angle_radians: random.random_range(-3.0..3.0), ..keypoint }
            };
            let descriptor = Descriptor(random.random());
            query.keypoints.push(keypoint);
            query.descriptors.push(descriptor);
            keyframe.keypoints.push(moved);
            keyframe.descriptors.push(descriptor);
        }
        (query, keyframe)
    }

    fn verified(query: &Features, keyframe: &Features) -> Verification {
        let groups = vec![0; query.len()];
        let view = |features| MatchingView { features, groups: &groups };
        verify(view(query), view(keyframe), &VerificationOptions::default())
    }

    proptest! {
        #[test]
        fn a_seen_place_is_verified_from_a_third_of_true_pairs(
            x in -60.0..60.0_f32, y in -60.0..60.0_f32, scale in 0.7..1.4_f32, turn in -0.4..0.4_f32, seed in 0..50_u64,
        ) {
            let transform = Similarity { scale, rotation_radians: turn, translation: Point { x, y } };
            let (query, keyframe) = scene(transform, 60, seed);
            let verification = verified(&query, &keyframe);
            prop_assert!(verification.inliers.len() >= 50, "{}", verification.inliers.len());
            let found = verification.keyframe_from_query.unwrap();
            let centre = Point { x: 320.0, y: 240.0 };
            prop_assert!(found.apply(centre).distance_squared(transform.apply(centre)) < 36.0);
        }

        #[test]
        fn unrelated_images_are_not(seed in 0..200_u64) {
            let nowhere = Similarity { scale: 1.0, rotation_radians: 0.0, translation: Point::default() };
            let (query, keyframe) = scene(nowhere, 0, seed);
            prop_assert!(verified(&query, &keyframe).effective_inliers <= 3);
        }
    }

    #[test]
    fn inliers_crowded_in_one_corner_count_as_few() {
        let same = Similarity { scale: 1.0, rotation_radians: 0.0, translation: Point::default() };
        let (mut query, _) = scene(same, 200, 1);
        for keypoint in &mut query.keypoints {
            keypoint.point = Point { x: keypoint.point.x / 20.0, y: keypoint.point.y / 20.0 };
        }
        let verification = verified(&query, &query);
        assert_eq!(verification.inliers.len(), 200);
        assert!(verification.effective_inliers <= 4, "{}", verification.effective_inliers);
    }

    #[test]
    fn images_without_features_or_on_one_line_are_not_verified() {
        assert_eq!(verified(&Features::default(), &Features::default()), Verification::default());
        let same = Similarity { scale: 1.0, rotation_radians: 0.0, translation: Point::default() };
        let (mut line, _) = scene(same, 200, 1);
        for keypoint in &mut line.keypoints {
            keypoint.point.y = 100.0;
        }
        assert_eq!(verified(&line, &line).effective_inliers, 0);
    }
}
