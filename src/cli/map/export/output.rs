//! Where an export goes: to a file that is replaced whole or not at all, or to stdout.

use std::io::{self, BufWriter, Stdout, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use loci::storage::{Replacement, StorageError};

enum Sink {
    File(Replacement),
    Stdout(BufWriter<Stdout>),
}

/// Takes an export's bytes, and remembers why they could not be written: what is in between tells it less well.
pub(super) struct Output {
    sink: Sink,
    path: PathBuf,
    failure: Option<io::Error>,
    /// Set once nobody reads any more.
    stop: Arc<AtomicBool>,
}

impl Output {
    /// The file `path`, or stdout.
    pub(super) fn create(path: &Path, stop: Arc<AtomicBool>) -> Result<Self, StorageError> {
        let (sink, path) = match path.to_str() {
            Some(super::STDOUT) => (Sink::Stdout(BufWriter::new(io::stdout())), PathBuf::from("stdout")),
            _ => (Sink::File(Replacement::create(path)?), path.to_owned()),
        };
        Ok(Self { sink, path, failure: None, stop })
    }

    /// Puts the file in its place if it was `written`; whether all of it went where it should. Whoever reads stdout
    /// may have seen enough and gone: that is no failure.
    pub(super) fn finish(mut self, written: anyhow::Result<()>) -> anyhow::Result<bool> {
        let written = written.and_then(|()| Ok(self.flush()?));
        if let Some(failure) = self.failure {
            let is_seen_enough =
                matches!(self.sink, Sink::Stdout(_)) && failure.kind() == io::ErrorKind::BrokenPipe;
            return match is_seen_enough {
                true => Ok(false),
                false => Err(StorageError::io("write", &self.path)(failure).into()),
            };
        }
        written?;
        if let Sink::File(file) = self.sink {
            file.finish()?;
        }
        Ok(true)
    }

    /// Keeps the first failure and answers one of its kind.
    fn remember(&mut self, failure: io::Error) -> io::Error {
        let kind = failure.kind();
        self.stop.store(true, Ordering::Relaxed);
        self.failure.get_or_insert(failure);
        kind.into()
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = match &mut self.sink {
            Sink::File(file) => file.write(bytes),
            Sink::Stdout(stdout) => stdout.write(bytes),
        };
        written.map_err(|failure| self.remember(failure))
    }

    fn flush(&mut self) -> io::Result<()> {
        let flushed = match &mut self.sink {
            Sink::File(file) => file.flush(),
            Sink::Stdout(stdout) => stdout.flush(),
        };
        flushed.map_err(|failure| self.remember(failure))
    }
}
