//! The driver's buffers: opened anew after every error, and given back without a panic.
//!
//! After an error the V4L2 library would queue a buffer twice at the next call and be refused for ever,
//! hence the new stream.

use std::io;
use std::mem;
use std::time::{Duration, Instant};

use v4l::Device;
use v4l::buffer::{Metadata, Type};
use v4l::io::traits::{CaptureStream, Stream as _};
use v4l::prelude::MmapStream;

use super::device::{self, Delivery, ENODEV, unpanicked};
use super::driver::Stream;
use super::query;

/// Buffers that the driver fills in turn; one is read while the others wait.
const BUFFERS: u32 = 4;

/// A stream of a camera's buffers.
pub(super) struct BufferStream {
    device: Device,
    /// `None` after a stream could not be opened.
    buffers: Option<Buffers>,
    is_broken: bool,
}

impl BufferStream {
    /// Takes the camera for us; it begins to send with the first call of [`next`](Self::next).
    pub(super) fn open(device: Device) -> io::Result<Self> {
        let buffers = Some(Buffers::allocate(&device)?);
        Ok(Self { device, buffers, is_broken: false })
    }
}

impl Stream for BufferStream {
    fn next(&mut self, deadline: Instant) -> io::Result<(&[u8], Metadata)> {
        if mem::take(&mut self.is_broken) {
            // Before anything else: the driver lends its buffers only once.
            self.buffers = None;
        }
        let buffers = match &mut self.buffers {
            Some(buffers) => buffers,
            none => none.insert(Buffers::allocate(&self.device)?),
        };
        let answer = buffers.next(deadline.saturating_duration_since(Instant::now()));
        self.is_broken = answer.is_err();
        let (bytes, metadata) = answer?;
        // The buffer is as long as the longest frame; this one ends where the driver says.
        let length = bytes.len().min(metadata.bytesused as usize);
        Ok((&bytes[..length], metadata))
    }

    fn is_gone(&self) -> bool {
        query::card(&self.device).is_err_and(|error| error.raw_os_error() == Some(ENODEV))
    }

    fn has_changed(&self, delivery: &Delivery) -> bool {
        device::has_changed(&self.device, delivery)
    }
}

/// Buffers on loan from the driver. Holds a stream for as long as it lives.
struct Buffers(Option<MmapStream<'static>>);

impl Buffers {
    fn allocate(device: &Device) -> io::Result<Self> {
        Ok(Self(Some(MmapStream::with_buffers(device, Type::VideoCapture, BUFFERS)?)))
    }

    fn next(&mut self, timeout: Duration) -> io::Result<(&[u8], Metadata)> {
        let stream = self.0.as_mut().ok_or(io::ErrorKind::NotConnected)?;
        stream.set_timeout(timeout);
        let (bytes, metadata) = CaptureStream::next(stream)?;
        Ok((bytes, *metadata))
    }
}

impl Drop for Buffers {
    /// The V4L2 library panics in `drop` where the driver refuses to stop, so that is tried first: what
    /// cannot be stopped is left to the end of the program.
    fn drop(&mut self) {
        let Some(mut stream) = self.0.take() else { return };
        match stream.stop() {
            Err(error) if error.raw_os_error() != Some(ENODEV) => mem::forget(stream),
            _ => {
                unpanicked(|| drop(stream));
            }
        }
    }
}
