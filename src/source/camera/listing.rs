//! Which cameras this computer has, and what each of them offers.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;
use v4l::control::{Flags, Type};
use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::video::Capture;
use v4l::{Device, FourCC};

use super::device::{self, named, rate, rounded, unpanicked};
use super::query::{self, Control};
use super::spec::PixelFormat;
use super::{controls, search};
use crate::source::SourceError;

/// Where udev has links to cameras that stay the same whatever is plugged in when.
const LINKS: &str = "/dev/v4l/by-id";
/// The size that an example asks for, if it is offered: larger ones cost time and help little.
const EXAMPLE_SIZE_PX: [u32; 2] = [640, 480];

/// A camera and what it offers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Camera {
    /// Its node, such as /dev/video0.
    pub path: PathBuf,
    /// A link to it that stays the same, if there is one.
    pub link: Option<PathBuf>,
    /// Its name.
    pub card: String,
    /// The kernel's driver.
    pub driver: String,
    /// Where it is plugged in.
    pub bus: String,
    /// In the driver's order.
    pub formats: Vec<CameraFormat>,
    /// In the driver's order.
    pub controls: Vec<CameraControl>,
    /// A source to begin with, if any of the formats is read.
    pub source: Option<String>,
}

/// A format of a camera's frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraFormat {
    /// The name by which it is asked for where it is read, or else its four-character code.
    pub name: String,
    /// What the driver calls it.
    pub description: String,
    /// Whether it is one that Loci reads.
    pub is_read: bool,
    /// In the driver's order.
    pub sizes: Vec<FrameSize>,
}

/// A size of frames, width and height in pixels, or a range of sizes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameSize {
    /// The least one.
    pub from_px: [u32; 2],
    /// The greatest one; the same where it is one alone.
    pub to_px: [u32; 2],
    /// From one to the next.
    pub step_px: [u32; 2],
    /// At what rates, of the greatest one.
    pub rates: FrameRates,
}

/// Frames a second.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameRates {
    /// Each of these.
    Each(Vec<f64>),
    /// From the slowest to the fastest.
    Between(f64, f64),
}

/// What can be set of a camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraControl {
    /// The key by which it is set in a source.
    pub name: String,
    /// What the driver calls it.
    pub description: String,
    /// What it takes: integer, boolean, menu, bitmask, button or text.
    pub kind: &'static str,
    /// The least value.
    pub minimum: i64,
    /// The greatest value.
    pub maximum: i64,
    /// From one value to the next.
    pub step: u64,
    /// The value that it has unless it is set.
    pub default: i64,
    /// The value that it has, if that can be read.
    pub value: Option<i64>,
    /// What a menu has.
    pub items: Vec<ControlItem>,
    /// Whether a source can set it.
    pub is_settable: bool,
    /// Whether it does nothing for now, because an automatic sees to it.
    pub is_inactive: bool,
}

/// An item of a menu.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ControlItem {
    /// The number by which it is set.
    pub value: i64,
    /// What the driver calls it.
    pub name: String,
}

/// The cameras of this computer, by the numbers of their nodes; an error for a node that does not say whether it is
/// one. Nodes that are none, such as those for metadata, are left out.
#[must_use]
pub fn cameras() -> Vec<Result<Camera, SourceError>> {
    search::paths().iter().filter_map(|path| listed(path).transpose()).collect()
}

fn listed(path: &Path) -> Result<Option<Camera>, SourceError> {
    let refused = |reason| SourceError::Camera { device: path.display().to_string(), reason };
    // What is unplugged while it is looked at, and what is no device, is no camera.
    if !device::is_device(path).unwrap_or(false) {
        return Ok(None);
    }
    let opened = device::open_node(path).map_err(refused)?;
    let Some(card) = query::card(&opened).ok().filter(|card| card.is_camera) else { return Ok(None) };
    let formats = unpanicked(|| formats(&opened)).ok_or_else(|| refused(device::ODD_ANSWER.to_owned()))?;
    if formats.is_empty() {
        return Ok(None);
    }
    let controls = query::controls(&opened).iter().map(|control| listed_control(&opened, control)).collect();
    let (path, link) = (path.to_owned(), link_to(path, Path::new(LINKS)));
    let source = example(link.as_deref().unwrap_or(&path), &formats);
    let query::Card { driver, name: card, bus, .. } = card;
    Ok(Some(Camera { path, link, card, driver, bus, formats, controls, source }))
}

/// The link in `folder` that leads to `path`.
fn link_to(path: &Path, folder: &Path) -> Option<PathBuf> {
    let links = fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    links.filter(|link| fs::canonicalize(link).is_ok_and(|target| target == path)).min()
}

fn formats(device: &Device) -> Vec<CameraFormat> {
    let described = device.enum_formats().unwrap_or_default();
    let format = |description: v4l::format::Description| CameraFormat {
        name: named(description.fourcc.repr),
        description: description.description,
        is_read: PixelFormat::from_fourcc(description.fourcc.repr).is_some(),
        sizes: sizes(device, description.fourcc),
    };
    described.into_iter().map(format).collect()
}

fn sizes(device: &Device, fourcc: FourCC) -> Vec<FrameSize> {
    let size = |size: v4l::FrameSize| {
        let (from_px, to_px, step_px) = match size.size {
            FrameSizeEnum::Discrete(one) => ([one.width, one.height], [one.width, one.height], [0, 0]),
            FrameSizeEnum::Stepwise(range) => (
                [range.min_width, range.min_height],
                [range.max_width, range.max_height],
                [range.step_width, range.step_height],
            ),
        };
        FrameSize { from_px, to_px, step_px, rates: rates(device, fourcc, to_px) }
    };
    device.enum_framesizes(fourcc).unwrap_or_default().into_iter().map(size).collect()
}

