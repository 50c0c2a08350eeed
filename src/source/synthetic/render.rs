//! The renderer: one ray a screen column, walls from near to far, ground and sky in what stays open.
//!
//! A ray o + t·d (d has length 1 straight ahead, so t is depth) meets the wall s + u·a at
//! t = (s − o) × a / d × a and u = (s − o) × d / d × a. Walls stand on the ground, so from the bottom of
//! the column upwards nearer walls hide farther ones, and one number, the lowest open row, is all the
//! depth buffer that is needed.

use std::ops::Range;

use super::camera::View;
use super::light::{Illumination, LightMap, mixed};
use super::plan::Vector;
use super::sky::Sky;
use super::texture::Radiance;
use super::world::{Plane, Wall, World};

/// Walls nearer than this are not drawn, in metres of depth.
const NEAREST_METRES: f32 = 0.15;
/// Lower things may be looked over.
const LOW_METRES: f32 = 2.0;
/// Rows between two looks at the light on the ground.
const LIGHT_STRIDE: usize = 4;
/// How much of a lamp a polished floor mirrors.
const FLOOR_GLOSS: f32 = 0.09;

/// Linear light, column by column from the top down.
#[derive(Clone, Debug)]
pub(super) struct Picture {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) light: Vec<Radiance>,
}

impl Picture {
    pub(super) fn column_mut(&mut self, x: usize) -> &mut [Radiance] {
        &mut self.light[x * self.height..(x + 1) * self.height]
    }
}

/// What hides things in one screen column.
#[derive(Clone, Copy, Debug)]
pub(super) struct Occlusion {
    /// Depth of the nearest wall that cannot be looked over.
    pub(super) tall_depth: f32,
    /// Depth of the nearest low wall, and the row of the highest low one.
    pub(super) low_depth: f32,
    pub(super) low_row: usize,
}

/// What is drawn: a world in its light under its sky.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) world: &'a World,
    pub(super) illumination: &'a Illumination,
    pub(super) sky: &'a Sky,
    /// By how much the clouds have moved on, as a heading.
    pub(super) sky_turn: f32,
}

/// A wall met by a ray.
#[derive(Clone, Copy, Debug)]
struct Hit {
    wall: usize,
    depth: f32,
    /// Metres along the wall, and how many of them one screen column covers.
    across: f32,
    span: f32,
    from_behind: bool,
}

/// Draws everything that stands still but the sprites.
pub(super) fn render_walls(scene: Scene<'_>, view: &View) -> (Picture, Vec<Occlusion>) {
    let (width, height) = view.size_px;
    let mut picture = Picture { width, height, light: vec![[0.0; 4]; width * height] };
    let mut painter = ColumnPainter::new(scene, view);
    let occlusion = (0..width).map(|x| painter.paint(x, picture.column_mut(x))).collect();
    (picture, occlusion)
}

/// What a row of the ground or the ceiling needs to know, the same in every column.
#[derive(Clone, Copy)]
struct PlaneRow {
    depth: f32,
    level: usize,
}

struct ColumnPainter<'a> {
    scene: Scene<'a>,
    view: &'a View,
    visible: Vec<usize>,
    ground_rows: Vec<PlaneRow>,
    ceiling_rows: Vec<PlaneRow>,
    hits: Vec<Hit>,
    strip: Vec<Radiance>,
    light: Vec<Radiance>,
}

impl<'a> ColumnPainter<'a> {
    fn new(scene: Scene<'a>, view: &'a View) -> Self {
        let ceiling_rows =
            scene.world.ceiling.as_ref().map(|plane| plane_rows(view, plane)).unwrap_or_default();
        Self {
            scene,
            view,
            visible: visible_walls(scene.world, view),
            ground_rows: plane_rows(view, &scene.world.ground),
            ceiling_rows,
            hits: Vec::new(),
            strip: Vec::new(),
            light: Vec::new(),
        }
    }

    fn paint(&mut self, x: usize, column: &mut [Radiance]) -> Occlusion {
        let ray = self.view.ray(x);
        self.cast(ray);
        let mut occlusion =
            Occlusion { tall_depth: f32::INFINITY, low_depth: f32::INFINITY, low_row: column.len() };
        let mut open = column.len();
        for hit in std::mem::take(&mut self.hits) {
            let height = self.scene.world.height_of(&self.scene.world.walls[hit.wall], hit.across);
            let base = self.first_row_below(hit.depth, 0.0);
            self.paint_ground(column, base..open, ray);
            open = open.min(base);
            let top = self.first_row_below(hit.depth, height);
            self.paint_wall(column, top..open, hit);
            open = open.min(top);
            if height < LOW_METRES {
                occlusion.low_depth = occlusion.low_depth.min(hit.depth);
                occlusion.low_row = occlusion.low_row.min(top);
            } else {
                occlusion.tall_depth = occlusion.tall_depth.min(hit.depth);
                if self.scene.world.ceiling.is_some() || open == 0 {
                    break;
                }
            }
        }
        self.paint_above(column, open, ray);
        occlusion
    }

