//! Recognitions as pictures and curves, for the [rerun](https://rerun.io) viewer.
//!
//! A viewer never holds up the stream: one that looks on live is behind the queue of [`live`], which
//! leaves frames out when it is too slow; only a recording to a file waits, for the disk.
//!
//! Everything is logged on two timelines: `frame`, the index in the stream, and `capture_time`, a date
//! if the first frame's clock stands later than 1971, else the time since the source began. Nothing is
//! logged against the computer's clock, so that a repeated run gives the same recording.

mod answer;
mod blueprint;
mod jpeg;
mod live;
mod scene;
mod style;
mod target;

#[cfg(test)]
mod tests;

pub use target::RerunTarget;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::mem;
use std::path::Path;
use std::time::Duration;

use ::rerun::sink::FileSinkError;
use ::rerun::{
    RecordingStream, RecordingStreamBuilder, RecordingStreamError, RecordingStreamResult, TimeCell,
};

use self::live::{Live, Relay};
use self::scene::Scene;
use self::target::one_line;
use super::{FrameRecord, RecognitionSink, TelemetryError};

/// The name under which viewers keep layouts of our recordings.
const APPLICATION: &str = "loci";
/// The program that shows recordings.
const VIEWER: &str = "rerun";
/// The timeline of frame indices.
const FRAME_TIMELINE: &str = "frame";
/// The timeline of capture times.
const TIME_TIMELINE: &str = "capture_time";
/// Clocks that stand earlier, in nanoseconds since the Unix epoch, count from the start of the source.
const EARLIEST_DATE_NANOS: i64 = 365 * 24 * 3600 * 1_000_000_000;
/// How long a disk may take for what is left at the end.
const MAX_WRITING: Duration = Duration::from_secs(20);

/// Shows recognitions in rerun.
pub struct RerunSink {
    target: RerunTarget,
    stream: RecordingStream,
    live: Option<Live>,
    scene: Scene,
    /// Whether capture times are dates; the first frame tells.
    has_dates: Option<bool>,
    /// Frames left out since the viewer fell behind.
    frames_left_out: u64,
}

impl RerunSink {
    /// Opens a recording to `target`; what goes to [`RerunTarget::Off`] is shown to nobody. A file that
    /// is there already is replaced. A viewer to connect to may come later.
    ///
    /// # Errors
    /// If the file cannot be written, the address is taken, or no viewer can be started.
    pub fn open(target: &RerunTarget) -> Result<Self, TelemetryError> {
        let (stream, live) = open(target).map_err(|reason| refusal(target, &reason))?;
        // Time comes from the frames alone.
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        answer::dress(&stream).map_err(|error| refusal(target, &error.to_string()))?;
        let target = target.clone();
        Ok(Self { target, stream, live, scene: Scene::default(), has_dates: None, frames_left_out: 0 })
    }

    fn show(&mut self, record: &FrameRecord) -> RecordingStreamResult<()> {
        self.set_time(record);
        if self.frames_left_out > 0 {
            answer::show_gap(&self.stream, mem::take(&mut self.frames_left_out))?;
        }
        self.scene.show(&self.stream, record)?;
        answer::show(&self.stream, record)
    }

    fn set_time(&mut self, record: &FrameRecord) {
        let nanos = record.frame.capture_nanos;
        let index = i64::try_from(record.frame.index).unwrap_or(i64::MAX);
        let has_dates = *self.has_dates.get_or_insert(nanos >= EARLIEST_DATE_NANOS);
        let time = if has_dates {
            TimeCell::from_timestamp_nanos_since_epoch(nanos)
        } else {
            TimeCell::from_duration_nanos(nanos)
        };
        self.stream.set_time(FRAME_TIMELINE, TimeCell::from_sequence(index));
        self.stream.set_time(TIME_TIMELINE, time);
    }

    /// Closes the recording; whatever is recorded afterwards is shown to nobody.
    fn close(&mut self) -> Result<(), String> {
        let stream = mem::replace(&mut self.stream, RecordingStream::disabled());
        let flushed = stream.flush_with_timeout(MAX_WRITING);
        drop(stream);
        if let Some(live) = self.live.take() {
            return if live.close() {
                Ok(())
            } else {
                Err("no viewer answered; start one with `rerun`".to_owned())
            };
        }
        let RerunTarget::Save(file) = &self.target else { return Ok(()) };
        flushed.map_err(|error| format!("{error}; is the disk full?"))?;
        if ends_complete(file) { Ok(()) } else { Err("the file is cut off; is the disk full?".to_owned()) }
    }
}

impl RecognitionSink for RerunSink {
    fn record(&mut self, record: &FrameRecord) -> Result<(), TelemetryError> {
        if self.live.as_ref().is_some_and(Live::is_behind) {
            self.frames_left_out += 1;
            return Ok(());
        }
        self.show(record).map_err(|error| refusal(&self.target, &error.to_string()))
    }

    fn finish(&mut self) -> Result<(), TelemetryError> {
        if !self.stream.is_enabled() {
            return Ok(());
        }
        self.close().map_err(|reason| refusal(&self.target, &reason))
    }

    fn shows_matched_keyframe(&self) -> bool {
        self.stream.is_enabled()
    }
}

fn open(target: &RerunTarget) -> Result<(RecordingStream, Option<Live>), String> {
    let builder = RecordingStreamBuilder::new(APPLICATION);
    match target {
        RerunTarget::Off => Ok((RecordingStream::disabled(), None)),
        RerunTarget::Save(file) => Ok((create(builder, file)?, None)),
        RerunTarget::Spawn => look_on(builder, live::spawn(VIEWER)?),
        RerunTarget::Connect(address) => look_on(builder, live::connect(address)?),
        RerunTarget::Serve(address) => look_on(builder, live::serve(*address)?),
    }
}

fn look_on(
    builder: RecordingStreamBuilder,
    (relay, live): (Relay, Live),
) -> Result<(RecordingStream, Option<Live>), String> {
    let stream = builder.buffered().map_err(|error| error.to_string())?;
    stream.set_sink(Box::new(relay));
    Ok((stream, Some(live)))
}

fn create(builder: RecordingStreamBuilder, file: &Path) -> Result<RecordingStream, String> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    match folder {
        Some(folder) if !folder.is_dir() => {
            return Err(format!("there is no folder {}; create it first", folder.display()));
        }
        _ if file.is_dir() => return Err("that is a folder; name a file in it".to_owned()),
        _ => {}
    }
    builder.save(file).map_err(|error| match error {
        RecordingStreamError::FileSink(FileSinkError::CreateFile { source, .. }) => {
            format!("cannot write the file: {source}")
        }
        error => error.to_string(),
    })
}

/// Whether the recording `file` ends as rerun ends them: with `RRF2`, `FOOT`, and where the footer is.
fn ends_complete(file: &Path) -> bool {
    const END_BYTES: usize = 64;
    let end = || {
        let mut file = File::open(file)?;
        file.seek(SeekFrom::End(-(END_BYTES as i64)))?;
        let mut end = [0; END_BYTES];
        file.read_exact(&mut end)?;
        Ok::<_, std::io::Error>(end)
    };
    end().is_ok_and(|end| end.windows(8).any(|bytes| bytes == b"RRF2FOOT"))
}

fn refusal(target: &RerunTarget, reason: &str) -> TelemetryError {
    TelemetryError::Rerun { target: target.to_string(), reason: one_line(reason) }
}
