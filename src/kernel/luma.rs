//! Luma of colour images.

use super::dispatch::for_every_processor;
use crate::raster::{GreyImage, RgbImage};

/// Luma by ITU-R BT.601 in 8-bit fixed point: (77 R + 150 G + 29 B + 128) / 256.
#[must_use]
pub fn luma(image: &RgbImage) -> GreyImage {
    luma_in(image, Vec::new())
}

/// The same, in the memory of `spare`.
pub(crate) fn luma_in(image: &RgbImage, mut spare: Vec<u8>) -> GreyImage {
    spare.resize(image.width() * image.height(), 0);
    weigh(image.pixels(), &mut spare);
    GreyImage::from_pixels(image.width(), image.height(), spare).expect("as many pixels as the image has")
}

for_every_processor! {
    fn weigh(colours: &[u8], greys: &mut [u8]) = weigh_channels
}

#[inline(always)]
fn weigh_channels(colours: &[u8], greys: &mut [u8]) {
    for (grey, [red, green, blue]) in greys.iter_mut().zip(colours.as_chunks::<3>().0) {
        // At most 256 · 255 + 128: 16 bits hold it.
        let sum = 77 * u16::from(*red) + 150 * u16::from(*green) + 29 * u16::from(*blue) + 128;
        *grey = (sum >> 8) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn luma_of_grey_is_itself() {
        let grey = GreyImage::from_pixels(256, 1, (0..=255).collect()).unwrap();
        assert_eq!(luma(&RgbImage::from_grey(&grey)), grey);
    }

    proptest! {
        #[test]
        fn every_pixel_is_the_weighted_sum_of_its_channels(
            pixels in proptest::collection::vec(any::<[u8; 3]>(), 0..200),
        ) {
            let expected = pixels.iter().map(|&[red, green, blue]| {
                ((77 * u32::from(red) + 150 * u32::from(green) + 29 * u32::from(blue) + 128) / 256) as u8
            });
            let expected: Vec<u8> = expected.collect();
            let image = RgbImage::from_pixels(pixels.len(), 1, pixels.concat()).unwrap();
            let found = luma(&image);
            let mut plain = vec![0; pixels.len()];
            weigh_channels(image.pixels(), &mut plain);
            prop_assert_eq!(found.pixels(), &expected);
            prop_assert_eq!(&plain, &expected);
        }
    }
}
