//! Lamps and lit windows: what shines at night, and what it shines on.

use rand::Rng;
use rand_pcg::Pcg64;

use super::light::black_body;
use super::linear_image::{Light, LinearImage, luminance};
use super::sky::Sky;
use super::view::span;

/// A lamp in the image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lamp {
    /// Its middle in pixels.
    pub(super) at: (f32, f32),
    /// Radius of its bulb in pixels.
    pub(super) radius_px: f32,
    /// Distance in pixels at which its light on the scene is down to a quarter.
    pub(super) reach_px: f32,
    /// Colour of its light, with luminance of about 1.
    pub(super) colour: Light,
    /// Its own light, of which 1 is the brightest that a byte holds.
    pub(super) brightness: f32,
}

impl Lamp {
    /// A lamp below the sky: far ones are small, dim and near the horizon.
    pub(super) fn drawn(sky: &Sky, image: &LinearImage, random: &mut Pcg64) -> Self {
        let (height, side) = (image.height as f32, image.shorter_side_px());
        let x = random.random_range(0.0..1.0) * image.width as f32;
        let nearness: f32 = random.random_range(0.0_f32..1.0).powi(2);
        let below = random.random_range(0.02..0.15) + 0.3 * nearness * random.random_range(0.0..1.0);
        let size = random.random_range(0.7..1.3);
        Self {
            at: (x, sky.ends_at(x).min(0.6 * height) + below * height),
            radius_px: side * size * (0.002 + 0.009 * nearness),
            reach_px: side * size * (0.04 + 0.25 * nearness),
            colour: drawn_colour(random),
            brightness: random.random_range(2.0..12.0),
        }
    }

    /// How much of its light reaches a surface that is seen at a point in pixels: 1 / (1 + d²)², d reaches from what
    /// is right below it, since with the distance both its light and the angle at which that falls decrease.
    #[inline]
    pub(super) fn light_at(&self, x: f32, y: f32) -> f32 {
        let (dx, dy) = (x - self.at.0, y - self.at.1 - 0.4 * self.reach_px);
        let root = 1.0 + (dx * dx + dy * dy) / (self.reach_px * self.reach_px);
        1.0 / (root * root)
    }

    /// Adds the lamp itself and its halo, which lens and air spread: b / (1 + d²)² at a distance of d radii, and over
    /// eight times that a hundredth of it.
    pub(super) fn glow(&self, image: &mut LinearImage) {
        const WIDER: f32 = 8.0;
        const WIDE_SHARE: f32 = 0.01;
        let reach = 4.0 * WIDER * self.radius_px;
        let bell = |squared: f32| 1.0 / ((1.0 + squared) * (1.0 + squared));
        let halo = |squared: f32| bell(squared) + WIDE_SHARE * bell(squared / (WIDER * WIDER));
        // What is left at the border of the square that is painted must not show.
        let rest = halo(16.0 * WIDER * WIDER);
        let squared = |a: f32, b: f32| ((a + 0.5 - b) / self.radius_px).powi(2);
        for y in span(self.at.1, reach, image.height) {
            for x in span(self.at.0, reach, image.width) {
                let distance = squared(x as f32, self.at.0) + squared(y as f32, self.at.1);
                let light = self.brightness * (halo(distance) - rest).max(0.0);
                let pixel = &mut image.pixels[y * image.width + x];
                *pixel = std::array::from_fn(|c| pixel[c] + self.colour[c] * light);
            }
        }
    }
}

/// Sodium, incandescent, LED or mercury: from orange to a cold green.
fn drawn_colour(random: &mut Pcg64) -> Light {
    match random.random_range(0..10) {
        0..5 => black_body(random.random_range(1900.0..2400.0)),
        5..7 => black_body(random.random_range(2600.0..3400.0)),
        7..9 => black_body(random.random_range(4000.0..6500.0)),
        _ => [0.75, 1.08, 0.95],
    }
}

