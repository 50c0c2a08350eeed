//! Numbers as 8-bit integers: real = scale · (integer − zero point).

use super::Range;
use super::constants::Constant;
use super::plan::Layer;

/// Steps between the least and the greatest u8.
const STEPS: f32 = 255.0;
/// Greatest magnitude of a weight of a depthwise convolution, in steps.
const LARGEST_DEPTHWISE: f32 = 127.0;
/// Greatest magnitude of any other weight, in steps. x86-64 processors without instructions for sums of 8-bit products
/// (AVX2 without VNNI) add them up in pairs of 16 bits, which 2 · 255 · 64 still fits into; from 65 on, sums are cut
/// off and the descriptors are those of another network. Depthwise kernels are computed otherwise.
const LARGEST_WEIGHT: f32 = 64.0;
/// Greatest magnitude of a bias; as much again is left for the sum that it is added to.
const LARGEST_BIAS: f64 = (1 << 30) as f64;
/// Below this, products of two scales would lose digits.
const SMALLEST_SCALE: f32 = 1e-18;

/// How an activation is quantised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Affine {
    pub(super) scale: f32,
    pub(super) zero_point: u8,
}

impl Affine {
    /// Covers `range` and zero, which a padded border needs to be exact. What never differed from zero gets the range
    /// from 0 to 1. `None` if the range is not finite or has no width in f32.
    pub(super) fn covering(range: Range) -> Option<Self> {
        let (least, greatest) = (range.least.min(0.0), range.greatest.max(0.0));
        let width = greatest - least;
        if !(range.least.is_finite() && range.greatest.is_finite() && width.is_finite()) {
            return None;
        }
        let mut scale = width / STEPS;
        if scale < SMALLEST_SCALE {
            return Some(Self { scale: 1.0 / STEPS, zero_point: 0 });
        }
        // ONNX Runtime leaves out a Clip only if the integers cover no more than it lets through.
        while scale * STEPS > width {
            scale = scale.next_down();
        }
        Some(Self { scale, zero_point: (-least / scale).round() as u8 })
    }
}

/// Weights and biases of a layer as integers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Integers {
    /// s8, in the order of the weights.
    pub(super) weights: Vec<i8>,
    /// Of the weights, one a channel.
    pub(super) weight_scales: Vec<f32>,
    /// int32, one a channel; their scales are those of the weights times the input's.
    pub(super) biases: Option<Vec<i32>>,
}

impl Integers {
    /// The integers of `layer`, whose input has the scale `input_scale`. `None` if a product of scales leaves f32.
    pub(super) fn of(layer: &Layer, input_scale: f32) -> Option<Self> {
        let Layer { weights: Constant { shape, values }, axis, biases } = layer;
        let inner: usize = shape.iter().skip(axis + 1).product();
        let channels = shape.get(*axis).copied().unwrap_or(1);
        let channel_of = |index: usize| index / inner % channels;
        let is_depthwise = shape.len() > 2 && shape.get(1) == Some(&1);
        let largest = if is_depthwise { LARGEST_DEPTHWISE } else { LARGEST_WEIGHT };
        let mut weight_scales = vec![SMALLEST_SCALE; channels];
        for (index, value) in values.iter().enumerate() {
            let scale = &mut weight_scales[channel_of(index)];
            *scale = scale.max(value.abs() / largest);
        }
        let biases = biases.iter().flat_map(|biases| &biases.values);
        for (scale, bias) in weight_scales.iter_mut().zip(biases.clone()) {
            // Beside weights that are as good as nothing, a bias would not fit its integer.
            *scale = scale.max((f64::from(bias.abs()) / (f64::from(input_scale) * LARGEST_BIAS)) as f32);
        }
        if !weight_scales.iter().all(|scale| (scale * input_scale).is_normal()) {
            return None;
        }
        let steps = |(index, value): (usize, &f32)| value / weight_scales[channel_of(index)];
        let steps: Vec<f32> = values.iter().enumerate().map(steps).collect();
        let taps: usize = shape.iter().skip(2).product();
        let weights = match taps {
            0 | 1 => steps.iter().map(|step| step.round() as i8).collect(),
            taps => steps.chunks(taps).flat_map(|kernel| rounded(kernel, largest)).collect(),
        };
        let of_biases = weight_scales.iter().map(|scale| f64::from(scale * input_scale));
        let integers = biases.zip(of_biases).map(|(&bias, scale)| (f64::from(bias) / scale).round() as i32);
        let biases = layer.biases.as_ref().map(|_| integers.collect());
        Some(Self { weights, weight_scales, biases })
    }
}

