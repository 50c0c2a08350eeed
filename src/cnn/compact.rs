//! A place descriptor in a byte a value: what a map keeps of it.
//!
//! Values are stored as shares of the greatest one in 127ths. Of a descriptor of 256 values that moves a cosine by
//! about 4e-4 (one standard deviation), a twentieth of what tells a threshold from the next sensible one.

use std::sync::Arc;

use super::Descriptor;
use crate::kernel;

/// Shares of the greatest value.
const STEPS: f32 = 127.0;
/// Most values.
const MAX_DIMENSIONS: usize = 1 << 16;

/// An L2-normalised descriptor of one image, rounded to a byte a value.
#[derive(Clone, Debug, PartialEq)]
pub struct CompactDescriptor {
    /// What a step of the values stands for, so that they have length 1 together.
    step: f32,
    /// Shared, for one descriptor may be in an index and wait to be stored.
    values: Arc<[i8]>,
}

impl From<&Descriptor> for CompactDescriptor {
    fn from(descriptor: &Descriptor) -> Self {
        Self::of_length_one(rounded(descriptor).collect())
    }
}

/// The values as shares of the greatest one.
fn rounded(descriptor: &Descriptor) -> impl Iterator<Item = i8> {
    let values = descriptor.as_slice();
    let greatest = values.iter().fold(0.0_f32, |greatest, value| greatest.max(value.abs()));
    // A unit vector has a greatest value above zero.
    values.iter().map(move |value| (value / greatest * STEPS).round() as i8)
}

impl CompactDescriptor {
    /// The descriptor in the direction of `values`; `None` if they are all zero, none, or more than 65,536.
    #[must_use]
    pub fn from_values(values: Vec<i8>) -> Option<Self> {
        let has_direction = values.len() <= MAX_DIMENSIONS && values.iter().any(|&value| value != 0);
        has_direction.then(|| Self::of_length_one(values.into()))
    }

    fn of_length_one(values: Arc<[i8]>) -> Self {
        Self { step: step(&values), values }
    }

    /// From now on that of `descriptor`, in the same memory if it has as many values and nobody shares it.
    pub fn set(&mut self, descriptor: &Descriptor) {
        match Arc::get_mut(&mut self.values) {
            Some(values) if values.len() == descriptor.dimensions() => {
                values.iter_mut().zip(rounded(descriptor)).for_each(|(value, rounded)| *value = rounded);
                self.step = step(values);
            }
            _ => *self = descriptor.into(),
        }
    }

    /// The values in steps.
    #[must_use]
    pub fn values(&self) -> &[i8] {
        &self.values
    }

    /// Cosine of the angle between two descriptors, in [-1, 1]. Those of different dimensions come from different
    /// models and have nothing in common: 0, which recognises nothing.
    #[must_use]
    pub fn cosine(&self, other: &Self) -> f32 {
        if self.values.len() != other.values.len() {
            return 0.0;
        }
        // Of at most 65,536 values, so that no sum overflows.
        (kernel::dot(&self.values, &other.values) as f32 * self.step * other.step).clamp(-1.0, 1.0)
    }
}

/// What a step of the values stands for where they have length 1 together.
fn step(values: &[i8]) -> f32 {
    let squared: i64 = values.iter().map(|&value| i64::from(value).pow(2)).sum();
    (squared as f64).sqrt().recip() as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rounding_moves_a_cosine_by_less_than_a_two_hundredth(
            a in proptest::collection::vec(-1.0..1.0_f32, 256),
            noise in proptest::collection::vec(-1.0..1.0_f32, 256),
            share in 0.0..2.0_f32,
        ) {
            let b = a.iter().zip(noise).map(|(a, noise)| a + share * noise).collect();
            let (Some(a), Some(b)) = (Descriptor::from_values(a), Descriptor::from_values(b)) else {
                return Ok(());
            };
            let rounded = CompactDescriptor::from(&a).cosine(&CompactDescriptor::from(&b));
            let mut in_memory_of_another = CompactDescriptor::from(&b);
            in_memory_of_another.set(&a);
            prop_assert_eq!(in_memory_of_another, CompactDescriptor::from(&a));
            prop_assert!((rounded - a.cosine(&b)).abs() < 0.005, "{} {}", rounded, a.cosine(&b));
        }
    }

    #[test]
    fn a_descriptor_is_itself_and_no_other_models() {
        let descriptor = CompactDescriptor::from_values(vec![3, -4, 100]).unwrap();
        assert!((descriptor.cosine(&descriptor) - 1.0).abs() < 1e-6);
        assert_eq!(descriptor.cosine(&CompactDescriptor::from_values(vec![1]).unwrap()), 0.0);
        assert_eq!(CompactDescriptor::from_values(vec![0, 0]), None);
        assert_eq!(CompactDescriptor::from_values(Vec::new()), None);
    }
}
