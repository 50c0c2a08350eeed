//! What the header of a JPEG says of its picture (ITU-T T.81, B.1.1 and B.2.2).

/// What the pictures of a video have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct JpegKind {
    width_px: u16,
    height_px: u16,
    bits: u8,
    /// How luma and chroma are sampled; 0 where there is no chroma.
    sampling: [u8; 3],
}

impl JpegKind {
    /// Width and height.
    pub(super) fn size_px(self) -> [f32; 2] {
        [f32::from(self.width_px), f32::from(self.height_px)]
    }
}

/// Width and height in pixels; `None` if `bytes` are no JPEG.
pub(super) fn size_px(bytes: &[u8]) -> Option<(u16, u16)> {
    kind(bytes).map(|kind| (kind.width_px, kind.height_px))
}

/// The kind of picture; `None` if `bytes` are no JPEG.
pub(super) fn kind(bytes: &[u8]) -> Option<JpegKind> {
    let mut rest = bytes.strip_prefix(&[0xFF, 0xD8])?;
    loop {
        let (&[marker_start, marker], segment) = rest.split_first_chunk()?;
        if marker_start != 0xFF {
            return None;
        }
        if marker == 0xFF {
            // Any number of these may stand before a marker.
            rest = &rest[1..];
            continue;
        }
        let length = usize::from(u16::from_be_bytes(*segment.first_chunk()?));
        // Frame headers are SOF0 to SOF15; DHT, JPG and DAC lie between them.
        if matches!(marker, 0xC0..=0xCF) && !matches!(marker, 0xC4 | 0xC8 | 0xCC) {
            let &[_, _, bits, height_high, height_low, width_high, width_low] = segment.first_chunk()?;
            let height_px = u16::from_be_bytes([height_high, height_low]);
            let width_px = u16::from_be_bytes([width_high, width_low]);
            // A component after the other: number, sampling, table.
            let components = segment.get(8..length.clamp(8, segment.len().max(8))).unwrap_or_default();
            let sampling = [1, 4, 7].map(|at| components.get(at).copied().unwrap_or_default());
            return (width_px > 0 && height_px > 0).then_some(JpegKind {
                width_px,
                height_px,
                bits,
                sampling,
            });
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
    fn bytes_that_fill_up_are_passed_over() {
        let filled = [&HEADER[..8], &[0xFF, 0xFF], &HEADER[8..]].concat();
        assert_eq!(size_px(&filled), Some((320, 240)));
    }

    #[test]
    fn pictures_of_a_size_differ_in_kind_where_their_chroma_is_sampled_in_another_way() {
        let kind_of = |sampling: u8| {
            let components = [3, 1, sampling, 0, 2, 0x11, 1, 3, 0x11, 1];
            kind(&[&HEADER[..], &components].concat()).unwrap()
        };
        assert_eq!(kind_of(0x22), kind_of(0x22));
        assert_ne!(kind_of(0x22), kind_of(0x11));
        assert_eq!(kind_of(0x22).sampling, [0x22, 0x11, 0x11]);
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
