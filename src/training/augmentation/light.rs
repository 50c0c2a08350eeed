//! The colour and strength of the light.

use super::linear_image::{Light, LinearImage, luminance};

/// Colour temperature that sRGB takes for white, in kelvin.
const NEUTRAL_KELVIN: f32 = 6504.0;

/// Brightens by `stops`: each doubles the light, a negative one halves it.
pub(super) fn expose(image: &mut LinearImage, stops: f32) {
    tint(image, [stops.exp2(); 3]);
}

/// Lights the scene by a black body of `kelvin` (1,667 to 25,000) instead of one of 6,504, with grey as bright as
/// before: below, red grows against blue; above, the other way round. Each channel is scaled on its own, as von Kries
/// (1902) had it of the eye.
pub(super) fn colour_temperature(image: &mut LinearImage, kelvin: f32) {
    let (light, neutral) = (black_body(kelvin), black_body(NEUTRAL_KELVIN));
    let gains: Light = std::array::from_fn(|channel| light[channel] / neutral[channel]);
    let of_grey = luminance(gains);
    tint(image, gains.map(|gain| gain / of_grey));
}

/// Multiplies red, green and blue by `gains`.
pub(super) fn tint(image: &mut LinearImage, gains: Light) {
    for pixel in &mut image.pixels {
        for (light, gain) in pixel.iter_mut().zip(gains) {
            *light *= gain;
        }
    }
}

/// The colour of a black body of `kelvin` (1,667 to 25,000; others count as the nearer of them) with luminance of
/// about 1, without what sRGB has no light for.
///
/// Chromaticity: Kim et al., "Design of advanced color temperature control system for HDTV applications" (2002).
pub(super) fn black_body(kelvin: f32) -> Light {
    let t = 1000.0 / f64::from(kelvin.clamp(1667.0, 25_000.0));
    let x = if t > 0.25 {
        ((-0.266_123_9 * t - 0.234_358_9) * t + 0.877_695_6) * t + 0.179_910
    } else {
        ((-3.025_846_9 * t + 2.107_037_9) * t + 0.222_634_7) * t + 0.240_390
    };
    let y = if t > 0.45 {
        ((-1.106_381_4 * x - 1.348_110_2) * x + 2.185_558_32) * x - 0.202_196_83
    } else if t > 0.25 {
        ((-0.954_947_6 * x - 1.374_185_93) * x + 2.091_370_15) * x - 0.167_488_67
    } else {
        ((3.081_758 * x - 5.873_386_7) * x + 3.751_129_97) * x - 0.370_014_83
    };
    // Y is 1; the matrix is that of IEC 61966-2-1.
    let (x, z) = (x / y, (1.0 - x - y) / y);
    [3.2406 * x - 1.5372 - 0.4986 * z, -0.9689 * x + 1.8758 + 0.0415 * z, 0.0557 * x - 0.2040 + 1.0570 * z]
        .map(|light| light.max(0.0) as f32)
}

#[cfg(test)]
mod tests {
    use super::super::linear_image::tests::plain;
    use super::*;

    #[test]
    fn one_stop_doubles_the_light_until_it_is_cut_off() {
        let mut image = plain(2, 1, 0.2);
        image.pixels[1] = [0.7; 3];
        expose(&mut image, 1.0);
        assert_eq!(image.pixels[0], [0.4; 3]);
        assert_eq!(&image.to_bytes().pixels()[3..], &[255; 3]);
    }

    #[test]
    fn a_lower_temperature_is_redder_and_as_bright() {
        let mut ratio_before = 0.0;
        for kelvin in [20_000.0, 9000.0, NEUTRAL_KELVIN, 4500.0, 3900.0, 3000.0, 2100.0, 1800.0] {
            let mut image = plain(1, 1, 0.5);
            colour_temperature(&mut image, kelvin);
            let [red, _, blue] = image.pixels[0];
            assert!((luminance(image.pixels[0]) - 0.5).abs() < 1e-4, "{kelvin} K");
            assert!(red / blue > ratio_before, "{kelvin} K: {red} to {blue}");
            ratio_before = red / blue;
        }
    }

    #[test]
    fn a_black_body_of_the_neutral_temperature_is_nearly_white_and_changes_nothing() {
        assert!(black_body(NEUTRAL_KELVIN).iter().all(|light| (light - 1.0).abs() < 0.06));
        let mut image = plain(1, 1, 0.5);
        colour_temperature(&mut image, NEUTRAL_KELVIN);
        assert!(image.pixels[0].iter().all(|light| (light - 0.5).abs() < 1e-4));
    }

    #[test]
    fn temperatures_that_no_formula_covers_count_as_the_nearest() {
        assert_eq!(black_body(-5.0), black_body(1667.0));
        assert_eq!(black_body(1e9), black_body(25_000.0));
    }
}
