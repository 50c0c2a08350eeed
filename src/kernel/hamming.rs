//! Hamming distance between 256-bit strings: the metric of ORB descriptors.

/// How many of the 256 bits of `a` and `b` differ.
#[inline]
#[must_use]
pub fn hamming(a: &[u8; 32], b: &[u8; 32]) -> u32 {
    let (a, _) = a.as_chunks::<8>();
    let (b, _) = b.as_chunks::<8>();
    a.iter().zip(b).map(|(&a, &b)| (u64::from_ne_bytes(a) ^ u64::from_ne_bytes(b)).count_ones()).sum()
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
    }
}
