//! Controls of a camera: found by name, checked, set in an order that works, and read back.
//!
//! Their names are those of `v4l2-ctl`: what drivers call "Exposure Time, Absolute" is `exposure_time_absolute`.

use v4l::control::{self, Flags, Type};
use v4l::{Device, control::Value};

use super::device;
use super::query::{self, Control};
use super::spec::{Setting, refused};

/// Control names that an error lists.
const MAX_LISTED: usize = 16;

/// The short name of how long a frame is exposed.
const EXPOSURE: &str = "exposure";
/// What drivers call it, by kernel and kind of camera.
const EXPOSURE_NAMES: [&str; 3] = ["exposure_time_absolute", "exposure_absolute", EXPOSURE];
/// What they call the menu by which the camera sees to it by itself.
const AUTOMATIC_NAMES: [&str; 2] = ["auto_exposure", "exposure_auto"];
/// The item of that menu under which the time of exposure is what it is set to.
const MANUAL: i64 = 1;

/// The name by which a control is asked for: `name` in lower case, with one underscore for whatever is between words.
pub(super) fn normalised(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join("_").to_ascii_lowercase()
}

/// Sets the controls of `settings`; answers what came out otherwise, as sentences. The error is the reason without the
/// device.
pub(super) fn apply(device: &Device, settings: &[(String, Setting)]) -> Result<Vec<String>, String> {
    if settings.is_empty() {
        return Ok(Vec::new());
    }
    let controls = query::controls(device);
    let mut otherwise = Vec::new();
    for Step { control, value } in plan(settings, &controls)? {
        let name = normalised(&control.name);
        // Whether it can be set now may depend on those that were set before.
        let now = query::control(device, control.id);
        refuse_inactive(&name, now.as_ref().unwrap_or(control), &controls)?;
        let value_of_kind = match control.kind {
            Type::Boolean => Value::Boolean(value != 0),
            _ => Value::Integer(value),
        };
        device
            .set_control(control::Control { id: control.id, value: value_of_kind })
            .map_err(|error| format!("{name}={value} is refused: {}", device::reason(&error)))?;
        if let Some(given) = query::value(device, control).filter(|given| *given != value) {
            otherwise.push(format!("{name} is {given} ({value} was asked for)"));
        }
    }
    Ok(otherwise)
}

/// A control that is to be set.
struct Step<'a> {
    control: &'a Control,
    value: i64,
}

/// What is to be set in which order: first what may be an automatic, which rules whether the others can be set.
fn plan<'a>(settings: &[(String, Setting)], controls: &'a [Control]) -> Result<Vec<Step<'a>>, String> {
    let mut steps = Vec::new();
    for (key, setting) in settings {
        let control = named(key, controls).ok_or_else(|| unknown(key, controls))?;
        steps.push(Step { control, value: value(key, *setting, control)? });
    }
    let automatic = || AUTOMATIC_NAMES.iter().find_map(|name| exactly(name, controls));
    if settings.iter().any(|(key, _)| key == EXPOSURE)
        && let Some(control) = automatic()
        && control.items.iter().any(|(number, _)| *number == MANUAL)
        && !steps.iter().any(|step| step.control.id == control.id)
    {
        steps.push(Step { control, value: MANUAL });
    }
    steps.sort_by_key(|step| !matches!(step.control.kind, Type::Boolean | Type::Menu));
    Ok(steps)
}

fn named<'a>(key: &str, controls: &'a [Control]) -> Option<&'a Control> {
    match key {
        EXPOSURE => EXPOSURE_NAMES.iter().find_map(|name| exactly(name, controls)),
        _ => exactly(key, controls),
    }
}

fn exactly<'a>(name: &str, controls: &'a [Control]) -> Option<&'a Control> {
    controls.iter().find(|control| normalised(&control.name) == name)
}

fn unknown(key: &str, controls: &[Control]) -> String {
    let names: Vec<String> = controls
        .iter()
        .filter(|control| is_settable(control))
        .map(|control| normalised(&control.name))
        .collect();
    let listed = names[..names.len().min(MAX_LISTED)].join(", ");
    let rest = match names.len().saturating_sub(MAX_LISTED) {
        0 => String::new(),
        more => format!(" and {more} more, which `loci devices` lists"),
    };
    match names.as_slice() {
        [] => format!("it has no control '{key}', nor any other; allowed are size, fps, format"),
        _ => format!("it has no control '{key}'; besides size, fps and format it takes {listed}{rest}"),
    }
}

