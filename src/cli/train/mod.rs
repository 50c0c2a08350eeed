//! `loci train`: a better CNN from the clusters that a robot made by itself.

mod arguments;
mod precision;
mod progress;
mod report;

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::{fs, io};

use loci::cnn::{DescriptorModel, ImageGenerator, MODEL_FILE, OnnxRuntime, save_model};
use loci::onnx::OnnxModel;
use loci::place_map::PlaceMap;
use loci::raster::RgbImage;
use loci::training::{
    Augmentation, Checkpoint, ClusterRules, Clusters, Describe, Device, DeviceChoice, Epoch, Gathered, Head,
    Labelled, PaperCnn, Picture, Pictures, Standing, TrainingError, TrainingReport, Variation, described,
    varied,
};

use self::arguments::Architecture;
pub(super) use self::arguments::TrainArguments;
use self::precision::Candidate;
use self::progress::Progress;
use super::console::{counted, say};
use super::map::report_losses;
use super::{Outcome, WrongArgument, assets, stream};

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
    refuse_contradictions(arguments)?;
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
    if clusters.classes.len() < 2 {
        return Err(TrainingError::TooFewClasses { classes: clusters.classes.len() }.into());
    }
    let trainer = Trainer::new(arguments, &out, &stop)?;
    let images = clusters.classes.iter().map(|class| class.learnt.len() + class.held_out.len()).sum();
    let pictures =
        trainer.progress.images(images, "images", |show| Pictures::of(&maps, &mut clusters, show))?;
    let current = trainer.gathered(&pictures, &mut trainer.open(&trainer.model)?)?;
    let (candidate, epochs) =
        trainer.train(&pictures, (&clusters, &current)).map_err(|error| trainer.with_what_is_kept(error))?;
    let current = Standing::of(&current, |one, other| clusters.is_near(one, other));
    let (mut model, precision) = trainer.in_precision(candidate, (&pictures, &clusters), current)?;
    model.card.name = name_of(&out);
    let is_accepted = model.is_accepted() || arguments.accept;
    let folder = if is_accepted { &out } else { &aside };
    let page = TrainingReport { clusters: &clusters, pictures: &pictures, epochs: &epochs, model: &model };
    let page = page.html();
    save_model(folder, &mut model.card, &model.network.to_bytes(), &page)?;
    trainer.forget_checkpoint()?;
    let (results, how) = ((&model, &epochs[..]), (precision, trainer.device.1));
    let report = report::Report::new((&clusters, &pictures), results, how, (folder, is_accepted));
    say(&if arguments.json { serde_json::to_string(&report)? } else { report.text() })?;
    let skipped = pictures.skipped + clusters.unreadable;
    if skipped > 0 {
        eprintln!("loci: skipped: {}, for they cannot be read", counted(skipped as u64, "image"));
    }
    if !model.is_accepted() {
        let (aside, out) = (aside.display(), out.display());
        let advice = match arguments.accept {
            true => "taken all the same".to_owned(),
            false => format!("kept aside; `mv {aside} {out}` takes it all the same"),
        };
        eprintln!("loci: the model does not do as well on what was held out as the one before: {advice}");
    }
    Ok(if is_accepted && skipped == 0 && !has_lost { Outcome::Done } else { Outcome::Lost })
}

/// What trains.
struct Trainer<'a> {
    arguments: &'a TrainArguments,
    /// Folder of the CNN that the trunk is.
    backbone: PathBuf,
    /// Folder of the CNN that the new one is to take the place of.
    model: PathBuf,
    runtime: OnnxRuntime,
    /// What trains, and what it is called.
    device: (Device, DeviceChoice),
    variation: Variation,
    progress: Progress<'a>,
    checkpoint_path: PathBuf,
}

impl<'a> Trainer<'a> {
    fn new(arguments: &'a TrainArguments, out: &Path, stop: &'a AtomicBool) -> anyhow::Result<Self> {
        let runtime = OnnxRuntime::open(arguments.onnxruntime.as_deref())?;
        let device = arguments.device.settled()?;
        let checkpoint_path = with_ending(out, ".checkpoint");
        // Before any image is looked at.
        if let Some(parent) = out.parent() {
            fs::create_dir_all(parent)?;
        }
        loci::storage::check_replaceable(&checkpoint_path)?;
        let generator = match &arguments.augment_model {
            Some(path) => Some(RefCell::new(ImageGenerator::open(path, &runtime, 2)?)),
            None => None,
        };
        let augmentation = (arguments.copies() > 0).then(Augmentation::default);
        Ok(Self {
            arguments,
            backbone: assets::find(arguments.backbone.as_deref(), assets::MODEL, "--backbone")?,
            model: assets::find(arguments.model.as_deref(), assets::MODEL, "--model")?,
            runtime,
            device: (device.open()?, device),
            variation: Variation { augmentation, generator },
            progress: Progress::new(stop),
            checkpoint_path,
        })
    }

