//! Fog and rain.

use rand::Rng;
use rand_pcg::Pcg64;

use super::linear_image::{Light, LinearImage};

/// Fog, in a scene whose depth is guessed: a ground that recedes to a horizon, and everything above as far as that.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fog {
    /// Optical depth at the horizon: its light comes through by a share of e^−density.
    pub(super) density: f32,
    /// Light of fog that lets nothing through.
    pub(super) airlight: Light,
    /// Where the horizon is, as a share of the height from the top.
    pub(super) horizon: f32,
}

impl Fog {
    /// From haze to fog in which the far end of a street is gone.
    pub(super) fn drawn(random: &mut Pcg64) -> Self {
        Self {
            density: random.random_range(0.3..2.2),
            airlight: [random.random_range(0.35..0.75); 3],
            horizon: random.random_range(0.3..0.6),
        }
    }
}

/// Koschmieder's law (1924): I = J t + A (1 − t) with the transmission t = e^(−density · depth).
pub(super) fn fog(image: &mut LinearImage, fog: &Fog) {
    /// How far below the horizon, as a share of the height, the ground is half as far away.
    const HALVED_AT: f32 = 0.15;
    /// Over about that share of the height the horizon is rounded off, so that it makes no edge.
    const ROUNDED: f32 = 0.06;
    let height = image.height as f32;
    for (y, row) in image.rows_mut().enumerate() {
        let below = (y as f32 + 0.5) / height - fog.horizon;
        let below = (below + below.hypot(ROUNDED)) / 2.0;
        let transmission = (-fog.density * HALVED_AT / (HALVED_AT + below)).exp();
        for pixel in row {
            *pixel = std::array::from_fn(|c| fog.airlight[c] + (pixel[c] - fog.airlight[c]) * transmission);
        }
    }
}

/// Streaks that falling drops leave while the shutter is open; drops gather light from all around, so that they are
/// brighter than most of what is behind them (Garg and Nayar, "Vision and Rain", 2007).
#[derive(Clone, Copy, Debug)]
pub(super) struct Rain {
    /// How many begin in an image as wide as it is high.
    pub(super) streaks: f32,
    /// How far one reaches down, as a share of the height.
    pub(super) length: f32,
    /// How far the wind blows them aside on a way down of one.
    pub(super) slant: f32,
    /// Share of a streak's own light in what is seen, 0 to 1.
    pub(super) opacity: f32,
    /// Light of a streak.
    pub(super) light: Light,
}

impl Rain {
    /// From drizzle to a downpour, before a scene of that mean luminance.
    pub(super) fn drawn(mean_luminance: f32, random: &mut Pcg64) -> Self {
        Self {
            streaks: random.random_range(100.0..500.0),
            length: random.random_range(0.04..0.15),
            slant: random.random_range(-0.3..0.3),
            opacity: random.random_range(0.15..0.45),
            light: [(1.8 * mean_luminance).clamp(0.05, 0.9); 3],
        }
    }
}

/// Draws the streaks at places of their own.
pub(super) fn rain(image: &mut LinearImage, rain: &Rain, random: &mut Pcg64) {
    let (width, height) = (image.width as f32, image.height as f32);
    let length_px = (rain.length * height).max(1.0);
    for _ in 0..(rain.streaks * width / height).min(4.0 * rain.streaks) as usize {
        let (x, y) = (random.random_range(-0.2..1.2) * width, random.random_range(-0.1..1.0) * height);
        // Near drops leave longer and clearer streaks.
        let nearness: f32 = random.random_range(0.4..1.0);
        let rows = (length_px * nearness).ceil() as i32;
        for down in 0..rows {
            let fading = 1.0 - (2.0 * down as f32 / rows as f32 - 1.0).abs() * 0.7;
            let at = (x + rain.slant * down as f32, y as i32 + down);
            blend(image, at, rain.light, rain.opacity * nearness * fading);
        }
    }
}

/// Blends a dot one pixel wide into the two pixels that share it.
fn blend(image: &mut LinearImage, (x, y): (f32, i32), light: Light, opacity: f32) {
    let left = x.floor();
    for (column, share) in [(left, 1.0 - (x - left)), (left + 1.0, x - left)] {
        if (0..image.height as i32).contains(&y) && (0.0..image.width as f32).contains(&column) {
            let pixel = &mut image.pixels[y as usize * image.width + column as usize];
            *pixel = std::array::from_fn(|c| pixel[c] + (light[c] - pixel[c]) * opacity * share);
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::linear_image::tests::{plain, riddle};
    use super::*;

    #[test]
    fn denser_fog_is_nearer_to_the_airlight_in_every_pixel() {
        let clear = LinearImage::of(&riddle(20, 30), 1.0);
        let in_fog = |density| {
            let mut image = clear.clone();
            fog(&mut image, &Fog { density, airlight: [0.5; 3], horizon: 0.4 });
            image.pixels.into_iter().flatten().collect::<Vec<f32>>()
        };
        let fogs = [0.0, 0.2, 1.0, 3.0, 20.0].map(in_fog);
        assert!(fogs[0].iter().zip(clear.pixels.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6));
        for pair in fogs.windows(2) {
            for (thin, thick) in pair[0].iter().zip(&pair[1]) {
                assert!((thick - 0.5).abs() <= (thin - 0.5).abs() + 1e-6, "{thin}, denser {thick}");
            }
        }
    }

    #[test]
    fn fog_hides_what_is_far_more_than_what_is_near() {
        let mut image = plain(1, 100, 0.0);
        fog(&mut image, &Fog { density: 1.0, airlight: [0.6; 3], horizon: 0.4 });
        let column: Vec<f32> = image.pixels.iter().map(|pixel| pixel[0]).collect();
        assert!(column.windows(2).all(|pair| pair[1] < pair[0]));
        assert!(column[0] - column[30] < 0.1 * (column[0] - column[99]));
        assert!((column[0] - 0.6 * (1.0 - (-1.0_f32).exp())).abs() < 5e-3);
    }

    #[test]
    fn rain_brightens_a_dark_scene_in_streaks_and_leaves_most_of_it() {
        let mut image = plain(80, 60, 0.1);
        let drops = Rain { streaks: 40.0, length: 0.1, slant: 0.2, opacity: 0.5, light: [0.8; 3] };
        rain(&mut image, &drops, &mut Pcg64::seed_from_u64(2));
        let touched = image.pixels.iter().filter(|pixel| pixel[0] > 0.1).count();
        assert!((50..1500).contains(&touched), "{touched} of 4800 pixels");
        assert!(image.pixels.iter().all(|pixel| (0.1..=0.8).contains(&pixel[0])));
    }
}
