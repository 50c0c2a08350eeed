//! Orientation by intensity centroid (Rosin): the direction from a corner to the centre of mass of
//! the disc of radius 15 px around it.

use crate::raster::GreyImage;

/// Radius of the disc in pixels.
pub(super) const PATCH_RADIUS: usize = 15;

/// Half the width of the disc in each row, from the centre row outwards.
fn half_widths() -> [usize; PATCH_RADIUS + 1] {
    std::array::from_fn(|dy| {
        let squared = PATCH_RADIUS * PATCH_RADIUS - dy * dy;
        (squared as f32).sqrt().round() as usize
    })
}

/// Measures the direction of the disc around pixels.
pub(super) struct IntensityCentroid {
    half_widths: [usize; PATCH_RADIUS + 1],
}

impl IntensityCentroid {
    pub(super) fn new() -> Self {
        Self { half_widths: half_widths() }
    }

    /// atan2(m₀₁, m₁₀) in radians at column `x`, row `y`, which lie ≥ 15 px inside the image.
    pub(super) fn angle_radians(&self, image: &GreyImage, x: usize, y: usize) -> f32 {
        let (mut moment_x, mut moment_y) = (0_i32, 0_i32);
        for row in y - PATCH_RADIUS..=y + PATCH_RADIUS {
            let half_width = self.half_widths[row.abs_diff(y)];
            let pixels = &image.row(row)[x - half_width..=x + half_width];
            let mut row_sum = 0;
            for (column, &pixel) in pixels.iter().enumerate() {
                row_sum += i32::from(pixel);
                moment_x += i32::from(pixel) * (column as i32 - half_width as i32);
            }
            moment_y += row_sum * (row as i32 - y as i32);
        }
        (moment_y as f32).atan2(moment_x as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::{FRAC_PI_2, PI};

    fn half_lit(lit: impl Fn(usize, usize) -> bool) -> GreyImage {
        let pixels = (0..31 * 31).map(|i| if lit(i % 31, i / 31) { 255 } else { 0 }).collect();
        GreyImage::from_pixels(31, 31, pixels).unwrap()
    }

    #[test]
    fn the_angle_points_to_the_bright_side() {
        let centroid = IntensityCentroid::new();
        let right = centroid.angle_radians(&half_lit(|x, _| x > 15), 15, 15);
        let down = centroid.angle_radians(&half_lit(|_, y| y > 15), 15, 15);
        let left = centroid.angle_radians(&half_lit(|x, _| x < 15), 15, 15);
        assert!(right.abs() < 1e-3, "{right}");
        assert!((down - FRAC_PI_2).abs() < 1e-3, "{down}");
        assert!((left.abs() - PI).abs() < 1e-3, "{left}");
    }
}
