//! Further images out of those that a map has: the same place in other light, other weather, from slightly elsewhere.
//!
//! [`Augmentation`] combines a few effects as they may meet in the world. They work on linear light, in the order in
//! which light meets them: point of view, occluder, weather, lamps or daylight, lens, sensor; only then the result is
//! rounded to bytes.

mod camera;
mod grid;
mod lamps;
mod light;
mod linear_image;
mod night;
mod sky;
mod view;
mod weather;

use rand::Rng;
use rand_pcg::Pcg64;

use crate::raster::RgbImage;
use linear_image::LinearImage;
use night::Night;
use view::Occluder;
use weather::{Fog, Rain};

/// How often each kind of change is made to an image; shares from 0, never, to 1, always.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Augmentation {
    /// Night: 5 to 15 % of the light, lamps, lit windows, noise.
    pub night: f32,
    /// Fog or rain, as often the one as the other.
    pub weather: f32,
    /// Exposure (−1.5 to 1 stops), colour temperature (4,300 to 9,900 K) and gamma (0.7 to 1.4); of a night, gamma
    /// alone.
    pub light: f32,
    /// A homography that moves the corners by up to 6 % of the sides.
    pub view: f32,
    /// A person or a vehicle in the way, or two.
    pub occluder: f32,
    /// Out of focus (σ up to 0.5 % of the shorter side), or smeared sideways (up to 3 %).
    pub blur: f32,
}

impl Default for Augmentation {
    /// A third nights, a quarter with weather; nearly all other daylight changes.
    fn default() -> Self {
        Self { night: 0.35, weather: 0.25, light: 0.9, view: 0.5, occluder: 0.25, blur: 0.2 }
    }
}

impl Augmentation {
    /// `image` as it might look another time, of the same size. What changes, and how, is drawn from `random` alone:
    /// the same state of it gives the same image, but for what processors round differently.
    #[must_use]
    pub fn apply(&self, image: &RgbImage, random: &mut Pcg64) -> RgbImage {
        if image.pixels().is_empty() {
            return image.clone();
        }
        let at_night = chance(random, self.night);
        let other_light = chance(random, self.light);
        let gamma = if other_light { random.random_range(-0.5_f32..0.5).exp2() } else { 1.0 };
        let mut light = LinearImage::of(image, gamma);
        self.look_from_elsewhere(&mut light, random);
        self.change_weather(&mut light, at_night, random);
        if at_night {
            night::fall(&mut light, &Night::drawn(random), random);
        } else if other_light {
            light::expose(&mut light, random.random_range(-1.5..1.0));
            light::colour_temperature(&mut light, 6500.0 * random.random_range(-0.6_f32..0.6).exp2());
        }
        self.photograph(&mut light, at_night, random);
        light.to_bytes()
    }

    fn look_from_elsewhere(&self, light: &mut LinearImage, random: &mut Pcg64) {
        if chance(random, self.view) {
            view::shift_view(light, random.random_range(0.01..0.06), random);
        }
        if chance(random, self.occluder) {
            for _ in 0..random.random_range(1..3) {
                view::occlude(light, &Occluder::drawn(random));
            }
        }
    }

    fn change_weather(&self, light: &mut LinearImage, at_night: bool, random: &mut Pcg64) {
        if !chance(random, self.weather) {
            return;
        }
        let mut fog = Fog::drawn(random);
        if at_night {
            // In the dark little is left to be seen through it.
            fog.density /= 2.0;
        }
        if random.random() {
            weather::fog(light, &fog);
        } else {
            // Rain comes from a grey sky and veils what is far.
            fog.density /= 3.0;
            weather::fog(light, &fog);
            light::expose(light, random.random_range(-1.2..0.0));
            let drops = Rain::drawn(light.mean_luminance(), random);
            weather::rain(light, &drops, random);
        }
    }

    fn photograph(&self, light: &mut LinearImage, at_night: bool, random: &mut Pcg64) {
        if chance(random, self.blur) {
            let side_px = light.shorter_side_px();
            if random.random() {
                camera::defocus(light, side_px * random.random_range(0.002..0.005));
            } else {
                camera::motion_blur(light, side_px * random.random_range(0.01..0.03));
            }
        }
        if at_night {
            camera::vignette(light, random.random_range(0.2..0.6));
            // A thumbnail's pixel gathers the light of several, so it has less noise than the sensor's own.
            let white_electrons = random.random_range(9.0_f32..13.0).exp2();
            camera::noise(light, white_electrons, random.random_range(2.0..6.0), random);
        }
    }
}

