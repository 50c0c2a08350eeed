//! Bilinear resize of grey images, for the levels of the pyramid.

use super::dispatch::for_every_processor;
use super::lanes::{EachLane, for_lanes, lanes, lanes_mut};
use crate::raster::GreyImage;

/// Weights are fixed-point numbers with this many fractional bits.
const FRACTION_BITS: u32 = 7;
const ONE: u16 = 1 << FRACTION_BITS;
/// Added to a weighted sum before it is shifted, so that it rounds.
const HALF: u16 = ONE / 2;
/// Pixels of a row that are made at a time.
const LANES: usize = 16;
/// Of how many pixels each of them is made at least. Levels of 5/6 of the one before need five, sometimes six.
const LEAST_DEPTH: usize = 5;

/// Resizes images from one size to another, again and again.
#[derive(Debug, Default)]
pub struct Resizer {
    rows: Vec<Tap>,
    columns: Columns,
    /// A row between two of the image, with room for [`LANES`] more at each end.
    between: Vec<u8>,
    /// Width and height before and after.
    sizes: [(usize, usize); 2],
}

impl Resizer {
    /// Makes `resized`, which says the size, what `image` is after bilinear interpolation between pixel centres.
    ///
    /// Meant for factors near one, as between pyramid levels: a strong reduction would alias. An image without pixels
    /// leaves `resized` as it is.
    pub fn resize_bilinear(&mut self, image: &GreyImage, resized: &mut GreyImage) {
        let sizes = [image, resized].map(|image| (image.width(), image.height()));
        if sizes[0] == sizes[1] {
            return resized.pixels_mut().copy_from_slice(image.pixels());
        }
        if !image.pixels().is_empty() && !resized.pixels().is_empty() {
            self.fit(sizes);
            resize(self, image, resized);
        }
    }

    /// Prepares for images of these sizes, if it is not prepared already.
    fn fit(&mut self, sizes: [(usize, usize); 2]) {
        if self.sizes == sizes {
            return;
        }
        let [(from_width, from_height), (to_width, to_height)] = sizes;
        self.rows = taps(from_height, to_height);
        self.columns = Columns::new(&taps(from_width, to_width));
        self.between = vec![0; self.columns.room(from_width)];
        self.sizes = sizes;
    }
}

/// Where a pixel takes its value: two neighbours and the weight of the second.
#[derive(Clone, Copy, Debug)]
struct Tap {
    first: usize,
    second: usize,
    weight: u16,
}

fn taps(from: usize, to: usize) -> Vec<Tap> {
    let last = from.saturating_sub(1);
    let tap = |index| {
        let centre = (index as f64 + 0.5) * from as f64 / to as f64 - 0.5;
        let clamped = centre.clamp(0.0, last as f64);
        let first = clamped as usize;
        let weight = ((clamped - first as f64) * f64::from(ONE)).round() as u16;
        Tap { first, second: (first + 1).min(last), weight }
    };
    (0..to).map(tap).collect()
}

/// The taps of a row, so that several pixels can be made at a time: pixel i of a few takes its value from those that
/// begin i after their start, of which most count nothing.
#[derive(Debug, Default)]
struct Columns {
    /// Where the pixels begin, in a row with [`LANES`] in front.
    starts: Vec<usize>,
    /// How many a pixel is made of.
    depth: usize,
    /// What each counts for each pixel, `depth` for every start.
    weights: Vec<[u16; LANES]>,
}

impl Columns {
    fn new(taps: &[Tap]) -> Self {
        let start = |taps: &[Tap]| {
            let starts = taps.iter().enumerate().map(|(lane, tap)| LANES + tap.first - lane);
            starts.min().unwrap_or_default()
        };
        let starts: Vec<usize> = taps.chunks(LANES).map(start).collect();
        let places = taps.chunks(LANES).zip(&starts).flat_map(|(taps, start)| {
            let place = move |(lane, tap): (usize, &Tap)| (lane, LANES + tap.first - lane - start, *tap);
            taps.iter().enumerate().map(place)
        });
        let places: Vec<(usize, usize, Tap)> = places.collect();
        let depth =
            places.iter().map(|&(_, offset, _)| offset + 2).max().unwrap_or_default().max(LEAST_DEPTH);
        let mut weights = vec![[0; LANES]; starts.len() * depth];
        for (pixel, &(lane, offset, tap)) in places.iter().enumerate() {
            let weights = &mut weights[pixel / LANES * depth..];
            weights[offset][lane] += ONE - tap.weight;
            weights[offset + tap.second - tap.first][lane] += tap.weight;
        }
        Self { starts, depth, weights }
    }

    /// Values that a row of so many pixels needs room for.
    fn room(&self, width: usize) -> usize {
        let last = self.starts.iter().max().map_or(0, |start| start + self.depth + LANES);
        last.max(LANES + width)
    }
}

for_every_processor! {
    fn resize(resizer: &mut Resizer, image: &GreyImage, resized: &mut GreyImage) = resize_rows
}

#[inline(always)]
fn resize_rows(resizer: &mut Resizer, image: &GreyImage, resized: &mut GreyImage) {
    let Resizer { columns, rows, between, .. } = resizer;
    for (y, row) in rows.iter().enumerate() {
        let values = &mut between[LANES..LANES + image.width()];
        let rows = [image.row(row.first), image.row(row.second)];
        for_lanes(0..values.len(), MixRows { rows, weight: row.weight, values });
        // Of weights whose number is known the sum needs no loop.
        match columns.depth {
            5 => make_row(columns, columns.weights.as_chunks::<5>().0, between, resized.row_mut(y)),
            6 => make_row(columns, columns.weights.as_chunks::<6>().0, between, resized.row_mut(y)),
            depth => {
                let weights = columns.weights.chunks_exact(depth);
                for ((pixels, &start), weights) in
                    resized.row_mut(y).chunks_mut(LANES).zip(&columns.starts).zip(weights)
                {
                    make(pixels, &between[start..], weights);
                }
            }
        }
    }
}

