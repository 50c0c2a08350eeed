//! A camera through V4L2: `v4l2:/dev/video0?size=640x480&fps=30&format=mjpg`.
//!
//! Frames are awaited for two seconds at most, so whoever asks for them soon hears of a camera that hangs.
//! What goes wrong with one frame is told and the next call goes on; a camera that is gone, or keeps
//! silent several times in a row, ends the stream.

mod device;
mod pixels;
mod spec;
mod stream;
mod timing;

use std::io;
use std::time::{Duration, Instant};

use v4l::buffer::{Flags, Metadata};

use self::device::{Delivery, ENODEV};
use self::spec::{CameraSpec, PixelFormat};
use self::stream::BufferStream;
use self::timing::{CaptureClock, Sampling};
use super::{FrameSource, SourceError, codec};
use crate::frame::Frame;
use crate::kernel::luma;
use crate::raster::RgbImage;

/// How long a frame is awaited.
const TIMEOUT: Duration = Duration::from_secs(2);
/// Failures in a row after which the camera is given up.
const MAX_FAILURES: u32 = 5;

/// Frames of a camera.
pub(super) struct CameraSource {
    stream: BufferStream,
    developer: Developer,
    sampling: Sampling,
    clock: CaptureClock,
    /// Failures since the last frame that arrived.
    failures: u32,
    is_ended: bool,
}

impl CameraSource {
    /// Opens the camera of `text`, `DEVICE?size=WxH&fps=N&format=mjpg|yuyv|nv12|grey`, and hands out every
    /// `sample_interval`-th frame, by default about three a second. Where the driver gives another size or
    /// rate than asked for, that is what the frames have.
    ///
    /// # Errors
    /// If `text` makes no sense, or there is no such camera, or it cannot be used.
    pub(super) fn open(text: &str, sample_interval: Option<u64>) -> Result<Self, SourceError> {
        let named = text.split('?').next().filter(|device| !device.is_empty());
        let device = named.unwrap_or("(none)").to_owned();
        let refused = |reason| SourceError::Camera { device: device.clone(), reason };
        let spec = CameraSpec::parse(text).map_err(refused)?;
        let (opened, delivery) = device::open(&spec).map_err(refused)?;
        let stream = BufferStream::open(opened).map_err(|error| refused(device::reason(&error)))?;
        Ok(Self {
            stream,
            sampling: Sampling::new(sample_interval, delivery.fps),
            developer: Developer { device, delivery },
            clock: CaptureClock::default(),
            failures: 0,
            is_ended: false,
        })
    }

    /// The next frame that is due; those before it are dropped as they are.
    fn due_frame(&mut self) -> Result<Frame, SourceError> {
        let mut deadline = Instant::now() + TIMEOUT;
        loop {
            let (bytes, metadata) = match self.stream.next(deadline) {
                Ok(buffer) => buffer,
                Err(error) => {
                    self.sampling.restart();
                    // A signal to the program is no fault of the camera.
                    if error.kind() == io::ErrorKind::Interrupted && Instant::now() < deadline {
                        continue;
                    }
                    return Err(self.failed(&error));
                }
            };
            let arrival_nanos = timing::wall_nanos();
            deadline = Instant::now() + TIMEOUT;
            self.failures = 0;
            let index = self.sampling.index(metadata.sequence);
            let capture_nanos = self.clock.capture_nanos(timing::stamp_nanos(&metadata), arrival_nanos);
            if self.sampling.is_due(index) {
                return self.developer.frame(bytes, &metadata, (index, capture_nanos));
            }
        }
    }

    /// Counts a failure of the stream, and ends it when there are too many.
    fn failed(&mut self, error: &io::Error) -> SourceError {
        self.failures += 1;
        let is_gone = error.raw_os_error() == Some(ENODEV);
        self.is_ended = is_gone || self.failures >= MAX_FAILURES;
        let mut reason = match error.kind() {
            _ if is_gone => "it was unplugged; plug it in and start again".to_owned(),
            io::ErrorKind::TimedOut => {
                format!("no frame within {} s; check the cable and the USB port", TIMEOUT.as_secs())
            }
            _ => device::reason(error),
        };
        if self.is_ended && !is_gone {
            reason = format!("given up after {MAX_FAILURES} failures in a row: {reason}");
        }
        self.developer.error(reason)
    }
}

impl FrameSource for CameraSource {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        (!self.is_ended).then(|| self.due_frame())
    }

    fn frame_count(&self) -> Option<u64> {
        None
    }
}

/// Makes frames of buffers.
struct Developer {
    device: String,
    delivery: Delivery,
}

