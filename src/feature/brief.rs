//! Rotated BRIEF: 256 brightness comparisons between point pairs, turned with the keypoint. The pattern is kept in 256
//! directions, as the ORB paper keeps it in 30; that takes 256 KiB.

use std::f32::consts::TAU;

use super::Descriptor;
use super::brief_pattern::PATTERN;
use super::detection::Corner;
use crate::kernel::for_every_processor;
use crate::raster::GreyImage;

/// Distance in pixels from the border within which a turned pattern would leave the image:
/// ⌈√(13² + 13²)⌉.
pub(super) const BORDER_PX: usize = 19;

/// Farthest that a turned point of the pattern lies from the keypoint in each direction.
const REACH_PX: usize = BORDER_PX - 1;
/// Pixels of a row that the pattern may reach.
const ROW_PX: usize = 2 * REACH_PX + 1;
/// Pixels from one row to the next of a patch, the square around a corner that its tests compare; a power of two, so
/// that no index of a pixel can leave it.
const STRIDE: usize = 64;

/// Points of the pattern, the first of every pair and then the second.
const POINTS: usize = 2 * PATTERN.len();

/// Directions that the pattern is kept in, 1.4° apart: more find as many true matches, half as many a little less
/// (BENCHMARKS, "ORB against OpenCV").
const TURNS: usize = 256;

/// Where the points of the pattern lie in a patch, for every direction.
#[derive(Debug)]
pub(super) struct TurnedPattern {
    turns: Vec<[u16; POINTS]>,
}

impl TurnedPattern {
    pub(super) fn new() -> Self {
        Self { turns: (0..TURNS).map(turned).collect() }
    }

    /// Adds to `descriptors` that of every one of `corners`, turned by its angle in radians. They were found in the
    /// level that is `blurred`, inside which they lie ≥ 19 px.
    pub(super) fn describe(
        &self,
        blurred: &GreyImage,
        corners: &[Corner],
        angles_radians: &[f32],
        descriptors: &mut Vec<Descriptor>,
    ) {
        describe(&self.turns, blurred, corners, angles_radians, descriptors);
    }
}

/// Indices of the pattern's points in a patch, each turned by so many of [`TURNS`] and rounded.
fn turned(turn: usize) -> [u16; POINTS] {
    let (sin, cos) = (turn as f32 * (TAU / TURNS as f32)).sin_cos();
    std::array::from_fn(|i| {
        let [x1, y1, x2, y2] = PATTERN[i % PATTERN.len()].map(f32::from);
        let (x, y) = if i < PATTERN.len() { (x1, y1) } else { (x2, y2) };
        let dx = (cos * x - sin * y).round_ties_even() as isize;
        let dy = (sin * x + cos * y).round_ties_even() as isize;
        (REACH_PX.wrapping_add_signed(dy) * STRIDE + REACH_PX.wrapping_add_signed(dx)) as u16
    })
}

/// The turn that is nearest to an angle.
#[inline(always)]
fn nearest_turn(angle_radians: f32) -> usize {
    let turns = (angle_radians * (TURNS as f32 / TAU)).round_ties_even() as isize;
    turns.rem_euclid(TURNS as isize) as usize
}

for_every_processor! {
    fn describe(
        turns: &[[u16; POINTS]],
        blurred: &GreyImage,
        corners: &[Corner],
        angles_radians: &[f32],
        descriptors: &mut Vec<Descriptor>,
    ) = describe_all
}

#[inline(always)]
fn describe_all(
    turns: &[[u16; POINTS]],
    blurred: &GreyImage,
    corners: &[Corner],
    angles_radians: &[f32],
    descriptors: &mut Vec<Descriptor>,
) {
    let (mut patch, mut pixels) = ([0; STRIDE * STRIDE], [0; POINTS]);
    for (&Corner { x, y, .. }, &angle_radians) in corners.iter().zip(angles_radians) {
        let (first, last) = ((y - REACH_PX) * blurred.width() + x, (y + REACH_PX) * blurred.width() + x);
        let around = &blurred.pixels()[first - REACH_PX..=last + REACH_PX];
        for (pixels, row) in patch.chunks_exact_mut(STRIDE).zip(around.chunks(blurred.width())) {
            pixels[..ROW_PX].copy_from_slice(&row[..ROW_PX]);
        }
        let at = &turns[nearest_turn(angle_radians)];
        for i in 0..POINTS {
            pixels[i] = patch[usize::from(at[i]) % patch.len()];
        }
        descriptors.push(compare(&pixels));
    }
}

