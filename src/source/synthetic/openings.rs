//! Windows, doors and shop fronts.

use super::canvas::{Area, Canvas, Colour, blend, scaled};
use super::masonry::moulding;
use super::noise::{Dice, mix, unit};

/// Colours of woodwork.
pub(super) const WOOD: [Colour; 8] = [
    [38, 68, 56],
    [36, 54, 88],
    [110, 36, 38],
    [40, 40, 44],
    [122, 84, 50],
    [70, 104, 116],
    [150, 120, 60],
    [92, 52, 84],
];
const SHOPS: [&str; 24] = [
    "CAFE",
    "BOOKS",
    "BAKERY",
    "FLOWERS",
    "OPTIK",
    "CHEESE",
    "WINE",
    "HATS",
    "RADIO",
    "TEA HOUSE",
    "BIKES",
    "PAPER",
    "TAILOR",
    "MUSIC",
    "SHOES",
    "HOTEL",
    "FISH",
    "TOYS",
    "CLOCKS",
    "PIZZA",
    "GALLERY",
    "BANK",
    "SOAP",
    "PHARMACY",
];
const GOODS: [Colour; 8] = [
    [206, 72, 58],
    [230, 186, 70],
    [86, 140, 88],
    [72, 106, 170],
    [228, 224, 210],
    [196, 126, 70],
    [160, 84, 140],
    [90, 176, 180],
];

/// How all windows of one house look.
#[derive(Clone, Copy, Debug)]
pub(super) struct WindowStyle {
    pub(super) width: f32,
    pub(super) height: f32,
    pub(super) frame: Colour,
    pub(super) trim: Colour,
    pub(super) shutters: Option<Colour>,
    pub(super) panes: (usize, usize),
    pub(super) flowers: bool,
}

impl WindowStyle {
    /// A style for a house with the given trim.
    pub(super) fn draw(dice: &mut Dice, trim: Colour) -> Self {
        Self {
            width: dice.between(0.95, 1.35),
            height: dice.between(1.45, 1.9),
            frame: if dice.chance(0.7) { [236, 234, 226] } else { dice.pick(&WOOD) },
            trim,
            shutters: dice.chance(0.35).then(|| dice.pick(&WOOD)),
            panes: dice.pick(&[(2, 2), (2, 3), (3, 4), (2, 1), (1, 2)]),
            flowers: dice.chance(0.3),
        }
    }
}

/// A window whose sill lies at the bottom of `area`.
pub(super) fn window(canvas: &mut Canvas, area: Area, style: &WindowStyle, dice: &mut Dice) {
    moulding(canvas, Area::centred(area.middle(), area.top + 0.02, area.width() + 0.34, 0.2), style.trim);
    canvas.border(
        Area { left: area.left - 0.1, right: area.right + 0.1, top: area.top + 0.06, ..area },
        0.1,
        style.trim,
    );
    if let Some(colour) = style.shutters {
        let width = area.width() * 0.46;
        for left in [area.left - width - 0.06, area.right + 0.06] {
            shutter(canvas, Area::new(left, area.bottom, width, area.height()), colour);
        }
    }
    glass(canvas, area, dice);
    canvas.shade(Area { bottom: area.top - 0.14, ..area }, 0.45);
    canvas.shade(Area { right: area.left + 0.09, ..area }, 0.55);
    panes(canvas, area, style.panes, style.frame);
    moulding(canvas, Area::centred(area.middle(), area.bottom - 0.12, area.width() + 0.3, 0.12), style.trim);
    if style.flowers {
        flower_box(canvas, Area::centred(area.middle(), area.bottom - 0.04, area.width(), 0.34), dice);
    }
}

fn shutter(canvas: &mut Canvas, area: Area, colour: Colour) {
    canvas.shade(Area { left: area.left + 0.05, bottom: area.bottom - 0.05, ..area }, 0.7);
    canvas.edit(area, |_, z, texel| {
        let [r, g, b] = scaled(colour, if (z / 0.13).fract() < 0.3 { 0.62 } else { 1.1 });
        *texel = [r, g, b, 0];
    });
    canvas.border(area, 0.06, scaled(colour, 1.2));
}

