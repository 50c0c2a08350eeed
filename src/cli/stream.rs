//! A stream put together from settings: vocabulary, CNN, map and sinks.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use bytesize::ByteSize;
use loci::cnn::{CnnError, DescriptorModel, ModelCard, OnnxRuntime};
use loci::feature::{OrbExtractor, OrbOptions};
use loci::pipeline::{CpuBudget, ModelFolder, Pipeline};
use loci::place_map::{MapError, MapOptions, PlaceMap};
use loci::recognition::{Recogniser, RecognitionOptions};
use loci::source::{self, FrameSource};
use loci::telemetry::RecognitionSink;
use loci::vocabulary::VocabularySet;

use super::console::counted;
use super::settings::{StreamSettings, Switch};
use super::size::Size;
use super::viewers::Viewers;
use super::{WrongArgument, assets};

/// Smallest `--map-disk` and `--map-memory`: below, a map is too small to be one.
const MIN_MAP_SIZE: ByteSize = ByteSize::mib(1);
/// Most bytes of a map that is gone at the end.
const MAX_MEMORY_MAP_BYTES: u64 = 1 << 30;

/// Puts the stream together. Where there is no ONNX Runtime it says so and does without the CNN.
pub(super) fn pipeline(
    source: &str,
    settings: &StreamSettings,
    mut sinks: Vec<Box<dyn RecognitionSink>>,
) -> anyhow::Result<Pipeline> {
    let viewers = Viewers::of(settings)?;
    let (options, map_options) = (recognition_options(settings)?, map_options(settings)?);
    let sample_interval = settings.sample_interval.map(|interval| u64::from(interval.get()));
    let mut source = source::open(source, sample_interval)?;
    if let Some(poses) = &settings.pose {
        if poses.is_live() && !source.is_live() {
            let reason = format!(
                "--pose {poses} tells where the robot is now: for frames of another day, name a file"
            );
            return Err(WrongArgument(reason).into());
        }
        source = Box::new(source::PosedSource::open(source, poses)?);
    }
    if let Some(fps) = settings.play_fps {
        source = played(source, fps)?;
    }
    let vocabularies = VocabularySet::open(&assets::find_vocabularies(&settings.vocab)?)?;
    let (model, model_folder) = open_cnn(settings)?.unzip();
    let (map, unwritable) = open_map(settings, map_options, options.read_only)?;
    report_condition(&map);
    let card = model.as_ref().map(|model| model.card().clone());
    let mut recogniser = Recogniser::new(Arc::new(vocabularies), map, card, options)?;
    let foreign = recogniser.foreign_descriptors();
    let outlook = " until they are described anew";
    report_foreign_descriptors(foreign, model.as_ref().map(DescriptorModel::card), outlook);
    if let Some(unwritable) = unwritable {
        recogniser.read_only_because(unwritable);
    }
    // Last, so that a run that cannot start for anything else replaces no recording and opens no viewer.
    sinks.extend(viewers.open()?);
    let extractor = OrbExtractor::new(OrbOptions::default());
    let budget = settings.cpu_budget;
    Ok(Pipeline { source, extractor, model, model_folder, recogniser, sinks, budget })
}

/// A recording, played at this rate.
fn played(source: Box<dyn FrameSource>, fps: f64) -> anyhow::Result<Box<dyn FrameSource>> {
    if source.is_live() {
        let reason = "--play-fps plays recordings; a camera has its own rate: v4l2:DEVICE?fps=30".to_owned();
        return Err(WrongArgument(reason).into());
    }
    if !(1.0..=1000.0).contains(&fps) {
        return Err(WrongArgument(format!("--play-fps {fps}: expected 1 to 1000 frames a second")).into());
    }
    Ok(Box::new(source::PacedSource::new(source, fps)))
}

/// The map of `settings`; where there is one but it is damaged or its folder cannot be written, for reading, with the
/// reason.
fn open_map(
    settings: &StreamSettings,
    options: MapOptions,
    is_read_only: bool,
) -> anyhow::Result<(PlaceMap, Option<MapError>)> {
    match (&settings.map, is_read_only) {
        (Some(folder), true) => Ok((PlaceMap::open_read_only(folder)?, None)),
        (Some(folder), false) => match PlaceMap::open(folder, options) {
            Ok(map) => Ok((map, None)),
            Err(error) if error.is_unwritable() || matches!(error, MapError::Damaged { .. }) => {
                match PlaceMap::open_read_only(folder) {
                    Ok(map) => Ok((map, Some(error))),
                    Err(_) => Err(error.into()),
                }
            }
            Err(error) => Err(error.into()),
        },
        (None, true) => Err(WrongArgument("--read-only needs a --map to localise in".into()).into()),
        (None, false) => {
            let disk_bytes = options.disk_bytes.min(MAX_MEMORY_MAP_BYTES);
            Ok((PlaceMap::in_memory(MapOptions { disk_bytes, ..options })?, None))
        }
    }
}

