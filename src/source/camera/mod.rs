//! A camera through V4L2: `v4l2:/dev/video0?size=640x480&fps=30&format=mjpg&exposure=100`.
//!
//! A robot is not stopped by its camera. What goes wrong with one frame is told and the next call goes on; a camera
//! that keeps silent is opened anew; one that is gone is looked for until it is there again, under another number
//! perhaps. Each trouble is told once, a damaged frame by itself, and so is the end. A frame is awaited for two
//! seconds, and a camera that is away for one, so whoever asks soon hears.

mod controls;
mod developer;
mod device;
mod driver;
mod listing;
mod outage;
mod pixels;
mod query;
mod search;
mod spec;
mod stream;
mod timing;

pub use listing::{Camera, CameraControl, CameraFormat, ControlItem, FrameRates, FrameSize, cameras};

use std::io;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use self::developer::Developer;
use self::device::ENODEV;
use self::driver::{Connected, Driver, Stream, V4l2};
use self::outage::Outage;
use self::search::{Identity, Search};
use self::spec::CameraSpec;
use self::timing::{CaptureClock, Clocks, Sampling};
use super::{FrameSource, SourceError};
use crate::frame::Frame;

/// Damaged frames in a row after which the camera is opened anew.
const MAX_DAMAGED: u32 = 3;
/// How often it is asked whether the camera is still there after an error that may be the first sign of its end.
const SIGNS_OF_LIFE: u32 = 4;

const UNPLUGGED: &str = "it was unplugged; waiting for it to come back";
const CHANGED: &str = "its format changed; opening it anew";

/// How long things take.
#[derive(Clone, Copy)]
struct Times {
    /// A frame is awaited for so long, or for two where the camera takes less than one a second.
    frame: Duration,
    /// Where no frame is due, or the camera is away, that is said after so long.
    answer: Duration,
    /// From one look for the camera to the next.
    pause: Duration,
}

const TIMES: Times = Times {
    frame: Duration::from_secs(2),
    answer: Duration::from_secs(1),
    pause: Duration::from_millis(250),
};
/// Longest time for which a frame of a slow camera is awaited.
const MAX_PATIENCE: Duration = Duration::from_secs(10);

/// Opens the camera of `text`, `DEVICE?size=WxH&fps=N&format=mjpg|yuyv|nv12|grey&CONTROL=VALUE`, and hands out every
/// `sample_interval`-th frame, by default about three a second. Where the driver gives another size or rate than asked
/// for, that is what the frames have.
///
/// # Errors
/// If `text` makes no sense, or there is no such camera, or it cannot be used.
pub(super) fn open(text: &str, sample_interval: Option<u64>) -> Result<Box<dyn FrameSource>, SourceError> {
    Ok(Box::new(CameraSource::open(V4l2, text, sample_interval)?))
}

/// Frames of a camera.
struct CameraSource<D: Driver> {
    driver: D,
    spec: CameraSpec,
    /// `None` while the camera is away.
    open: Option<OpenCamera<D::Stream>>,
    search: Search,
    sampling: Sampling,
    clock: CaptureClock,
    outage: Outage,
    /// Frames in a row that were damaged.
    damaged: u32,
    notice: Option<String>,
    times: Times,
}

/// A camera while it is there.
struct OpenCamera<S> {
    stream: S,
    developer: Developer,
    /// Who it is and what is said of it once it has sent a frame, after it was opened anew.
    greeting: Option<(Identity, String)>,
}

/// Why there is no frame.
enum Fault {
    NotYet,
    /// The frame is damaged, which is no fault of the stream.
    Frame(String),
    /// The camera gives something else than what was agreed on.
    Change,
    Stream(io::Error),
}

impl<D: Driver> CameraSource<D> {
    fn open(driver: D, text: &str, sample_interval: Option<u64>) -> Result<Self, SourceError> {
        let named = text.split('?').next().filter(|device| !device.is_empty());
        let device = named.unwrap_or("(none)").to_owned();
        let refused = |reason| SourceError::Camera { device: device.clone(), reason };
        let spec = CameraSpec::parse(text).map_err(refused)?;
        let Connected { stream, delivery, identity, description } =
            driver.open(Path::new(&device), &spec).map_err(refused)?;
        Ok(Self {
            driver,
            spec,
            sampling: Sampling::new(sample_interval, delivery.fps),
            notice: Some(format!("camera {device}: {description}")),
            open: Some(OpenCamera { stream, developer: Developer { device, delivery }, greeting: None }),
            search: Search::begin(identity, Vec::new()),
            clock: CaptureClock::default(),
            outage: Outage::default(),
            damaged: 0,
            times: TIMES,
        })
    }

