//! What is asked of a camera: the text after `v4l2:`, read and bounded.

use std::fmt::{self, Display};
use std::ops::RangeInclusive;

/// Sides of a frame in pixels: the bounds of all images that are read.
pub(super) const SIDES_PX: RangeInclusive<u32> = 32..=8192;
const EXAMPLE: &str = "v4l2:/dev/video0?size=640x480&fps=30&format=mjpg";
/// Longest key: V4L2's names of controls have 31 bytes.
const MAX_KEY_CHARS: usize = 32;
/// Longest value that is shown: no number has as many.
const MAX_VALUE_CHARS: usize = 24;
/// Most controls of a camera that can be set.
const MAX_CONTROLS: usize = 32;

/// How a camera packs its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PixelFormat {
    /// A JPEG a frame.
    Mjpg,
    /// Two pixels in four bytes: Y U Y V.
    Yuyv,
    /// A plane of luma, and one of U and V at half the width and height: what cameras of boards with their own image
    /// processor give.
    Nv12,
    /// A byte of luma a pixel.
    Grey,
}

impl PixelFormat {
    /// Every format that is read, the best first: a JPEG costs the least bandwidth and is kept as it is.
    pub(super) const BY_PREFERENCE: [Self; 4] = [Self::Mjpg, Self::Yuyv, Self::Nv12, Self::Grey];

    /// The name as written in a source.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Mjpg => "mjpg",
            Self::Yuyv => "yuyv",
            Self::Nv12 => "nv12",
            Self::Grey => "grey",
        }
    }

    /// The four-character code by which V4L2 knows the format.
    pub(super) fn fourcc(self) -> [u8; 4] {
        match self {
            Self::Mjpg => *b"MJPG",
            Self::Yuyv => *b"YUYV",
            Self::Nv12 => *b"NV12",
            Self::Grey => *b"GREY",
        }
    }

    /// The format with this four-character code, if it is one that is read.
    pub(super) fn from_fourcc(fourcc: [u8; 4]) -> Option<Self> {
        Self::BY_PREFERENCE.into_iter().find(|format| format.fourcc() == fourcc)
    }
}

/// What a control is to be set to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Setting {
    /// A number, or the number of a menu's item.
    Number(i64),
    /// `on` or `off`.
    Switch(bool),
}

impl Setting {
    fn parse(text: &str) -> Option<Self> {
        match text {
            "on" | "true" => Some(Self::Switch(true)),
            "off" | "false" => Some(Self::Switch(false)),
            number => number.parse().ok().map(Self::Number),
        }
    }
}

impl Display for Setting {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => write!(formatter, "{number}"),
            Self::Switch(is_on) => formatter.write_str(if *is_on { "on" } else { "off" }),
        }
    }
}

/// A camera and what is wished of it; whatever is `None` the driver decides.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct CameraSpec {
    /// Path of the device node.
    pub(super) device: String,
    /// Width and height in pixels.
    pub(super) size_px: Option<(u32, u32)>,
    /// Frames a second.
    pub(super) fps: Option<u32>,
    /// Pixel format; `None` takes the first of [`PixelFormat::BY_PREFERENCE`] that is offered.
    pub(super) format: Option<PixelFormat>,
    /// Controls by their normalised names, as they were given. Which there are, only the camera knows.
    pub(super) controls: Vec<(String, Setting)>,
}

