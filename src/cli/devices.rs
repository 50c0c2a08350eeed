//! `loci devices`: the cameras of this computer, what they offer, and a source to begin with.

use clap::Args;

use super::Outcome;

/// Arguments of `loci devices`.
#[derive(Args)]
#[command(after_help = "Examples:\n  loci devices\n  loci devices --json")]
pub(super) struct DevicesArguments {
    /// Print a JSON object
    #[arg(long)]
    json: bool,
}

/// Says that cameras are missing from this build.
#[cfg(not(feature = "v4l"))]
pub(super) fn run(_: &DevicesArguments) -> anyhow::Result<Outcome> {
    anyhow::bail!("this build has no cameras; build with `--features v4l`")
}

/// Prints every camera.
#[cfg(feature = "v4l")]
pub(super) fn run(arguments: &DevicesArguments) -> anyhow::Result<Outcome> {
    let (mut cameras, mut refusals) = (Vec::new(), Vec::new());
    for found in loci::source::cameras() {
        match found {
            Ok(camera) => cameras.push(camera),
            Err(refusal) => refusals.push(refusal.to_string()),
        }
    }
    let text = if arguments.json { listing::json(&cameras, &refusals)? } else { listing::text(&cameras) };
    if !text.is_empty() {
        super::console::say(&text)?;
    }
    for refusal in &refusals {
        eprintln!("loci: {refusal}");
    }
    if cameras.is_empty() && refusals.is_empty() {
        eprintln!(
            "loci: no cameras; plug one in, or load its driver (`ls /dev/video*` shows what the kernel has)"
        );
    }
    Ok(if refusals.is_empty() { Outcome::Done } else { Outcome::Lost })
}

/// Cameras as text and as JSON.
#[cfg(feature = "v4l")]
mod listing {
    use loci::source::{Camera, CameraControl, CameraFormat, FrameRates, FrameSize};
    use serde::Serialize;

