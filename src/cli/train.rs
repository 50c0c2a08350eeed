//! `loci train`: a better CNN from the clusters that a robot made by itself.

use std::ffi::OsString;
use std::fs;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressDrawTarget};
use loci::cnn::{DescriptorModel, MODEL_FILE, OnnxRuntime, save_model};
use loci::onnx::OnnxModel;
use loci::place_map::PlaceMap;
use loci::training::{
    ClusterRules, Clusters, Device, Epoch, Gathered, Head, HeadOptions, Loss, TrainedModel, TrainingError,
    gather,
};
use serde::Serialize;

use super::console::{counted, progress_bar, say};
use super::map::report_losses;
use super::{Outcome, WrongArgument, assets, stream};

/// Widest class of the histogram of cluster sizes.
const HISTOGRAM_STEP: usize = 20;

/// Arguments of `loci train`.
#[derive(Args)]
#[command(after_help = "Examples:\n  loci train maps/site --out models/site\n  \
    loci train maps/hall maps/yard --out models/site2 --min-samples 30 --epochs 50\n\n\
    The places of the maps are the classes. A projection of the backbone's features and a direction for each class are \
    trained; the model that is made has the backbone in it. The latest fifth of every place is held out: a model that \
    recognises less of it than the backbone alone is kept aside, in OUT.rejected. The exit code is 3 then, and where \
    something could not be read. Places of several maps are told apart: merge maps of one site first.")]
