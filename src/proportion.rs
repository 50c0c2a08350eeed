//! A share of a whole, with the 95 % interval in which the truth is to be expected.
//!
//! The interval is the score interval of Wilson (1927, "Probable inference, the law of succession, and
//! statistical inference"): with p = successes / n, it is
//! (p + z²/2n ± z √(p (1 - p) / n + z²/4n²)) / (1 + z²/n).

use serde::Serialize;

/// Standard deviations of a normal distribution that hold 95 % of it.
const Z: f64 = 1.959_964;

/// A share of a whole.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Proportion {
    /// How many of the whole.
    pub successes: u64,
    /// The whole.
    pub n: u64,
    /// `successes / n`.
    pub rate: f64,
    /// Lower end of the 95 % Wilson interval of `rate`.
    pub low: f64,
    /// Upper end of the 95 % Wilson interval of `rate`.
    pub high: f64,
}

impl Proportion {
    /// `successes` of `n`; `None` where there is nothing to count.
    #[must_use]
    pub fn new(successes: u64, n: u64) -> Option<Self> {
        debug_assert!(successes <= n, "{successes} successes among {n}");
        if n == 0 {
            return None;
        }
        let whole = n as f64;
        let rate = successes as f64 / whole;
        let scale = 1.0 + Z * Z / whole;
        let centre = (rate + Z * Z / (2.0 * whole)) / scale;
        let variance = rate * (1.0 - rate) / whole + Z * Z / (4.0 * whole * whole);
        let reach = Z * variance.sqrt() / scale;
        // The interval of none ends at 0 and that of all at 1; rounding would leave a speck.
        let low = if successes == 0 { 0.0 } else { centre - reach };
        let high = if successes == n { 1.0 } else { centre + reach };
        Some(Self { successes, n, rate, low, high })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn eight_of_ten_lie_between_49_and_94_percent() {
        // z² = 3.841459; 1 + z²/10 = 1.3841459; centre = (0.8 + 0.19207295) / 1.3841459 = 0.7167402;
        // variance = 0.8 · 0.2 / 10 + 3.841459 / 400 = 0.02560365, its root 0.1600114;
        // reach = 1.959964 · 0.1600114 / 1.3841459 = 0.2265776; 0.7167402 ∓ 0.2265776.
        let proportion = Proportion::new(8, 10).unwrap();
        assert_eq!((proportion.successes, proportion.n, proportion.rate), (8, 10, 0.8));
        assert!((proportion.low - 0.490_162_6).abs() < 1e-6, "{proportion:?}");
        assert!((proportion.high - 0.943_317_8).abs() < 1e-6, "{proportion:?}");
    }

    #[test]
    fn none_and_all_of_ten_reach_the_ends_exactly() {
        // p = 0: the interval is 0 to z² / (n + z²) = 3.841459 / 13.841459 = 0.2775328.
        let none = Proportion::new(0, 10).unwrap();
        assert_eq!((none.rate, none.low), (0.0, 0.0));
        assert!((none.high - 0.277_532_8).abs() < 1e-6, "{none:?}");
        let all = Proportion::new(10, 10).unwrap();
        assert_eq!((all.rate, all.high), (1.0, 1.0));
        assert!((all.low - (1.0 - none.high)).abs() < 1e-12, "{all:?}");
    }

    #[test]
    fn a_share_of_nothing_is_none() {
        assert_eq!(Proportion::new(0, 0), None);
    }

    proptest! {
        #[test]
        fn a_wilson_interval_solves_its_equation(
            (n, successes) in (1_u64..5_000).prop_flat_map(|n| (Just(n), 0..=n)),
        ) {
            // Both ends q solve (p - q)² = z² q (1 - q) / n, which is how Wilson found them.
            let Proportion { rate, low, high, .. } = Proportion::new(successes, n).unwrap();
            prop_assert!((0.0..=rate).contains(&low) && (rate..=1.0).contains(&high));
            for end in [low, high] {
                let left = (rate - end).powi(2);
                prop_assert!((left - Z * Z * end * (1.0 - end) / n as f64).abs() < 1e-12);
            }
        }
    }
}
