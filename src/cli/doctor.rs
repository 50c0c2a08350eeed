//! `loci doctor`: what works on this computer, what is missing, and the fix.

use std::path::Path;

use clap::Args;
use loci::cnn::{CARD_FILE, DescriptorModel, ModelCard, OnnxRuntime};
use loci::kernel;
use loci::place_map::PlaceMap;
use loci::raster::RgbImage;
use loci::vocabulary::{Vocabulary, VocabularySet};
use serde::Serialize;

use super::console::say;
use super::settings::StreamSettings;
use super::{Outcome, assets};

/// Arguments of `loci doctor`.
#[derive(Args)]
#[command(after_help = "Example:\n  loci doctor --map maps/site")]
pub(super) struct DoctorArguments {
    #[command(flatten)]
    settings: StreamSettings,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Health {
    Ok,
    Warn,
    Fail,
}

#[derive(Serialize)]
struct Finding {
    part: &'static str,
    health: Health,
    detail: String,
}

impl Finding {
    /// A part that works, or that fails with the reason and the fix in the error.
    fn of(part: &'static str, tried: anyhow::Result<String>) -> Self {
        match tried {
            Ok(detail) => Self { part, health: Health::Ok, detail },
            Err(error) => Self { part, health: Health::Fail, detail: error.to_string() },
        }
    }
}

/// Tries every part and prints a line for each.
pub(super) fn run(arguments: DoctorArguments) -> anyhow::Result<Outcome> {
    let findings = findings(&arguments.settings.completed(None)?);
    if arguments.json {
        say(&serde_json::to_string(&findings)?)?;
    } else {
        for finding in &findings {
            let health = match finding.health {
                Health::Ok => "ok",
                Health::Warn => "warn",
                Health::Fail => "FAIL",
            };
            say(&format!("{health:<5} {:<13} {}", finding.part, finding.detail))?;
        }
    }
    let failed = findings.iter().filter(|finding| finding.health == Health::Fail).count();
    anyhow::ensure!(failed == 0, "{failed} of {} parts do not work", findings.len());
    let warned = findings.iter().any(|finding| finding.health == Health::Warn);
    Ok(if warned { Outcome::Lost } else { Outcome::Done })
}

fn findings(settings: &StreamSettings) -> Vec<Finding> {
    let mut findings = vec![Finding::of("vocabulary", vocabulary(settings))];
    // Without a CNN the runtime goes on with BoW+HV: that is a warning, a broken model is a failure.
    match OnnxRuntime::open(settings.onnxruntime.as_deref()) {
        Ok(runtime) => {
            let detail = format!("{} at {}", runtime.version(), runtime.path().display());
            findings.push(Finding { part: "onnx runtime", health: Health::Ok, detail });
            findings.push(Finding::of("model", model(settings, &runtime)));
        }
        Err(error) => {
            let health = if settings.onnxruntime.is_some() { Health::Fail } else { Health::Warn };
            findings.push(Finding { part: "onnx runtime", health, detail: error.to_string() });
        }
    }
    findings.extend(settings.map.as_deref().map(|folder| Finding::of("map", map(folder, settings))));
    findings.push(rerun());
    let detail = format!("inner loops by {}", kernel::instructions());
    findings.push(Finding { part: "processor", health: Health::Ok, detail });
    findings
}

fn vocabulary(settings: &StreamSettings) -> anyhow::Result<String> {
    let paths = assets::find_vocabularies(&settings.vocab)?;
    let mut found = Vec::new();
    for path in &paths {
        let vocabulary = Vocabulary::open(path)?;
        vocabulary.verify(path)?;
        found.push(format!("{} words in {}", vocabulary.word_count(), path.display()));
    }
    VocabularySet::open(&paths)?;
    Ok(found.join("; "))
}

/// Opens the model and asks it for a descriptor.
fn model(settings: &StreamSettings, runtime: &OnnxRuntime) -> anyhow::Result<String> {
    if settings.is_without_cnn() {
        return Ok("none: BoW+HV decides alone".to_owned());
    }
    let folder = assets::find(settings.model.as_deref(), assets::MODEL, "--model")?;
    let mut model = DescriptorModel::open(&folder, runtime, 1)?;
    // In a picture of one colour a network may see nothing.
    let waves = |at: usize| [(at % 64) * 4, (at / 64) * 4, (at * at) % 256].map(|value| value as u8);
    let image = RgbImage::from_pixels(64, 64, (0..64 * 64).flat_map(waves).collect());
    let descriptor = model.describe(&image.unwrap_or_else(|| RgbImage::new(64, 64)))?;
    Ok(format!("{} answers with {} values", model.card().name, descriptor.dimensions()))
}

fn map(folder: &Path, settings: &StreamSettings) -> anyhow::Result<String> {
    let map = PlaceMap::open_read_only(folder)?;
    if let Some(passed_over) = map.passed_over() {
        anyhow::bail!("{passed_over}; `loci map compact --repair` gives it up");
    }
    let summary = map.summary();
    let known = known_places(&map, settings).unwrap_or_default();
    let (places, experiences, folder) = (summary.places, summary.experiences, folder.display());
    Ok(format!("{places} places, {experiences} experiences in {folder}{known}"))
}

/// How many of the places that the model was trained on are in the map; nothing of a model that was trained on none.
fn known_places(map: &PlaceMap, settings: &StreamSettings) -> Option<String> {
    let folder = assets::find(settings.model.as_deref(), assets::MODEL, "--model").ok()?;
    // What is wrong with a card is said of the model.
    let card = ModelCard::read(&folder.join(CARD_FILE)).ok().filter(|card| !card.classes.is_empty())?;
    let known = map.places_of(&card.classes).iter().flatten().count();
    Some(format!("; it has {known} of the {} places that {} was trained on", card.classes.len(), card.name))
}

fn rerun() -> Finding {
    let part = "rerun";
    if !cfg!(feature = "rerun") {
        let detail = "not in this build; build with `--features rerun`".to_owned();
        return Finding { part, health: Health::Warn, detail };
    }
    let on_path = std::env::var_os("PATH")
        .is_some_and(|path| std::env::split_paths(&path).any(|folder| folder.join("rerun").is_file()));
    let detail = if on_path {
        "recording and viewer".to_owned()
    } else {
        "recording works; for the viewer: pip install rerun-sdk==0.36.3".to_owned()
    };
    Finding { part, health: Health::Ok, detail }
}
