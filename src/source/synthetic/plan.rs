//! The plan of a world: vectors on the ground, and the closed circuit that the camera follows.
//!
//! A circuit is an axis-parallel polygon whose corners are rounded with quarter circles, so a point at
//! arc length s is a closed formula: on a piece of curvature κ that starts at p with heading h,
//! p(s) = p + ((sin(h + κs) − sin h)/κ, (cos h − cos(h + κs))/κ).

use std::f32::consts::FRAC_PI_2;
use std::ops::{Add, Mul, Sub};

/// A vector on the ground in metres, x to the east and y to the north.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Vector {
    pub(super) x: f32,
    pub(super) y: f32,
}

impl Vector {
    pub(super) const fn new(x: f32, y: f32) -> Self {
        Self { x, y }
    }

    /// The unit vector of a heading, anticlockwise from east.
    pub(super) fn from_heading(radians: f32) -> Self {
        Self::new(radians.cos(), radians.sin())
    }

    /// Turned a quarter to the left.
    pub(super) fn left(self) -> Self {
        Self::new(-self.y, self.x)
    }

    pub(super) fn dot(self, other: Self) -> f32 {
        self.x * other.x + self.y * other.y
    }

    /// The z component of the cross product.
    pub(super) fn cross(self, other: Self) -> f32 {
        self.x * other.y - self.y * other.x
    }

    pub(super) fn length(self) -> f32 {
        self.x.hypot(self.y)
    }
}

impl Add for Vector {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y)
    }
}

impl Sub for Vector {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y)
    }
}

impl Mul<f32> for Vector {
    type Output = Self;
    fn mul(self, factor: f32) -> Self {
        Self::new(self.x * factor, self.y * factor)
    }
}

/// A stretch of the circuit with constant curvature.
#[derive(Clone, Copy, Debug)]
struct Piece {
    start: Vector,
    heading_radians: f32,
    /// Positive to the left, in 1/metre.
    curvature: f32,
    length: f32,
}

impl Piece {
    fn at(&self, distance: f32) -> Waypoint {
        let heading = self.heading_radians;
        let turned = heading + self.curvature * distance;
        let position = if self.curvature == 0.0 {
            self.start + Vector::from_heading(heading) * distance
        } else {
            let swing = Vector::new(turned.sin() - heading.sin(), heading.cos() - turned.cos());
            self.start + swing * (1.0 / self.curvature)
        };
        Waypoint { position, heading_radians: turned, curvature: self.curvature }
    }
}

/// A point of the circuit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waypoint {
    pub(super) position: Vector,
    pub(super) heading_radians: f32,
    /// Positive to the left, in 1/metre.
    pub(super) curvature: f32,
}

/// One straight edge of the polygon under a circuit, in travel direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub(super) start: Vector,
    pub(super) along: Vector,
    pub(super) length: f32,
}

/// A closed circuit in travel direction.
#[derive(Clone, Debug)]
pub(super) struct Circuit {
    corners: Vec<Vector>,
    pieces: Vec<Piece>,
    length: f32,
}

impl Circuit {
    /// The circuit around `corners`, an axis-parallel polygon, rounded with `radius` metres.
    pub(super) fn new(corners: &[Vector], radius: f32) -> Self {
        let mut circuit = Self { corners: corners.to_vec(), pieces: Vec::new(), length: 0.0 };
        for i in 0..corners.len() {
            let edge = circuit.edge(i);
            let turn = edge.along.cross(circuit.edge(i + 1).along);
            let heading_radians = edge.along.y.atan2(edge.along.x);
            let (start, length) = (edge.start + edge.along * radius, edge.length - 2.0 * radius);
            circuit.pieces.push(Piece { start, heading_radians, curvature: 0.0, length });
            let start = start + edge.along * length;
            let bend = Piece { start, heading_radians, curvature: turn / radius, length: FRAC_PI_2 * radius };
            circuit.pieces.push(bend);
        }
        circuit.length = circuit.pieces.iter().map(|piece| piece.length).sum();
        circuit
    }

