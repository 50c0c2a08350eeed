//! House fronts: what stands on one lot of the street, from the plinth to the gable.
//!
//! A front is a pure function of its design number, so two lots with the same design look the same to
//! the last texel: the perceptual aliasing that place recognition has to live with.

use super::canvas::{Area, Canvas, Colour, scaled};
use super::masonry::{ivy, moulding, paint_wall, roof_tiles};
use super::noise::{Dice, Grain};
use super::openings::{WindowStyle, door, shop_front, window};
use super::world::Surface;

/// Texels per metre of every outdoor wall.
pub(super) const FACADE_PX_PER_METRE: f32 = 36.0;

const TRIMS: [Colour; 5] =
    [[238, 234, 224], [210, 192, 158], [184, 178, 168], [222, 206, 176], [150, 142, 134]];
const POSTERS: [&str; 8] = ["JAZZ", "VOTE", "CIRCUS", "SALE", "OPERA", "EXPO", "RADIO 7", "CINEMA"];

/// How a front ends towards the sky.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Gable {
    /// A level cornice with a parapet.
    Flat,
    /// A tiled roof with its long side to the street.
    Roof,
    /// Steps up to the middle.
    Stepped,
    /// A plain triangle.
    Triangle,
    /// A rounded bell.
    Bell,
}

impl Gable {
    /// Height above the eaves as a fraction, at `x` in [0, 1] across the front.
    fn rise(self, x: f32) -> f32 {
        let tent = 1.0 - (2.0 * x - 1.0).abs();
        match self {
            Self::Flat => 1.0,
            Self::Roof => (tent * 9.0).min(1.0),
            Self::Stepped => ((tent * 5.0).floor() / 4.0).min(1.0),
            Self::Triangle => tent,
            Self::Bell => {
                if tent < 0.3 {
                    0.35 * (tent / 0.3 * std::f32::consts::FRAC_PI_2).sin()
                } else {
                    0.35 + 0.65 * ((tent - 0.3) / 0.7 * std::f32::consts::FRAC_PI_2).sin()
                }
            }
        }
    }
}

/// The measures of a house in metres.
struct House {
    width: f32,
    ground_floor: f32,
    storey: f32,
    storeys: usize,
    eaves: f32,
    gable: Gable,
    rise: f32,
    trim: Colour,
}

impl House {
    fn draw(dice: &mut Dice) -> Self {
        let gable =
            dice.pick(&[Gable::Flat, Gable::Roof, Gable::Roof, Gable::Stepped, Gable::Triangle, Gable::Bell]);
        let (low, high) = match gable {
            Gable::Flat => (0.5, 0.9),
            Gable::Roof => (1.8, 2.6),
            _ => (2.4, 3.4),
        };
        let (ground_floor, storey, storeys) =
            (dice.between(3.3, 3.9), dice.between(2.7, 3.1), dice.pick(&[1, 1, 2, 2, 2, 3]));
        let eaves = ground_floor + storey * storeys as f32 + 0.35;
        let width = dice.between(5.4, 9.2);
        Self {
            width,
            ground_floor,
            storey,
            storeys,
            eaves,
            gable,
            rise: dice.between(low, high),
            trim: dice.pick(&TRIMS),
        }
    }
}

/// The house front with number `design`.
pub(super) fn house_front(design: u32, grain: &Grain) -> Surface {
    let mut dice = Dice::new(design, 11);
    let house = House::draw(&mut dice);
    let size = (house.width, house.eaves + house.rise + 0.9);
    let mut canvas = Canvas::wall(size, FACADE_PX_PER_METRE, [128, 128, 128]);
    let whole = canvas.area();
    let colour = paint_wall(&mut canvas, whole, &mut dice, grain);
    corner_stones(&mut canvas, &house, colour, &mut dice);
    upper_storeys(&mut canvas, &house, &mut dice);
    ground_floor(&mut canvas, &house, &mut dice);
    if house.gable == Gable::Roof {
        tiled_roof(&mut canvas, &house, &mut dice);
    }
    moulding(&mut canvas, Area::new(0.0, house.eaves - 0.3, house.width, 0.3), house.trim);
    down_pipe(&mut canvas, &house, &mut dice);
    if dice.chance(0.14) {
        ivy(&mut canvas, dice.between(0.5, house.width - 0.5), dice.between(3.0, house.eaves), dice.bits());
    }
    let skyline = skyline(&canvas, &house, &mut dice);
    coping(&mut canvas, &house, &skyline);
    Surface::new(canvas, skyline)
}

