//! The corridor: a loop through a building, with doors, boards, ceiling lights and floor tiles.

use super::canvas::{Canvas, Colour, blend, scaled};
use super::figures::{plant, walker};
use super::fittings::{CEILING_METRES, Livery, bay};
use super::noise::{Dice, Grain, fractal_noise, mix, unit};
use super::plan::{Circuit, Edge, Vector};
use super::world::{Billboard, Lamp, Measures, Plane, Surface, Wall, World};

const CORNERS: [(f32, f32); 6] =
    [(0.0, 0.0), (30.0, 0.0), (30.0, 14.0), (16.0, 14.0), (16.0, 26.0), (0.0, 26.0)];
const CORNER_RADIUS_METRES: f32 = 1.2;
const LAMP_SPACING_METRES: f32 = 3.0;
const WALKERS: usize = 12;
const PLANTS: usize = 3;
/// How often the next bay copies one that already exists in the same livery.
const COPY_PROBABILITY: f32 = 0.3;
const PX_PER_METRE: f32 = 44.0;
/// Remainders of a wall shorter than this are no bay of their own.
const SLIVER_METRES: f32 = 0.5;

const MEASURES: Measures =
    Measures { eye_height: 1.35, half_width: 1.35, place: 3.0, speed: 1.3, walkway: (0.6, 0.95) };

struct Builder {
    seed: u32,
    dice: Dice,
    grain: Grain,
    surfaces: Vec<Surface>,
    walls: Vec<Wall>,
}

/// The corridor of `seed`.
pub(super) fn corridor(seed: u32) -> World {
    let circuit = Circuit::new(&CORNERS.map(|(x, y)| Vector::new(x, y)), CORNER_RADIUS_METRES);
    let (grain, dice) = (Grain::new(seed), Dice::new(seed, 71));
    let mut builder = Builder { seed, dice, grain, surfaces: Vec::new(), walls: Vec::new() };
    for i in 0..circuit.edge_count() {
        let (livery, first) = (Livery::draw(&mut builder.dice), builder.surfaces.len());
        builder.row_of_bays(circuit.offset_edge(i, MEASURES.half_width), &livery, first);
        let right = circuit.offset_edge(i, -MEASURES.half_width);
        let end = right.start + right.along * right.length;
        builder.row_of_bays(Edge { start: end, along: right.along * -1.0, ..right }, &livery, first);
    }
    let mut sprites: Vec<_> = (0..PLANTS).map(|i| plant(mix(seed, 700 + i as u32))).collect();
    sprites.extend((0..WALKERS).map(|i| walker(mix(seed, 800 + i as u32))));
    let lamps = lamps(&circuit);
    World {
        measures: MEASURES,
        surfaces: builder.surfaces,
        walls: builder.walls,
        ground: floor(&circuit, seed, &builder.grain),
        ceiling: Some(ceiling(&circuit, &lamps, seed)),
        sprites,
        walkers: PLANTS..PLANTS + WALKERS,
        billboards: plants(&circuit, &mut builder.dice),
        lamps,
        circuit,
    }
}

impl Builder {
    /// Fills `edge` with bays; the last one is cut, or goes on, to where the wall ends.
    fn row_of_bays(&mut self, edge: Edge, livery: &Livery, first: usize) {
        let mut done = 0.0;
        while done < edge.length {
            let surface = self.next_bay(livery, first);
            let (width, rest) = (self.surfaces[surface].width_metres(), edge.length - done);
            // A sliver at the end joins the bay before it, whose surface repeats.
            let width = if rest - width < SLIVER_METRES { rest } else { width };
            let start = edge.start + edge.along * done;
            self.walls.push(Wall::between(start, start + edge.along * width, surface));
            done += width;
        }
    }

    /// A bay of this stretch, whose surfaces start at index `first`.
    fn next_bay(&mut self, livery: &Livery, first: usize) -> usize {
        let known = self.surfaces.len() - first;
        if known > 2 && self.dice.chance(COPY_PROBABILITY) {
            return first + self.dice.below(known);
        }
        let design = mix(self.seed, self.surfaces.len() as u32);
        self.surfaces.push(bay(design, livery, &self.grain));
        self.surfaces.len() - 1
    }
}

/// Lamps in the middle of the ceiling.
fn lamps(circuit: &Circuit) -> Vec<Lamp> {
    let edges = (0..circuit.edge_count()).map(|i| circuit.edge(i));
    edges
        .flat_map(|edge| {
            let count = (edge.length / LAMP_SPACING_METRES).round();
            (0..count as usize).map(move |slot| {
                let along = (slot as f32 + 0.5) * edge.length / count;
                Lamp { at: edge.start + edge.along * along, height: CEILING_METRES }
            })
        })
        .collect()
}

