//! The order of scores.

/// `score` as it is ranked: NaN says nothing, and is the lowest; the two zeros are equal.
pub(super) fn rankable(score: f64) -> f64 {
    if score.is_nan() { f64::NEG_INFINITY } else { score + 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_is_the_lowest_and_the_zeros_are_equal() {
        assert!(rankable(f64::NAN) < rankable(f64::MIN));
        assert!(rankable(-0.0).total_cmp(&rankable(0.0)).is_eq());
        assert_eq!(rankable(-0.25), -0.25);
    }
}
