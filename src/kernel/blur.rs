//! Blur of 7×7 pixels, the smoothing that ORB's binary tests expect.
//!
//! Its weights fall off in a straight line, 1, 2, 3, 4, 3, 2, 1, so that it is made of means of two bytes, for which
//! processors have one instruction. Their variance is 2.5 px²; that of the Gaussian which others use, σ = 2 px cut off
//! at 7 pixels, is 2.7.

use super::dispatch::for_every_processor;
use super::lanes::{EachLane, for_lanes, lanes, lanes_mut};
use crate::raster::GreyImage;

/// Farthest pixel in each direction that counts.
const RADIUS: usize = 3;

/// Blurs images, in memory that it keeps from image to image.
#[derive(Debug, Default)]
pub struct Blur {
    /// A row blurred along its columns, with repeated edges.
    between: Vec<u8>,
}

impl Blur {
    /// Makes `blurred` what `image` is when each pixel is the weighted mean of seven in its column, and then of seven
    /// in its row; borders repeat the edge pixel. Every mean of two is rounded up to a whole grey value.
    pub fn blur_7x7(&mut self, image: &GreyImage, blurred: &mut GreyImage) {
        blurred.reshape(image.width(), image.height());
        self.between.resize(image.width() + 2 * RADIUS, 0);
        if image.width() > 0 {
            blur(image, &mut self.between, blurred);
        }
    }
}

for_every_processor! {
    fn blur(image: &GreyImage, between: &mut [u8], blurred: &mut GreyImage) = blur_rows
}

#[inline(always)]
fn blur_rows(image: &GreyImage, between: &mut [u8], blurred: &mut GreyImage) {
    let width = image.width();
    for y in 0..image.height() {
        let row = |offset: usize| image.row((y + offset).saturating_sub(RADIUS).min(image.height() - 1));
        let rows = [row(0), row(1), row(2), row(3), row(4), row(5), row(6)];
        for_lanes(0..width, AlongColumns { rows, pixels: &mut between[RADIUS..] });
        repeat_edges(between);
        for_lanes(0..width, AlongRow { row: between, pixels: blurred.row_mut(y) });
    }
}

/// The weighted mean of each column of seven pixels.
struct AlongColumns<'a> {
    rows: [&'a [u8]; 7],
    pixels: &'a mut [u8],
}

impl EachLane for AlongColumns<'_> {
    #[inline(always)]
    fn step<const N: usize>(&mut self, x: usize) {
        let [a, b, c, d, e, f, g] = self.rows;
        let seven =
            [lanes(a, x), lanes(b, x), lanes(c, x), lanes(d, x), lanes(e, x), lanes(f, x), lanes(g, x)];
        *lanes_mut(self.pixels, x) = weigh::<N>(seven);
    }
}

/// The weighted mean of seven neighbours in a row.
struct AlongRow<'a> {
    row: &'a [u8],
    pixels: &'a mut [u8],
}

impl EachLane for AlongRow<'_> {
    #[inline(always)]
    fn step<const N: usize>(&mut self, x: usize) {
        *lanes_mut(self.pixels, x) = weigh::<N>(seven_from(self.row, x));
    }
}

/// The bytes from `x` on, and those from each of the next six on.
#[inline(always)]
fn seven_from<const N: usize>(row: &[u8], x: usize) -> [&[u8; N]; 7] {
    let row = &row[x..x + N + 6];
    [lanes(row, 0), lanes(row, 1), lanes(row, 2), lanes(row, 3), lanes(row, 4), lanes(row, 5), lanes(row, 6)]
}

/// The means of seven bytes, weighted 1, 2, 3, 4, 3, 2 and 1 sixteenths, as averages of averages.
#[inline(always)]
fn weigh<const N: usize>([a, b, c, d, e, f, g]: [&[u8; N]; 7]) -> [u8; N] {
    let mut means = [0; N];
    for i in 0..N {
        let before = average(average(a[i], c[i]), b[i]);
        let centre = average(average(c[i], e[i]), d[i]);
        let behind = average(average(e[i], g[i]), f[i]);
        means[i] = average(average(before, behind), centre);
    }
    means
}

