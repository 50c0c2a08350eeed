//! Texts that a person writes: suites and arguments.

use loci::evaluation::ground_truth::RowFilter;
use loci::evaluation::layout::Layout;
use loci::evaluation::{Suite, TruthSpec};
use loci::source::Address;
use loci::source::synthetic::SyntheticSpec;

use super::accepted;
use super::folder::{folder, write};

/// A suite of experiments, [`Suite::read`]. It is not planned: that would open what its paths name.
pub fn suite(bytes: &[u8]) {
    let here = folder();
    accepted(Suite::read(&write(here.path(), "suite.toml", bytes)));
}

/// Arguments with a syntax of their own: sources, choices of rows, ground truths, layouts.
pub fn argument(bytes: &[u8]) {
    // An argument of several lines may be repeated in the error as it is.
    let Some(text) = std::str::from_utf8(bytes).ok().filter(|text| !text.contains(['\n', '\r'])) else {
        return;
    };
    let world = match Address::from(text) {
        Address::Synthetic(world) => world,
        Address::Camera(_) | Address::Path(_) => text,
    };
    if let Some(spec) = accepted(world.parse::<SyntheticSpec>()) {
        assert!((1..=10_000_000).contains(&spec.drive_length()));
        let _ = spec.light_of_lap(spec.laps());
    }
    if let Some(filter) = accepted(text.parse::<RowFilter>()) {
        assert_eq!(filter.to_string().parse(), Ok(filter));
    }
    accepted(text.parse::<TruthSpec>());
    accepted(text.parse::<Layout>());
}
