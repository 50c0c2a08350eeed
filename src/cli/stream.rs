//! A stream put together from settings: vocabulary, CNN, map and sinks.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use loci::cnn::{CnnError, DescriptorModel, ModelCard, OnnxRuntime, RuntimeVersion};
use loci::feature::{OrbExtractor, OrbOptions};
use loci::pipeline::Pipeline;
use loci::place_map::PlaceMap;
use loci::recognition::{Recogniser, RecognitionOptions};
use loci::source;
use loci::telemetry::RecognitionSink;
use loci::vocabulary::VocabularySet;

use super::settings::StreamSettings;
use super::{WrongArgument, assets};

/// Puts the stream together. Where there is no ONNX Runtime it says so and does without the CNN.
pub(super) fn pipeline(
    source: &str,
    settings: &StreamSettings,
    mut sinks: Vec<Box<dyn RecognitionSink>>,
) -> anyhow::Result<Pipeline> {
    let rerun = rerun_target(settings.rerun.as_deref())?;
    let sample_interval = settings.sample_interval.map(|interval| u64::from(interval.get()));
    let source = source::open(source, sample_interval)?;
    let vocabularies = VocabularySet::open(&assets::find_vocabularies(&settings.vocab)?)?;
    let model = open_cnn(settings)?.map(|(model, _)| model);
    let options = recognition_options(settings);
    let map = match (&settings.map, options.read_only) {
        (Some(folder), true) => PlaceMap::open_read_only(folder)?,
        (Some(folder), false) => PlaceMap::open(folder)?,
        (None, true) => return Err(WrongArgument("--read-only needs a --map to localise in".into()).into()),
        (None, false) => PlaceMap::in_memory()?,
    };
    report_condition(&map, model.as_ref().map(DescriptorModel::card));
    let card = model.as_ref().map(|model| model.card().clone());
    let recogniser = Recogniser::new(Arc::new(vocabularies), map, card, options);
    // Last, so that a run that cannot start replaces no recording and opens no viewer.
    sinks.extend(rerun_sink(&rerun)?);
    Ok(Pipeline { source, extractor: OrbExtractor::new(OrbOptions::default()), model, recogniser, sinks })
}

pub(super) fn recognition_options(settings: &StreamSettings) -> RecognitionOptions {
    let defaults = RecognitionOptions::default();
    RecognitionOptions {
        place_interval: settings.place_interval.unwrap_or(defaults.place_interval),
        read_only: settings.read_only.unwrap_or(defaults.read_only),
        grow_vocabulary: settings.grow_vocabulary.unwrap_or(defaults.grow_vocabulary),
        ..defaults
    }
}

/// The CNN of `settings` and the runtime that runs it; `None`, said loudly, where no ONNX Runtime can run it.
fn open_cnn(settings: &StreamSettings) -> anyhow::Result<Option<(DescriptorModel, RuntimeVersion)>> {
    let runtime = match OnnxRuntime::open(settings.onnxruntime.as_deref()) {
        Ok(runtime) => runtime,
        Err(error @ (CnnError::NotBuilt | CnnError::RuntimeNotFound { .. })) => {
            eprintln!("loci: NO CNN, going on with BoW+HV alone: {error}");
            return Ok(None);
        }
        Err(error) => return Err(error.into()),
    };
    let folder = assets::find(settings.model.as_deref(), assets::MODEL, "--model")?;
    let threads = settings.threads.map_or(1, |threads| threads.get() as usize);
    Ok(Some((DescriptorModel::open(&folder, &runtime, threads)?, runtime.version())))
}

/// What looks at frames for an evaluation, with the version of the ONNX Runtime that it uses.
#[cfg(feature = "evaluation")]
pub(super) fn eyes(
    vocabularies: &[std::path::PathBuf],
    settings: &StreamSettings,
) -> anyhow::Result<(loci::evaluation::Eyes, Option<RuntimeVersion>)> {
    let vocabularies = Arc::new(VocabularySet::open(vocabularies)?);
    let (model, version) = open_cnn(settings)?.unzip();
    let extractor = OrbExtractor::new(OrbOptions::default());
    Ok((loci::evaluation::Eyes { extractor, vocabularies, model }, version))
}

/// Says what a user would want to know of a map before a run.
fn report_condition(map: &PlaceMap, card: Option<&ModelCard>) {
    let summary = map.summary();
    if summary.torn_bytes > 0 {
        eprintln!("loci: the map's last record was torn ({} bytes) and is left out", summary.torn_bytes);
    }
    if let Some(card) = card
        && summary.models.iter().any(|model| *model != card.sha256)
    {
        eprintln!(
            "loci: the map has CNN descriptors of another model than {}; their keyframes are found by BoW+HV alone",
            card.name
        );
    }
}

#[cfg(feature = "rerun")]
type RerunTarget = loci::telemetry::RerunTarget;

#[cfg(feature = "rerun")]
fn rerun_target(text: Option<&str>) -> anyhow::Result<RerunTarget> {
    Ok(text.unwrap_or("off").parse::<RerunTarget>().map_err(|error| WrongArgument(error.to_string()))?)
}

#[cfg(feature = "rerun")]
fn rerun_sink(target: &RerunTarget) -> anyhow::Result<Option<Box<dyn RecognitionSink>>> {
    match target {
        RerunTarget::Off => Ok(None),
        target => Ok(Some(Box::new(loci::telemetry::RerunSink::open(target)?))),
    }
}

/// Nowhere: all that a build without rerun can show.
#[cfg(not(feature = "rerun"))]
struct Nowhere;

#[cfg(not(feature = "rerun"))]
fn rerun_target(text: Option<&str>) -> anyhow::Result<Nowhere> {
    match text.unwrap_or("off") {
        "off" => Ok(Nowhere),
        _ => Err(WrongArgument("this build has no rerun; build with `--features rerun`".to_owned()).into()),
    }
}

#[cfg(not(feature = "rerun"))]
fn rerun_sink(_: &Nowhere) -> anyhow::Result<Option<Box<dyn RecognitionSink>>> {
    Ok(None)
}

/// A flag that Ctrl-C and SIGTERM set. The second one ends the program at once.
pub(super) fn stop_flag() -> anyhow::Result<Arc<AtomicBool>> {
    use signal_hook::consts::{SIGINT, SIGTERM};
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))
            .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop)))
            .map_err(|error| anyhow::anyhow!("cannot listen for Ctrl-C: {error}"))?;
    }
    Ok(stop)
}
