//! Sprites: passers-by, trees, street lamps and potted plants, painted flat and cut out.

use super::canvas::{Area, Canvas, Colour, blend, multiply, scaled};
use super::noise::{Dice, fractal_noise, mix, unit};
use super::texture::Texture;

const COATS: [Colour; 10] = [
    [150, 44, 48],
    [44, 70, 112],
    [60, 64, 66],
    [196, 164, 96],
    [66, 104, 78],
    [206, 200, 188],
    [112, 76, 54],
    [88, 62, 110],
    [214, 132, 56],
    [70, 130, 142],
];
const SKINS: [Colour; 4] = [[226, 184, 154], [198, 148, 114], [140, 94, 68], [98, 66, 50]];
const HAIRS: [Colour; 5] = [[48, 36, 30], [96, 64, 40], [176, 138, 84], [140, 136, 132], [28, 26, 28]];

/// Middle of a figure in metres from the left of its sprite.
const MIDDLE_METRES: f32 = 0.45;

/// Passer-by number `variant`.
pub(super) fn walker(variant: u32) -> Texture {
    let mut dice = Dice::new(variant, 41);
    let height = dice.between(1.6, 1.86);
    let mut canvas = Canvas::sprite((2.0 * MIDDLE_METRES, 1.95), 96.0, [60, 58, 56]);
    let (coat, trousers) = (dice.pick(&COATS), scaled(dice.pick(&COATS), 0.55));
    let skin = dice.pick(&SKINS);
    legs(&mut canvas, height, trousers, &mut dice);
    let swing = dice.between(-0.07, 0.07);
    arm(&mut canvas, height, -1.0, (scaled(coat, 0.72), skin, swing));
    torso(&mut canvas, height, coat, &mut dice);
    arm(&mut canvas, height, 1.0, (scaled(coat, 0.94), skin, swing));
    head(&mut canvas, height, skin, &mut dice);
    folds(&mut canvas, dice.bits());
    canvas.into()
}

/// A limb that tapers from one joint to the next; joints are (x, z, width) in metres.
fn limb(canvas: &mut Canvas, from: (f32, f32, f32), to: (f32, f32, f32), colour: Colour) {
    const STEPS: usize = 36;
    for step in 0..=STEPS {
        let t = step as f32 / STEPS as f32;
        let at = |a: f32, b: f32| a + (b - a) * t;
        let (x, z, width) = (at(from.0, to.0), at(from.1, to.1), at(from.2, to.2));
        canvas.ellipse(Area::centred(x, z - width / 2.0, width, width), colour);
    }
}

fn legs(canvas: &mut Canvas, height: f32, colour: Colour, dice: &mut Dice) {
    let stride = dice.between(0.04, 0.15);
    for (side, tone) in [(-1.0, 0.75), (1.0, 1.0)] {
        let (hip, knee) = (MIDDLE_METRES + side * 0.07, MIDDLE_METRES + side * (0.08 + 0.4 * stride));
        let foot = MIDDLE_METRES + side * (0.07 + stride);
        let shade = scaled(colour, tone);
        canvas.ellipse(Area::new(foot - 0.08, 0.0, 0.23, 0.11), [30, 27, 26]);
        limb(canvas, (hip, height * 0.48, 0.2), (knee, height * 0.27, 0.15), shade);
        limb(canvas, (knee, height * 0.27, 0.15), (foot, 0.1, 0.11), shade);
    }
}

fn arm(canvas: &mut Canvas, height: f32, side: f32, (sleeve, skin, swing): (Colour, Colour, f32)) {
    let (shoulder, elbow) = (MIDDLE_METRES + side * 0.2, MIDDLE_METRES + side * 0.255 + swing * 0.5);
    let hand = MIDDLE_METRES + side * 0.245 + swing;
    limb(canvas, (hand, height * 0.45, 0.09), (hand, height * 0.43, 0.08), skin);
    limb(canvas, (elbow, height * 0.62, 0.115), (hand, height * 0.47, 0.095), sleeve);
    limb(canvas, (shoulder, height * 0.785, 0.13), (elbow, height * 0.62, 0.115), sleeve);
}

