//! The robot's way, where something told its position. It has a length that it never exceeds: where it would, every
//! second point is left out.

use ::rerun::{LineStrips2D, Points2D, Radius, RecordingStream, RecordingStreamResult};

use super::style;
use crate::frame::Pose;

const MOST_POINTS: usize = 2000;
/// The way is logged whole, so not with every point.
const SHOWN_EVERY: u64 = 10;

/// The way so far, in a plane that begins where it does: positions on earth are larger than what a picture can tell
/// apart.
pub(super) struct Trajectory {
    /// Where it began, in metres.
    origin: Option<[f64; 2]>,
    points: Vec<[f32; 2]>,
    /// One in so many poses is a point.
    interval: u64,
    poses: u64,
}

impl Default for Trajectory {
    fn default() -> Self {
        Self { origin: None, points: Vec::new(), interval: 1, poses: 0 }
    }
}

impl Trajectory {
    /// Metres to the right and down of where the way began: pictures grow downwards.
    pub(super) fn in_plane(&mut self, pose: &Pose) -> [f32; 2] {
        let [x, y, _] = pose.position_metres;
        let origin = *self.origin.get_or_insert([x, y]);
        [(x - origin[0]) as f32, (origin[1] - y) as f32]
    }

    /// Draws the way so far, and the robot where it is now.
    pub(super) fn show(&mut self, stream: &RecordingStream, pose: &Pose) -> RecordingStreamResult<()> {
        let here = self.in_plane(pose);
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

    /// Adds where the robot is.
    pub(super) fn add(&mut self, pose: &Pose) {
        let here = self.in_plane(pose);
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

    fn at(x: f64, y: f64) -> Pose {
        Pose { position_metres: [x, y, 9.0], orientation: Pose::UPRIGHT }
    }

    #[test]
    fn a_long_way_keeps_its_beginning_and_evenly_spaced_points() {
        let mut way = Trajectory::default();
        (0..10_000).for_each(|metre| way.add(&at(500_000.0 + f64::from(metre), 5_000_000.0)));
        assert!((MOST_POINTS / 2..MOST_POINTS).contains(&way.points.len()), "{}", way.points.len());
        let spacing = way.interval as f32;
        assert!(way.points.iter().enumerate().all(|(index, point)| *point == [index as f32 * spacing, 0.0]));
    }

    #[test]
    fn north_is_up() {
        let mut way = Trajectory::default();
        way.add(&at(1.0, 2.0));
        assert_eq!(way.in_plane(&at(4.0, 6.0)), [3.0, -4.0]);
    }
}
