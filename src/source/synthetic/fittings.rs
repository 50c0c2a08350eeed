//! What hangs on the walls of the corridor: doors, notice boards, pictures, lockers, signs.

use super::canvas::{Area, Canvas, Colour, blend, multiply, scaled};
use super::facade::poster;
use super::noise::{Dice, Grain, fractal_noise};
use super::world::Surface;

/// Height of the corridor in metres.
pub(super) const CEILING_METRES: f32 = 2.7;
const PX_PER_METRE: f32 = 84.0;

const WALLS: [Colour; 6] =
    [[222, 216, 202], [206, 214, 216], [226, 208, 178], [200, 212, 192], [216, 204, 212], [232, 228, 222]];
const DOORS: [Colour; 6] =
    [[148, 100, 62], [112, 74, 50], [72, 98, 122], [176, 140, 96], [92, 112, 92], [136, 60, 54]];
const ROOMS: [&str; 8] = ["LAB", "OFFICE", "ARCHIVE", "PRINT", "SEMINAR", "STORE", "LIBRARY", "KITCHEN"];
const PAPERS: [Colour; 6] =
    [[244, 240, 228], [246, 222, 110], [176, 214, 240], [244, 178, 168], [190, 226, 176], [250, 250, 250]];

/// The colours that one stretch of corridor is painted in.
#[derive(Clone, Copy, Debug)]
pub(super) struct Livery {
    wall: Colour,
    wainscot: Colour,
    door: Colour,
}

impl Livery {
    /// Colours for one stretch.
    pub(super) fn draw(dice: &mut Dice) -> Self {
        let wainscots: [Colour; 6] =
            [[104, 132, 126], [150, 84, 66], [84, 104, 142], [160, 138, 92], [116, 96, 120], [92, 118, 84]];
        Self { wall: dice.pick(&WALLS), wainscot: dice.pick(&wainscots), door: dice.pick(&DOORS) }
    }
}

/// One bay of corridor wall, `design` says which; the same design gives the same bay.
pub(super) fn bay(design: u32, livery: &Livery, grain: &Grain) -> Surface {
    let mut dice = Dice::new(design, 61);
    let kind = dice.below(9);
    let width = match kind {
        0..=2 => dice.between(2.0, 2.6),
        3 => 3.2,
        _ => dice.between(1.8, 3.0),
    };
    let mut canvas = bare_wall(width, livery, grain, dice.bits());
    let middle = width / 2.0;
    match kind {
        0..=2 => door(&mut canvas, Area::centred(middle - 0.2, 0.0, 0.95, 2.1), livery.door, &mut dice),
        3 => double_door(&mut canvas, middle, livery.door, &mut dice),
        4 => notice_board(&mut canvas, Area::centred(middle, 1.05, width - 0.5, 1.1), &mut dice),
        5 => lockers(&mut canvas, Area::centred(middle, 0.08, width - 0.3, 1.85), &mut dice),
        6 => posters(&mut canvas, width, &mut dice),
        7 => painting(&mut canvas, Area::centred(middle, 1.15, width * 0.6, 0.95), &mut dice),
        _ => office_window(&mut canvas, Area::centred(middle, 1.0, width - 0.5, 1.25), &mut dice),
    }
    accessories(&mut canvas, width, kind, &mut dice);
    Surface::level(canvas)
}

/// Plaster above, paint below, with a rail, a skirting and scuff marks.
fn bare_wall(width: f32, livery: &Livery, grain: &Grain, seed: u32) -> Canvas {
    let mut canvas = Canvas::wall((width, CEILING_METRES), PX_PER_METRE, livery.wall);
    let whole = canvas.area();
    let dado = Area { top: 0.95, ..whole };
    canvas.gradient(dado, scaled(livery.wainscot, 0.88), livery.wainscot);
    canvas.grain(whole, grain, 0.07);
    canvas.edit(dado, |x, z, texel| {
        let scuff = fractal_noise(seed, x * 1.4, z * 9.0, 3);
        multiply(texel, 1.0 - 0.9 * (scuff - 0.6).max(0.0));
    });
    canvas.edit(Area { bottom: 1.0, ..whole }, |x, z, texel| {
        let cloud = fractal_noise(seed ^ 7, x * 1.1, z * 1.1, 3);
        multiply(texel, 0.93 + 0.12 * cloud);
    });
    canvas.fill(Area { bottom: 0.93, top: 1.0, ..whole }, scaled(livery.wainscot, 0.62));
    canvas.fill(Area { bottom: 0.985, top: 1.0, ..whole }, scaled(livery.wainscot, 1.3));
    canvas.fill(Area { top: 0.11, ..whole }, [66, 58, 52]);
    canvas.fill(Area { bottom: 0.1, top: 0.115, ..whole }, [128, 118, 108]);
    canvas.fill(Area { bottom: CEILING_METRES - 0.06, ..whole }, scaled(livery.wall, 0.7));
    canvas
}

