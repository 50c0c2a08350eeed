//! Hamming distance between 256-bit strings: the metric of ORB descriptors.

/// How many of the 256 bits of `a` and `b` differ.
#[inline]
#[must_use]
pub fn hamming(a: &[u8; 32], b: &[u8; 32]) -> u32 {
    let (a, _) = a.as_chunks::<8>();
    let (b, _) = b.as_chunks::<8>();
    a.iter().zip(b).map(|(&a, &b)| (u64::from_ne_bytes(a) ^ u64::from_ne_bytes(b)).count_ones()).sum()
}

/// Index and Hamming distance of the one of `others` that is nearest to `string`, the first of equally near
/// ones; `(0, u32::MAX)` where there is none.
#[must_use]
pub fn nearest(string: &[u8; 32], others: &[[u8; 32]]) -> (u32, u32) {
    dispatch::nearest(string, others)
}

#[inline(always)]
fn nearest_by_count_ones(string: &[u8; 32], others: &[[u8; 32]]) -> (u32, u32) {
    let mut best = (0, u32::MAX);
    for (index, other) in (0..).zip(others) {
        let distance = hamming(string, other);
        if distance < best.1 {
            best = (index, distance);
        }
    }
    best
}

/// The same loop for every processor: plain x86-64 has no instruction that counts bits, so the ones that have
/// it are asked for it.
#[cfg(target_arch = "x86_64")]
mod dispatch {
    #![expect(unsafe_code, reason = "code for newer processors runs behind a check that this is one")]

    use super::nearest_by_count_ones;

    #[target_feature(enable = "popcnt")]
    fn nearest_popcnt(string: &[u8; 32], others: &[[u8; 32]]) -> (u32, u32) {
        nearest_by_count_ones(string, others)
    }

    #[target_feature(enable = "avx512vl,avx512vpopcntdq")]
    fn nearest_vpopcnt(string: &[u8; 32], others: &[[u8; 32]]) -> (u32, u32) {
        nearest_by_count_ones(string, others)
    }

    #[inline]
    pub(super) fn nearest(string: &[u8; 32], others: &[[u8; 32]]) -> (u32, u32) {
        by_avx512(string, others)
            .or_else(|| by_popcnt(string, others))
            .unwrap_or_else(|| nearest_by_count_ones(string, others))
    }

    /// With the instructions of AVX-512 that count bits; `None` where the processor does not have them.
    #[inline]
    pub(super) fn by_avx512(string: &[u8; 32], others: &[[u8; 32]]) -> Option<(u32, u32)> {
        let is_there = is_x86_feature_detected!("avx512vpopcntdq") && is_x86_feature_detected!("avx512vl");
        // SAFETY: the processor has them.
        is_there.then(|| unsafe { nearest_vpopcnt(string, others) })
    }

    /// With the plain one; `None` where the processor does not have it.
    #[inline]
    pub(super) fn by_popcnt(string: &[u8; 32], others: &[[u8; 32]]) -> Option<(u32, u32)> {
        // SAFETY: the processor has it.
        is_x86_feature_detected!("popcnt").then(|| unsafe { nearest_popcnt(string, others) })
    }
}

#[cfg(not(target_arch = "x86_64"))]
mod dispatch {
    pub(super) use super::nearest_by_count_ones as nearest;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bit(bytes: &[u8; 32], index: usize) -> bool {
        bytes[index / 8] >> (index % 8) & 1 == 1
    }

    proptest! {
        #[test]
        fn the_distance_is_the_number_of_differing_bits(a in any::<[u8; 32]>(), b in any::<[u8; 32]>()) {
            let counted = (0..256).filter(|&index| bit(&a, index) != bit(&b, index)).count();
            prop_assert_eq!(hamming(&a, &b) as usize, counted);
        }

        #[test]
        fn the_nearest_is_the_first_that_no_other_beats(
            string in any::<[u8; 32]>(), mut others in proptest::collection::vec(any::<[u8; 32]>(), 0..20),
            twin in any::<prop::sample::Index>(),
        ) {
            // A copy at the end: the first of the two must win.
            if !others.is_empty() {
                others.push(others[twin.index(others.len())]);
            }
            let by_distance = others.iter().map(|other| hamming(&string, other)).zip(0..).min();
            let expected = by_distance.map_or((0, u32::MAX), |(distance, index)| (index, distance));
            prop_assert_eq!(nearest(&string, &others), expected);
            prop_assert_eq!(nearest_by_count_ones(&string, &others), expected);
            #[cfg(target_arch = "x86_64")]
            for by_others in [dispatch::by_avx512(&string, &others), dispatch::by_popcnt(&string, &others)] {
                prop_assert_eq!(by_others.unwrap_or(expected), expected);
            }
        }
    }
}
