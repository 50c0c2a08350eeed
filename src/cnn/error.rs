//! What can go wrong with a model or with ONNX Runtime: each error names the file and the fix in one line.

use std::path::PathBuf;

use thiserror::Error;

use super::library::{LibraryFault, OLDEST_RUNTIME};
use super::search::SearchedPlace;

/// Why no CNN could be opened, or why it gave no descriptor.
#[derive(Debug, Error)]
pub enum CnnError {
    /// The program was built without the feature `cnn`.
    #[error("this build has no CNN; build with `--features cnn`")]
    NotBuilt,
    /// No usable ONNX Runtime lies where one is looked for.
    #[error(
        "no ONNX Runtime {OLDEST_RUNTIME} or newer found; run `make deps`, or name the library with \
         --onnxruntime PATH (searched {}, and installed Python packages)",
        listed(searched)
    )]
    RuntimeNotFound {
        /// Folders without a library, and libraries that were turned down, in the order of the search.
        searched: Vec<SearchedPlace>,
    },
    /// The library that was asked for is not a usable ONNX Runtime.
    #[error("{}: {fault}; name another ONNX Runtime with --onnxruntime PATH, or run `make deps`", path.display())]
    UnusableLibrary {
        /// The path as it was given.
        path: PathBuf,
        /// What is wrong with it.
        fault: LibraryFault,
    },
    /// The dynamic linker or ONNX Runtime itself refused to start.
    #[error("{}: ONNX Runtime does not start: {reason}", path.display())]
    RuntimeStart {
        /// The library.
        path: PathBuf,
        /// The words of the linker or of ONNX Runtime.
        reason: String,
    },
    /// A process can hold one ONNX Runtime, and it holds another one already.
    #[error(
        "{}: this process already uses {}; one process can load one ONNX Runtime",
        wanted.display(), loaded.display()
    )]
    AnotherRuntimeLoaded {
        /// The library in use.
        loaded: PathBuf,
        /// The library asked for now.
        wanted: PathBuf,
    },
    /// A file of the model cannot be read.
    #[error("{}: cannot read this file of the model: {reason}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system or the size limit says.
        reason: String,
    },
    /// The model card breaks the rules of its format.
    #[error("{}: bad model card: {reason}", path.display())]
    Card {
        /// The card.
        path: PathBuf,
        /// Key and rule.
        reason: String,
    },
    /// The network is not the one that the card describes.
    #[error("{}: sha256 is {got}, the model card says {expected}; rebuild or fetch the model again", path.display())]
    HashMismatch {
        /// The network's file.
        path: PathBuf,
        /// Hexadecimal hash on the card.
        expected: String,
        /// Hexadecimal hash of the file.
        got: String,
    },
    /// ONNX Runtime cannot make a network of the file, or it is another kind of network.
    #[error("{}: not a network that fits its model card: {reason}", path.display())]
    UnfitNetwork {
        /// The network's file.
        path: PathBuf,
        /// What differs.
        reason: String,
    },
    /// ONNX Runtime cannot make a network of the file, or it makes no image of an image.
    #[error("{}: no generator of images: {reason}", path.display())]
    UnfitGenerator {
        /// The network's file.
        path: PathBuf,
        /// What differs, and what to change.
        reason: String,
    },
    /// The network failed on an image.
    #[error("model {model}: inference failed: {reason}")]
    Inference {
        /// Name of the model.
        model: String,
        /// The words of ONNX Runtime.
        reason: String,
    },
    /// The network's answer is all zeros, infinite or not a number.
    #[error(
        "model {model}: the descriptor has no finite length above zero; the network does not suit this image"
    )]
    Degenerate {
        /// Name of the model.
        model: String,
    },
    /// The image has no pixels.
    #[error("the image is {width_px}x{height_px} pixels: nothing to describe")]
    EmptyImage {
        /// Width of the image.
        width_px: usize,
        /// Height of the image.
        height_px: usize,
    },
}

fn listed(places: &[SearchedPlace]) -> String {
    places.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// Foreign words on one line: line breaks become spaces, and the length is bounded.
pub(super) fn one_line(text: &str) -> String {
    const LONGEST_CHARS: usize = 400;
    let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
    words.chars().take(LONGEST_CHARS).collect()
}
