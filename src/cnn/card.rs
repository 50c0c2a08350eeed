//! The model card, `card.toml`: what a network is, how to feed it, what its answers mean.
//!
//! The card travels with the network and binds it by SHA-256. It holds everything that the program must
//! know to use the network, so a retrained model needs no new program. Unknown keys are refused: a
//! mistyped threshold must not silently become a default.

use std::collections::BTreeMap;
use std::io::Read;
use std::ops::RangeInclusive;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::error::{CnnError, one_line};

/// Largest card that is read, in bytes.
pub(super) const LARGEST_CARD_BYTES: u64 = 1 << 20;
const SIDE_PX: RangeInclusive<usize> = 16..=1024;
const DIMENSIONS: RangeInclusive<usize> = 1..=8192;
const LARGEST_WEIGHT: f32 = 1000.0;

/// A model card.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ModelCard {
    /// Name of the model, such as `efficientnet-lite0`.
    pub name: String,
    /// Version of the model.
    pub version: String,
    /// What it is, for people.
    pub description: String,
    /// Licence of the weights, as an SPDX expression.
    pub licence: String,
    /// Where the weights come from.
    pub source: String,
    /// How to make the network again.
    pub recipe: String,
    /// SHA-256 of `model.onnx`, 64 hexadecimal digits.
    pub sha256: String,
    /// What goes in.
    pub input: InputCard,
    /// What comes out.
    pub descriptor: DescriptorCard,
    /// What an answer means.
    pub decision: DecisionCard,
    /// What it means together with geometry; those of the shipped model where the card does not say.
    #[serde(default)]
    pub fusion: FusionCard,
    /// What it learnt from.
    pub training: TrainingCard,
    /// Measured figures, for people: name to value with unit.
    pub metrics: BTreeMap<String, String>,
    /// The places that it was trained on, in the order of its output `class_scores`; none if it has no such output.
    #[serde(default, rename = "class", skip_serializing_if = "Vec::is_empty")]
    pub classes: Vec<ClassCard>,
}

/// The network's input: RGB planes `[1, 3, height, width]` of (value − mean) · scale.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct InputCard {
    /// Name of the input in the graph.
    pub name: String,
    /// Width in pixels, 16 to 1024.
    pub width_px: usize,
    /// Height in pixels, 16 to 1024.
    pub height_px: usize,
    /// Subtracted from each 8-bit value.
    pub mean: f32,
    /// Multiplies what is left; not zero.
    pub scale: f32,
}

/// The network's output: `[1, dimensions]`.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DescriptorCard {
    /// Name of the output in the graph.
    pub name: String,
    /// Number of values, 1 to 8192.
    pub dimensions: usize,
}

/// What a cosine between two descriptors means.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DecisionCard {
    /// A cosine above this recognises the place, in [-1, 1].
    pub recognise_above: f32,
    /// Slope of the logistic calibration; not negative.
    pub calibration_slope: f32,
    /// Offset of the logistic calibration.
    pub calibration_offset: f32,
}

/// A logistic model of what the network and geometry say together of a place: the weights of its log odds.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FusionCard {
    /// Where everything else is zero.
    pub offset: f32,
    /// Of the log odds that the calibration gives the cosine.
    pub cosine: f32,
    /// Of what these log odds are more than those of the fourth most alike of the other places.
    pub cosine_margin: f32,
    /// Of ln(1 + effective inliers).
    pub inliers: f32,
    /// Of there being inliers at all.
    pub any_inliers: f32,
    /// Of what ln(1 + effective inliers) is more than that of the best place neither next to it nor its twin.
    pub inlier_margin: f32,
    /// Least log odds of a place whose cosine passes `recognise_above`, where geometry verifies no other one.
    #[serde(default = "passed")]
    pub passed: f32,
    /// What the weights but for the last were fitted on, for people.
    pub data: String,
}

/// ln 100: one in two hundred frames of other places passes the threshold, and half of those of the place itself by
/// day. By night there may be no geometry to ask.
fn passed() -> f32 {
    4.6
}

impl Default for FusionCard {
    /// The weights of the shipped model. They are of calibrated log odds and of a threshold that few strangers pass, so
    /// they hold for other networks, too, of which as few pass it.
    fn default() -> Self {
        Self {
            offset: -1.289,
            cosine: 0.257,
            cosine_margin: 0.312,
            inliers: 1.307,
            any_inliers: -3.564,
            inlier_margin: 1.042,
            passed: passed(),
            data: "those of efficientnet-lite0, version 2".to_owned(),
        }
    }
}

impl FusionCard {
    fn weights(&self) -> [f32; 7] {
        let Self { offset, cosine, cosine_margin, inliers, any_inliers, inlier_margin, passed, .. } = *self;
        [offset, cosine, cosine_margin, inliers, any_inliers, inlier_margin, passed]
    }
}

