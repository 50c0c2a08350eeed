//! Images from bytes, JPEG and PNG, told apart by content and bounded before they are decoded; and JPEGs of images.

use std::io::Cursor;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngDecoder;
use image::{DynamicImage, ExtendedColorType, ImageDecoder, ImageError};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use crate::raster::RgbImage;

/// Longest side in pixels.
const MAX_SIDE_PX: usize = 8192;
/// Shortest side in pixels in which anything can be recognised.
const MIN_SIDE_PX: usize = 32;
/// Quality of the JPEGs that are written.
const JPEG_QUALITY: u8 = 85;
/// Shorter side of a thumbnail in pixels: the input size of common CNNs, for retraining.
const THUMBNAIL_SIDE_PX: usize = 224;

/// Why bytes are no image.
#[derive(Debug, thiserror::Error)]
#[error("{reason}")]
pub struct CodecError {
    /// What is wrong with them, and what to do.
    pub reason: String,
}

/// Whether `bytes` begin as a JPEG.
#[must_use]
pub fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xFF, 0xD8, 0xFF])
}

/// Decodes a JPEG or PNG; the pixels of a JPEG are made in the memory of `spare`.
///
/// # Errors
/// If the bytes are neither, are cut off or damaged, or the image is smaller than 32 or larger than
/// 8,192 pixels a side.
pub fn decode(bytes: &[u8], spare: Vec<u8>) -> Result<RgbImage, CodecError> {
    let decoded = if bytes.is_empty() {
        Err("the file is empty; copy it again or remove it".to_owned())
    } else if is_jpeg(bytes) {
        decode_jpeg(bytes, spare)
    } else if bytes.starts_with(b"\x89PNG") {
        decode_png(bytes).map_err(|error| format!("{error}; copy it again or remove it"))
    } else {
        Err("neither JPEG nor PNG; convert it or remove it".to_owned())
    };
    decoded.map_err(|reason| CodecError { reason })
}

fn decode_jpeg(bytes: &[u8], mut pixels: Vec<u8>) -> Result<RgbImage, String> {
    if !has_end_of_image(bytes) {
        return Err("the JPEG is cut off; copy it again or remove it".to_owned());
    }
    // Some of the decoder's errors end in a line break.
    let damaged = |error| format!("{error:?}").split_whitespace().collect::<Vec<_>>().join(" ");
    let damaged = |error| format!("damaged JPEG ({}); copy it again or remove it", damaged(error));
    let options = DecoderOptions::default()
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX))
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(damaged)?;
    let (width, height) = decoder.dimensions().ok_or("the JPEG has no size; remove it")?;
    check_size(width, height)?;
    // As long as the decoder says, which fits the size checked above.
    pixels.resize(decoder.output_buffer_size().unwrap_or_default(), 0);
    decoder.decode_into(&mut pixels).map_err(damaged)?;
    RgbImage::from_pixels(width, height, pixels).ok_or_else(|| "the JPEG is not RGB; convert it".to_owned())
}

/// Decoders fill what is missing of a cut JPEG with grey and say nothing. Inside a scan a 0xFF byte is always escaped,
/// so the two bytes of the end marker behind the last scan's start are the marker: of the two, the end comes last.
fn has_end_of_image(bytes: &[u8]) -> bool {
    let is_start_or_end = |pair: &[u8]| pair == [0xFF, 0xDA] || pair == [0xFF, 0xD9];
    let last = bytes.windows(2).rposition(is_start_or_end);
    let has_start = || bytes.windows(2).any(|pair| pair == [0xFF, 0xDA]);
    last.is_some_and(|last| bytes[last + 1] == 0xD9 && has_start())
}

fn decode_png(bytes: &[u8]) -> Result<RgbImage, String> {
    let plain = |error: ImageError| error.to_string();
    if has_torn_palette(bytes) {
        return Err("the palette is torn".to_owned());
    }
    let decoder = PngDecoder::new(Cursor::new(bytes)).map_err(plain)?;
    let (width, height) = decoder.dimensions();
    check_size(width as usize, height as usize)?;
    let image = DynamicImage::from_decoder(decoder).map_err(plain)?.into_rgb8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    RgbImage::from_pixels(width, height, image.into_raw()).ok_or_else(|| "the PNG is not RGB".to_owned())
}

/// Whether a palette is no list of three bytes a colour: the decoder panics on it (png 0.18.1).
fn has_torn_palette(bytes: &[u8]) -> bool {
    let mut rest = bytes.get(8..).unwrap_or_default();
    // A chunk: length of its data (4), kind (4), data, checksum (4).
    while let Some((&[a, b, c, d, ref kind @ ..], after)) = rest.split_first_chunk::<8>() {
        let length = u32::from_be_bytes([a, b, c, d]) as usize;
        if kind == b"PLTE" && !length.is_multiple_of(3) {
            return true;
        }
        rest = after.get(length.saturating_add(4)..).unwrap_or_default();
    }
    false
}

