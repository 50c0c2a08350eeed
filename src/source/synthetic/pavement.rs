//! The ground of the street: roadway, kerb and pavement, seen from above.

use super::canvas::{Canvas, Colour, scaled};
use super::noise::{Dice, Grain, fractal_noise, mix, unit};
use super::plan::{Circuit, Vector};
use super::world::Plane;

/// From the middle of the road to the kerb, in metres.
pub(super) const KERB_METRES: f32 = 3.6;
const PX_PER_METRE: f32 = 22.0;

/// What the roadway along one edge of the circuit is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Roadway {
    Asphalt,
    Cobbles,
    Clinker,
}

/// A point of the ground in the coordinates of its street.
#[derive(Clone, Copy)]
struct Spot {
    /// Metres along the edge.
    along: f32,
    /// Metres from its middle line.
    across: f32,
    /// Metres to the nearer end of the edge.
    to_corner: f32,
}

struct Painter<'a> {
    seed: u32,
    grain: &'a Grain,
    roadways: Vec<Roadway>,
    manholes: Vec<Vector>,
}

/// The ground around `circuit`, up to `half_width` metres from it.
pub(super) fn street_ground(circuit: &Circuit, half_width: f32, seed: u32, grain: &Grain) -> Plane {
    let (origin, corner) = circuit.bounds(half_width + 0.5);
    let extent = corner - origin;
    let mut canvas = Canvas::wall((extent.x, extent.y), PX_PER_METRE, [60, 60, 58]);
    let painter = Painter::new(circuit, seed, grain);
    canvas.edit(canvas.area(), |x, y, texel| {
        let point = origin + Vector::new(x, y);
        let (edge, along, across) = circuit.nearest_edge(point);
        if across > half_width + 0.3 {
            return;
        }
        let length = circuit.edge(edge).length;
        let spot = Spot { along, across, to_corner: along.min(length - along) };
        let [r, g, b] = painter.colour(point, spot, edge);
        *texel = [r, g, b, 0];
    });
    Plane { texture: canvas.into(), origin, height: 0.0 }
}

impl<'a> Painter<'a> {
    fn new(circuit: &Circuit, seed: u32, grain: &'a Grain) -> Self {
        let mut dice = Dice::new(seed, 31);
        let kinds = [Roadway::Asphalt, Roadway::Cobbles, Roadway::Asphalt, Roadway::Clinker];
        let roadways = (0..circuit.edge_count()).map(|i| kinds[(i + seed as usize) % kinds.len()]).collect();
        let manholes = (0..24)
            .map(|_| {
                let way = circuit.at(dice.between(0.0, circuit.length()));
                way.position + Vector::from_heading(way.heading_radians).left() * dice.between(-2.2, 2.2)
            })
            .collect();
        Self { seed, grain, roadways, manholes }
    }

    fn colour(&self, point: Vector, spot: Spot, edge: usize) -> Colour {
        let grain = self.grain.at((point.x * 22.0) as usize + 4096, (point.y * 22.0) as usize + 4096);
        let colour = if spot.across > KERB_METRES + 0.22 {
            self.pavement(point, spot)
        } else if spot.across > KERB_METRES {
            let gap = (spot.along / 0.9).fract() < 0.05 || spot.across < KERB_METRES + 0.05;
            if gap { [96, 94, 90] } else { [176, 174, 168] }
        } else {
            self.road(point, spot, edge)
        };
        scaled(colour, 1.0 + 0.14 * grain)
    }

    fn pavement(&self, point: Vector, spot: Spot) -> Colour {
        let (column, row) = ((point.x / 0.6).floor(), (point.y / 0.6).floor());
        let joint = point.x / 0.6 - column < 0.08 || point.y / 0.6 - row < 0.08;
        let tone = unit(mix(mix(self.seed, column as i32 as u32), row as i32 as u32));
        let dirt = fractal_noise(self.seed ^ 5, point.x * 0.8, point.y * 0.8, 3);
        let wall_shade = 0.75 + 0.25 * ((6.2 - spot.across) / 0.6).clamp(0.0, 1.0);
        let tone = if joint { 0.66 } else { 0.84 + 0.26 * tone } * (0.86 + 0.28 * dirt) * wall_shade;
        scaled([164, 158, 150], tone)
    }

    fn road(&self, point: Vector, spot: Spot, edge: usize) -> Colour {
        for manhole in &self.manholes {
            let distance = (point - *manhole).length();
            if distance < 0.42 {
                let ribs = (point.x / 0.11).floor() + (point.y / 0.11).floor();
                return if distance > 0.36 {
                    [58, 56, 54]
                } else {
                    scaled([96, 92, 88], 0.7 + 0.4 * (ribs as i32 & 1) as f32)
                };
            }
        }
        let gutter = 0.72 + 0.28 * ((KERB_METRES - spot.across) / 0.4).clamp(0.0, 1.0);
        let dirt = 0.84 + 0.32 * fractal_noise(self.seed ^ 9, point.x * 0.45, point.y * 0.45, 4);
        if let Some(paint) = self.marking(spot, edge) {
            return scaled(paint, dirt);
        }
        let colour = match self.roadways[edge] {
            Roadway::Asphalt => self.asphalt(point),
            Roadway::Cobbles => self.setts(spot, (0.24, 0.24), [128, 122, 116]),
            Roadway::Clinker => self.setts(spot, (0.3, 0.16), [142, 92, 76]),
        };
        scaled(colour, gutter * dirt)
    }

    /// Zebra crossings in the middle and stop lines at the ends of asphalt streets.
    fn marking(&self, spot: Spot, edge: usize) -> Option<Colour> {
        const WHITE: Colour = [214, 212, 204];
        let zebra = (spot.to_corner - 9.0).abs() < 1.5 && spot.across < KERB_METRES - 0.3;
        if zebra && (spot.across / 0.5 + 0.5).fract() < 0.5 {
            return Some(WHITE);
        }
        let asphalt = self.roadways[edge] == Roadway::Asphalt;
        let dash =
            asphalt && spot.to_corner > 11.5 && spot.across < 0.07 && (spot.along / 3.0).fract() < 0.55;
        dash.then_some(WHITE)
    }

    fn asphalt(&self, point: Vector) -> Colour {
        let (column, row) = ((point.x / 5.0).floor(), (point.y / 7.0).floor());
        let patch = unit(mix(mix(self.seed ^ 77, column as i32 as u32), row as i32 as u32));
        let crack = (fractal_noise(self.seed ^ 3, point.x * 0.7, point.y * 0.7, 4) - 0.5).abs() < 0.004
            && patch > 0.5;
        let tone = if patch < 0.18 { 0.76 } else { 1.0 } * if crack { 0.6 } else { 1.0 };
        scaled([106, 106, 110], tone)
    }

    /// Stones of `size` metres in running bond across the street.
    fn setts(&self, spot: Spot, size: (f32, f32), colour: Colour) -> Colour {
        let row = (spot.along / size.1).floor();
        let across = spot.across / size.0 + 0.5 * row.rem_euclid(2.0);
        let joint = spot.along / size.1 - row < 0.22 || across.fract() < 0.18;
        let tone = unit(mix(mix(self.seed ^ 21, row as i32 as u32), across as u32));
        scaled(colour, if joint { 0.58 } else { 0.8 + 0.4 * tone })
    }
}