pub(super) fn map_options(settings: &StreamSettings) -> anyhow::Result<MapOptions> {
    let defaults = MapOptions::default();
    let disk_bytes = bytes_of("--map-disk", settings.map_disk)?.unwrap_or(defaults.disk_bytes);
    Ok(MapOptions { durability: settings.durability.unwrap_or_default(), disk_bytes, ..defaults })
}

/// The size that `flag` was given, unless no map would fit into it.
fn bytes_of(flag: &str, size: Option<Size>) -> Result<Option<u64>, WrongArgument> {
    match size.map(Size::bytes) {
        Some(bytes) if bytes < MIN_MAP_SIZE.as_u64() => {
            Err(WrongArgument(format!("{flag} must be at least 1MiB, not {}", ByteSize(bytes))))
        }
        bytes => Ok(bytes),
    }
}

pub(super) fn recognition_options(settings: &StreamSettings) -> anyhow::Result<RecognitionOptions> {
    let defaults = RecognitionOptions::default();
    let memory_bytes = bytes_of("--map-memory", settings.map_memory)?;
    Ok(RecognitionOptions {
        place_interval: settings.place_interval.unwrap_or(defaults.place_interval),
        sequence: settings.sequence.map_or(defaults.sequence, |switch| switch == Switch::On),
        read_only: settings.read_only.unwrap_or(defaults.read_only),
        grow_vocabulary: settings.grow_vocabulary.unwrap_or(defaults.grow_vocabulary),
        memory_bytes: memory_bytes.map_or(defaults.memory_bytes, |bytes| bytes as usize),
        ..defaults
    })
}

/// The CNN of `settings` and where it came from; `None` where none is wanted and, said loudly, where no ONNX Runtime
/// can run it.
fn open_cnn(settings: &StreamSettings) -> anyhow::Result<Option<(DescriptorModel, ModelFolder)>> {
    if settings.is_without_cnn() {
        return Ok(None);
    }
    let runtime = match OnnxRuntime::open(settings.onnxruntime.as_deref()) {
        Ok(runtime) => runtime,
        Err(error @ (CnnError::NotBuilt | CnnError::RuntimeNotFound { .. })) => {
            eprintln!("loci: NO CNN, going on with BoW+HV alone: {error}");
            return Ok(None);
        }
        Err(error) => return Err(error.into()),
    };
    let path = assets::find(settings.model.as_deref(), assets::MODEL, "--model")?;
    let threads = settings.threads.or(settings.cpu_budget.map(CpuBudget::cnn_threads));
    let threads = threads.map_or(1, |threads| threads.get() as usize);
    let folder = ModelFolder { path, runtime, threads };
    Ok(Some((folder.open()?, folder)))
}

/// What looks at frames for an evaluation, with the version of the ONNX Runtime that it uses.
#[cfg(feature = "evaluation")]
pub(super) fn eyes(
    vocabularies: &[std::path::PathBuf],
    settings: &StreamSettings,
) -> anyhow::Result<(loci::evaluation::Eyes, Option<loci::cnn::RuntimeVersion>)> {
    let vocabularies = Arc::new(VocabularySet::open(vocabularies)?);
    let (model, folder) = open_cnn(settings)?.unzip();
    let version = folder.map(|folder| folder.runtime.version());
    let extractor = OrbExtractor::new(OrbOptions::default());
    Ok((loci::evaluation::Eyes { extractor, vocabularies, model }, version))
}

/// Says how many keyframes cannot be compared by the model of `card`, and until when.
pub(super) fn report_foreign_descriptors(keyframes: usize, card: Option<&ModelCard>, outlook: &str) {
    let (count @ 1.., Some(card)) = (keyframes, card) else { return };
    let verb = if count == 1 { "has" } else { "have" };
    eprintln!(
        "loci: {} {verb} CNN descriptors of another model than {}; they are found by BoW+HV alone{outlook}",
        counted(count, "keyframe"),
        card.name
    );
}

/// Says what a user would want to know of a map before a run.
fn report_condition(map: &PlaceMap) {
    let torn_bytes = map.summary().torn_bytes;
    if torn_bytes > 0 {
        let torn = counted(torn_bytes, "byte");
        eprintln!("loci: the map's last record was torn ({torn}) and is left out");
    }
    if let Some(passed_over) = map.passed_over() {
        eprintln!("loci: {passed_over}; `loci map compact --repair` gives it up");
    }
    if let Some(fault) = map.snapshot_fault() {
        eprintln!("loci: the journal was read from its beginning: {fault}");
    }
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
