//! `loci train`: a better CNN from the clusters that a robot made by itself.

mod arguments;
mod models;
mod precision;
mod progress;
mod report;

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::{fs, io};

use loci::cnn::{DescriptorModel, ImageGenerator, ModelCard, OnnxRuntime, save_model};
use loci::place_map::PlaceMap;
use loci::raster::RgbImage;
use loci::training::{
    Augmentation, Checkpoint, ClusterRules, Clusters, Describe, Device, DeviceChoice, Epoch, Gathered, Head,
    Labelled, PaperCnn, Picture, Pictures, Rivals, Standing, TrainedModel, TrainingError, TrainingReport,
    Unreadable, Variation, described, varied,
};

pub(super) use self::arguments::TrainArguments;
use self::arguments::{Architecture, Precision};
use self::models::{Backbone, Models};
use self::precision::Candidate;
use self::progress::Progress;
use super::console::{counted, say};
use super::map::report_losses;
use super::{Outcome, WrongArgument, stream};

/// Trains a model and says how it fares.
pub(super) fn run(arguments: &TrainArguments) -> anyhow::Result<Outcome> {
    // Without a slash at its end.
    let out: PathBuf = arguments.out.components().collect();
    let aside = with_ending(&out, ".rejected");
    // A link that leads nowhere is something, too.
    if let Some(path) = [&out, &aside].into_iter().find(|path| path.symlink_metadata().is_ok()) {
        let path = path.display();
        return Err(WrongArgument(format!("{path} is there already; choose another --out")).into());
    }
    refuse_contradictions(arguments)?;
    let device = arguments.device.settled().map_err(|error| WrongArgument(error.to_string()))?;
    let stop = stream::stop_flag()?;
    let maps = arguments.maps.iter().map(|folder| PlaceMap::open_read_only(folder));
    let maps = maps.collect::<Result<Vec<_>, _>>()?;
    let losses = maps.iter().zip(&arguments.maps).map(|(map, folder)| report_losses(map, folder));
    let has_lost = losses.fold(false, |has_lost, outcome| has_lost | (outcome == Outcome::Lost));
    let maps: Vec<&PlaceMap> = maps.iter().collect();
    let rules = ClusterRules { min_samples: arguments.min_samples.get(), ..ClusterRules::default() };
    let mut clusters = Clusters::of(&maps, &rules)?;
    if !arguments.json {
        say(&report::described(&clusters))?;
    }
    refuse_too_few(&clusters)?;
    let trainer = Trainer::new(arguments, &out, device, &stop)?;
    let mut models = Models::open(arguments, &trainer.runtime)?;
    let images = Pictures::most_of(&clusters);
    let pictures = trainer.progress.images(images, "images", |show| Pictures::of(&maps, &mut clusters, show));
    let pictures = pictures.map_err(|error| trainer.with_what_is_kept(error.into()))?;
    refuse_unreadable(arguments, &clusters.unreadable)?;
    report::report_left_out(&clusters);
    refuse_too_few(&clusters)?;
    pictures.check(&clusters)?;
    let trained = trainer.trained((&pictures, &clusters), &mut models);
    let Trained { mut model, precision, epochs } =
        trained.map_err(|error| trainer.with_what_is_kept(error))?;
    model.call(&name_of(&out));
    let is_accepted = model.is_accepted() || arguments.accept;
    let folder = if is_accepted { &out } else { &aside };
    let page = TrainingReport { clusters: &clusters, pictures: &pictures, epochs: &epochs, model: &model };
    let page = page.html();
    save_model(folder, &mut model.card, &model.network.to_bytes(), &page)?;
    trainer.forget_checkpoint()?;
    let (results, how) = ((&model, &epochs[..]), (precision, trainer.device_name));
    let report = report::Report::new((&clusters, &pictures), results, how, (folder, is_accepted));
    say(&if arguments.json { serde_json::to_string(&report)? } else { report.text() })?;
    if let Some(fault) = model.fault() {
        report::report_refusal(&fault, (&out, &aside), arguments.accept);
    }
    let is_whole = clusters.unreadable.is_empty() && !has_lost;
    Ok(if is_accepted && is_whole { Outcome::Done } else { Outcome::Lost })
}

/// What a training comes to.
struct Trained {
    model: TrainedModel,
    precision: Precision,
    epochs: Vec<Epoch>,
}

/// What trains.
struct Trainer<'a> {
    arguments: &'a TrainArguments,
    runtime: OnnxRuntime,
    device: Device,
    /// What it is called.
    device_name: DeviceChoice,
    variation: Variation,
    progress: Progress<'a>,
    checkpoint_path: PathBuf,
}

