//! What a person sees of a training while it goes on, and how it is interrupted.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::ProgressDrawTarget;
use loci::training::{Checkpoint, Epoch, Step, TrainingError};

use super::super::console::progress_bar;

/// Progress bars that end what they show when the stop flag is set.
pub(super) struct Progress<'a> {
    stop: &'a AtomicBool,
}

impl<'a> Progress<'a> {
    pub(super) fn new(stop: &'a AtomicBool) -> Self {
        Self { stop }
    }

    /// Shows the progress of `work` over `count` things.
    pub(super) fn images<T>(
        &self,
        count: usize,
        things: &'static str,
        work: impl FnOnce(&mut dyn FnMut() -> ControlFlow<()>) -> Result<T, TrainingError>,
    ) -> Result<T, TrainingError> {
        let bar = progress_bar(Some(count as u64), things, ProgressDrawTarget::stderr());
        let done = work(&mut || {
            bar.inc(1);
            self.go_on()
        });
        bar.finish_and_clear();
        done
    }

    /// Shows loss and recall of every epoch of `work`, which may have begun at `checkpoint`.
    pub(super) fn epochs<T>(
        &self,
        count: usize,
        checkpoint: &Checkpoint,
        work: impl FnOnce(&mut dyn FnMut(Step) -> ControlFlow<()>) -> Result<T, TrainingError>,
    ) -> Result<T, TrainingError> {
        let bar = progress_bar(Some(count as u64), "epochs", ProgressDrawTarget::stderr());
        bar.set_position(checkpoint.epochs() as u64);
        let done = work(&mut |step| {
            if let Step::Epoch(Epoch { loss, recall, .. }) = step {
                bar.inc(1);
                bar.set_prefix(format!("loss {loss:.3}, recall {recall:.3} "));
            }
            self.go_on()
        });
        bar.finish_and_clear();
        if self.go_on().is_break() { Err(TrainingError::Interrupted) } else { done }
    }

    fn go_on(&self) -> ControlFlow<()> {
        if self.stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}
