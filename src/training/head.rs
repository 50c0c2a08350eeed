//! A head for a frozen backbone: a projection to a shorter unit descriptor, and a direction for each class, learnt
//! together so that a descriptor lies nearer to its own class than to any other by a margin.
//!
//! Training begins where no training would end: with the projection that keeps most of the features, and class means as
//! directions.

use std::ops::ControlFlow;

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use rand_pcg::Pcg64;

use super::checkpoint::Checkpoint;
use super::error::TrainingError;
use super::fitting::{Epoch, FitOptions, Fitted, Lesson, Step, fit};
use super::labelled::{Glance, Labelled};
use super::principal::principal_directions;

/// Where a direction has no length, for the sake of division.
const SHORTEST: f32 = 1e-12;

/// A trained head.
#[derive(Clone, Debug, PartialEq)]
pub struct Head {
    /// Values of a feature vector.
    pub width: usize,
    /// `[width, dimensions]`, row-major.
    pub projection: Vec<f32>,
    /// Directions of unit length, `[classes, dimensions]`.
    pub classes: Vec<f32>,
    /// Sharpness of the softmax over the cosines.
    pub scale: f32,
    /// The epoch that it is of; 0 if no training made it better.
    pub epoch: usize,
    /// Share of the vectors that were only looked at whose own class is the nearest.
    pub recall: f64,
    /// How every epoch went.
    pub epochs: Vec<Epoch>,
}

/// The head as it is trained.
#[derive(Module, Debug)]
pub(super) struct HeadNetwork {
    /// `[features, dimensions]`
    projection: Param<Tensor<2>>,
    /// `[classes, dimensions]`
    classes: Param<Tensor<2>>,
}

impl HeadNetwork {
    pub(super) fn new(projection: &[f32], classes: &[f32], dimensions: usize, device: &Device) -> Self {
        let matrix = |values: &[f32]| {
            let shape = [values.len() / dimensions, dimensions];
            Param::from_tensor(Tensor::from_data(TensorData::new(values.to_vec(), shape), device))
        };
        Self { projection: matrix(projection), classes: matrix(classes) }
    }

    /// Descriptors of `features`, `[n, features]`: `[n, dimensions]`.
    pub(super) fn descriptors(&self, features: Tensor<2>) -> Tensor<2> {
        unit(unit(features).matmul(self.projection.val()))
    }

    /// Cosines of `features`, `[n, features]`, to all classes: `[n, classes]`.
    pub(super) fn cosines(&self, features: Tensor<2>) -> Tensor<2> {
        self.descriptors(features).matmul(unit(self.classes.val()).transpose())
    }

    /// Its projection and its classes, these in unit length.
    pub(super) fn matrices(&self) -> Result<(Vec<f32>, Vec<f32>), TrainingError> {
        Ok((values(self.projection.val())?, values(unit(self.classes.val()))?))
    }
}

/// Rows of unit length.
fn unit(rows: Tensor<2>) -> Tensor<2> {
    let lengths = rows.clone().powi_scalar(2).sum_dim(1).sqrt().clamp_min(SHORTEST);
    rows / lengths
}

impl Head {
    /// The head without any training: the directions in which `learnt` differs most, `dimensions` of them at most, and
    /// the means of the classes.
    ///
    /// # Errors
    /// [`TrainingError::TooFewClasses`].
    pub fn untrained(
        learnt: &Labelled,
        checked: &Labelled,
        dimensions: usize,
        options: &FitOptions,
    ) -> Result<Self, TrainingError> {
        let classes = learnt.class_count();
        if classes < 2 {
            return Err(TrainingError::TooFewClasses { classes });
        }
        let projection = principal_directions(learnt, dimensions.min(learnt.width()), options.seed);
        let classes = learnt.projected(&projection).prototypes();
        let recall = checked.projected(&projection).recall(&classes);
        let (width, scale) = (learnt.width(), options.loss.scale());
        Ok(Self { width, projection, classes, scale, epoch: 0, recall, epochs: Vec::new() })
    }

