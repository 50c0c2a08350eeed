//! The sky: a panorama over all headings, drawn once for each light.

use std::f32::consts::TAU;

use super::noise::{fractal_noise, mix, unit};
use super::parse::Light;
use super::texture::Radiance;

const WIDTH_PX: usize = 1536;
const HEIGHT_PX: usize = 192;
/// Rise over run at the top of the panorama.
const HIGHEST_SLOPE: f32 = 1.1;

/// Colours of the sky over a heading and a slope (rise over run), column by column from the horizon up.
#[derive(Clone, Debug)]
pub(super) struct Sky {
    values: Vec<Radiance>,
}

impl Sky {
    /// The sky of `light`; `seed` shapes the clouds.
    pub(super) fn of(light: Light, seed: u32) -> Self {
        let value = |i: usize| {
            let heading = (i / HEIGHT_PX) as f32 / WIDTH_PX as f32 * TAU;
            let slope = (i % HEIGHT_PX) as f32 / HEIGHT_PX as f32 * HIGHEST_SLOPE;
            let [r, g, b] = match light {
                Light::Noon => noon(heading, slope, seed),
                Light::Dusk => dusk(heading, slope, seed),
                Light::Night => night(i, slope, seed),
            };
            [r, g, b, 0.0]
        };
        Self { values: (0..WIDTH_PX * HEIGHT_PX).map(value).collect() }
    }

    /// The column of the panorama at a heading in radians.
    pub(super) fn column(&self, heading: f32) -> &[Radiance] {
        let column = (heading.rem_euclid(TAU) / TAU * WIDTH_PX as f32) as usize % WIDTH_PX;
        &self.values[column * HEIGHT_PX..(column + 1) * HEIGHT_PX]
    }

    /// Rows of a column per unit of slope.
    pub(super) const ROWS_PER_SLOPE: f32 = HEIGHT_PX as f32 / HIGHEST_SLOPE;
}

/// Cover by a layer of cloud seen in perspective, 0 to 1.
fn cloud(heading: f32, slope: f32, seed: u32) -> f32 {
    let distance = 1.0 / (slope + 0.16);
    let (x, y) = (heading.cos() * distance, heading.sin() * distance);
    let density = fractal_noise(seed, x * 1.3 + 40.0, y * 1.3 + 40.0, 5);
    ((density - 0.47) * 4.5).clamp(0.0, 1.0)
}

fn mixed(from: [f32; 3], to: [f32; 3], fraction: f32) -> [f32; 3] {
    [0, 1, 2].map(|c| from[c] + (to[c] - from[c]) * fraction)
}

fn noon(heading: f32, slope: f32, seed: u32) -> [f32; 3] {
    let blue = mixed([0.78, 0.95, 1.16], [0.2, 0.42, 0.98], (slope * 1.3).min(1.0).sqrt());
    let cover = cloud(heading, slope, seed);
    let bright = 0.85 + 0.25 * cloud(heading + 0.05, slope + 0.04, seed ^ 1);
    mixed(blue, [1.6 * bright, 1.58 * bright, 1.55 * bright], cover * 0.9)
}

/// Sunset in the west: orange at the horizon, violet above, clouds lit from below.
fn dusk(heading: f32, slope: f32, seed: u32) -> [f32; 3] {
    let west = 0.5 - 0.5 * (heading + 0.28).cos();
    let low = mixed([0.3, 0.2, 0.26], [0.95, 0.42, 0.14], west * west);
    let middle = mixed([0.2, 0.17, 0.28], [0.6, 0.3, 0.26], west);
    let clear = mixed(mixed(low, middle, (slope * 2.6).min(1.0)), [0.1, 0.12, 0.26], (slope * 1.1).min(1.0));
    let lit = mixed([0.24, 0.15, 0.2], [0.9, 0.38, 0.22], west);
    mixed(clear, lit, cloud(heading, slope, seed) * 0.65)
}

fn night(i: usize, slope: f32, seed: u32) -> [f32; 3] {
    let glow = mixed([0.03, 0.024, 0.022], [0.006, 0.008, 0.018], (slope * 2.0).min(1.0));
    let star = unit(mix(seed, i as u32));
    if star > 0.9994 { mixed(glow, [0.12, 0.125, 0.14], (star - 0.9994) / 0.0006) } else { glow }
}
