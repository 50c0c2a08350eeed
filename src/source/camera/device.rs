//! Opening a camera and agreeing with its driver on format, size, rate and controls.

use std::io;
use std::os::unix::fs::FileTypeExt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use v4l::format::{Colorspace, Quantization};
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC, Fraction};

use super::driver::Connected;
use super::pixels::{Layout, Range};
use super::search::{self, Identity};
use super::spec::{CameraSpec, PixelFormat, SIDES_PX};
use super::stream::BufferStream;
use super::{controls, query};

/// Error number of a device that is gone; it has no `ErrorKind`.
pub(super) const ENODEV: i32 = 19;
/// Error number of a node without a driver behind it.
const ENXIO: i32 = 6;
/// A rate is the one that was asked for if it is as near; 29.97 is not 30.
const MAX_RATE_ERROR_HZ: f64 = 0.005;
/// Offered formats that an error lists; cameras have two or three.
const MAX_LISTED: usize = 6;

const NO_DEVICE: &str = "there is no such device; plug the camera in, or name one that /dev/v4l/by-id lists";
pub(super) const ODD_ANSWER: &str = "its driver answers what V4L2 does not define; update the driver";
const NOT_A_CAMERA: &str =
    "it is not a video capture device; a camera may have several nodes, so try the next /dev/video…";

/// What the driver really gives, which need not be what was asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Delivery {
    pub(super) format: PixelFormat,
    pub(super) layout: Layout,
    pub(super) range: Range,
    /// Frames a second, where the driver says.
    pub(super) fps: Option<f64>,
}

/// Opens the camera at `path` and sets it up; the error is the reason without the device.
pub(super) fn open(path: &Path, spec: &CameraSpec) -> Result<Connected<BufferStream>, String> {
    let device = open_node(path)?;
    let set_up = || -> Result<(Identity, Delivery, Vec<String>), String> {
        // Before anything else is asked: what is no V4L2 device has no answer to it.
        let card = query::card(&device).map_err(|_| NOT_A_CAMERA.to_owned())?;
        let delivery = negotiate(&device, spec)?;
        let otherwise = controls::apply(&device, &spec.controls)?;
        Ok((search::identity(card, path), delivery, otherwise))
    };
    let (identity, delivery, otherwise) = unpanicked(set_up).unwrap_or_else(|| Err(ODD_ANSWER.to_owned()))?;
    let given = [delivery.described(spec)].into_iter().chain(otherwise).collect::<Vec<_>>().join(", ");
    let description = format!("{} on {} gives {given}", identity.card, identity.bus);
    let stream = BufferStream::open(device).map_err(|error| reason(&error))?;
    Ok(Connected { stream, delivery, identity, description })
}

/// Opens the node at `path`, whatever it is good for; the error is the reason without the device.
pub(super) fn open_node(path: &Path) -> Result<Device, String> {
    // Opening has side effects on some kinds of file (a pipe, a tape), so look first.
    if !is_device(path).map_err(|error| reason(&error))? {
        return Err(NOT_A_CAMERA.to_owned());
    }
    Device::with_path(path).map_err(|error| reason(&error))
}

/// Whether a device is at `path`.
pub(super) fn is_device(path: &Path) -> io::Result<bool> {
    Ok(std::fs::metadata(path)?.file_type().is_char_device())
}

/// Whether the driver gives something else by now than what was agreed on.
pub(super) fn has_changed(device: &Device, delivery: &Delivery) -> bool {
    let format = unpanicked(|| device.format().ok()).flatten();
    format.is_some_and(|format| {
        format.fourcc.repr != delivery.format.fourcc() || layout(&format) != delivery.layout
    })
}

impl Delivery {
    /// What is given, and where that is not what was asked for.
    fn described(&self, spec: &CameraSpec) -> String {
        let Layout { width_px, height_px, stride_bytes } = self.layout;
        let given = (width_px as u32, height_px as u32);
        let size = match spec.size_px {
            Some((width, height)) if (width, height) != given => format!(" ({width}×{height} was asked for)"),
            _ => String::new(),
        };
        // Rows that are compressed have no length, though some drivers name one.
        let rows = match (self.format, stride_bytes) {
            (PixelFormat::Mjpg, _) | (_, 0) => String::new(),
            (_, bytes) => format!(" in rows of {bytes} bytes"),
        };
        let rate = match self.fps {
            Some(fps) => format!("{} frames/s", rounded(fps)),
            None => "at a rate that its driver does not say".to_owned(),
        };
        let is_as_asked = |asked: f64| self.fps.is_some_and(|fps| (fps - asked).abs() < MAX_RATE_ERROR_HZ);
        let asked = match spec.fps {
            Some(asked) if !is_as_asked(asked.into()) => format!(" ({asked} was asked for)"),
            _ => String::new(),
        };
        format!("{}, {width_px}×{height_px} px{size}{rows}, {rate}{asked}", self.format.name())
    }
}