    /// Trains a head on `learnt`; of all epochs the one is kept after which most of `checked` are recognised.
    /// `progress` hears of every step. After an epoch it may end the training early, with the best one so far; after a
    /// batch that interrupts it.
    ///
    /// # Errors
    /// [`TrainingError::TooFewClasses`], [`TrainingError::NotFinite`] or [`TrainingError::Interrupted`], or if the
    /// checkpoint cannot be written.
    pub fn train(
        (learnt, checked): (&Labelled, &Labelled),
        dimensions: usize,
        options: &FitOptions,
        (device, checkpoint): (&Device, Option<&Checkpoint>),
        progress: &mut dyn FnMut(Step) -> ControlFlow<()>,
    ) -> Result<Self, TrainingError> {
        let start = Self::untrained(learnt, checked, dimensions, options)?;
        let dimensions = start.dimensions();
        let device = device.clone().autodiff();
        let network = HeadNetwork::new(&start.projection, &start.classes, dimensions, &device);
        let lesson = FeatureLesson { learnt, checked, scale: start.scale, device };
        let Fitted { network, epoch, glance, epochs } = fit(&lesson, network, options, checkpoint, progress)?;
        if epoch == 0 {
            return Ok(Self { epochs, ..start });
        }
        let (projection, classes) = network.matrices()?;
        Ok(Self { projection, classes, epoch, recall: glance.recall, epochs, ..start })
    }
}

/// Features of images, of which a head is to make something.
struct FeatureLesson<'a> {
    learnt: &'a Labelled,
    checked: &'a Labelled,
    scale: f32,
    device: Device,
}

impl Lesson for FeatureLesson<'_> {
    type Network = HeadNetwork;

    fn classes(&self) -> &[usize] {
        self.learnt.classes()
    }

    fn cosines(
        &self,
        network: &HeadNetwork,
        batch: &[usize],
        _: &mut Pcg64,
    ) -> Result<Tensor<2>, TrainingError> {
        let vectors: Vec<f32> = batch.iter().flat_map(|&index| self.learnt.vector(index)).copied().collect();
        let shape = [batch.len(), self.learnt.width()];
        Ok(network.cosines(Tensor::from_data(TensorData::new(vectors, shape), &self.device)))
    }

    fn glance(&self, network: &HeadNetwork) -> Result<Glance, TrainingError> {
        let (projection, classes) = network.matrices()?;
        let projected = self.checked.projected(&projection);
        Ok(projected.glance(&classes, self.scale).of_all((projected.len(), self.checked.len())))
    }
}