/// The mean of two bytes, a half rounded up; written such that compilers see the one instruction that it is.
#[inline(always)]
fn average(a: u8, b: u8) -> u8 {
    (a | b) - ((a ^ b) >> 1)
}

fn repeat_edges(padded: &mut [u8]) {
    let last = padded.len() - RADIUS - 1;
    let (first, last) = (padded[RADIUS], padded[last]);
    let end = padded.len() - RADIUS;
    padded[..RADIUS].fill(first);
    padded[end..].fill(last);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Each pixel by `mean` of seven in its column, and then of seven in its row.
    fn by_definition<T: Copy>(image: &GreyImage, grey: fn(u8) -> T, mean: fn([T; 7]) -> T) -> Vec<T> {
        let (width, height) = (image.width(), image.height());
        let near = |at: usize, offset: usize, size: usize| (at + offset).saturating_sub(3).min(size - 1);
        let along_column =
            |x, y| mean(std::array::from_fn(|offset| grey(image.get(x, near(y, offset, height)))));
        let along_row = |x, y| mean(std::array::from_fn(|offset| along_column(near(x, offset, width), y)));
        (0..width * height).map(|i| along_row(i % width, i / width)).collect()
    }

    fn mean_of_means([a, b, c, d, e, f, g]: [u16; 7]) -> u16 {
        let two = |a: u16, b: u16| (a + b).div_ceil(2);
        let three = |before, centre, behind| two(two(before, behind), centre);
        three(three(a, b, c), three(c, d, e), three(e, f, g))
    }

    fn weighted_mean([a, b, c, d, e, f, g]: [f64; 7]) -> f64 {
        (a + 2.0 * b + 3.0 * c + 4.0 * d + 3.0 * e + 2.0 * f + g) / 16.0
    }

    fn blurred(image: &GreyImage) -> GreyImage {
        let mut blurred = GreyImage::new(0, 0);
        Blur::default().blur_7x7(image, &mut blurred);
        blurred
    }

    #[test]
    fn flat_images_stay_flat() {
        for grey in [0, 1, 200, 255] {
            let flat = GreyImage::from_pixels(49, 5, vec![grey; 245]).unwrap();
            assert_eq!(blurred(&flat), flat);
        }
    }

    #[test]
    fn an_image_without_pixels_stays_one() {
        assert_eq!(blurred(&GreyImage::new(0, 7)), GreyImage::new(0, 7));
        assert_eq!(blurred(&GreyImage::new(7, 0)), GreyImage::new(7, 0));
    }

    proptest! {
        #[test]
        fn the_blur_equals_its_definition(width in 1..80_usize, height in 1..12_usize, seed in any::<[u8; 32]>()) {
            let pixels = (0..width * height).map(|i| seed[i % 32].wrapping_mul(i as u8 | 1)).collect();
            let image = GreyImage::from_pixels(width, height, pixels).unwrap();
            let expected: Vec<u8> =
                by_definition(&image, u16::from, mean_of_means).into_iter().map(|grey| grey as u8).collect();
            let mut plain = GreyImage::new(width, height);
            blur_rows(&image, &mut vec![0; width + 6], &mut plain);
            let blurred = blurred(&image);
            prop_assert_eq!(blurred.pixels(), &expected);
            prop_assert_eq!(plain.pixels(), &expected);
            // Means are rounded up: by 1.5 grey levels at most along a column, and again along a row.
            for (&rounded, exact) in expected.iter().zip(by_definition(&image, f64::from, weighted_mean)) {
                prop_assert!((0.0..=3.0).contains(&(f64::from(rounded) - exact)), "{rounded} for {exact}");
            }
        }
    }
}