/// The taps of a kernel, given in steps of their scale, as integers whose sum is rounded to the nearest, too. Taps see
/// nearly the same values, so whatever is added to their sum shifts all that the channel gives; a tap that is off by up
/// to one step instead of half a step matters less.
fn rounded(kernel: &[f32], largest: f32) -> Vec<i8> {
    let nearest = |step: f32| step.clamp(-largest, largest).round();
    let errors: Vec<f32> = kernel.iter().map(|&step| step - nearest(step)).collect();
    let missing = errors.iter().sum::<f32>().round();
    let mut integers: Vec<i8> = kernel.iter().map(|&step| nearest(step) as i8).collect();
    if missing != 0.0 {
        // Those first that lie nearest to the integer on the other side.
        let mut order: Vec<usize> = (0..kernel.len()).collect();
        order.sort_by(|&one, &other| (errors[other] * missing).total_cmp(&(errors[one] * missing)));
        for &tap in order.iter().take(missing.abs() as usize) {
            let other_side = f32::from(integers[tap]) + missing.signum();
            integers[tap] = other_side.clamp(-largest, largest) as i8;
        }
    }
    integers
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn layer(shape: &[usize], values: Vec<f32>, biases: Option<Vec<f32>>) -> Layer {
        let biases = biases.map(|values| Constant { shape: vec![values.len()], values });
        Layer { weights: Constant { shape: shape.to_vec(), values }, axis: 0, biases }
    }

    proptest! {
        #[test]
        fn a_range_is_covered_to_half_a_step_and_zero_is_exact(one in -1e6_f32..1e6, other in -1e6_f32..1e6) {
            let range = Range { least: one.min(other), greatest: one.max(other) };
            let Affine { scale, zero_point } = Affine::covering(range).unwrap();
            let (least, greatest) = (range.least.min(0.0), range.greatest.max(0.0));
            prop_assert!(scale * STEPS <= greatest - least);
            let lowest = -f32::from(zero_point) * scale;
            let highest = (STEPS - f32::from(zero_point)) * scale;
            prop_assert!((lowest - least).abs() <= 0.501 * scale && (highest - greatest).abs() <= 0.501 * scale);
        }

        #[test]
        fn weights_and_biases_are_those_of_a_naive_oracle(
            values in prop::collection::vec(-2.0_f32..2.0, 5 * 3),
            biases in prop::collection::vec(-9.0_f32..9.0, 5),
            input_scale in 0.001_f32..0.1,
        ) {
            let integers = Integers::of(&layer(&[5, 3], values.clone(), Some(biases.clone())), input_scale).unwrap();
            let of_biases = integers.biases.unwrap();
            for channel in 0..5 {
                let own = &values[channel * 3..][..3];
                let scale = integers.weight_scales[channel];
                let largest = own.iter().fold(0.0_f32, |largest, value| largest.max(value.abs()));
                let for_bias = biases[channel].abs() / (input_scale * (1 << 30) as f32);
                let expected = (largest / 64.0).max(for_bias).max(1e-18);
                prop_assert!((scale - expected).abs() < 1e-5 * scale, "{scale} for {largest}");
                for (value, &integer) in own.iter().zip(&integers.weights[channel * 3..]) {
                    prop_assert!((value - f32::from(integer) * scale).abs() <= 0.501 * scale);
                }
                let product = f64::from(scale * input_scale);
                let bias = f64::from(of_biases[channel]) * product;
                prop_assert!((bias - f64::from(biases[channel])).abs() <= 0.501 * product);
            }
        }

        #[test]
        fn the_taps_of_a_kernel_are_within_a_step_and_their_sum_within_half_a_step(
            values in prop::collection::vec(-2.0_f32..2.0, 4 * 2 * 9)
        ) {
            let integers = Integers::of(&layer(&[4, 2, 3, 3], values.clone(), None), 0.02).unwrap();
            for (index, kernel) in values.chunks(9).enumerate() {
                let scale = integers.weight_scales[index / 2];
                let restored = integers.weights[index * 9..][..9].iter().map(|&tap| f32::from(tap) * scale);
                let errors: Vec<f32> = kernel.iter().zip(restored).map(|(tap, restored)| tap - restored).collect();
                prop_assert!(errors.iter().all(|error| error.abs() <= 1.001 * scale));
                prop_assert!(errors.iter().sum::<f32>().abs() <= 0.501 * scale, "{errors:?}");
            }
        }
    }

    #[test]
    fn what_never_differed_from_zero_has_a_scale_all_the_same_and_what_is_not_finite_has_none() {
        let range = |least, greatest| Affine::covering(Range { least, greatest });
        let unit = Some(Affine { scale: 1.0 / 255.0, zero_point: 0 });
        assert_eq!((range(0.0, 0.0), range(-0.0, 1e-30)), (unit, unit));
        for (least, greatest) in [(f32::NAN, 1.0), (0.0, f32::INFINITY), (-3e38, 3e38)] {
            assert_eq!(range(least, greatest), None);
        }
    }

    #[test]
    fn a_dead_channel_keeps_its_bias() {
        let integers = Integers::of(&layer(&[2, 1], vec![0.0, 0.0], Some(vec![0.7, 0.0])), 0.02).unwrap();
        assert_eq!(integers.weights, [0, 0]);
        let bias = f64::from(integers.biases.unwrap()[0]) * f64::from(integers.weight_scales[0] * 0.02);
        assert!((bias - 0.7).abs() < 1e-6, "{bias}");
    }

    #[test]
    fn weights_beyond_all_measure_have_no_integers() {
        assert_eq!(Integers::of(&layer(&[1, 1], vec![3e38], None), 1e3), None);
    }
}