fn door(canvas: &mut Canvas, area: Area, colour: Colour, dice: &mut Dice) {
    let casing = Area { left: area.left - 0.09, right: area.right + 0.09, top: area.top + 0.09, ..area };
    canvas.shade(Area { right: casing.right + 0.04, ..casing }, 0.7);
    canvas.fill(casing, [120, 118, 114]);
    canvas.border(casing, 0.025, [168, 166, 160]);
    let seed = dice.bits();
    canvas.edit(area, |x, z, texel| {
        let vein = fractal_noise(seed, x * 16.0, z * 0.8, 3);
        let [r, g, b] = scaled(colour, 0.78 + 0.44 * vein);
        *texel = [r, g, b, 0];
    });
    canvas.border(area, 0.015, scaled(colour, 0.5));
    match dice.below(3) {
        0 => {
            let pane = area.part((0.6, 0.82), (0.5, 0.88));
            canvas.fill(pane, scaled(colour, 0.5));
            canvas.fill_glowing(pane.inset(0.03), [150, 172, 180], 30);
            canvas.shade(pane.part((0.2, 0.5), (0.1, 0.9)), 1.2);
        }
        1 => {
            for rows in [(0.08, 0.44), (0.52, 0.92)] {
                let panel = area.part((0.14, 0.86), rows);
                canvas.border(panel, 0.03, scaled(colour, 0.55));
                canvas.border(panel.inset(0.03), 0.02, scaled(colour, 1.35));
            }
        }
        _ => canvas.fill(area.part((0.0, 1.0), (0.0, 0.1)), [150, 152, 154]),
    }
    canvas.fill(Area::new(area.left + 0.07, 0.98, 0.16, 0.035), [214, 214, 210]);
    canvas.fill(Area::new(area.left + 0.06, 0.9, 0.045, 0.2), [150, 150, 148]);
    name_plate(canvas, Area::new(area.right + 0.2, 1.4, 0.52, 0.34), dice);
}

fn name_plate(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    canvas.shade(Area { left: area.left + 0.015, bottom: area.bottom - 0.02, ..area }, 0.75);
    canvas.fill(area, [238, 238, 234]);
    canvas.fill(area.part((0.0, 1.0), (0.86, 1.0)), dice.pick(&DOORS));
    canvas.text(area.part((0.06, 0.94), (0.44, 0.84)), &format!("{}", 100 + dice.below(300)), [34, 36, 42]);
    canvas.text(area.part((0.03, 0.97), (0.08, 0.38)), dice.pick(&ROOMS), [84, 86, 92]);
}

fn double_door(canvas: &mut Canvas, middle: f32, colour: Colour, dice: &mut Dice) {
    for (left, wing) in [(middle - 0.92, 0), (middle, 1)] {
        let area = Area::new(left, 0.0, 0.92, 2.2);
        canvas.fill(area, scaled(colour, 0.9));
        canvas.border(area, 0.05, scaled(colour, 0.6));
        let pane = area.part((0.22, 0.78), (0.42, 0.9));
        canvas.gradient(pane, [96, 112, 118], [172, 190, 196]);
        canvas.edit(pane, |x, z, texel| {
            if (x / 0.06).fract() < 0.12 || (z / 0.06).fract() < 0.12 {
                *texel = [96, 100, 100, 0];
            }
        });
        canvas.fill(area.part((0.08, 0.92), (0.02, 0.12)), [150, 152, 154]);
        let handle = if wing == 0 { area.right - 0.12 } else { area.left + 0.08 };
        canvas.fill(Area::new(handle, 0.9, 0.04, 0.4), [210, 210, 206]);
    }
    canvas.border(Area::centred(middle, 0.0, 2.0, 2.28), 0.08, [120, 118, 114]);
    exit_sign(canvas, Area::centred(middle, 2.34, 0.56, 0.22));
    name_plate(canvas, Area::new(middle + 1.05, 1.4, 0.5, 0.34), dice);
}

fn exit_sign(canvas: &mut Canvas, area: Area) {
    canvas.fill_glowing(area, [24, 150, 84], 255);
    canvas.text(area.inset(0.03), "EXIT", [236, 250, 240]);
    canvas.edit(area, |_, _, texel| texel[3] = 255);
}

