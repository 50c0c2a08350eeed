//! Light and shadow: what noon, dusk and night do to a world.
//!
//! Light does not move within a lap, so it is worked out once for a coarse grid on every wall and on the
//! ground: sky light, sun with cast shadows, and lamps by the inverse square law with Lambert's cosine.

use super::parse::Light;
use super::plan::Vector;
use super::texture::Radiance;
use super::world::{Lamp, Wall, World};

/// A point in space in metres, z upwards.
type Point3 = [f32; 3];

/// Spacing of light samples in metres.
const STEP_METRES: f32 = 0.4;
/// Lamps farther away than this add nothing visible.
const LAMP_REACH_METRES: f32 = 16.0;

/// How glowing texels shine.
#[derive(Clone, Copy, Debug)]
struct Glow {
    strength: f32,
    /// Texels that glow no more than this stay dark.
    threshold: f32,
    /// Colour of the light.
    tint: Point3,
    /// How much of it does not take on the texel's own colour, like light behind a curtain.
    veil: f32,
}

/// Lamplight behind windows.
const WINDOW_TINT: Point3 = [1.0, 0.56, 0.19];

/// What a light does, in linear units in which a white wall in full noon sun is about 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lighting {
    /// Towards the sun as a unit vector.
    sun: Point3,
    sun_colour: Point3,
    sky_colour: Point3,
    pub(super) lamp_colour: Point3,
    /// Only every so-many-th lamp is lit.
    lamp_every: usize,
    glow: Glow,
    /// What far things fade to, and the distance in metres over which they do.
    haze: (Point3, f32),
    /// Brightening before the film.
    pub(super) exposure: f32,
    /// Shutter time in seconds.
    pub(super) shutter_seconds: f32,
    /// Sensor noise in grey levels: shot noise, and read noise that shows in the dark.
    pub(super) noise: (f32, f32),
}

impl Lighting {
    /// The lighting under the open sky, or inside.
    pub(super) fn of(light: Light, outdoors: bool) -> Self {
        match (light, outdoors) {
            (Light::Noon, true) => Self::noon(),
            (Light::Dusk, true) => Self::dusk(),
            (Light::Night, true) => Self::night(),
            (_, false) => Self::inside(light),
        }
    }

    fn noon() -> Self {
        Self {
            sun: [-0.4, -0.47, 0.787],
            sun_colour: [1.75, 1.6, 1.34],
            sky_colour: [0.4, 0.46, 0.56],
            lamp_colour: [0.0; 3],
            lamp_every: 1,
            glow: Glow { strength: 0.0, threshold: 0.0, tint: WINDOW_TINT, veil: 0.0 },
            haze: ([0.5, 0.62, 0.76], 420.0),
            exposure: 0.8,
            shutter_seconds: 0.004,
            noise: (0.9, 0.1),
        }
    }

    fn dusk() -> Self {
        Self {
            sun: [-0.93, -0.27, 0.25],
            sun_colour: [0.42, 0.2, 0.08],
            sky_colour: [0.19, 0.155, 0.165],
            lamp_colour: [1.7, 1.15, 0.62],
            lamp_every: 1,
            glow: Glow { strength: 0.75, threshold: 0.45, tint: WINDOW_TINT, veil: 0.4 },
            haze: ([0.3, 0.2, 0.17], 240.0),
            exposure: 1.9,
            shutter_seconds: 0.012,
            noise: (1.6, 0.4),
        }
    }

    fn night() -> Self {
        Self {
            sun: [0.3, -0.5, 0.81],
            sun_colour: [0.004, 0.006, 0.01],
            sky_colour: [0.008, 0.011, 0.02],
            lamp_colour: [2.6, 1.75, 0.9],
            lamp_every: 1,
            glow: Glow { strength: 0.55, threshold: 0.3, tint: WINDOW_TINT, veil: 0.3 },
            haze: ([0.012, 0.014, 0.022], 200.0),
            exposure: 2.4,
            shutter_seconds: 0.014,
            noise: (3.2, 1.3),
        }
    }