impl Developer {
    /// The frame in `bytes`, with its number and time of capture.
    fn frame(&self, bytes: &[u8], metadata: &Metadata, taken: (u64, i64)) -> Result<Frame, SourceError> {
        let (index, capture_nanos) = taken;
        let name = format!("{}#{index:06}", self.device);
        let spoilt = |reason| self.error(format!("frame {index}: {reason}; try another cable or USB port"));
        if metadata.flags.contains(Flags::ERROR) {
            return Err(spoilt("the driver says that it is damaged".to_owned()));
        }
        let Delivery { format, layout, range, .. } = self.delivery;
        let (colour, grey, jpeg) = match format {
            PixelFormat::Mjpg => {
                let jpeg = without_padding(bytes);
                if jpeg.is_empty() {
                    return Err(spoilt("it is empty".to_owned()));
                }
                let colour = codec::decode(jpeg, &name).map_err(|error| spoilt(what_is_wrong(error)))?;
                (colour, None, Some(jpeg.to_vec()))
            }
            PixelFormat::Yuyv => (pixels::rgb_from_yuyv(bytes, layout, range).map_err(spoilt)?, None, None),
            PixelFormat::Nv12 => (pixels::rgb_from_nv12(bytes, layout, range).map_err(spoilt)?, None, None),
            PixelFormat::Grey => {
                let grey = pixels::grey_from_grey(bytes, layout).map_err(spoilt)?;
                (RgbImage::from_grey(&grey), Some(grey), None)
            }
        };
        let grey = grey.unwrap_or_else(|| luma(&colour));
        Ok(Frame { index, capture_nanos, name, colour, grey, jpeg, pose: None, true_place: None })
    }

    fn error(&self, reason: String) -> SourceError {
        SourceError::Camera { device: self.device.clone(), reason }
    }
}

/// A JPEG ends with an end marker; some drivers fill up the first buffers behind it with zeros.
fn without_padding(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    &bytes[..end]
}

/// What the decoder says without its advice, which is about files.
fn what_is_wrong(error: SourceError) -> String {
    match error {
        SourceError::BadImage { reason, .. } => reason.split("; ").next().unwrap_or_default().to_owned(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::camera::pixels::{Layout, Range};

    const TAKEN: (u64, i64) = (123, 456);

    fn developer(format: PixelFormat) -> Developer {
        let layout = Layout { width_px: 40, height_px: 32, stride_bytes: 0 };
        let delivery = Delivery { format, layout, range: Range::Limited, fps: None };
        Developer { device: "/dev/video0".to_owned(), delivery }
    }

    fn reason(text: &str) -> String {
        let message = CameraSource::open(text, None).map(|_| ()).unwrap_err().to_string();
        assert!(!message.contains('\n'), "{message}");
        message
    }

    #[test]
    fn a_device_that_cannot_be_a_camera_is_named_with_the_fix() {
        let missing = reason("/dev/video-of-nobody?size=640x480");
        assert!(missing.starts_with("camera /dev/video-of-nobody: there is no such device; "), "{missing}");
        let file = tempfile::NamedTempFile::new().unwrap();
        for path in ["/dev/null", "/dev", file.path().to_str().unwrap()] {
            let message = reason(path);
            let expected = format!("camera {path}: it is not a video capture device; ");
            assert!(message.starts_with(&expected), "{message}");
        }
        assert!(reason("?fps=30").starts_with("camera (none): no device is named; "));
        assert!(reason("/dev/video0?sise=1x1").starts_with("camera /dev/video0: there is no key 'sise'; "));
    }

    #[test]
    fn a_padded_mjpg_frame_becomes_a_frame_with_its_jpeg() {
        let jpeg = codec::jpeg(&RgbImage::new(40, 32));
        let padded = [jpeg.as_slice(), &[0; 100]].concat();
        let frame = developer(PixelFormat::Mjpg).frame(&padded, &Metadata::default(), TAKEN).unwrap();
        assert_eq!(frame.jpeg, Some(jpeg));
        assert_eq!((frame.index, frame.capture_nanos, frame.name.as_str()), (123, 456, "/dev/video0#000123"));
        assert_eq!((frame.colour.width(), frame.grey.height()), (40, 32));
    }

    #[test]
    fn a_broken_frame_is_reported_with_its_number() {
        let jpeg = codec::jpeg(&RgbImage::new(40, 32));
        let cases = [
            (PixelFormat::Mjpg, &jpeg[..jpeg.len() - 2], "the JPEG is cut off"),
            (PixelFormat::Mjpg, &[0; 50], "it is empty"),
            (PixelFormat::Yuyv, &[0; 2559], "the frame is cut off: 2559 of 2560 bytes arrived"),
            (PixelFormat::Nv12, &[0; 1919], "the frame is cut off: 1919 of 1920 bytes arrived"),
            (PixelFormat::Grey, &[0; 1279], "the frame is cut off: 1279 of 1280 bytes arrived"),
        ];
        for (format, bytes, what) in cases {
            let error = developer(format).frame(bytes, &Metadata::default(), TAKEN).unwrap_err().to_string();
            let expected = format!("camera /dev/video0: frame 123: {what}; try another cable or USB port");
            assert_eq!(error, expected);
        }
        let damaged = Metadata { flags: Flags::ERROR, ..Metadata::default() };
        let error = developer(PixelFormat::Grey).frame(&[0; 1280], &damaged, TAKEN).unwrap_err().to_string();
        assert!(error.contains("frame 123: the driver says that it is damaged"), "{error}");
    }

    #[test]
    fn raw_frames_have_the_luma_of_the_camera() {
        let frame = developer(PixelFormat::Grey).frame(&[77; 1280], &Metadata::default(), TAKEN).unwrap();
        assert_eq!((frame.grey.get(39, 31), frame.colour.row(31)[119]), (77, 77));
        assert!(frame.jpeg.is_none());
        for (format, bytes) in [(PixelFormat::Yuyv, &[128; 2560][..]), (PixelFormat::Nv12, &[128; 1920])] {
            let frame = developer(format).frame(bytes, &Metadata::default(), TAKEN).unwrap();
            assert_eq!((frame.grey.get(39, 31), frame.colour.row(31)[119]), (130, 130));
        }
    }
}
