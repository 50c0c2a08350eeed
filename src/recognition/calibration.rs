//! What effective inliers say of the chance of being right.

/// Slope and offset of the logistic that turns effective inliers into the probability of the same place:
/// fitted by maximum likelihood on the 7,556 candidates that BoW+HV alone verified in laps 2 and 3 of
/// eight synthetic drives (both worlds, seeds 31, 33, 34, 35, three laps at noon, dusk and night), a
/// candidate being right within two frames of sixty.
const INLIER_CALIBRATION: (f32, f32) = (0.377, -2.420);

/// Probability that two frames with so many effective inliers show the same place.
#[must_use]
pub fn inlier_probability(effective_inliers: u32) -> f32 {
    let (slope, offset) = INLIER_CALIBRATION;
    1.0 / (1.0 + (-(slope * effective_inliers as f32 + offset)).exp())
}

/// Probability that one of the candidates that were turned down is right all the same, from that of the
/// likeliest of each kind. Where geometry was asked it has the last word, since it is asked about what the
/// CNN left open.
#[must_use]
pub fn doubt(likeliest_by_cnn: Option<f32>, likeliest_by_bow_hv: Option<f32>) -> f32 {
    likeliest_by_bow_hv.or(likeliest_by_cnn).unwrap_or(0.0)
}
