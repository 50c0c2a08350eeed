//! From camera image to network input: resize, normalise, and split into planes.
//!
//! The whole image is stretched to the input size, not cropped to its centre: the borders of a view
//! (door frames, shop fronts) tell places apart, and a network bears a changed aspect ratio, the same
//! for each frame of a camera, better than it bears missing scenery.
//!
//! Resizing is separable linear interpolation whose filter widens with the reduction, so that every
//! source pixel counts (area-aware, as in Heckbert, "Fundamentals of Texture Mapping", 1989). Output
//! pixel i of n takes source pixel x of m with weight max(0, 1 − |x + ½ − c| / r), where
//! c = (i + ½) · m / n and r = max(m / n, 1), the weights scaled to sum 1.

use std::mem;

use super::card::InputCard;
use super::error::CnnError;
use crate::kernel::for_every_processor;
use crate::raster::RgbImage;

/// Turns images into tensors; keeps its buffers and tables from frame to frame.
#[derive(Clone, Debug)]
pub struct Preprocessor {
    input: InputCard,
    columns: Taps,
    rows: Taps,
    /// [`ROWS`] rows of the output, still as wide as the source.
    rows_between: Vec<Pixel>,
    /// `[3, height, width]`; of none yet if all were written elsewhere.
    tensor: Vec<f32>,
}

impl Preprocessor {
    /// A preprocessor for one network's input.
    #[must_use]
    pub fn new(input: &InputCard) -> Self {
        Self {
            input: input.clone(),
            columns: Taps::default(),
            rows: Taps::default(),
            rows_between: Vec::new(),
            tensor: Vec::new(),
        }
    }

    /// The tensor `[1, 3, height, width]` of an image of any size: R, G and B planes, row-major,
    /// each value (v − mean) · scale. Allocates only when the size of the images changes.
    ///
    /// # Errors
    /// [`CnnError::EmptyImage`] for an image without pixels.
    pub fn tensor(&mut self, image: &RgbImage) -> Result<&[f32], CnnError> {
        let mut tensor = mem::take(&mut self.tensor);
        tensor.resize(3 * self.input.width_px * self.input.height_px, 0.0);
        let written = self.write_tensor(image, &mut tensor);
        self.tensor = tensor;
        written.map(|()| self.tensor.as_slice())
    }

    /// Writes that tensor over `tensor`, which is as long.
    ///
    /// # Errors
    /// As [`tensor`](Self::tensor).
    pub fn write_tensor(&mut self, image: &RgbImage, tensor: &mut [f32]) -> Result<(), CnnError> {
        let (width_px, height_px) = (image.width(), image.height());
        if width_px == 0 || height_px == 0 {
            return Err(CnnError::EmptyImage { width_px, height_px });
        }
        self.columns.prepare(width_px, self.input.width_px);
        self.rows.prepare(height_px, self.input.height_px);
        self.rows_between.resize(width_px, [[0.0; ROWS]; 3]);
        for y in (0..self.input.height_px).step_by(ROWS) {
            blend_rows(image, &self.rows, y, self.rows_between.as_flattened_mut());
            blend_columns(&self.rows_between, &self.columns, &self.input, y, tensor);
        }
        Ok(())
    }
}

/// Rows of the output that are made together, side by side.
const ROWS: usize = 8;
/// Values of a row that are summed up at a time.
const LANES: usize = 32;

/// R, G and B of a column in [`ROWS`] rows.
type Pixel = [[f32; ROWS]; 3];

for_every_processor! {
    /// Vertical pass: rows of the output from row `y` on, as wide as the source.
    fn blend_rows(image: &RgbImage, rows: &Taps, y: usize, between: &mut [[f32; ROWS]]) = blend_all_rows
}

for_every_processor! {
    /// Horizontal pass over those rows, into the three planes of `tensor`.
    fn blend_columns(
        between: &[Pixel],
        columns: &Taps,
        input: &InputCard,
        y: usize,
        tensor: &mut [f32],
    ) = blend_all_columns
}

#[inline(always)]
fn blend_all_rows(image: &RgbImage, rows: &Taps, y: usize, between: &mut [[f32; ROWS]]) {
    let count = ROWS.min(rows.output_px - y);
    let length = 3 * image.width();
    let mut x = 0;
    while x + LANES <= length {
        let mut sums = [[0.0; LANES]; ROWS];
        for (row, sums) in sums.iter_mut().take(count).enumerate() {
            *sums = blend_row::<LANES>(image, rows.of(y + row), x);
        }
        for (tile, between) in between[x..x + LANES].as_chunks_mut::<ROWS>().0.iter_mut().enumerate() {
            for i in 0..ROWS {
                for row in 0..ROWS {
                    between[i][row] = sums[row][tile * ROWS + i];
                }
            }
        }
        x += LANES;
    }
    for (x, between) in between.iter_mut().enumerate().skip(x) {
        for (row, value) in between.iter_mut().take(count).enumerate() {
            [*value] = blend_row::<1>(image, rows.of(y + row), x);
        }
    }
}

