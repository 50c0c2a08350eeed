//! From linear light to the bytes of a frame: motion blur, lens shading, tone curve, sensor noise.
//!
//! The tone curve is Narkowicz's fit to the ACES film curve (2016),
//! y = √((x (2.51 x + 0.03)) / (x (2.43 x + 0.59) + 0.14)). Because of the square root, shot noise
//! (variance proportional to light) is about as strong everywhere in y, which is Anscombe's
//! observation; read noise grows towards black like the derivative of the root, 1/y.

use super::camera::View;
use super::light::Lighting;
use super::noise::{mix, unit};
use super::render::Picture;
use crate::raster::RgbImage;

/// Length of the noise table; more than four times the height of the largest frame.
const NOISE_LENGTH: usize = 1 << 15;
/// Columns developed before their bytes are laid out in rows.
const COLUMNS_AT_ONCE: usize = 16;
/// Longest motion blur in pixels, so that a frame in a bend still shows something.
const MAX_BLUR_PX: usize = 24;

/// Develops pictures; holds a table of Gaussian noise with variance 1.
#[derive(Clone, Debug)]
pub(super) struct Film {
    noise: Vec<f32>,
}

impl Film {
    /// The film of the world `seed`.
    pub(super) fn new(seed: u32) -> Self {
        // The sum of four uniform numbers is close enough to a Gaussian; its variance is 4/12.
        let value = |i: usize| {
            let sum: f32 = (0..4).map(|k| unit(mix(seed ^ k, i as u32)) - 0.5).sum();
            sum * 3.0_f32.sqrt()
        };
        Self { noise: (0..NOISE_LENGTH).map(value).collect() }
    }

    /// The frame that `picture` leaves on the sensor; `seed` is that of the frame.
    pub(super) fn develop(&self, picture: &Picture, lighting: &Lighting, seed: u32) -> RgbImage {
        let (width, height) = (picture.width, picture.height);
        let mut image = RgbImage::new(width, height);
        let falloff = |i: usize, size: usize| 0.55 * ((i as f32 + 0.5) / size as f32 - 0.5).powi(2);
        let shading: Vec<f32> = (0..4 * height).map(|i| 1.06 - falloff(i / 4, height)).collect();
        let mut levels = vec![0; COLUMNS_AT_ONCE * 4 * height];
        for first in (0..width).step_by(COLUMNS_AT_ONCE) {
            let columns = first..(first + COLUMNS_AT_ONCE).min(width);
            for (x, levels) in columns.clone().zip(levels.chunks_exact_mut(4 * height)) {
                let light = picture.light[x * height..(x + 1) * height].as_flattened();
                let start = mix(seed, x as u32) as usize % (NOISE_LENGTH - 4 * height);
                let noise = &self.noise[start..start + 4 * height];
                expose((light, &shading, noise), lighting, falloff(x, width), levels);
            }
            for y in 0..height {
                let row = &mut image.pixels_mut()[(y * width + first) * 3..][..columns.len() * 3];
                for (pixel, levels) in row.chunks_exact_mut(3).zip(levels.chunks_exact(4 * height)) {
                    pixel.copy_from_slice(&levels[4 * y..4 * y + 3]);
                }
            }
        }
        image
    }
}

/// Grey levels from the light, lens shading and noise of one column. Plain slices of equal length and no
/// branches, so that the compiler may use vector instructions.
fn expose(
    (light, shading, noise): (&[f32], &[f32], &[f32]),
    lighting: &Lighting,
    edge: f32,
    levels: &mut [u8],
) {
    let (shot, read) = lighting.noise;
    for (((level, light), shading), noise) in levels.iter_mut().zip(light).zip(shading).zip(noise) {
        let tone = tone(light * lighting.exposure * (shading - edge));
        *level = (tone * 255.0 + noise * (shot + read / (tone + 0.08)) + 0.5) as u8;
    }
}

#[inline]
fn tone(light: f32) -> f32 {
    (light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14)).min(1.0).sqrt()
}

/// Smears the picture sideways by as much as the camera turns while the shutter is open.
pub(super) fn motion_blur(picture: &mut Picture, view: &View, shutter_seconds: f32, strength: f32) {
    let smear_px = strength * shutter_seconds * view.yaw_rate.abs() * view.focal_px;
    let reach = ((smear_px / 2.0).round() as usize).min(MAX_BLUR_PX / 2);
    if reach == 0 {
        return;
    }
    let (width, height) = (picture.width, picture.height);
    let sharp = picture.light.clone();
    let column = |x: usize| &sharp[x * height..(x + 1) * height];
    let clamp = |x: isize| x.clamp(0, width as isize - 1) as usize;
    let mut sum = vec![[0.0; 4]; height];
    let (reach, weight) = (reach as isize, 1.0 / (2 * reach + 1) as f32);
    for x in -reach..=reach {
        accumulate(&mut sum, column(clamp(x)), 1.0);
    }
    for x in 0..width {
        for (pixel, total) in picture.column_mut(x).iter_mut().zip(&sum) {
            *pixel = total.map(|channel| (channel * weight).max(0.0));
        }
        accumulate(&mut sum, column(clamp(x as isize + reach + 1)), 1.0);
        accumulate(&mut sum, column(clamp(x as isize - reach)), -1.0);
    }
}

fn accumulate(sum: &mut [[f32; 4]], column: &[[f32; 4]], sign: f32) {
    for (total, pixel) in sum.iter_mut().zip(column) {
        for c in 0..4 {
            total[c] += sign * pixel[c];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brighter_light_never_gives_a_darker_pixel() {
        let tones: Vec<f32> = (0..2000).map(|i| tone(i as f32 * 0.003)).collect();
        assert_eq!(tones[0], 0.0);
        assert!(tones.windows(2).all(|pair| pair[0] < pair[1]));
    }
}
