//! Where the sky is, by day.
//!
//! Sky is what is bright, compared with the whole image, and hangs together from the top down without an edge of light
//! or colour. It is looked for in cells of a few pixels, each by its brightest one, so that a wire or a twig parts
//! nothing; within a cell only what is not much darker than the sky belongs to it. A bright ceiling counts as sky, too:
//! it is as dark when the light is out.

use super::grid::Grid;
use super::linear_image::{LinearImage, luminance};

/// Luminance, as a share of the image's mean, from which the top of an image is sky.
const LEAST_AT_TOP: f32 = 0.9;
/// The same of what hangs together with that.
const LEAST: f32 = 0.6;
/// Red, green and blue of neighbouring cells of one sky differ by no more than this factor each.
const MOST_CHANGE: f32 = 1.25;
/// A cell whose darkest pixel is darker than its brightest by more than this factor is rough.
const ROUGH: f32 = 0.7;
/// Sky goes on behind no more rough cells in a row than a wire takes up: a wall of windows is rough all over.
const MOST_ROUGH: u8 = 2;
/// Share of columns that may be bright like sky in the lowest third; if more are, these are walls and there is no sky.
const MOST_TO_THE_GROUND: f32 = 0.15;
/// Shares of the height between which sky fades to none.
const FADES: (f32, f32) = (0.5, 0.75);
/// Luminance, as a share of the sky's, up to which a pixel is no sky, and from which it is.
const OWN: (f32, f32) = (0.08, 0.3);

/// Share of sky of each cell, and the sky's luminance there.
#[derive(Clone, Debug)]
pub(super) struct Sky(Grid<2>);

impl Sky {
    /// The sky in an image that was taken by day.
    pub(super) fn of(image: &LinearImage) -> Self {
        let cells = looked_at(image);
        let mut found = connected_to_top(&cells, image.mean_luminance());
        if reaches_the_ground(&cells, &found) {
            found.fill(false);
        }
        Self(widened(&cells, &found))
    }

    /// First row in pixels, below the top, where column `x` is no sky any more.
    pub(super) fn ends_at(&self, x: f32) -> f32 {
        let grid = &self.0;
        let column = ((x.max(0.0) / grid.cell_px as f32) as usize).min(grid.columns - 1);
        let end = (0..grid.rows).find(|row| grid.values[row * grid.columns + column][0] < 0.5);
        (end.unwrap_or(grid.rows) * grid.cell_px) as f32
    }

    /// Share of sky and the sky's luminance along row `y`, for [`share`].
    pub(super) fn row(&self, y: usize, along: &mut [[f32; 2]]) {
        self.0.row(y, along);
    }
}

/// Share of sky in a pixel of that luminance, 0 to 1, where its surroundings are as [`Sky::row`] says.
#[inline]
pub(super) fn share([around, sky]: [f32; 2], luminance: f32) -> f32 {
    around * ((luminance / sky.max(1e-6) - OWN.0) / (OWN.1 - OWN.0)).clamp(0.0, 1.0)
}

/// Colour of the brightest pixel of each cell, and the luminance of the darkest.
fn looked_at(image: &LinearImage) -> Grid<4> {
    let mut grid = Grid::new((image.width, image.height), |_, _| [0.0, 0.0, 0.0, f32::INFINITY]);
    for (y, row) in image.pixels.chunks_exact(image.width).enumerate() {
        let cells = &mut grid.values[y / grid.cell_px * grid.columns..][..grid.columns];
        for (pixels, cell) in row.chunks(grid.cell_px).zip(cells) {
            for &pixel in pixels {
                let here = luminance(pixel);
                if here > brightest(cell) {
                    cell[..3].copy_from_slice(&pixel);
                }
                cell[3] = cell[3].min(here);
            }
        }
    }
    grid
}

fn brightest(&[red, green, blue, _]: &[f32; 4]) -> f32 {
    luminance([red, green, blue])
}

/// Which cells are bright and hang together with bright ones at the top of an image of that mean luminance.
fn connected_to_top(cells: &Grid<4>, mean: f32) -> Vec<bool> {
    let Grid { columns, rows, ref values, .. } = *cells;
    // Through how many rough cells in a row the sky came; one more than it may where it did not.
    let mut through = vec![MOST_ROUGH + 1; values.len()];
    let at_top = (0..columns).filter(|&cell| brightest(&values[cell]) > LEAST_AT_TOP * mean);
    let mut open: Vec<usize> = at_top.collect();
    open.iter().for_each(|&cell| through[cell] = 0);
    while let Some(cell) = open.pop() {
        let (x, y) = (cell % columns, cell / columns);
        let beside = [
            (x > 0).then(|| cell - 1),
            (x + 1 < columns).then(|| cell + 1),
            (y > 0).then(|| cell - columns),
            (y + 1 < rows).then(|| cell + columns),
        ];
        for next in beside.into_iter().flatten() {
            let light = brightest(&values[next]);
            let is_rough = values[next][3] < ROUGH * light;
            let rough = if is_rough { through[cell] + 1 } else { 0 };
            if rough < through[next] && light > LEAST * mean && alike(&values[cell], &values[next]) {
                through[next] = rough;
                open.push(next);
            }
        }
    }
    through.into_iter().map(|rough| rough <= MOST_ROUGH).collect()
}