/// Height of the front at every texel column, chimneys included.
fn skyline(canvas: &Canvas, house: &House, dice: &mut Dice) -> Vec<f32> {
    let chimney = (house.gable == Gable::Roof).then(|| dice.between(0.1, 0.8));
    let columns = canvas.width_px();
    (0..columns)
        .map(|column| {
            let x = (column as f32 + 0.5) / columns as f32;
            let on_chimney = chimney.is_some_and(|left| (left..left + 0.9 / house.width).contains(&x));
            house.eaves + house.rise * house.gable.rise(x) + if on_chimney { 0.85 } else { 0.0 }
        })
        .collect()
}

/// A light rim of cut stone along the top of a gable.
fn coping(canvas: &mut Canvas, house: &House, skyline: &[f32]) {
    if house.gable == Gable::Roof {
        return;
    }
    let step = 1.0 / canvas.px_per_metre();
    for (column, &height) in skyline.iter().enumerate() {
        let strip = Area::new(column as f32 * step, height - 0.22, step, 0.22);
        canvas.gradient(strip, scaled(house.trim, 0.7), house.trim);
        canvas.shade(Area { bottom: strip.bottom - 0.1, top: strip.bottom, ..strip }, 0.6);
    }
}

/// Plinth, quoins at both corners and a course between the storeys.
fn corner_stones(canvas: &mut Canvas, house: &House, colour: Colour, dice: &mut Dice) {
    if dice.chance(0.5) {
        let mut z = 0.0;
        let mut long = false;
        while z < house.eaves {
            let width = if long { 0.62 } else { 0.4 };
            for left in [0.0, house.width - width] {
                canvas.fill(Area::new(left, z, width, 0.33), house.trim);
                canvas.shade(Area::new(left, z, width, 0.04), 0.6);
            }
            z += 0.36;
            long = !long;
        }
    }
    canvas.fill(Area::new(0.0, 0.0, house.width, 0.5), scaled(colour, 0.55));
    canvas.shade(Area::new(0.0, 0.46, house.width, 0.04), 0.6);
    if dice.chance(0.6) {
        moulding(canvas, Area::new(0.0, house.ground_floor - 0.02, house.width, 0.16), house.trim);
    }
}

fn upper_storeys(canvas: &mut Canvas, house: &House, dice: &mut Dice) {
    let style = WindowStyle::draw(dice, house.trim);
    let pitch = style.width + if style.shutters.is_some() { 1.25 } else { 0.85 };
    let columns = ((house.width - 0.4) / pitch).floor().max(1.0) as usize;
    let step = house.width / columns as f32;
    let balcony = dice.chance(0.2);
    for storey in 0..house.storeys {
        let sill = house.ground_floor + house.storey * storey as f32 + 0.8;
        for column in 0..columns {
            let middle = (column as f32 + 0.5) * step;
            let height = style.height.min(house.storey - 1.1);
            window(canvas, Area::centred(middle, sill, style.width, height), &style, dice);
        }
        if balcony && storey == 0 {
            railing(canvas, Area::new(0.5, sill - 0.5, house.width - 1.0, 1.0));
        }
    }
    if matches!(house.gable, Gable::Stepped | Gable::Triangle | Gable::Bell) {
        let attic = Area::centred(house.width / 2.0, house.eaves + 0.3, 0.9, 1.1);
        window(canvas, attic, &WindowStyle { shutters: None, flowers: false, panes: (2, 2), ..style }, dice);
    }
}

fn railing(canvas: &mut Canvas, area: Area) {
    canvas.shade(Area { bottom: area.bottom - 0.5, top: area.bottom, ..area }, 0.6);
    canvas.fill(Area { top: area.bottom + 0.16, ..area }, [172, 164, 152]);
    canvas.edit(area, |x, z, texel| {
        if (x / 0.14).fract() < 0.28 || area.top - z < 0.07 {
            *texel = [34, 34, 38, 0];
        }
    });
}