/// Dark glass with the sky in it; behind some of it somebody has put on a light.
fn glass(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    let glow = if dice.chance(0.5) { 90 + dice.below(160) as u8 } else { 0 };
    let (low, high) =
        (scaled([44, 54, 64], dice.between(0.7, 1.2)), scaled([132, 158, 182], dice.between(0.6, 1.1)));
    let tilt = dice.between(0.2, 0.6);
    canvas.edit(area, |x, z, texel| {
        let (right, up) = ((x - area.left) / area.width(), (z - area.bottom) / area.height());
        let sky = if up + tilt * right > 0.85 { 1.0 } else { 0.25 * up };
        let [r, g, b] = blend(low, high, sky);
        *texel = [r, g, b, (f32::from(glow) * (0.75 + 0.25 * up)) as u8];
    });
    if dice.chance(0.55) {
        let drawn = dice.between(0.16, 0.34);
        let colour = dice.pick(&[[222, 214, 198], [196, 164, 132], [168, 92, 84], [150, 170, 180]]);
        for part in [(0.0, drawn), (1.0 - drawn, 1.0)] {
            canvas.edit(area.part(part, (0.0, 1.0)), |x, _, texel| {
                let [r, g, b] = scaled(colour, if (x / 0.1).fract() < 0.5 { 0.62 } else { 0.5 });
                *texel = [r, g, b, glow / 2];
            });
        }
    }
}

fn panes(canvas: &mut Canvas, area: Area, (columns, rows): (usize, usize), frame: Colour) {
    for column in 1..columns {
        let x = area.left + area.width() * column as f32 / columns as f32;
        canvas.fill(Area::new(x - 0.03, area.bottom, 0.06, area.height()), frame);
    }
    for row in 1..rows {
        let z = area.bottom + area.height() * row as f32 / rows as f32;
        canvas.fill(Area::new(area.left, z - 0.03, area.width(), 0.06), frame);
    }
    canvas.border(area, 0.08, frame);
}

fn flower_box(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    let seed = dice.bits();
    let colour =
        dice.pick(&[[214, 60, 66], [232, 120, 160], [240, 200, 70], [236, 236, 240], [150, 90, 190]]);
    canvas.edit(area, |x, z, texel| {
        let up = (z - area.bottom) / area.height();
        let leaf = unit(mix(mix(seed, (x * 14.0) as u32), (z * 14.0) as u32));
        if up > 0.5 && leaf < (up - 0.5) * 1.6 {
            return;
        }
        let [r, g, b] = match (up < 0.36, leaf > 0.62) {
            (true, _) => [126, 72, 48],
            (false, true) => colour,
            (false, false) => scaled([62, 104, 48], 0.6 + leaf),
        };
        *texel = [r, g, b, 0];
    });
}

/// A house door with steps, panels, a fanlight and its number.
pub(super) fn door(canvas: &mut Canvas, area: Area, trim: Colour, dice: &mut Dice) {
    let colour = dice.pick(&WOOD);
    canvas
        .fill(Area { left: area.left - 0.16, right: area.right + 0.16, top: area.top + 0.16, ..area }, trim);
    moulding(canvas, Area::centred(area.middle(), area.top + 0.16, area.width() + 0.6, 0.16), trim);
    canvas.gradient(area, scaled(colour, 0.8), scaled(colour, 1.1));
    let fanlight = area.part((0.08, 0.92), (0.82, 0.97));
    canvas.fill_glowing(fanlight, [70, 82, 92], 170);
    panes(canvas, fanlight, (3, 1), trim);
    for rows in [(0.06, 0.3), (0.35, 0.76)] {
        for columns in [(0.1, 0.46), (0.54, 0.9)] {
            let panel = area.part(columns, rows);
            canvas.fill(panel, scaled(colour, 0.62));
            canvas.fill(panel.inset(0.05), scaled(colour, 1.25));
        }
    }
    canvas.ellipse(Area::new(area.right - 0.2, area.bottom + 0.95, 0.12, 0.12), [226, 190, 90]);
    canvas.shade(Area { bottom: area.top - 0.1, ..area }, 0.5);
    canvas.fill(Area::centred(area.middle(), 0.0, area.width() + 0.5, 0.14), [176, 170, 160]);
    canvas.shade(Area::centred(area.middle(), 0.0, area.width() + 0.5, 0.05), 0.6);
    let plate = Area::new(area.right + 0.26, area.bottom + 1.6, 0.42, 0.3);
    canvas.fill(plate, [36, 58, 130]);
    canvas.text(plate.inset(0.04), &format!("{}", 1 + dice.below(98)), [240, 240, 240]);
}

