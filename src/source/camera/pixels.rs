//! Raw camera buffers to images: YUYV, NV12 and GREY, row by row, with the padding that drivers put behind a row.
//!
//! The colour matrix is that of ITU-R BT.601, which V4L2 prescribes for both colour formats unless the driver
//! says otherwise: with E = 255 / 219 for luma and C = 255 / 224 for chroma in limited range (1 in full range),
//! R = E (Y − Y₀) + 1.402 C (V − 128), B = E (Y − Y₀) + 1.772 C (U − 128),
//! G = E (Y − Y₀) − 0.344136 C (U − 128) − 0.714136 C (V − 128), where Y₀ is 16 or 0.

use crate::raster::RgbImage;

/// Where the pixels of a frame lie in its buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    /// Pixels a row.
    pub(super) width_px: usize,
    /// Rows.
    pub(super) height_px: usize,
    /// Bytes from the start of a row to that of the next; 0 where the driver does not say.
    pub(super) stride_bytes: usize,
}

impl Layout {
    /// Bytes from row to row where a row has so many.
    fn stride(self, row_bytes: usize) -> usize {
        self.stride_bytes.max(row_bytes).max(1)
    }

    /// Bytes of all rows; the last one needs no padding.
    fn needed_bytes(self, row_bytes: usize) -> usize {
        let others = self.height_px.saturating_sub(1);
        others.saturating_mul(self.stride(row_bytes)).saturating_add(row_bytes)
    }
}

/// Which numbers stand for black and white.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Range {
    /// 0 to 255.
    Full,
    /// Luma 16 to 235, chroma 16 to 240.
    Limited,
}

/// The colour matrix in 16-bit fixed point.
struct Matrix {
    black: i32,
    luma: i32,
    red_v: i32,
    green_u: i32,
    green_v: i32,
    blue_u: i32,
}

const FULL: Matrix =
    Matrix { black: 0, luma: 65_536, red_v: 91_881, green_u: 22_553, green_v: 46_802, blue_u: 116_130 };
const LIMITED: Matrix =
    Matrix { black: 16, luma: 76_309, red_v: 104_597, green_u: 25_675, green_v: 53_279, blue_u: 132_201 };

impl Matrix {
    fn of(range: Range) -> &'static Self {
        match range {
            Range::Full => &FULL,
            Range::Limited => &LIMITED,
        }
    }

    #[inline]
    fn rgb(&self, y: u8, u: u8, v: u8) -> [u8; 3] {
        let luma = (i32::from(y) - self.black) * self.luma + (1 << 15);
        let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
        let byte = |fixed: i32| (fixed >> 16).clamp(0, 255) as u8;
        [
            byte(luma + self.red_v * v),
            byte(luma - self.green_u * u - self.green_v * v),
            byte(luma + self.blue_u * u),
        ]
    }

    /// Adds a row of `width_px` pixels, two of which share their U and V each.
    #[inline]
    fn push_row(
        &self,
        pixels: &mut Vec<u8>,
        width_px: usize,
        pairs: impl Iterator<Item = ([u8; 2], [u8; 2])>,
    ) {
        let end = pixels.len() + width_px * 3;
        for ([left, right], [u, v]) in pairs {
            pixels.extend_from_slice(&self.rgb(left, u, v));
            pixels.extend_from_slice(&self.rgb(right, u, v));
        }
        // Where the width is odd, the last pair holds one pixel too many.
        pixels.truncate(end);
    }
}

/// The colour image in a YUYV buffer; the error says how many bytes are missing. Its
/// pixels are made in the memory of `spare`.
pub(super) fn rgb_from_yuyv(
    bytes: &[u8],
    layout: Layout,
    range: Range,
    spare: Vec<u8>,
) -> Result<RgbImage, String> {
    let matrix = Matrix::of(range);
    let rows = rows(bytes, layout, layout.width_px.div_ceil(2) * 4)?;
    let mut pixels = cleared(spare, layout.width_px * layout.height_px * 3);
    for row in rows {
        let pairs = row.as_chunks::<4>().0.iter().map(|&[left, u, right, v]| ([left, right], [u, v]));
        matrix.push_row(&mut pixels, layout.width_px, pairs);
    }
    image(RgbImage::from_pixels(layout.width_px, layout.height_px, pixels))
}

