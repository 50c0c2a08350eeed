//! Rectangular pixel planes: 8-bit grey for features, 8-bit RGB for the CNN and for people.
//!
//! Pixels are stored row by row without padding. Sizes are checked once, at construction, so the
//! inner loops above may index without doubt.

/// An 8-bit grey image of `width` × `height` pixels, row-major.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GreyImage {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl GreyImage {
    /// A black image.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![0; width * height] }
    }

    /// An image from `width * height` row-major bytes; `None` if the count differs.
    #[must_use]
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<u8>) -> Option<Self> {
        (pixels.len() == width.checked_mul(height)?).then_some(Self { width, height, pixels })
    }

    /// Makes room for an image of this size. Its pixels are to be written before they are read.
    pub(crate) fn reshape(&mut self, width: usize, height: usize) {
        self.pixels.resize(width * height, 0);
        (self.width, self.height) = (width, height);
    }

    /// Its memory, for another image.
    #[must_use]
    pub fn into_pixels(self) -> Vec<u8> {
        self.pixels
    }

    /// Width in pixels.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row-major.
    #[must_use]
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// All pixels, row-major, for writing.
    pub fn pixels_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }

    /// Row `y`.
    #[must_use]
    pub fn row(&self, y: usize) -> &[u8] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// Row `y`, for writing.
    pub fn row_mut(&mut self, y: usize) -> &mut [u8] {
        &mut self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// The pixel at column `x`, row `y`.
    #[must_use]
    pub fn get(&self, x: usize, y: usize) -> u8 {
        self.pixels[y * self.width + x]
    }

    /// Mean of all pixels, 0 (black) to 255 (white); 0 of no pixel.
    #[must_use]
    pub fn mean_luminance(&self) -> f32 {
        let sum: u64 = self.pixels.iter().map(|&pixel| u64::from(pixel)).sum();
        sum as f32 / self.pixels.len().max(1) as f32
    }
}

/// An 8-bit RGB image of `width` × `height` pixels, row-major, three bytes a pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RgbImage {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl RgbImage {
    /// A black image.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![0; width * height * 3] }
    }

    /// An image from `width * height * 3` row-major bytes; `None` if the count differs.
    #[must_use]
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<u8>) -> Option<Self> {
        let expected = width.checked_mul(height)?.checked_mul(3)?;
        (pixels.len() == expected).then_some(Self { width, height, pixels })
    }

    /// A colour image whose three channels all hold `grey`.
    #[must_use]
    pub fn from_grey(grey: &GreyImage) -> Self {
        let pixels = grey.pixels().iter().flat_map(|&value| [value; 3]).collect();
        Self { width: grey.width, height: grey.height, pixels }
    }

    /// Its memory, for another image.
    #[must_use]
    pub fn into_pixels(self) -> Vec<u8> {
        self.pixels
    }

    /// Width in pixels.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All bytes, row-major, R G B.
    #[must_use]
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// All bytes, row-major, R G B, for writing.
    pub fn pixels_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }

    /// Row `y`, three bytes a pixel.
    #[must_use]
    pub fn row(&self, y: usize) -> &[u8] {
        &self.pixels[y * self.width * 3..(y + 1) * self.width * 3]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_byte_count_is_refused() {
        assert!(GreyImage::from_pixels(3, 2, vec![0; 5]).is_none());
        assert!(RgbImage::from_pixels(3, 2, vec![0; 6]).is_none());
        assert!(RgbImage::from_pixels(usize::MAX, 2, vec![]).is_none());
    }
}
