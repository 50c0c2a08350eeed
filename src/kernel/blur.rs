//! Gaussian blur of 7×7 pixels with σ = 2, the smoothing that ORB's binary tests expect.

use crate::raster::GreyImage;

/// exp(−x²/2σ²) for x = −3…3, σ = 2, scaled so that the taps sum to 256.
const TAPS: [u32; 7] = [18, 34, 48, 56, 48, 34, 18];
const RADIUS: usize = TAPS.len() / 2;

/// `image` blurred by a separable 7×7 Gaussian of σ = 2 px in 16-bit fixed point; borders repeat
/// the edge pixel.
#[must_use]
pub fn blur_7x7(image: &GreyImage) -> GreyImage {
    let (width, height) = (image.width(), image.height());
    let mut blurred = GreyImage::new(width, height);
    let mut sums = vec![0_u32; width];
    let mut padded = vec![0_u32; width + 2 * RADIUS];
    for y in 0..height {
        sum_rows_around(image, y, &mut sums);
        pad_with_edges(&sums, &mut padded);
        for (pixel, window) in blurred.row_mut(y).iter_mut().zip(padded.windows(TAPS.len())) {
            let sum: u32 = window.iter().zip(TAPS).map(|(&value, tap)| value * tap).sum();
            *pixel = ((sum + (1 << 15)) >> 16) as u8;
        }
    }
    blurred
}

fn sum_rows_around(image: &GreyImage, y: usize, sums: &mut [u32]) {
    sums.fill(0);
    for (offset, tap) in TAPS.into_iter().enumerate() {
        let row = (y + offset).saturating_sub(RADIUS).min(image.height() - 1);
        for (sum, &pixel) in sums.iter_mut().zip(image.row(row)) {
            *sum += tap * u32::from(pixel);
        }
    }
}

fn pad_with_edges(row: &[u32], padded: &mut [u32]) {
    let Some((&first, &last)) = row.first().zip(row.last()) else { return };
    padded[..RADIUS].fill(first);
    padded[RADIUS..RADIUS + row.len()].copy_from_slice(row);
    padded[RADIUS + row.len()..].fill(last);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn blur_by_definition(image: &GreyImage, x: usize, y: usize) -> u8 {
        let at = |x: isize, y: isize| {
            let x = x.clamp(0, image.width() as isize - 1) as usize;
            let y = y.clamp(0, image.height() as isize - 1) as usize;
            u32::from(image.get(x, y))
        };
        let mut sum = 0;
        for (j, tap_y) in TAPS.into_iter().enumerate() {
            for (i, tap_x) in TAPS.into_iter().enumerate() {
                sum += tap_x * tap_y * at(x as isize + i as isize - 3, y as isize + j as isize - 3);
            }
        }
        ((sum + (1 << 15)) >> 16) as u8
    }

    #[test]
    fn the_taps_sum_to_one_so_that_flat_images_stay_flat() {
        assert_eq!(TAPS.iter().sum::<u32>(), 256);
        let flat = GreyImage::from_pixels(9, 5, vec![200; 45]).unwrap();
        assert_eq!(blur_7x7(&flat), flat);
    }

    proptest! {
        #[test]
        fn the_blur_equals_its_definition(width in 1..20_usize, height in 1..20_usize, seed in any::<[u8; 32]>()) {
            let pixels = (0..width * height).map(|i| seed[i % 32].wrapping_mul(i as u8 | 1)).collect();
            let image = GreyImage::from_pixels(width, height, pixels).unwrap();
            let blurred = blur_7x7(&image);
            for y in 0..height {
                for x in 0..width {
                    prop_assert_eq!(blurred.get(x, y), blur_by_definition(&image, x, y));
                }
            }
        }
    }
}