/// `N` values of a row from `x` on.
#[inline(always)]
fn blend_row<const N: usize>(image: &RgbImage, (first, weights): (usize, &[f32]), x: usize) -> [f32; N] {
    let mut sums = [0.0; N];
    for (tap, &weight) in weights.iter().enumerate() {
        let values = &image.row(first + tap)[x..x + N];
        for lane in 0..N {
            sums[lane] += weight * f32::from(values[lane]);
        }
    }
    sums
}

#[inline(always)]
fn blend_all_columns(between: &[Pixel], columns: &Taps, input: &InputCard, y: usize, tensor: &mut [f32]) {
    let &InputCard { width_px, height_px, mean, scale, .. } = input;
    let rows = y * width_px..(y + ROWS.min(height_px - y)) * width_px;
    let (red, rest) = tensor.split_at_mut(width_px * height_px);
    let (green, blue) = rest.split_at_mut(width_px * height_px);
    let mut planes = [&mut red[rows.clone()], &mut green[rows.clone()], &mut blue[rows]];
    for x in (0..width_px).step_by(ROWS) {
        let wide = ROWS.min(width_px - x);
        let mut tile = [[[0.0; ROWS]; 3]; ROWS];
        for (column, pixel) in tile.iter_mut().take(wide).enumerate() {
            *pixel = blend_column(between, columns.of(x + column));
            for channel in pixel {
                for value in channel {
                    *value = (*value - mean) * scale;
                }
            }
        }
        for (channel, plane) in planes.iter_mut().enumerate() {
            for (pixels, values) in plane.chunks_exact_mut(width_px).zip(&rows_of(&tile, channel)) {
                match pixels[x..].first_chunk_mut::<ROWS>() {
                    Some(pixels) => *pixels = *values,
                    None => pixels[x..].copy_from_slice(&values[..wide]),
                }
            }
        }
    }
}

/// A column of the output.
#[inline(always)]
fn blend_column(between: &[Pixel], (first, weights): (usize, &[f32])) -> Pixel {
    let mut sums = [[0.0; ROWS]; 3];
    for (pixel, &weight) in between[first..].iter().zip(weights) {
        for channel in 0..3 {
            for row in 0..ROWS {
                sums[channel][row] += weight * pixel[channel][row];
            }
        }
    }
    sums
}

/// A channel of a few columns, row by row.
#[inline(always)]
fn rows_of(columns: &[Pixel; ROWS], channel: usize) -> [[f32; ROWS]; ROWS] {
    let mut rows = [[0.0; ROWS]; ROWS];
    for (row, values) in rows.iter_mut().enumerate() {
        for (value, column) in values.iter_mut().zip(columns) {
            *value = column[channel][row];
        }
    }
    rows
}

/// For each output position of one axis: the first source position and the weights from there on.
#[derive(Clone, Debug, Default)]
struct Taps {
    source_px: usize,
    output_px: usize,
    /// (first source position, first weight, end of the weights) a position.
    spans: Vec<(usize, usize, usize)>,
    weights: Vec<f32>,
}

impl Taps {
    /// Fills the table, unless it holds these sizes already.
    fn prepare(&mut self, source_px: usize, output_px: usize) {
        if (self.source_px, self.output_px) == (source_px, output_px) {
            return;
        }
        (self.source_px, self.output_px) = (source_px, output_px);
        self.spans.clear();
        self.weights.clear();
        let ratio = source_px as f64 / output_px as f64;
        let radius = ratio.max(1.0);
        for output in 0..output_px {
            let centre = (output as f64 + 0.5) * ratio;
            let first = (centre - radius - 0.5).ceil().max(0.0) as usize;
            let last = ((centre + radius - 0.5).floor() as usize).min(source_px - 1);
            let weight = |source: usize| (1.0 - (source as f64 + 0.5 - centre).abs() / radius).max(0.0);
            let total: f64 = (first..=last).map(weight).sum();
            let begin = self.weights.len();
            self.weights.extend((first..=last).map(|source| (weight(source) / total) as f32));
            self.spans.push((first, begin, self.weights.len()));
        }
    }