    /// The first row whose middle lies below height `z` at `depth`.
    fn first_row_below(&self, depth: f32, z: f32) -> usize {
        let row = (self.view.row(depth, z) - 0.5).ceil().max(0.0);
        (row as usize).min(self.view.size_px.1)
    }

    /// Fills `hits` from near to far.
    fn cast(&mut self, ray: Vector) {
        self.hits.clear();
        let right = Vector::from_heading(self.view.heading_radians).left() * -1.0;
        for &wall in &self.visible {
            let Wall { start, along, length, .. } = self.scene.world.walls[wall];
            let (offset, denominator) = (start - self.view.eye, ray.cross(along));
            if denominator.abs() < 1e-6 {
                continue;
            }
            let depth = offset.cross(along) / denominator;
            let across = offset.cross(ray) / denominator;
            if depth < NEAREST_METRES || !(0.0..length).contains(&across) {
                continue;
            }
            let slope = (offset.cross(right) - across * right.cross(along)) / denominator;
            let span = slope.abs() / self.view.focal_px;
            self.hits.push(Hit { wall, depth, across, span, from_behind: denominator > 0.0 });
        }
        self.hits.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    }

    fn paint_wall(&mut self, column: &mut [Radiance], rows: Range<usize>, hit: Hit) {
        if rows.is_empty() {
            return;
        }
        let wall = &self.scene.world.walls[hit.wall];
        let texture = &self.scene.world.surface(wall, hit.from_behind).texture;
        let lighting = &self.scene.illumination.lighting;
        let metres_per_row = hit.depth / self.view.focal_px;
        let level = texture.level_for(metres_per_row.max(hit.span / 6.0));
        let density = texture.density(level);
        let texel_at = |row: usize| {
            let z = self.view.eye_height - (row as f32 + 0.5 - self.view.horizon_px) * metres_per_row;
            z * density - 0.5
        };
        let highest = texture.height_px(level) - 1;
        let low = (texel_at(rows.end - 1).max(0.0) as usize).min(highest);
        let high = (texel_at(rows.start).max(0.0) as usize + 1).clamp(low, highest);
        let across = hit.across.rem_euclid(texture.width_metres());
        self.strip.clear();
        texture.read_strip(level, (across, hit.span), low..high + 1, &mut self.strip);
        self.light.clear();
        if hit.from_behind && wall.rear != wall.surface {
            self.light.extend([self.scene.illumination.behind(); 2]);
        } else {
            self.light.extend(self.scene.illumination.walls[hit.wall].column(hit.across));
        }
        let haze = lighting.haze_through(hit.depth);
        for (i, texel) in self.strip.iter_mut().enumerate() {
            let light = LightMap::in_column(&self.light, ((low + i) as f32 + 0.5) / density);
            *texel = mixed(lighting.shade(*texel, light), haze.0, haze.1);
        }
        let (last, mut texel) = ((self.strip.len() - 1) as f32, texel_at(rows.start) - low as f32);
        let step = metres_per_row * density;
        for pixel in &mut column[rows] {
            let y = texel.clamp(0.0, last);
            let below = y as usize;
            let above = (below + 1).min(self.strip.len() - 1);
            *pixel = mixed(self.strip[below], self.strip[above], y - below as f32);
            texel -= step;
        }
    }

    fn paint_ground(&self, column: &mut [Radiance], rows: Range<usize>, ray: Vector) {
        let Scene { world, illumination, .. } = self.scene;
        let lighting = &illumination.lighting;
        let gloss =
            world.ceiling.as_ref().map(|ceiling| (ceiling, 1.0 + ceiling.height / self.view.eye_height));
        let light_at = |row: usize| {
            let point = self.view.eye + ray * self.ground_rows[row].depth - world.ground.origin;
            illumination.ground.at(point.x, point.y)
        };
        for block in blocks(rows) {
            let (first, last) = (light_at(block.start), light_at(block.end - 1));
            let step = 1.0 / (block.len() as f32 - 1.0).max(1.0);
            let haze = lighting.haze_through(self.ground_rows[block.start].depth);
            for (i, row) in block.enumerate() {
                let PlaneRow { depth, level } = self.ground_rows[row];
                let texel = world.ground.sample(level, self.view.eye + ray * depth);
                let mut colour = lighting.shade(texel, mixed(first, last, i as f32 * step));
                if let Some((ceiling, factor)) = gloss {
                    let mirrored = ceiling.sample(level + 2, self.view.eye + ray * (depth * factor));
                    let shine = FLOOR_GLOSS * lighting.glow_of(mirrored[3]) * (0.5 + depth / 6.0).min(2.0);
                    (0..3).for_each(|c| colour[c] += shine);
                }
                column[row] = mixed(colour, haze.0, haze.1);
            }
        }
    }