impl<'a> Trainer<'a> {
    fn new(
        arguments: &'a TrainArguments,
        out: &Path,
        device: DeviceChoice,
        stop: &'a AtomicBool,
    ) -> anyhow::Result<Self> {
        let runtime = OnnxRuntime::open(arguments.onnxruntime.as_deref())?;
        let checkpoint_path = with_ending(out, ".checkpoint");
        // Before any image is looked at.
        if let Some(parent) = out.parent() {
            let refuse = |error| anyhow::anyhow!("cannot make the folder {}: {error}", parent.display());
            fs::create_dir_all(parent).map_err(refuse)?;
        }
        loci::storage::check_replaceable(&checkpoint_path)?;
        if checkpoint_path.exists() && !Checkpoint::is_at(&checkpoint_path) {
            return Err(of_another_training(&checkpoint_path).into());
        }
        let generator = match &arguments.augment_model {
            Some(path) => Some(RefCell::new(ImageGenerator::open(path, &runtime, 2)?)),
            None => None,
        };
        let augmentation = (arguments.copies() > 0).then(Augmentation::default);
        Ok(Self {
            arguments,
            runtime,
            device: device.open()?,
            device_name: device,
            variation: Variation { augmentation, generator },
            progress: Progress::new(stop),
            checkpoint_path,
        })
    }