    fn of(&self, output: usize) -> (usize, &[f32]) {
        let (first, begin, end) = self.spans[output];
        (first, &self.weights[begin..end])
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn input(width_px: usize, height_px: usize) -> InputCard {
        InputCard { name: "image".to_owned(), width_px, height_px, mean: 127.0, scale: 1.0 / 128.0 }
    }

    /// Weights that are a smooth riddle of position and seed, so that errors of one pixel show.
    fn image(width: usize, height: usize, seed: u32) -> RgbImage {
        let byte = |i: usize| ((i as u32).wrapping_mul(2_654_435_761).wrapping_add(seed) >> 13) as u8;
        RgbImage::from_pixels(width, height, (0..width * height * 3).map(byte).collect()).unwrap()
    }

    /// The definition, pixel by pixel over the whole image.
    fn oracle(image: &RgbImage, input: &InputCard) -> Vec<f32> {
        let weight = |output: usize, outputs: usize, source: usize, sources: usize| {
            let ratio = sources as f64 / outputs as f64;
            (1.0 - (source as f64 + 0.5 - (output as f64 + 0.5) * ratio).abs() / ratio.max(1.0)).max(0.0)
        };
        let mut tensor = Vec::new();
        for channel in 0..3 {
            for y in 0..input.height_px {
                for x in 0..input.width_px {
                    let (mut sum, mut total) = (0.0, 0.0);
                    for source_y in 0..image.height() {
                        for source_x in 0..image.width() {
                            let w = weight(y, input.height_px, source_y, image.height())
                                * weight(x, input.width_px, source_x, image.width());
                            sum += w * f64::from(image.row(source_y)[source_x * 3 + channel]);
                            total += w;
                        }
                    }
                    tensor.push(((sum / total - f64::from(input.mean)) * f64::from(input.scale)) as f32);
                }
            }
        }
        tensor
    }

    fn assert_close(got: &[f32], expected: &[f32]) {
        assert_eq!(got.len(), expected.len());
        let worst = got.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 1e-5, "worst difference {worst}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn resizing_agrees_with_its_definition(
            (width, height) in (1_usize..50, 1_usize..50), side in (16_usize..24, 16_usize..24), seed in any::<u32>()
        ) {
            let (image, input) = (image(width, height, seed), input(side.0, side.1));
            assert_close(Preprocessor::new(&input).tensor(&image).unwrap(), &oracle(&image, &input));
        }
    }

    #[test]
    fn rows_are_blended_the_same_to_the_bit_whatever_the_processor_offers() {
        let (image, input) = (image(45, 27, 3), input(19, 11));
        let (mut rows, mut columns) = (Taps::default(), Taps::default());
        rows.prepare(27, 11);
        columns.prepare(45, 19);
        for y in [0, 8] {
            let (mut newest, mut plain) = (vec![[0.0; ROWS]; 135], vec![[0.0; ROWS]; 135]);
            blend_rows(&image, &rows, y, &mut newest);
            blend_all_rows(&image, &rows, y, &mut plain);
            assert_eq!(newest, plain);
            let (mut newest, mut tensor) = (vec![1.0; 3 * 19 * 11], vec![1.0; 3 * 19 * 11]);
            blend_columns(plain.as_chunks().0, &columns, &input, y, &mut newest);
            blend_all_columns(plain.as_chunks().0, &columns, &input, y, &mut tensor);
            assert_eq!(newest, tensor);
        }
    }

    #[test]
    fn an_image_of_the_input_size_is_only_normalised_and_split() {
        let (image, input) = (image(20, 16, 7), input(20, 16));
        let mut preprocessor = Preprocessor::new(&input);
        let tensor = preprocessor.tensor(&image).unwrap();
        for (i, &value) in tensor.iter().enumerate() {
            let (channel, pixel) = (i / 320, i % 320);
            assert_eq!(value, (f32::from(image.pixels()[pixel * 3 + channel]) - 127.0) / 128.0);
        }
    }

    #[test]
    fn every_source_pixel_counts_when_the_image_shrinks() {
        let mut white_line = RgbImage::new(640, 48);
        (0..48).for_each(|y| white_line.pixels_mut()[(y * 640 + 301) * 3..][..3].fill(255));
        let input = input(16, 16);
        let mut preprocessor = Preprocessor::new(&input);
        let brightness: f32 =
            preprocessor.tensor(&white_line).unwrap().iter().map(|v| v * 128.0 + 127.0).sum();
        assert!((brightness / 768.0 - 255.0 / 640.0).abs() < 0.01, "{}", brightness / 768.0);
    }

    #[test]
    fn a_change_of_size_leaves_nothing_of_the_image_before() {
        let input = input(18, 17);
        let mut used = Preprocessor::new(&input);
        for (width, height) in [(64, 48), (5, 90), (64, 48), (1, 1)] {
            let image = image(width, height, 3);
            let fresh = Preprocessor::new(&input).tensor(&image).unwrap().to_vec();
            assert_eq!(used.tensor(&image).unwrap(), fresh);
        }
    }

    #[test]
    fn frames_of_one_size_reuse_the_buffers() {
        let input = input(32, 32);
        let mut preprocessor = Preprocessor::new(&input);
        let first = preprocessor.tensor(&image(64, 48, 1)).unwrap().as_ptr();
        let tables = preprocessor.columns.weights.as_ptr();
        assert_eq!(preprocessor.tensor(&image(64, 48, 2)).unwrap().as_ptr(), first);
        assert_eq!(preprocessor.columns.weights.as_ptr(), tables);
    }

    #[test]
    fn an_image_without_pixels_is_an_error() {
        let error = Preprocessor::new(&input(16, 16)).tensor(&RgbImage::new(0, 5)).unwrap_err();
        assert_eq!(error.to_string(), "the image is 0x5 pixels: nothing to describe");
    }
}
