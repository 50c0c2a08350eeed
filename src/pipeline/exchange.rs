//! The model that describes frames, and how another one takes its place between two of them.
//!
//! The new one is on trial for its first frames, and the one before stays at hand: where the new one fails on a frame
//! that the one before can describe, that one describes it and goes on. Whoever lets go of a model does so in another
//! thread, for that takes time.

use std::mem;
use std::sync::Arc;
use std::time::Instant;

use crossbeam_channel::{Receiver, Sender};

use super::stages::{Described, micros};
use crate::cnn::{CnnError, Descriptor, DescriptorModel, ModelCard};
use crate::raster::RgbImage;

/// Frames that a new model has to describe before the one before is let go: seven seconds of a camera.
pub(super) const TRIAL_FRAMES: u32 = 20;

/// The model that a frame was given to.
#[derive(Clone, Debug)]
pub struct ModelInUse {
    /// Its card.
    pub card: Arc<ModelCard>,
    /// Whether it took over a few frames ago, so that the one before may come back.
    pub is_on_trial: bool,
}

/// Where the models come from that take over, and where those go that are not used any more.
pub(super) struct Exchange {
    pub(super) offered: Receiver<DescriptorModel>,
    pub(super) replaced: Sender<Replaced>,
}

/// A model that is not used any more.
pub(super) struct Replaced {
    pub(super) model: DescriptorModel,
    /// Why it is the new one that went, if it is.
    pub(super) failure: Option<CnnError>,
}

struct Trial {
    before: DescriptorModel,
    frames_left: u32,
}

/// What describes frames.
pub(super) struct Describer<'a> {
    model: &'a mut DescriptorModel,
    card: Arc<ModelCard>,
    exchange: Option<Exchange>,
    trial: Option<Trial>,
}

impl<'a> Describer<'a> {
    /// Describes by `model`, until another one is offered.
    pub(super) fn new(model: &'a mut DescriptorModel, exchange: Option<Exchange>) -> Self {
        let card = Arc::new(model.card().clone());
        Self { model, card, exchange, trial: None }
    }

    /// Describes a frame, by another model than the one before if one was offered meanwhile.
    pub(super) fn describe(&mut self, image: &RgbImage) -> Described {
        let started = Instant::now();
        if self.trial.is_none()
            && let Some(new) = self.exchange.as_ref().and_then(|exchange| exchange.offered.try_recv().ok())
        {
            let before = self.change_to(new);
            self.trial = Some(Trial { before, frames_left: TRIAL_FRAMES });
        }
        let descriptor = match self.model.describe(image) {
            Ok(descriptor) => {
                self.prove();
                Ok(descriptor)
            }
            Err(failure) => self.go_back(failure, image),
        };
        let model = ModelInUse { card: Arc::clone(&self.card), is_on_trial: self.trial.is_some() };
        Described { descriptor, model, cnn_us: micros(started), waiting: 0 }
    }

    /// Describes by `new` from now on, and answers by what it was until now.
    fn change_to(&mut self, new: DescriptorModel) -> DescriptorModel {
        self.card = Arc::new(new.card().clone());
        mem::replace(self.model, new)
    }

    /// The model on trial has described one more frame.
    fn prove(&mut self) {
        let Some(mut trial) = self.trial.take() else { return };
        trial.frames_left -= 1;
        if trial.frames_left > 0 {
            self.trial = Some(trial);
        } else {
            self.hand_back(Replaced { model: trial.before, failure: None });
        }
    }

    /// Has the model before describe what the one on trial failed on. If it fails, too, the image is at fault.
    fn go_back(&mut self, failure: CnnError, image: &RgbImage) -> Result<Descriptor, CnnError> {
        let Some(mut trial) = self.trial.take() else { return Err(failure) };
        match trial.before.describe(image) {
            Ok(descriptor) => {
                let failed = self.change_to(trial.before);
                self.hand_back(Replaced { model: failed, failure: Some(failure) });
                Ok(descriptor)
            }
            Err(_) => {
                self.trial = Some(trial);
                Err(failure)
            }
        }
    }

    fn hand_back(&self, replaced: Replaced) {
        if let Some(exchange) = &self.exchange {
            // There is room for it: the next model is offered only once it has come. At the end nobody listens.
            let _ = exchange.replaced.try_send(replaced);
        }
    }
}