impl CameraSpec {
    /// Reads `DEVICE?size=WxH&fps=N&format=NAME&CONTROL=VALUE`; the error is the reason without the device.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let (device, query) = text.split_once('?').unwrap_or((text, ""));
        if device.is_empty() {
            return Err(format!("no device is named; example: {EXAMPLE}"));
        }
        if device.contains('\0') {
            return Err("a path cannot hold a zero byte; name the device as /dev lists it".to_owned());
        }
        let device = device.to_owned();
        let mut spec = Self { device, size_px: None, fps: None, format: None, controls: Vec::new() };
        let mut seen: Vec<&str> = Vec::new();
        for pair in query.split('&').filter(|pair| !pair.is_empty()) {
            let (key, value) =
                pair.split_once('=').ok_or_else(|| format!("'{pair}' has no value; write {pair}=…"))?;
            spec.set(key, value)?;
            if seen.contains(&key) {
                return Err(format!("key '{key}' is given twice; once is allowed"));
            }
            seen.push(key);
        }
        Ok(spec)
    }

    fn set(&mut self, key: &str, value: &str) -> Result<(), String> {
        match key {
            "size" => self.size_px = Some(size_px(value)?),
            "fps" => {
                self.fps = Some(bounded(value, 1..=1000).ok_or_else(|| refused(key, value, "1 to 1000"))?)
            }
            "format" => {
                let named = PixelFormat::BY_PREFERENCE.into_iter().find(|format| format.name() == value);
                self.format = Some(named.ok_or_else(|| refused(key, value, "mjpg, yuyv, nv12 or grey"))?);
            }
            _ => self.controls.push((key.to_owned(), self.setting(key, value)?)),
        }
        Ok(())
    }

    /// What the control `key` is to be set to.
    fn setting(&self, key: &str, value: &str) -> Result<Setting, String> {
        let is_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        if key.is_empty() || key.len() > MAX_KEY_CHARS || !key.chars().all(is_name) {
            let key = shortened(key, MAX_KEY_CHARS);
            return Err(format!("there is no key '{key}'; `loci devices` lists those of every camera"));
        }
        if self.controls.len() >= MAX_CONTROLS {
            return Err(format!("there are more than {MAX_CONTROLS} controls; name fewer"));
        }
        Setting::parse(value).ok_or_else(|| {
            let value = shortened(value, MAX_VALUE_CHARS);
            format!(
                "there is no key '{key}' that takes '{value}'; allowed are size, fps, format, and controls with \
                 a whole number, on or off"
            )
        })
    }
}

