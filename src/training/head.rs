//! A head for a frozen backbone: a projection to a shorter unit descriptor, and a direction for each class, learnt
//! together so that a descriptor lies nearer to its own class than to any other by a margin.
//!
//! The margin is CosFace's (Wang et al., "CosFace: Large Margin Cosine Loss for Deep Face Recognition", CVPR 2018,
//! eq. 4): softmax over s · cos θ of all classes, where the right one counts s · (cos θ − m). Training begins where no
//! training would end: with the projection that keeps most of the features, and class means as directions.

use std::ops::ControlFlow;

use burn::module::{Module, Param};
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::activation::log_softmax;
use burn::tensor::{Device, Int, Tensor, TensorData};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::error::TrainingError;
use super::labelled::Labelled;
use super::principal::principal_directions;

/// Where a direction has no length, for the sake of division.
const SHORTEST: f32 = 1e-12;

/// What is asked of a descriptor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// That its class is the likeliest: softmax over `scale` · cos θ.
    CrossEntropy {
        /// Sharpness of the softmax.
        scale: f32,
    },
    /// That its class is the likeliest even with the cosine less by `margin`.
    CosFace {
        /// Sharpness of the softmax: s of the paper.
        scale: f32,
        /// m of the paper.
        margin: f32,
    },
}

impl Loss {
    fn scale_and_margin(self) -> (f32, f32) {
        match self {
            Self::CrossEntropy { scale } => (scale, 0.0),
            Self::CosFace { scale, margin } => (scale, margin),
        }
    }
}

/// How a head is trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadOptions {
    /// Values of a descriptor, at most as many as the features have.
    pub dimensions: usize,
    /// Times that every class is gone through.
    pub epochs: usize,
    /// Vectors of a step.
    pub batch: usize,
    /// Step size of Adam.
    pub learning_rate: f64,
    /// What is asked of a descriptor.
    pub loss: Loss,
    /// Settles every draw.
    pub seed: u64,
}

impl Default for HeadOptions {
    fn default() -> Self {
        let loss = Loss::CosFace { scale: 30.0, margin: 0.2 };
        Self { dimensions: 256, epochs: 30, batch: 64, learning_rate: 3e-4, loss, seed: 0 }
    }
}

/// How an epoch went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Epoch {
    /// Counted from 1.
    pub number: usize,
    /// Mean loss of its steps.
    pub loss: f64,
    /// Share of the vectors that are only looked at whose own class is the nearest.
    pub recall: f64,
}

/// A trained head.
#[derive(Clone, Debug, PartialEq)]
pub struct Head {
    /// `[features, dimensions]`, row-major.
    pub projection: Vec<f32>,
    /// Directions of unit length, `[classes, dimensions]`.
    pub classes: Vec<f32>,
    /// Sharpness of the softmax over the cosines.
    pub scale: f32,
    /// The epoch that it is of; 0 if no training made it better.
    pub epoch: usize,
    /// Share of the vectors that were only looked at whose own class is the nearest.
    pub recall: f64,
}

#[derive(Module, Debug)]
struct Network {
    /// `[features, dimensions]`
    projection: Param<Tensor<2>>,
    /// `[classes, dimensions]`
    classes: Param<Tensor<2>>,
}

impl Network {
    /// Cosines of `features` `[n, features]` to all classes: `[n, classes]`.
    fn cosines(&self, features: Tensor<2>) -> Tensor<2> {
        let descriptors = unit(features.matmul(self.projection.val()));
        descriptors.matmul(unit(self.classes.val()).transpose())
    }
}

/// Rows of unit length.
fn unit(rows: Tensor<2>) -> Tensor<2> {
    let lengths = rows.clone().powi_scalar(2).sum_dim(1).sqrt().clamp_min(SHORTEST);
    rows / lengths
}

impl Head {
    /// The head without any training: the directions in which `learnt` differs most, and the means of the classes.
    ///
    /// # Errors
    /// [`TrainingError::TooFewClasses`].
    pub fn untrained(
        learnt: &Labelled,
        checked: &Labelled,
        options: &HeadOptions,
    ) -> Result<Self, TrainingError> {
        let classes = learnt.class_count();
        if classes < 2 {
            return Err(TrainingError::TooFewClasses { classes });
        }
        let projection = principal_directions(learnt, options.dimensions.min(learnt.width()), options.seed);
        let classes = learnt.projected(&projection).prototypes();
        let recall = checked.projected(&projection).recall(&classes);
        let (scale, _) = options.loss.scale_and_margin();
        Ok(Self { projection, classes, scale, epoch: 0, recall })
    }