    /// The next frame that is due; those before it are dropped as they are.
    fn due_frame(&mut self, spare: Option<Frame>) -> Result<Frame, SourceError> {
        let answer_by = Instant::now() + self.times.answer;
        let mut camera = match self.open.take() {
            Some(camera) => camera,
            None => self.awaited(answer_by)?,
        };
        match self.read(&mut camera, answer_by, spare) {
            Ok(frame) => {
                self.damaged = 0;
                self.open = Some(camera);
                Ok(frame)
            }
            Err(Fault::NotYet) => {
                self.open = Some(camera);
                Err(SourceError::NotYet)
            }
            Err(Fault::Frame(reason)) => Err(self.is_damaged(camera, reason)),
            Err(Fault::Change) => Err(self.is_changed(camera)),
            Err(Fault::Stream(error)) => Err(self.failed(camera, &error)),
        }
    }

    fn read(
        &mut self,
        camera: &mut OpenCamera<D::Stream>,
        answer_by: Instant,
        spare: Option<Frame>,
    ) -> Result<Frame, Fault> {
        let patience = self.patience(camera.developer.delivery.fps);
        loop {
            if self.is_other(camera) {
                return Err(Fault::Change);
            }
            let (bytes, metadata) = camera.stream.next(Instant::now() + patience).map_err(Fault::Stream)?;
            let arrived = Clocks::now();
            let index = self.sampling.index(metadata.sequence);
            let capture_nanos = self.clock.capture_nanos(timing::stamp_nanos(&metadata), arrived);
            if self.sampling.is_due(index) {
                let taken = (index, capture_nanos);
                let frame = camera.developer.frame(bytes, &metadata, taken, spare).map_err(Fault::Frame)?;
                self.welcome(&mut camera.greeting);
                return Ok(frame);
            }
            if Instant::now() >= answer_by {
                return Err(Fault::NotYet);
            }
        }
    }

    /// Whether what comes next is something else than what was agreed on. Buffers have a size, so that can only be
    /// where the stream, but not the camera, is opened anew.
    fn is_other(&self, camera: &OpenCamera<D::Stream>) -> bool {
        let is_anew = self.outage.has_failed() && camera.greeting.is_none();
        is_anew && camera.stream.has_changed(&camera.developer.delivery)
    }

    /// A whole frame came: whatever was wrong is over.
    fn welcome(&mut self, greeting: &mut Option<(Identity, String)>) {
        let was_told = self.outage.end();
        let news = match greeting.take() {
            Some((identity, greeting)) => {
                // Not before: another camera that sends nothing is no replacement.
                self.search = Search::begin(identity, Vec::new());
                greeting
            }
            None if was_told => "it sends frames again".to_owned(),
            None => return,
        };
        self.notice = Some(format!("camera {}: {news}", self.spec.device));
    }

    /// How long a frame of a camera that takes `fps` is awaited.
    fn patience(&self, fps: Option<f64>) -> Duration {
        let two_frames = fps.map(|fps| Duration::try_from_secs_f64(2.0 / fps).unwrap_or(MAX_PATIENCE));
        two_frames.unwrap_or_default().clamp(self.times.frame, MAX_PATIENCE)
    }

    /// The camera as soon as it is there again; an error where it is not by `answer_by`.
    fn awaited(&mut self, answer_by: Instant) -> Result<OpenCamera<D::Stream>, SourceError> {
        loop {
            let refusal = match self.reopened() {
                Ok(camera) => return Ok(camera),
                Err(refusal) => refusal,
            };
            thread::sleep(self.times.pause);
            if Instant::now() >= answer_by {
                let told = match refusal {
                    None => Some(UNPLUGGED.to_owned()),
                    Some(reason) if self.outage.is_lasting(&reason) => {
                        Some(format!("it is there, but cannot be used: {reason}"))
                    }
                    Some(_) => None,
                };
                return Err(told.map_or(SourceError::NotYet, |reason| self.told(reason)));
            }
        }
    }

