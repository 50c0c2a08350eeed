//! The FAST-9 segment test (Rosten & Drummond, *Machine Learning for High-Speed Corner Detection*).
//!
//! A pixel is a corner at threshold t when nine contiguous pixels of the circle of radius 3 around
//! it are all brighter than the centre by more than t, or all darker. Its score is the largest t at
//! which it is still one.

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
/// Length of the arc.
const ARC: usize = 9;
/// Radius of the circle in pixels.
const RADIUS: usize = 3;

/// The corner score of every pixel of `image`, row-major: the largest threshold at which the pixel
/// passes the FAST-9 test, or 0 where that is below `threshold` or closer than 3 px to the border.
#[must_use]
pub fn corner_scores(image: &GreyImage, threshold: u8) -> Vec<u8> {
    let (width, height) = (image.width(), image.height());
    let mut scores = vec![0; width * height];
    if width <= 2 * RADIUS || height <= 2 * RADIUS {
        return scores;
    }
    let circle = CIRCLE.map(|(dx, dy)| dy * width as isize + dx);
    let pixels = image.pixels();
    for y in RADIUS..height - RADIUS {
        for centre in y * width + RADIUS..(y + 1) * width - RADIUS {
            let ring = |index: usize| pixels[centre.wrapping_add_signed(circle[index])];
            if may_be_corner(pixels[centre], threshold, ring) {
                let score = arc_score(pixels[centre], std::array::from_fn(ring));
                scores[centre] = if score >= threshold { score } else { 0 };
            }
        }
    }
    scores
}

/// An arc of nine covers at least one pixel of each opposite pair; a centre that differs enough
/// from neither end of some pair, in one direction, cannot be a corner.
fn may_be_corner(centre: u8, threshold: u8, ring: impl Fn(usize) -> u8) -> bool {
    let bright = centre.saturating_add(threshold);
    let dark = centre.saturating_sub(threshold);
    let mut can_be_brighter = true;
    let mut can_be_darker = true;
    for index in [0, 4, 2, 6] {
        let (one, other) = (ring(index), ring(index + 8));
        can_be_brighter &= one > bright || other > bright;
        can_be_darker &= one < dark || other < dark;
        if !can_be_brighter && !can_be_darker {
            return false;
        }
    }
    true
}

/// max over arcs of min over the arc of |ring − centre|, less one, in the better direction.
fn arc_score(centre: u8, ring: [u8; 16]) -> u8 {
    let difference = ring.map(|pixel| i16::from(pixel) - i16::from(centre));
    let mut best = 0;
    for start in 0..16 {
        let mut brightest_floor = i16::MAX;
        let mut darkest_floor = i16::MAX;
        for step in 0..ARC {
            let value = difference[(start + step) % 16];
            brightest_floor = brightest_floor.min(value);
            darkest_floor = darkest_floor.min(-value);
        }
        best = best.max(brightest_floor).max(darkest_floor);
    }
    (best - 1).max(0) as u8
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
            let arc = || (start..start + ARC).map(|index| ring[index % 16]);
            arc().all(|pixel| pixel > centre + threshold) || arc().all(|pixel| pixel < centre - threshold)
        })
    }

    proptest! {
        #[test]
        fn the_score_is_the_largest_threshold_that_still_passes(
            pixels in proptest::collection::vec(prop_oneof![0..40_u8, 200..=255_u8], 9 * 8),
            threshold in 1..60_u8,
        ) {
            let image = GreyImage::from_pixels(9, 8, pixels).unwrap();
            let scores = corner_scores(&image, threshold);
            for y in 3..5 {
                for x in 3..6 {
                    let largest = (1..=255).rev().find(|&t| is_corner(&image, x, y, t)).unwrap_or(0);
                    let expected = if largest >= i32::from(threshold) { largest } else { 0 };
                    prop_assert_eq!(i32::from(scores[y * 9 + x]), expected);
                }
            }
        }
    }

    #[test]
    fn images_too_small_for_the_circle_have_no_corners() {
        assert!(corner_scores(&GreyImage::new(6, 6), 7).iter().all(|&score| score == 0));
        assert!(corner_scores(&GreyImage::new(0, 0), 7).is_empty());
    }
}
