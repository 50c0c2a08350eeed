//! The street: two rows of houses around a block, with trees, lamps and parked cars.

use super::canvas::{Area, Canvas};
use super::cars::{car_surfaces, car_walls};
use super::facade::{FACADE_PX_PER_METRE, house_front, poster};
use super::figures::{street_lamp, tree, walker};
use super::masonry::{bricks, ivy, paint_wall};
use super::noise::{Dice, Grain, mix};
use super::pavement::{KERB_METRES, street_ground};
use super::plan::{Circuit, Edge, Vector};
use super::world::{Billboard, Lamp, Measures, Surface, Wall, World};

const CORNERS: [(f32, f32); 6] =
    [(0.0, 0.0), (66.0, 0.0), (66.0, 30.0), (38.0, 30.0), (38.0, 56.0), (0.0, 56.0)];
const CORNER_RADIUS_METRES: f32 = 5.0;
const LAMP_HEIGHT_METRES: f32 = 4.4;
const HOUSE_DEPTH_METRES: f32 = 7.0;
const WALKERS: usize = 12;
const TREES: usize = 5;
const CARS: usize = 8;
/// How often the next lot copies a house that already stands somewhere.
const COPY_PROBABILITY: f32 = 0.3;

const MEASURES: Measures =
    Measures { eye_height: 1.7, half_width: 6.2, place: 6.0, speed: 4.0, walkway: (4.1, 5.6) };

/// Surfaces that are not house fronts, by index.
const FIREWALL: usize = 0;
const GARDEN_WALL: usize = 1;
const FIRST_CAR: usize = 2;

struct Builder {
    seed: u32,
    dice: Dice,
    grain: Grain,
    surfaces: Vec<Surface>,
    /// Surfaces that are house fronts, one for each house built so far.
    fronts: Vec<usize>,
    walls: Vec<Wall>,
}

/// The street of `seed`.
pub(super) fn street(seed: u32) -> World {
    let circuit = Circuit::new(&CORNERS.map(|(x, y)| Vector::new(x, y)), CORNER_RADIUS_METRES);
    let mut builder = Builder::new(seed);
    for i in 0..circuit.edge_count() {
        let left = circuit.offset_edge(i, MEASURES.half_width);
        builder.row_of_houses(left);
        builder.row_of_houses(turned_round(circuit.offset_edge(i, -MEASURES.half_width)));
    }
    builder.parked_cars(&circuit);
    let (billboards, lamps) = furniture(&circuit, &mut builder.dice);
    let mut sprites = vec![street_lamp(LAMP_HEIGHT_METRES)];
    sprites.extend((0..TREES).map(|i| tree(mix(seed, 700 + i as u32))));
    sprites.extend((0..WALKERS).map(|i| walker(mix(seed, 800 + i as u32))));
    let ground = street_ground(&circuit, MEASURES.half_width, seed, &builder.grain);
    World {
        circuit,
        measures: MEASURES,
        surfaces: builder.surfaces,
        walls: builder.walls,
        ground,
        ceiling: None,
        sprites,
        walkers: 1 + TREES..1 + TREES + WALKERS,
        billboards,
        lamps,
    }
}

/// The edge travelled the other way: whoever looks at a right-hand wall sees it run backwards.
fn turned_round(edge: Edge) -> Edge {
    Edge { start: edge.start + edge.along * edge.length, along: edge.along * -1.0, length: edge.length }
}

impl Builder {
    fn new(seed: u32) -> Self {
        let (grain, mut dice) = (Grain::new(seed), Dice::new(seed, 3));
        let mut surfaces = vec![firewall(seed, &grain), garden_wall(seed, &grain)];
        for model in 0..CARS {
            surfaces.extend(car_surfaces(model, &mut dice));
        }
        Self { seed, dice, grain, surfaces, fronts: Vec::new(), walls: Vec::new() }
    }

    /// Fills `edge` with houses; what is left over becomes garden walls at random lots.
    fn row_of_houses(&mut self, edge: Edge) {
        let mut lots = Vec::new();
        let mut free = edge.length;
        loop {
            let front = self.next_front();
            let width = self.surfaces[front].width_metres();
            if width > free {
                break;
            }
            free -= width;
            lots.push(front);
        }
        let gap_after = self.dice.below(lots.len().max(1));
        let mut at = edge.start;
        for (i, &front) in lots.iter().enumerate() {
            at = self.house(at, edge.along, front);
            if i == gap_after && free > 0.3 {
                let end = at + edge.along * free;
                self.walls.push(Wall::between(at, end, GARDEN_WALL));
                at = end;
            }
        }
    }

    fn next_front(&mut self) -> usize {
        if self.fronts.len() > 3 && self.dice.chance(COPY_PROBABILITY) {
            return self.fronts[self.dice.below(self.fronts.len())];
        }
        let design = mix(self.seed, self.surfaces.len() as u32);
        self.surfaces.push(house_front(design, &self.grain));
        self.fronts.push(self.surfaces.len() - 1);
        self.surfaces.len() - 1
    }

