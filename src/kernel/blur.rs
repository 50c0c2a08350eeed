//! Gaussian blur of 7×7 pixels with σ = 2, the smoothing that ORB's binary tests expect.

use super::dispatch::for_every_processor;
use super::lanes::{EachLane, for_lanes, lanes, lanes_mut};
use crate::raster::GreyImage;

/// exp(−x²/2σ²) for x = −3…3, σ = 2, scaled so that the taps sum to 256.
const TAPS: [u16; 7] = [18, 34, 48, 56, 48, 34, 18];
const RADIUS: usize = TAPS.len() / 2;

/// Blurs images, in memory that it keeps from image to image.
#[derive(Debug, Default)]
pub struct Blur {
    /// A row blurred along its columns, with repeated edges.
    between: Vec<u8>,
}

impl Blur {
    /// Makes `blurred` what `image` is after a separable 7×7 Gaussian blur of σ = 2 px, rounded to whole grey values
    /// after the columns and again after the rows; borders repeat the edge pixel.
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

/// The means of seven bytes, each weighted by its tap, rounded.
#[inline(always)]
fn weigh<const N: usize>(seven: [&[u8; N]; 7]) -> [u8; N] {
    let mut means = [0; N];
    if N % 2 == 1 {
        for i in 0..N {
            means[i] = rounded(weighted_sum(seven.map(|bytes| u16::from(bytes[i])))) as u8;
        }
        return means;
    }
    // Two bytes at a time, the lower and the upper one of 16 bits: no instruction has to widen them. The sum of the
    // lower ones, which 16 bits hold, is what the sum of both leaves when that of the upper ones is taken away.
    let [a, b, c, d, e, f, g] = seven.map(|bytes| bytes.as_chunks::<2>().0);
    let (means_of_two, _) = means.as_chunks_mut::<2>();
    for i in 0..N / 2 {
        let word = |pairs: &[[u8; 2]]| u16::from_le_bytes(pairs[i]);
        let (a, b, c, d, e, f, g) = (word(a), word(b), word(c), word(d), word(e), word(f), word(g));
        let upper = weighted_sum([a >> 8, b >> 8, c >> 8, d >> 8, e >> 8, f >> 8, g >> 8]);
        let lower = weighted_sum([a, b, c, d, e, f, g]).wrapping_sub(upper << 8);
        means_of_two[i] = (rounded(lower) | rounded(upper) << 8).to_le_bytes();
    }
    means
}

/// The sum of seven values, each weighted by its tap, modulo 2¹⁶.
#[inline(always)]
fn weighted_sum([a, b, c, d, e, f, g]: [u16; 7]) -> u16 {
    let pair = |tap: u16, a: u16, b: u16| tap.wrapping_mul(a.wrapping_add(b));
    let (outer, inner) = (pair(TAPS[0], a, g).wrapping_add(pair(TAPS[1], b, f)), pair(TAPS[2], c, e));
    outer.wrapping_add(inner).wrapping_add(TAPS[3].wrapping_mul(d))
}

/// A weighted sum as a grey value.
#[inline(always)]
fn rounded(sum: u16) -> u16 {
    (sum + (1 << 7)) >> 8
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

    fn by_definition(image: &GreyImage) -> Vec<u8> {
        let (width, height) = (image.width(), image.height());
        let mean = |of: &dyn Fn(usize) -> u8, at: usize, size: usize| {
            let tap = |offset: usize| u32::from(of((at + offset).saturating_sub(3).min(size - 1)));
            let sum: u32 = (0..).zip(TAPS).map(|(offset, weight)| u32::from(weight) * tap(offset)).sum();
            ((sum + 128) / 256) as u8
        };
        let along_column = |x: usize, y: usize| mean(&|y| image.get(x, y), y, height);
        let pixel = |i: usize| mean(&|x| along_column(x, i / width), i % width, width);
        (0..width * height).map(pixel).collect()
    }

    fn blurred(image: &GreyImage) -> GreyImage {
        let mut blurred = GreyImage::new(0, 0);
        Blur::default().blur_7x7(image, &mut blurred);
        blurred
    }

    #[test]
    fn the_taps_sum_to_one_so_that_flat_images_stay_flat() {
        assert_eq!(TAPS.iter().sum::<u16>(), 256);
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
            let expected = by_definition(&image);
            let mut plain = GreyImage::new(width, height);
            blur_rows(&image, &mut vec![0; width + 6], &mut plain);
            let blurred = blurred(&image);
            prop_assert_eq!(blurred.pixels(), &expected);
            prop_assert_eq!(plain.pixels(), &expected);
        }
    }
}
