//! What a cosine means: how likely two descriptors show one place, and above which cosine that is taken for granted.

/// Share of the frames of other places that may lie above the threshold.
const FALSE_ACCEPTS: f64 = 0.005;
/// Steps of Newton's method; it settles in fewer.
const STEPS: usize = 40;
/// Keeps the slope finite where cosines of both kinds do not overlap.
const RIDGE: f64 = 1e-3;

/// P(same place | cosine) = 1 / (1 + e^−(slope · cosine + offset)), and the threshold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Slope of the logistic; not negative.
    pub slope: f64,
    /// Offset of the logistic.
    pub offset: f64,
    /// Cosine above which one in two hundred frames of other places lies at most.
    pub threshold: f64,
}

impl Calibration {
    /// Fits the logistic to the cosines of the best matches within one place and with any other, both kinds counting
    /// the same; nothing if one kind is missing.
    #[must_use]
    pub fn fit(same: &[f32], other: &[f32]) -> Option<Self> {
        let mut sorted = other.to_vec();
        sorted.sort_unstable_by(f32::total_cmp);
        let allowed = (sorted.len() as f64 * FALSE_ACCEPTS) as usize;
        let threshold = f64::from(*sorted.get(sorted.len().checked_sub(allowed + 1)?)?);
        let weighed = |cosines: &[f32], is_same: f64| -> Vec<(f64, f64, f64)> {
            let weight = 1.0 / cosines.len() as f64;
            cosines.iter().map(|&cosine| (f64::from(cosine), is_same, weight)).collect()
        };
        if same.is_empty() {
            return None;
        }
        let (slope, offset) = logistic(&[weighed(same, 1.0), weighed(other, 0.0)].concat());
        Some(Self { slope: slope.max(0.0), offset, threshold })
    }
}

/// Slope and offset by Newton's method from (cosine, 0 or 1, weight).
fn logistic(cases: &[(f64, f64, f64)]) -> (f64, f64) {
    let (mut slope, mut offset) = (0.0, 0.0);
    for _ in 0..STEPS {
        let (mut by_slope, mut by_offset) = (-RIDGE * slope, 0.0);
        let (mut a, mut b, mut c) = (RIDGE, 0.0, 1e-9);
        for &(cosine, is_same, weight) in cases {
            let likely = 1.0 / (1.0 + (-(slope * cosine + offset)).exp());
            let (error, curve) = (weight * (is_same - likely), weight * likely * (1.0 - likely));
            by_slope += error * cosine;
            by_offset += error;
            a += curve * cosine * cosine;
            b += curve * cosine;
            c += curve;
        }
        let determinant = a * c - b * b;
        if determinant <= f64::EPSILON {
            break;
        }
        slope += (c * by_slope - b * by_offset) / determinant;
        offset += (a * by_offset - b * by_slope) / determinant;
    }
    (slope, offset)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cosine_between_both_kinds_is_as_likely_the_one_as_the_other() {
        let same: Vec<f32> = (0..100_u8).map(|index| 0.6 + f32::from(index) * 0.004).collect();
        let other: Vec<f32> = (0..100_u8).map(|index| 0.3 + f32::from(index) * 0.004).collect();
        let Calibration { slope, offset, .. } = Calibration::fit(&same, &other).unwrap();
        let likely = |cosine: f64| 1.0 / (1.0 + (-(slope * cosine + offset)).exp());
        assert!((likely(0.65) - 0.5).abs() < 0.02, "{}", likely(0.65));
        assert!(likely(0.9) > 0.9 && likely(0.4) < 0.1, "{} {}", likely(0.9), likely(0.4));
    }

    #[test]
    fn one_in_two_hundred_of_the_others_lies_above_the_threshold() {
        let other: Vec<f32> = (0..1000_u16).map(|index| f32::from(index) / 1000.0).collect();
        let Calibration { threshold, .. } = Calibration::fit(&[0.99], &other).unwrap();
        assert_eq!(other.iter().filter(|&&cosine| f64::from(cosine) > threshold).count(), 5);
        let few = Calibration::fit(&[0.9], &[0.1, 0.4, 0.2]).unwrap();
        assert!((few.threshold - 0.4).abs() < 1e-6, "of few, none");
    }

    #[test]
    fn nothing_is_fitted_to_nothing_and_cosines_apart_stay_finite() {
        assert_eq!(Calibration::fit(&[], &[0.5]), None);
        assert_eq!(Calibration::fit(&[0.5], &[]), None);
        let apart = Calibration::fit(&[1.0; 50], &[0.0; 50]).unwrap();
        assert!(apart.slope.is_finite() && apart.slope > 5.0 && apart.offset.is_finite());
        let upside_down = Calibration::fit(&[0.1; 50], &[0.9; 50]).unwrap();
        assert_eq!(upside_down.slope, 0.0);
    }
}
