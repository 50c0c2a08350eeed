//! Which frames are handed out, under which number and time.
//!
//! A driver numbers the frames that its sensor took, so a gap is a frame that nobody fetched in time. It
//! stamps them with the monotonic clock, which counts from the computer's start.

use rustix::time::{ClockId, clock_gettime};
use v4l::buffer::{Flags, Metadata};

use crate::source::wall_nanos;

/// Frames a second that are handed out unless another interval is asked for.
const DEFAULT_RATE_HZ: f64 = 3.0;
/// Frames a second of a camera whose driver does not say.
const USUAL_FPS: f64 = 30.0;

/// A driver that seems to skip as many numbers counts anew.
const MAX_GAP: u32 = 1 << 31;

/// Numbers frames, counts those that are missing and picks every `interval`-th; numbers only ever grow.
#[derive(Debug)]
pub(super) struct Sampling {
    /// The interval that was asked for.
    wished: Option<u64>,
    interval: u64,
    /// What is added to the driver's numbers, which begin anew with every stream.
    base: u64,
    /// The lowest number that is still free.
    free: u64,
    /// The number from which on the next frame is handed out.
    due: u64,
    /// The driver's number of the next frame of this stream, once it has begun.
    expected: Option<u32>,
    /// Frames of all streams that were never fetched.
    lost: u64,
}

impl Sampling {
    /// Hands out every `interval`-th frame; by default about three a second of a camera that takes `fps`.
    pub(super) fn new(interval: Option<u64>, fps: Option<f64>) -> Self {
        let mut sampling =
            Self { wished: interval, interval: 1, base: 0, free: 0, due: 0, expected: None, lost: 0 };
        sampling.begin_anew(fps);
        sampling
    }

    /// The camera was opened anew and takes `fps`: its next frame is handed out.
    pub(super) fn begin_anew(&mut self, fps: Option<f64>) {
        let default = || (fps.unwrap_or(USUAL_FPS) / DEFAULT_RATE_HZ).round() as u64;
        self.interval = self.wished.unwrap_or_else(default).max(1);
        self.due = self.free;
        self.restart();
    }

    /// The number of the frame that the driver calls `sequence`. Some drivers call all frames 0.
    pub(super) fn index(&mut self, sequence: u32) -> u64 {
        let missing = self.expected.map_or(0, |expected| sequence.wrapping_sub(expected));
        if missing < MAX_GAP {
            self.lost = self.lost.saturating_add(missing.into());
        }
        self.expected = Some(sequence.wrapping_add(1));
        let index = self.base.saturating_add(u64::from(sequence)).max(self.free);
        self.free = index.saturating_add(1);
        index
    }

    /// Frames that the sensor took and nobody fetched in time, within streams.
    pub(super) fn lost(&self) -> u64 {
        self.lost
    }

    /// The driver's numbers begin anew.
    pub(super) fn restart(&mut self) {
        self.base = self.free;
        self.expected = None;
    }

    /// Whether the frame of this number is to be handed out; asked once a frame.
    pub(super) fn is_due(&mut self, index: u64) -> bool {
        let is_due = index >= self.due;
        if is_due {
            self.due = index.saturating_add(self.interval);
        }
        is_due
    }
}

/// Maps the driver's clock to the wall clock, once, at the first frame: a later correction of the wall clock does not
/// tear the stream.
#[derive(Debug, Default)]
pub(super) struct CaptureClock {
    wall_nanos_at_zero: Option<i64>,
}

impl CaptureClock {
    /// Time of capture in nanoseconds since the Unix epoch of a frame stamped `stamp_nanos`, the clocks standing at
    /// `now`; of a frame without a stamp it is now.
    pub(super) fn capture_nanos(&mut self, stamp_nanos: Option<i64>, now: Clocks) -> i64 {
        let Some(stamp) = stamp_nanos else { return now.wall_nanos };
        let zero = now.wall_nanos.saturating_sub(now.monotonic_nanos);
        self.wall_nanos_at_zero.get_or_insert(zero).saturating_add(stamp)
    }
}

/// What two clocks show at the same time: the wall clock since the Unix epoch, and the one that drivers stamp with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clocks {
    wall_nanos: i64,
    monotonic_nanos: i64,
}

impl Clocks {
    pub(super) fn now() -> Self {
        let monotonic = clock_gettime(ClockId::Monotonic);
        let monotonic_nanos =
            monotonic.tv_sec.saturating_mul(1_000_000_000).saturating_add(monotonic.tv_nsec);
        Self { wall_nanos: wall_nanos(), monotonic_nanos }
    }
}

