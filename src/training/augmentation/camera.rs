//! What lens, shutter and sensor do to the light.

use rand::RngCore;
use rand_pcg::Pcg64;

use super::linear_image::{Light, LinearImage};

/// Darkens towards the corners by the fourth power of the cosine of the angle off the axis, which is
/// `half_angle_radians` in the corners: cos⁴ θ = 1 / (1 + tan² θ)².
pub(super) fn vignette(image: &mut LinearImage, half_angle_radians: f32) {
    let (middle_x, middle_y) = (image.width as f32 / 2.0, image.height as f32 / 2.0);
    let scale = half_angle_radians.tan().powi(2) / (middle_x * middle_x + middle_y * middle_y);
    for (y, row) in image.rows_mut().enumerate() {
        let above = (y as f32 + 0.5 - middle_y).powi(2);
        for (x, pixel) in row.iter_mut().enumerate() {
            let aside = (x as f32 + 0.5 - middle_x).powi(2);
            let root = 1.0 + (above + aside) * scale;
            let share = 1.0 / (root * root);
            *pixel = pixel.map(|light| light * share);
        }
    }
}

/// Sensor noise: of `white_electrons` that white light frees, the root of those that came are shot noise (Poisson's,
/// nearly a Gaussian), and `read_electrons` more are what reading adds (EMVA standard 1288, without dark current).
pub(super) fn noise(image: &mut LinearImage, white_electrons: f32, read_electrons: f32, random: &mut Pcg64) {
    let (shot, read) = (1.0 / white_electrons, (read_electrons / white_electrons).powi(2));
    let mut gaussian = vec![0.0; 3 * image.width];
    for row in image.rows_mut() {
        gaussian.fill_with(|| nearly_gaussian(random));
        for (light, gaussian) in row.as_flattened_mut().iter_mut().zip(&gaussian) {
            *light = (*light + gaussian * (light.max(0.0) * shot + read).sqrt()).max(0.0);
        }
    }
}

/// A number with mean 0 and variance 1: the sum of four uniform ones of 16 bits, which is near enough to a Gaussian
/// and costs one draw.
fn nearly_gaussian(random: &mut Pcg64) -> f32 {
    let bits = random.next_u64();
    let sum = (0..4).map(|part| (bits >> (16 * part)) as u16).map(u32::from).sum::<u32>();
    // Each has the variance (2³² − 1) / 12.
    const DEVIATION: f32 = 37_837.2;
    (sum as f32 - 131_070.0) / DEVIATION
}

/// Blurs by a Gaussian of `sigma_px`, as a lens out of focus does about; borders repeat the edge.
pub(super) fn defocus(image: &mut LinearImage, sigma_px: f32) {
    let taps = gaussian_taps(sigma_px);
    let reach = taps.len() / 2;
    let mut padded = vec![[0.0; 3]; image.width + 2 * reach];
    for row in image.rows_mut() {
        pad(row, reach, &mut padded);
        row.as_flattened_mut().fill(0.0);
        for (step, &tap) in taps.iter().enumerate() {
            add(&padded[step..step + row.len()], tap, row);
        }
    }
    let sharp = image.pixels.clone();
    let (width, last) = (image.width, image.height.saturating_sub(1));
    for (y, row) in image.rows_mut().enumerate() {
        row.as_flattened_mut().fill(0.0);
        for (step, &tap) in taps.iter().enumerate() {
            let from = (y + step).saturating_sub(reach).min(last);
            add(&sharp[from * width..][..width], tap, row);
        }
    }
}

/// Smears sideways over `length_px`, as a robot does that turns while the shutter is open; borders repeat the edge.
pub(super) fn motion_blur(image: &mut LinearImage, length_px: f32) {
    let reach = (length_px.clamp(0.0, image.width as f32) / 2.0) as usize;
    let taps = 2 * reach + 1;
    let mut padded = vec![[0.0; 3]; image.width + 2 * reach];
    for row in image.rows_mut() {
        pad(row, reach, &mut padded);
        let mut sum = [0.0; 3];
        padded[..taps - 1].iter().for_each(|pixel| accumulate(&mut sum, *pixel, 1.0));
        for (x, pixel) in row.iter_mut().enumerate() {
            accumulate(&mut sum, padded[x + taps - 1], 1.0);
            *pixel = sum.map(|light| light.max(0.0) / taps as f32);
            accumulate(&mut sum, padded[x], -1.0);
        }
    }
}

