//! Bilinear resize of grey images, for the levels of the pyramid.

use crate::raster::GreyImage;

/// Weights are fixed-point numbers with this many fractional bits.
const FRACTION_BITS: u32 = 11;
const ONE: u32 = 1 << FRACTION_BITS;

/// Where an output pixel takes its value: two neighbours and the weight of the second.
struct Tap {
    first: usize,
    second: usize,
    weight: u32,
}

/// `image` resized to `width` × `height` by bilinear interpolation between pixel centres.
///
/// Meant for factors near one, as between pyramid levels: a strong reduction would alias.
#[must_use]
pub fn resize_bilinear(image: &GreyImage, width: usize, height: usize) -> GreyImage {
    let columns = taps(image.width(), width);
    let rows = taps(image.height(), height);
    let mut resized = GreyImage::new(width, height);
    for (y, row) in rows.iter().enumerate() {
        let (upper, lower) = (image.row(row.first), image.row(row.second));
        for (pixel, column) in resized.row_mut(y).iter_mut().zip(&columns) {
            let top = mix(upper[column.first], upper[column.second], column.weight);
            let bottom = mix(lower[column.first], lower[column.second], column.weight);
            let value = top * (ONE - row.weight) + bottom * row.weight;
            *pixel = ((value + (1 << (2 * FRACTION_BITS - 1))) >> (2 * FRACTION_BITS)) as u8;
        }
    }
    resized
}

fn mix(first: u8, second: u8, weight: u32) -> u32 {
    u32::from(first) * (ONE - weight) + u32::from(second) * weight
}

fn taps(from: usize, to: usize) -> Vec<Tap> {
    let last = from.saturating_sub(1);
    (0..to)
        .map(|index| {
            let centre = (index as f64 + 0.5) * from as f64 / to as f64 - 0.5;
            let clamped = centre.clamp(0.0, last as f64);
            let first = clamped as usize;
            let weight = ((clamped - first as f64) * f64::from(ONE)).round() as u32;
            Tap { first, second: (first + 1).min(last), weight }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn halving_averages_neighbours() {
        let image = GreyImage::from_pixels(4, 2, vec![10, 20, 100, 200, 30, 40, 100, 200]).unwrap();
        assert_eq!(resize_bilinear(&image, 2, 1).pixels(), &[25, 150]);
    }

    proptest! {
        #[test]
        fn the_same_size_changes_nothing(width in 1..30_usize, height in 1..30_usize, step in 1..255_usize) {
            let pixels = (0..width * height).map(|i| (i * step % 256) as u8).collect();
            let image = GreyImage::from_pixels(width, height, pixels).unwrap();
            prop_assert_eq!(resize_bilinear(&image, width, height), image);
        }

        #[test]
        fn no_pixel_leaves_the_range_of_the_image(width in 1..40_usize, height in 1..40_usize, low in 0..100_u8) {
            let pixels = (0..20 * 15).map(|i| low + (i * 7 % 60) as u8).collect();
            let image = GreyImage::from_pixels(20, 15, pixels).unwrap();
            let resized = resize_bilinear(&image, width, height);
            prop_assert!(resized.pixels().iter().all(|&pixel| (low..low + 60).contains(&pixel)));
        }
    }
}
