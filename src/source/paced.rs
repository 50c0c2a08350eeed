//! Recorded frames played as if a camera took them now: at their own pace, whether anybody keeps up or not.

use std::thread;
use std::time::{Duration, Instant};

use super::{FrameSource, SourceError, wall_nanos};
use crate::frame::Frame;

/// Frames of another source, one every so often, each of which counts as captured when it is due.
pub struct PacedSource {
    frames: Box<dyn FrameSource>,
    interval: Duration,
    /// When the next frame is due; the first one is at once.
    due: Option<Instant>,
    lost: u64,
}

impl PacedSource {
    /// The frames of `frames`, so many a second.
    #[must_use]
    pub fn new(frames: Box<dyn FrameSource>, fps: f64) -> Self {
        Self { frames, interval: Duration::from_secs_f64(1.0 / fps), due: None, lost: 0 }
    }

    /// Passes over the frames whose time went by while this one was read: a camera would not have waited.
    fn catch_up(&mut self, due: Instant) -> Instant {
        let late = due.elapsed();
        if late < self.interval {
            return due;
        }
        let missed = late.as_nanos() / self.interval.as_nanos();
        self.lost = self.lost.saturating_add(u64::try_from(missed).unwrap_or(u64::MAX));
        due + self.interval.saturating_mul(u32::try_from(missed).unwrap_or(u32::MAX))
    }
}

impl FrameSource for PacedSource {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        self.next_frame_in(None)
    }

    fn next_frame_in(&mut self, spare: Option<Frame>) -> Option<Result<Frame, SourceError>> {
        let due = self.due.unwrap_or_else(Instant::now);
        let due = self.catch_up(due);
        thread::sleep(due.saturating_duration_since(Instant::now()));
        self.due = Some(due + self.interval);
        // Only now, for a camera's frame is decoded after it was captured.
        let frame = self.frames.next_frame_in(spare)?;
        let age_nanos = i64::try_from(due.elapsed().as_nanos()).unwrap_or(i64::MAX);
        Some(frame.map(|frame| Frame { capture_nanos: wall_nanos().saturating_sub(age_nanos), ..frame }))
    }

    fn frame_count(&self) -> Option<u64> {
        self.frames.frame_count()
    }

    fn is_live(&self) -> bool {
        true
    }

    fn take_notice(&mut self) -> Option<String> {
        self.frames.take_notice()
    }

    fn lost_frames(&self) -> u64 {
        self.frames.lost_frames().saturating_add(self.lost)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames, each of which takes a while to be read.
    struct Recorded {
        frames: u64,
        reading: Duration,
        index: u64,
    }

    impl FrameSource for Recorded {
        fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
            thread::sleep(self.reading);
            self.index += 1;
            (self.index <= self.frames).then(|| Ok(Frame::numbered(self.index - 1)))
        }

        fn frame_count(&self) -> Option<u64> {
            Some(self.frames)
        }
    }

    fn played(frames: u64, reading_ms: u64, fps: f64) -> (PacedSource, Vec<i64>) {
        let recorded = Recorded { frames, reading: Duration::from_millis(reading_ms), index: 0 };
        let mut source = PacedSource::new(Box::new(recorded), fps);
        let times = std::iter::from_fn(|| source.next_frame()).map(|frame| frame.unwrap().capture_nanos);
        let times = times.collect();
        (source, times)
    }

    #[test]
    fn frames_come_at_their_rate_and_are_as_old_as_they_are_late() {
        let started = wall_nanos();
        let (source, times) = played(20, 0, 200.0);
        assert_eq!((times.len(), source.is_live(), source.frame_count()), (20, true, Some(20)));
        let last = times[19] - started;
        assert!(last >= 90_000_000, "{last}");
        assert!(times.is_sorted(), "{times:?}");
    }

    #[test]
    fn what_goes_by_while_a_frame_is_read_is_lost_as_it_would_be_of_a_camera() {
        let (source, times) = played(10, 25, 100.0);
        assert!((10..1000).contains(&source.lost_frames()), "{}", source.lost_frames());
        // Each counts as captured when it was due, less than an interval before it was read.
        assert!(times.windows(2).all(|pair| pair[1] - pair[0] >= 15_000_000), "{times:?}");
    }
}