    fn inside(light: Light) -> Self {
        let (sky, lamp, every, glow, exposure) = match light {
            Light::Noon => ([0.2, 0.2, 0.2], [1.0, 0.97, 0.88], 1, (1.6, 0.0), 1.0),
            Light::Dusk => ([0.06, 0.05, 0.04], [0.5, 0.36, 0.21], 1, (0.45, 0.0), 1.2),
            Light::Night => ([0.011, 0.014, 0.018], [0.22, 0.26, 0.25], 3, (0.7, 0.75), 2.3),
        };
        let (shutter_seconds, noise) = match light {
            Light::Noon => (0.008, (1.2, 0.1)),
            Light::Dusk => (0.016, (1.8, 0.5)),
            Light::Night => (0.02, (3.4, 1.4)),
        };
        Self {
            sun: [0.0, 0.0, 1.0],
            sun_colour: [0.0; 3],
            sky_colour: sky,
            lamp_colour: lamp,
            lamp_every: every,
            glow: Glow { strength: glow.0, threshold: glow.1, tint: [1.0; 3], veil: 0.0 },
            haze: (sky, 150.0),
            exposure,
            shutter_seconds,
            noise,
        }
    }

    /// The light that leaves a texel on which `light` falls; squaring undoes the gamma of 2.
    #[inline]
    pub(super) fn shade(&self, texel: Radiance, light: Radiance) -> Radiance {
        let glow = self.glow_of(texel[3]);
        let mut result = [0.0; 4];
        for c in 0..3 {
            let albedo = texel[c] * texel[c];
            result[c] = albedo * light[c] + glow * self.glow.tint[c] * (self.glow.veil + 2.0 * albedo);
        }
        result
    }

    /// Strength with which a texel shines whose fourth channel is `glow`.
    #[inline]
    pub(super) fn glow_of(&self, glow: f32) -> f32 {
        let Glow { strength, threshold, .. } = self.glow;
        strength * ((glow - threshold) / (1.0 - threshold)).max(0.0)
    }

    /// The haze before something `distance` metres away, and its share of what is seen.
    pub(super) fn haze_through(&self, distance: f32) -> (Radiance, f32) {
        let ([r, g, b], reach) = self.haze;
        ([r, g, b, 0.0], 1.0 - (-distance / reach).exp())
    }

    fn has_sun(&self) -> bool {
        self.sun_colour[0] > 0.0
    }
}

/// Light on a grid of points.
#[derive(Clone, Debug)]
pub(super) struct LightMap {
    columns: usize,
    rows: usize,
    /// Column by column, from the bottom up.
    values: Vec<Radiance>,
}

impl LightMap {
    fn new((width, height): (f32, f32), light_at: impl Fn(f32, f32) -> Radiance) -> Self {
        let (columns, rows) = ((width / STEP_METRES) as usize + 2, (height / STEP_METRES) as usize + 2);
        let value = |i: usize| light_at((i / rows) as f32 * STEP_METRES, (i % rows) as f32 * STEP_METRES);
        Self { columns, rows, values: (0..columns * rows).map(value).collect() }
    }

    /// The light along the vertical line `across` metres from the left, one value a step.
    pub(super) fn column(&self, across: f32) -> impl Iterator<Item = Radiance> {
        let x = (across / STEP_METRES).clamp(0.0, (self.columns - 2) as f32 + 0.999);
        let (column, fraction) = (x as usize, x.fract());
        let left = &self.values[column * self.rows..(column + 1) * self.rows];
        let right = &self.values[(column + 1) * self.rows..(column + 2) * self.rows];
        left.iter().zip(right).map(move |(left, right)| mixed(*left, *right, fraction))
    }

    /// Light at height `z` metres of what [`column`](Self::column) gave.
    #[inline]
    pub(super) fn in_column(column: &[Radiance], z: f32) -> Radiance {
        let y = (z / STEP_METRES).clamp(0.0, (column.len() - 2) as f32 + 0.999);
        mixed(column[y as usize], column[y as usize + 1], y.fract())
    }

