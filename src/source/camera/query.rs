//! What drivers are asked past the V4L2 library, which panics at names and kinds of controls that it does not know: who
//! a camera is, and which plain controls it has. Compound kinds, such as the rectangles of newer kernels, are left out.
#![expect(unsafe_code, reason = "a driver fills in C structures; this is the one place that hands it any")]

use std::{io, ptr};

use v4l::Device;
use v4l::capability::Flags as Capability;
use v4l::control::{Flags, Type};
use v4l::v4l_sys::{
    v4l2_capability, v4l2_control, v4l2_query_ext_ctrl, v4l2_querymenu, v4l2_querymenu__bindgen_ty_1,
};
use v4l::v4l2::{self, vidioc};

/// No camera has as many controls; an odd driver must not be asked for ever.
const MAX_CONTROLS: usize = 512;
/// Likewise of the items of a menu.
const MAX_MENU_ITEMS: i64 = 256;

/// A structure that a driver reads and fills in, with the request that it belongs to.
trait Question: Copy {
    const REQUEST: vidioc::_IOC_TYPE;

    fn asked_of(mut self, device: &Device) -> io::Result<Self> {
        // SAFETY: for this request the driver reads and writes one structure of this type, which is whole and ours; all
        // of its fields are numbers, so whatever is written there is valid.
        unsafe { v4l2::ioctl(device.handle().fd(), Self::REQUEST, ptr::from_mut(&mut self).cast()) }?;
        Ok(self)
    }
}

impl Question for v4l2_capability {
    const REQUEST: vidioc::_IOC_TYPE = vidioc::VIDIOC_QUERYCAP;
}

impl Question for v4l2_query_ext_ctrl {
    const REQUEST: vidioc::_IOC_TYPE = vidioc::VIDIOC_QUERY_EXT_CTRL;
}

impl Question for v4l2_querymenu {
    const REQUEST: vidioc::_IOC_TYPE = vidioc::VIDIOC_QUERYMENU;
}

impl Question for v4l2_control {
    const REQUEST: vidioc::_IOC_TYPE = vidioc::VIDIOC_G_CTRL;
}

/// Who a device says that it is.
pub(super) struct Card {
    pub(super) driver: String,
    pub(super) name: String,
    pub(super) bus: String,
    /// Whether this very node gives frames: a camera may have others, for metadata.
    pub(super) is_camera: bool,
}

/// Who `device` is.
pub(super) fn card(device: &Device) -> io::Result<Card> {
    let question = v4l2_capability {
        driver: [0; 16],
        card: [0; 32],
        bus_info: [0; 32],
        version: 0,
        capabilities: 0,
        device_caps: 0,
        reserved: [0; 3],
    };
    let answer = question.asked_of(device)?;
    Ok(Card {
        driver: text(answer.driver),
        name: text(answer.card),
        bus: text(answer.bus_info),
        is_camera: Capability::from(answer.device_caps).contains(Capability::VIDEO_CAPTURE),
    })
}

/// A control, as its driver describes it.
#[derive(Clone, Debug)]
pub(super) struct Control {
    pub(super) id: u32,
    pub(super) kind: Type,
    pub(super) name: String,
    pub(super) minimum: i64,
    pub(super) maximum: i64,
    pub(super) step: u64,
    pub(super) default: i64,
    pub(super) flags: Flags,
    /// What a menu has: numbers, not all of which need be there, and names.
    pub(super) items: Vec<(i64, String)>,
}

/// All controls of a camera that are of a plain kind, in its driver's order.
pub(super) fn controls(device: &Device) -> Vec<Control> {
    let (mut controls, mut last) = (Vec::new(), 0);
    for _ in 0..MAX_CONTROLS {
        match described(device, last | Flags::NEXT_CTRL.bits()) {
            // A driver that does not go on would be asked the same for ever.
            Ok(answer) if answer.id > last => {
                last = answer.id;
                controls.extend(control_of(device, &answer));
            }
            _ => break,
        }
    }
    controls
}

/// The control `id` as it is now.
pub(super) fn control(device: &Device, id: u32) -> Option<Control> {
    control_of(device, &described(device, id).ok()?)
}

/// The value of a control, if it is one of 32 bits that can be read.
pub(super) fn value(device: &Device, control: &Control) -> Option<i64> {
    let value = v4l2_control { id: control.id, value: 0 }.asked_of(device).ok()?.value;
    // A set of bits has no sign.
    Some(if control.kind == Type::Bitmask { value.cast_unsigned().into() } else { value.into() })
}

fn described(device: &Device, id: u32) -> io::Result<v4l2_query_ext_ctrl> {
    let question = v4l2_query_ext_ctrl {
        id,
        type_: 0,
        name: [0; 32],
        minimum: 0,
        maximum: 0,
        step: 0,
        default_value: 0,
        flags: 0,
        elem_size: 0,
        elems: 0,
        nr_of_dims: 0,
        dims: [0; 4],
        reserved: [0; 32],
    };
    question.asked_of(device)
}

fn control_of(device: &Device, answer: &v4l2_query_ext_ctrl) -> Option<Control> {
    let kind = Type::try_from(answer.type_).ok()?;
    let flags = Flags::from(answer.flags);
    let is_one = answer.nr_of_dims == 0 && kind != Type::CtrlClass && !flags.contains(Flags::DISABLED);
    let items = match kind {
        Type::Menu | Type::IntegerMenu => menu(device, answer, kind),
        _ => Vec::new(),
    };
    is_one.then(|| Control {
        id: answer.id,
        kind,
        name: text(answer.name.map(|byte| byte as u8)),
        minimum: answer.minimum,
        maximum: answer.maximum,
        step: answer.step,
        default: answer.default_value,
        flags,
        items,
    })
}

fn menu(device: &Device, control: &v4l2_query_ext_ctrl, kind: Type) -> Vec<(i64, String)> {
    let last = control.maximum.min(control.minimum.saturating_add(MAX_MENU_ITEMS));
    let item = |number: i64| {
        let question = v4l2_querymenu {
            id: control.id,
            index: u32::try_from(number).ok()?,
            __bindgen_anon_1: v4l2_querymenu__bindgen_ty_1 { name: [0; 32] },
            reserved: 0,
        };
        // Numbers between the first and the last may be missing.
        let answer = question.asked_of(device).ok()?.__bindgen_anon_1;
        // SAFETY: both sides of the union are numbers, and all 32 bytes were written when the question was made.
        let (name, value) = unsafe { (answer.name, answer.value) };
        Some((number, if kind == Type::IntegerMenu { value.to_string() } else { text(name) }))
    };
    (control.minimum..=last).filter_map(item).collect()
}

/// The text up to the zero byte. It may come from the device itself, so nothing that would steer a terminal is left.
fn text<const N: usize>(bytes: [u8; N]) -> String {
    let length = bytes.iter().position(|byte| *byte == 0).unwrap_or(N);
    String::from_utf8_lossy(&bytes[..length]).replace(char::is_control, "?").trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_end_at_a_zero_and_cannot_steer_a_terminal() {
        assert_eq!(text(*b"C920 \0\0x"), "C920");
        assert_eq!(text(*b"a\x1b[2Jb\n"), "a?[2Jb?");
        assert_eq!(text([b'a', 0xE4, 0xB8]), "a\u{FFFD}");
        assert_eq!(text([0; 4]), "");
    }
}