/// The colour image in an NV12 buffer, a plane of luma and then one of U and V for every square of four pixels; the
/// error says how many bytes are missing.
pub(super) fn rgb_from_nv12(
    bytes: &[u8],
    layout: Layout,
    range: Range,
    spare: Vec<u8>,
) -> Result<RgbImage, String> {
    let matrix = Matrix::of(range);
    let of_chroma = Layout { height_px: layout.height_px.div_ceil(2), ..layout };
    let even_width_px = layout.width_px.div_ceil(2) * 2;
    let luma_bytes = layout.stride(even_width_px).saturating_mul(layout.height_px);
    let needed = luma_bytes.saturating_add(of_chroma.needed_bytes(even_width_px));
    if bytes.len() < needed {
        return Err(cut_off(bytes.len(), needed));
    }
    let (luma, chroma) = bytes.split_at(luma_bytes);
    let chroma_rows = rows(chroma, of_chroma, even_width_px)?.flat_map(|row| [row, row]);
    let mut pixels = cleared(spare, layout.width_px * layout.height_px * 3);
    for (luma, chroma) in rows(luma, layout, even_width_px)?.zip(chroma_rows) {
        let pairs = luma.as_chunks::<2>().0.iter().zip(chroma.as_chunks::<2>().0);
        matrix.push_row(&mut pixels, layout.width_px, pairs.map(|(&ys, &uv)| (ys, uv)));
    }
    image(RgbImage::from_pixels(layout.width_px, layout.height_px, pixels))
}

/// The colour image in a GREY buffer, whose channels are all alike; the error says how many bytes are missing. Its
/// pixels are made in the memory of `spare`.
pub(super) fn rgb_from_grey(bytes: &[u8], layout: Layout, spare: Vec<u8>) -> Result<RgbImage, String> {
    let rows = rows(bytes, layout, layout.width_px)?;
    let mut pixels = cleared(spare, layout.width_px * layout.height_px * 3);
    rows.for_each(|row| pixels.extend(row.iter().flat_map(|&grey| [grey; 3])));
    image(RgbImage::from_pixels(layout.width_px, layout.height_px, pixels))
}

/// The memory of `spare`, with room for so many bytes.
fn cleared(mut spare: Vec<u8>, bytes: usize) -> Vec<u8> {
    spare.clear();
    spare.reserve(bytes);
    spare
}

/// The rows of a buffer without the padding behind them.
fn rows(bytes: &[u8], layout: Layout, row_bytes: usize) -> Result<impl Iterator<Item = &[u8]>, String> {
    let needed = layout.needed_bytes(row_bytes);
    if bytes.len() < needed {
        return Err(cut_off(bytes.len(), needed));
    }
    Ok(bytes.chunks(layout.stride(row_bytes)).take(layout.height_px).map(move |row| &row[..row_bytes]))
}

fn cut_off(arrived: usize, needed: usize) -> String {
    format!("the frame is cut off: {arrived} of {needed} bytes arrived")
}

