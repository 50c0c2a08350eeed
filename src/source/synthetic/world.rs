//! A world as the renderer sees it: upright walls on a flat ground, perhaps a ceiling, upright sprites,
//! and lamps.
//!
//! A wall is a line on the plan with a texture and a skyline, so roofs and car bodies need no polygons.

use std::ops::Range;

use super::canvas::Canvas;
use super::plan::{Circuit, Vector};
use super::texture::{Radiance, Texture};

/// What a wall looks like, and how high it is along its width.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    pub(super) texture: Texture,
    /// Height in metres at each column of the finest level.
    skyline: Vec<f32>,
    highest: f32,
}

impl Surface {
    /// A surface that ends where `skyline` says, in metres, one number a texel column.
    pub(super) fn new(canvas: Canvas, skyline: Vec<f32>) -> Self {
        let highest = skyline.iter().copied().fold(0.0, f32::max);
        Self { texture: canvas.into(), skyline, highest }
    }

    /// A surface as high as its canvas.
    pub(super) fn level(canvas: Canvas) -> Self {
        let skyline = vec![canvas.area().height(); canvas.width_px()];
        Self::new(canvas, skyline)
    }

    pub(super) fn width_metres(&self) -> f32 {
        self.texture.width_metres()
    }

    /// The greatest height in metres.
    pub(super) fn highest(&self) -> f32 {
        self.highest
    }

    /// Height in metres at `across` metres from the left; the texture repeats sideways.
    pub(super) fn height_at(&self, across: f32) -> f32 {
        let column = across.rem_euclid(self.width_metres()) * self.texture.density(0);
        self.skyline[(column as usize).min(self.skyline.len() - 1)]
    }
}

/// An upright wall; whoever looks at its front sees `along` point to the right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wall {
    pub(super) start: Vector,
    /// Unit vector.
    pub(super) along: Vector,
    pub(super) length: f32,
    /// Index of the surface in front.
    pub(super) surface: usize,
    /// Index of the surface behind, with the skyline of the one in front.
    pub(super) rear: usize,
    /// The wall ends here in metres even where its surface goes on.
    pub(super) highest: f32,
}

impl Wall {
    /// The wall from `start` to `end`, the same on both sides.
    pub(super) fn between(start: Vector, end: Vector, surface: usize) -> Self {
        let length = (end - start).length();
        Self {
            start,
            along: (end - start) * (1.0 / length),
            length,
            surface,
            rear: surface,
            highest: f32::INFINITY,
        }
    }

    /// The same wall with another surface behind.
    pub(super) fn with_rear(self, rear: usize) -> Self {
        Self { rear, ..self }
    }

    /// The same wall cut off at `highest` metres.
    pub(super) fn lowered_to(self, highest: f32) -> Self {
        Self { highest, ..self }
    }

    /// The unit vector towards whoever looks at the front.
    pub(super) fn normal(&self) -> Vector {
        self.along.left() * -1.0
    }
}

/// A level plane with one texture that covers the whole plan: ground or ceiling.
#[derive(Clone, Debug)]
pub(super) struct Plane {
    pub(super) texture: Texture,
    /// South-west corner.
    pub(super) origin: Vector,
    /// Height above the ground in metres.
    pub(super) height: f32,
}

impl Plane {
    /// The texture at `point`, channels scaled to [0, 1].
    #[inline]
    pub(super) fn sample(&self, level: usize, point: Vector) -> Radiance {
        self.texture.sample(level, point.x - self.origin.x, point.y - self.origin.y)
    }
}

/// An upright picture that always faces the camera, as large as its sprite.
#[derive(Clone, Copy, Debug)]
pub(super) struct Billboard {
    pub(super) at: Vector,
    /// Index of the sprite.
    pub(super) sprite: usize,
}

/// A point light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lamp {
    pub(super) at: Vector,
    pub(super) height: f32,
}

/// Measures of a world, in metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measures {
    /// Height of the camera.
    pub(super) eye_height: f32,
    /// Distance from the middle of the way to the walls.
    pub(super) half_width: f32,
    /// Length of a place along the circuit, before rounding to a whole number of places a lap.
    pub(super) place: f32,
    /// How fast the camera goes, in metres a second.
    pub(super) speed: f32,
    /// Where passers-by walk, left and right of the middle.
    pub(super) walkway: (f32, f32),
}

/// Everything that stands still.
#[derive(Clone, Debug)]
pub(super) struct World {
    pub(super) circuit: Circuit,
    pub(super) measures: Measures,
    pub(super) surfaces: Vec<Surface>,
    pub(super) walls: Vec<Wall>,
    pub(super) ground: Plane,
    /// Without a ceiling there is sky.
    pub(super) ceiling: Option<Plane>,
    pub(super) sprites: Vec<Texture>,
    /// Which sprites are passers-by.
    pub(super) walkers: Range<usize>,
    pub(super) billboards: Vec<Billboard>,
    pub(super) lamps: Vec<Lamp>,
}

impl World {
    /// Number of places on the circuit.
    pub(super) fn place_count(&self) -> u32 {
        (self.circuit.length() / self.measures.place).round().max(1.0) as u32
    }

    /// The place at `distance` metres into a lap, from 0.
    pub(super) fn place_at(&self, distance: f32) -> u32 {
        let fraction = distance.rem_euclid(self.circuit.length()) / self.circuit.length();
        ((fraction * self.place_count() as f32) as u32).min(self.place_count() - 1)
    }

    /// Height of `wall` at `across` metres from its start.
    pub(super) fn height_of(&self, wall: &Wall, across: f32) -> f32 {
        self.surfaces[wall.surface].height_at(across).min(wall.highest)
    }

    /// The surface of `wall` as seen from in front or from behind.
    pub(super) fn surface(&self, wall: &Wall, from_behind: bool) -> &Surface {
        &self.surfaces[if from_behind { wall.rear } else { wall.surface }]
    }
}