/// `text`, or its beginning where it has more than `most` characters.
fn shortened(text: &str, most: usize) -> String {
    match text.char_indices().nth(most) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

fn size_px(value: &str) -> Result<(u32, u32), String> {
    let sides = value
        .split_once('x')
        .and_then(|(width, height)| Some((bounded(width, SIDES_PX)?, bounded(height, SIDES_PX)?)));
    sides.ok_or_else(|| refused("size", value, "WIDTHxHEIGHT, each 32 to 8192, such as 640x480"))
}

/// That `key` does not take `value`, but what is `allowed`.
pub(super) fn refused(key: &str, value: impl Display, allowed: impl Display) -> String {
    format!("{key}={value} is not allowed; {key} takes {allowed}")
}

fn bounded(value: &str, allowed: RangeInclusive<u32>) -> Option<u32> {
    value.parse().ok().filter(|number| allowed.contains(number))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn reason(text: &str) -> String {
        let reason = CameraSpec::parse(text).unwrap_err();
        assert!(!reason.contains('\n'), "{reason}");
        reason
    }

    #[test]
    fn a_bare_device_leaves_everything_to_the_driver() {
        for text in ["/dev/v4l/by-id/usb-046d_C920-video-index0", "/dev/video0"] {
            let device = text.to_owned();
            let expected =
                CameraSpec { device, size_px: None, fps: None, format: None, controls: Vec::new() };
            assert_eq!(CameraSpec::parse(text), Ok(expected.clone()));
            assert_eq!(CameraSpec::parse(&format!("{text}?")), Ok(expected));
        }
    }

    #[test]
    fn all_keys_are_read_in_any_order() {
        let expected = CameraSpec {
            device: "/dev/video2".to_owned(),
            size_px: Some((640, 480)),
            fps: Some(30),
            format: Some(PixelFormat::Yuyv),
            controls: Vec::new(),
        };
        assert_eq!(CameraSpec::parse("/dev/video2?size=640x480&fps=30&format=yuyv"), Ok(expected.clone()));
        assert_eq!(CameraSpec::parse("/dev/video2?format=yuyv&fps=30&size=640x480"), Ok(expected));
    }

    #[test]
    fn unknown_keys_and_values_are_refused_by_name_with_those_allowed() {
        assert_eq!(
            reason("/dev/video0?sise=1x1"),
            "there is no key 'sise' that takes '1x1'; allowed are size, fps, format, and controls with a whole \
             number, on or off"
        );
        assert_eq!(
            reason("/dev/video0?format=h264"),
            "format=h264 is not allowed; format takes mjpg, yuyv, nv12 or grey"
        );
        for fps in ["0", "-1", "29.97", "1001", ""] {
            assert_eq!(
                reason(&format!("/dev/video0?fps={fps}")),
                format!("fps={fps} is not allowed; fps takes 1 to 1000")
            );
        }
        for size in ["640", "640x", "31x480", "640x8193", "640x480x3", "640×480"] {
            assert_eq!(
                reason(&format!("/dev/video0?size={size}")),
                format!(
                    "size={size} is not allowed; size takes WIDTHxHEIGHT, each 32 to 8192, such as 640x480"
                )
            );
        }
    }

    #[test]
    fn a_missing_device_or_value_and_a_doubled_key_are_refused() {
        assert_eq!(reason("?fps=30"), format!("no device is named; example: {EXAMPLE}"));
        assert_eq!(reason("/dev/video0?fps"), "'fps' has no value; write fps=…");
        assert_eq!(reason("/dev/video0?fps=30&fps=15"), "key 'fps' is given twice; once is allowed");
        assert!(reason("/dev/vi\0deo0").contains("zero byte"));
    }

    #[test]
    fn whatever_else_is_given_is_a_control() {
        let spec =
            CameraSpec::parse("/dev/video0?gain=8&size=640x480&hue=-3&horizontal_flip=on&autogain=false");
        let expected = [
            ("gain", Setting::Number(8)),
            ("hue", Setting::Number(-3)),
            ("horizontal_flip", Setting::Switch(true)),
            ("autogain", Setting::Switch(false)),
        ];
        assert_eq!(spec.unwrap().controls, expected.map(|(key, setting)| (key.to_owned(), setting)));
    }

    #[test]
    fn what_cannot_be_a_control_is_refused_and_long_texts_are_cut() {
        for key in ["Gain", "white balance", "hüe", "", &"a".repeat(33)] {
            let reason = reason(&format!("/dev/video0?{key}=1"));
            assert!(reason.starts_with("there is no key '") && reason.len() < 120, "{reason}");
        }
        for value in ["", "yes", "1.5", "0x10", "99999999999999999999", &"ä".repeat(9999)] {
            let reason = reason(&format!("/dev/video0?gain={value}"));
            assert!(reason.contains("there is no key 'gain' that takes '") && reason.len() < 200, "{reason}");
        }
        assert_eq!(reason("/dev/video0?gain=1&gain=2"), "key 'gain' is given twice; once is allowed");
        let many: Vec<String> = (0..33).map(|number| format!("control_{number}=1")).collect();
        assert!(reason(&format!("/dev/video0?{}", many.join("&"))).contains("more than 32 controls"));
    }

    #[test]
    fn every_format_is_known_by_its_code() {
        for format in PixelFormat::BY_PREFERENCE {
            assert_eq!(PixelFormat::from_fourcc(format.fourcc()), Some(format));
        }
        assert_eq!(PixelFormat::from_fourcc(*b"UYVY"), None);
    }

    proptest! {
        #[test]
        fn no_text_can_break_the_reading(
            text in "\\PC{0,40}",
            query in "(size|fps|format|gain|on|&|=|x|-|[0-9]|a|ü){0,12}",
        ) {
            let _ = CameraSpec::parse(&text);
            let _ = CameraSpec::parse(&format!("/dev/video0?{query}"));
        }

        #[test]
        fn every_allowed_size_and_rate_is_read_back(width in SIDES_PX, height in SIDES_PX, fps in 1_u32..=1000) {
            let spec = CameraSpec::parse(&format!("/dev/video0?size={width}x{height}&fps={fps}")).unwrap();
            prop_assert_eq!((spec.size_px, spec.fps), (Some((width, height)), Some(fps)));
        }

        #[test]
        fn every_control_is_read_back(key in "[a-z0-9_]{1,32}", number in any::<i64>(), is_on in any::<bool>()) {
            prop_assume!(!["size", "fps", "format"].contains(&key.as_str()));
            for setting in [Setting::Number(number), Setting::Switch(is_on)] {
                let spec = CameraSpec::parse(&format!("/dev/video0?{key}={setting}")).unwrap();
                prop_assert_eq!(spec.controls, [(key.clone(), setting)]);
            }
        }
    }
}