/// Whether the control takes a value at all.
pub(super) fn is_settable(control: &Control) -> bool {
    let is_number = matches!(
        control.kind,
        Type::Integer | Type::Integer64 | Type::Boolean | Type::Menu | Type::IntegerMenu | Type::Bitmask
    );
    is_number && !control.flags.contains(Flags::READ_ONLY)
}

/// The number that stands for `setting`, if `control` takes it.
fn value(key: &str, setting: Setting, control: &Control) -> Result<i64, String> {
    if control.flags.contains(Flags::READ_ONLY) {
        return Err(format!("control '{key}' can only be read; leave it out"));
    }
    if !is_settable(control) {
        return Err(format!("control '{key}' takes no number; leave it out"));
    }
    let taken = match (control.kind, setting) {
        (Type::Boolean, Setting::Switch(is_on)) => Some(i64::from(is_on)),
        (_, Setting::Switch(_)) => None,
        (Type::Menu | Type::IntegerMenu, Setting::Number(number)) => {
            Some(number).filter(|number| control.items.iter().any(|(item, _)| item == number))
        }
        // Of a set of bits, the greatest number says which there are; there is no least.
        (Type::Bitmask, Setting::Number(number)) => {
            Some(number).filter(|number| number & !control.maximum == 0)
        }
        (_, Setting::Number(number)) => {
            Some(number).filter(|number| (control.minimum..=control.maximum).contains(number))
        }
    };
    taken.ok_or_else(|| refused(key, setting, allowed(control)))
}

/// What a control takes, in words.
fn allowed(control: &Control) -> String {
    match control.kind {
        Type::Boolean => "on or off".to_owned(),
        Type::Menu | Type::IntegerMenu => {
            let items: Vec<String> =
                control.items.iter().map(|(number, name)| format!("{number} ({name})")).collect();
            items.join(", ")
        }
        Type::Bitmask => format!("a sum of the bits of {}", control.maximum),
        _ => format!("{} to {}", control.minimum, control.maximum),
    }
}

