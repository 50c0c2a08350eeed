//! The difference hash of an image: 64 bits that say which of two neighbouring areas is brighter.
//!
//! Two looks at the same view differ in few bits, also when the light has changed; two views of one place from
//! different points differ in more. It is far too coarse to recognise a place, and just right to tell which of
//! many experiences of one place are worth keeping. (Krawetz, *Kind of like that*, 2013.)

use crate::raster::GreyImage;

const COLUMNS: usize = 9;
const ROWS: usize = 8;

/// The difference hash of `image`: bit 8 r + c is set if the mean of area (r, c) exceeds that of its right
/// neighbour, in a grid of 8 rows and 9 columns. 0 of an image of fewer pixels.
#[must_use]
pub fn difference_hash(image: &GreyImage) -> u64 {
    if image.width() < COLUMNS || image.height() < ROWS {
        return 0;
    }
    let edges = |length: usize, parts: usize| move |part: usize| part * length / parts;
    let (column, row) = (edges(image.width(), COLUMNS), edges(image.height(), ROWS));
    let mut hash = 0;
    for r in 0..ROWS {
        let mean = |c: usize| area_mean(image, (column(c), column(c + 1)), (row(r), row(r + 1)));
        let means: [f32; COLUMNS] = std::array::from_fn(mean);
        for c in 0..COLUMNS - 1 {
            hash |= u64::from(means[c] > means[c + 1]) << (8 * r + c);
        }
    }
    hash
}

fn area_mean(image: &GreyImage, (left, right): (usize, usize), (top, bottom): (usize, usize)) -> f32 {
    let sum_of_row = |y: usize| image.row(y)[left..right].iter().map(|&pixel| u64::from(pixel)).sum::<u64>();
    let sum: u64 = (top..bottom).map(sum_of_row).sum();
    sum as f32 / ((right - left) * (bottom - top)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: usize, pixel: impl Fn(usize, usize) -> u8) -> GreyImage {
        let mut image = GreyImage::new(width, 80);
        for y in 0..80 {
            for (x, value) in image.row_mut(y).iter_mut().enumerate() {
                *value = pixel(x, y);
            }
        }
        image
    }

    #[test]
    fn brightness_that_falls_to_the_right_sets_every_bit_and_its_mirror_none() {
        assert_eq!(difference_hash(&image(90, |x, _| 200 - x as u8)), u64::MAX);
        assert_eq!(difference_hash(&image(90, |x, _| x as u8)), 0);
        assert_eq!(difference_hash(&image(8, |x, _| 200 - x as u8)), 0);
    }

    #[test]
    fn half_the_light_changes_no_bit_and_another_view_changes_many() {
        let pattern = |x: usize, y: usize| ((x / 10 * 7 + y / 10 * 3) % 11 * 20) as u8;
        let day = difference_hash(&image(90, pattern));
        assert_eq!(difference_hash(&image(90, |x, y| pattern(x, y) / 2)), day);
        let elsewhere = difference_hash(&image(90, |x, y| pattern(x + 30, y + 20)));
        assert!((day ^ elsewhere).count_ones() > 10);
    }
}