    /// The camera, opened anew; the error is why it cannot be, or `None` where it is away.
    fn reopened(&mut self) -> Result<OpenCamera<D::Stream>, Option<String>> {
        let named = self.driver.node(Path::new(&self.spec.device));
        let nodes = self.driver.nodes();
        let path = self.search.found(named.as_ref(), &nodes).ok_or(None)?;
        let Connected { stream, delivery, identity, description } =
            self.driver.open(path, &self.spec).map_err(Some)?;
        self.sampling.begin_anew(delivery.fps);
        self.clock = CaptureClock::default();
        let greeting = Some((identity, format!("it is back at {}: {description}", path.display())));
        let developer = Developer { device: self.spec.device.clone(), delivery };
        Ok(OpenCamera { stream, developer, greeting })
    }

    /// Says that a frame is damaged; where many are, the camera is opened anew.
    fn is_damaged(&mut self, camera: OpenCamera<D::Stream>, reason: String) -> SourceError {
        if camera.stream.has_changed(&camera.developer.delivery) {
            return self.is_changed(camera);
        }
        self.damaged += 1;
        if self.damaged.is_multiple_of(MAX_DAMAGED) {
            self.close(camera);
        } else {
            self.open = Some(camera);
        }
        SourceError::DamagedFrame { device: self.spec.device.clone(), reason }
    }

    /// Says that the format is not the one that was agreed on, unless that was said; it will be agreed on anew.
    fn is_changed(&mut self, camera: OpenCamera<D::Stream>) -> SourceError {
        self.close(camera);
        self.told(CHANGED.to_owned())
    }

    /// Says what went wrong with the stream, unless that was said. The stream is opened anew, and the camera if that
    /// does not help.
    fn failed(&mut self, camera: OpenCamera<D::Stream>, error: &io::Error) -> SourceError {
        self.sampling.restart();
        // A signal to the program is no fault of the camera, but may be meant to end it.
        if error.kind() == io::ErrorKind::Interrupted {
            self.open = Some(camera);
            return SourceError::NotYet;
        }
        let is_late = error.kind() == io::ErrorKind::TimedOut;
        let is_gone = error.raw_os_error() == Some(ENODEV) || (!is_late && self.vanishes(&camera.stream));
        let reason = match error.kind() {
            _ if is_gone => UNPLUGGED.to_owned(),
            io::ErrorKind::TimedOut => {
                let patience = self.patience(camera.developer.delivery.fps).as_secs();
                format!("no frame within {patience} s; check the cable and the USB port")
            }
            _ => device::reason(error),
        };
        let is_enough = self.outage.count_failure();
        if is_gone || is_enough {
            self.close(camera);
        } else {
            self.open = Some(camera);
        }
        let answer = self.told(reason);
        if matches!(answer, SourceError::NotYet) && !is_late {
            // What fails at once would be tried without a pause.
            thread::sleep(self.times.pause);
        }
        answer
    }

    /// Whether the device is about to go: some drivers fail with other errors before it does.
    fn vanishes(&self, stream: &D::Stream) -> bool {
        (0..SIGNS_OF_LIFE).any(|_| {
            let is_gone = stream.is_gone();
            if !is_gone {
                thread::sleep(self.times.pause / SIGNS_OF_LIFE);
            }
            is_gone
        })
    }

    /// Closes the camera, which is looked for from here on.
    fn close(&mut self, camera: OpenCamera<D::Stream>) {
        drop(camera);
        self.search.begin_again(self.driver.nodes());
    }

    /// The error, unless it was told in this outage.
    fn told(&mut self, reason: String) -> SourceError {
        if self.outage.is_news(&reason) { self.error(reason) } else { SourceError::NotYet }
    }

    fn error(&self, reason: String) -> SourceError {
        SourceError::Camera { device: self.spec.device.clone(), reason }
    }
}

impl<D: Driver> FrameSource for CameraSource<D> {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        self.next_frame_in(None)
    }

    fn next_frame_in(&mut self, spare: Option<Frame>) -> Option<Result<Frame, SourceError>> {
        Some(self.due_frame(spare))
    }

    fn frame_count(&self) -> Option<u64> {
        None
    }

    fn is_live(&self) -> bool {
        true
    }

    fn take_notice(&mut self) -> Option<String> {
        self.notice.take()
    }

    fn lost_frames(&self) -> u64 {
        self.sampling.lost()
    }
}

#[cfg(test)]
mod tests;