    /// A front with the two firewalls behind it; returns where the next lot starts.
    fn house(&mut self, start: Vector, along: Vector, front: usize) -> Vector {
        let end = start + along * self.surfaces[front].width_metres();
        let back = along.left() * HOUSE_DEPTH_METRES;
        self.walls.push(Wall::between(start, end, front).with_rear(FIREWALL));
        for corner in [start, end] {
            let inwards = if corner == start { along } else { along * -1.0 };
            let (near, eaves) = (corner + inwards * 0.02, self.surfaces[front].height_at(0.03));
            self.walls.push(Wall::between(near, near + back, FIREWALL).lowered_to(eaves));
        }
        end
    }

    fn parked_cars(&mut self, circuit: &Circuit) {
        for i in 0..circuit.edge_count() {
            let edge = circuit.edge(i);
            for side in [-1.0, 1.0] {
                let mut along = 14.0;
                while along < edge.length - 13.0 {
                    if self.dice.chance(0.42) {
                        let car = FIRST_CAR + 4 * self.dice.below(CARS);
                        let across = side * (KERB_METRES - 0.95 + self.dice.between(-0.08, 0.04));
                        let middle = edge.start + edge.along * along + edge.along.left() * across;
                        self.walls.extend(car_walls(car, middle, edge.along * -side));
                    }
                    along += 5.2;
                }
            }
        }
    }
}

/// Lamps along both kerbs and trees between them.
fn furniture(circuit: &Circuit, dice: &mut Dice) -> (Vec<Billboard>, Vec<Lamp>) {
    let (mut billboards, mut lamps) = (Vec::new(), Vec::new());
    for i in 0..circuit.edge_count() {
        let edge = circuit.edge(i);
        let count = (edge.length / 9.0).round();
        for slot in 0..count as usize {
            let side = if slot % 2 == 0 { 1.0 } else { -1.0 };
            let along = (slot as f32 + 0.5) * edge.length / count;
            let at = |across: f32| edge.start + edge.along * along + edge.along.left() * across;
            billboards.push(Billboard { at: at(side * 4.0), sprite: 0 });
            lamps.push(Lamp { at: at(side * 4.0), height: LAMP_HEIGHT_METRES });
            if dice.chance(0.4) {
                billboards.push(Billboard { at: at(side * -4.2), sprite: 1 + dice.below(TREES) });
            }
        }
    }
    (billboards, lamps)
}

/// Plain brick for flanks and backs of houses.
fn firewall(seed: u32, grain: &Grain) -> Surface {
    let mut canvas = Canvas::wall((HOUSE_DEPTH_METRES, 17.0), FACADE_PX_PER_METRE, [120, 100, 88]);
    let whole = canvas.area();
    bricks(&mut canvas, whole, [136, 104, 88], seed);
    canvas.grain(whole, grain, 0.2);
    Surface::level(canvas)
}

/// A garden wall with bills and ivy.
fn garden_wall(seed: u32, grain: &Grain) -> Surface {
    let mut dice = Dice::new(seed, 5);
    let mut canvas = Canvas::wall((9.0, 2.5), FACADE_PX_PER_METRE, [150, 140, 130]);
    let whole = canvas.area();
    paint_wall(&mut canvas, whole, &mut dice, grain);
    for left in [0.4, 2.6, 5.1, 7.3] {
        poster(&mut canvas, Area::new(left, dice.between(0.7, 1.0), 0.8, 1.1), &mut dice);
    }
    ivy(&mut canvas, 4.2, 2.4, seed);
    canvas.fill(Area { bottom: whole.top - 0.14, ..whole }, [176, 170, 160]);
    canvas.shade(Area { bottom: whole.top - 0.2, top: whole.top - 0.14, ..whole }, 0.6);
    Surface::level(canvas)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_house_fronts_stand_more_than_once_and_look_the_same_from_the_road() {
        let world = street(7);
        let fronts: Vec<&Wall> =
            world.walls.iter().filter(|wall| wall.rear == FIREWALL && wall.surface != FIREWALL).collect();
        let pair = fronts.iter().enumerate().find_map(|(i, first)| {
            let twin = fronts[i + 1..].iter().find(|wall| wall.surface == first.surface)?;
            Some((first, twin))
        });
        let (first, twin) = pair.expect("no front was copied");
        assert!((first.start - twin.start).length() > 5.0);
        assert!((first.length - twin.length).abs() < 1e-3);
        let copies = fronts.len()
            - fronts.iter().map(|wall| wall.surface).collect::<std::collections::HashSet<_>>().len();
        assert!(copies >= 5 && copies < fronts.len() / 2, "{copies} of {} are copies", fronts.len());
    }

    #[test]
    fn one_design_gives_one_front_and_another_design_another() {
        let grain = Grain::new(3);
        let picture = |design: u32| {
            let mut strip = Vec::new();
            let front = house_front(design, &grain);
            for across in [0.5, 1.7, 3.1, 4.6] {
                front.texture.read_strip(0, (across, 0.01), 0..200, &mut strip);
            }
            strip
        };
        assert_eq!(picture(8), picture(8));
        assert_ne!(picture(8), picture(9));
    }

    #[test]
    fn the_road_is_free_for_the_camera() {
        let world = street(7);
        for wall in &world.walls {
            for step in 0..=10 {
                let point = wall.start + wall.along * (wall.length * step as f32 / 10.0);
                let (_, _, across) = world.circuit.nearest_edge(point);
                assert!(across > 1.4, "a wall stands {across} m from the middle of the road at {point:?}");
            }
        }
    }
}
