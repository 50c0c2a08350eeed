//! The FAST-9 segment test (Rosten & Drummond, *Machine Learning for High-Speed Corner Detection*).
//!
//! A pixel is a corner at threshold t when nine contiguous pixels of the circle of radius 3 around
//! it are all brighter than the centre by more than t, or all darker. Its score is the largest t at
//! which it is still one.

use std::ops::Range;

use super::dispatch::for_every_processor;
use super::lanes::{EachLane, for_lanes, lanes, lanes_mut};
use crate::raster::GreyImage;

/// The circle of 16 pixels around a candidate, clockwise from the top.
const CIRCLE: [(isize, isize); 16] = [
    (0, -3),
    (1, -3),
    (2, -2),
    (3, -1),
    (3, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 3),
    (-1, 3),
    (-2, 2),
    (-3, 1),
    (-3, 0),
    (-3, -1),
    (-2, -2),
    (-1, -3),
];
/// Radius of the circle in pixels.
const RADIUS: usize = 3;

for_every_processor! {
    /// Writes into `scores` the corner score of each of `columns` in row `y` of `image`: the largest threshold at which
    /// it passes the FAST-9 test, or 0 where that is below `threshold` or closer than 3 px to the border.
    pub fn corner_scores(
        image: &GreyImage,
        y: usize,
        threshold: u8,
        columns: Range<usize>,
        scores: &mut [u8],
    ) = score_row
}

#[inline(always)]
fn score_row(image: &GreyImage, y: usize, threshold: u8, columns: Range<usize>, scores: &mut [u8]) {
    let (width, height) = (image.width(), image.height());
    let inside = columns.start.max(RADIUS)..columns.end.min(width.saturating_sub(RADIUS));
    if inside.is_empty() || y < RADIUS || y + RADIUS >= height {
        return scores[columns].fill(0);
    }
    scores[columns.start..inside.start].fill(0);
    scores[inside.end..columns.end].fill(0);
    let row = |offset: usize| image.row(y + offset - RADIUS);
    let rows = [row(0), row(1), row(2), row(3), row(4), row(5), row(6)];
    for_lanes(inside, Scores { rows, threshold, scores });
}

/// What a function of an index answers for each of sixteen, written out: a loop over them would go through memory.
macro_rules! sixteen {
    ($of:expr) => {
        [
            $of(0),
            $of(1),
            $of(2),
            $of(3),
            $of(4),
            $of(5),
            $of(6),
            $of(7),
            $of(8),
            $of(9),
            $of(10),
            $of(11),
            $of(12),
            $of(13),
            $of(14),
            $of(15),
        ]
    };
}

struct Scores<'a> {
    /// The middle row and three on each side.
    rows: [&'a [u8]; 2 * RADIUS + 1],
    threshold: u8,
    scores: &'a mut [u8],
}

impl EachLane for Scores<'_> {
    #[inline(always)]
    fn step<const N: usize>(&mut self, x: usize) {
        let mut windows = self.rows;
        for window in &mut windows {
            *window = &window[x - RADIUS..x + N + RADIUS];
        }
        let centre = lanes(windows[RADIUS], RADIUS);
        let pixels = |index: usize| {
            let (dx, dy) = CIRCLE[index];
            lanes(windows[RADIUS.wrapping_add_signed(dy)], RADIUS.wrapping_add_signed(dx))
        };
        let ring = sixteen!(pixels);
        if !may_have_corner::<N>(centre, &ring, self.threshold) {
            *lanes_mut(self.scores, x) = [0; N];
            return;
        }
        let pixels = |index: usize| *ring[index];
        let ring = sixteen!(pixels);
        let (brightest, darkest) = (brightest_arc(&ring), darkest_arc(&ring));
        let mut scores = [0; N];
        for lane in 0..N {
            let brighter = brightest[lane].saturating_sub(centre[lane]);
            let darker = centre[lane].saturating_sub(darkest[lane]);
            let largest = brighter.max(darker).saturating_sub(1);
            scores[lane] = if largest >= self.threshold { largest } else { 0 };
        }
        *lanes_mut(self.scores, x) = scores;
    }
}