/// exp(−x² / 2σ²) for whole x within 2.5 σ, scaled to the sum 1.
fn gaussian_taps(sigma_px: f32) -> Vec<f32> {
    let reach = (2.5 * sigma_px.clamp(0.0, 64.0)).ceil() as i32;
    let weight = |x: i32| (-(x * x) as f32 / (2.0 * sigma_px * sigma_px).max(1e-6)).exp();
    let total: f32 = (-reach..=reach).map(weight).sum();
    (-reach..=reach).map(|x| weight(x) / total).collect()
}

fn pad(row: &[Light], reach: usize, padded: &mut [Light]) {
    let Some((&first, &last)) = row.first().zip(row.last()) else { return };
    padded[..reach].fill(first);
    padded[reach..reach + row.len()].copy_from_slice(row);
    padded[reach + row.len()..].fill(last);
}

fn add(from: &[Light], weight: f32, to: &mut [Light]) {
    for (to, from) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        *to += weight * from;
    }
}

fn accumulate(sum: &mut Light, pixel: Light, sign: f32) {
    for (sum, light) in sum.iter_mut().zip(pixel) {
        *sum += sign * light;
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::linear_image::tests::plain;
    use super::*;

    fn deviation(image: &LinearImage, mean: f32) -> f32 {
        let values = image.pixels.as_flattened();
        (values.iter().map(|light| (light - mean).powi(2)).sum::<f32>() / values.len() as f32).sqrt()
    }

    #[test]
    fn a_vignette_darkens_corners_by_the_fourth_power_of_the_cosine_and_leaves_the_middle() {
        let mut image = plain(401, 301, 1.0);
        vignette(&mut image, 0.5);
        assert!((image.pixels[150 * 401 + 200][0] - 1.0).abs() < 1e-3);
        assert!((image.pixels[0][0] - 0.5_f32.cos().powi(4)).abs() < 0.01, "{:?}", image.pixels[0]);
    }

    #[test]
    fn noise_has_the_strength_that_the_electrons_give_it() {
        for (light, expected) in
            [(0.25, (0.25_f32 * 1000.0 + 25.0).sqrt() / 1000.0), (0.04, 0.065_f32.sqrt() / 31.6)]
        {
            let mut image = plain(200, 100, light);
            noise(&mut image, 1000.0, 5.0, &mut Pcg64::seed_from_u64(1));
            let mean = image.mean_luminance();
            assert!((mean - light).abs() < 1e-3, "mean {mean}");
            let got = deviation(&image, light);
            assert!((got / expected - 1.0).abs() < 0.02, "deviation {got}, expected {expected}");
        }
    }

    #[test]
    fn blurring_keeps_a_plain_image_and_the_light_of_a_spot() {
        for blur in [defocus, motion_blur] {
            let mut image = plain(9, 7, 0.3);
            blur(&mut image, 3.0);
            assert!(image.pixels.as_flattened().iter().all(|light| (light - 0.3).abs() < 1e-5));
            let mut spot = plain(31, 31, 0.0);
            spot.pixels[15 * 31 + 15] = [1.0; 3];
            blur(&mut spot, 3.0);
            let sum: f32 = spot.pixels.iter().map(|pixel| pixel[0]).sum();
            assert!((sum - 1.0).abs() < 1e-4 && spot.pixels[15 * 31 + 15][0] < 0.5, "{sum}");
        }
    }

    #[test]
    fn a_blur_of_nothing_changes_nothing() {
        let mut image = plain(5, 4, 0.1);
        image.pixels[7] = [0.9, 0.2, 0.4];
        for blur in [defocus, motion_blur] {
            let mut blurred = image.clone();
            blur(&mut blurred, 0.0);
            assert_eq!(blurred, image);
        }
    }
}