pub(super) struct TrainArguments {
    /// Folders of maps
    #[arg(required = true, value_name = "MAP")]
    maps: Vec<PathBuf>,
    /// Folder of the model to make; it must not be there yet
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Folder of the CNN that is the backbone [default: models/efficientnet-lite0]
    #[arg(long, env = "LOCI_MODEL", value_name = "DIR")]
    model: Option<PathBuf>,
    /// ONNX Runtime library [default: looked for]
    #[arg(long, env = "LOCI_ONNXRUNTIME", value_name = "PATH")]
    onnxruntime: Option<PathBuf>,
    /// Fewest experiences of a place that is learnt
    #[arg(long, value_name = "N", default_value = "20")]
    min_samples: NonZeroUsize,
    /// Values of the descriptor
    #[arg(long, value_name = "N", default_value = "256")]
    dimensions: NonZeroUsize,
    /// Times that every place is gone through
    #[arg(long, value_name = "N", default_value = "30")]
    epochs: NonZeroUsize,
    /// What is asked of a descriptor
    #[arg(long, value_enum, default_value = "cosface")]
    loss: LossName,
    /// Settles every draw
    #[arg(long, value_name = "N", default_value = "0")]
    seed: u64,
    /// Take the model even where it recognises less than the backbone alone
    #[arg(long)]
    accept: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum LossName {
    /// Its own class is the likeliest by a margin
    Cosface,
    /// Its own class is the likeliest
    CrossEntropy,
}

#[derive(Serialize)]
struct Report {
    classes: usize,
    images: usize,
    small_places: usize,
    duplicates: usize,
    joined_by_pose: usize,
    skipped: usize,
    epoch: usize,
    held_out: usize,
    recall: f64,
    untrained_recall: f64,
    accepted: bool,
    model: String,
}

/// Trains a model and says how it fares.
pub(super) fn run(arguments: &TrainArguments) -> anyhow::Result<Outcome> {
    // Without a slash at its end.
    let out: PathBuf = arguments.out.components().collect();
    let aside = with_ending(&out, ".rejected");
    for path in [&out, &aside] {
        if path.exists() {
            let path = path.display();
            return Err(WrongArgument(format!("{path} is there already; choose another --out")).into());
        }
    }
    let stop = stream::stop_flag()?;
    let maps = arguments.maps.iter().map(|folder| PlaceMap::open_read_only(folder));
    let maps = maps.collect::<Result<Vec<_>, _>>()?;
    let losses = maps.iter().zip(&arguments.maps).map(|(map, folder)| report_losses(map, folder));
    let has_lost = losses.fold(false, |has_lost, outcome| has_lost | (outcome == Outcome::Lost));
    let maps: Vec<&PlaceMap> = maps.iter().collect();
    let rules = ClusterRules { min_samples: arguments.min_samples.get(), ..ClusterRules::default() };
    let mut clusters = Clusters::of(&maps, &rules)?;
    if !arguments.json {
        say(&described(&clusters))?;
    }
    if clusters.classes.len() < 2 {
        return Err(TrainingError::TooFewClasses { classes: clusters.classes.len() }.into());
    }
    let folder = assets::find(arguments.model.as_deref(), assets::MODEL, "--model")?;
    let runtime = OnnxRuntime::open(arguments.onnxruntime.as_deref())?;
    let mut backbone = DescriptorModel::open(&folder, &runtime, 2)?;
    let gathered = gathered(&maps, &mut clusters, &mut backbone, &stop)?;
    let head = trained(&gathered, arguments, &stop)?;
    let network = OnnxModel::read(&fs::read(folder.join(MODEL_FILE))?)?;
    let mut model = TrainedModel::new((network, backbone.card()), &head, &clusters, &gathered)?;
    model.card.name = name_of(&out);
    let is_accepted = model.is_accepted() || arguments.accept;
    let out = if is_accepted { &out } else { &aside };
    save_model(out, &mut model.card, &model.network.to_bytes())?;
    let report = report(&clusters, &gathered, (&head, &model), (out, is_accepted));
    say(&if arguments.json { serde_json::to_string(&report)? } else { concluded(&report) })?;
    if report.skipped > 0 {
        eprintln!("loci: skipped: {}, for they cannot be read", counted(report.skipped as u64, "image"));
    }
    if !model.is_accepted() {
        let advice = if arguments.accept { "taken all the same" } else { "kept aside; --accept takes it" };
        eprintln!("loci: the model recognises less of what was held out than the backbone alone: {advice}");
    }
    Ok(if is_accepted && report.skipped == 0 && !has_lost { Outcome::Done } else { Outcome::Lost })
}

/// The features of all images, computed with a progress bar.
fn gathered(
    maps: &[&PlaceMap],
    clusters: &mut Clusters,
    backbone: &mut DescriptorModel,
    stop: &AtomicBool,
) -> Result<Gathered, TrainingError> {
    let images =
        clusters.classes.iter().map(|class| class.learnt.len() + class.held_out.len()).sum::<usize>();
    let bar = progress_bar(Some(images as u64), "images", ProgressDrawTarget::stderr());
    let gathered = gather(maps, clusters, backbone, &mut || {
        bar.inc(1);
        go_on(stop)
    });
    bar.finish_and_clear();
    gathered
}

/// The head, trained with a progress bar that shows loss and recall.
fn trained(gathered: &Gathered, arguments: &TrainArguments, stop: &AtomicBool) -> anyhow::Result<Head> {
    let defaults = HeadOptions::default();
    let options = HeadOptions {
        dimensions: arguments.dimensions.get(),
        epochs: arguments.epochs.get(),
        loss: match arguments.loss {
            LossName::Cosface => defaults.loss,
            LossName::CrossEntropy => Loss::CrossEntropy { scale: 30.0 },
        },
        seed: arguments.seed,
        ..defaults
    };
    let bar = progress_bar(Some(options.epochs as u64), "epochs", ProgressDrawTarget::stderr());
    let mut show = |epoch: Epoch| {
        step(&bar, epoch);
        go_on(stop)
    };
    let head = Head::train(&gathered.learnt, &gathered.checked, &options, &Device::flex(), &mut show);
    bar.finish_and_clear();
    anyhow::ensure!(!stop.load(Ordering::Relaxed), TrainingError::Interrupted);
    Ok(head?)
}

fn step(bar: &ProgressBar, Epoch { loss, recall, .. }: Epoch) {
    bar.inc(1);
    bar.set_prefix(format!("loss {loss:.3}, recall {recall:.3} "));
}

fn go_on(stop: &AtomicBool) -> ControlFlow<()> {
    if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

/// Classes, what was left out, and the sizes of the clusters as a histogram: the paper's Fig. 2.
fn described(clusters: &Clusters) -> String {
    let images: usize = clusters.classes.iter().map(|class| class.learnt.len() + class.held_out.len()).sum();
    let (classes, places) = (clusters.classes.len(), clusters.sizes.len());
    let mut text = format!("classes   {classes} of {places} places, {}\n", counted(images as u64, "image"));
    text += &format!(
        "left out  {} with too few, {}; {} joined by pose\n",
        counted(clusters.small_places as u64, "place"),
        counted(clusters.duplicates as u64, "duplicate"),
        clusters.joined_by_pose
    );
    let largest = clusters.sizes.first().copied().unwrap_or_default();
    for from in (0..=largest).step_by(HISTOGRAM_STEP) {
        let within = from..from + HISTOGRAM_STEP;
        let count = clusters.sizes.iter().filter(|size| within.contains(size)).count();
        text += &format!("{from:>6}–{:<4}{} {count}\n", within.end - 1, "▇".repeat(count.min(60)));
    }
    text.trim_end().to_owned()
}

fn report(
    clusters: &Clusters,
    gathered: &Gathered,
    (head, model): (&Head, &TrainedModel),
    (out, accepted): (&Path, bool),
) -> Report {
    Report {
        classes: clusters.classes.len(),
        images: gathered.learnt.len() + gathered.checked.len(),
        small_places: clusters.small_places,
        duplicates: clusters.duplicates,
        joined_by_pose: clusters.joined_by_pose,
        skipped: gathered.skipped + clusters.unreadable,
        epoch: head.epoch,
        held_out: model.held_out,
        recall: model.recall,
        untrained_recall: model.untrained_recall,
        accepted,
        model: out.display().to_string(),
    }
}

fn concluded(report: &Report) -> String {
    let Report { epoch, held_out, recall, untrained_recall, model, .. } = report;
    let held_out = counted(*held_out as u64, "image");
    format!(
        "held out  {held_out}: recall@1 {recall:.3}, by the backbone alone {untrained_recall:.3} (epoch {epoch})\n\
         model     {model}"
    )
}

/// The folder's name, by which the model is called.
fn name_of(folder: &Path) -> String {
    folder.file_name().map_or_else(|| "trained".to_owned(), |name| name.to_string_lossy().into_owned())
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut path: OsString = path.as_os_str().to_owned();
    path.push(ending);
    path.into()
}
