//! What changes slowly over an image, worked out for a few points and blended between them.

/// Cells along the shorter side of an image.
const CELLS: usize = 48;

/// `N` values in the middle of each cell of an image.
#[derive(Clone, Debug)]
pub(super) struct Grid<const N: usize> {
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Side of a cell in pixels; those at the right and at the bottom may be narrower.
    pub(super) cell_px: usize,
    /// Row-major.
    pub(super) values: Vec<[f32; N]>,
    /// For each pixel of a row, the cell to the left and the share of the cell to the right.
    across: Vec<(usize, f32)>,
}

impl<const N: usize> Grid<N> {
    /// The grid of an image of that size, of what `value` gives for the middle of each cell in pixels.
    pub(super) fn new((width, height): (usize, usize), mut value: impl FnMut(f32, f32) -> [f32; N]) -> Self {
        let cell_px = (width.min(height) / CELLS).max(1);
        let (columns, rows) = (width.div_ceil(cell_px), height.div_ceil(cell_px));
        let middle = |cell: usize| (cell as f32 + 0.5) * cell_px as f32;
        let values = (0..columns * rows).map(|i| value(middle(i % columns), middle(i / columns))).collect();
        let across = (0..width).map(|x| between(x, cell_px, columns)).collect();
        Self { columns, rows, cell_px, values, across }
    }

    /// A grid of the same cells, of what `value` makes of the number of each.
    pub(super) fn with_values<const M: usize>(&self, value: impl FnMut(usize) -> [f32; M]) -> Grid<M> {
        let Self { columns, rows, cell_px, ref across, .. } = *self;
        let values = (0..self.values.len()).map(value).collect();
        Grid { columns, rows, cell_px, values, across: across.clone() }
    }

    /// The values along the pixels of row `y`, bilinear between the middles of cells.
    pub(super) fn row(&self, y: usize, blended: &mut [[f32; N]]) {
        let (top, lower_share) = between(y, self.cell_px, self.rows);
        let bottom = (top + 1).min(self.rows - 1);
        let cells = |row: usize| &self.values[row * self.columns..][..self.columns];
        let mut line: Vec<_> =
            cells(top).iter().zip(cells(bottom)).map(|(a, b)| mixed(a, b, lower_share)).collect();
        // Whatever the share, the last cell goes on to the border.
        line.extend(line.last().copied());
        for (value, &(left, share)) in blended.iter_mut().zip(&self.across) {
            *value = mixed(&line[left], &line[left + 1], share);
        }
    }
}

/// The first of the two of `cells` along one axis between whose middles a pixel lies, and the share of the second.
fn between(pixel: usize, cell_px: usize, cells: usize) -> (usize, f32) {
    let position = ((pixel as f32 + 0.5) / cell_px as f32 - 0.5).max(0.0);
    let first = (position as usize).min(cells - 1);
    (first, position - first as f32)
}

#[inline]
fn mixed<const N: usize>(from: &[f32; N], to: &[f32; N], share: f32) -> [f32; N] {
    std::array::from_fn(|i| from[i] + (to[i] - from[i]) * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_changes_evenly_is_blended_exactly_and_repeated_at_the_border() {
        let grid = Grid::new((150, 101), |x, y| [x, 2.0 * x + y]);
        assert_eq!((grid.cell_px, grid.columns, grid.rows), (2, 75, 51));
        let mut row = vec![[0.0; 2]; 150];
        for y in [0, 1, 50, 100] {
            grid.row(y, &mut row);
            for (x, value) in row.iter().enumerate() {
                let expected = ((x as f32 + 0.5).clamp(1.0, 149.0), (y as f32 + 0.5).clamp(1.0, 101.0));
                assert!((value[0] - expected.0).abs() < 1e-3, "{value:?} at {x}, {y}");
                assert!((value[1] - 2.0 * expected.0 - expected.1).abs() < 1e-3, "{value:?} at {x}, {y}");
            }
        }
    }

    #[test]
    fn a_single_pixel_has_a_grid_too() {
        let mut row = [[0.0]];
        Grid::new((1, 1), |_, _| [7.0]).row(0, &mut row);
        assert_eq!(row, [[7.0]]);
    }
}
