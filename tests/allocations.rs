//! Which memory a robot asks for while it looks at one frame after the other.

use std::alloc::System;
use std::path::Path;

use loci::feature::{Features, OrbExtractor, OrbOptions};
use loci::retrieval::{BowVector, InvertedIndex};
use loci::source;
use loci::vocabulary::Vocabulary;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static HEAP: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Allocations, those that grew included, while `work` is done.
fn allocations(work: impl FnOnce()) -> usize {
    let region = Region::new(HEAP);
    work();
    region.change().allocations + region.change().reallocations
}

/// One test, for other threads would be counted, too.
#[test]
fn neither_features_nor_a_query_take_memory() {
    let mut street = source::open("synthetic:street?laps=1&light=noon&frames=60&seed=7", None).unwrap();
    let frames: Vec<_> = (0..4).map(|_| street.next_frame().unwrap().unwrap()).collect();
    let mut extractor = OrbExtractor::new(OrbOptions::default());
    let features: Vec<_> = frames.iter().map(|frame| extractor.extract(&frame.grey)).collect();
    let mut found = Features::default();
    extractor.extract_into(&frames[0].grey, &mut found);
    for frame in &frames {
        assert_eq!(allocations(|| extractor.extract_into(&frame.grey, &mut found)), 0);
        assert!(!found.is_empty());
    }

    let vocabulary =
        Vocabulary::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("vocab/default.lvoc")).unwrap();
    let mut index = InvertedIndex::default();
    let mut bags = Vec::new();
    for features in &features {
        let quantised = vocabulary.quantise_all(&features.descriptors);
        bags.push(BowVector::new(quantised.iter().map(|quantised| quantised.word), &vocabulary));
        index.add(&bags[bags.len() - 1]);
    }
    let mut query = || bags.iter().for_each(|bag| assert!(!index.query(bag, |_| true).is_empty()));
    query();
    assert_eq!(allocations(query), 0);
}
