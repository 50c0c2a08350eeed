//! The camera: where it is and where it looks in every frame of every lap.
//!
//! A pinhole without roll; pitch only moves the horizon up or down. Laps follow the same circuit but
//! none exactly: a smooth sideways drift and a smooth yaw, different each lap, and a small jitter a frame.

use super::noise::{folded, mix, unit, wave};
use super::parse::SyntheticSpec;
use super::plan::Vector;
use super::world::World;

/// Focal length as a fraction of the frame's width: a horizontal field of view of 71°.
const FOCAL_FRACTION: f32 = 0.7;
/// Height of the horizon in the frame, from the top, when the camera is level.
const HORIZON_FRACTION: f32 = 0.58;
const PITCH_RADIANS: f32 = 0.012;
/// Jerk of the camera's heading from frame to frame, for motion blur.
const SHAKE_RADIANS_PER_SECOND: f32 = 0.3;
/// Share of the spacing between frames by which a frame may be taken early or late.
const TIMING_JITTER: f32 = 0.15;

/// What one frame sees.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    pub(super) eye: Vector,
    pub(super) eye_height: f32,
    pub(super) heading_radians: f32,
    /// How fast the heading changes.
    pub(super) yaw_rate: f32,
    pub(super) focal_px: f32,
    /// Row of the horizon.
    pub(super) horizon_px: f32,
    pub(super) size_px: (usize, usize),
}

impl View {
    /// The direction of screen column `x`, scaled so that its part straight ahead has length 1.
    pub(super) fn ray(&self, x: usize) -> Vector {
        let forward = Vector::from_heading(self.heading_radians);
        let right = forward.left() * -1.0;
        forward + right * ((x as f32 + 0.5 - self.size_px.0 as f32 / 2.0) / self.focal_px)
    }

    /// The row at which a point at `depth` and height `z` appears.
    pub(super) fn row(&self, depth: f32, z: f32) -> f32 {
        self.horizon_px + self.focal_px * (self.eye_height - z) / depth
    }
}

/// How far into the lap frame `i` of `frames` is nominally taken, in metres.
pub(super) fn nominal_distance(world: &World, i: u32, frames: u32) -> f32 {
    (i as f32 + 0.5) / frames as f32 * world.circuit.length()
}

/// What frame `i` of `lap` sees.
pub(super) fn view(world: &World, spec: &SyntheticSpec, (lap, i): (u32, u32)) -> View {
    let seed = mix(mix(folded(spec.seed), 0xCA), lap);
    let shake = |salt: u32| 2.0 * unit(mix(mix(seed, i), salt)) - 1.0;
    let spacing = world.circuit.length() / spec.frames_per_lap as f32;
    let distance = nominal_distance(world, i, spec.frames_per_lap) + TIMING_JITTER * spacing * shake(1);
    let way = world.circuit.at(distance);
    // Two laps may drift to opposite sides, so each gets half of the offset.
    let drift = 0.5 * spec.offset_metres * (0.85 * wave(seed ^ 2, distance / 14.0) + 0.15 * shake(2));
    let yaw = spec.yaw_degrees.to_radians() * (0.75 * wave(seed ^ 3, distance / 11.0) + 0.25 * shake(3));
    let (width, height) = spec.size_px;
    let focal_px = FOCAL_FRACTION * width as f32;
    let pitch = PITCH_RADIANS * shake(4);
    View {
        eye: way.position + Vector::from_heading(way.heading_radians).left() * drift,
        eye_height: world.measures.eye_height + 0.02 * shake(5),
        heading_radians: way.heading_radians + yaw,
        yaw_rate: way.curvature * world.measures.speed + SHAKE_RADIANS_PER_SECOND * shake(6),
        focal_px,
        horizon_px: HORIZON_FRACTION * height as f32 + pitch * focal_px,
        size_px: spec.size_px,
    }
}