fn notice_board(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    canvas.shade(
        Area { left: area.left + 0.03, right: area.right + 0.03, bottom: area.bottom - 0.04, ..area },
        0.72,
    );
    let felt = dice.pick(&[[176, 132, 86], [72, 104, 82], [70, 84, 124], [140, 66, 62]]);
    canvas.fill(area, felt);
    for _ in 0..(area.width() * 9.0) as usize {
        let (width, height) = dice.pick(&[(0.21, 0.297), (0.297, 0.21), (0.15, 0.21), (0.1, 0.1)]);
        let left = dice.between(area.left + 0.05, area.right - width - 0.05);
        let bottom = dice.between(area.bottom + 0.05, area.top - height - 0.05);
        sheet(canvas, Area::new(left, bottom, width, height), dice);
    }
    canvas.border(area, 0.045, [196, 190, 178]);
    canvas.border(area, 0.015, [130, 124, 114]);
}

/// A pinned sheet with a headline and lines of print.
fn sheet(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    canvas.shade(
        Area { left: area.left + 0.012, right: area.right + 0.012, bottom: area.bottom - 0.014, ..area },
        0.7,
    );
    canvas.fill(area, dice.pick(&PAPERS));
    let ink = dice.pick(&[[52, 52, 58], [60, 70, 120], [130, 50, 50]]);
    canvas.fill(area.part((0.12, dice.between(0.5, 0.88)), (0.8, 0.9)), ink);
    for line in 0..5 {
        let z = 0.12 + 0.12 * line as f32;
        canvas.fill(
            area.part((0.12, dice.between(0.45, 0.9)), (z, z + 0.045)),
            blend(ink, [255, 255, 255], 0.35),
        );
    }
    if dice.chance(0.4) {
        canvas.fill(area.part((0.5, 0.88), (0.3, 0.66)), dice.pick(&PAPERS));
        canvas.ellipse(area.part((0.55, 0.83), (0.34, 0.62)), dice.pick(&DOORS));
    }
    let pin = Area::centred(area.middle(), area.top - 0.03, 0.025, 0.025);
    canvas.ellipse(pin, dice.pick(&[[200, 44, 40], [40, 90, 180], [230, 190, 40]]));
}

fn lockers(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    let colour =
        dice.pick(&[[92, 122, 150], [170, 108, 70], [110, 138, 112], [150, 152, 156], [176, 152, 84]]);
    canvas.shade(Area { right: area.right + 0.06, ..area }, 0.65);
    let columns = (area.width() / 0.34).floor().max(1.0);
    for column in 0..columns as usize {
        for row in 0..2 {
            let (x, z) = (column as f32 / columns, row as f32 * 0.5);
            let locker = area.part((x, x + 1.0 / columns), (z, z + 0.5));
            canvas.gradient(locker, scaled(colour, 0.84), scaled(colour, dice.between(0.96, 1.1)));
            canvas.border(locker, 0.012, scaled(colour, 0.5));
            for slot in 0..4 {
                let top = locker.top - 0.1 - 0.035 * slot as f32;
                canvas.fill(
                    Area::centred(locker.middle(), top, locker.width() * 0.5, 0.014),
                    scaled(colour, 0.4),
                );
            }
            canvas.fill(Area::new(locker.right - 0.07, locker.bottom + 0.4, 0.03, 0.1), [60, 62, 64]);
            if dice.chance(0.25) {
                let sticker = Area::centred(locker.middle() - 0.03, locker.bottom + 0.5, 0.12, 0.1);
                canvas.fill(sticker, dice.pick(&PAPERS));
                canvas.ellipse(sticker.inset(0.02), dice.pick(&DOORS));
            }
        }
    }
}

fn posters(canvas: &mut Canvas, width: f32, dice: &mut Dice) {
    let count = (width / 0.85).floor().max(1.0);
    for i in 0..count as usize {
        let middle = (i as f32 + 0.5) * width / count;
        poster(canvas, Area::centred(middle, 1.12 + dice.between(0.0, 0.15), 0.68, 0.96), dice);
    }
}

