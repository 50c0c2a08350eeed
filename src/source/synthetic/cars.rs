//! Parked cars, each put together from six upright cards: two flanks, bonnet and boot, two screens.

use super::canvas::{Area, Canvas, Colour, scaled};
use super::noise::Dice;
use super::plan::Vector;
use super::world::{Surface, Wall};

const LENGTH_METRES: f32 = 4.2;
const WIDTH_METRES: f32 = 1.7;
const PX_PER_METRE: f32 = 56.0;
const PAINTS: [Colour; 8] = [
    [158, 40, 42],
    [44, 76, 124],
    [206, 204, 198],
    [56, 60, 64],
    [92, 120, 96],
    [214, 176, 70],
    [128, 132, 138],
    [112, 150, 160],
];

/// Height of the body at `x` metres from the rear bumper.
fn body_height(x: f32) -> f32 {
    let outline = [
        (0.0, 0.78),
        (0.12, 0.92),
        (0.5, 1.02),
        (1.0, 1.4),
        (2.3, 1.42),
        (3.05, 0.98),
        (4.0, 0.84),
        (4.2, 0.6),
    ];
    let after = outline.iter().position(|point| point.0 > x).unwrap_or(outline.len() - 1).max(1);
    let ((left, low), (right, high)) = (outline[after - 1], outline[after]);
    low + (high - low) * ((x - left) / (right - left)).clamp(0.0, 1.0)
}

/// The four surfaces of car `model`: left flank, right flank, bonnet or boot, screen.
pub(super) fn car_surfaces(model: usize, dice: &mut Dice) -> [Surface; 4] {
    let paint = PAINTS[model % PAINTS.len()];
    [flank(paint, true), flank(paint, false), end(paint, dice), screen(paint)]
}

fn flank(paint: Colour, mirrored: bool) -> Surface {
    let mut canvas = Canvas::wall((LENGTH_METRES, 1.5), PX_PER_METRE, paint);
    let from_rear = |x: f32| if mirrored { LENGTH_METRES - x } else { x };
    canvas.edit(canvas.area(), |x, z, texel| {
        let (x, roof) = (from_rear(x), body_height(from_rear(x)));
        let wheel = [0.8, 3.35].map(|middle: f32| (x - middle).hypot(z - 0.3));
        let nearest = wheel[0].min(wheel[1]);
        let in_glass = z > 0.86 && z < roof - 0.1 && (0.75..3.0).contains(&x) && !(1.82..1.9).contains(&x);
        let [r, g, b] = match () {
            () if nearest < 0.16 => [150, 152, 154],
            () if nearest < 0.31 => [26, 26, 28],
            () if nearest < 0.36 || z < 0.2 => [14, 14, 15],
            () if in_glass => scaled([66, 84, 100], 0.6 + 0.9 * (z - 0.86)),
            () if (0.8..0.83).contains(&z) || (1.83..1.86).contains(&x) && z < 0.8 => scaled(paint, 0.55),
            () if (0.5..0.54).contains(&z) => [60, 60, 62],
            () if x < 0.14 && (0.6..0.76).contains(&z) => [170, 30, 30],
            () if x > 4.02 && (0.56..0.7).contains(&z) => [236, 236, 220],
            () => scaled(paint, 0.7 + 0.38 * z),
        };
        *texel = [r, g, b, 0];
    });
    let columns = canvas.width_px();
    let skyline =
        (0..columns).map(|column| body_height(from_rear((column as f32 + 0.5) / PX_PER_METRE))).collect();
    Surface::new(canvas, skyline)
}

fn end(paint: Colour, dice: &mut Dice) -> Surface {
    let mut canvas = Canvas::wall((WIDTH_METRES, 0.92), PX_PER_METRE, paint);
    let whole = canvas.area();
    canvas.gradient(whole, scaled(paint, 0.6), scaled(paint, 1.08));
    canvas.fill(Area { top: 0.2, ..whole }, [14, 14, 15]);
    canvas.fill(Area::new(0.0, 0.3, WIDTH_METRES, 0.16), [54, 54, 58]);
    for left in [0.08, WIDTH_METRES - 0.42] {
        canvas.fill(Area::new(left, 0.56, 0.34, 0.17), [176, 34, 32]);
        canvas.fill(Area::new(left + 0.1, 0.56, 0.12, 0.17), [232, 180, 150]);
    }
    let plate = Area::centred(WIDTH_METRES / 2.0, 0.5, 0.52, 0.13);
    canvas.fill(plate, [236, 214, 120]);
    let number = format!("{}{} {}", letter(dice), letter(dice), 100 + dice.below(900));
    canvas.text(plate.inset(0.015), &number, [30, 30, 32]);
    canvas.fill(Area::new(0.0, 0.85, WIDTH_METRES, 0.02), scaled(paint, 0.5));
    Surface::level(canvas)
}

fn letter(dice: &mut Dice) -> char {
    char::from(b'A' + dice.below(26) as u8)
}

fn screen(paint: Colour) -> Surface {
    let mut canvas = Canvas::wall((WIDTH_METRES - 0.16, 1.4), PX_PER_METRE, scaled(paint, 0.9));
    let glass = Area::new(0.1, 0.9, WIDTH_METRES - 0.36, 0.4);
    canvas.gradient(glass, [38, 46, 54], [120, 142, 160]);
    canvas.border(glass, 0.04, [24, 24, 26]);
    canvas.fill(Area::new(0.35, 0.9, 0.3, 0.28), [30, 32, 36]);
    canvas.fill(Area::new(0.9, 0.9, 0.3, 0.28), [30, 32, 36]);
    Surface::level(canvas)
}

/// The walls of a car whose surfaces start at index `first`, its middle at `middle`, nose along `heading`.
pub(super) fn car_walls(first: usize, middle: Vector, heading: Vector) -> [Wall; 6] {
    let at =
        |forward: f32, left: f32| middle + heading * (forward - LENGTH_METRES / 2.0) + heading.left() * left;
    let half = WIDTH_METRES / 2.0;
    let (rear, nose, inner) = (0.02, LENGTH_METRES - 0.02, half - 0.08);
    [
        Wall::between(at(LENGTH_METRES, half), at(0.0, half), first),
        Wall::between(at(0.0, -half), at(LENGTH_METRES, -half), first + 1),
        Wall::between(at(rear, half), at(rear, -half), first + 2),
        Wall::between(at(nose, -half), at(nose, half), first + 2),
        Wall::between(at(0.95, inner), at(0.95, -inner), first + 3),
        Wall::between(at(2.6, -inner), at(2.6, inner), first + 3),
    ]
}