/// One bit for every pair, set where its first pixel is darker.
#[inline(always)]
fn compare(pixels: &[u8; POINTS]) -> Descriptor {
    let (first, second) = pixels.split_at(PATTERN.len());
    let mut is_darker = [0; PATTERN.len()];
    for i in 0..PATTERN.len() {
        is_darker[i] = u8::from(first[i] < second[i]);
    }
    let mut bytes = [0; 32];
    for (byte, bits) in bytes.iter_mut().zip(is_darker.as_chunks::<8>().0) {
        *byte = pack(*bits);
    }
    Descriptor(bytes)
}

/// Eight bytes of 0 or 1 as the bits of one, the first the lowest.
#[inline(always)]
fn pack(bits: [u8; 8]) -> u8 {
    (u64::from_le_bytes(bits).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::FRAC_PI_2;
    use std::sync::LazyLock;

    use proptest::prelude::*;

    static KEPT: LazyLock<TurnedPattern> = LazyLock::new(TurnedPattern::new);

    fn textured(size: usize) -> GreyImage {
        let pixels = (0..size * size).map(|i| ((i % size * 37) ^ (i / size * 91)) as u8).collect();
        GreyImage::from_pixels(size, size, pixels).unwrap()
    }

    fn turned_by_a_quarter(image: &GreyImage) -> GreyImage {
        let size = image.width();
        let mut turned = GreyImage::new(size, size);
        for y in 0..size {
            for x in 0..size {
                turned.row_mut(x)[size - 1 - y] = image.get(x, y);
            }
        }
        turned
    }

    fn describe_one(image: &GreyImage, x: usize, y: usize, angle_radians: f32) -> Descriptor {
        let mut descriptors = Vec::new();
        let corner = Corner { x, y, response: 0 };
        KEPT.describe(image, &[corner], &[angle_radians], &mut descriptors);
        descriptors[0]
    }

    /// The tests one by one, each point turned by the nearest of the kept directions and rounded by itself.
    fn by_definition(image: &GreyImage, x: usize, y: usize, angle_radians: f32) -> Descriptor {
        let turn = (angle_radians / TAU * 256.0).round().rem_euclid(256.0);
        let (sin, cos) = (turn * (TAU / 256.0)).sin_cos();
        let sample = |px: i8, py: i8| {
            let (px, py) = (f32::from(px), f32::from(py));
            let dx = (cos * px - sin * py).round_ties_even() as isize;
            let dy = (sin * px + cos * py).round_ties_even() as isize;
            image.get(x.wrapping_add_signed(dx), y.wrapping_add_signed(dy))
        };
        let mut bytes = [0; 32];
        for (index, &[x1, y1, x2, y2]) in PATTERN.iter().enumerate() {
            bytes[index / 8] |= u8::from(sample(x1, y1) < sample(x2, y2)) << (index % 8);
        }
        Descriptor(bytes)
    }

    proptest! {
        #[test]
        fn every_bit_is_one_test_between_two_turned_points(
            pixels in proptest::collection::vec(any::<u8>(), 40 * 41), right in 0..2_usize, down in 0..3_usize,
            turn in -160..160_i32, beside in -0.49..0.49_f32,
        ) {
            let image = GreyImage::from_pixels(40, 41, pixels).unwrap();
            let (x, y) = (19 + right, 19 + down);
            let angle_radians = (turn as f32 + beside) * (TAU / 256.0);
            let expected = by_definition(&image, x, y, angle_radians);
            prop_assert_eq!(describe_one(&image, x, y, angle_radians), expected);
            let mut plain = Vec::new();
            describe_all(&KEPT.turns, &image, &[Corner { x, y, response: 0 }], &[angle_radians], &mut plain);
            prop_assert_eq!(plain[0], expected);
        }
    }

    #[test]
    fn the_first_bits_are_the_published_tests() {
        let image = textured(41);
        let descriptor = describe_one(&image, 20, 20, 0.0);
        let expected = image.get(28, 17) < image.get(29, 25);
        assert_eq!(descriptor.0[0] & 1 == 1, expected);
        let expected = image.get(24, 22) < image.get(27, 8);
        assert_eq!(descriptor.0[0] >> 1 & 1 == 1, expected);
    }

    #[test]
    fn a_turned_patch_with_a_turned_angle_keeps_its_descriptor() {
        let image = textured(41);
        let upright = describe_one(&image, 20, 20, 0.0);
        let turned = describe_one(&turned_by_a_quarter(&image), 20, 20, FRAC_PI_2);
        assert_eq!(upright, turned);
    }

    #[test]
    fn the_turned_pattern_lies_within_the_rows_that_are_copied() {
        for &at in KEPT.turns.iter().flatten() {
            let (row, column) = (usize::from(at) / STRIDE, usize::from(at) % STRIDE);
            assert!(row < ROW_PX && column < ROW_PX, "row {row}, column {column}");
        }
    }
}
