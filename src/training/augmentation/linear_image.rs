//! An image as linear light, in which effects add up and multiply as light does; bytes only before and after.

use std::sync::LazyLock;

use crate::raster::RgbImage;

/// Steps of the table from light to bytes: the darkest byte alone spans five of them.
const STEPS: usize = 1 << 14;

/// What byte each step of light becomes.
static BYTES: LazyLock<Vec<u8>> = LazyLock::new(|| {
    (0..=STEPS).map(|step| (encoded(step as f64 / STEPS as f64) * 255.0).round() as u8).collect()
});

/// Red, green and blue light; 1 is the brightest that a byte holds, and more than that is kept until the end.
pub(super) type Light = [f32; 3];

/// Share of red, green and blue in luminance (ITU-R BT.709, linear light).
const LUMINANCE: Light = [0.2126, 0.7152, 0.0722];

/// Luminance of a pixel, 0 to 1 as far as a byte holds it.
#[inline]
pub(super) fn luminance([red, green, blue]: Light) -> f32 {
    LUMINANCE[0] * red + LUMINANCE[1] * green + LUMINANCE[2] * blue
}

/// An image of `width` × `height` pixels of light, row-major; it has one pixel at least.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LinearImage {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) pixels: Vec<Light>,
}

impl LinearImage {
    /// The light of an sRGB image whose levels, 0 to 1, are first raised to the power of `gamma`: above 1 darkens the
    /// middle, below 1 brightens it, 1 changes nothing.
    pub(super) fn of(image: &RgbImage, gamma: f32) -> Self {
        let level = |byte: usize| (byte as f64 / 255.0).powf(f64::from(gamma));
        let table: [f32; 256] = std::array::from_fn(|byte| decoded(level(byte)) as f32);
        let (pixels, _) = image.pixels().as_chunks::<3>();
        let pixels = pixels.iter().map(|pixel| pixel.map(|byte| table[usize::from(byte)])).collect();
        Self { width: image.width(), height: image.height(), pixels }
    }

    /// The nearest sRGB image; light beyond what a byte holds is cut off.
    pub(super) fn to_bytes(&self) -> RgbImage {
        let table = BYTES.as_slice();
        let mut image = RgbImage::new(self.width, self.height);
        for (byte, &light) in image.pixels_mut().iter_mut().zip(self.pixels.as_flattened()) {
            // Beyond 2²³ a float has no fraction, so that its last bits are the nearest step; a cast is slower.
            let step = (light.clamp(0.0, 1.0) * STEPS as f32 + 8_388_608.0).to_bits() as usize % (2 * STEPS);
            *byte = table[step.min(STEPS)];
        }
        image
    }

    /// Shorter side in pixels.
    pub(super) fn shorter_side_px(&self) -> f32 {
        self.width.min(self.height) as f32
    }

    /// Mean luminance of all pixels.
    pub(super) fn mean_luminance(&self) -> f32 {
        let sum: f64 = self.pixels.iter().map(|&pixel| f64::from(luminance(pixel))).sum();
        (sum / self.pixels.len() as f64) as f32
    }

    /// Rows from the top down.
    pub(super) fn rows_mut(&mut self) -> impl Iterator<Item = &mut [Light]> {
        self.pixels.chunks_exact_mut(self.width)
    }
}

/// Light of an sRGB level, both 0 to 1 (IEC 61966-2-1).
fn decoded(level: f64) -> f64 {
    if level <= 0.04045 { level / 12.92 } else { ((level + 0.055) / 1.055).powf(2.4) }
}

/// sRGB level of light, both 0 to 1 (IEC 61966-2-1).
fn encoded(light: f64) -> f64 {
    if light <= 0.003_130_8 { light * 12.92 } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::kernel::luma;

    /// An image in which every pixel differs from its neighbours.
    pub(in super::super) fn riddle(width: usize, height: usize) -> RgbImage {
        let byte = |i: usize| ((i as u32).wrapping_mul(2_654_435_761) >> 13) as u8;
        RgbImage::from_pixels(width, height, (0..width * height * 3).map(byte).collect()).unwrap()
    }

    /// An image of one level of grey light.
    pub(in super::super) fn plain(width: usize, height: usize, light: f32) -> LinearImage {
        LinearImage { width, height, pixels: vec![[light; 3]; width * height] }
    }

    #[test]
    fn every_byte_survives_the_way_to_light_and_back() {
        let image = RgbImage::from_pixels(256, 1, (0..=255).flat_map(|byte| [byte; 3]).collect()).unwrap();
        assert_eq!(LinearImage::of(&image, 1.0).to_bytes(), image);
    }

    #[test]
    fn gamma_moves_the_middle_and_keeps_black_and_white() {
        let image = RgbImage::from_pixels(3, 1, [0, 128, 255].map(|byte| [byte; 3]).concat()).unwrap();
        let levels = |gamma| luma(&LinearImage::of(&image, gamma).to_bytes());
        assert_eq!(levels(2.0).pixels(), &[0, 64, 255]);
        assert_eq!(levels(0.5).pixels(), &[0, 181, 255]);
    }

    #[test]
    fn light_that_no_byte_holds_is_cut_off() {
        let mut image = plain(1, 1, 0.0);
        for (light, byte) in [(7.0, 255), (-1.0, 0), (f32::INFINITY, 255), (f32::NAN, 0)] {
            image.pixels[0] = [light; 3];
            assert_eq!(image.to_bytes().pixels(), &[byte; 3]);
        }
    }
}