/// The pixels of a window and the light that comes from them, if there seems to be one at a place that is drawn: what
/// is darker by day than an even wall all around it, as panes are.
pub(super) fn drawn_window(day: &LinearImage, sky: &Sky, random: &mut Pcg64) -> Vec<(usize, Light)> {
    /// A pane is darker than the wall by this factor at least.
    const DARKER: f32 = 0.75;
    /// The darkest of four places on an even wall is no darker than the lightest by more than this factor.
    const EVEN: f32 = 0.5;
    let (height, side) = (day.height as f32, day.shorter_side_px());
    let x = random.random_range(0.0..1.0) * day.width as f32;
    let (top, down) = (sky.ends_at(x), random.random_range(0.02..0.7));
    let y = top + down * (height - top);
    let half_width = side * random.random_range(0.004..0.02);
    let half_height = half_width * random.random_range(0.8..2.0);
    let strength = random.random_range(0.1..0.7);
    let light = black_body(random.random_range(2300.0..4500.0)).map(|light| light * strength);
    let at = |dx: f32, dy: f32| {
        let clamp = |place: f32, length: usize| (place.max(0.0) as usize).min(length - 1);
        let (x, y) = (clamp(x + dx * half_width, day.width), clamp(y + dy * half_height, day.height));
        luminance(day.pixels[y * day.width + x])
    };
    let around = [at(-2.0, 0.0), at(2.0, 0.0), at(0.0, -2.0), at(0.0, 2.0)];
    let (wall, lightest) = (around.into_iter().fold(1.0, f32::min), around.into_iter().fold(0.0, f32::max));
    if at(0.0, 0.0) > DARKER * wall || EVEN * lightest > wall {
        return Vec::new();
    }
    let (rows, columns) = (span(y, 1.2 * half_height, day.height), span(x, 1.2 * half_width, day.width));
    let pane: Vec<(usize, Light)> = rows
        .clone()
        .flat_map(|y| columns.clone().map(move |x| y * day.width + x))
        .filter(|&at| luminance(day.pixels[at]) < DARKER * wall)
        .map(|at| (at, light))
        .collect();
    // Dark scraps, such as twigs, are no window.
    if 2 * pane.len() < rows.len() * columns.len() { Vec::new() } else { pane }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::linear_image::tests::plain;
    use super::*;

    const LAMP: Lamp =
        Lamp { at: (50.0, 40.0), radius_px: 2.0, reach_px: 20.0, colour: [1.0; 3], brightness: 4.0 };

    #[test]
    fn a_lamp_is_brightest_in_its_middle_and_fades_without_an_edge() {
        let mut image = plain(200, 81, 0.0);
        LAMP.glow(&mut image);
        let row: Vec<f32> = image.pixels[40 * 200 + 50..41 * 200].iter().map(|pixel| pixel[0]).collect();
        assert!(row[0] > 3.0 && row[149] == 0.0);
        assert!(row.windows(2).all(|pair| pair[1] <= pair[0]));
        let beyond_black = row.iter().rposition(|&light| light > 0.0).unwrap();
        assert!(row[beyond_black] < 1e-3, "an edge of {}", row[beyond_black]);
    }

    #[test]
    fn a_lamp_lights_what_is_near_it_most() {
        let [under, at_reach, far] = [50.0, 70.0, 150.0].map(|x| LAMP.light_at(x, 48.0));
        assert!((under - 1.0).abs() < 1e-6 && (at_reach - 0.25).abs() < 1e-6 && far < 0.01);
    }

    #[test]
    fn only_what_is_darker_than_the_wall_around_it_is_lit_as_a_window() {
        let mut day = plain(320, 240, 0.4);
        for (x, y) in (10..230).step_by(12).flat_map(|y| (4..310).step_by(10).map(move |x| (x, y))) {
            (y..y + 6).for_each(|y| day.pixels[y * 320 + x..][..4].fill([0.05; 3]));
        }
        let (sky, mut random) = (Sky::of(&plain(320, 240, 0.0)), Pcg64::seed_from_u64(4));
        let lit: Vec<_> = (0..500).flat_map(|_| drawn_window(&day, &sky, &mut random)).collect();
        assert!(!lit.is_empty());
        assert!(lit.iter().all(|&(at, light)| day.pixels[at][0] < 0.1 && luminance(light) > 0.05));
    }
}
