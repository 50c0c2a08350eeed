//! Plane geometry: points, angles, the similarity transform that a correspondence votes for and
//! the affine transform that verification refines it to.

use std::f32::consts::{PI, TAU};

/// A point in pixels, x to the right and y down.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Column in pixels.
    pub x: f32,
    /// Row in pixels.
    pub y: f32,
}

impl Point {
    /// Squared distance to `other` in square pixels.
    #[must_use]
    pub fn distance_squared(self, other: Self) -> f32 {
        (self.x - other.x).powi(2) + (self.y - other.y).powi(2)
    }
}

/// `radians` wrapped into [−π, π).
#[must_use]
pub fn wrap_radians(radians: f32) -> f32 {
    // What two wrapped angles differ by needs no division.
    let near = if radians < -PI {
        radians + TAU
    } else if radians >= PI {
        radians - TAU
    } else {
        radians
    };
    if (-PI..PI).contains(&near) {
        return near;
    }
    let wrapped = (radians + PI).rem_euclid(TAU) - PI;
    // rem_euclid may round up to TAU itself for tiny negative input.
    if wrapped >= PI { -PI } else { wrapped }
}

/// A similarity transform p ↦ s·R(θ)·p + t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Scale s, positive.
    pub scale: f32,
    /// Rotation θ in radians.
    pub rotation_radians: f32,
    /// Translation t in pixels.
    pub translation: Point,
}

impl Similarity {
    /// The transform that takes `from` (scale and orientation included) to `to`:
    /// s = s₂/s₁, θ = wrap(θ₂ − θ₁), t = p₂ − s·R(θ)·p₁ (the paper's eq. 2 in one direction).
    #[must_use]
    pub fn between(from: OrientedPoint, to: OrientedPoint) -> Self {
        let scale = to.scale / from.scale;
        let rotation_radians = wrap_radians(to.angle_radians - from.angle_radians);
        let turned = rotate_and_scale(from.point, scale, rotation_radians);
        let translation = Point { x: to.point.x - turned.x, y: to.point.y - turned.y };
        Self { scale, rotation_radians, translation }
    }

    /// The image of `point`.
    #[must_use]
    pub fn apply(&self, point: Point) -> Point {
        let turned = rotate_and_scale(point, self.scale, self.rotation_radians);
        Point { x: turned.x + self.translation.x, y: turned.y + self.translation.y }
    }
}

fn rotate_and_scale(point: Point, scale: f32, radians: f32) -> Point {
    let (sin, cos) = radians.sin_cos();
    Point { x: scale * (cos * point.x - sin * point.y), y: scale * (sin * point.x + cos * point.y) }
}

/// A point with the size and direction of the feature found there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientedPoint {
    /// Position in pixels.
    pub point: Point,
    /// Size of the feature relative to the finest pyramid level.
    pub scale: f32,
    /// Direction in radians.
    pub angle_radians: f32,
}

/// An affine transform (x, y) ↦ (a·x + b·y + tx, c·x + d·y + ty).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    /// The linear part, row-major: a, b, c, d.
    pub linear: [f32; 4],
    /// Translation in pixels.
    pub translation: Point,
}

impl Affine {
    /// The image of `point`.
    #[must_use]
    pub fn apply(&self, point: Point) -> Point {
        let [a, b, c, d] = self.linear;
        Point {
            x: a * point.x + b * point.y + self.translation.x,
            y: c * point.x + d * point.y + self.translation.y,
        }
    }

    /// The factor by which areas grow.
    #[must_use]
    pub fn determinant(&self) -> f32 {
        let [a, b, c, d] = self.linear;
        a * d - b * c
    }

    /// The angle by which it turns, in radians: that of the rotation nearest to its linear part.
    #[must_use]
    pub fn rotation_radians(&self) -> f32 {
        let [a, b, c, d] = self.linear;
        (c - b).atan2(a + d)
    }

    /// The factor by which lengths grow: the geometric mean of the most and the least that they do in any direction.
    #[must_use]
    pub fn growth(&self) -> f32 {
        self.determinant().abs().sqrt()
    }

    /// The inverse, or `None` if areas collapse.
    #[must_use]
    pub fn inverse(&self) -> Option<Self> {
        let determinant = self.determinant();
        if !determinant.is_finite() || determinant.abs() < 1e-6 {
            return None;
        }
        let [a, b, c, d] = self.linear.map(|value| value / determinant);
        let linear = [d, -b, -c, a];
        let Point { x, y } = self.translation;
        let translation = Point { x: -(d * x - b * y), y: -(-c * x + a * y) };
        Some(Self { linear, translation })
    }
}

impl From<Similarity> for Affine {
    fn from(similarity: Similarity) -> Self {
        let (sin, cos) = similarity.rotation_radians.sin_cos();
        let (sin, cos) = (sin * similarity.scale, cos * similarity.scale);
        Self { linear: [cos, -sin, sin, cos], translation: similarity.translation }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn oriented_point() -> impl Strategy<Value = OrientedPoint> {
        (-500.0..500.0_f32, -500.0..500.0_f32, 1.0..4.0_f32, -PI..PI).prop_map(
            |(x, y, scale, angle_radians)| OrientedPoint { point: Point { x, y }, scale, angle_radians },
        )
    }

    proptest! {
        #[test]
        fn a_transform_between_two_features_takes_one_to_the_other(from in oriented_point(), to in oriented_point()) {
            let image = Similarity::between(from, to).apply(from.point);
            prop_assert!(image.distance_squared(to.point) < 1e-2);
        }

        #[test]
        fn an_affine_transform_turns_and_grows_as_the_rotation_and_the_stretches_do_of_which_it_is_made(
            turn in -3.0..3.0_f32, most in 0.5..4.0_f32, least in 0.2..0.5_f32, along in -3.0..3.0_f32,
        ) {
            // Stretched along a direction and across it (V·D·Vᵀ), then turned.
            let (s, c) = along.sin_cos();
            let stretched =
                [most * c * c + least * s * s, (most - least) * c * s, most * s * s + least * c * c];
            let (sine, cosine) = turn.sin_cos();
            let linear = [
                cosine * stretched[0] - sine * stretched[1],
                cosine * stretched[1] - sine * stretched[2],
                sine * stretched[0] + cosine * stretched[1],
                sine * stretched[1] + cosine * stretched[2],
            ];
            let affine = Affine { linear, translation: Point::default() };
            prop_assert!((affine.rotation_radians() - turn).abs() < 1e-3);
            prop_assert!((affine.growth() - (most * least).sqrt()).abs() < 1e-3);
        }

        #[test]
        fn an_inverse_brings_every_point_back(
            from in oriented_point(), to in oriented_point(), x in -99.0..99.0_f32, y in -99.0..99.0_f32,
        ) {
            let affine = Affine::from(Similarity::between(from, to));
            let point = Point { x, y };
            let back = affine.inverse().unwrap().apply(affine.apply(point));
            prop_assert!(back.distance_squared(point) < 1e-1);
        }

        #[test]
        fn wrapped_angles_stay_in_one_turn_and_keep_their_direction(radians in -50.0..50.0_f32) {
            let wrapped = wrap_radians(radians);
            prop_assert!((-PI..PI).contains(&wrapped));
            prop_assert!((wrapped.sin() - radians.sin()).abs() < 1e-4);
        }
    }
}
