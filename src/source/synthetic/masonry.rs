//! What walls and roofs are made of: brick courses, plaster, roof tiles, and the dirt of years.

use super::canvas::{Area, Canvas, Colour, blend, multiply, scaled};
use super::noise::{Dice, Grain, fractal_noise, mix, unit};

const PLASTERS: [Colour; 9] = [
    [228, 214, 182],
    [216, 174, 104],
    [212, 144, 116],
    [160, 174, 144],
    [146, 164, 182],
    [234, 232, 224],
    [188, 110, 82],
    [222, 182, 174],
    [206, 196, 186],
];
const BRICKS: [Colour; 5] = [[156, 78, 58], [124, 84, 66], [192, 160, 114], [104, 72, 62], [174, 104, 74]];
const TILES: [Colour; 4] = [[134, 68, 50], [88, 84, 88], [112, 76, 62], [74, 82, 92]];

/// Covers `area` with brick or plaster and returns its main colour.
pub(super) fn paint_wall(canvas: &mut Canvas, area: Area, dice: &mut Dice, grain: &Grain) -> Colour {
    if dice.chance(0.45) {
        let colour = dice.pick(&BRICKS);
        bricks(canvas, area, colour, dice.bits());
        canvas.grain(area, grain, 0.16);
        colour
    } else {
        let colour = dice.pick(&PLASTERS);
        canvas.fill(area, colour);
        canvas.grain(area, grain, 0.1);
        stains(canvas, area, dice.bits());
        colour
    }
}

/// Brick courses in running bond, every brick with its own tone.
pub(super) fn bricks(canvas: &mut Canvas, area: Area, colour: Colour, seed: u32) {
    const COURSE_METRES: f32 = 0.125;
    const BRICK_METRES: f32 = 0.34;
    let mortar = blend(colour, [214, 206, 194], 0.55);
    canvas.edit(area, |x, z, texel| {
        let course = (z / COURSE_METRES).floor();
        let along = x / BRICK_METRES + 0.5 * (course % 2.0);
        let joint = z - course * COURSE_METRES < 0.028 || (along - along.floor()) * BRICK_METRES < 0.028;
        let tone = unit(mix(mix(seed, course as u32), along as u32));
        let [r, g, b] = if joint { mortar } else { scaled(colour, 0.74 + 0.5 * tone) };
        *texel = [r, g, b, 0];
    });
}

/// Roof tiles in shadowed rows.
pub(super) fn roof_tiles(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    let (colour, seed) = (dice.pick(&TILES), dice.bits());
    canvas.edit(area, |x, z, texel| {
        let row = (z / 0.22).floor();
        let across = x / 0.26 + 0.5 * (row % 2.0);
        let (depth, rim) = (z / 0.22 - row, across - across.floor());
        let tone = 0.78 + 0.3 * unit(mix(mix(seed, row as u32), across as u32));
        let relief = if depth < 0.2 || rim < 0.14 { 0.6 } else { 0.9 + 0.2 * depth };
        let [r, g, b] = scaled(colour, tone * relief);
        *texel = [r, g, b, 0];
    });
}

/// Damp at the foot, rain streaks from above and patches where plaster has come off.
fn stains(canvas: &mut Canvas, area: Area, seed: u32) {
    canvas.edit(area, |x, z, texel| {
        let streak = fractal_noise(seed, x * 3.0, z * 0.25, 2);
        let damp = (1.0 - (z - area.bottom) / 1.1).max(0.0) * fractal_noise(seed ^ 1, x * 1.5, z * 1.5, 2);
        multiply(texel, 1.0 - 0.3 * (streak - 0.55).max(0.0) * 2.2 - 0.4 * damp);
    });
    let mut dice = Dice::new(seed, 2);
    for _ in 0..dice.below(4) {
        let (width, height) = (dice.between(0.5, 1.3), dice.between(0.4, 1.0));
        let left = area.left + dice.between(0.0, (area.width() - width).max(0.1));
        let bottom = area.bottom + dice.between(0.3, (area.height() - height).max(0.4));
        peeled_patch(canvas, Area::new(left, bottom, width, height), dice.bits());
    }
}

/// A ragged patch of bare brick.
fn peeled_patch(canvas: &mut Canvas, area: Area, seed: u32) {
    let (middle, centre) = (area.middle(), (area.bottom + area.top) / 2.0);
    canvas.edit(area, |x, z, texel| {
        let (dx, dz) = ((x - middle) / area.width(), (z - centre) / area.height());
        if dx.hypot(dz) > 0.22 + 0.3 * fractal_noise(seed, x * 4.0, z * 4.0, 3) {
            return;
        }
        let course = (z / 0.125).floor();
        let along = x / 0.34 + 0.5 * (course % 2.0);
        let joint = z - course * 0.125 < 0.03 || along - along.floor() < 0.1;
        let [r, g, b] = if joint { [176, 164, 148] } else { [150, 88, 66] };
        *texel = [r, g, b, 0];
    });
}

/// Ivy that climbs from the foot of a wall, densest at `middle`.
pub(super) fn ivy(canvas: &mut Canvas, middle: f32, height: f32, seed: u32) {
    let area = Area::centred(middle, 0.0, height * 0.8, height);
    canvas.edit(area, |x, z, texel| {
        let spread = ((x - middle).abs() / (height * 0.4)).powi(2) + (z / height).powi(2);
        if fractal_noise(seed, x * 2.0, z * 2.0, 3) * 1.25 < spread {
            return;
        }
        let leaf = unit(mix(mix(seed, (x * 11.0) as u32), (z * 11.0) as u32));
        let [r, g, b] = scaled([74, 108, 48], 0.45 + 0.85 * leaf);
        *texel = [r, g, b, 0];
    });
}

/// A moulding that stands out of the wall: light above, its shadow below.
pub(super) fn moulding(canvas: &mut Canvas, area: Area, colour: Colour) {
    canvas.shade(Area { bottom: area.bottom - area.height() * 0.9, top: area.bottom, ..area }, 0.62);
    canvas.gradient(area, scaled(colour, 0.78), colour);
    canvas.fill(Area { bottom: area.top - 0.05, ..area }, scaled(colour, 1.12));
}
