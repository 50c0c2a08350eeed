//! From a sample of descriptors to a tree: split, and split the clusters again, side by side.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};

use rand::SeedableRng;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::clustering::split;
use super::{TrainingOptions, TrainingProgress, TrainingWatcher};
use crate::feature::Descriptor;
use crate::vocabulary::VocabularyError;
use crate::vocabulary::format::Link;

/// A grown tree as the file has it, node 0 its root.
pub(super) struct Tree {
    pub(super) centres: Vec<[u8; 32]>,
    pub(super) links: Vec<Link>,
    pub(super) words: u32,
}

/// The children of a node; none of a leaf.
#[derive(Default)]
struct Branch(Vec<([u8; 32], Branch)>);

/// Grows a tree from `sample`, which is not empty.
///
/// # Errors
/// If `watcher` ends it.
pub(super) fn grow(
    mut sample: Vec<Descriptor>,
    options: &TrainingOptions,
    watcher: &dyn TrainingWatcher,
) -> Result<Tree, VocabularyError> {
    let growth = Growth {
        branching: options.branching as usize,
        depth: options.depth,
        done: AtomicU64::new(0),
        total: sample.len() as u64 * u64::from(options.depth),
        watcher,
    };
    let root = growth.branch(&mut sample, 0, options.seed);
    if watcher.goes_on() { Ok(flatten(root)) } else { Err(VocabularyError::Interrupted) }
}

struct Growth<'a> {
    branching: usize,
    depth: u32,
    done: AtomicU64,
    total: u64,
    watcher: &'a dyn TrainingWatcher,
}

impl Growth<'_> {
    /// The subtree of a node at `level` with the descriptors in `run`; `stream` is its random stream. Cut short where
    /// the watcher ends it.
    fn branch(&self, run: &mut [Descriptor], level: u32, stream: u64) -> Branch {
        if level == self.depth || (run.len() < 2 && level > 0) || !self.watcher.goes_on() {
            self.settled(run.len() as u64 * u64::from(self.depth - level));
            return Branch::default();
        }
        let clusters = split(run, self.branching, &mut Pcg64::seed_from_u64(stream), self.watcher);
        if clusters.len() == 1 && level > 0 {
            self.settled(run.len() as u64 * u64::from(self.depth - level));
            return Branch::default();
        }
        self.settled(run.len() as u64);
        let mut rest = run;
        let mut parts = Vec::with_capacity(clusters.len());
        for (index, cluster) in (1..).zip(&clusters) {
            let (part, behind) = rest.split_at_mut(cluster.size);
            parts.push((part, child_stream(stream, index)));
            rest = behind;
        }
        let branches = parts.into_par_iter().map(|(part, stream)| self.branch(part, level + 1, stream));
        let branches: Vec<Branch> = branches.collect();
        Branch(clusters.iter().map(|cluster| cluster.centre).zip(branches).collect())
    }

    fn settled(&self, descriptors: u64) {
        let done = self.done.fetch_add(descriptors, Ordering::Relaxed) + descriptors;
        self.watcher.note(TrainingProgress::Growing { done, total: self.total });
    }
}

/// A stream for the `index`th child that no other node has: SplitMix64's mixing of both.
fn child_stream(stream: u64, index: u64) -> u64 {
    let mixed = stream.wrapping_add(index.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ mixed >> 31
}

/// Nodes level by level, words in their order.
fn flatten(root: Branch) -> Tree {
    let mut tree = Tree { centres: vec![[0; 32]], links: Vec::new(), words: 0 };
    let mut queue = VecDeque::from([root]);
    while let Some(Branch(children)) = queue.pop_front() {
        if children.is_empty() {
            tree.links.push(Link::Word(tree.words));
            tree.words += 1;
            continue;
        }
        let first = tree.centres.len() as u32;
        tree.links.push(Link::Children { first, children: children.len() as u32 });
        for (centre, branch) in children {
            tree.centres.push(centre);
            queue.push_back(branch);
        }
    }
    tree
}
