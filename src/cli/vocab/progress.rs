//! How far a training or a weighing is, as a bar; and Ctrl-C, which ends it.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget};
use loci::vocabulary::{TrainingFile, TrainingProgress, TrainingWatcher, VocabularyError};

use super::extraction::training_path;
use crate::cli::console::{counted, progress_bar};

/// A bar that ends the training once `stop` is raised.
pub(super) struct Progress<'a> {
    bar: ProgressBar,
    stop: &'a AtomicBool,
}

impl<'a> Progress<'a> {
    pub(super) fn new(stop: &'a AtomicBool) -> Self {
        Self { bar: progress_bar(None, "{msg}", ProgressDrawTarget::stderr()), stop }
    }
}

impl TrainingWatcher for Progress<'_> {
    fn note(&self, progress: TrainingProgress) {
        let (done, total, unit) = match progress {
            TrainingProgress::Growing { done, total } => (done, total, "descriptors sorted into the tree"),
            TrainingProgress::Weighing { done, total } => (done, total, "images weighed"),
        };
        // Both at once, for the bar may be drawn at any time.
        self.bar.update(|state| {
            state.set_len(total);
            state.set_pos(done);
        });
        self.bar.set_message(unit);
    }

    fn goes_on(&self) -> bool {
        !self.stop.load(Ordering::Relaxed)
    }
}

impl Drop for Progress<'_> {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// What the user is told of `error`: how to go on, where it was Ctrl-C.
pub(super) fn explained(error: VocabularyError, corpus: &TrainingFile, out: &Path) -> anyhow::Error {
    let VocabularyError::Interrupted = error else { return error.into() };
    let (frames, path) = (counted(corpus.frame_count(), "frame"), training_path(out));
    anyhow::anyhow!("interrupted; the same command goes on with the {frames} in {}", path.display())
}
