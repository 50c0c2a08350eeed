//! The head of a report: all that is needed to get the same figures again.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use loci::cnn::ModelCard;
use loci::evaluation::results::{Asset, Header};
use loci::evaluation::{Eyes, RobotOptions, machine};
use loci::feature::OrbOptions;
use loci::retrieval::MAX_RETRIEVED;

/// The head of a report made with `eyes` and `options`.
pub(super) fn header(
    eyes: &Eyes,
    options: &RobotOptions,
    (vocabularies, suite): (&[PathBuf], Option<Asset>),
    backend: String,
) -> anyhow::Result<Header> {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let card = eyes.model.as_ref().map(|model| model.card());
    Ok(Header {
        loci: env!("CARGO_PKG_VERSION").to_owned(),
        command: command_line(std::env::args().skip(1)),
        cpu: machine::cpu(),
        cpu_threads: machine::cpu_threads(),
        backend,
        vocabularies: vocabularies
            .iter()
            .map(|path| loci::evaluation::asset(name(path), path))
            .collect::<Result<_, _>>()?,
        model: card.map(|card| Asset {
            name: format!("{} {}", card.name, card.version),
            sha256: card.sha256.clone(),
        }),
        suite,
        settings: setting_values(eyes.extractor.options(), options, card),
    })
}

/// Every setting that bears on a decision.
fn setting_values(
    orb: &OrbOptions,
    RobotOptions { recognition, map }: &RobotOptions,
    card: Option<&ModelCard>,
) -> BTreeMap<String, String> {
    let verification = &recognition.verification;
    let (matching, hough) = (&verification.matching, &verification.hough);
    let mut values = BTreeMap::from([
        ("orb.max_features", orb.max_features.to_string()),
        ("orb.levels", orb.levels.to_string()),
        ("orb.scale_factor", orb.scale_factor.to_string()),
        ("orb.threshold", orb.threshold.to_string()),
        ("orb.fallback_threshold", orb.fallback_threshold.to_string()),
        ("orb.min_width_px", orb.min_width_px.to_string()),
        ("place_interval", recognition.place_interval.to_string()),
        ("grow_vocabulary", recognition.grow_vocabulary.to_string()),
        ("keyframe_features", recognition.keyframe_features.to_string()),
        ("map_memory_bytes", recognition.memory_bytes.to_string()),
        ("map_disk_bytes", map.disk_bytes.to_string()),
        ("accept_above", recognition.accept_above.to_string()),
        ("sequence", recognition.sequence.to_string()),
        ("min_inliers", recognition.min_inliers.to_string()),
        ("retrieval.max_retrieved", MAX_RETRIEVED.to_string()),
        ("verification.loose_tolerance", verification.loose_tolerance.to_string()),
        ("verification.tight_tolerance", verification.tight_tolerance.to_string()),
        ("verification.max_area_ratio", verification.max_area_ratio.to_string()),
        ("verification.grid_cells", verification.grid_cells.to_string()),
        ("matching.max_distance_bits", matching.max_distance_bits.to_string()),
        ("matching.max_ratio", matching.max_ratio.to_string()),
        ("hough.levels", hough.levels.to_string()),
        ("hough.level_decay", hough.level_decay.to_string()),
        ("hough.translation_bins", hough.translation_bins.to_string()),
        ("hough.scale_bins", hough.scale_bins.to_string()),
        ("hough.rotation_bins", hough.rotation_bins.to_string()),
    ]);
    if let Some(card) = card {
        values.insert("cnn.recognise_above", card.decision.recognise_above.to_string());
    }
    values.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

/// The command line as one would type it again.
fn command_line(arguments: impl Iterator<Item = String>) -> String {
    let quoted = arguments.map(|argument| {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_=./,:%+".contains(c);
        if !argument.is_empty() && argument.chars().all(is_plain) {
            argument
        } else {
            format!("'{}'", argument.replace('\'', "'\\''"))
        }
    });
    std::iter::once("loci".to_owned()).chain(quoted).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_can_be_typed_again() {
        let arguments = ["evaluate", "synthetic:street?laps=2&light=dusk", "it's", "--recent=5"];
        let typed = command_line(arguments.into_iter().map(str::to_owned));
        assert_eq!(typed, "loci evaluate 'synthetic:street?laps=2&light=dusk' 'it'\\''s' --recent=5");
    }
}