fn refuse_inactive(name: &str, control: &Control, controls: &[Control]) -> Result<(), String> {
    if control.flags.contains(Flags::GRABBED) {
        return Err(format!("control '{name}' is locked while the camera is in use; close whatever uses it"));
    }
    if !control.flags.contains(Flags::INACTIVE) {
        return Ok(());
    }
    let automatics: Vec<String> = controls
        .iter()
        .filter(|other| matches!(other.kind, Type::Boolean | Type::Menu) && other.id != control.id)
        .map(|other| normalised(&other.name))
        .filter(|other| other.contains("auto"))
        .take(MAX_LISTED)
        .collect();
    let automatics = if automatics.is_empty() { "it names none".to_owned() } else { automatics.join(", ") };
    Err(format!("control '{name}' is inactive while an automatic sees to it; set that, too ({automatics})"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn control(id: u32, name: &str, kind: Type, range: (i64, i64)) -> Control {
        let items = match kind {
            Type::Menu => [(0, "Auto Mode"), (1, "Manual Mode"), (3, "Aperture Priority Mode")].to_vec(),
            _ => Vec::new(),
        };
        let items = items.into_iter().map(|(number, name)| (number, name.to_owned())).collect();
        let ((minimum, maximum), flags, name) = (range, Flags::empty(), name.to_owned());
        Control { id, kind, name, minimum, maximum, step: 1, default: minimum, flags, items }
    }

    fn webcam() -> Vec<Control> {
        vec![
            control(1, "Brightness", Type::Integer, (-64, 64)),
            control(2, "White Balance, Automatic", Type::Boolean, (0, 1)),
            control(3, "Gain", Type::Integer, (0, 255)),
            control(4, "Auto Exposure", Type::Menu, (0, 3)),
            control(5, "Exposure Time, Absolute", Type::Integer, (3, 2047)),
            control(6, "LED1 Mode", Type::Bitmask, (0, 0b101)),
            control(7, "Pan Reset", Type::Button, (0, 0)),
        ]
    }

    fn planned(query: &str) -> Result<Vec<(u32, i64)>, String> {
        let spec = super::super::spec::CameraSpec::parse(&format!("/dev/video0?{query}")).unwrap();
        let controls = webcam();
        let steps = plan(&spec.controls, &controls)?;
        Ok(steps.iter().map(|step| (step.control.id, step.value)).collect())
    }

    fn reason(query: &str) -> String {
        let reason = planned(query).unwrap_err();
        assert!(!reason.contains('\n'), "{reason}");
        reason
    }

    #[test]
    fn names_are_those_of_v4l2_ctl() {
        for (name, expected) in [
            ("Exposure Time, Absolute", "exposure_time_absolute"),
            ("White Balance, Automatic", "white_balance_automatic"),
            ("LED1 Mode", "led1_mode"),
            ("  Über-Gain!  ", "ber_gain"),
            ("Exposure (Absolute)", "exposure_absolute"),
            ("", ""),
        ] {
            assert_eq!(normalised(name), expected);
        }
    }

    #[test]
    fn switches_and_menus_are_set_before_what_they_rule() {
        assert_eq!(
            planned("gain=8&white_balance_automatic=off&brightness=-64"),
            Ok(vec![(2, 0), (3, 8), (1, -64)])
        );
        assert_eq!(planned("led1_mode=5"), Ok(vec![(6, 5)]));
    }

    #[test]
    fn an_exposure_by_its_short_name_switches_the_automatic_off() {
        assert_eq!(planned("exposure=100"), Ok(vec![(4, 1), (5, 100)]));
        assert_eq!(planned("exposure=100&auto_exposure=3"), Ok(vec![(4, 3), (5, 100)]));
        assert_eq!(planned("exposure_time_absolute=100"), Ok(vec![(5, 100)]));
        let older = [control(9, "Exposure (Absolute)", Type::Integer, (1, 10))];
        let steps = plan(&[("exposure".to_owned(), Setting::Number(3))], &older).unwrap();
        assert_eq!(steps.iter().map(|step| (step.control.id, step.value)).collect::<Vec<_>>(), [(9, 3)]);
    }

    #[test]
    fn what_a_control_does_not_take_is_refused_with_what_it_does() {
        assert_eq!(reason("gain=256"), "gain=256 is not allowed; gain takes 0 to 255");
        assert_eq!(reason("gain=on"), "gain=on is not allowed; gain takes 0 to 255");
        assert_eq!(
            reason("white_balance_automatic=2"),
            "white_balance_automatic=2 is not allowed; white_balance_automatic takes on or off"
        );
        assert_eq!(
            reason("auto_exposure=2"),
            "auto_exposure=2 is not allowed; auto_exposure takes 0 (Auto Mode), 1 (Manual Mode), 3 (Aperture \
             Priority Mode)"
        );
        assert_eq!(
            reason("led1_mode=2"),
            "led1_mode=2 is not allowed; led1_mode takes a sum of the bits of 5"
        );
        assert_eq!(reason("pan_reset=1"), "control 'pan_reset' takes no number; leave it out");
    }

    #[test]
    fn a_control_that_is_none_is_named_with_those_that_there_are() {
        assert_eq!(
            reason("sise=640"),
            "it has no control 'sise'; besides size, fps and format it takes brightness, white_balance_automatic, \
             gain, auto_exposure, exposure_time_absolute, led1_mode"
        );
        let none = unknown("gain", &[]);
        assert_eq!(none, "it has no control 'gain', nor any other; allowed are size, fps, format");
        let many: Vec<Control> =
            (0..30).map(|id| control(id, &format!("Knob {id}"), Type::Integer, (0, 1))).collect();
        assert!(unknown("gain", &many).ends_with("knob_15 and 14 more, which `loci devices` lists"));
    }

    #[test]
    fn what_cannot_be_set_now_says_why() {
        let mut gain = control(3, "Gain", Type::Integer, (0, 255));
        assert_eq!(refuse_inactive("gain", &gain, &webcam()), Ok(()));
        gain.flags = Flags::INACTIVE;
        assert_eq!(
            refuse_inactive("gain", &gain, &webcam()).unwrap_err(),
            "control 'gain' is inactive while an automatic sees to it; set that, too (white_balance_automatic, \
             auto_exposure)"
        );
        gain.flags = Flags::READ_ONLY;
        let refusal = value("gain", Setting::Number(1), &gain).unwrap_err();
        assert_eq!(refusal, "control 'gain' can only be read; leave it out");
    }
}
