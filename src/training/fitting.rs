//! The training itself: epochs of steps, the best epoch kept, a checkpoint after each.

use std::ops::ControlFlow;

use burn::module::Module;
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::activation::log_softmax;
use burn::tensor::{Int, Tensor, TensorData};
use rand::Rng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use super::checkpoint::{Checkpoint, State};
use super::error::TrainingError;
use super::labelled::Glance;

/// What is asked of a descriptor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// That its class is the likeliest: softmax over `scale` · cos θ.
    CrossEntropy {
        /// Sharpness of the softmax.
        scale: f32,
    },
    /// That its class is the likeliest even with the cosine less by `margin` (Wang et al., "CosFace: Large Margin
    /// Cosine Loss for Deep Face Recognition", CVPR 2018, eq. 4).
    CosFace {
        /// Sharpness of the softmax: s of the paper.
        scale: f32,
        /// m of the paper.
        margin: f32,
    },
}

impl Loss {
    /// Sharpness of the softmax.
    #[must_use]
    pub fn scale(self) -> f32 {
        match self {
            Self::CrossEntropy { scale } | Self::CosFace { scale, .. } => scale,
        }
    }

    fn margin(self) -> f32 {
        match self {
            Self::CrossEntropy { .. } => 0.0,
            Self::CosFace { margin, .. } => margin,
        }
    }

    /// Mean loss over a batch of cosines to all classes, `[n, classes]`, whose own are `classes`.
    fn of(self, cosines: Tensor<2>, classes: &[usize]) -> Tensor<1> {
        let [count, class_count] = cosines.dims();
        let classes: Vec<i32> = classes.iter().map(|&class| class as i32).collect();
        let classes = Tensor::<1, Int>::from_data(TensorData::new(classes, [count]), &cosines.device());
        let is_own = classes.one_hot::<2>(class_count).float();
        let logits = (cosines - is_own.clone() * self.margin()) * self.scale();
        -(log_softmax(logits, 1) * is_own).sum() / count as f32
    }
}

/// How a network is trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitOptions {
    /// Times that every class is gone through.
    pub epochs: usize,
    /// Images of a step.
    pub batch: usize,
    /// Step size of Adam.
    pub learning_rate: f64,
    /// What is asked of a descriptor.
    pub loss: Loss,
    /// Settles every draw.
    pub seed: u64,
}

impl Default for FitOptions {
    fn default() -> Self {
        let loss = Loss::CosFace { scale: 30.0, margin: 0.2 };
        Self { epochs: 30, batch: 64, learning_rate: 3e-4, loss, seed: 0 }
    }
}

/// How an epoch went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Epoch {
    /// Counted from 1.
    pub number: usize,
    /// Mean loss of its steps.
    pub loss: f64,
    /// Share of what is only looked at whose own class is the nearest.
    pub recall: f64,
}

/// What a training tells while it goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// A batch was learnt.
    Batch,
    /// An epoch has ended.
    Epoch(Epoch),
}

/// A network that tells the classes of what it is shown apart.
pub(super) trait Lesson {
    /// What is trained.
    type Network: Module;

    /// Class of each of what is learnt.
    fn classes(&self) -> &[usize];

    /// Cosines of what is learnt under the numbers `batch` to all classes, `[batch, classes]`. Whatever is drawn, is
    /// drawn from `random`.
    ///
    /// # Errors
    /// If what is learnt cannot be read.
    fn cosines(
        &self,
        network: &Self::Network,
        batch: &[usize],
        random: &mut Pcg64,
    ) -> Result<Tensor<2>, TrainingError>;

    /// How what is only looked at lies to the classes.
    ///
    /// # Errors
    /// If it cannot be read, or the device fails.
    fn glance(&self, network: &Self::Network) -> Result<Glance, TrainingError>;
}

/// A network as it was after its best epoch.
pub(super) struct Fitted<N> {
    pub(super) network: N,
    /// 0 if no epoch was better than the start.
    pub(super) epoch: usize,
    pub(super) glance: Glance,
    /// Every epoch.
    pub(super) epochs: Vec<Epoch>,
}