fn ground_floor(canvas: &mut Canvas, house: &House, dice: &mut Dice) {
    if dice.chance(0.5) {
        let margin = dice.between(0.25, 0.5);
        let front = Area::new(margin, 0.0, house.width - 2.0 * margin, house.ground_floor - 0.15);
        shop_front(canvas, front, dice);
        return;
    }
    let style = WindowStyle { flowers: false, ..WindowStyle::draw(dice, house.trim) };
    let door_at = dice.pick(&[0.18, 0.5, 0.82]) * house.width;
    let slots = (house.width / 2.3).floor().max(2.0);
    for slot in 0..slots as usize {
        let middle = (slot as f32 + 0.5) * house.width / slots;
        if (middle - door_at).abs() > 1.5 {
            let area = Area::centred(middle, 1.05, style.width, style.height);
            window(canvas, area, &WindowStyle { shutters: None, ..style }, dice);
        }
    }
    let door_at = door_at.clamp(0.9, house.width - 1.2);
    door(
        canvas,
        Area::centred(door_at, 0.12, dice.between(1.0, 1.3), dice.between(2.3, 2.7)),
        house.trim,
        dice,
    );
    if dice.chance(0.35) {
        poster(
            canvas,
            Area::new(dice.between(0.2, house.width - 1.0), dice.between(0.9, 1.2), 0.7, 1.0),
            dice,
        );
    }
}

/// A bill with a word, a picture and a rim of old glue.
pub(super) fn poster(canvas: &mut Canvas, area: Area, dice: &mut Dice) {
    let papers: [Colour; 6] =
        [[226, 196, 72], [206, 78, 60], [70, 120, 168], [236, 230, 214], [84, 148, 104], [40, 40, 52]];
    let paper = dice.pick(&papers);
    let ink = if paper[0] > 150 { [36, 34, 44] } else { [244, 236, 214] };
    canvas.shade(Area { left: area.left + 0.03, bottom: area.bottom - 0.03, ..area }, 0.7);
    canvas.fill(area, paper);
    canvas.text(area.part((0.08, 0.92), (0.74, 0.95)), dice.pick(&POSTERS), ink);
    let picture = area.part((0.1, 0.9), (0.22, 0.7));
    canvas.fill(picture, dice.pick(&papers));
    for _ in 0..4 {
        let (x, z, size) = (dice.between(0.0, 0.6), dice.between(0.0, 0.6), dice.between(0.2, 0.5));
        let shape = picture.part((x, (x + size).min(1.0)), (z, (z + size).min(1.0)));
        let colour = dice.pick(&papers);
        if dice.chance(0.5) { canvas.ellipse(shape, colour) } else { canvas.fill(shape, colour) }
    }
    for line in [0.05, 0.12] {
        let end = dice.between(0.5, 0.92);
        canvas.fill(area.part((0.08, end), (line, line + 0.035)), ink);
    }
}

/// Tiles above the eaves, with dormers.
fn tiled_roof(canvas: &mut Canvas, house: &House, dice: &mut Dice) {
    let roof = Area::new(0.0, house.eaves, house.width, house.rise + 0.9);
    roof_tiles(canvas, roof, dice);
    canvas
        .shade(Area { bottom: house.eaves + house.rise - 0.12, top: house.eaves + house.rise, ..roof }, 0.7);
    let chimney = Area { bottom: house.eaves + house.rise, ..roof };
    canvas.fill(chimney, [134, 82, 66]);
    canvas.fill(Area { bottom: chimney.top - 0.2, ..chimney }, [90, 62, 54]);
    let style =
        WindowStyle { shutters: None, flowers: false, panes: (2, 2), ..WindowStyle::draw(dice, house.trim) };
    let dormers = dice.below(4);
    for dormer in 0..dormers {
        let middle = (dormer as f32 + 0.5) * house.width / dormers as f32;
        let area = Area::centred(middle, house.eaves + 0.35, 0.9, 1.0);
        canvas.fill(
            Area { left: area.left - 0.25, right: area.right + 0.25, top: area.top + 0.3, ..area },
            house.trim,
        );
        window(canvas, area, &style, dice);
    }
}

fn down_pipe(canvas: &mut Canvas, house: &House, dice: &mut Dice) {
    let left = if dice.chance(0.5) { 0.08 } else { house.width - 0.24 };
    let pipe = Area::new(left, 0.1, 0.14, house.eaves - 0.3);
    let colour = dice.pick(&[[86, 92, 88], [70, 70, 74], [122, 104, 86]]);
    canvas.shade(Area { left: pipe.left + 0.1, right: pipe.right + 0.1, ..pipe }, 0.6);
    canvas.fill(pipe, colour);
    canvas.fill(Area { right: pipe.left + 0.05, ..pipe }, scaled(colour, 1.4));
    for bracket in 0..4 {
        let z = 0.6 + bracket as f32 * house.eaves / 4.5;
        canvas.fill(Area::new(left - 0.04, z, 0.22, 0.07), scaled(colour, 0.6));
    }
}