/// What the network and its calibration learnt from.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingCard {
    /// The data, for people.
    pub data: String,
}

/// A place that the network was trained on.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ClassCard {
    /// Its number in the map that it was trained from.
    pub place: u32,
    /// Its name then, if it had one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Difference hashes of some of its experiences, 16 hexadecimal digits each: by them it can be found in a map in
    /// which its number is another one.
    pub views: Vec<String>,
}

impl ModelCard {
    /// Reads and checks a card.
    ///
    /// # Errors
    /// [`CnnError::Unreadable`] if it is no regular file of at most 1 MiB, [`CnnError::Card`] naming the
    /// key that breaks a rule.
    pub fn read(path: &Path) -> Result<Self, CnnError> {
        let text = String::from_utf8(read_bounded(path, LARGEST_CARD_BYTES)?);
        let refuse = |reason| CnnError::Card { path: path.to_path_buf(), reason };
        let text = text.map_err(|_| refuse("it is not UTF-8 text".to_owned()))?;
        let card: Self = toml::from_str(&text).map_err(|error| refuse(described(&error, &text)))?;
        card.check().map_err(refuse)?;
        Ok(card)
    }

    /// Probability that two descriptors of this cosine show the same place: 1 / (1 + e^−(slope·cos + offset)).
    #[must_use]
    pub fn probability(&self, cosine: f32) -> f32 {
        1.0 / (1.0 + (-self.log_odds(cosine)).exp())
    }

    /// Log odds of that: slope·cos + offset.
    #[must_use]
    pub fn log_odds(&self, cosine: f32) -> f32 {
        self.decision.calibration_slope * cosine + self.decision.calibration_offset
    }

    pub(super) fn check(&self) -> Result<(), String> {
        let sha256_fits =
            self.sha256.len() == 64 && self.sha256.bytes().all(|digit| digit.is_ascii_hexdigit());
        let rules = [
            (!self.name.trim().is_empty(), "name is empty"),
            (sha256_fits, "sha256 is not 64 hexadecimal digits"),
            (!self.input.name.is_empty(), "input.name is empty"),
            (SIDE_PX.contains(&self.input.width_px), "input.width_px is not within 16..=1024"),
            (SIDE_PX.contains(&self.input.height_px), "input.height_px is not within 16..=1024"),
            (self.input.mean.is_finite(), "input.mean is not finite"),
            (self.input.scale.is_finite() && self.input.scale != 0.0, "input.scale is not finite or is zero"),
            (!self.descriptor.name.is_empty(), "descriptor.name is empty"),
            (
                DIMENSIONS.contains(&self.descriptor.dimensions),
                "descriptor.dimensions is not within 1..=8192",
            ),
            (
                (-1.0..=1.0).contains(&self.decision.recognise_above),
                "decision.recognise_above is not within -1..=1",
            ),
            (
                self.decision.calibration_slope.is_finite() && self.decision.calibration_slope >= 0.0,
                "decision.calibration_slope is not finite or is negative",
            ),
            (self.decision.calibration_offset.is_finite(), "decision.calibration_offset is not finite"),
            (
                self.fusion.weights().iter().all(|weight| weight.abs() <= LARGEST_WEIGHT),
                "a weight of fusion is not within -1000..=1000",
            ),
        ];
        rules.iter().find(|(holds, _)| !holds).map_or(Ok(()), |(_, rule)| Err((*rule).to_owned()))
    }
}

/// The parser's words with the line of the card they are about.
fn described(error: &toml::de::Error, text: &str) -> String {
    let before = error.span().and_then(|span| text.get(..span.start));
    let line = before.map(|before| format!(" (line {})", before.matches('\n').count() + 1));
    one_line(error.message()) + &line.unwrap_or_default()
}

/// The bytes of a regular file; a pipe, a device or a file above `largest_bytes` is refused unread.
pub(super) fn read_bounded(path: &Path, largest_bytes: u64) -> Result<Vec<u8>, CnnError> {
    let refuse = |reason: String| CnnError::Unreadable { path: path.to_path_buf(), reason };
    let metadata = std::fs::metadata(path).map_err(|error| refuse(error.to_string()))?;
    if !metadata.is_file() {
        return Err(refuse("it is not a regular file".to_owned()));
    }
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(|error| refuse(error.to_string()))?;
    // One byte more than allowed tells a file that is too large from one that just fits, even while it grows.
    file.take(largest_bytes + 1).read_to_end(&mut bytes).map_err(|error| refuse(error.to_string()))?;
    if bytes.len() as u64 > largest_bytes {
        return Err(refuse(format!("it is larger than {} MiB", largest_bytes >> 20)));
    }
    Ok(bytes)
}