fn torso(canvas: &mut Canvas, height: f32, coat: Colour, dice: &mut Dice) {
    let long = dice.chance(0.4);
    let (hem, shoulder) = (height * if long { 0.34 } else { 0.45 }, height * 0.845);
    let area = Area::centred(MIDDLE_METRES, hem, 0.62, shoulder - hem);
    let stripe = dice.chance(0.35).then(|| dice.pick(&COATS));
    let tall = area.height();
    canvas.edit(area, |x, z, texel| {
        let up = (z - hem) / tall;
        let waist =
            0.205 + 0.035 * (2.0 * up - 0.9).powi(2) + if long { 0.05 * (0.5 - up).max(0.0) } else { 0.0 };
        let half = waist * (1.0 - ((up - 0.78) / 0.22).max(0.0).powi(3) * 0.72);
        let across = (x - MIDDLE_METRES) / half;
        if across.abs() > 1.0 {
            return;
        }
        let striped = stripe.filter(|_| (0.3..0.8).contains(&up) && (up * 9.0).fract() < 0.4);
        let opening = if across.abs() < 0.045 { 0.6 } else { 1.0 };
        let [r, g, b] = scaled(striped.unwrap_or(coat), (0.92 + 0.16 * across) * opening);
        *texel = [r, g, b, 255];
    });
    canvas.ellipse(Area::centred(MIDDLE_METRES, shoulder - 0.06, 0.22, 0.1), dice.pick(&COATS));
    if dice.chance(0.55) {
        bag(canvas, height, dice);
    }
}

fn bag(canvas: &mut Canvas, height: f32, dice: &mut Dice) {
    let (colour, side) = (dice.pick(&COATS), dice.pick(&[-1.0, 1.0]));
    let area = Area::centred(MIDDLE_METRES + side * 0.24, height * 0.32, 0.26, 0.27);
    let strap = scaled(colour, 0.55);
    limb(canvas, (area.middle(), area.top, 0.03), (MIDDLE_METRES - side * 0.1, height * 0.82, 0.03), strap);
    canvas.fill(area, scaled(colour, 0.85));
    canvas.border(area, 0.02, strap);
    canvas.fill(area.part((0.0, 1.0), (0.6, 0.68)), strap);
    canvas.fill(area.part((0.42, 0.58), (0.5, 0.62)), [210, 190, 130]);
}

fn head(canvas: &mut Canvas, height: f32, skin: Colour, dice: &mut Dice) {
    let hair = dice.pick(&HAIRS);
    let chin = height - 0.25;
    limb(canvas, (MIDDLE_METRES, height * 0.82, 0.11), (MIDDLE_METRES, chin + 0.04, 0.1), scaled(skin, 0.78));
    if dice.chance(0.45) {
        canvas.ellipse(Area::centred(MIDDLE_METRES, chin - 0.1, 0.25, 0.34), scaled(hair, 0.85));
    }
    canvas.ellipse(Area::centred(MIDDLE_METRES, chin + 0.035, 0.205, 0.225), hair);
    canvas.ellipse(Area::centred(MIDDLE_METRES, chin, 0.165, 0.205), skin);
    canvas.ellipse(Area::centred(MIDDLE_METRES, chin + 0.15, 0.18, 0.1), hair);
    for eye in [-0.036, 0.036] {
        canvas.fill(Area::centred(MIDDLE_METRES + eye, chin + 0.105, 0.024, 0.014), [38, 30, 30]);
        canvas.fill(Area::centred(MIDDLE_METRES + eye, chin + 0.135, 0.034, 0.009), scaled(hair, 0.8));
    }
    canvas.fill(Area::centred(MIDDLE_METRES + 0.006, chin + 0.07, 0.02, 0.034), scaled(skin, 0.84));
    canvas.fill(Area::centred(MIDDLE_METRES, chin + 0.042, 0.05, 0.01), scaled(skin, 0.6));
    if dice.chance(0.3) {
        let hat = dice.pick(&COATS);
        canvas.ellipse(Area::centred(MIDDLE_METRES, chin + 0.145, 0.34, 0.055), scaled(hat, 0.7));
        canvas.ellipse(Area::centred(MIDDLE_METRES, chin + 0.13, 0.2, 0.17), hat);
    }
}

/// Folds of cloth and the round shading of a body lit from the upper right.
fn folds(canvas: &mut Canvas, seed: u32) {
    canvas.edit(canvas.area(), |x, z, texel| {
        let fold = fractal_noise(seed, x * 14.0 + z * 3.0, z * 5.0, 3);
        let round = 1.0 + 0.3 * (x - MIDDLE_METRES).clamp(-0.25, 0.25) / 0.25;
        multiply(texel, (0.76 + 0.46 * fold) * round);
    });
}

