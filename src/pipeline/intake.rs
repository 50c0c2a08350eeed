//! The queue behind capture. Sources that can wait are held up by a full one; of a live source the oldest frame gives
//! way, so that what is looked at is never older than it has to be.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Instant;

use crossbeam_channel::{Receiver, Sender, TryRecvError, TrySendError, bounded};

use super::QUEUE_FRAMES;
use crate::frame::Frame;
use crate::telemetry::Losses;

/// A frame on its way.
#[derive(Clone)]
pub(super) struct Captured {
    pub(super) frame: Arc<Frame>,
    pub(super) decode_us: u64,
    /// When it was captured; where the source is not live, when reading it began.
    pub(super) captured_at: Instant,
    pub(super) losses: Losses,
}

/// Where capture puts frames.
pub(super) struct Entrance {
    queue: Sender<Captured>,
    live: Option<LiveSide>,
}

/// What a live source needs besides.
struct LiveSide {
    oldest: Receiver<Captured>,
    /// Closed when nobody takes frames any more: the queue itself stays open as long as this side holds both its ends.
    listener: Receiver<Infallible>,
}

/// Where frames are taken.
pub(super) struct Exit {
    queue: Receiver<Captured>,
    _listener: Sender<Infallible>,
}

/// What became of a frame that was put in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Passage {
    /// It is in the queue, behind others or not.
    Free,
    /// It is in the queue; the oldest one had to go.
    Displacing,
    /// Nobody takes frames any more.
    Closed,
}

/// Both ends of the queue. That of a live source holds one frame.
pub(super) fn intake(is_live: bool) -> (Entrance, Exit) {
    let (queue, taken) = bounded(if is_live { 1 } else { QUEUE_FRAMES });
    let (presence, listener) = bounded(0);
    let live = is_live.then(|| LiveSide { oldest: taken.clone(), listener });
    (Entrance { queue, live }, Exit { queue: taken, _listener: presence })
}

impl Entrance {
    /// Puts a frame in, waiting only where the source can.
    pub(super) fn put(&self, captured: Captured) -> Passage {
        let Some(live) = &self.live else {
            return if self.queue.send(captured).is_ok() { Passage::Free } else { Passage::Closed };
        };
        if live.listener.try_recv() == Err(TryRecvError::Disconnected) {
            return Passage::Closed;
        }
        let (mut passage, mut captured) = (Passage::Free, captured);
        while let Err(TrySendError::Full(refused)) = self.queue.try_send(captured) {
            captured = refused;
            // Whoever takes frames may have been faster.
            if live.oldest.try_recv().is_ok() {
                passage = Passage::Displacing;
            }
        }
        passage
    }
}

impl Exit {
    /// The next frame, with how many wait behind it; `None` when capture has ended.
    pub(super) fn take(&self) -> Option<(Captured, usize)> {
        let captured = self.queue.recv().ok()?;
        Some((captured, self.queue.len()))
    }
}

#[cfg(test)]
mod tests {
    use std::thread;
    use std::time::Duration;

    use super::*;

    fn captured(index: u64) -> Captured {
        let frame = Arc::new(Frame::numbered(index));
        Captured { frame, decode_us: 0, captured_at: Instant::now(), losses: Losses::default() }
    }

    fn taken(exit: &Exit) -> Option<u64> {
        exit.take().map(|(captured, _)| captured.frame.index)
    }

    #[test]
    fn of_a_live_source_the_newest_frame_is_taken_and_those_before_it_are_counted() {
        let (entrance, exit) = intake(true);
        let passages: Vec<Passage> = (0..4).map(|index| entrance.put(captured(index))).collect();
        assert_eq!(passages[0], Passage::Free);
        assert_eq!(passages[1..], [Passage::Displacing; 3]);
        assert_eq!(taken(&exit), Some(3));
        drop(entrance);
        assert_eq!(taken(&exit), None);
    }

    #[test]
    fn other_sources_wait_and_lose_nothing() {
        let (entrance, exit) = intake(false);
        let slow = thread::spawn(move || {
            let mut indices = Vec::new();
            while let Some(index) = taken(&exit) {
                thread::sleep(Duration::from_millis(1));
                indices.push(index);
            }
            indices
        });
        assert!((0..40).all(|index| entrance.put(captured(index)) == Passage::Free));
        drop(entrance);
        assert_eq!(slow.join().unwrap(), Vec::from_iter(0..40));
    }

    #[test]
    fn whoever_puts_frames_in_hears_that_nobody_takes_them() {
        for is_live in [false, true] {
            let (entrance, exit) = intake(is_live);
            drop(exit);
            assert_eq!(entrance.put(captured(0)), Passage::Closed);
        }
    }
}
