//! The size of a JPEG, read from its header (ITU-T T.81, B.1.1 and B.2.2).

/// Width and height in pixels; `None` if `bytes` are no JPEG.
pub(super) fn size_px(bytes: &[u8]) -> Option<(u16, u16)> {
    let mut rest = bytes.strip_prefix(&[0xFF, 0xD8])?;
    loop {
        let (&[marker_start, marker], segment) = rest.split_first_chunk()?;
        if marker_start != 0xFF {
            return None;
        }
        let length = usize::from(u16::from_be_bytes(*segment.first_chunk()?));
        // Frame headers are SOF0 to SOF15; DHT, JPG and DAC lie between them.
        if matches!(marker, 0xC0..=0xCF) && !matches!(marker, 0xC4 | 0xC8 | 0xCC) {
            let &[_, _, _, height_high, height_low, width_high, width_low] = segment.first_chunk()?;
            let height = u16::from_be_bytes([height_high, height_low]);
            let width = u16::from_be_bytes([width_high, width_low]);
            return (width > 0 && height > 0).then_some((width, height));
        }
        rest = segment.get(length.max(2)..)?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The header of a 320×240 JPEG: SOI, APP0, SOF0.
    const HEADER: [u8; 17] = [0xFF, 0xD8, 0xFF, 0xE0, 0, 4, 1, 2, 0xFF, 0xC0, 0, 17, 8, 0, 240, 1, 64];

    #[test]
    fn the_size_stands_in_the_frame_header() {
        assert_eq!(size_px(&HEADER), Some((320, 240)));
    }

    #[test]
    fn a_header_that_is_cut_off_has_no_size() {
        for length in 0..HEADER.len() {
            assert_eq!(size_px(&HEADER[..length]), None, "{length} bytes");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic_or_hang(tail in proptest::collection::vec(any::<u8>(), 0..64), cut in 2..17_usize) {
            let mut bytes = HEADER[..cut].to_vec();
            bytes.extend(tail);
            let _ = size_px(&bytes);
        }
    }
}
