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
        done.and_then(|done| if self.go_on().is_break() { Err(TrainingError::Interrupted) } else { Ok(done) })
    }

    /// `images` up to where the stop flag is set, and there the word that it is.
    pub(super) fn until_stopped<T>(
        &self,
        images: impl Iterator<Item = Result<T, TrainingError>>,
    ) -> impl Iterator<Item = Result<T, TrainingError>> {
        images.map(|image| if self.go_on().is_break() { Err(TrainingError::Interrupted) } else { image })
    }

    fn go_on(&self) -> ControlFlow<()> {
        if self.stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn a_training_that_was_stopped_is_interrupted_and_one_that_failed_has_failed() {
        let stop = AtomicBool::new(true);
        let progress = Progress::new(&stop);
        let checkpoint = Checkpoint::new(Path::new("nowhere"), "");
        let stopped = progress.epochs(3, &checkpoint, |_| Ok(()));
        assert!(matches!(stopped, Err(TrainingError::Interrupted)));
        let failed = progress.epochs(3, &checkpoint, |_| Err::<(), _>(TrainingError::NotFinite { epoch: 2 }));
        assert!(matches!(failed, Err(TrainingError::NotFinite { epoch: 2 })));
        let mut images = progress.until_stopped([Ok(1), Ok(2)].into_iter());
        assert!(matches!(images.next(), Some(Err(TrainingError::Interrupted))));
        stop.store(false, Ordering::Relaxed);
        assert!(matches!(images.next(), Some(Ok(2))));
        assert!(matches!(progress.epochs(3, &checkpoint, |_| Ok(7)), Ok(7)));
    }
}
