//! Capture: frames are read as fast as the source has them, or the CPU budget allows.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use super::Watcher;
use super::intake::{Captured, Entrance, Passage};
use super::pacing::Pace;
use super::pool::Pool;
use super::stages::micros;
use crate::frame::Frame;
use crate::source::{FrameSource, SourceError, wall_nanos};
use crate::telemetry::Losses;

/// Frames whose memory is kept: more than are under way where nobody is slow, and in records that are kept.
const POOLED: usize = 48;
/// How long a source that can wait sleeps at most before it looks whether it is to stop.
const LONGEST_SLEEP: Duration = Duration::from_millis(100);
/// Age of a frame from which on its clock is not believed.
const OLDEST: Duration = Duration::from_secs(60);

/// What captures frames.
pub(super) struct Capture<'a> {
    pub(super) source: Box<dyn FrameSource>,
    pub(super) entrance: Entrance,
    pub(super) pace: Option<Pace>,
    pub(super) watcher: &'a dyn Watcher,
}

impl Capture<'_> {
    /// Reads frames until the source ends, `stop` is set or nobody takes them; answers which did not come through.
    pub(super) fn run(mut self, stop: &AtomicBool) -> Losses {
        let mut losses = Losses::default();
        let (mut frames, mut spare) = (Pool::new(POOLED), None);
        while !stop.load(Ordering::Relaxed) {
            let started = Instant::now();
            let next = self.source.next_frame_in(spare.take());
            losses.lost = self.source.lost_frames();
            if let Some(notice) = self.source.take_notice() {
                self.watcher.noticed(&notice);
            }
            let frame = match next {
                None => break,
                Some(Err(SourceError::NotYet)) => continue,
                Some(Err(error)) => {
                    self.watcher.skipped(&error);
                    losses.unreadable += 1;
                    continue;
                }
                Some(Ok(frame)) => frame,
            };
            let captured_at = self.captured_at(&frame, started);
            // Waiting for a camera's frame is no work.
            let decode_us = micros(captured_at);
            if !self.is_within_budget(stop) {
                losses.spared += 1;
                spare = Some(frame);
                continue;
            }
            let (frame, before) = frames.share(frame);
            spare = before;
            match self.entrance.put(Captured { frame, decode_us, captured_at, losses }) {
                Passage::Free => {}
                Passage::Displacing => losses.dropped += 1,
                Passage::Closed => break,
            }
        }
        losses
    }

    /// When the frame was captured, on the clock that latencies are measured with; for one from a file that is when
    /// reading it `started`.
    fn captured_at(&self, frame: &Frame, started: Instant) -> Instant {
        if !self.source.is_live() {
            return started;
        }
        let age_nanos = wall_nanos().saturating_sub(frame.capture_nanos);
        // A clock that was set meanwhile tells nothing.
        let age = u64::try_from(age_nanos).ok().map(Duration::from_nanos).filter(|age| *age < OLDEST);
        let now = Instant::now();
        age.and_then(|age| now.checked_sub(age)).unwrap_or(now)
    }

    /// Whether the frame fits into the budget; a source that can wait does so until it does.
    fn is_within_budget(&mut self, stop: &AtomicBool) -> bool {
        let Some(pace) = &mut self.pace else { return true };
        let mut wait = pace.wait();
        while !wait.is_zero() && !self.source.is_live() && !stop.load(Ordering::Relaxed) {
            thread::sleep(wait.min(LONGEST_SLEEP));
            wait = pace.wait();
        }
        wait.is_zero()
    }
}