#[cfg(test)]
pub(super) mod tests {
    use std::path::PathBuf;

    use tempfile::TempDir;

    use super::*;

    pub(in crate::cnn) const CARD: &str = r#"
name = "toy"
version = "1"
description = "a toy"
licence = "MIT"
source = "made up"
recipe = "none"
sha256 = "0000000000000000000000000000000000000000000000000000000000000000"

[input]
name = "image"
width_px = 224
height_px = 160
mean = 127
scale = 0.0078125

[descriptor]
name = "descriptor"
dimensions = 1280

[decision]
recognise_above = 0.8
calibration_slope = 10.0
calibration_offset = -8.0

[training]
data = "none"

[metrics]
recall = "0.9 at 1"
"#;

    fn read(text: &[u8]) -> Result<ModelCard, String> {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("card.toml");
        std::fs::write(&path, text).unwrap();
        ModelCard::read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn a_complete_card_is_read() {
        let card = read(CARD.as_bytes()).unwrap();
        assert_eq!((card.input.width_px, card.input.height_px, card.input.mean), (224, 160, 127.0));
        assert_eq!(card.metrics["recall"], "0.9 at 1");
    }

    #[test]
    fn a_card_without_weights_has_those_of_the_shipped_one_and_impossible_ones_are_refused() {
        let shipped = ModelCard::read(Path::new("models/efficientnet-lite0/card.toml")).unwrap();
        assert_eq!(shipped.fusion.weights(), read(CARD.as_bytes()).unwrap().fusion.weights());
        let keys = ["offset", "cosine", "cosine_margin", "inliers", "any_inliers", "inlier_margin"];
        let weights: String = keys.iter().map(|key| format!("{key} = 1e9\n")).collect();
        let table = format!("[fusion]\n{weights}data = ''\n");
        let error = read(format!("{CARD}\n{table}").as_bytes()).unwrap_err();
        assert!(error.contains("a weight of fusion is not within -1000..=1000"), "{error}");
    }

    #[test]
    fn probability_is_a_half_at_the_calibrated_cosine_and_grows_with_it() {
        let card = read(CARD.as_bytes()).unwrap();
        assert!((card.probability(0.8) - 0.5).abs() < 1e-6);
        assert!(card.probability(1.0) > 0.88 && card.probability(0.5) < 0.05);
        assert!((0.0..=1.0).contains(&card.probability(-1.0)));
    }

    #[test]
    fn a_broken_rule_is_reported_with_the_card_and_the_key() {
        let cases = [
            ("width_px = 224", "width_px = 2048", "input.width_px"),
            ("height_px = 160", "height_px = 0", "input.height_px"),
            ("height_px = 160", "height_px = -3", "line 13"),
            ("scale = 0.0078125", "scale = inf", "input.scale"),
            ("scale = 0.0078125", "scale = 0.0", "input.scale"),
            ("mean = 127", "mean = nan", "input.mean"),
            ("dimensions = 1280", "dimensions = 100000", "descriptor.dimensions"),
            ("recognise_above = 0.8", "recognise_above = 1.5", "decision.recognise_above"),
            ("calibration_slope = 10.0", "calibration_slope = -1.0", "decision.calibration_slope"),
            ("calibration_offset = -8.0", "calibration_offset = nan", "decision.calibration_offset"),
            ("sha256 = \"0000", "sha256 = \"zz00", "sha256"),
            ("name = \"toy\"", "name = \" \"", "name is empty"),
            ("licence = \"MIT\"\n", "", "licence"),
            ("licence = \"MIT\"", "license = \"MIT\"", "license"),
            ("data = \"none\"", "data = \"none\"\nhours = 3", "hours"),
            ("recall = \"0.9 at 1\"", "recall = 0.9", "line 30"),
        ];
        for (old, new, word) in cases {
            assert!(CARD.contains(old), "{old}");
            let error = read(CARD.replacen(old, new, 1).as_bytes()).unwrap_err();
            assert!(error.contains("card.toml: bad model card: "), "{error}");
            assert!(error.contains(word), "{new}: {error}");
            assert!(!error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn a_file_that_is_no_card_is_reported_by_name() {
        for bytes in [&b"\xff\xfe\x00"[..], b"hello", b"", b"[[[[", &[b'#'; (1 << 20) + 1]] {
            let error = read(bytes).unwrap_err();
            assert!(error.contains("card.toml: ") && !error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn a_missing_card_a_folder_and_a_device_are_refused_unread() {
        for path in ["/nowhere/card.toml", "/", "/dev/zero"] {
            let error = ModelCard::read(&PathBuf::from(path)).unwrap_err();
            assert!(matches!(error, CnnError::Unreadable { .. }), "{error}");
        }
    }
}