/// Trains `start`, or goes on where `checkpoint` says; of all epochs the one is kept after which most is recognised
/// of what is only looked at, and most surely. `progress` hears of every step. After an epoch it may end the training
/// early, with the best one so far; after a batch that interrupts it.
///
/// # Errors
/// [`TrainingError::NotFinite`], [`TrainingError::Interrupted`], what `lesson` answers, or if the checkpoint cannot be
/// written.
pub(super) fn fit<L: Lesson>(
    lesson: &L,
    start: L::Network,
    options: &FitOptions,
    checkpoint: Option<&Checkpoint>,
    progress: &mut dyn FnMut(Step) -> ControlFlow<()>,
) -> Result<Fitted<L::Network>, TrainingError> {
    let mut state = match checkpoint.and_then(|checkpoint| checkpoint.read(&start)) {
        Some(state) => state,
        None => State::begin(start, lesson)?,
    };
    for number in state.best.epochs.len() + 1..=options.epochs {
        // A stream of its own for each epoch: one that goes on draws what one that never stopped would.
        let mut random = Pcg64::new(u128::from(options.seed), number as u128);
        let loss = run_epoch((lesson, &mut state), options, &mut random, progress)?;
        let glance = lesson.glance(&state.network)?;
        // The last step may have broken what every loss was still computed with.
        if !loss.is_finite() || !glance.loss.is_finite() {
            return Err(TrainingError::NotFinite { epoch: number });
        }
        let best = &mut state.best;
        if glance.is_better_than(&best.glance) {
            (best.network, best.epoch, best.glance) = (state.network.clone(), number, glance);
        }
        let epoch = Epoch { number, loss, recall: glance.recall };
        best.epochs.push(epoch);
        if let Some(checkpoint) = checkpoint {
            checkpoint.write(&state)?;
        }
        if progress(Step::Epoch(epoch)).is_break() {
            break;
        }
    }
    Ok(state.best)
}

/// One epoch; answers the mean loss of its steps.
fn run_epoch<L: Lesson>(
    (lesson, state): (&L, &mut State<L::Network>),
    options: &FitOptions,
    random: &mut Pcg64,
    progress: &mut dyn FnMut(Step) -> ControlFlow<()>,
) -> Result<f64, TrainingError> {
    let order = balanced(lesson.classes(), random);
    let mut losses = 0.0;
    for batch in order.chunks(options.batch.max(1)) {
        let classes: Vec<usize> = batch.iter().map(|&index| lesson.classes()[index]).collect();
        let cosines = lesson.cosines(&state.network, batch, random)?;
        let loss = options.loss.of(cosines, &classes);
        let value = f64::from(loss.clone().into_scalar::<f32>());
        if !value.is_finite() {
            return Ok(value);
        }
        losses += value * batch.len() as f64;
        let gradients = GradientsParams::from_grads(loss.backward(), &state.network);
        state.network = state.optimiser.step(options.learning_rate, state.network.clone(), gradients);
        if progress(Step::Batch).is_break() {
            return Err(TrainingError::Interrupted);
        }
    }
    Ok(losses / order.len() as f64)
}

pub(super) fn optimiser() -> ModuleOptimizer {
    AdamConfig::new().init()
}

/// What an epoch goes through: of each class as many as of the one in the middle, drawn anew where it has fewer.
fn balanced(classes: &[usize], random: &mut Pcg64) -> Vec<usize> {
    let mut of_class = vec![Vec::new(); classes.iter().max().map_or(0, |&class| class + 1)];
    for (index, &class) in classes.iter().enumerate() {
        of_class[class].push(index);
    }
    of_class.retain(|members| !members.is_empty());
    let mut sizes: Vec<usize> = of_class.iter().map(Vec::len).collect();
    sizes.sort_unstable();
    let wanted = sizes.get(sizes.len() / 2).copied().unwrap_or_default();
    let mut order = Vec::new();
    for mut members in of_class {
        members.shuffle(random);
        let drawn = (members.len()..wanted).map(|_| members[random.random_range(0..members.len())]);
        let drawn: Vec<usize> = drawn.collect();
        order.extend(members.into_iter().take(wanted).chain(drawn));
    }
    order.shuffle(random);
    order
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn every_class_is_gone_through_as_often_as_the_one_in_the_middle() {
        let classes: Vec<usize> =
            [(0, 50), (1, 10), (2, 3)].iter().flat_map(|&(class, count)| vec![class; count]).collect();
        let order = balanced(&classes, &mut Pcg64::seed_from_u64(0));
        let of_class = |class| order.iter().filter(|&&index| classes[index] == class).count();
        assert_eq!([of_class(0), of_class(1), of_class(2)], [10, 10, 10]);
        assert!(balanced(&[], &mut Pcg64::seed_from_u64(0)).is_empty());
    }
}