/// Two decimals at most: 25, 29.97.
pub(super) fn rounded(number: f64) -> f64 {
    (number * 100.0).round() / 100.0
}

/// What went wrong, and what to do, for the errors that a user can mend.
pub(super) fn reason(error: &io::Error) -> String {
    match (error.kind(), error.raw_os_error()) {
        (io::ErrorKind::NotFound, _) | (_, Some(ENODEV | ENXIO)) => NO_DEVICE.to_owned(),
        (io::ErrorKind::PermissionDenied, _) => {
            "permission denied; add the user to the group video (sudo usermod -aG video $USER) and log in again"
                .to_owned()
        }
        (io::ErrorKind::ResourceBusy, _) => "another program uses it; close that one".to_owned(),
        _ => format!("{error}; unplug the camera and plug it in again"),
    }
}

/// Runs `work`, in which the V4L2 library panics on what it does not know; `None` if it did.
pub(super) fn unpanicked<T>(work: impl FnOnce() -> T) -> Option<T> {
    catch_unwind(AssertUnwindSafe(work)).ok()
}

fn negotiate(device: &Device, spec: &CameraSpec) -> Result<Delivery, String> {
    let offered: Vec<[u8; 4]> = device
        .enum_formats()
        .map_err(|error| reason(&error))?
        .iter()
        .map(|format| format.fourcc.repr)
        .collect();
    if offered.is_empty() {
        return Err(NOT_A_CAMERA.to_owned());
    }
    let format = chosen(spec.format, &offered)?;
    let current = device.format().map_err(|error| reason(&error))?;
    let (width, height) = spec.size_px.unwrap_or((current.width, current.height));
    // A new `Format` leaves stride and size at 0, so that the driver computes them anew.
    let wanted = Format::new(width, height, FourCC::new(&format.fourcc()));
    let given = device.set_format(&wanted).map_err(|error| reason(&error))?;
    if given.fourcc != wanted.fourcc {
        let (given, wanted) = (named(given.fourcc.repr), format.name());
        return Err(format!("the driver gives {given} where {wanted} is asked for; ask for another format"));
    }
    if !(SIDES_PX.contains(&given.width) && SIDES_PX.contains(&given.height)) {
        let (width, height) = (given.width, given.height);
        return Err(format!("it gives {width}×{height} px; ask for a size of 32 to 8192 px a side"));
    }
    if let Some(fps) = spec.fps {
        // A driver that cannot set a rate refuses; what it does instead is read back below.
        let _ = device.set_params(&Parameters::with_fps(fps));
    }
    let fps = device.params().ok().and_then(|parameters| rate(parameters.interval));
    Ok(Delivery { format, layout: layout(&given), range: range(&given), fps })
}

/// Frames a second, if `interval` makes any sense.
pub(super) fn rate(interval: Fraction) -> Option<f64> {
    let fps = f64::from(interval.denominator) / f64::from(interval.numerator);
    (fps.is_finite() && fps > 0.0).then_some(fps)
}

/// The format to ask for: the one that is wished, or else the best that is offered.
fn chosen(wished: Option<PixelFormat>, offered: &[[u8; 4]]) -> Result<PixelFormat, String> {
    let is_offered = |format: &PixelFormat| offered.contains(&format.fourcc());
    if let Some(format) = wished.or_else(|| PixelFormat::BY_PREFERENCE.into_iter().find(is_offered))
        && is_offered(&format)
    {
        return Ok(format);
    }
    let readable: Vec<&str> =
        PixelFormat::BY_PREFERENCE.into_iter().filter(is_offered).map(PixelFormat::name).collect();
    let offered = listed(offered);
    Err(match (wished, readable.as_slice()) {
        (_, []) => format!("it offers only {offered}; use a camera with mjpg, yuyv, nv12 or grey"),
        (wished, readable) => {
            let wished = wished.map_or("the format", PixelFormat::name);
            format!(
                "it does not offer {wished} but {offered}; ask for format={}",
                readable.join(" or format=")
            )
        }
    })
}

/// The names of the first few formats.
fn listed(offered: &[[u8; 4]]) -> String {
    let names: Vec<String> = offered.iter().take(MAX_LISTED).map(|fourcc| named(*fourcc)).collect();
    match offered.len().saturating_sub(MAX_LISTED) {
        0 => names.join(", "),
        more => format!("{} and {more} more", names.join(", ")),
    }
}

/// Our name of a four-character code, or the code itself.
pub(super) fn named(fourcc: [u8; 4]) -> String {
    let code = || fourcc.escape_ascii().to_string().trim_end().to_owned();
    PixelFormat::from_fourcc(fourcc).map_or_else(code, |format| format.name().to_owned())
}

