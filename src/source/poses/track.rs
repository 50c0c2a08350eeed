//! Poses in the order of time, and those in between.

use crate::frame::Pose;

/// Longest time between two poses within which those in between are taken from both, in nanoseconds.
const LONGEST_GAP_NANOS: i64 = 2_000_000_000;
/// Quaternions whose dot product is above this differ by so little that a straight line serves.
const NEARLY_THE_SAME: f64 = 0.9995;

/// Where the robot was, over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseTrack {
    /// By time in nanoseconds, rising.
    poses: Vec<(i64, Pose)>,
}

impl PoseTrack {
    /// A track of poses with their times in nanoseconds, in any order; of equal times the first counts.
    #[must_use]
    pub fn new(mut poses: Vec<(i64, Pose)>) -> Self {
        poses.sort_by_key(|(nanos, _)| *nanos);
        poses.dedup_by_key(|(nanos, _)| *nanos);
        Self { poses }
    }

    /// First and last time in nanoseconds; `None` if there is no pose.
    #[must_use]
    pub fn span_nanos(&self) -> Option<[i64; 2]> {
        Some([self.poses.first()?.0, self.poses.last()?.0])
    }

    /// The pose at a time: positions along a straight line, orientations along the shortest turn (Shoemake,
    /// *Animating rotation with quaternion curves*, 1985). `None` before the first, behind the last, and between two
    /// that are more than 2 s apart.
    #[must_use]
    pub fn at(&self, nanos: i64) -> Option<Pose> {
        let after = self.poses.partition_point(|(time, _)| *time < nanos);
        let &(next_nanos, next) = self.poses.get(after)?;
        if next_nanos == nanos {
            return Some(next);
        }
        let &(before_nanos, before) = self.poses.get(after.checked_sub(1)?)?;
        let gap = next_nanos.checked_sub(before_nanos).filter(|&gap| gap <= LONGEST_GAP_NANOS)?;
        Some(between(&before, &next, (nanos - before_nanos) as f64 / gap as f64))
    }
}

/// The pose that lies at `share` of the way from one to another.
pub(super) fn between(from: &Pose, to: &Pose, share: f64) -> Pose {
    let along = |axis: usize| {
        from.position_metres[axis] + share * (to.position_metres[axis] - from.position_metres[axis])
    };
    let position_metres = [along(0), along(1), along(2)];
    Pose { position_metres, orientation: turned(from.orientation, to.orientation, share) }
}

/// The unit quaternion at `share` of the shorter way from one to another.
fn turned(from: [f64; 4], to: [f64; 4], share: f64) -> [f64; 4] {
    let dot: f64 = from.iter().zip(to).map(|(a, b)| a * b).sum();
    // A quaternion and its negative are the same turn.
    let (to, cosine) = if dot < 0.0 { (to.map(|part| -part), -dot) } else { (to, dot) };
    let weights = if cosine > NEARLY_THE_SAME {
        [1.0 - share, share]
    } else {
        let angle = cosine.acos();
        [((1.0 - share) * angle).sin(), (share * angle).sin()]
    };
    let mixed: [f64; 4] = std::array::from_fn(|part| weights[0] * from[part] + weights[1] * to[part]);
    let length = mixed.iter().map(|part| part * part).sum::<f64>().sqrt();
    mixed.map(|part| part / length)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_4;

    use super::*;

    /// A pose at x on the floor, turned about the upright axis.
    fn pose(x: f64, yaw_radians: f64) -> Pose {
        let half = yaw_radians / 2.0;
        Pose { position_metres: [x, 2.0 * x, 0.0], orientation: [0.0, 0.0, half.sin(), half.cos()] }
    }

    fn assert_near(pose: Pose, expected: Pose) {
        let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        let orientation = expected.orientation;
        assert!(near(&pose.position_metres, &expected.position_metres), "{pose:?}");
        let is_turned = near(&pose.orientation, &orientation);
        assert!(is_turned || near(&pose.orientation, &orientation.map(|part| -part)), "{pose:?}");
    }

    #[test]
    fn between_two_poses_the_robot_goes_and_turns_evenly() {
        let track = PoseTrack::new(vec![(1_000, pose(4.0, 2.0 * FRAC_PI_4)), (0, pose(0.0, 0.0))]);
        assert_eq!(track.span_nanos(), Some([0, 1_000]));
        assert_near(track.at(0).unwrap(), pose(0.0, 0.0));
        assert_near(track.at(500).unwrap(), pose(2.0, FRAC_PI_4));
        assert_near(track.at(1_000).unwrap(), pose(4.0, 2.0 * FRAC_PI_4));
    }

    #[test]
    fn it_turns_the_shorter_way_whatever_the_sign_of_the_quaternions() {
        let mut turned = pose(0.0, 2.0 * FRAC_PI_4);
        turned.orientation = turned.orientation.map(|part| -part);
        let track = PoseTrack::new(vec![(0, pose(0.0, 0.0)), (1_000, turned)]);
        assert_near(track.at(500).unwrap(), pose(0.0, FRAC_PI_4));
        let still = PoseTrack::new(vec![(0, pose(1.0, 0.3)), (1_000, pose(1.0, 0.3))]);
        assert_near(still.at(123).unwrap(), pose(1.0, 0.3));
    }

    #[test]
    fn outside_the_track_and_in_its_gaps_nobody_knows() {
        let later = 2 * LONGEST_GAP_NANOS;
        let track = PoseTrack::new(vec![(0, pose(0.0, 0.0)), (later, pose(1.0, 0.0))]);
        assert_eq!([-1, 1, later - 1, later + 1].map(|nanos| track.at(nanos)), [None; 4]);
        assert_eq!(PoseTrack::default().at(0), None);
        let ends = PoseTrack::new(vec![(i64::MIN, pose(0.0, 0.0)), (i64::MAX, pose(1.0, 0.0))]);
        assert_eq!(ends.at(0), None);
    }

    #[test]
    fn of_poses_at_the_same_time_the_first_counts() {
        let track = PoseTrack::new(vec![(5, pose(1.0, 0.0)), (5, pose(2.0, 0.0))]);
        assert_eq!(track.at(5), Some(pose(1.0, 0.0)));
    }
}
