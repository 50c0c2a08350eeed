//! Orientation by intensity centroid (Rosin): the direction from a corner to the centre of mass of
//! the disc of radius 15 px around it.

use super::detection::Corner;
use crate::kernel::for_every_processor;
use crate::raster::GreyImage;

/// Radius of the disc in pixels.
pub(super) const PATCH_RADIUS: usize = 15;

/// Pixels of a row that are weighed at a time: the disc's and one more, of no weight.
const LANES: usize = 2 * PATCH_RADIUS + 2;

/// What a pixel of the disc counts for each moment, by its distance from the centre row, and its column.
#[derive(Debug)]
struct Weights {
    columns: [[i16; LANES]; PATCH_RADIUS + 1],
    rows: [[i16; LANES]; PATCH_RADIUS + 1],
}

/// Measures the direction of the disc around pixels.
#[derive(Debug)]
pub(super) struct IntensityCentroid {
    weights: Weights,
}

impl IntensityCentroid {
    pub(super) fn new() -> Self {
        let mut weights = Weights { columns: [[0; LANES]; _], rows: [[0; LANES]; _] };
        for dy in 0..=PATCH_RADIUS {
            let half_width = ((PATCH_RADIUS * PATCH_RADIUS - dy * dy) as f32).sqrt().round() as usize;
            for column in PATCH_RADIUS - half_width..=PATCH_RADIUS + half_width {
                weights.columns[dy][column] = column as i16 - PATCH_RADIUS as i16;
                weights.rows[dy][column] = dy as i16;
            }
        }
        Self { weights }
    }

    /// Replaces `angles_radians` by atan2(m₀₁, m₁₀) at every one of `corners`, which lie ≥ 16 px inside the image.
    pub(super) fn measure(&self, image: &GreyImage, corners: &[Corner], angles_radians: &mut Vec<f32>) {
        angles_radians.clear();
        measure(&self.weights, image, corners, angles_radians);
    }
}

for_every_processor! {
    fn measure(weights: &Weights, image: &GreyImage, corners: &[Corner], angles_radians: &mut Vec<f32>) = measure_all
}

#[inline(always)]
fn measure_all(weights: &Weights, image: &GreyImage, corners: &[Corner], angles_radians: &mut Vec<f32>) {
    for corner in corners {
        let (m10, m01) = moments(weights, image, corner);
        angles_radians.push((m01 as f32).atan2(m10 as f32));
    }
}

/// m₁₀ and m₀₁ of the disc around a corner.
#[inline(always)]
fn moments(weights: &Weights, image: &GreyImage, &Corner { x, y, .. }: &Corner) -> (i32, i32) {
    let row = |y: usize| -> &[u8; LANES] {
        let left = x - PATCH_RADIUS;
        image.row(y)[left..left + LANES].try_into().expect("as long as the range")
    };
    let (mut m10, mut m01) = (0, 0);
    for (&weight, &pixel) in weights.columns[0].iter().zip(row(y)) {
        m10 += i32::from(weight) * i32::from(pixel);
    }
    for dy in 1..=PATCH_RADIUS {
        let (above, below) = (row(y - dy), row(y + dy));
        for i in 0..LANES {
            let (above, below) = (i16::from(above[i]), i16::from(below[i]));
            m10 += i32::from(weights.columns[dy][i]) * i32::from(above + below);
            m01 += i32::from(weights.rows[dy][i]) * i32::from(below - above);
        }
    }
    (m10, m01)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::{FRAC_PI_2, PI};

    use proptest::prelude::*;

    fn half_lit(lit: impl Fn(usize, usize) -> bool) -> GreyImage {
        let pixels = (0..33 * 33).map(|i| if lit(i % 33, i / 33) { 255 } else { 0 }).collect();
        GreyImage::from_pixels(33, 33, pixels).unwrap()
    }

    fn angle_radians(image: &GreyImage, x: usize, y: usize) -> f32 {
        let mut angles_radians = Vec::new();
        IntensityCentroid::new().measure(image, &[Corner { x, y, response: 0 }], &mut angles_radians);
        angles_radians[0]
    }

    #[test]
    fn the_angle_points_to_the_bright_side() {
        let right = angle_radians(&half_lit(|x, _| x > 16), 16, 16);
        let down = angle_radians(&half_lit(|_, y| y > 16), 16, 16);
        let left = angle_radians(&half_lit(|x, _| x < 16), 16, 16);
        assert!(right.abs() < 1e-3, "{right}");
        assert!((down - FRAC_PI_2).abs() < 1e-3, "{down}");
        assert!((left.abs() - PI).abs() < 1e-3, "{left}");
    }

    proptest! {
        #[test]
        fn the_moments_are_sums_over_the_disc(pixels in proptest::collection::vec(any::<u8>(), 33 * 33)) {
            let image = GreyImage::from_pixels(33, 33, pixels).unwrap();
            let (mut m10, mut m01) = (0, 0);
            for dy in -15_i32..=15 {
                let half_width = ((15 * 15 - dy * dy) as f32).sqrt().round() as i32;
                for dx in -half_width..=half_width {
                    let pixel = i32::from(image.get((16 + dx) as usize, (16 + dy) as usize));
                    (m10, m01) = (m10 + dx * pixel, m01 + dy * pixel);
                }
            }
            let (corner, weights) = (Corner { x: 16, y: 16, response: 0 }, IntensityCentroid::new().weights);
            prop_assert_eq!(moments(&weights, &image, &corner), (m10, m01));
            prop_assert_eq!(angle_radians(&image, 16, 16), (m01 as f32).atan2(m10 as f32));
        }
    }
}
