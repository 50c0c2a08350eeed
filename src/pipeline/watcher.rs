//! Who hears what happens while a stream runs.

use super::Seen;
use crate::cnn::{CnnError, ModelCard};
use crate::place_map::MapError;
use crate::source::SourceError;
use crate::telemetry::{FrameRecord, TelemetryError};

/// Hears what happens while a stream runs.
pub trait Watcher: Sync {
    /// A frame could not be read and was skipped.
    fn skipped(&self, error: &SourceError);
    /// The source says something that is no failure: what a camera gives, that it is back.
    fn noticed(&self, _notice: &str) {}
    /// Of a live stream, a sink failed and gets no more records.
    fn sink_failed(&self, _error: &TelemetryError) {}
    /// The CNN failed on a frame, which BoW+HV then decided alone.
    fn cnn_failed(&self, frame_name: &str, error: &CnnError);
    /// The map could not be read or changed; unless the robot `goes_on_learning`, it is only read from here on.
    fn map_failed(&self, failure: &MapError, goes_on_learning: bool);
    /// From the frame of this index on, frames are described by the model of `card`, for which so many keyframes were
    /// described anew.
    fn model_changed(&self, _card: &ModelCard, _frame_index: u64, _described_anew: usize) {}
    /// A model that was deployed is not used, for this reason; that of `in_use` goes on.
    fn model_refused(&self, _reason: &str, _in_use: &ModelCard) {}
    /// A frame was looked at.
    fn seen(&self, _seen: &Seen) {}
    /// A frame was decided.
    fn decided(&self, _record: &FrameRecord) {}
}
