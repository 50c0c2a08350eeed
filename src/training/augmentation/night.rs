//! Night out of day: what the sun lit is lit by lamps.

use rand::Rng;
use rand_pcg::Pcg64;

use super::grid::Grid;
use super::lamps::{Lamp, drawn_window};
use super::light::black_body;
use super::linear_image::{Light, LinearImage, luminance};
use super::sky::{self, Sky};

/// A night.
#[derive(Clone, Copy, Debug)]
pub(super) struct Night {
    /// Mean luminance that is left of the day's, before anything shines by itself, as a share.
    pub(super) light_left: f32,
    /// Light from everywhere against that of the lamps in their middle, as a share.
    pub(super) ambient: f32,
    /// Colour of the light from everywhere.
    pub(super) ambient_colour: Light,
    /// What is left of the sky's light, as a share of what is left of a scene that only the light from everywhere
    /// reaches.
    pub(super) sky: f32,
    /// How many lamps there are.
    pub(super) lamps: usize,
    /// How many places are looked at for a window to be lit.
    pub(super) windows: usize,
}

impl Night {
    /// From a dark lane to a bright street: 5 to 15 % of the day's light.
    pub(super) fn drawn(random: &mut Pcg64) -> Self {
        Self {
            light_left: random.random_range(0.05..0.15),
            ambient: random.random_range(-5.0_f32..-1.5).exp2(),
            // Light of a town that clouds send back is warm, that of the moon as the day's, of dusk cold.
            ambient_colour: black_body(random.random_range(-1.0_f32..1.0).exp2() * 5500.0),
            sky: random.random_range(-5.0_f32..-1.0).exp2(),
            lamps: random.random_range(2..14),
            windows: random.random_range(0..250),
        }
    }
}

/// Turns day into night: takes the image for what surfaces reflect, lights it by lamps at places of their own, darkens
/// the sky further, and adds what shines.
pub(super) fn fall(image: &mut LinearImage, night: &Night, random: &mut Pcg64) {
    let (by_day, sky) = (image.mean_luminance(), Sky::of(image));
    let lamps: Vec<Lamp> = (0..night.lamps).map(|_| Lamp::drawn(&sky, image, random)).collect();
    let windows: Vec<_> = (0..night.windows).flat_map(|_| drawn_window(image, &sky, random)).collect();
    relight(image, night, &sky, &lamps);
    let lit = image.mean_luminance();
    let scale = if lit > 0.0 { night.light_left * by_day / lit } else { 0.0 };
    image.pixels.as_flattened_mut().iter_mut().for_each(|light| *light *= scale);
    for (at, light) in windows {
        // Panes that two windows share shine once.
        image.pixels[at] = std::array::from_fn(|c| image.pixels[at][c].max(light[c]));
    }
    lamps.iter().for_each(|lamp| lamp.glow(image));
}

/// Multiplies what surfaces reflect by the light that falls on them.
fn relight(image: &mut LinearImage, night: &Night, sky: &Sky, lamps: &[Lamp]) {
    let everywhere = night.ambient_colour.map(|light| light * night.ambient);
    let falling = Grid::new((image.width, image.height), |x, y| {
        lamps.iter().fold(everywhere, |light, lamp| {
            // Brighter lamps light more; the mean is one.
            let share = lamp.light_at(x, y) * lamp.brightness / 7.0;
            std::array::from_fn(|c| light[c] + lamp.colour[c] * share)
        })
    });
    let from_sky = everywhere.map(|light| light * night.sky);
    let (mut light, mut around) = (vec![[0.0; 3]; image.width], vec![[0.0; 2]; image.width]);
    for (y, row) in image.rows_mut().enumerate() {
        falling.row(y, &mut light);
        sky.row(y, &mut around);
        for ((pixel, light), &around) in row.iter_mut().zip(&light).zip(&around) {
            let share = sky::share(around, luminance(*pixel));
            *pixel = std::array::from_fn(|c| pixel[c] * (light[c] + (from_sky[c] - light[c]) * share));
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::linear_image::tests::plain;
    use super::*;

    fn night(seed: u64) -> (Night, Pcg64) {
        let mut random = Pcg64::seed_from_u64(seed);
        (Night::drawn(&mut random), random)
    }

    #[test]
    fn a_night_without_anything_that_shines_has_the_light_that_it_says() {
        for seed in 0..20 {
            let mut image = plain(80, 60, 0.3);
            let (drawn, mut random) = night(seed);
            let dark = Night { lamps: 0, windows: 0, ..drawn };
            fall(&mut image, &dark, &mut random);
            assert!((image.mean_luminance() / 0.3 - dark.light_left).abs() < 1e-3);
            assert!((0.05..0.15).contains(&dark.light_left));
        }
    }

    #[test]
    fn a_night_is_darker_than_its_day_and_its_lamps_are_the_brightest_of_it() {
        for seed in 0..50 {
            let mut image = plain(320, 240, 0.4);
            let (night, mut random) = night(seed);
            fall(&mut image, &night, &mut random);
            let mut light: Vec<f32> = image.pixels.iter().map(|&pixel| luminance(pixel)).collect();
            light.sort_by(f32::total_cmp);
            let median = light[light.len() / 2];
            assert!(median < 0.1, "seed {seed}: half is brighter than {median}");
            assert!(light[light.len() - 1] > 0.7, "seed {seed}: no lamp among {:?}", light.last());
        }
    }

    #[test]
    fn the_sky_that_was_the_brightest_by_day_is_darker_than_the_street() {
        let mut image = plain(320, 240, 0.2);
        image.pixels[..100 * 320].fill([0.7, 0.8, 0.9]);
        let (drawn, mut random) = night(3);
        fall(&mut image, &Night { lamps: 6, ..drawn }, &mut random);
        let mean = |pixels: &[Light]| {
            pixels.iter().map(|&pixel| luminance(pixel)).sum::<f32>() / pixels.len() as f32
        };
        let (sky, street) = (mean(&image.pixels[..60 * 320]), mean(&image.pixels[120 * 320..]));
        assert!(sky < street, "sky {sky}, street {street}");
    }

    #[test]
    fn a_black_day_becomes_a_night_of_lamps_alone() {
        let mut image = plain(40, 30, 0.0);
        let (drawn, mut random) = night(1);
        fall(&mut image, &Night { windows: 0, lamps: 3, ..drawn }, &mut random);
        assert!(image.pixels.as_flattened().iter().all(|light| light.is_finite()));
        assert!(image.mean_luminance() > 0.0);
    }
}
