//! What the program does, seen from outside: one module a subject, one binary for all.

mod bad_input;
mod commands;
#[cfg(feature = "evaluation")]
mod evaluate;
mod map_care;
mod map_merge;
mod misfortune;
#[cfg(feature = "cnn")]
mod model_swap;
mod program;
mod real_sequences;
#[cfg(feature = "rerun")]
mod review;
mod stream;
#[cfg(feature = "train")]
mod train;