    /// Arc length of one lap in metres.
    pub(super) fn length(&self) -> f32 {
        self.length
    }

    /// The point `distance` metres into the lap; distances beyond a lap go round again.
    pub(super) fn at(&self, distance: f32) -> Waypoint {
        let mut rest = distance.rem_euclid(self.length);
        for piece in &self.pieces {
            if rest < piece.length {
                return piece.at(rest);
            }
            rest -= piece.length;
        }
        self.pieces[0].at(0.0)
    }

    /// Number of edges of the polygon.
    pub(super) fn edge_count(&self) -> usize {
        self.corners.len()
    }

    /// Edge `i` of the polygon, counted round and round.
    pub(super) fn edge(&self, i: usize) -> Edge {
        let count = self.corners.len();
        let (start, end) = (self.corners[i % count], self.corners[(i + 1) % count]);
        let length = (end - start).length();
        Edge { start, along: (end - start) * (1.0 / length), length }
    }

    /// Edge `i` moved `distance` metres to the left (right if negative), mitred at both ends.
    pub(super) fn offset_edge(&self, i: usize, distance: f32) -> Edge {
        let (edge, count) = (self.edge(i), self.corners.len());
        let before = self.edge(i + count - 1).along.left();
        let (here, after) = (edge.along.left(), self.edge(i + 1).along.left());
        let start = edge.start + (here + before) * distance;
        let end = edge.start + edge.along * edge.length + (here + after) * distance;
        Edge { start, along: edge.along, length: (end - start).dot(edge.along) }
    }

    /// The edge nearest to `point` in the maximum norm, which keeps offset corners square:
    /// its number, the distance along it and the distance from it, both in metres.
    pub(super) fn nearest_edge(&self, point: Vector) -> (usize, f32, f32) {
        let mut nearest = (0, 0.0, f32::INFINITY);
        for i in 0..self.corners.len() {
            let edge = self.edge(i);
            let along = (point - edge.start).dot(edge.along);
            let across = (point - edge.start).dot(edge.along.left()).abs();
            let beyond = (-along).max(along - edge.length).max(0.0);
            if across.max(beyond) < nearest.2 {
                nearest = (i, along, across.max(beyond));
            }
        }
        nearest
    }

    /// South-west and north-east corner of the polygon, widened by `margin` metres.
    pub(super) fn bounds(&self, margin: f32) -> (Vector, Vector) {
        let (mut low, mut high) = (self.corners[0], self.corners[0]);
        for corner in &self.corners {
            low = Vector::new(low.x.min(corner.x), low.y.min(corner.y));
            high = Vector::new(high.x.max(corner.x), high.y.max(corner.y));
        }
        (low - Vector::new(margin, margin), high + Vector::new(margin, margin))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ell() -> Circuit {
        let corners = [(0.0, 0.0), (30.0, 0.0), (30.0, 14.0), (16.0, 14.0), (16.0, 26.0), (0.0, 26.0)];
        Circuit::new(&corners.map(|(x, y)| Vector::new(x, y)), 1.5)
    }

    #[test]
    fn a_circuit_is_closed_and_without_jumps() {
        let circuit = ell();
        let step = 0.05;
        let count = (circuit.length() / step) as usize + 2;
        for i in 0..count {
            let here = circuit.at(i as f32 * step);
            let next = circuit.at((i + 1) as f32 * step);
            assert!(((next.position - here.position).length() - step).abs() < 2e-3, "at step {i}");
        }
    }

    #[test]
    fn offset_edges_join_at_their_ends() {
        let circuit = ell();
        for side in [-1.3, 1.3] {
            for i in 0..circuit.edge_count() {
                let (edge, next) = (circuit.offset_edge(i, side), circuit.offset_edge(i + 1, side));
                let end = edge.start + edge.along * edge.length;
                assert!((end - next.start).length() < 1e-4, "edge {i}");
            }
        }
    }
}