/// An arc of nine covers at least one pixel of each opposite pair: where both of some pair are too much like the
/// centre, there is no corner.
#[inline(always)]
fn may_have_corner<const N: usize>(centre: &[u8; N], ring: &[&[u8; N]; 16], threshold: u8) -> bool {
    let mut most = 0;
    for lane in 0..N {
        let pair = |index: usize| (ring[index][lane], ring[index + 8][lane]);
        let ((a, b), (c, d)) = (pair(0), pair(4));
        let brighter = a.max(b).min(c.max(d)).saturating_sub(centre[lane]);
        let darker = centre[lane].saturating_sub(a.min(b).max(c.min(d)));
        most = brighter.max(darker).max(most);
    }
    most > threshold
}

/// The largest, over all arcs of nine around the ring, of the smallest pixel on the arc.
///
/// Arcs that begin at 2k and 2k + 1 share eight pixels, so that eight minima of eight are enough for sixteen arcs.
#[inline(always)]
fn brightest_arc<const N: usize>(ring: &[[u8; N]; 16]) -> [u8; N] {
    let mut brightest = [0; N];
    for lane in 0..N {
        let at = |index: usize| ring[index % 16][lane];
        let two = |index: usize| at(index).min(at(index + 1));
        let four = |index: usize| two(index).min(two(index + 2));
        let mut best = 0;
        for start in (0..16).step_by(2) {
            let shared = four(start + 1).min(four(start + 5));
            best = shared.min(at(start).max(at(start + 9))).max(best);
        }
        brightest[lane] = best;
    }
    brightest
}

/// The smallest, over all arcs of nine around the ring, of the largest pixel on the arc.
#[inline(always)]
fn darkest_arc<const N: usize>(ring: &[[u8; N]; 16]) -> [u8; N] {
    let mut darkest = [0; N];
    for lane in 0..N {
        let at = |index: usize| ring[index % 16][lane];
        let two = |index: usize| at(index).max(at(index + 1));
        let four = |index: usize| two(index).max(two(index + 2));
        let mut best = u8::MAX;
        for start in (0..16).step_by(2) {
            let shared = four(start + 1).max(four(start + 5));
            best = shared.max(at(start).min(at(start + 9))).min(best);
        }
        darkest[lane] = best;
    }
    darkest
}

for_every_processor! {
    /// Replaces `maxima` by those of `columns`, in order, whose score in the middle one of three `rows` is positive and
    /// beats those of its eight neighbours; of equal ones the first wins, row by row.
    pub fn local_maxima(rows: [&[u8]; 3], columns: Range<usize>, maxima: &mut Vec<usize>) = find_maxima
}

#[inline(always)]
fn find_maxima(rows: [&[u8]; 3], columns: Range<usize>, maxima: &mut Vec<usize>) {
    maxima.clear();
    for_lanes(columns, Maxima { rows, maxima });
}

struct Maxima<'a> {
    rows: [&'a [u8]; 3],
    maxima: &'a mut Vec<usize>,
}

impl EachLane for Maxima<'_> {
    #[inline(always)]
    fn step<const N: usize>(&mut self, x: usize) {
        let [above, row, below] = self.rows;
        let scores = lanes::<N>(row, x);
        if *scores == [0; N] {
            return;
        }
        let before = [
            lanes::<N>(above, x - 1),
            lanes::<N>(above, x),
            lanes::<N>(above, x + 1),
            lanes::<N>(row, x - 1),
        ];
        let after = [
            lanes::<N>(row, x + 1),
            lanes::<N>(below, x - 1),
            lanes::<N>(below, x),
            lanes::<N>(below, x + 1),
        ];
        let mut wins = [0; N];
        for lane in 0..N {
            let score = scores[lane];
            let before = before[0][lane].max(before[1][lane]).max(before[2][lane]).max(before[3][lane]);
            let after = after[0][lane].max(after[1][lane]).max(after[2][lane]).max(after[3][lane]);
            wins[lane] = u8::from((score > before) & (score >= after));
        }
        self.add(&wins, x);
    }
}

