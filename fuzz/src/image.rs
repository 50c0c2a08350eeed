//! Images: JPEG and PNG.

use loci::source;

use super::accepted;

/// Larger images are left out: decoding one takes a second, whatever the bytes.
const MAX_SIDE_PX: u32 = 512;

/// JPEG and PNG, [`source::decode`].
pub fn image(bytes: &[u8]) {
    if claims_a_large_image(bytes) {
        return;
    }
    if let Some(image) = accepted(source::decode(bytes, "image")) {
        assert_eq!(image.pixels().len(), image.width() * image.height() * 3);
        let thumbnail = source::decode(&source::thumbnail_jpeg(&image), "thumbnail").expect("a thumbnail");
        assert!(thumbnail.width() <= image.width() && thumbnail.height() <= image.height());
    }
}

fn claims_a_large_image(bytes: &[u8]) -> bool {
    let number = |at: usize, width: usize| {
        let bytes = bytes.get(at..at + width).unwrap_or_default();
        bytes.iter().fold(0, |number, byte| number << 8 | u32::from(*byte))
    };
    if bytes.starts_with(b"\x89PNG") {
        return number(16, 4).max(number(20, 4)) > MAX_SIDE_PX;
    }
    // Start of frame: marker (2), length (2), precision (1), height (2), width (2).
    let mut markers =
        bytes.windows(2).enumerate().filter(|(_, pair)| pair[0] == 0xFF && pair[1] & 0xF0 == 0xC0);
    markers.any(|(at, _)| number(at + 5, 2).max(number(at + 7, 2)) > MAX_SIDE_PX)
}
