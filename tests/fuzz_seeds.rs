//! Every input that is kept for fuzzing, given to its reader: what once made one fail must not again.
#![cfg(feature = "evaluation")]

#[path = "../fuzz/src/lib.rs"]
pub mod readers;

use std::fs;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};

use readers::{TARGETS, Target};

const FUZZ: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz");

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    entries.map(|entry| entry.unwrap().path()).collect()
}

/// How many seeds `target` has; those that make it panic are added to `failed`.
fn seeds(name: &str, target: Target, failed: &mut Vec<PathBuf>) -> usize {
    let seeds = files(&Path::new(FUZZ).join("seeds").join(name));
    let count = seeds.len();
    failed.extend(seeds.into_iter().filter(|seed| {
        let bytes = fs::read(seed).unwrap();
        catch_unwind(|| target(&bytes)).is_err()
    }));
    count
}

#[test]
fn every_reader_survives_its_seeds() {
    let mut failed = Vec::new();
    for (name, target) in TARGETS {
        assert!(seeds(name, target, &mut failed) > 0, "{name} has no seeds");
    }
    assert!(failed.is_empty(), "readers fail on {failed:?}");
}

#[test]
fn every_target_is_a_program_and_has_a_folder_of_seeds() {
    let listed = |folder: &str| {
        let stems = files(&Path::new(FUZZ).join(folder)).into_iter();
        let mut stems: Vec<String> =
            stems.map(|path| path.file_stem().unwrap().to_string_lossy().into_owned()).collect();
        stems.sort();
        stems
    };
    let names = TARGETS.map(|(name, _)| name);
    assert!(names.is_sorted());
    assert_eq!(listed("fuzz_targets"), names);
    assert_eq!(listed("seeds"), names);
}
