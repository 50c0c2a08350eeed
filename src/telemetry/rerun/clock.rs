//! The timelines of a run: `frame`, the index in the stream, and `capture_time`, a date if the first frame's clock
//! stands later than 1971, else the time since the source began.

use ::rerun::{RecordingStream, TimeCell};

/// The timeline of frame indices.
pub(super) const FRAME_TIMELINE: &str = "frame";
/// The timeline of capture times.
pub(super) const TIME_TIMELINE: &str = "capture_time";
/// Clocks that stand earlier, in nanoseconds since the Unix epoch, count from the start of the source.
pub(super) const EARLIEST_DATE_NANOS: i64 = 365 * 24 * 3600 * 1_000_000_000;

/// What kind of clock the source has.
#[derive(Default)]
pub(super) struct Clock {
    /// Whether capture times are dates; the first frame tells.
    has_dates: Option<bool>,
}

impl Clock {
    /// Whatever is logged next belongs to this frame.
    pub(super) fn set(&mut self, stream: &RecordingStream, frame: u64, capture_nanos: i64) {
        let has_dates = *self.has_dates.get_or_insert(capture_nanos >= EARLIEST_DATE_NANOS);
        let time = if has_dates {
            TimeCell::from_timestamp_nanos_since_epoch(capture_nanos)
        } else {
            TimeCell::from_duration_nanos(capture_nanos)
        };
        stream.set_time(FRAME_TIMELINE, TimeCell::from_sequence(i64::try_from(frame).unwrap_or(i64::MAX)));
        stream.set_time(TIME_TIMELINE, time);
    }
}