    /// Trains a head on `learnt`; of all epochs the one is kept after which most of `checked` are recognised.
    /// `progress` hears of every epoch and may end the training early, with the best one so far.
    ///
    /// # Errors
    /// [`TrainingError::TooFewClasses`] or [`TrainingError::NotFinite`].
    pub fn train(
        learnt: &Labelled,
        checked: &Labelled,
        options: &HeadOptions,
        device: &Device,
        progress: &mut dyn FnMut(Epoch) -> ControlFlow<()>,
    ) -> Result<Self, TrainingError> {
        let mut best = Self::untrained(learnt, checked, options)?;
        let width = learnt.width();
        let dimensions = best.projection.len() / width;
        let device = device.clone().autodiff();
        let matrix = |values: &[f32]| {
            let shape = [values.len() / dimensions, dimensions];
            Param::from_tensor(Tensor::from_data(TensorData::new(values.to_vec(), shape), &device))
        };
        let mut network = Network { projection: matrix(&best.projection), classes: matrix(&best.classes) };
        let mut optimiser = AdamConfig::new().init();
        let mut random = Pcg64::seed_from_u64(options.seed);
        for number in 1..=options.epochs {
            let order = balanced(learnt, &mut random);
            let mut losses = 0.0;
            for batch in order.chunks(options.batch.max(1)) {
                let loss = loss(&network, learnt, batch, options.loss, &device);
                losses += f64::from(loss.clone().into_scalar::<f32>()) * batch.len() as f64;
                let gradients = GradientsParams::from_grads(loss.backward(), &network);
                network = optimiser.step(options.learning_rate, network, gradients);
            }
            let loss = losses / order.len() as f64;
            if !loss.is_finite() {
                return Err(TrainingError::NotFinite { epoch: number });
            }
            let head = Self::of(&network, number, checked, options)?;
            let recall = head.recall;
            if recall > best.recall {
                best = head;
            }
            if progress(Epoch { number, loss, recall }).is_break() {
                break;
            }
        }
        Ok(best)
    }

    fn of(
        network: &Network,
        epoch: usize,
        checked: &Labelled,
        options: &HeadOptions,
    ) -> Result<Self, TrainingError> {
        let projection = values(network.projection.val())?;
        let classes = values(unit(network.classes.val()))?;
        let recall = checked.projected(&projection).recall(&classes);
        let (scale, _) = options.loss.scale_and_margin();
        Ok(Self { projection, classes, scale, epoch, recall })
    }
}

fn values(tensor: Tensor<2>) -> Result<Vec<f32>, TrainingError> {
    let values = tensor.into_data_as::<f32>().try_to_vec();
    values.map_err(|error| TrainingError::Device { reason: error.to_string() })
}

/// The vectors of an epoch: of each class as many as of the one in the middle, drawn anew where it has fewer.
fn balanced(learnt: &Labelled, random: &mut Pcg64) -> Vec<usize> {
    let mut of_class = vec![Vec::new(); learnt.class_count()];
    for (index, &class) in learnt.classes().iter().enumerate() {
        of_class[class].push(index);
    }
    of_class.retain(|vectors| !vectors.is_empty());
    let mut sizes: Vec<usize> = of_class.iter().map(Vec::len).collect();
    sizes.sort_unstable();
    let wanted = sizes[sizes.len() / 2];
    let mut order = Vec::new();
    for mut vectors in of_class {
        vectors.shuffle(random);
        let drawn = (vectors.len()..wanted).map(|_| vectors[random.random_range(0..vectors.len())]);
        let drawn: Vec<usize> = drawn.collect();
        order.extend(vectors.into_iter().take(wanted).chain(drawn));
    }
    order.shuffle(random);
    order
}