    /// Light at a point of the grid's plane.
    #[inline]
    pub(super) fn at(&self, x_metres: f32, y_metres: f32) -> Radiance {
        let x = (x_metres / STEP_METRES).clamp(0.0, (self.columns - 2) as f32 + 0.999);
        let y = (y_metres / STEP_METRES).clamp(0.0, (self.rows - 2) as f32 + 0.999);
        let corner = x as usize * self.rows + y as usize;
        let left = mixed(self.values[corner], self.values[corner + 1], y.fract());
        let right = mixed(self.values[corner + self.rows], self.values[corner + self.rows + 1], y.fract());
        mixed(left, right, x.fract())
    }
}

/// The radiance `fraction` of the way from `from` to `to`.
#[inline]
pub(super) fn mixed(from: Radiance, to: Radiance, fraction: f32) -> Radiance {
    let mut result = from;
    for c in 0..4 {
        result[c] += (to[c] - from[c]) * fraction;
    }
    result
}

/// The light that falls on everything in a world.
#[derive(Clone, Debug)]
pub(super) struct Illumination {
    pub(super) lighting: Lighting,
    /// One map a wall, in the order of the world's walls.
    pub(super) walls: Vec<LightMap>,
    pub(super) ground: LightMap,
    /// Lamps that are lit.
    pub(super) lamps: Vec<Lamp>,
}

impl Illumination {
    /// Works out the light on every surface of `world`.
    pub(super) fn of(world: &World, light: Light) -> Self {
        let lighting = Lighting::of(light, world.ceiling.is_none());
        let lit = lighting.lamp_colour[0] > 0.0;
        let lamps: Vec<Lamp> =
            world.lamps.iter().copied().step_by(lighting.lamp_every).filter(|_| lit).collect();
        let tracer = Tracer { world, lighting: &lighting, lamps: &lamps };
        let walls = world.walls.iter().map(|wall| tracer.wall(wall)).collect();
        let ground = tracer.ground();
        Self { lighting, walls, ground, lamps }
    }

    /// Light on something upright in the open at `point`, from all sides.
    pub(super) fn around(&self, world: &World, point: Vector) -> Radiance {
        let on_ground = self.ground.at(point.x - world.ground.origin.x, point.y - world.ground.origin.y);
        on_ground.map(|channel| channel * 0.72)
    }

    /// Light on walls seen from behind.
    pub(super) fn behind(&self) -> Radiance {
        let [r, g, b] = self.lighting.sky_colour;
        [r * 0.7, g * 0.7, b * 0.7, 0.0]
    }
}

struct Tracer<'a> {
    world: &'a World,
    lighting: &'a Lighting,
    lamps: &'a [Lamp],
}