    /// Trains a model to take the place of the one that is now.
    fn trained(
        &self,
        (pictures, clusters): (&Pictures<'_>, &Clusters),
        models: &mut Models,
    ) -> anyhow::Result<Trained> {
        let backbone = models.backbone.as_ref().map(|backbone| backbone.model.card());
        let checkpoint = self.checkpoint(backbone, pictures)?;
        let current = self.gathered(pictures, &mut models.current)?;
        // What the training begins with; the paper's CNN begins with nothing.
        let features = match &mut models.backbone {
            Some(Backbone { model, is_current: false, .. }) => &self.gathered(pictures, model)?,
            _ => &current,
        };
        let standing = |gathered| Standing::of(gathered, |one, other| clusters.is_near(one, other));
        let rivals = Rivals { current: standing(&current), prototypes: standing(&features.by_prototypes()) };
        let (candidate, epochs) = match &mut models.backbone {
            Some(backbone) => self.train_trunk(pictures, (backbone, features), &checkpoint)?,
            None => self.train_paper(pictures, clusters.classes.len(), &checkpoint)?,
        };
        let (model, precision) = self.in_precision(candidate, (pictures, clusters), rivals)?;
        Ok(Trained { model, precision, epochs })
    }

    /// Trains a head for `backbone`, which says `features` of all images, and answers how every epoch went.
    fn train_trunk(
        &self,
        pictures: &Pictures<'_>,
        (backbone, features): (&mut Backbone, &Gathered),
        checkpoint: &Checkpoint,
    ) -> anyhow::Result<(Candidate, Vec<Epoch>)> {
        let Backbone { model, network, .. } = backbone;
        let how = (model.dimensions(), self.arguments.seed);
        let varied = self.varied((pictures, &pictures.learnt), how, &mut |image| described(model, image))?;
        let vectors = (&features.learnt.and(&varied), &features.checked);
        let options = self.arguments.fit_options();
        let head = self.progress.epochs(options.epochs, checkpoint, |show| {
            let dimensions = self.arguments.dimensions();
            Head::train(vectors, dimensions, &options, (&self.device, Some(checkpoint)), show)
        })?;
        let (network, card) = head.grafted((network.clone(), model.card()))?;
        let descriptors = features.projected(&head.projection);
        Ok((Candidate { network, card, descriptors }, head.epochs))
    }

    fn train_paper(
        &self,
        pictures: &Pictures<'_>,
        classes: usize,
        checkpoint: &Checkpoint,
    ) -> anyhow::Result<(Candidate, Vec<Epoch>)> {
        let options = self.arguments.paper_options();
        let cnn = self.progress.epochs(options.fit.epochs, checkpoint, |show| {
            let pictures = (pictures, &self.variation);
            PaperCnn::train(pictures, classes, &options, (&self.device, Some(checkpoint)), show)
        })?;
        let mut describe = |image: &RgbImage| cnn.describe(image).map(Some);
        let descriptors = self.gathered_by(pictures, options.dimensions, &mut describe)?;
        let (network, card) = cnn.to_onnx()?;
        Ok((Candidate { network, card, descriptors }, cnn.head.epochs))
    }

    /// What `model` says of all images.
    fn gathered(&self, pictures: &Pictures<'_>, model: &mut DescriptorModel) -> anyhow::Result<Gathered> {
        let dimensions = model.dimensions();
        Ok(self.gathered_by(pictures, dimensions, &mut |image| described(model, image))?)
    }

    /// What `describe` says of all images. What training only looks at, and what is of no class, is varied, too: the
    /// best epoch and the threshold are to be those for other light.
    fn gathered_by(
        &self,
        pictures: &Pictures<'_>,
        dimensions: usize,
        describe: &mut Describe<'_>,
    ) -> Result<Gathered, TrainingError> {
        let gathered = self
            .progress
            .images(pictures.len(), "images", |show| Gathered::of(pictures, dimensions, describe, show))?;
        // Other draws than for what is learnt.
        let how = (dimensions, !self.arguments.seed);
        let checked = self.varied((pictures, &pictures.checked), how, describe)?;
        let strangers = self.varied((pictures, &pictures.strangers), how, describe)?;
        let (checked, strangers) = (gathered.checked.and(&checked), gathered.strangers.and(&strangers));
        Ok(Gathered { checked, strangers, ..gathered })
    }

    /// What `describe` says of varied copies of `part` of `pictures`.
    fn varied(
        &self,
        (pictures, part): (&Pictures<'_>, &[Picture]),
        (dimensions, seed): (usize, u64),
        describe: &mut Describe<'_>,
    ) -> Result<Labelled, TrainingError> {
        let copies = self.arguments.copies();
        self.progress.images(copies * part.len(), "copies", |show| {
            varied((pictures, part), dimensions, (&self.variation, copies, seed), describe, show)
        })
    }

    /// Where this training keeps what it has come to; one of another training, on another `backbone`, otherwise or on
    /// other images, is not gone on with.
    fn checkpoint(
        &self,
        backbone: Option<&ModelCard>,
        pictures: &Pictures<'_>,
    ) -> anyhow::Result<Checkpoint> {
        let TrainArguments { architecture, augment_model, .. } = self.arguments;
        let generator = augment_model.as_ref().map(fs::read).transpose()?;
        let generator = generator.map(|bytes| loci::storage::checksum(&bytes));
        let arguments =
            (architecture, self.arguments.dimensions(), self.arguments.copies(), generator, self.device_name);
        let how = (self.arguments.fit_options(), self.arguments.paper_options(), backbone);
        let what = format!("{arguments:?} {how:?} {:?} {:?}", pictures.learnt, pictures.checked);
        let checkpoint = Checkpoint::new(&self.checkpoint_path, &what);
        match checkpoint.epochs() {
            0 if self.checkpoint_path.exists() => {
                return Err(of_another_training(&self.checkpoint_path).into());
            }
            0 => {}
            epochs => {
                let (epochs, path) = (counted(epochs as u64, "epoch"), self.checkpoint_path.display());
                eprintln!("loci: going on after {epochs}, from {path}");
            }
        }
        Ok(checkpoint)
    }

    /// Says how an interrupted training goes on.
    fn with_what_is_kept(&self, error: anyhow::Error) -> anyhow::Error {
        let is_interrupted = matches!(error.downcast_ref(), Some(TrainingError::Interrupted));
        if is_interrupted && self.checkpoint_path.exists() {
            let path = self.checkpoint_path.display();
            return anyhow::anyhow!("interrupted; the same command goes on with what is in {path}");
        }
        error
    }

    /// The training is done.
    fn forget_checkpoint(&self) -> anyhow::Result<()> {
        match fs::remove_file(&self.checkpoint_path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                anyhow::bail!("cannot remove {}: {error}", self.checkpoint_path.display())
            }
            _ => Ok(()),
        }
    }
}

/// Each map is named once, or its places would be told apart from themselves; there is a CNN to compare with; and a
/// generator and a backbone have something to do.
fn refuse_contradictions(arguments: &TrainArguments) -> Result<(), WrongArgument> {
    let mut known = BTreeSet::new();
    let path = |map: &PathBuf| fs::canonicalize(map).unwrap_or_else(|_| map.clone());
    if let Some(map) = arguments.maps.iter().find(|map| !known.insert(path(map))) {
        return Err(WrongArgument(format!("{} is named twice", map.display())));
    }
    let is_without_cnn = arguments.model.as_deref() == Some(Path::new("none"));
    let is_trunk = arguments.architecture == Architecture::Trunk;
    let contradictions = [
        (
            is_without_cnn,
            "training needs a CNN to compare with, and --model (or LOCI_MODEL) says none; name a folder",
        ),
        (
            arguments.augment_model.is_some() && arguments.copies() == 0,
            "--augment-model makes nothing of --augment 0",
        ),
        (
            !is_trunk && arguments.backbone.is_some(),
            "--architecture paper has no backbone; leave --backbone out",
        ),
    ];
    let found = contradictions.iter().find(|(is_one, _)| *is_one);
    found.map_or(Ok(()), |(_, reason)| Err(WrongArgument((*reason).to_owned())))
}

/// There is something to tell apart.
fn refuse_too_few(clusters: &Clusters) -> Result<(), TrainingError> {
    let classes = clusters.classes.len();
    if classes < 2 { Err(TrainingError::TooFewClasses { classes }) } else { Ok(()) }
}

/// A training does not go on without what it was to look at, unless that is wanted.
fn refuse_unreadable(arguments: &TrainArguments, unreadable: &[Unreadable]) -> anyhow::Result<()> {
    let Some(first) = unreadable.first().filter(|_| !arguments.skip_unreadable) else { return Ok(()) };
    let (count, map) = (counted(unreadable.len() as u64, "experience"), arguments.maps[first.map].display());
    anyhow::bail!(
        "{count} of those looked at cannot be read, the first is number {} of {map}: see loci map verify; \
         --skip-unreadable goes on without",
        first.experience.0
    )
}

/// What to do where a training cannot go on with the file at `path`.
fn of_another_training(path: &Path) -> WrongArgument {
    let path = path.display();
    WrongArgument(format!("{path} is of another training, or damaged; remove it or choose another --out"))
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
