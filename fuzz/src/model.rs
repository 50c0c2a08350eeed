//! What comes with a network: its card, and the ONNX Runtime that is looked at before it is loaded.

use loci::cnn::{ModelCard, OLDEST_RUNTIME, Surroundings, find_runtime};

use super::accepted;
use super::folder::{folder, write};

/// A model card, [`ModelCard::read`].
pub fn model_card(bytes: &[u8]) {
    let here = folder();
    if let Some(card) = accepted(ModelCard::read(&write(here.path(), "card.toml", bytes))) {
        let are_probabilities =
            [-1.0, 0.0, 1.0].map(|cosine| (0.0..=1.0).contains(&card.probability(cosine)));
        assert_eq!(are_probabilities, [true; 3]);
    }
}

/// A shared library that may be an ONNX Runtime, [`find_runtime`]; it is read, not loaded.
pub fn runtime_library(bytes: &[u8]) {
    let here = folder();
    let path = write(here.path(), "libonnxruntime.so", bytes);
    if let Some(found) = accepted(find_runtime(Some(&path), &Surroundings::default())) {
        assert!(found.version >= OLDEST_RUNTIME);
    }
}
