//! The robot's way, where something told its position. It has a length that it never exceeds: where it would, every
//! second point is left out.

use ::rerun::{LineStrips2D, Points2D, Radius, RecordingStream, RecordingStreamResult};

use super::style;
use crate::frame::Pose;

const MOST_POINTS: usize = 2000;
/// The way is logged whole, so not with every point.
const SHOWN_EVERY: u64 = 10;

/// The way so far.
pub(super) struct Trajectory {
    points: Vec<[f32; 2]>,
    /// One in so many poses is a point.
    interval: u64,
    poses: u64,
}

impl Default for Trajectory {
    fn default() -> Self {
        Self { points: Vec::new(), interval: 1, poses: 0 }
    }
}

/// Metres to the right and down: pictures grow downwards.
pub(super) fn in_plane(pose: &Pose) -> [f32; 2] {
    let [x, y, _] = pose.position_metres;
    [x as f32, -y as f32]
}

impl Trajectory {
    /// Adds where the robot is, and draws it there.
    pub(super) fn show(&mut self, stream: &RecordingStream, pose: &Pose) -> RecordingStreamResult<()> {
        let here = in_plane(pose);
        self.add(here);
        let robot = Points2D::new([here])
            .with_radii([Radius::new_ui_points(4.0)])
            .with_colors([style::WHITE])
            .with_draw_order(style::PLACES_ORDER + 1.0);
        stream.log(style::ROBOT, &robot)?;
        if self.poses % SHOWN_EVERY != 1 {
            return Ok(());
        }
        let way = LineStrips2D::new([self.points.iter().copied().chain([here])])
            .with_radii([Radius::new_ui_points(0.8)])
            .with_colors([style::BLUE])
            .with_draw_order(style::BELOW_PLACES - 2.0);
        stream.log(style::TRAJECTORY, &way)
    }

    fn add(&mut self, here: [f32; 2]) {
        if self.poses.is_multiple_of(self.interval) {
            self.points.push(here);
        }
        self.poses += 1;
        if self.points.len() == MOST_POINTS {
            let mut index = 0;
            self.points.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.interval *= 2;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_way_keeps_its_beginning_and_evenly_spaced_points() {
        let mut way = Trajectory::default();
        (0..10_000).for_each(|metre| way.add([metre as f32, 0.0]));
        assert!((MOST_POINTS / 2..MOST_POINTS).contains(&way.points.len()), "{}", way.points.len());
        let spacing = way.interval as f32;
        assert!(way.points.iter().enumerate().all(|(index, [x, _])| *x == index as f32 * spacing));
    }

    #[test]
    fn north_is_up() {
        let pose = Pose { position_metres: [3.0, 4.0, 9.0], orientation: Pose::UPRIGHT };
        assert_eq!(in_plane(&pose), [3.0, -4.0]);
    }
}