/// `true` in a share of all draws.
fn chance(random: &mut Pcg64, share: f32) -> bool {
    random.random::<f32>() < share
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::SeedableRng;

    use super::linear_image::tests::riddle;
    use super::*;
    use crate::kernel::luma;

    const EVERYTHING: Augmentation =
        Augmentation { night: 1.0, weather: 1.0, light: 1.0, view: 1.0, occluder: 1.0, blur: 1.0 };
    const NOTHING: Augmentation =
        Augmentation { night: 0.0, weather: 0.0, light: 0.0, view: 0.0, occluder: 0.0, blur: 0.0 };

    fn augmented(augmentation: Augmentation, image: &RgbImage, seed: u64) -> RgbImage {
        augmentation.apply(image, &mut Pcg64::seed_from_u64(seed))
    }

    /// A street by day: a bright sky, houses with windows, a road.
    fn street() -> RgbImage {
        let pixel = |i: usize| {
            let (x, y) = (i % 320, i / 320);
            match y {
                0..80 => [150, 190, 230],
                80..180 if x / 16 % 2 == 0 && y / 20 % 2 == 0 => [40, 45, 60],
                80..180 => [170, 150, 130],
                _ => [110, 110, 112],
            }
        };
        RgbImage::from_pixels(320, 240, (0..320 * 240).flat_map(pixel).collect()).unwrap()
    }

    #[test]
    fn the_same_seed_gives_the_same_image_and_another_seed_another() {
        let image = street();
        for seed in 0..8 {
            let first = augmented(Augmentation::default(), &image, seed);
            assert_eq!(augmented(Augmentation::default(), &image, seed), first);
            assert_ne!(augmented(Augmentation::default(), &image, seed + 100), first);
        }
    }

    #[test]
    fn where_nothing_changes_the_image_stays() {
        assert_eq!(augmented(NOTHING, &street(), 1), street());
    }

    #[test]
    fn an_image_without_pixels_stays_one() {
        for (width, height) in [(0, 0), (0, 5), (5, 0)] {
            let empty = RgbImage::new(width, height);
            for seed in 0..20 {
                assert_eq!(augmented(EVERYTHING, &empty, seed), empty);
            }
        }
    }

    #[test]
    fn nights_are_dark_with_a_few_bright_lamps() {
        let augmentation = Augmentation { night: 1.0, ..NOTHING };
        let day = luma(&street());
        for seed in 0..20 {
            let night = luma(&augmented(augmentation, &street(), seed));
            assert!(night.mean_luminance() < 0.6 * day.mean_luminance(), "seed {seed}");
            assert!(night.pixels().iter().any(|&level| level > 150), "seed {seed}");
        }
    }

    #[test]
    fn about_a_third_of_all_images_are_nights() {
        let image = street();
        let dark = |seed: &u64| {
            let grey = luma(&augmented(Augmentation::default(), &image, *seed));
            // By day the sky is never that dark.
            grey.pixels()[..320 * 20].iter().map(|&level| u32::from(level)).sum::<u32>() / (320 * 20) < 60
        };
        let nights = (0..150).filter(dark).count();
        assert!((30..75).contains(&nights), "{nights} of 150");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(96))]
        #[test]
        fn no_size_and_no_seed_is_too_much(width in 1..40_usize, height in 1..40_usize, seed in any::<u64>()) {
            let image = riddle(width, height);
            for augmentation in [EVERYTHING, Augmentation { night: 0.0, ..EVERYTHING }, Augmentation::default()] {
                let augmented = augmented(augmentation, &image, seed);
                prop_assert_eq!((augmented.width(), augmented.height()), (width, height));
            }
        }
    }

    #[test]
    fn shares_that_are_none_do_not_panic() {
        let odd = Augmentation { night: f32::NAN, weather: -3.0, light: 7.0, ..EVERYTHING };
        assert_eq!(augmented(odd, &street(), 1).width(), 320);
    }
}
