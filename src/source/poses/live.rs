//! Poses that come while the robot drives. They are looked for whenever a frame has come, and never waited for.

use std::collections::VecDeque;

use super::gpsd::Gpsd;
use super::socket::PoseSocket;
use super::track::between;
use crate::frame::Pose;

/// Most poses that are kept: ten seconds at 200 Hz.
const MOST_POSES: usize = 2000;
/// How long the last pose holds, and how far apart two may be between which one is interpolated, in nanoseconds.
const HOLDS_NANOS: i64 = 2_000_000_000;

/// Who tells poses.
#[derive(Debug)]
pub(super) enum Teller {
    /// gpsd, whose positions count as of when they arrive.
    Gpsd(Gpsd),
    /// Whoever writes to a socket.
    Socket(PoseSocket),
}

/// The poses of the last few seconds.
#[derive(Debug)]
pub(super) struct LivePoses {
    teller: Teller,
    /// By time in nanoseconds, rising.
    recent: VecDeque<(i64, Pose)>,
}

impl LivePoses {
    pub(super) fn of(teller: Teller) -> Self {
        Self { teller, recent: VecDeque::with_capacity(MOST_POSES) }
    }

    /// Takes what has come. Answers what people should know.
    pub(super) fn listen(&mut self) -> Option<String> {
        let recent = &mut self.recent;
        match &mut self.teller {
            Teller::Gpsd(gpsd) => gpsd.read(|nanos, pose| add(recent, nanos, pose)),
            Teller::Socket(socket) => socket.read(|nanos, pose| add(recent, nanos, pose)),
        }
    }

    /// The pose at a time: between two at most 2 s apart, or the last one for 2 s.
    pub(super) fn at(&self, nanos: i64) -> Option<Pose> {
        let after = self.recent.partition_point(|(time, _)| *time < nanos);
        let is_near = |from: i64, to: i64| to.checked_sub(from).is_some_and(|gap| gap <= HOLDS_NANOS);
        let before = after.checked_sub(1).map(|before| self.recent[before]);
        match (before, self.recent.get(after)) {
            (_, Some(&(time, pose))) if time == nanos => Some(pose),
            (Some((from, before)), Some(&(to, next))) if is_near(from, to) => {
                Some(between(&before, &next, (nanos - from) as f64 / (to - from) as f64))
            }
            (Some((from, before)), None) if is_near(from, nanos) => Some(before),
            _ => None,
        }
    }
}

/// Adds a pose in its order; of as many as are kept the oldest goes, and of those of one time the first counts.
fn add(recent: &mut VecDeque<(i64, Pose)>, nanos: i64, pose: Pose) {
    let position = recent.partition_point(|(time, _)| *time < nanos);
    if recent.get(position).is_some_and(|(time, _)| *time == nanos) {
        return;
    }
    if recent.len() < MOST_POSES {
        recent.insert(position, (nanos, pose));
    } else if position > 0 {
        recent.pop_front();
        recent.insert(position - 1, (nanos, pose));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    fn pose(x: f64) -> Pose {
        Pose { position_metres: [x, 0.0, 0.0], orientation: Pose::UPRIGHT }
    }

    /// Poses at x metres after as many seconds.
    fn poses(seconds: &[i64]) -> LivePoses {
        let teller = Teller::Gpsd(Gpsd::watch("127.0.0.1:1".to_owned()).unwrap());
        let mut poses = LivePoses::of(teller);
        seconds.iter().for_each(|&second| add(&mut poses.recent, second * SECOND, pose(second as f64)));
        poses
    }

    #[test]
    fn between_two_poses_the_robot_goes_evenly_and_after_the_last_it_stays_a_while() {
        // They may come in any order.
        let poses = poses(&[4, 2, 9, 3]);
        let at =
            |seconds: f64| poses.at((seconds * SECOND as f64) as i64).map(|pose| pose.position_metres[0]);
        assert_eq!([2.0, 2.5, 3.0, 3.75].map(at), [2.0, 2.5, 3.0, 3.75].map(Some));
        assert_eq!([9.0, 10.5, 11.0].map(at), [Some(9.0); 3]);
        assert_eq!([1.9, 5.0, 8.9, 11.1].map(at), [None; 4]);
    }

    #[test]
    fn no_more_than_the_latest_are_kept() {
        let seconds: Vec<i64> = (0..3000).collect();
        let mut poses = poses(&seconds);
        add(&mut poses.recent, 5, pose(0.0));
        assert_eq!((poses.recent.len(), poses.recent[0].0), (MOST_POSES, 1000 * SECOND));
        assert!(poses.recent.iter().is_sorted_by_key(|(nanos, _)| *nanos));
    }
}