/// Tree number `variant`: a trunk and a crown of leaf clusters with light from above.
pub(super) fn tree(variant: u32) -> Texture {
    let mut dice = Dice::new(variant, 43);
    let leaf = dice.pick(&[[104, 138, 60], [124, 146, 62], [84, 124, 70], [164, 146, 62]]);
    let (width, height) = (dice.between(3.0, 3.8), dice.between(5.2, 6.6));
    let mut canvas = Canvas::sprite((width, height), 48.0, scaled(leaf, 0.55));
    let middle = width / 2.0;
    canvas.fill(Area::centred(middle, 0.0, 0.22, height * 0.6), [92, 76, 60]);
    canvas.fill(Area::new(middle - 0.11, 0.0, 0.08, height * 0.6), [66, 54, 44]);
    let (seed, crown) = (dice.bits(), Area::centred(middle, height * 0.36, width, height * 0.64));
    canvas.edit(crown, |x, z, texel| {
        let (dx, dz) =
            ((x - middle) / (width / 2.0), (z - (crown.bottom + crown.top) / 2.0) / (crown.height() / 2.0));
        let cluster = fractal_noise(seed, x * 1.6, z * 1.6, 3);
        let speck = unit(mix(mix(seed, (x * 24.0) as u32), (z * 24.0) as u32));
        if dx.hypot(dz) > 0.5 + 0.55 * cluster || (speck < 0.1 && cluster < 0.5) {
            return;
        }
        let light = 0.42 + 0.4 * cluster + 0.24 * dz + 0.14 * dx + 0.2 * (speck - 0.5);
        let [r, g, b] =
            scaled(blend(leaf, [206, 204, 120], (light - 0.7).clamp(0.0, 0.5)), light.max(0.2) * 1.25);
        *texel = [r, g, b, 255];
    });
    canvas.into()
}

/// A cast-iron street lamp as high as `height` metres, lantern on top.
pub(super) fn street_lamp(height: f32) -> Texture {
    let mut canvas = Canvas::sprite((0.7, height + 0.35), 48.0, [40, 46, 44]);
    let iron: Colour = [46, 54, 52];
    canvas.fill(Area::centred(0.35, 0.0, 0.1, height - 0.3), iron);
    canvas.fill(Area::new(0.3, 0.0, 0.03, height - 0.3), scaled(iron, 1.7));
    for (bottom, width, tall) in
        [(0.0, 0.34, 0.16), (0.16, 0.24, 0.7), (1.2, 0.18, 0.08), (height - 0.9, 0.5, 0.06)]
    {
        canvas.fill(Area::centred(0.35, bottom, width, tall), scaled(iron, 0.9));
    }
    let lantern = Area::centred(0.35, height - 0.32, 0.4, 0.46);
    canvas.fill(lantern, iron);
    canvas.fill(lantern.inset(0.05), [250, 240, 206]);
    canvas.fill(Area::centred(0.35, height - 0.32, 0.04, 0.46), iron);
    canvas.fill(Area::centred(0.35, height + 0.14, 0.5, 0.06), iron);
    canvas.fill(Area::centred(0.35, height + 0.2, 0.26, 0.08), iron);
    canvas.into()
}

/// Potted plant number `variant`.
pub(super) fn plant(variant: u32) -> Texture {
    let mut dice = Dice::new(variant, 47);
    let mut canvas = Canvas::sprite((0.8, 1.5), 84.0, [52, 74, 44]);
    let pot = dice.pick(&[[176, 100, 70], [220, 216, 208], [70, 74, 82]]);
    canvas.gradient(Area::centred(0.4, 0.0, 0.34, 0.36), scaled(pot, 0.7), pot);
    canvas.fill(Area::centred(0.4, 0.32, 0.4, 0.07), scaled(pot, 1.1));
    for _ in 0..46 {
        let (lean, reach) = (dice.between(-0.9, 0.9), dice.between(0.4, 1.05));
        let colour = scaled([74, 120, 62], dice.between(0.5, 1.3));
        for step in 0..40 {
            let t = step as f32 / 40.0;
            let x = 0.4 + lean * t * 0.4;
            let z = 0.38 + reach * t * (1.0 - 0.45 * t * lean.abs());
            canvas.ellipse(Area::centred(x, z, 0.02 + 0.05 * (1.0 - t) * (t * 6.0).min(1.0), 0.05), colour);
        }
    }
    canvas.into()
}