fn rates(device: &Device, fourcc: FourCC, [width, height]: [u32; 2]) -> FrameRates {
    let mut each = Vec::new();
    for interval in device.enum_frameintervals(fourcc, width, height).unwrap_or_default() {
        match interval.interval {
            FrameIntervalEnum::Discrete(interval) => each.extend(rate(interval).map(rounded)),
            FrameIntervalEnum::Stepwise(range) => {
                if let (Some(fastest), Some(slowest)) = (rate(range.min), rate(range.max)) {
                    return FrameRates::Between(rounded(slowest), rounded(fastest));
                }
            }
        }
    }
    FrameRates::Each(each)
}

fn listed_control(device: &Device, control: &Control) -> CameraControl {
    let item = |(value, name): &(i64, String)| ControlItem { value: *value, name: name.clone() };
    CameraControl {
        name: controls::normalised(&control.name),
        description: control.name.clone(),
        kind: match control.kind {
            Type::Boolean => "boolean",
            Type::Menu | Type::IntegerMenu => "menu",
            Type::Bitmask => "bitmask",
            Type::Button => "button",
            Type::String => "text",
            _ => "integer",
        },
        minimum: control.minimum,
        maximum: control.maximum,
        step: control.step,
        default: control.default,
        value: query::value(device, control),
        items: control.items.iter().map(item).collect(),
        is_settable: controls::is_settable(control),
        is_inactive: control.flags.contains(Flags::INACTIVE),
    }
}

/// A source that is sure to work: the best format that is read, at a size that is offered.
fn example(path: &Path, formats: &[CameraFormat]) -> Option<String> {
    let best = PixelFormat::BY_PREFERENCE
        .into_iter()
        .find_map(|wished| formats.iter().find(|format| format.is_read && format.name == wished.name()))?;
    let holds = |size: &&FrameSize| {
        (0..2).all(|side| (size.from_px[side]..=size.to_px[side]).contains(&EXAMPLE_SIZE_PX[side]))
    };
    let size = match best.sizes.iter().find(holds) {
        Some(_) => Some(EXAMPLE_SIZE_PX),
        None => best.sizes.first().map(|size| size.to_px),
    };
    let size = size.map_or(String::new(), |[width, height]| format!("size={width}x{height}&"));
    Some(format!("v4l2:{}?{size}format={}", path.display(), best.name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn format(name: &str, sizes: &[[u32; 2]]) -> CameraFormat {
        let size = |size: &[u32; 2]| FrameSize {
            from_px: *size,
            to_px: *size,
            step_px: [0, 0],
            rates: FrameRates::Each(vec![30.0]),
        };
        CameraFormat {
            name: name.to_owned(),
            description: String::new(),
            is_read: name != "H264",
            sizes: sizes.iter().map(size).collect(),
        }
    }

    fn example_of(formats: &[CameraFormat]) -> Option<String> {
        example(Path::new("/dev/video0"), formats)
    }

    #[test]
    fn an_example_has_the_best_format_at_a_size_that_is_offered() {
        let formats = [
            format("H264", &[[640, 480]]),
            format("yuyv", &[[640, 480]]),
            format("mjpg", &[[1920, 1080], [640, 480]]),
        ];
        assert_eq!(example_of(&formats).unwrap(), "v4l2:/dev/video0?size=640x480&format=mjpg");
        let large = [format("yuyv", &[[1280, 720], [1920, 1080]])];
        assert_eq!(example_of(&large).unwrap(), "v4l2:/dev/video0?size=1280x720&format=yuyv");
        assert_eq!(example_of(&[format("grey", &[])]).unwrap(), "v4l2:/dev/video0?format=grey");
        assert_eq!(example_of(&formats[..1]), None);
        let mut range = format("nv12", &[[48, 32]]);
        range.sizes[0].to_px = [4096, 2160];
        assert_eq!(example_of(&[range]).unwrap(), "v4l2:/dev/video0?size=640x480&format=nv12");
    }

    #[test]
    fn a_link_is_found_by_where_it_leads() {
        let folder = tempfile::tempdir().unwrap();
        let (node, other) = (folder.path().join("video0"), folder.path().join("video1"));
        for file in [&node, &other] {
            fs::write(file, "").unwrap();
        }
        let links = folder.path().join("by-id");
        fs::create_dir(&links).unwrap();
        for (link, target) in [("usb-b", &node), ("usb-a", &node), ("usb-0", &other)] {
            std::os::unix::fs::symlink(target, links.join(link)).unwrap();
        }
        std::os::unix::fs::symlink("nowhere", links.join("usb-gone")).unwrap();
        let node = fs::canonicalize(node).unwrap();
        assert_eq!(link_to(&node, &links), Some(links.join("usb-a")));
        assert_eq!(link_to(Path::new("/dev/null"), &links), None);
        assert_eq!(link_to(&node, Path::new("/no/such/folder")), None);
    }

    #[test]
    fn looking_for_cameras_ends_wherever_it_is_done() {
        for camera in cameras().into_iter().flatten() {
            assert!(!camera.formats.is_empty(), "{camera:?}");
        }
    }
}
