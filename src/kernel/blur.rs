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
    /// The weighted sums of a row's columns: their high bytes, and their low ones, with repeated edges.
    sums: [Vec<u8>; 2],
}

impl Blur {
    /// Makes `blurred` what `image` is after a separable 7×7 Gaussian blur of σ = 2 px in 16-bit fixed point; borders
    /// repeat the edge pixel.
    pub fn blur_7x7(&mut self, image: &GreyImage, blurred: &mut GreyImage) {
        blurred.reshape(image.width(), image.height());
        self.sums.iter_mut().for_each(|bytes| bytes.resize(image.width() + 2 * RADIUS, 0));
        if image.width() > 0 {
            blur(image, &mut self.sums, blurred);
        }
    }
}

for_every_processor! {
    fn blur(image: &GreyImage, sums: &mut [Vec<u8>; 2], blurred: &mut GreyImage) = blur_rows
}

#[inline(always)]
fn blur_rows(image: &GreyImage, [high, low]: &mut [Vec<u8>; 2], blurred: &mut GreyImage) {
    let width = image.width();
    for y in 0..image.height() {
        let row = |offset: usize| image.row((y + offset).saturating_sub(RADIUS).min(image.height() - 1));
        let rows = [row(0), row(1), row(2), row(3), row(4), row(5), row(6)];
        for_lanes(0..width, ColumnSums { rows, high: &mut high[RADIUS..], low: &mut low[RADIUS..] });
        repeat_edges(high);
        repeat_edges(low);
        for_lanes(0..width, RowSums { high, low, pixels: blurred.row_mut(y) });
    }
}

/// The weighted sum of each column of seven pixels, at most 255 · 256, in two bytes.
struct ColumnSums<'a> {
    rows: [&'a [u8]; 7],
    high: &'a mut [u8],
    low: &'a mut [u8],
}

impl EachLane for ColumnSums<'_> {
    #[inline(always)]
    fn step<const N: usize>(&mut self, x: usize) {
        let [a, b, c, d, e, f, g] = self.rows;
        let sums = weigh::<N>([
            lanes(a, x),
            lanes(b, x),
            lanes(c, x),
            lanes(d, x),
            lanes(e, x),
            lanes(f, x),
            lanes(g, x),
        ]);
        *lanes_mut(self.high, x) = narrow(&sums, 8);
        *lanes_mut(self.low, x) = narrow(&sums, 0);
    }
}

/// The weighted sum of seven neighbouring sums, rounded to a pixel; byte by byte, so that 16 bits hold it.
struct RowSums<'a> {
    high: &'a [u8],
    low: &'a [u8],
    pixels: &'a mut [u8],
}

impl EachLane for RowSums<'_> {
    #[inline(always)]
    fn step<const N: usize>(&mut self, x: usize) {
        let (high, low) = (weigh::<N>(seven_from(self.high, x)), weigh::<N>(seven_from(self.low, x)));
        let mut sums = [0; N];
        for i in 0..N {
            sums[i] = high[i] + (low[i] >> 8) + (1 << 7);
        }
        *lanes_mut(self.pixels, x) = narrow(&sums, 8);
    }
}

/// The bytes from `x` on, and those from each of the next six on.
#[inline(always)]
fn seven_from<const N: usize>(row: &[u8], x: usize) -> [&[u8; N]; 7] {
    let row = &row[x..x + N + 6];
    [lanes(row, 0), lanes(row, 1), lanes(row, 2), lanes(row, 3), lanes(row, 4), lanes(row, 5), lanes(row, 6)]
}

/// The sums of seven bytes, each weighted by its tap.
#[inline(always)]
fn weigh<const N: usize>([a, b, c, d, e, f, g]: [&[u8; N]; 7]) -> [u16; N] {
    let mut sums = [0; N];
    let pair = |a: u8, b: u8| u16::from(a) + u16::from(b);
    for i in 0..N {
        sums[i] = TAPS[0] * pair(a[i], g[i])
            + TAPS[1] * pair(b[i], f[i])
            + TAPS[2] * pair(c[i], e[i])
            + TAPS[3] * u16::from(d[i]);
    }
    sums
}

/// The low bytes of the sums, shifted by so many bits.
#[inline(always)]
fn narrow<const N: usize>(sums: &[u16; N], shift: u32) -> [u8; N] {
    let mut bytes = [0; N];
    for i in 0..N {
        bytes[i] = (sums[i] >> shift) as u8;
    }
    bytes
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

    fn blur_by_definition(image: &GreyImage, x: usize, y: usize) -> u8 {
        let at = |x: isize, y: isize| {
            let x = x.clamp(0, image.width() as isize - 1) as usize;
            let y = y.clamp(0, image.height() as isize - 1) as usize;
            u32::from(image.get(x, y))
        };
        let mut sum = 0;
        for (j, tap_y) in TAPS.into_iter().enumerate() {
            for (i, tap_x) in TAPS.into_iter().enumerate() {
                sum += u32::from(tap_x)
                    * u32::from(tap_y)
                    * at(x as isize + i as isize - 3, y as isize + j as isize - 3);
            }
        }
        ((sum + (1 << 15)) >> 16) as u8
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
            let at = |index: usize| blur_by_definition(&image, index % width, index / width);
            let expected: Vec<u8> = (0..width * height).map(at).collect();
            let mut plain = GreyImage::new(width, height);
            blur_rows(&image, &mut [vec![0; width + 6], vec![0; width + 6]], &mut plain);
            let blurred = blurred(&image);
            prop_assert_eq!(blurred.pixels(), &expected);
            prop_assert_eq!(plain.pixels(), &expected);
        }
    }
}
