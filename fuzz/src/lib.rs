//! Every reader of bytes from outside, called as the fuzzer calls it: with any bytes at all.
//!
//! A reader may refuse its bytes, in one line, or take them; then what it took must make sense. It must
//! never panic, hang or allocate without bound. The same functions run under libFuzzer (`fuzz_targets/`)
//! and over the kept inputs (`seeds/`) in a plain test of Loci, which includes this file.

mod folder;
mod ground_truth;
mod image;
mod model;
mod stored;
mod text;

pub use ground_truth::{layout, loop_matrix, truth_table};
pub use image::image;
pub use model::{model_card, runtime_library};
pub use stored::{map_index, map_journal, map_snapshot, training_file, vocabulary_file, vocabulary_import};
pub use text::{argument, suite};

/// A fuzz target: gives the bytes to a reader and panics if the answer makes no sense.
pub type Target = fn(&[u8]);

/// All targets by name; each has a folder of that name in `seeds/`.
pub const TARGETS: [(&str, Target); 14] = [
    ("argument", argument),
    ("image", image),
    ("layout", layout),
    ("loop_matrix", loop_matrix),
    ("map_index", map_index),
    ("map_journal", map_journal),
    ("map_snapshot", map_snapshot),
    ("model_card", model_card),
    ("runtime_library", runtime_library),
    ("suite", suite),
    ("training_file", training_file),
    ("truth_table", truth_table),
    ("vocabulary_file", vocabulary_file),
    ("vocabulary_import", vocabulary_import),
];

/// What a reader answered, unless it refused; a refusal must be one line.
fn accepted<T, E: std::fmt::Display>(answer: Result<T, E>) -> Option<T> {
    answer
        .map_err(|error| {
            let message = error.to_string();
            assert!(!message.is_empty() && !message.contains(['\n', '\r']), "not one line: {message:?}");
        })
        .ok()
}