    fn open(&self, folder: &Path) -> anyhow::Result<DescriptorModel> {
        Ok(DescriptorModel::open(folder, &self.runtime, 2)?)
    }

    /// Trains a model; answers it and how every epoch went. The one that it is to take the place of says `current`.
    fn train(
        &self,
        pictures: &Pictures<'_>,
        (clusters, current): (&Clusters, &Gathered),
    ) -> anyhow::Result<(Candidate, Vec<Epoch>)> {
        match self.arguments.architecture {
            Architecture::Trunk => self.train_trunk(pictures, current),
            Architecture::Paper => self.train_paper(pictures, clusters.classes.len()),
        }
    }

    fn train_trunk(
        &self,
        pictures: &Pictures<'_>,
        current: &Gathered,
    ) -> anyhow::Result<(Candidate, Vec<Epoch>)> {
        let mut backbone = self.open(&self.backbone)?;
        let is_current = fs::canonicalize(&self.backbone)? == fs::canonicalize(&self.model)?;
        let features = if is_current { current.clone() } else { self.gathered(pictures, &mut backbone)? };
        let dimensions = backbone.dimensions();
        let mut describe = |image: &RgbImage| described(&mut backbone, image);
        let how = (dimensions, self.arguments.seed);
        let varied = self.varied((pictures, &pictures.learnt), how, &mut describe)?;
        let vectors = (&features.learnt.and(&varied), &features.checked);
        let options = self.arguments.fit_options();
        let checkpoint = self.checkpoint(&(&options, backbone.card()), pictures)?;
        let head = self.progress.epochs(options.epochs, &checkpoint, |show| {
            let dimensions = self.arguments.dimensions();
            Head::train(vectors, dimensions, &options, (&self.device.0, Some(&checkpoint)), show)
        })?;
        let network = OnnxModel::read(&fs::read(self.backbone.join(MODEL_FILE))?)?;
        let (network, card) = head.grafted((network, backbone.card()))?;
        let descriptors = features.projected(&head.projection);
        Ok((Candidate { network, card, descriptors }, head.epochs))
    }

    fn train_paper(
        &self,
        pictures: &Pictures<'_>,
        classes: usize,
    ) -> anyhow::Result<(Candidate, Vec<Epoch>)> {
        let options = self.arguments.paper_options();
        let checkpoint = self.checkpoint(&options, pictures)?;
        let cnn = self.progress.epochs(options.fit.epochs, &checkpoint, |show| {
            let pictures = (pictures, &self.variation);
            PaperCnn::train(pictures, classes, &options, (&self.device.0, Some(&checkpoint)), show)
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

    /// What `describe` says of all images. What training only looks at is varied, too: the best epoch and the threshold
    /// are to be those for other light.
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
        let varied = self.varied((pictures, &pictures.checked), how, describe)?;
        Ok(Gathered { checked: gathered.checked.and(&varied), ..gathered })
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

    /// Where this training keeps what it has come to; one of another training, `how` or on what, is not gone on with.
    fn checkpoint(&self, how: &dyn Debug, pictures: &Pictures<'_>) -> anyhow::Result<Checkpoint> {
        let TrainArguments { architecture, augment_model, .. } = self.arguments;
        let generator = augment_model.as_ref().map(fs::read).transpose()?;
        let generator = generator.map(|bytes| loci::storage::checksum(&bytes));
        let arguments =
            (architecture, self.arguments.dimensions(), self.arguments.copies(), generator, self.device.1);
        let what = format!("{arguments:?} {how:?} {:?} {:?}", pictures.learnt, pictures.checked);
        let checkpoint = Checkpoint::new(&self.checkpoint_path, &what);
        match checkpoint.epochs() {
            0 if self.checkpoint_path.exists() => {
                let path = self.checkpoint_path.display();
                let reason =
                    format!("{path} is of another training, or damaged; remove it or choose another --out");
                return Err(WrongArgument(reason).into());
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

/// Each map is named once, or its places would be told apart from themselves; and a generator has something to do.
fn refuse_contradictions(arguments: &TrainArguments) -> Result<(), WrongArgument> {
    let mut known = BTreeSet::new();
    let path = |map: &PathBuf| fs::canonicalize(map).unwrap_or_else(|_| map.clone());
    if let Some(map) = arguments.maps.iter().find(|map| !known.insert(path(map))) {
        return Err(WrongArgument(format!("{} is named twice", map.display())));
    }
    if arguments.augment_model.is_some() && arguments.copies() == 0 {
        return Err(WrongArgument("--augment-model makes nothing of --augment 0".to_owned()));
    }
    Ok(())
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