/// Mean loss of the vectors `batch`.
fn loss(network: &Network, learnt: &Labelled, batch: &[usize], loss: Loss, device: &Device) -> Tensor<1> {
    let (count, classes) = (batch.len(), learnt.class_count());
    let vectors: Vec<f32> = batch.iter().flat_map(|&index| learnt.vector(index)).copied().collect();
    let features = Tensor::<2>::from_data(TensorData::new(vectors, [count, learnt.width()]), device);
    let targets: Vec<i32> = batch.iter().map(|&index| learnt.classes()[index] as i32).collect();
    let targets = Tensor::<1, Int>::from_data(TensorData::new(targets, [count]), device);
    let is_own = targets.one_hot::<2>(classes).float();
    let (scale, margin) = loss.scale_and_margin();
    let logits = (network.cosines(features) - is_own.clone() * margin) * scale;
    -(log_softmax(logits, 1) * is_own).sum() / count as f32
}

#[cfg(test)]
mod tests {
    use super::*;

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

    fn options() -> HeadOptions {
        HeadOptions { dimensions: 12, epochs: 15, batch: 32, learning_rate: 1e-2, ..HeadOptions::default() }
    }

    fn train(options: &HeadOptions) -> (Head, Vec<Epoch>) {
        let (learnt, checked) = (labelled(600, 1), labelled(300, 2));
        let mut epochs = Vec::new();
        let head = Head::train(&learnt, &checked, options, &Device::flex(), &mut |epoch| {
            epochs.push(epoch);
            ControlFlow::Continue(())
        });
        (head.unwrap(), epochs)
    }

    #[test]
    fn training_finds_what_tells_classes_apart_where_their_means_do_not() {
        let (learnt, checked, asked) = (labelled(600, 1), labelled(300, 2), labelled(600, 3));
        let untrained = Head::untrained(&learnt, &checked, &options()).unwrap();
        for loss in [Loss::CosFace { scale: 10.0, margin: 0.2 }, Loss::CrossEntropy { scale: 10.0 }] {
            let (trained, epochs) = train(&HeadOptions { loss, ..options() });
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
        let few = HeadOptions { epochs: 3, ..options() };
        let (one, other) = (train(&few).0, train(&few).0);
        assert_eq!(one, other);
        assert_ne!(one, train(&HeadOptions { seed: 1, ..few }).0);
    }

    #[test]
    fn a_head_that_training_makes_no_better_is_the_untrained_one() {
        let (learnt, checked) = (labelled(600, 1), labelled(300, 2));
        let untrained = Head::untrained(&learnt, &checked, &options()).unwrap();
        let still = HeadOptions { learning_rate: 0.0, ..options() };
        assert_eq!(train(&still).0, untrained);
        assert_eq!(untrained.epoch, 0);
    }

    #[test]
    fn a_training_may_be_ended_and_says_what_makes_no_sense() {
        let (learnt, checked) = (labelled(60, 1), labelled(60, 2));
        let mut seen = 0;
        let mut stop = |_| {
            seen += 1;
            ControlFlow::Break(())
        };
        Head::train(&learnt, &checked, &options(), &Device::flex(), &mut stop).unwrap();
        assert_eq!(seen, 1);
        let mut one_class = Labelled::new(WIDTH);
        one_class.push(learnt.vector(0), 0);
        let refused = Head::untrained(&one_class, &checked, &options()).unwrap_err().to_string();
        assert_eq!(refused, "a training needs two places at least, not 1");
        let wild = HeadOptions { learning_rate: f64::INFINITY, ..options() };
        let mut go_on = |_| ControlFlow::Continue(());
        let failed = Head::train(&learnt, &checked, &wild, &Device::flex(), &mut go_on).unwrap_err();
        assert!(failed.to_string().contains("is not finite; nothing was written"), "{failed}");
    }

    #[test]
    fn every_class_is_gone_through_as_often_as_the_one_in_the_middle() {
        let mut learnt = Labelled::new(1);
        for (class, count) in [(0, 50), (1, 10), (2, 3)] {
            (0..count).for_each(|_| learnt.push(&[1.0], class));
        }
        let order = balanced(&learnt, &mut Pcg64::seed_from_u64(0));
        let of_class = |class| order.iter().filter(|&&index| learnt.classes()[index] == class).count();
        assert_eq!([of_class(0), of_class(1), of_class(2)], [10, 10, 10]);
    }
}
