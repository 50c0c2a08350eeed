//! Rotated BRIEF: 256 brightness comparisons between point pairs, turned with the keypoint.

use super::Descriptor;
use super::brief_pattern::PATTERN;
use crate::raster::GreyImage;

/// Distance in pixels from the border within which a turned pattern would leave the image:
/// ⌈√(13² + 13²)⌉.
pub(super) const BORDER_PX: usize = 19;

/// The descriptor at column `x`, row `y` of the blurred `image`; both lie ≥ 19 px inside it.
pub(super) fn describe(image: &GreyImage, x: usize, y: usize, angle_radians: f32) -> Descriptor {
    let (sin, cos) = angle_radians.sin_cos();
    let sample = |px: i8, py: i8| {
        let (px, py) = (f32::from(px), f32::from(py));
        let dx = (cos * px - sin * py).round_ties_even() as isize;
        let dy = (sin * px + cos * py).round_ties_even() as isize;
        image.get(x.wrapping_add_signed(dx), y.wrapping_add_signed(dy))
    };
    let mut bytes = [0; 32];
    for (byte, tests) in bytes.iter_mut().zip(PATTERN.as_chunks::<8>().0) {
        for (bit, &[x1, y1, x2, y2]) in tests.iter().enumerate() {
            *byte |= u8::from(sample(x1, y1) < sample(x2, y2)) << bit;
        }
    }
    Descriptor(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::FRAC_PI_2;

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

    #[test]
    fn the_first_bits_are_the_published_tests() {
        let image = textured(41);
        let descriptor = describe(&image, 20, 20, 0.0);
        let expected = image.get(28, 17) < image.get(29, 25);
        assert_eq!(descriptor.0[0] & 1 == 1, expected);
        let expected = image.get(24, 22) < image.get(27, 8);
        assert_eq!(descriptor.0[0] >> 1 & 1 == 1, expected);
    }

    #[test]
    fn a_turned_patch_with_a_turned_angle_keeps_its_descriptor() {
        let image = textured(41);
        let upright = describe(&image, 20, 20, 0.0);
        let turned = describe(&turned_by_a_quarter(&image), 20, 20, FRAC_PI_2);
        assert_eq!(upright, turned);
    }

    #[test]
    fn the_turned_pattern_never_reaches_beyond_the_border() {
        for &[x1, y1, x2, y2] in &PATTERN {
            for (x, y) in [(x1, y1), (x2, y2)] {
                assert!(f32::from(x).hypot(f32::from(y)).round() <= BORDER_PX as f32);
            }
        }
    }
}