impl Tracer<'_> {
    fn wall(&self, wall: &Wall) -> LightMap {
        let normal = wall.normal();
        let height = self.world.surfaces[wall.surface].highest().min(wall.highest);
        LightMap::new((wall.length, height), |across, z| {
            let inset = (wall.length / 2.0).min(0.05);
            let point = wall.start + wall.along * across.clamp(inset, wall.length - inset) + normal * 0.06;
            let foot = 1.0 - 0.3 * (-z / 0.5).exp();
            let under_ceiling = match &self.world.ceiling {
                Some(ceiling) => 1.0 - 0.25 * (-(ceiling.height - z).max(0.0) / 0.4).exp(),
                None => 0.62 + 0.38 * (z / 9.0).min(1.0),
            };
            self.light_at([point.x, point.y, z.max(0.05)], [normal.x, normal.y, 0.0], foot * under_ceiling)
        })
    }

    fn ground(&self) -> LightMap {
        let (low, high) = self.world.circuit.bounds(self.world.measures.half_width + 0.5);
        let extent = high - low;
        LightMap::new((extent.x, extent.y), |x, y| {
            let point = low + Vector::new(x, y);
            let (_, _, across) = self.world.circuit.nearest_edge(point);
            if across > self.world.measures.half_width + 0.6 {
                return [0.0; 4];
            }
            let to_wall = (self.world.measures.half_width - across).max(0.0);
            let openness = 1.0 - 0.35 * (-to_wall / 0.6).exp();
            self.light_at([point.x, point.y, 0.02], [0.0, 0.0, 1.0], openness)
        })
    }

    fn light_at(&self, point: Point3, normal: Point3, openness: f32) -> Radiance {
        let lighting = self.lighting;
        let sky = openness * (0.62 + 0.38 * normal[2]);
        let mut light = lighting.sky_colour.map(|channel| channel * sky);
        let facing = dot(lighting.sun, normal).max(0.0);
        if lighting.has_sun() && facing > 0.0 && self.is_sunlit(point) {
            (0..3).for_each(|c| light[c] += lighting.sun_colour[c] * facing);
        }
        let lamps: f32 = self.lamps.iter().map(|lamp| lamp_light(lamp, point, normal)).sum();
        (0..3).for_each(|c| light[c] += lighting.lamp_colour[c] * lamps);
        [light[0], light[1], light[2], 0.0]
    }

    /// Whether no wall stands between `point` and the sun.
    fn is_sunlit(&self, [x, y, z]: Point3) -> bool {
        let (origin, sun) = (Vector::new(x, y), self.lighting.sun);
        let towards = Vector::new(sun[0], sun[1]);
        !self.world.walls.iter().any(|wall| {
            let denominator = towards.cross(wall.along);
            if denominator.abs() < 1e-6 {
                return false;
            }
            let offset = wall.start - origin;
            let distance = offset.cross(wall.along) / denominator;
            let across = offset.cross(towards) / denominator;
            let crosses = distance > 0.0 && (0.0..wall.length).contains(&across);
            crosses && z + distance * sun[2] < self.world.height_of(wall, across)
        })
    }
}

/// Share of a lamp's light that reaches `point`: cos θ / (d² + 1), faded out at the lamp's reach.
fn lamp_light(lamp: &Lamp, point: Point3, normal: Point3) -> f32 {
    let offset = [lamp.at.x - point[0], lamp.at.y - point[1], lamp.height - 0.1 - point[2]];
    let squared = dot(offset, offset);
    if squared > LAMP_REACH_METRES * LAMP_REACH_METRES {
        return 0.0;
    }
    let fade = 1.0 - squared / (LAMP_REACH_METRES * LAMP_REACH_METRES);
    let facing = (dot(offset, normal) / squared.sqrt().max(0.1)).max(0.0);
    4.0 * facing * fade / (squared + 1.0)
}

fn dot(a: Point3, b: Point3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::super::street::street;
    use super::*;

    #[test]
    fn at_night_the_road_is_brightest_under_the_lamps() {
        let world = street(7);
        let night = Illumination::of(&world, Light::Night);
        let light_at = |point: Vector| night.around(&world, point)[1];
        let under: Vec<f32> = night.lamps.iter().map(|lamp| light_at(lamp.at)).collect();
        let road: Vec<f32> = (0..200)
            .map(|i| light_at(world.circuit.at(world.circuit.length() * i as f32 / 200.0).position))
            .collect();
        let darkest = road.iter().copied().fold(f32::INFINITY, f32::min);
        assert!(under.iter().all(|&light| light > 2.0 * darkest), "{darkest} {under:?}");
    }

    #[test]
    fn at_noon_part_of_the_road_lies_in_the_shadow_of_houses() {
        let world = street(7);
        let noon = Illumination::of(&world, Light::Noon);
        let bright = (0..200)
            .map(|i| {
                noon.around(&world, world.circuit.at(world.circuit.length() * i as f32 / 200.0).position)[1]
            })
            .filter(|&light| light > 0.8)
            .count();
        assert!((20..180).contains(&bright), "{bright} of 200 points are in the sun");
    }
}
