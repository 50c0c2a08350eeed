//! Loops over a row of pixels that take many at a time: short arrays, which become vector instructions. Where a row is
//! too short for that, the same body takes one at a time.

use std::ops::Range;

/// Pixels that are worked on at a time.
const LANES: usize = 32;

/// What is done with `N` pixels from column `x` on. It may be done twice with the same ones.
pub(super) trait EachLane {
    fn step<const N: usize>(&mut self, x: usize);
}

/// Does `body` with all pixels of `columns`.
#[inline(always)]
pub(super) fn for_lanes(columns: Range<usize>, mut body: impl EachLane) {
    let mut x = columns.start;
    while x + LANES <= columns.end {
        body.step::<LANES>(x);
        x += LANES;
    }
    if x < columns.end && columns.len() >= LANES {
        body.step::<LANES>(columns.end - LANES);
    } else {
        for x in x..columns.end {
            body.step::<1>(x);
        }
    }
}

/// `N` bytes of `row` from `x` on.
#[inline(always)]
pub(super) fn lanes<const N: usize>(row: &[u8], x: usize) -> &[u8; N] {
    row[x..x + N].try_into().expect("as long as the range")
}

/// The same, to be written.
#[inline(always)]
pub(super) fn lanes_mut<const N: usize>(row: &mut [u8], x: usize) -> &mut [u8; N] {
    (&mut row[x..x + N]).try_into().expect("as long as the range")
}