fn plants(circuit: &Circuit, dice: &mut Dice) -> Vec<Billboard> {
    let mut plants = Vec::new();
    for i in 0..circuit.edge_count() {
        let edge = circuit.edge(i);
        for side in [-1.0, 1.0] {
            let along = dice.between(1.8, edge.length - 1.8);
            let at =
                edge.start + edge.along * along + edge.along.left() * (side * (MEASURES.half_width - 0.3));
            plants.push(Billboard { at, sprite: dice.below(PLANTS) });
        }
    }
    plants
}

/// Paints a level plane over the corridor; `colour` gets the point, its edge and its distance from the middle.
fn plane(circuit: &Circuit, height: f32, colour: impl Fn(Vector, usize, f32) -> (Colour, u8)) -> Plane {
    let (origin, corner) = circuit.bounds(MEASURES.half_width + 0.2);
    let extent = corner - origin;
    let mut canvas = Canvas::wall((extent.x, extent.y), PX_PER_METRE, [40, 40, 40]);
    canvas.edit(canvas.area(), |x, y, texel| {
        let point = origin + Vector::new(x, y);
        let (edge, _, across) = circuit.nearest_edge(point);
        if across < MEASURES.half_width + 0.1 {
            let ([r, g, b], glow) = colour(point, edge, across);
            *texel = [r, g, b, glow];
        }
    });
    Plane { texture: canvas.into(), origin, height }
}

/// Floor tiles: chequered, with a border along the walls; every stretch has its own colours.
fn floor(circuit: &Circuit, seed: u32, grain: &Grain) -> Plane {
    const PAIRS: [[Colour; 2]; 4] = [
        [[186, 176, 156], [132, 122, 108]],
        [[172, 178, 178], [108, 120, 126]],
        [[188, 160, 124], [148, 96, 76]],
        [[180, 184, 164], [104, 122, 104]],
    ];
    plane(circuit, 0.0, |point, edge, across| {
        let (column, row) = ((point.x / 0.45).floor(), (point.y / 0.45).floor());
        let joint = point.x / 0.45 - column < 0.06 || point.y / 0.45 - row < 0.06;
        let tile = mix(mix(seed, column as i32 as u32), row as i32 as u32);
        let pair = PAIRS[(edge + seed as usize) % PAIRS.len()];
        let odd = (column as i32 + row as i32).rem_euclid(2) as usize;
        let colour = if across > MEASURES.half_width - 0.18 { scaled(pair[1], 0.6) } else { pair[odd] };
        let marble = fractal_noise(seed ^ tile & 0xFF, point.x * 3.0, point.y * 3.0, 3);
        let speck = grain.at((point.x * 44.0) as usize + 4096, (point.y * 44.0) as usize + 4096);
        let tone = if joint { 0.62 } else { 0.8 + 0.12 * unit(tile) + 0.24 * marble } + 0.06 * speck;
        (scaled(colour, tone), 0)
    })
}

/// Ceiling panels with light fittings; every third fitting has an emergency tube that glows more.
fn ceiling(circuit: &Circuit, lamps: &[Lamp], seed: u32) -> Plane {
    plane(circuit, CEILING_METRES, |point, edge, across| {
        let along = circuit.edge(edge).along;
        for (i, lamp) in lamps.iter().enumerate() {
            let offset = point - lamp.at;
            let (forward, side) = (offset.dot(along).abs(), offset.cross(along).abs());
            if forward < 0.62 && side < 0.32 {
                let tube = (side - 0.13).abs() < 0.09 && forward < 0.56;
                let glow = if i % 3 == 0 { 255 } else { 180 };
                return if tube { ([255, 252, 240], glow) } else { ([226, 226, 222], glow / 3) };
            }
        }
        let (column, row) = ((point.x / 0.6).floor(), (point.y / 0.6).floor());
        let joint = point.x / 0.6 - column < 0.05 || point.y / 0.6 - row < 0.05;
        let tile = unit(mix(mix(seed ^ 13, column as i32 as u32), row as i32 as u32));
        let hole = unit(mix(mix(seed, (point.x * 44.0) as i32 as u32), (point.y * 44.0) as i32 as u32)) < 0.1;
        let edge_shade = 1.0 - 0.12 * (across / MEASURES.half_width);
        let tone = if joint { 0.66 } else { 0.94 + 0.08 * tile } * edge_shade;
        let base: Colour = [226, 224, 216];
        (scaled(if hole { blend(base, [120, 118, 112], 0.45) } else { base }, tone), 0)
    })
}
