//! A number computed from samples, with the 95 % interval in which the truth is to be expected: the percentile
//! bootstrap of Efron (1979, "Bootstrap methods: another look at the jackknife").

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde::Serialize;

use super::latency::quantile;

/// Resamples of a bootstrap: the 5th smallest and the 195th bound its interval.
const RESAMPLES: usize = 200;
/// Any number will do, so long as it stays: the same samples must give the same interval.
const SEED: u64 = 95;

/// A number computed from samples.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The number.
    pub value: f64,
    /// Samples it was computed from.
    pub n: u64,
    /// Lower end of its 95 % bootstrap interval.
    pub low: f64,
    /// Upper end of its 95 % bootstrap interval.
    pub high: f64,
}

impl Estimate {
    /// The `statistic` of `samples` with its percentile bootstrap interval; the same samples in the same
    /// order give the same interval.
    ///
    /// `None` where there are no samples or the statistic has no value; resamples on which it has none
    /// (one without any unknown frame, say) are left out. Where the statistic leans to one side on
    /// resamples, as calibration errors do, the interval is widened to hold the value.
    #[must_use]
    pub fn bootstrap<T: Clone>(samples: &[T], statistic: impl Fn(&[T]) -> Option<f64>) -> Option<Self> {
        if samples.is_empty() {
            return None;
        }
        let value = statistic(samples)?;
        let mut random = Pcg64::seed_from_u64(SEED);
        let mut resample = Vec::with_capacity(samples.len());
        let resampled = (0..RESAMPLES).filter_map(|_| {
            resample.clear();
            resample.extend(samples.iter().map(|_| samples[random.random_range(0..samples.len())].clone()));
            statistic(&resample)
        });
        let (low, high) = percentile_interval(resampled.collect(), value);
        Some(Self { value, n: samples.len() as u64, low, high })
    }
}

/// The middle 95 % of `resampled`, widened to hold `value`.
fn percentile_interval(mut resampled: Vec<f64>, value: f64) -> (f64, f64) {
    resampled.sort_unstable_by(f64::total_cmp);
    let low = quantile(&resampled, 0.025).unwrap_or(value);
    let high = quantile(&resampled, 0.975).unwrap_or(value);
    (low.min(value), high.max(value))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::proportion::Proportion;

    fn mean(samples: &[f64]) -> Option<f64> {
        Some(samples.iter().sum::<f64>() / samples.len() as f64)
    }

    #[test]
    fn of_200_resamples_the_5th_and_the_195th_bound_the_interval() {
        let resampled: Vec<f64> = (1..=200).rev().map(f64::from).collect();
        assert_eq!(percentile_interval(resampled.clone(), 100.0), (5.0, 195.0));
        assert_eq!(percentile_interval(resampled.clone(), 2.0), (2.0, 195.0));
        assert_eq!(percentile_interval(resampled, 199.0), (5.0, 199.0));
        assert_eq!(percentile_interval(Vec::new(), 7.0), (7.0, 7.0));
    }

    #[test]
    fn the_bootstrap_of_a_share_agrees_with_wilson() {
        let samples: Vec<f64> = (0..2_000).map(|i| f64::from(u8::from(i % 4 == 0))).collect();
        let estimate = Estimate::bootstrap(&samples, mean).unwrap();
        let wilson = Proportion::new(500, 2_000).unwrap();
        assert_eq!((estimate.value, estimate.n), (0.25, 2_000));
        // The interval is 0.038 wide; with 200 resamples its ends are good to a few thousandths.
        assert!((estimate.low - wilson.low).abs() < 0.005, "{estimate:?} {wilson:?}");
        assert!((estimate.high - wilson.high).abs() < 0.005, "{estimate:?} {wilson:?}");
    }

    #[test]
    fn a_bootstrap_gives_the_same_interval_again() {
        let samples: Vec<f64> = (0..100).map(|i| f64::from(i * i % 37)).collect();
        assert_eq!(Estimate::bootstrap(&samples, mean), Estimate::bootstrap(&samples, mean));
    }

    #[test]
    fn a_single_sample_has_an_interval_without_width() {
        let estimate = Estimate { value: 3.0, n: 1, low: 3.0, high: 3.0 };
        assert_eq!(Estimate::bootstrap(&[3.0], mean), Some(estimate));
    }

    #[test]
    fn there_is_no_estimate_without_samples_or_value() {
        assert_eq!(Estimate::bootstrap(&[], mean), None);
        assert_eq!(Estimate::bootstrap(&[1.0, 2.0], |_| None), None);
    }

    #[test]
    fn resamples_without_a_value_are_left_out() {
        // The mean of the samples, where all of them are there: of three samples two resamples in nine are.
        let whole = |samples: &[f64]| {
            let is_whole = [1.0, 2.0, 6.0].iter().all(|wanted| samples.contains(wanted));
            is_whole.then_some(())?;
            mean(samples)
        };
        let estimate = Estimate { value: 3.0, n: 3, low: 3.0, high: 3.0 };
        assert_eq!(Estimate::bootstrap(&[1.0, 2.0, 6.0], whole), Some(estimate));
    }

    proptest! {
        #[test]
        fn an_interval_holds_its_value(samples in prop::collection::vec(-9.0_f64..9.0, 1..30)) {
            let estimate = Estimate::bootstrap(&samples, mean).unwrap();
            prop_assert!(estimate.low <= estimate.value && estimate.value <= estimate.high);
        }
    }
}