impl Maxima<'_> {
    /// Adds the columns from `x` on that win, as few do, if they were not added before.
    #[inline(always)]
    fn add<const N: usize>(&mut self, wins: &[u8; N], x: usize) {
        let next = self.maxima.last().map_or(0, |last| last + 1);
        let (words, single) = wins.as_chunks::<8>();
        for (first, word) in (x..).step_by(8).zip(words) {
            let mut wins = u64::from_le_bytes(*word);
            while wins != 0 {
                let column = first + wins.trailing_zeros() as usize / 8;
                if column >= next {
                    self.maxima.push(column);
                }
                wins &= wins - 1;
            }
        }
        if single == [1] {
            self.maxima.push(x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The definition, word for word.
    fn is_corner(image: &GreyImage, x: usize, y: usize, threshold: i32) -> bool {
        let centre = i32::from(image.get(x, y));
        let ring: Vec<i32> = CIRCLE
            .iter()
            .map(|&(dx, dy)| i32::from(image.get((x as isize + dx) as usize, (y as isize + dy) as usize)))
            .collect();
        (0..16).any(|start| {
            let arc = || (start..start + 9).map(|index| ring[index % 16]);
            arc().all(|pixel| pixel > centre + threshold) || arc().all(|pixel| pixel < centre - threshold)
        })
    }

    /// The largest threshold at which a pixel is a corner, if it is at least `threshold`.
    fn score(image: &GreyImage, x: usize, y: usize, threshold: u8) -> u8 {
        let is_inside = |at: usize, size: usize| at >= RADIUS && at + RADIUS < size;
        if !is_inside(x, image.width()) || !is_inside(y, image.height()) {
            return 0;
        }
        let passes = |&threshold: &u8| is_corner(image, x, y, i32::from(threshold));
        (threshold..=u8::MAX).rev().find(passes).unwrap_or(0)
    }

    /// Narrow images are worked on pixel by pixel, wide ones many at a time.
    fn images() -> impl Strategy<Value = GreyImage> {
        let pixel = prop_oneof![0..40_u8, 200..=255_u8];
        (1..80_usize, 1..9_usize).prop_flat_map(move |(width, height)| {
            let pixels = proptest::collection::vec(pixel.clone(), width * height);
            pixels.prop_map(move |pixels| GreyImage::from_pixels(width, height, pixels).unwrap())
        })
    }

    proptest! {
        // Each tries every threshold on every pixel.
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn the_score_is_the_largest_threshold_that_still_passes(
            image in images(), threshold in 1..60_u8, start in 0..60_usize, count in 0..80_usize,
        ) {
            let start = start.min(image.width());
            let columns = start..(start + count).min(image.width());
            for y in 0..image.height() {
                let (mut scores, mut plain) = (vec![9; image.width()], vec![9; image.width()]);
                corner_scores(&image, y, threshold, columns.clone(), &mut scores);
                score_row(&image, y, threshold, columns.clone(), &mut plain);
                let expected = |x| if columns.contains(&x) { score(&image, x, y, threshold) } else { 9 };
                let expected: Vec<u8> = (0..image.width()).map(expected).collect();
                prop_assert_eq!(&scores, &expected);
                prop_assert_eq!(&plain, &expected);
            }
        }

        #[test]
        fn a_maximum_beats_what_comes_before_it_and_is_not_beaten_by_what_comes_after(
            scores in proptest::collection::vec(0..4_u8, 3 * 90), start in 1..50_usize, count in 0..39_usize,
        ) {
            let rows: Vec<&[u8]> = scores.chunks(90).collect();
            let is_maximum = |x: &usize| {
                let others = (0..9).filter(|&index| index != 4);
                let (before, after): (Vec<usize>, Vec<usize>) = others.partition(|&index| index < 4);
                let at = |index: &usize| rows[index / 3][x + index % 3 - 1];
                let score = rows[1][*x];
                score > 0 && before.iter().all(|i| at(i) < score) && after.iter().all(|i| at(i) <= score)
            };
            let columns = start..start + count;
            let expected: Vec<usize> = columns.clone().filter(is_maximum).collect();
            let (mut found, mut plain) = (vec![7], vec![8]);
            local_maxima([rows[0], rows[1], rows[2]], columns.clone(), &mut found);
            find_maxima([rows[0], rows[1], rows[2]], columns, &mut plain);
            prop_assert_eq!(&found, &expected);
            prop_assert_eq!(&plain, &expected);
        }
    }
}
