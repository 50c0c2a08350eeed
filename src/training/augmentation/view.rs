//! Another point of view, and what stands in the way.

use rand::Rng;
use rand_pcg::Pcg64;

use super::linear_image::{Light, LinearImage};

/// Looks from slightly elsewhere: the corners of the new image lie in the old one, each drawn up to `strength` times
/// the width and the height inside its corner (below a quarter), so nothing has to be made up beyond the border.
pub(super) fn shift_view(image: &mut LinearImage, strength: f32, random: &mut Pcg64) {
    let (right, bottom) = (image.width.saturating_sub(1) as f32, image.height.saturating_sub(1) as f32);
    let mut inside = |x: f32, y: f32| {
        let (dx, dy) = (random.random::<f32>() * strength, random.random::<f32>() * strength);
        ((x + dx * (1.0 - 2.0 * x)) * right, (y + dy * (1.0 - 2.0 * y)) * bottom)
    };
    let corners = [inside(0.0, 0.0), inside(1.0, 0.0), inside(1.0, 1.0), inside(0.0, 1.0)];
    // An image of one row or column has no view to be shifted.
    let Some(homography) = Homography::to_quadrilateral(corners) else { return };
    let old = image.clone();
    for (y, row) in image.rows_mut().enumerate() {
        for (x, pixel) in row.iter_mut().enumerate() {
            let (x, y) = homography.apply(x as f32 / right, y as f32 / bottom);
            *pixel = sample(&old, x, y);
        }
    }
}

/// A projective map: x = (a u + b v + c) / w, y = (d u + e v + f) / w with w = g u + h v + 1.
struct Homography {
    x: [f32; 3],
    y: [f32; 3],
    w: [f32; 2],
}

impl Homography {
    /// The map from the unit square to the corners at (0, 0), (1, 0), (1, 1), (0, 1), in closed form (Heckbert,
    /// "Fundamentals of Texture Mapping", 1989, 2.2.3); none if they span no area.
    fn to_quadrilateral([(x0, y0), (x1, y1), (x2, y2), (x3, y3)]: [(f32, f32); 4]) -> Option<Self> {
        let (dx1, dx2, sx) = (x1 - x2, x3 - x2, x0 - x1 + x2 - x3);
        let (dy1, dy2, sy) = (y1 - y2, y3 - y2, y0 - y1 + y2 - y3);
        let area = dx1 * dy2 - dx2 * dy1;
        if area.abs() < f32::EPSILON {
            return None;
        }
        let (g, h) = ((sx * dy2 - dx2 * sy) / area, (dx1 * sy - sx * dy1) / area);
        Some(Self {
            x: [x1 - x0 + g * x1, x3 - x0 + h * x3, x0],
            y: [y1 - y0 + g * y1, y3 - y0 + h * y3, y0],
            w: [g, h],
        })
    }

    #[inline]
    fn apply(&self, u: f32, v: f32) -> (f32, f32) {
        let scale = 1.0 / (self.w[0] * u + self.w[1] * v + 1.0);
        let on = |[a, b, c]: [f32; 3]| (a * u + b * v + c) * scale;
        (on(self.x), on(self.y))
    }
}

/// Bilinear between pixel centres; the image has two rows and columns at least.
#[inline]
fn sample(image: &LinearImage, x: f32, y: f32) -> Light {
    let (left, top) = ((x as usize).min(image.width - 2), (y as usize).min(image.height - 2));
    let (right_share, bottom_share) = (x - left as f32, y - top as f32);
    let upper = &image.pixels[top * image.width + left..][..2];
    let lower = &image.pixels[(top + 1) * image.width + left..][..2];
    std::array::from_fn(|channel| {
        let above = upper[0][channel] + (upper[1][channel] - upper[0][channel]) * right_share;
        let below = lower[0][channel] + (lower[1][channel] - lower[0][channel]) * right_share;
        above + (below - above) * bottom_share
    })
}

/// Somebody or something before the camera: a rounded body with a narrower top, a head or a cabin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Occluder {
    /// Middle of the whole, as a share of width and height.
    pub(super) middle: (f32, f32),
    /// Half its width and height, as a share of the image's height.
    pub(super) half_size: (f32, f32),
    /// Share of its height that the top takes, and how wide that is against the body.
    pub(super) top: (f32, f32),
    /// Its light, of the body and of the top; towards its foot each loses half of that.
    pub(super) colours: [Light; 2],
}

impl Occluder {
    /// A passer-by, or as often a vehicle, that stands somewhere in the lower part of the image.
    pub(super) fn drawn(random: &mut Pcg64) -> Self {
        let (half_height, slimness, top) = if random.random() {
            (random.random_range(0.12..0.32), random.random_range(0.25..0.4), (0.17, 0.5))
        } else {
            (random.random_range(0.06..0.15), random.random_range(1.4..2.6), (0.45, 0.65))
        };
        let foot = random.random_range(0.75..1.1);
        let mut colour = || {
            let shade: f32 = random.random_range(0.01..0.25);
            [0; 3].map(|_| shade * random.random_range(0.8..1.2))
        };
        Self {
            colours: [colour(), colour()],
            middle: (random.random_range(0.0..1.0), foot - half_height),
            half_size: (half_height * slimness, half_height),
            top,
        }
    }
}