    /// What `--json` prints.
    #[derive(Serialize)]
    struct Document<'a> {
        schema: &'static str,
        cameras: &'a [Camera],
        /// Why other nodes could not be asked.
        refusals: &'a [String],
    }

    pub(super) fn json(cameras: &[Camera], refusals: &[String]) -> anyhow::Result<String> {
        Ok(serde_json::to_string(&Document { schema: "loci-devices-1", cameras, refusals })?)
    }

    pub(super) fn text(cameras: &[Camera]) -> String {
        cameras.iter().map(camera_text).collect::<Vec<_>>().join("\n\n")
    }

    fn camera_text(camera: &Camera) -> String {
        let mut lines = vec![format!("{}  {}", camera.path.display(), camera.card)];
        lines.extend(camera.link.as_ref().map(|link| format!("  link      {}", link.display())));
        lines.push(format!("  driver    {}, at {}", camera.driver, camera.bus));
        let (read, others): (Vec<_>, Vec<_>) = camera.formats.iter().partition(|format| format.is_read);
        lines.extend(read.into_iter().flat_map(format_lines));
        if !others.is_empty() {
            let names: Vec<&str> = others.iter().map(|format| format.name.as_str()).collect();
            lines.push(format!("  others    {}, which Loci does not read", names.join(", ")));
        }
        if !camera.controls.is_empty() {
            lines.push("  controls".to_owned());
        }
        lines.extend(camera.controls.iter().map(control_line));
        lines.push(match &camera.source {
            Some(source) => format!("  try       loci run '{source}' --map maps/site"),
            None => "  try       another camera: Loci reads none of these formats".to_owned(),
        });
        lines.join("\n")
    }

    fn format_lines(format: &CameraFormat) -> Vec<String> {
        let mut lines = vec![format!("  format    {}  {}", format.name, format.description)];
        lines.extend(format.sizes.iter().map(|size| format!("            {}", size_text(size))));
        lines
    }

    fn size_text(size: &FrameSize) -> String {
        let FrameSize { from_px: [width, height], to_px, step_px, rates } = size;
        let to = if (to_px, step_px) == (&size.from_px, &[0, 0]) {
            String::new()
        } else {
            format!(" to {}x{}, in steps of {}x{}", to_px[0], to_px[1], step_px[0], step_px[1])
        };
        let rates = match rates {
            FrameRates::Each(rates) if rates.is_empty() => String::new(),
            FrameRates::Each(rates) => {
                let rates: Vec<String> = rates.iter().map(f64::to_string).collect();
                format!("  {} frames/s", rates.join(", "))
            }
            FrameRates::Between(slowest, fastest) => format!("  {slowest} to {fastest} frames/s"),
        };
        format!("{width}x{height}{to}{rates}")
    }

    fn control_line(control: &CameraControl) -> String {
        let mut parts = vec![format!("    {:<30}  {}", control.name, taken(control))];
        if matches!(control.kind, "integer" | "boolean" | "menu" | "bitmask") {
            parts.push(format!("default {}", control.default));
            parts.extend(control.value.map(|value| format!("now {value}")));
        }
        parts.extend((!control.is_settable).then(|| "cannot be set".to_owned()));
        parts.extend(control.is_inactive.then(|| "inactive while an automatic sees to it".to_owned()));
        parts.join(", ")
    }

    /// What a control takes.
    fn taken(control: &CameraControl) -> String {
        match control.kind {
            "boolean" => "off (0) or on (1)".to_owned(),
            "menu" => {
                let items = control.items.iter().map(|item| format!("{} ({})", item.value, item.name));
                items.collect::<Vec<_>>().join(", ")
            }
            "bitmask" => format!("a sum of the bits of {}", control.maximum),
            "integer" if control.step > 1 => {
                format!("{} to {} in steps of {}", control.minimum, control.maximum, control.step)
            }
            "integer" => format!("{} to {}", control.minimum, control.maximum),
            other => other.to_owned(),
        }
    }

    #[cfg(test)]
    mod tests {
        use loci::source::ControlItem;

        use super::*;

        fn control(name: &str, kind: &'static str) -> CameraControl {
            CameraControl {
                name: name.to_owned(),
                description: name.to_owned(),
                kind,
                minimum: 0,
                maximum: 255,
                step: 1,
                default: 16,
                value: Some(8),
                items: Vec::new(),
                is_settable: true,
                is_inactive: false,
            }
        }

        fn size(from_px: [u32; 2], rates: FrameRates) -> FrameSize {
            FrameSize { from_px, to_px: from_px, step_px: [0, 0], rates }
        }

        fn camera() -> Camera {
            let menu = CameraControl {
                items: [(0, "Auto Mode"), (1, "Manual Mode")]
                    .map(|(value, name)| ControlItem { value, name: name.to_owned() })
                    .to_vec(),
                ..control("auto_exposure", "menu")
            };
            let range = FrameSize {
                to_px: [1920, 1080],
                step_px: [2, 2],
                ..size([16, 16], FrameRates::Between(1.0, 60.0))
            };
            let format = |name: &str, is_read, size| CameraFormat {
                name: name.to_owned(),
                description: "as it comes".to_owned(),
                is_read,
                sizes: vec![size],
            };
            let pressed = CameraControl { is_settable: false, ..control("pan_reset", "button") };
            Camera {
                path: "/dev/video0".into(),
                link: Some("/dev/v4l/by-id/usb-C920".into()),
                card: "C920".to_owned(),
                driver: "uvcvideo".to_owned(),
                bus: "usb-1".to_owned(),
                formats: vec![
                    format("mjpg", true, size([640, 480], FrameRates::Each(vec![30.0, 7.5]))),
                    format("grey", true, range),
                    format("H264", false, size([640, 480], FrameRates::Each(vec![30.0]))),
                    format("UYVY", false, size([640, 480], FrameRates::Each(vec![30.0]))),
                ],
                controls: vec![
                    CameraControl { is_inactive: true, step: 5, ..control("gain", "integer") },
                    menu,
                    pressed,
                ],
                source: Some("v4l2:/dev/v4l/by-id/usb-C920?size=640x480&format=mjpg".to_owned()),
            }
        }

        #[test]
        fn a_camera_is_told_with_all_that_it_offers() {
            let expected = "\
/dev/video0  C920
  link      /dev/v4l/by-id/usb-C920
  driver    uvcvideo, at usb-1
  format    mjpg  as it comes
            640x480  30, 7.5 frames/s
  format    grey  as it comes
            16x16 to 1920x1080, in steps of 2x2  1 to 60 frames/s
  others    H264, UYVY, which Loci does not read
  controls
    gain                            0 to 255 in steps of 5, default 16, now 8, inactive while an automatic sees to it
    auto_exposure                   0 (Auto Mode), 1 (Manual Mode), default 16, now 8
    pan_reset                       button, cannot be set
  try       loci run 'v4l2:/dev/v4l/by-id/usb-C920?size=640x480&format=mjpg' --map maps/site";
            assert_eq!(text(&[camera()]), expected);
            assert_eq!(text(&[camera(), camera()]).matches("\n\n/dev/video0").count(), 1);
            let unreadable = Camera { link: None, source: None, ..camera() };
            assert!(text(&[unreadable]).ends_with("Loci reads none of these formats"));
        }

        #[test]
        fn json_has_its_schema_and_an_empty_list_where_there_are_none() {
            let document: serde_json::Value = serde_json::from_str(&json(&[], &[]).unwrap()).unwrap();
            let expected = serde_json::json!({"schema": "loci-devices-1", "cameras": [], "refusals": []});
            assert_eq!(document, expected);
            let document: serde_json::Value = serde_json::from_str(&json(&[camera()], &[]).unwrap()).unwrap();
            let camera = &document["cameras"][0];
            assert_eq!(camera["formats"][0]["sizes"][0]["rates"]["each"], serde_json::json!([30.0, 7.5]));
            assert_eq!(camera["formats"][1]["sizes"][0]["rates"]["between"], serde_json::json!([1.0, 60.0]));
            assert_eq!(camera["controls"][1]["items"][1]["value"], 1);
        }
    }
}