/// The values of a tensor.
///
/// # Errors
/// [`TrainingError::Device`].
pub(super) fn values<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>, TrainingError> {
    let values = tensor.into_data_as::<f32>().try_to_vec();
    values.map_err(|error| TrainingError::Device { reason: error.to_string() })
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;
    use crate::training::Loss;

    const WIDTH: usize = 24;
    const CLASSES: usize = 6;

    /// Classes that differ in a few values, behind others that differ much more and mean nothing.
    fn labelled(count: usize, seed: u64) -> Labelled {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut labelled = Labelled::new(WIDTH);
        for index in 0..count {
            let class = index % CLASSES;
            let mut vector = [0.0; WIDTH];
            vector.iter_mut().for_each(|value| *value = random.random_range(-1.0..1.0));
            vector[class] += 0.9;
            vector[WIDTH / 2..].iter_mut().for_each(|value| *value *= 3.0);
            labelled.push(&vector, class);
        }
        labelled
    }

    const DIMENSIONS: usize = 12;

    fn options() -> FitOptions {
        FitOptions { epochs: 15, batch: 32, learning_rate: 1e-2, ..FitOptions::default() }
    }

    fn untrained() -> Head {
        Head::untrained(&labelled(600, 1), &labelled(300, 2), DIMENSIONS, &options()).unwrap()
    }

    /// Trains, if need be in several goes: each ends after `until` epochs of it.
    fn train_until(
        options: &FitOptions,
        checkpoint: Option<&Checkpoint>,
        until: usize,
    ) -> Result<Head, TrainingError> {
        let (learnt, checked) = (labelled(600, 1), labelled(300, 2));
        let mut stop = |step: Step| match step {
            Step::Epoch(epoch) if epoch.number == until => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        };
        Head::train((&learnt, &checked), DIMENSIONS, options, (&Device::flex(), checkpoint), &mut stop)
    }

    fn train(options: &FitOptions) -> Head {
        train_until(options, None, usize::MAX).unwrap()
    }

    #[test]
    fn training_finds_what_tells_classes_apart_where_their_means_do_not() {
        let (checked, asked) = (labelled(300, 2), labelled(600, 3));
        let untrained = untrained();
        for loss in [Loss::CosFace { scale: 10.0, margin: 0.2 }, Loss::CrossEntropy { scale: 10.0 }] {
            let trained = train(&FitOptions { loss, ..options() });
            let epochs = &trained.epochs;
            let recall = |head: &Head| asked.projected(&head.projection).recall(&head.classes);
            assert!(
                recall(&trained) > recall(&untrained) + 0.2,
                "{} {}",
                recall(&trained),
                recall(&untrained)
            );
            assert!(epochs[14].loss < 0.7 * epochs[0].loss, "{epochs:?}");
            let best = epochs.iter().map(|epoch| epoch.recall).fold(untrained.recall, f64::max);
            assert_eq!(trained.recall, best);
            assert_eq!(checked.projected(&trained.projection).recall(&trained.classes), best);
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_head_and_another_one_another() {
        let few = FitOptions { epochs: 3, ..options() };
        let (one, other) = (train(&few), train(&few));
        assert_eq!(one, other);
        assert_ne!(one, train(&FitOptions { seed: 1, ..few }));
    }

    #[test]
    fn a_training_that_was_cut_off_goes_on_to_what_it_would_have_come_to() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site.checkpoint");
        let few = FitOptions { epochs: 6, ..options() };
        let checkpoint = Checkpoint::new(&path, "this one");
        assert_eq!(checkpoint.epochs(), 0);
        train_until(&few, Some(&checkpoint), 2).unwrap();
        assert!(Checkpoint::is_at(&path));
        assert_eq!((checkpoint.epochs(), Checkpoint::new(&path, "this one").epochs()), (2, 2));
        train_until(&few, Some(&checkpoint), 3).unwrap();
        assert_eq!(train_until(&few, Some(&checkpoint), usize::MAX).unwrap(), train(&few));
        // One of another training, or one that is damaged, is begun anew.
        assert_eq!(Checkpoint::new(&path, "another").epochs(), 0);
        let mut damaged = std::fs::read(&path).unwrap();
        let middle = damaged.len() / 2;
        damaged[middle] ^= 1;
        std::fs::write(&path, damaged).unwrap();
        assert!(!Checkpoint::is_at(&path) && !Checkpoint::is_at(&path.join("gone")));
        assert_eq!(checkpoint.epochs(), 0);
        assert_eq!(train_until(&few, Some(&checkpoint), usize::MAX).unwrap(), train(&few));
    }

    #[test]
    fn a_training_that_is_interrupted_within_an_epoch_keeps_the_one_before() {
        let folder = tempfile::tempdir().unwrap();
        let checkpoint = Checkpoint::new(&folder.path().join("site.checkpoint"), "");
        let (learnt, checked) = (labelled(600, 1), labelled(300, 2));
        let mut batches = 0;
        // An epoch has 19.
        let mut stop = |step| {
            batches += usize::from(step == Step::Batch);
            if batches == 25 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let how = (&Device::flex(), Some(&checkpoint));
        let ended = Head::train((&learnt, &checked), DIMENSIONS, &options(), how, &mut stop);
        assert!(matches!(ended, Err(TrainingError::Interrupted)));
        assert_eq!(checkpoint.epochs(), 1);
    }

    #[test]
    fn a_loss_that_is_no_number_ends_the_training_and_leaves_the_last_good_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let checkpoint = Checkpoint::new(&folder.path().join("site.checkpoint"), "");
        train_until(&options(), Some(&checkpoint), 2).unwrap();
        let wild = FitOptions { learning_rate: f64::INFINITY, ..options() };
        let failed = train_until(&wild, Some(&checkpoint), usize::MAX).unwrap_err().to_string();
        assert_eq!(failed, "the loss of epoch 3 is not finite; what the epochs before came to is kept");
        assert_eq!(checkpoint.epochs(), 2);
        // The last step of an epoch, after which no loss is computed: one batch holds everything.
        let whole = FitOptions { batch: 10_000, ..wild };
        let failed = train_until(&whole, Some(&checkpoint), usize::MAX).unwrap_err().to_string();
        assert!(failed.starts_with("the loss of epoch 3 is not finite"), "{failed}");
        assert_eq!(checkpoint.epochs(), 2);
    }

    #[test]
    fn a_head_that_training_makes_no_better_is_the_untrained_one() {
        let still = train(&FitOptions { learning_rate: 0.0, ..options() });
        assert_eq!((still.epoch, still.epochs.len()), (0, 15));
        assert_eq!(Head { epochs: Vec::new(), ..still }, untrained());
    }

    #[test]
    fn one_class_alone_is_nothing_to_tell_apart() {
        let learnt = labelled(60, 1);
        let mut one_class = Labelled::new(WIDTH);
        one_class.push(learnt.vector(0), 0);
        let refused = Head::untrained(&one_class, &learnt, DIMENSIONS, &options()).unwrap_err().to_string();
        assert_eq!(refused, "a training needs two places at least, not 1");
    }
}