/// Puts an occluder into the image.
pub(super) fn occlude(image: &mut LinearImage, occluder: &Occluder) {
    let (width, height) = (image.width as f32, image.height as f32);
    let (half_x, half_y) = (occluder.half_size.0 * height, occluder.half_size.1 * height);
    let (x, y) = (occluder.middle.0 * width, occluder.middle.1 * height);
    let ((top_share, top_width), [body, top]) = (occluder.top, occluder.colours);
    cover(image, (x, y + top_share * half_y), (half_x, half_y * (1.0 - top_share)), body);
    // A little of the top reaches into the body, so that no gap is left.
    let top_half_y = 1.15 * top_share * half_y;
    cover(image, (x, y - half_y + top_half_y), (half_x * top_width, top_half_y), top);
}

/// Covers a superellipse, x⁴ + y⁴ ≤ 1, with soft edges.
fn cover(
    image: &mut LinearImage,
    (middle_x, middle_y): (f32, f32),
    (half_x, half_y): (f32, f32),
    colour: Light,
) {
    for y in span(middle_y, half_y, image.height) {
        let down = (y as f32 + 0.5 - middle_y) / half_y;
        let colour = colour.map(|light| light * (0.75 - 0.25 * down));
        for x in span(middle_x, half_x, image.width) {
            let aside = (x as f32 + 0.5 - middle_x) / half_x;
            let share = ((1.0 - aside.powi(4) - down.powi(4)) * 6.0).clamp(0.0, 1.0);
            let pixel = &mut image.pixels[y * image.width + x];
            *pixel = std::array::from_fn(|c| pixel[c] + (colour[c] - pixel[c]) * share);
        }
    }
}

/// The pixels of `length` that lie within `half` of `middle`.
pub(super) fn span(middle: f32, half: f32, length: usize) -> std::ops::Range<usize> {
    let begin = (middle - half).floor().clamp(0.0, length as f32) as usize;
    let end = (middle + half).ceil().clamp(0.0, length as f32) as usize;
    begin..end.max(begin)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::linear_image::tests::{plain, riddle};
    use super::*;

    #[test]
    fn a_view_shifted_by_nothing_is_the_same() {
        for (width, height) in [(64, 48), (2, 2), (3, 2), (1, 5), (5, 1), (1, 1)] {
            let image = riddle(width, height);
            let mut light = LinearImage::of(&image, 1.0);
            shift_view(&mut light, 0.0, &mut Pcg64::seed_from_u64(1));
            assert_eq!(light.to_bytes(), image, "{width}×{height}");
        }
    }

    #[test]
    fn corners_go_where_they_are_sent() {
        let corners = [(1.0, 2.0), (90.0, 5.0), (99.0, 70.0), (4.0, 75.0)];
        let homography = Homography::to_quadrilateral(corners).unwrap();
        for ((u, v), (x, y)) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].into_iter().zip(corners) {
            let got = homography.apply(u, v);
            assert!((got.0 - x).abs() < 1e-3 && (got.1 - y).abs() < 1e-3, "{got:?}, expected {x}, {y}");
        }
    }

    #[test]
    fn a_shifted_view_moves_a_pixel_by_no_more_than_its_strength() {
        let mut ramp = plain(101, 81, 0.0);
        ramp.rows_mut().flat_map(|row| row.iter_mut().enumerate()).for_each(|(x, pixel)| pixel[0] = x as f32);
        let before = ramp.clone();
        shift_view(&mut ramp, 0.05, &mut Pcg64::seed_from_u64(5));
        let moved = ramp.pixels.iter().zip(&before.pixels).map(|(new, old)| (new[0] - old[0]).abs());
        let farthest = moved.fold(0.0, f32::max);
        assert!(farthest > 0.5 && farthest <= 5.0 + 1e-3, "{farthest} px");
    }

    #[test]
    fn an_occluder_hides_what_is_behind_it_and_nothing_else() {
        let mut image = plain(60, 40, 1.0);
        let shape = Occluder {
            middle: (0.5, 0.5),
            half_size: (0.2, 0.3),
            top: (0.25, 0.5),
            colours: [[0.1; 3], [0.2; 3]],
        };
        occlude(&mut image, &shape);
        assert!(image.pixels[20 * 60 + 30][0] < 0.1 && image.pixels[10 * 60 + 30][0] < 0.2);
        let hidden = image.pixels.iter().filter(|pixel| pixel[0] < 0.99).count();
        assert!((250..384).contains(&hidden), "{hidden} of 2400 pixels");
        assert_eq!(image.pixels[10 * 60 + 24], [1.0; 3]);
        assert_eq!(image.pixels[0], [1.0; 3]);
    }
}