/// The monotonic time of a buffer in nanoseconds, if the driver stamped it with that.
pub(super) fn stamp_nanos(metadata: &Metadata) -> Option<i64> {
    let is_monotonic = metadata.flags & Flags::TIMESTAMP_MASK == Flags::TIMESTAMP_MONOTONIC;
    let micros = metadata.timestamp.sec.checked_mul(1_000_000)?.checked_add(metadata.timestamp.usec)?;
    micros.checked_mul(1000).filter(|nanos| is_monotonic && *nanos > 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use v4l::timestamp::Timestamp;

    fn handed_out(sampling: &mut Sampling, sequences: impl IntoIterator<Item = u32>) -> Vec<u64> {
        let mut indices = Vec::new();
        for sequence in sequences {
            let index = sampling.index(sequence);
            if sampling.is_due(index) {
                indices.push(index);
            }
        }
        indices
    }

    #[test]
    fn about_three_frames_a_second_are_handed_out_by_default() {
        let interval = |fps| Sampling::new(None, fps).interval;
        assert_eq!([Some(30.0), Some(25.0), Some(5.0), Some(1.0), None].map(interval), [10, 8, 2, 1, 10]);
        assert_eq!(Sampling::new(Some(4), Some(30.0)).interval, 4);
        assert_eq!(Sampling::new(Some(0), None).interval, 1);
    }

    #[test]
    fn a_dropped_frame_leaves_a_gap_and_does_not_delay_the_next() {
        let mut sampling = Sampling::new(Some(3), None);
        assert_eq!(handed_out(&mut sampling, [0, 1, 2, 3, 4, 8, 9, 10, 11]), [0, 3, 8, 11]);
    }

    #[test]
    fn a_driver_that_does_not_count_is_counted_for() {
        assert_eq!(handed_out(&mut Sampling::new(Some(2), None), [0; 5]), [0, 2, 4]);
    }

    #[test]
    fn numbers_go_on_when_the_stream_is_reopened() {
        let mut sampling = Sampling::new(Some(1), None);
        assert_eq!(handed_out(&mut sampling, [0, 1, 5]), [0, 1, 5]);
        sampling.restart();
        assert_eq!(handed_out(&mut sampling, [0, 2]), [6, 8]);
    }

    #[test]
    fn a_camera_that_is_opened_anew_gives_its_next_frame_and_samples_by_its_new_rate() {
        let mut sampling = Sampling::new(None, Some(30.0));
        assert_eq!(handed_out(&mut sampling, 0..=12), [0, 10]);
        sampling.begin_anew(Some(6.0));
        assert_eq!(handed_out(&mut sampling, 0..=4), [13, 15, 17]);
        let mut wished = Sampling::new(Some(4), Some(30.0));
        wished.begin_anew(Some(6.0));
        assert_eq!(handed_out(&mut wished, 0..=8), [0, 4, 8]);
    }

    #[test]
    fn frames_that_nobody_fetched_are_counted_within_a_stream() {
        let mut sampling = Sampling::new(Some(3), None);
        let lost = |sampling: &mut Sampling, sequences: &[u32]| {
            handed_out(sampling, sequences.iter().copied());
            sampling.lost()
        };
        // What is missing before the first one was taken before anybody asked.
        assert_eq!(lost(&mut sampling, &[7, 8, 9]), 0);
        assert_eq!(lost(&mut sampling, &[12, 13, 15]), 3);
        // A number twice, and a driver that counts anew.
        assert_eq!(lost(&mut sampling, &[15, 0, 1]), 3);
        sampling.restart();
        assert_eq!(lost(&mut sampling, &[100, 102]), 4);
        sampling.begin_anew(None);
        assert_eq!(lost(&mut sampling, &[u32::MAX - 1, 1]), 6);
        assert_eq!(lost(&mut Sampling::new(None, None), &[0; 9]), 0);
    }

    #[test]
    fn the_clock_is_mapped_once() {
        let mut clock = CaptureClock::default();
        let at = |wall_nanos, monotonic_nanos| Clocks { wall_nanos, monotonic_nanos };
        // Stamped at 40, it arrives at 45.
        assert_eq!(clock.capture_nanos(Some(40), at(1_000_045, 45)), 1_000_040);
        assert_eq!(clock.capture_nanos(Some(50), at(7_777_777, 52)), 1_000_050);
        assert_eq!(clock.capture_nanos(None, at(7_777_778, 60)), 7_777_778);
    }

    #[test]
    fn only_a_monotonic_stamp_is_believed() {
        let metadata = |flags, sec, usec| Metadata {
            flags,
            timestamp: Timestamp::new(sec, usec),
            ..Metadata::default()
        };
        let monotonic = Flags::TIMESTAMP_MONOTONIC | Flags::TSTAMP_SRC_SOE | Flags::MAPPED;
        assert_eq!(stamp_nanos(&metadata(monotonic, 2, 3)), Some(2_000_003_000));
        assert_eq!(stamp_nanos(&metadata(Flags::TIMESTAMP_COPY, 2, 3)), None);
        assert_eq!(stamp_nanos(&metadata(Flags::TIMESTAMP_UNKNOWN, 2, 3)), None);
        assert_eq!(stamp_nanos(&metadata(monotonic, 0, 0)), None);
        assert_eq!(stamp_nanos(&metadata(monotonic, i64::MAX, 3)), None);
    }

    proptest! {
        #[test]
        fn numbers_only_grow(sequences in prop::collection::vec((any::<u32>(), any::<bool>()), 1..40)) {
            let mut sampling = Sampling::new(Some(1), None);
            let mut last = None;
            for (sequence, restarts) in sequences {
                if restarts {
                    sampling.restart();
                }
                let index = sampling.index(sequence);
                prop_assert!(Some(index) > last);
                last = Some(index);
            }
        }
    }
}