/// A framed landscape: sky, sun, hills, water.
fn painting(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    canvas.shade(
        Area { left: area.left + 0.04, right: area.right + 0.04, bottom: area.bottom - 0.06, ..area },
        0.65,
    );
    canvas.fill(area, dice.pick(&[[132, 96, 48], [52, 46, 42], [196, 170, 110]]));
    let view = area.inset(0.07);
    canvas.fill(area.inset(0.05), [238, 232, 218]);
    let (low, high) = dice.pick(&[
        ([250, 206, 150], [96, 142, 190]),
        ([240, 150, 100], [88, 70, 120]),
        ([216, 228, 226], [120, 160, 176]),
    ]);
    canvas.gradient(view, low, high);
    let sun = view.part((dice.between(0.15, 0.4), 0.0), (0.0, 0.0)).left;
    canvas.ellipse(Area::new(sun, view.bottom + view.height() * 0.62, 0.14, 0.14), [252, 236, 180]);
    let seed = dice.bits();
    for (layer, colour) in [[116, 132, 150], [84, 112, 96], [58, 78, 52]].into_iter().enumerate() {
        canvas.edit(view, |x, z, texel| {
            let hill = fractal_noise(seed ^ layer as u32, x * 3.0, layer as f32, 3) * 0.5 + 0.38
                - 0.17 * layer as f32;
            if (z - view.bottom) / view.height() < hill {
                let [r, g, b] = scaled(colour, 0.85 + 0.3 * fractal_noise(seed, x * 30.0, z * 30.0, 2));
                *texel = [r, g, b, 0];
            }
        });
    }
}

/// A window into an office with blinds.
fn office_window(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    canvas.fill_glowing(area, [138, 156, 162], 40);
    canvas.gradient(area.part((0.0, 1.0), (0.0, 0.45)), [84, 88, 92], [120, 134, 140]);
    for _ in 0..5 {
        let x = dice.between(0.05, 0.8);
        let top = dice.between(0.2, 0.5);
        canvas.fill(area.part((x, x + 0.14), (0.0, top)), dice.pick(&DOORS));
    }
    let drawn = dice.between(0.3, 0.9);
    canvas.edit(area.part((0.0, 1.0), (1.0 - drawn, 1.0)), |_, z, texel| {
        let slat = (z / 0.045).fract();
        if slat > 0.25 {
            let [r, g, b] = scaled([224, 222, 212], 0.75 + 0.3 * slat);
            *texel = [r, g, b, 0];
        }
    });
    for column in 1..3 {
        let x = area.left + area.width() * column as f32 / 3.0;
        canvas.fill(Area::centred(x, area.bottom, 0.05, area.height()), [150, 148, 142]);
    }
    canvas.border(area, 0.06, [160, 158, 152]);
    canvas.border(area, 0.015, [96, 94, 90]);
}

/// Switches, extinguishers, clocks and arrows between the larger things.
fn accessories(canvas: &mut Canvas, width: f32, kind: usize, dice: &mut Dice) {
    if dice.chance(0.3) && [4, 7, 8].contains(&kind) {
        let tank = Area::new(0.08, 0.5, 0.16, 0.44);
        canvas.shade(Area { right: tank.right + 0.05, ..tank }, 0.7);
        canvas.gradient(tank, [150, 24, 22], [208, 44, 38]);
        canvas.fill(Area { right: tank.left + 0.04, ..tank }, [228, 96, 84]);
        canvas.fill(tank.part((0.15, 0.85), (0.4, 0.7)), [240, 232, 220]);
        canvas.fill(Area::centred(tank.middle(), tank.top, 0.07, 0.08), [30, 30, 32]);
        let sign = Area::new(0.08, 1.5, 0.15, 0.15);
        canvas.fill(sign, [204, 36, 32]);
        canvas.fill(sign.part((0.38, 0.62), (0.15, 0.7)), [250, 240, 236]);
    }
    let (clock, sign) = (dice.chance(0.25), dice.chance(0.33));
    if clock && kind != 3 {
        let clock = Area::centred(dice.between(0.4, width - 0.4), 2.22, 0.3, 0.3);
        canvas.ellipse(clock, [40, 40, 44]);
        canvas.ellipse(clock.inset(0.025), [244, 244, 240]);
        canvas.fill(Area::centred(clock.middle(), clock.bottom + 0.14, 0.02, 0.11), [30, 30, 34]);
        canvas.fill(Area::new(clock.middle(), clock.bottom + 0.14, 0.08, 0.02), [30, 30, 34]);
    }
    if dice.chance(0.5) {
        let switch = Area::new(width - 0.2, 1.12, 0.085, 0.125);
        canvas.border(switch.inset(-0.008), 0.01, [150, 146, 140]);
        canvas.fill(switch, [244, 242, 236]);
    }
    if sign && !clock && kind != 3 {
        let sign = Area::centred(width / 2.0, 2.3, 0.62, 0.2);
        canvas.fill(sign, [44, 78, 142]);
        canvas.text(sign.inset(0.035), dice.pick(&ROOMS), [244, 246, 250]);
    }
}