    /// Ceiling, or sky with whatever ground no wall stands on.
    fn paint_above(&self, column: &mut [Radiance], open: usize, ray: Vector) {
        let horizon = (self.view.horizon_px.max(0.0) as usize).min(open);
        if let Some(ceiling) = &self.scene.world.ceiling {
            self.paint_ceiling(column, 0..horizon, ray, ceiling);
            return;
        }
        self.paint_ground(column, (horizon + 1).min(open)..open, ray);
        let sky = self.scene.sky.column(ray.y.atan2(ray.x) + self.scene.sky_turn);
        let slope_per_row = Sky::ROWS_PER_SLOPE / (self.view.focal_px * ray.length());
        for (row, pixel) in column[..(horizon + 1).min(open)].iter_mut().enumerate() {
            let y = ((self.view.horizon_px - row as f32 - 0.5) * slope_per_row)
                .clamp(0.0, (sky.len() - 2) as f32);
            *pixel = mixed(sky[y as usize], sky[y as usize + 1], y.fract());
        }
    }

    fn paint_ceiling(&self, column: &mut [Radiance], rows: Range<usize>, ray: Vector, ceiling: &Plane) {
        let illumination = self.scene.illumination;
        for row in rows {
            let PlaneRow { depth, level } = self.ceiling_rows[row];
            let point = self.view.eye + ray * depth;
            // What lights the ceiling is what the floor throws back.
            let below = point - self.scene.world.ground.origin;
            let light = illumination.ground.at(below.x, below.y).map(|channel| channel * 0.55);
            let colour = illumination.lighting.shade(ceiling.sample(level, point), light);
            let haze = illumination.lighting.haze_through(depth);
            column[row] = mixed(colour, haze.0, haze.1);
        }
    }
}

/// Rows in blocks over which light changes evenly.
fn blocks(rows: Range<usize>) -> impl Iterator<Item = Range<usize>> {
    let end = rows.end;
    rows.step_by(LIGHT_STRIDE).map(move |start| start..(start + LIGHT_STRIDE).min(end))
}

/// Walls with at least one end before the camera and within the field of view's half-plane.
fn visible_walls(world: &World, view: &View) -> Vec<usize> {
    let forward = Vector::from_heading(view.heading_radians);
    let right = forward.left() * -1.0;
    let edge = view.size_px.0 as f32 / 2.0 / view.focal_px;
    let outside = |point: Vector, side: f32| {
        let offset = point - view.eye;
        side * offset.dot(right) > edge * offset.dot(forward).max(0.0) + 0.01
    };
    (0..world.walls.len())
        .filter(|&i| {
            let wall = &world.walls[i];
            let ends = [wall.start, wall.start + wall.along * wall.length];
            let ahead = ends.iter().any(|&end| (end - view.eye).dot(forward) > NEAREST_METRES);
            ahead && ![-1.0, 1.0].iter().any(|&side| ends.iter().all(|&end| outside(end, side)))
        })
        .collect()
}

fn plane_rows(view: &View, plane: &Plane) -> Vec<PlaneRow> {
    let drop = view.eye_height - plane.height;
    (0..view.size_px.1)
        .map(|row| {
            let below = (row as f32 + 0.5 - view.horizon_px) * drop.signum();
            let depth = view.focal_px * drop.abs() / below.max(0.25);
            // Between the sideways and the lengthwise footprint of a pixel.
            let footprint = depth / view.focal_px * (depth / drop.abs()).max(1.0).sqrt();
            PlaneRow { depth, level: plane.texture.level_for(footprint * 0.8) }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::parse::{SyntheticSpec, WorldKind};
    use super::super::{camera, corridor};
    use super::*;

    #[test]
    fn no_wall_that_a_ray_meets_is_left_out_beforehand() {
        let world = corridor::corridor(7);
        let spec = SyntheticSpec::new(WorldKind::Corridor);
        for i in 0..60 {
            let view = camera::view(&world, &spec, (0, i));
            let visible = visible_walls(&world, &view);
            for x in (0..640).step_by(13) {
                let ray = view.ray(x);
                for (number, wall) in world.walls.iter().enumerate() {
                    let (offset, denominator) = (wall.start - view.eye, ray.cross(wall.along));
                    let (depth, across) =
                        (offset.cross(wall.along) / denominator, offset.cross(ray) / denominator);
                    if depth > NEAREST_METRES && (0.0..wall.length).contains(&across) {
                        assert!(visible.contains(&number), "frame {i}, column {x}, wall {number}");
                    }
                }
            }
        }
    }
}
