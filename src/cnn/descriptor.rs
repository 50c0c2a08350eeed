//! The place descriptor: a unit vector, compared by cosine (cos = a·b, since ‖a‖ = ‖b‖ = 1).

/// Squared lengths this close to 1 count as unit, so that a stored descriptor reads back bit for bit.
const UNIT_TOLERANCE: f64 = 1e-6;

/// An L2-normalised descriptor of one image: finite values, length 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Descriptor(Box<[f32]>);

impl Descriptor {
    /// The descriptor in the direction of `values`; `None` if they are empty, all zero, or not all finite.
    ///
    /// A vector that is of unit length already is kept bit for bit.
    #[must_use]
    pub fn from_values(mut values: Vec<f32>) -> Option<Self> {
        let squared: f64 = values.iter().map(|&value| f64::from(value).powi(2)).sum();
        if !squared.is_finite() || squared <= 0.0 {
            return None;
        }
        if (squared - 1.0).abs() > UNIT_TOLERANCE {
            let length = squared.sqrt();
            values.iter_mut().for_each(|value| *value = (f64::from(*value) / length) as f32);
        }
        Some(Self(values.into_boxed_slice()))
    }

    /// Its values, or rather their memory: for the next descriptor.
    #[must_use]
    pub fn into_values(self) -> Vec<f32> {
        self.0.into_vec()
    }

    /// Number of values.
    #[must_use]
    pub fn dimensions(&self) -> usize {
        self.0.len()
    }

    /// The values, of unit length together.
    #[must_use]
    pub fn as_slice(&self) -> &[f32] {
        &self.0
    }

    /// Cosine of the angle between two descriptors, in [-1, 1]: 1 for the same image.
    ///
    /// Descriptors of different dimensions come from different models and have nothing in common:
    /// their cosine is 0, which recognises nothing.
    #[must_use]
    pub fn cosine(&self, other: &Self) -> f32 {
        if self.dimensions() != other.dimensions() {
            return 0.0;
        }
        dot(&self.0, &other.0).clamp(-1.0, 1.0)
    }
}

/// Dot product in eight running sums, which the compiler keeps in vector registers.
pub(crate) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a_blocks, a_rest) = a.as_chunks::<8>();
    let (b_blocks, b_rest) = b.as_chunks::<8>();
    let mut sums = [0.0_f32; 8];
    for (a, b) in a_blocks.iter().zip(b_blocks) {
        for lane in 0..8 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f32>() + rest
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn values_without_a_direction_make_no_descriptor() {
        for values in [vec![], vec![0.0; 5], vec![1.0, f32::NAN], vec![f32::INFINITY, 1.0]] {
            assert_eq!(Descriptor::from_values(values), None);
        }
    }

    #[test]
    fn descriptors_of_different_models_have_cosine_zero() {
        let short = Descriptor::from_values(vec![1.0; 3]).unwrap();
        let long = Descriptor::from_values(vec![1.0; 4]).unwrap();
        assert_eq!(short.cosine(&long), 0.0);
    }

    #[test]
    fn tiny_and_huge_values_normalise_too() {
        for size in [1e-38_f32, 1e38] {
            let descriptor = Descriptor::from_values(vec![size, size]).unwrap();
            assert!((descriptor.as_slice()[0] - 0.5_f32.sqrt()).abs() < 1e-6);
        }
    }

    proptest! {
        #[test]
        fn cosine_agrees_with_the_definition(pairs in prop::collection::vec((-9.0_f32..9.0, -9.0_f32..9.0), 1..70)) {
            let (a, b): (Vec<f32>, Vec<f32>) = pairs.iter().copied().unzip();
            let sum = |f: &dyn Fn(f64, f64) -> f64| pairs.iter().map(|&(a, b)| f(a.into(), b.into())).sum::<f64>();
            let expected = sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
            let (a, b) = (Descriptor::from_values(a).unwrap(), Descriptor::from_values(b).unwrap());
            prop_assert!((f64::from(a.cosine(&b)) - expected).abs() < 1e-5);
            prop_assert!((a.cosine(&a) - 1.0).abs() < 1e-5);
        }

        #[test]
        fn a_stored_descriptor_reads_back_bit_for_bit(values in prop::collection::vec(0.1_f32..9.0, 1..1500)) {
            let descriptor = Descriptor::from_values(values).unwrap();
            let again = Descriptor::from_values(descriptor.as_slice().to_vec()).unwrap();
            prop_assert_eq!(again, descriptor);
        }
    }
}