fn alike(one: &[f32; 4], other: &[f32; 4]) -> bool {
    let is_near = |(a, b): (&f32, &f32)| a.max(*b) <= MOST_CHANGE * a.min(*b) + 0.02;
    one[..3].iter().zip(&other[..3]).all(is_near)
}

fn reaches_the_ground(cells: &Grid<4>, found: &[bool]) -> bool {
    let lowest_third = cells.rows - cells.rows / 3;
    let reaches = |x: &usize| (lowest_third..cells.rows).any(|y| found[y * cells.columns + x]);
    (0..cells.columns).filter(reaches).count() as f32 > MOST_TO_THE_GROUND * cells.columns as f32
}

/// The cells that were found and those around them, which have a rim of sky, faded towards the ground.
fn widened(cells: &Grid<4>, found: &[bool]) -> Grid<2> {
    let Grid { columns, rows, ref values, .. } = *cells;
    cells.with_values(|cell| {
        let (x, y) = (cell % columns, cell / columns);
        let (left, right) = (x.saturating_sub(1), (x + 1).min(columns - 1));
        let (above, below) = (y.saturating_sub(1), (y + 1).min(rows - 1));
        let around = (above..=below).flat_map(|y| (left..=right).map(move |x| y * columns + x));
        let sky = around.filter(|&cell| found[cell]).map(|cell| brightest(&values[cell])).fold(0.0, f32::max);
        let down = (y as f32 + 0.5) / rows as f32;
        let fade = ((FADES.1 - down) / (FADES.1 - FADES.0)).clamp(0.0, 1.0);
        // Where there is none, the light of the cell itself: blending towards it shows nothing.
        if sky > 0.0 { [fade, sky] } else { [0.0, brightest(&values[cell])] }
    })
}

#[cfg(test)]
mod tests {
    use super::super::linear_image::tests::plain;
    use super::*;

    /// Sky of that light above row 80 of 240, houses of 0.2 below.
    fn street(sky: f32) -> LinearImage {
        let mut image = plain(320, 240, 0.2);
        image.pixels[..80 * 320].fill([sky; 3]);
        image
    }

    fn shares(image: &LinearImage) -> Vec<f32> {
        let sky = Sky::of(image);
        let mut along = vec![[0.0; 2]; image.width];
        let mut shares = Vec::new();
        for (y, row) in image.pixels.chunks_exact(image.width).enumerate() {
            sky.row(y, &mut along);
            shares.extend(row.iter().zip(&along).map(|(&pixel, &around)| share(around, luminance(pixel))));
        }
        shares
    }

    #[test]
    fn a_bright_sky_ends_where_houses_begin() {
        let shares = shares(&street(0.8));
        assert!(shares[..80 * 320].iter().all(|&share| share > 0.95));
        assert!(shares[90 * 320..].iter().all(|&share| share == 0.0));
        assert!((80.0..91.0).contains(&Sky::of(&street(0.8)).ends_at(100.0)));
    }

    #[test]
    fn a_dark_top_is_no_sky() {
        assert_eq!(shares(&street(0.05)), vec![0.0; 320 * 240]);
        assert_eq!(Sky::of(&street(0.05)).ends_at(100.0), 0.0);
    }

    #[test]
    fn a_wire_across_the_sky_parts_nothing_and_is_none() {
        let mut image = street(0.8);
        image.pixels[40 * 320..42 * 320].fill([0.03; 3]);
        let shares = shares(&image);
        assert!(shares[70 * 320..80 * 320].iter().all(|&share| share > 0.95));
        assert!(shares[40 * 320..42 * 320].iter().all(|&share| share < 0.05));
    }

    #[test]
    fn a_house_of_another_colour_and_a_house_with_windows_are_no_sky_however_bright() {
        let mut brick = street(0.5);
        brick.pixels[80 * 320..].fill([0.9, 0.45, 0.2]);
        let mut windows = street(0.5);
        for (i, pixel) in windows.pixels.iter_mut().enumerate().skip(80 * 320) {
            *pixel = if i % 320 % 6 < 3 || i / 320 % 8 < 2 { [0.5; 3] } else { [0.1; 3] };
        }
        for image in [brick, windows] {
            let shares = shares(&image);
            assert!(shares[100 * 320..].iter().all(|&share| share == 0.0));
            assert!(shares[..70 * 320].iter().all(|&share| share > 0.95));
        }
    }

    #[test]
    fn a_bright_wall_down_to_the_floor_is_no_sky() {
        assert_eq!(shares(&plain(100, 100, 0.7)), vec![0.0; 10_000]);
    }
}