/// A shop front that fills `area`: sign, awning, display window and door.
pub(super) fn shop_front(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    let wood = dice.pick(&WOOD);
    canvas.fill(area, wood);
    let sign = Area { bottom: area.top - 0.72, ..area };
    moulding(canvas, Area { bottom: area.top - 0.1, top: area.top + 0.08, ..area }, scaled(wood, 1.3));
    let (board, ink) = dice.pick(&[
        (wood, [238, 214, 150]),
        ([240, 234, 218], wood),
        ([196, 54, 46], [250, 246, 236]),
        ([34, 34, 38], [236, 200, 96]),
    ]);
    let plate = Area { top: area.top - 0.12, ..sign }.inset(0.04);
    canvas.fill_glowing(plate, board, 60);
    canvas.text(plate.inset(0.09), dice.pick(&SHOPS), ink);
    let door_left = dice.chance(0.5);
    let body = Area { top: sign.bottom - 0.06, bottom: area.bottom + 0.12, ..area };
    let (door_part, shop_part) =
        if door_left { ((0.03, 0.24), (0.28, 0.97)) } else { ((0.76, 0.97), (0.03, 0.72)) };
    display(canvas, Area { bottom: area.bottom + 0.5, ..body.part(shop_part, (0.0, 1.0)) }, dice);
    let door = body.part(door_part, (0.0, 1.0));
    canvas.gradient(door, [52, 60, 66], [110, 130, 146]);
    canvas.fill_glowing(door.inset(0.12), [86, 100, 108], 150);
    canvas.border(door, 0.1, scaled(wood, 1.35));
    canvas.fill(Area { top: door.bottom + 0.7, ..door.inset(0.1) }, scaled(wood, 0.8));
    if dice.chance(0.55) {
        awning(canvas, Area { bottom: sign.bottom - 0.62, top: sign.bottom + 0.02, ..area }, dice);
    }
}

fn display(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    canvas.gradient(area, [40, 46, 52], [96, 112, 126]);
    canvas.edit(area, |_, z, texel| texel[3] = (200.0 - 60.0 * (z - area.bottom)).clamp(60.0, 220.0) as u8);
    for shelf in 0..3 {
        let bottom = area.bottom + 0.08 + shelf as f32 * area.height() / 3.2;
        let mut x = area.left + 0.1;
        while x < area.right - 0.3 {
            let (width, height) = (dice.between(0.12, 0.34), dice.between(0.16, 0.5));
            if dice.chance(0.75) {
                let colour = scaled(dice.pick(&GOODS), dice.between(0.6, 1.0));
                canvas.fill_glowing(Area::new(x, bottom, width, height), colour, 120);
                canvas.fill_glowing(
                    Area::new(x, bottom + height * 0.6, width, 0.06),
                    scaled(colour, 0.5),
                    90,
                );
            }
            x += width + dice.between(0.04, 0.14);
        }
        canvas.fill(Area::new(area.left, bottom - 0.06, area.width(), 0.06), [92, 74, 56]);
    }
    panes(canvas, area, (if area.width() > 3.0 { 3 } else { 2 }, 1), [226, 220, 206]);
}

fn awning(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    let colours = dice.pick(&[
        [[190, 52, 48], [240, 232, 214]],
        [[44, 96, 72], [236, 232, 216]],
        [[46, 76, 136], [238, 236, 228]],
        [[214, 150, 54], [246, 236, 210]],
    ]);
    canvas.shade(Area { bottom: area.bottom - 0.5, top: area.bottom, ..area }, 0.6);
    canvas.edit(area, |x, z, texel| {
        let stripe = (x / 0.32).floor();
        let up = (z - area.bottom) / area.height();
        let scallop = 0.2 * (((x / 0.32).fract() - 0.5) * 2.0).powi(2);
        if up > scallop {
            let [r, g, b] =
                scaled(colours[(stripe % 2.0) as usize], if up < 0.25 { 0.78 } else { 0.85 + 0.2 * up });
            *texel = [r, g, b, 20];
        }
    });
}