#[inline(always)]
fn make_row<const DEPTH: usize>(
    columns: &Columns,
    weights: &[[[u16; LANES]; DEPTH]],
    values: &[u8],
    pixels: &mut [u8],
) {
    for ((pixels, &start), weights) in pixels.chunks_mut(LANES).zip(&columns.starts).zip(weights) {
        make(pixels, &values[start..], weights);
    }
}

/// Makes a row between two, of which the second has this weight.
struct MixRows<'a> {
    rows: [&'a [u8]; 2],
    weight: u16,
    values: &'a mut [u8],
}

impl EachLane for MixRows<'_> {
    #[inline(always)]
    fn step<const N: usize>(&mut self, x: usize) {
        let (upper, lower) = (lanes::<N>(self.rows[0], x), lanes::<N>(self.rows[1], x));
        let mut sums = [HALF; N];
        for i in 0..N {
            sums[i] += u16::from(upper[i]) * (ONE - self.weight) + u16::from(lower[i]) * self.weight;
        }
        *lanes_mut(self.values, x) = whole(&sums);
    }
}

/// Makes up to [`LANES`] pixels of as many values, and those that begin one after them, and so on.
#[inline(always)]
fn make(pixels: &mut [u8], values: &[u8], weights: &[[u16; LANES]]) {
    let values = &values[..weights.len() + LANES - 1];
    let mut sums = [HALF; LANES];
    for (offset, weights) in weights.iter().enumerate() {
        let values = &values[offset..offset + LANES];
        for lane in 0..LANES {
            sums[lane] += u16::from(values[lane]) * weights[lane];
        }
    }
    match pixels.as_mut_array::<LANES>() {
        Some(pixels) => *pixels = whole(&sums),
        None => pixels.copy_from_slice(&whole(&sums)[..pixels.len()]),
    }
}

/// Weighted sums as grey values.
#[inline(always)]
fn whole<const N: usize>(sums: &[u16; N]) -> [u8; N] {
    let mut whole = [0; N];
    for i in 0..N {
        whole[i] = (sums[i] >> FRACTION_BITS) as u8;
    }
    whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn resized(image: &GreyImage, width: usize, height: usize) -> GreyImage {
        let mut resized = GreyImage::new(width, height);
        Resizer::default().resize_bilinear(image, &mut resized);
        resized
    }

    fn patterned(width: usize, height: usize, step: usize) -> GreyImage {
        let pixels = (0..width * height).map(|i| (i * step % 256) as u8).collect();
        GreyImage::from_pixels(width, height, pixels).unwrap()
    }

    /// A row between two, rounded, and in it a pixel between two.
    fn by_definition(image: &GreyImage, width: usize, height: usize) -> Vec<u8> {
        let columns = taps(image.width(), width);
        let between = |[first, second]: [u8; 2], weight: u16| {
            let sum = u32::from(first) * u32::from(ONE - weight) + u32::from(second) * u32::from(weight);
            ((sum + 64) / 128) as u8
        };
        let pixel = |row: &Tap, column: &Tap| {
            let at = |x| between([row.first, row.second].map(|y| image.get(x, y)), row.weight);
            between([column.first, column.second].map(at), column.weight)
        };
        let rows = taps(image.height(), height);
        rows.iter().flat_map(|row| columns.iter().map(move |column| pixel(row, column))).collect()
    }

    #[test]
    fn halving_averages_neighbours() {
        let image = GreyImage::from_pixels(4, 2, vec![10, 20, 100, 200, 30, 40, 100, 200]).unwrap();
        assert_eq!(resized(&image, 2, 1).pixels(), &[25, 150]);
    }

    #[test]
    fn an_image_without_pixels_changes_nothing() {
        assert_eq!(resized(&GreyImage::new(0, 0), 3, 2), GreyImage::new(3, 2));
        assert_eq!(resized(&GreyImage::new(4, 4), 0, 2), GreyImage::new(0, 2));
    }

    #[test]
    fn what_one_image_left_behind_does_not_show_in_the_next() {
        let mut resizer = Resizer::default();
        let sizes = [((90, 80), (75, 67)), ((20, 20), (40, 30)), ((90, 80), (75, 67)), ((99, 60), (75, 67))];
        for (from, to) in sizes {
            let (image, mut resized) = (patterned(from.0, from.1, 37), GreyImage::new(to.0, to.1));
            resizer.resize_bilinear(&image, &mut resized);
            assert_eq!(resized.pixels(), by_definition(&image, to.0, to.1));
        }
    }

    proptest! {
        #[test]
        fn every_pixel_is_what_the_definition_says(
            from in (1..70_usize, 1..20_usize), to in (1..90_usize, 1..20_usize), step in 1..255_usize,
        ) {
            let image = patterned(from.0, from.1, step);
            let expected = by_definition(&image, to.0, to.1);
            let resized = resized(&image, to.0, to.1);
            prop_assert_eq!(resized.pixels(), &expected);
            let mut resizer = Resizer::default();
            resizer.fit([from, to]);
            let mut plain = GreyImage::new(to.0, to.1);
            resize_rows(&mut resizer, &image, &mut plain);
            prop_assert_eq!(plain.pixels(), &expected);
        }

        #[test]
        fn the_same_size_changes_nothing(width in 1..30_usize, height in 1..30_usize, step in 1..255_usize) {
            let image = patterned(width, height, step);
            prop_assert_eq!(resized(&image, width, height), image);
        }
    }
}