/// Where the pixels of a frame in this format lie.
fn layout(given: &Format) -> Layout {
    Layout {
        width_px: given.width as usize,
        height_px: given.height as usize,
        stride_bytes: given.stride as usize,
    }
}

/// The range by V4L2's rule: limited unless the driver says otherwise or the colours are those of JPEG.
fn range(given: &Format) -> Range {
    match (given.quantization, given.colorspace) {
        (Quantization::FullRange, _) | (Quantization::Default, Colorspace::JPEG) => Range::Full,
        _ => Range::Limited,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UYVY: [u8; 4] = *b"UYVY";
    const YUYV: [u8; 4] = *b"YUYV";
    const MJPG: [u8; 4] = *b"MJPG";

    #[test]
    fn the_first_of_mjpg_yuyv_and_grey_is_taken_unless_one_is_wished() {
        assert_eq!(chosen(None, &[UYVY, YUYV, MJPG]), Ok(PixelFormat::Mjpg));
        assert_eq!(chosen(None, &[*b"GREY", YUYV]), Ok(PixelFormat::Yuyv));
        assert_eq!(chosen(Some(PixelFormat::Yuyv), &[MJPG, YUYV]), Ok(PixelFormat::Yuyv));
    }

    #[test]
    fn a_format_that_is_not_offered_is_refused_with_those_that_are() {
        assert_eq!(
            chosen(Some(PixelFormat::Grey), &[MJPG, UYVY, YUYV]).unwrap_err(),
            "it does not offer grey but mjpg, UYVY, yuyv; ask for format=mjpg or format=yuyv"
        );
        assert_eq!(
            chosen(None, &[UYVY, *b"Y16 ", [0, 0xFF, b'\n', 0]]).unwrap_err(),
            "it offers only UYVY, Y16, \\x00\\xff\\n\\x00; use a camera with mjpg, yuyv, nv12 or grey"
        );
    }

    #[test]
    fn a_long_offer_is_cut_short_but_the_readable_ones_are_named() {
        let offered = [[UYVY; 8].as_slice(), &[YUYV]].concat();
        assert_eq!(
            chosen(Some(PixelFormat::Grey), &offered).unwrap_err(),
            "it does not offer grey but UYVY, UYVY, UYVY, UYVY, UYVY, UYVY and 3 more; ask for format=yuyv"
        );
    }

    #[test]
    fn what_is_given_is_said_and_what_was_asked_for_where_it_differs() {
        let layout = Layout { width_px: 640, height_px: 360, stride_bytes: 1280 };
        let yuyv = Delivery {
            format: PixelFormat::Yuyv,
            layout,
            range: Range::Limited,
            fps: Some(30_000.0 / 1001.0),
        };
        let described = |delivery: Delivery, query: &str| {
            delivery.described(&CameraSpec::parse(&format!("/dev/video0?{query}")).unwrap())
        };
        assert_eq!(described(yuyv, "size=640x360"), "yuyv, 640×360 px in rows of 1280 bytes, 29.97 frames/s");
        assert_eq!(
            described(yuyv, "size=650x370&fps=30"),
            "yuyv, 640×360 px (650×370 was asked for) in rows of 1280 bytes, 29.97 frames/s (30 was asked for)"
        );
        let mjpg = Delivery { format: PixelFormat::Mjpg, fps: Some(25.0), ..yuyv };
        assert_eq!(described(mjpg, "fps=25"), "mjpg, 640×360 px, 25 frames/s");
        let silent = Delivery { fps: None, ..mjpg };
        let expected = "mjpg, 640×360 px, at a rate that its driver does not say (25 was asked for)";
        assert_eq!(described(silent, "fps=25"), expected);
    }

    #[test]
    fn the_range_is_limited_unless_the_driver_says_otherwise() {
        let mut given = Format::new(640, 480, FourCC::new(&YUYV));
        assert_eq!(range(&given), Range::Limited);
        given.colorspace = Colorspace::JPEG;
        assert_eq!(range(&given), Range::Full);
        given.quantization = Quantization::LimitedRange;
        assert_eq!(range(&given), Range::Limited);
        given.quantization = Quantization::FullRange;
        assert_eq!(range(&given), Range::Full);
    }

    #[test]
    fn every_error_says_what_to_do_in_one_line() {
        let cases =
            [(2, "plug the camera in"), (13, "group video"), (16, "close that one"), (5, "plug it in")];
        for (number, fix) in cases {
            let reason = reason(&io::Error::from_raw_os_error(number));
            assert!(reason.contains(fix) && !reason.contains('\n'), "{reason}");
        }
    }
}
