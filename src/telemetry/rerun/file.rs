//! A recording on the disk, in one file or one after the other.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use ::rerun::sink::FileSinkError;
use ::rerun::{RecordingStream, RecordingStreamBuilder, RecordingStreamError};

use super::MAX_WRITING;
use super::rotation::{Files, Rotation};

/// Waits until the disk has what was logged.
pub(super) fn written(stream: &RecordingStream) -> Result<(), String> {
    stream.flush_with_timeout(MAX_WRITING).map_err(|error| format!("{error}; is the disk full?"))
}

/// The file that is written, and those that come after it.
pub(super) struct RecordingFile {
    path: PathBuf,
    rotation: Rotation,
    /// Where the recording goes on; `None` if it stays in one file.
    files: Option<Files>,
    /// When the file's first frame was captured.
    begun_nanos: Option<i64>,
    /// All files are parts of one recording: a viewer that opens several shows them as one.
    recording: Option<String>,
}

impl RecordingFile {
    /// Nothing is written before [`begin`](Self::begin).
    pub(super) fn new(path: &Path, rotation: Rotation) -> Result<Self, String> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        match folder {
            Some(folder) if !folder.is_dir() => {
                return Err(format!("there is no folder {}; create it first", folder.display()));
            }
            _ if path.is_dir() => return Err("that is a folder; name a file in it".to_owned()),
            _ => {}
        }
        let files = rotation.happens().then(|| Files::of(path, rotation)).transpose();
        let files = files.map_err(|error| format!("cannot read its folder: {error}"))?;
        Ok(Self { path: path.to_owned(), rotation, files, begun_nanos: None, recording: None })
    }

    /// Begins the only file, or the next one.
    pub(super) fn begin(&mut self) -> Result<RecordingStream, String> {
        super::check_switch()?;
        if let Some(files) = &mut self.files {
            self.path = files.next().map_err(|error| format!("cannot write the next file: {error}"))?;
        }
        let builder = RecordingStreamBuilder::new(super::APPLICATION);
        let builder = match &self.recording {
            Some(recording) => builder.recording_id(recording.as_str()).send_properties(true),
            None => builder,
        };
        let stream = builder.save(&self.path).map_err(|error| match error {
            RecordingStreamError::FileSink(FileSinkError::CreateFile { source, .. }) => {
                format!("cannot write the file: {source}")
            }
            error => error.to_string(),
        })?;
        self.recording = stream.store_info().map(|info| info.recording_id().to_string());
        Ok(stream)
    }

    /// Whether the file is done before the frame that was captured then, which is the first one of the next file.
    pub(super) fn is_over(&mut self, capture_nanos: i64) -> bool {
        if self.files.is_none() {
            return false;
        }
        // A clock that was set back is believed: the file is as old as its oldest frame.
        let begun = self.begun_nanos.map_or(capture_nanos, |begun| begun.min(capture_nanos));
        self.begun_nanos = Some(begun);
        // What cannot be asked for its size is told of when it is closed.
        let bytes = fs::metadata(&self.path).map_or(0, |metadata| metadata.len());
        let is_over = self.rotation.is_over(bytes, capture_nanos.saturating_sub(begun));
        if is_over {
            self.begun_nanos = Some(capture_nanos);
        }
        is_over
    }

    /// Refuses a file that does not end as recordings do.
    pub(super) fn check_end(&self) -> Result<(), String> {
        match ends_complete(&self.path) {
            Ok(true) => Ok(()),
            _ => Err("the file is cut off; is the disk full?".to_owned()),
        }
    }
}

/// Whether the recording `file` ends as rerun ends them: with `RRF2`, `FOOT`, and where the footer is.
fn ends_complete(file: &Path) -> io::Result<bool> {
    const END_BYTES: usize = 64;
    let mut file = File::open(file)?;
    file.seek(SeekFrom::End(-(END_BYTES as i64)))?;
    let mut end = [0; END_BYTES];
    file.read_exact(&mut end)?;
    Ok(end.windows(8).any(|bytes| bytes == b"RRF2FOOT"))
}
