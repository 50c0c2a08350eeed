//! Quantiles by nearest rank: of times, and of whatever else is sorted.

/// The value below or at which the share `q` of `sorted` (ascending) lies: the one of rank ⌈q · n⌉,
/// counted from 1; `q` is held to 0 ..= 1. `None` where `sorted` is empty.
#[must_use]
pub fn quantile<T: Copy>(sorted: &[T], q: f64) -> Option<T> {
    // Shares such as 0.07 are a little more in binary than on paper, which must not cost a whole rank.
    let rank = ((q - 1e-12) * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.max(1).min(sorted.len()).checked_sub(1)?).copied()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn quantiles_are_values_that_occurred() {
        // ⌈0.05 · 5⌉ = 1, ⌈0.3 · 5⌉ = 2, ⌈0.4 · 5⌉ = 2, ⌈0.5 · 5⌉ = 3, ⌈1 · 5⌉ = 5.
        let sorted = [15_u64, 20, 35, 40, 50];
        let quantiles = [0.05, 0.3, 0.4, 0.5, 1.0].map(|q| quantile(&sorted, q).unwrap());
        assert_eq!(quantiles, [15, 20, 20, 35, 50]);
    }

    #[test]
    fn every_percentile_of_a_hundred_values_is_its_own() {
        let sorted: Vec<u64> = (1..=100).collect();
        for percent in 1..=100_u8 {
            assert_eq!(quantile(&sorted, f64::from(percent) / 100.0), Some(u64::from(percent)));
        }
    }

    #[test]
    fn shares_out_of_range_give_the_ends() {
        let sorted = [3_u64, 4, 5];
        assert_eq!([-1.0, 0.0, 1.5, f64::NAN].map(|q| quantile(&sorted, q).unwrap()), [3, 3, 5, 3]);
    }

    #[test]
    fn nothing_has_no_quantile() {
        assert_eq!(quantile::<u64>(&[], 0.5), None);
    }

    proptest! {
        #[test]
        fn a_quantile_is_the_least_value_with_the_share_at_or_below_it(
            mut values in prop::collection::vec(0_u64..50, 1..60),
            per_mille in 1_u64..=1_000,
        ) {
            values.sort_unstable();
            let at_or_below = |value: u64| values.iter().filter(|&&other| other <= value).count() as u64;
            let has_share = |value: u64| at_or_below(value) * 1_000 >= per_mille * values.len() as u64;
            let least = values.iter().copied().filter(|&value| has_share(value)).min();
            prop_assert_eq!(quantile(&values, per_mille as f64 / 1_000.0), least);
        }
    }
}