/// Refuses sizes in which nothing can be recognised, or that would take too much memory.
pub(crate) fn check_size(width: usize, height: usize) -> Result<(), String> {
    if width.min(height) < MIN_SIDE_PX {
        Err(format!("{width}×{height} px is too small: use at least {MIN_SIDE_PX}×{MIN_SIDE_PX}"))
    } else if width.max(height) > MAX_SIDE_PX {
        Err(format!("{width}×{height} px is too large: shrink it to at most {MAX_SIDE_PX} a side"))
    } else {
        Ok(())
    }
}

/// `image` as a JPEG of quality 85.
#[must_use]
pub fn jpeg(image: &RgbImage) -> Vec<u8> {
    encode(image.pixels(), image.width() as u32, image.height() as u32)
}

/// `image` as a small JPEG whose shorter side has at most 224 px.
#[must_use]
pub fn thumbnail_jpeg(image: &RgbImage) -> Vec<u8> {
    let (width, height) = (image.width() as u32, image.height() as u32);
    let shrink = (width.min(height) as f32 / THUMBNAIL_SIDE_PX as f32).max(1.0);
    let full = image::RgbImage::from_raw(width, height, image.pixels().to_vec()).unwrap_or_default();
    let side = |pixels: u32| ((pixels as f32 / shrink).round() as u32).max(1);
    let small = image::imageops::thumbnail(&full, side(width), side(height));
    encode(&small, small.width(), small.height())
}

fn encode(pixels: &[u8], width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY);
    match image::ImageEncoder::write_image(encoder, pixels, width, height, ExtendedColorType::Rgb8) {
        Ok(()) => bytes,
        // Only an image without pixels cannot be encoded: it has no picture.
        Err(_) => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn gradient(width: usize, height: usize) -> RgbImage {
        let pixel = |i: usize| [(i % width * 255 / width) as u8, (i / width * 255 / height) as u8, 128];
        RgbImage::from_pixels(width, height, (0..width * height).flat_map(pixel).collect()).unwrap()
    }

    fn png(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        let image = image::GrayImage::new(width, height);
        image.write_to(&mut Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
        bytes
    }

    fn reason(bytes: &[u8]) -> String {
        let message = decode(bytes, Vec::new()).unwrap_err().to_string();
        assert!(!message.contains('\n'), "{message}");
        message
    }

    #[test]
    fn a_jpeg_decodes_to_nearly_what_was_encoded() {
        let image = gradient(64, 48);
        let decoded = decode(&jpeg(&image), Vec::new()).unwrap();
        let worst = decoded.pixels().iter().zip(image.pixels()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst < Some(20), "{worst:?}");
    }

    #[test]
    fn a_truncated_jpeg_is_refused() {
        let bytes = jpeg(&gradient(64, 48));
        assert!(reason(&bytes[..bytes.len() * 2 / 3]).contains("cut off"));
    }

    #[test]
    fn empty_foreign_small_and_huge_images_are_refused_before_decoding() {
        assert!(reason(b"").contains("empty"));
        assert!(reason(b"GIF89a").contains("neither JPEG nor PNG"));
        assert!(reason(&png(1, 1)).contains("1×1 px is too small"));
        assert!(reason(&png(20_000, 20_000)).contains("20000×20000 px is too large"));
        let mut huge = jpeg(&gradient(64, 48));
        let size = huge.windows(2).position(|pair| pair == [0xFF, 0xC0]).unwrap() + 5;
        huge[size..size + 4].copy_from_slice(&[0x4E, 0x20, 0x4E, 0x20]);
        assert!(reason(&huge).contains("20000×20000 px is too large"));
    }

    #[test]
    fn a_cut_png_is_refused() {
        let bytes = png(64, 64);
        reason(&bytes[..bytes.len() - 20]);
        assert!(decode(&bytes, Vec::new()).is_ok());
    }

    #[test]
    fn a_thumbnail_keeps_the_shape_and_never_grows() {
        let small = decode(&thumbnail_jpeg(&gradient(640, 480)), Vec::new()).unwrap();
        assert_eq!((small.width(), small.height()), (299, 224));
        let same = decode(&thumbnail_jpeg(&gradient(160, 120)), Vec::new()).unwrap();
        assert_eq!((same.width(), same.height()), (160, 120));
    }

    proptest! {
        #[test]
        fn damaged_jpegs_never_panic(
            position in any::<prop::sample::Index>(), byte in any::<u8>(), cut in any::<prop::sample::Index>(),
        ) {
            let mut bytes = jpeg(&gradient(64, 48));
            let position = position.index(bytes.len());
            bytes[position] = byte;
            let _ = decode(&bytes, Vec::new());
            bytes.truncate(cut.index(bytes.len()));
            let _ = decode(&bytes, Vec::new());
        }
    }
}
