//! Dot product of bytes: what the cosine of two compact descriptors is made of.

use super::dispatch::for_every_processor;

/// Σ aᵢ · bᵢ over as many as both have, of which 131,071 cannot overflow.
#[must_use]
pub fn dot(a: &[i8], b: &[i8]) -> i32 {
    let mut sum = 0;
    sum_of_products(a, b, &mut sum);
    sum
}

for_every_processor! {
    fn sum_of_products(a: &[i8], b: &[i8], sum: &mut i32) = add_products
}

#[inline(always)]
fn add_products(a: &[i8], b: &[i8], sum: &mut i32) {
    for (&a, &b) in a.iter().zip(b) {
        *sum += i32::from(a) * i32::from(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_product_is_the_sum_of_those_of_all_pairs(
            pairs in proptest::collection::vec(any::<(i8, i8)>(), 0..300), more in 0..3_usize,
        ) {
            let (a, mut b): (Vec<i8>, Vec<i8>) = pairs.iter().copied().unzip();
            b.resize(b.len() + more, 7);
            let expected: i64 = pairs.iter().map(|&(a, b)| i64::from(a) * i64::from(b)).sum();
            prop_assert_eq!(i64::from(dot(&a, &b)), expected);
            let mut plain = 0;
            add_products(&a, &b, &mut plain);
            prop_assert_eq!(i64::from(plain), expected);
        }
    }

    #[test]
    fn the_longest_descriptors_do_not_overflow() {
        let most = vec![i8::MIN; 1 << 16];
        assert_eq!(dot(&most, &most), 1 << 30);
    }
}