fn image<T>(image: Option<T>) -> Result<T, String> {
    image.ok_or_else(|| "the frame has no pixels".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The same colours from the equations at the head of this file, in floating point.
    fn naive_rgb(y: u8, u: u8, v: u8, range: Range) -> [f64; 3] {
        let (black, luma, chroma) = match range {
            Range::Full => (0.0, 1.0, 1.0),
            Range::Limited => (16.0, 255.0 / 219.0, 255.0 / 224.0),
        };
        let y = (f64::from(y) - black) * luma;
        let (u, v) = ((f64::from(u) - 128.0) * chroma, (f64::from(v) - 128.0) * chroma);
        [y + 1.402 * v, y - 0.344_136 * u - 0.714_136 * v, y + 1.772 * u].map(|c| c.clamp(0.0, 255.0))
    }

    /// Finds every byte by its address instead of walking.
    fn naive_image(bytes: &[u8], layout: Layout, range: Range) -> Vec<[f64; 3]> {
        let mut pixels = Vec::new();
        for row in 0..layout.height_px {
            for column in 0..layout.width_px {
                let pair = row * layout.stride_bytes + column / 2 * 4;
                let y = bytes[pair + column % 2 * 2];
                pixels.push(naive_rgb(y, bytes[pair + 1], bytes[pair + 3], range));
            }
        }
        pixels
    }

    fn worst(image: &RgbImage, expected: &[[f64; 3]]) -> f64 {
        let values = expected.iter().flatten();
        image.pixels().iter().zip(values).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
    }

    fn one_pair(yuyv: [u8; 4], range: Range) -> Vec<u8> {
        let layout = Layout { width_px: 2, height_px: 1, stride_bytes: 4 };
        rgb_from_yuyv(&yuyv, layout, range, vec![9; 5]).unwrap().pixels().to_vec()
    }

    #[test]
    fn black_and_white_are_those_of_the_range() {
        assert_eq!(one_pair([16, 128, 235, 128], Range::Limited), [0, 0, 0, 255, 255, 255]);
        assert_eq!(one_pair([0, 128, 255, 128], Range::Full), [0, 0, 0, 255, 255, 255]);
        assert_eq!(one_pair([0, 128, 255, 128], Range::Limited), [0, 0, 0, 255, 255, 255]);
        // The red of BT.601 in limited range.
        assert_eq!(one_pair([81, 90, 81, 240], Range::Limited)[..3], [254, 0, 0]);
    }

    #[test]
    fn all_colours_are_within_one_of_the_equations() {
        for range in [Range::Full, Range::Limited] {
            for y in 0..=255 {
                for (u, v) in (0..=255).step_by(5).flat_map(|u| (0..=255).step_by(3).map(move |v| (u, v))) {
                    let layout = Layout { width_px: 1, height_px: 1, stride_bytes: 0 };
                    let image = rgb_from_yuyv(&[y, u, 0, v], layout, range, vec![9; 5]).unwrap();
                    assert!(worst(&image, &[naive_rgb(y, u, v, range)]) < 0.51, "{y} {u} {v}");
                }
            }
        }
    }

    fn layouts() -> impl Strategy<Value = Layout> {
        (1_usize..20, 1_usize..12, 0_usize..9).prop_map(|(width_px, height_px, padding)| Layout {
            width_px,
            height_px,
            stride_bytes: width_px.div_ceil(2) * 4 + padding,
        })
    }

    proptest! {
        #[test]
        fn yuyv_rows_are_found_behind_any_padding(
            layout in layouts(),
            bytes in prop::collection::vec(any::<u8>(), 12 * 49),
        ) {
            let image = rgb_from_yuyv(&bytes, layout, Range::Full, vec![9; 5]).unwrap();
            prop_assert_eq!((image.width(), image.height()), (layout.width_px, layout.height_px));
            prop_assert!(worst(&image, &naive_image(&bytes, layout, Range::Full)) < 0.51);
        }

        #[test]
        fn nv12_planes_are_found_behind_any_padding(
            layout in layouts(),
            bytes in prop::collection::vec(any::<u8>(), 18 * 49),
        ) {
            let image = rgb_from_nv12(&bytes, layout, Range::Limited, vec![9; 5]).unwrap();
            let stride = layout.stride_bytes;
            let mut expected = Vec::new();
            for (y, x) in (0..layout.height_px).flat_map(|y| (0..layout.width_px).map(move |x| (y, x))) {
                let chroma = (layout.height_px + y / 2) * stride + x / 2 * 2;
                expected.push(naive_rgb(bytes[y * stride + x], bytes[chroma], bytes[chroma + 1], Range::Limited));
            }
            prop_assert_eq!((image.width(), image.height()), (layout.width_px, layout.height_px));
            prop_assert!(worst(&image, &expected) < 0.51);
        }

        #[test]
        fn grey_rows_are_found_behind_any_padding(
            layout in layouts(),
            bytes in prop::collection::vec(any::<u8>(), 12 * 49),
        ) {
            let image = rgb_from_grey(&bytes, layout, vec![9; 5]).unwrap();
            for y in 0..layout.height_px {
                for x in 0..layout.width_px {
                    let grey = bytes[y * layout.stride_bytes + x];
                    prop_assert_eq!(&image.row(y)[3 * x..][..3], &[grey; 3]);
                }
            }
        }

        #[test]
        fn a_buffer_one_byte_short_is_refused_and_one_of_exact_length_is_not(layout in layouts()) {
            let needed = (layout.height_px - 1) * layout.stride_bytes + layout.width_px.div_ceil(2) * 4;
            prop_assert!(rgb_from_yuyv(&vec![0; needed], layout, Range::Full, vec![9; 5]).is_ok());
            let reason = rgb_from_yuyv(&vec![0; needed - 1], layout, Range::Full, vec![9; 5]).unwrap_err();
            let expected = format!("the frame is cut off: {} of {needed} bytes arrived", needed - 1);
            prop_assert_eq!(reason, expected);
            let needed = (layout.height_px - 1) * layout.stride_bytes + layout.width_px;
            prop_assert!(rgb_from_grey(&vec![0; needed], layout, vec![9; 5]).is_ok());
            prop_assert!(rgb_from_grey(&vec![0; needed - 1], layout, vec![9; 5]).is_err());
            let rows = layout.height_px + layout.height_px.div_ceil(2);
            let needed = (rows - 1) * layout.stride_bytes + layout.width_px.div_ceil(2) * 2;
            prop_assert!(rgb_from_nv12(&vec![0; needed], layout, Range::Full, vec![9; 5]).is_ok());
            let reason = rgb_from_nv12(&vec![0; needed - 1], layout, Range::Full, vec![9; 5]).unwrap_err();
            prop_assert!(reason.contains(&format!("{} of {needed} bytes", needed - 1)), "{}", reason);
        }

        #[test]
        fn no_layout_can_break_the_conversion(
            width_px in 0_usize..9000,
            height_px in 0_usize..9000,
            stride_bytes in any::<usize>(),
            bytes in prop::collection::vec(any::<u8>(), 0..64),
        ) {
            let layout = Layout { width_px, height_px, stride_bytes };
            let _ = rgb_from_yuyv(&bytes, layout, Range::Limited, vec![9; 5]);
            let _ = rgb_from_nv12(&bytes, layout, Range::Full, vec![9; 5]);
            let _ = rgb_from_grey(&bytes, layout, vec![9; 5]);
        }
    }
}
