//! A tree as another library stores it, and how it becomes ours.

use super::Fault;
use crate::vocabulary::Weighting;
use crate::vocabulary::format::{self, Counts, Link, MAX_BRANCHING, MAX_DEPTH, MAX_NODES};

/// A node below the root.
#[derive(Debug)]
pub(super) struct ForeignNode {
    /// Its number, from 1; the root is 0.
    pub(super) id: u32,
    pub(super) parent: u32,
    pub(super) descriptor: [u8; 32],
    pub(super) weight: f64,
}

/// A tree as a file has it.
///
/// Its branching and depth are those of the nodes that are there: what the file's head says is only a plan.
#[derive(Debug)]
pub(super) struct ForeignTree {
    pub(super) weighting: Weighting,
    /// In the order of the file, which is that of the children of a node.
    pub(super) nodes: Vec<ForeignNode>,
    /// The word of a node, and the node.
    pub(super) words: Vec<(u32, u32)>,
}

/// What the parameters at the head of a file are in DBoW2's family.
pub(super) struct Parameters {
    pub(super) branching: i64,
    pub(super) depth: i64,
    pub(super) scoring: i64,
    pub(super) weighting: i64,
}

impl Parameters {
    /// A tree without nodes; an error says which parameter makes no sense.
    pub(super) fn tree(&self) -> Result<ForeignTree, String> {
        let within = |name: &str, value: i64, most: u32| {
            let is_within = (1..=i64::from(most)).contains(&value);
            if is_within { Ok(()) } else { Err(format!("{name} is {value}, expected 1 to {most}")) }
        };
        let weighting = u32::try_from(self.weighting).ok().and_then(Weighting::from_number);
        if !(0..=5).contains(&self.scoring) {
            return Err(format!("there is no scoring {}", self.scoring));
        }
        within("the branching", self.branching, MAX_BRANCHING)?;
        within("the depth", self.depth, MAX_DEPTH)?;
        let weighting = weighting.ok_or_else(|| format!("there is no weighting {}", self.weighting))?;
        Ok(ForeignTree { weighting, nodes: Vec::new(), words: Vec::new() })
    }
}

impl ForeignTree {
    /// Adds a node; an error if there are more than can be kept.
    pub(super) fn push(&mut self, node: ForeignNode) -> Result<(), String> {
        if self.nodes.len() as u32 >= MAX_NODES - 1 {
            return Err(format!("it has more than {MAX_NODES} nodes"));
        }
        self.nodes.push(node);
        Ok(())
    }

    /// The bytes of the vocabulary file with this tree: nodes level by level, the children of a node in the
    /// order of the file, words with the numbers they had.
    pub(super) fn into_file(self) -> Result<Vec<u8>, Fault> {
        let children = Children::of(&self.nodes)?;
        let words = self.words_of_nodes(&children)?;
        let nodes = self.nodes.len() + 1;
        let mut order = Vec::with_capacity(nodes);
        order.push(0);
        let mut levels = vec![0_u32];
        let mut links = Vec::with_capacity(nodes);
        let mut weights = vec![0.0; self.words.len()];
        let mut descriptors = vec![[0; 32]];
        let mut branching = 0;
        for next in 0..nodes {
            let Some(&id) = order.get(next) else {
                return Err(Fault::in_tree("some of its nodes hang together in a circle"));
            };
            let run = children.of_node(id);
            if run.is_empty() {
                let word = words[id as usize];
                links.push(Link::Word(word));
                weights[word as usize] = self.nodes[children.position[id as usize] as usize].weight;
                continue;
            }
            let level = levels[next] + 1;
            branching = branching.max(run.len() as u32);
            if branching > MAX_BRANCHING {
                return Err(Fault::in_tree(format!("node {id} has more than {MAX_BRANCHING} children")));
            }
            if level > MAX_DEPTH {
                return Err(Fault::in_tree(format!("node {id} lies deeper than {MAX_DEPTH} levels")));
            }
            links.push(Link::Children { first: order.len() as u32, children: run.len() as u32 });
            for &position in run {
                let node = &self.nodes[position as usize];
                order.push(node.id);
                levels.push(level);
                descriptors.push(node.descriptor);
            }
        }
        let counts = Counts {
            branching,
            // Level by level, the last node is one of the deepest.
            depth: levels.last().copied().unwrap_or(0),
            nodes: nodes as u32,
            words: weights.len() as u32,
            images: 0,
            weighting: self.weighting,
            luminance: None,
        };
        Ok(format::encode(&counts, &descriptors, &links, &weights))
    }

    /// The word of every node by its number; every leaf has one and no inner node has.
    fn words_of_nodes(&self, children: &Children) -> Result<Vec<u32>, Fault> {
        const NONE: u32 = u32::MAX;
        let mut words = vec![NONE; self.nodes.len() + 1];
        let mut is_taken = vec![false; self.words.len()];
        for &(word, node) in &self.words {
            let is_new = is_taken.get_mut(word as usize).is_some_and(|taken| !std::mem::replace(taken, true));
            let is_leaf = (node as usize) < words.len() && node > 0 && children.of_node(node).is_empty();
            if !is_new || !is_leaf || words[node as usize] != NONE {
                return Err(Fault::in_tree(format!("word {word} of node {node} does not fit the tree")));
            }
            words[node as usize] = word;
        }
        let bare = (1..words.len() as u32)
            .find(|&node| words[node as usize] == NONE && children.of_node(node).is_empty());
        match bare {
            Some(node) => Err(Fault::in_tree(format!("leaf {node} has no word"))),
            None if children.of_node(0).is_empty() => Err(Fault::in_tree("nothing hangs from its root")),
            None => Ok(words),
        }
    }
}

/// The children of every node, as positions in the file.
struct Children {
    /// Position in the file of the node with each number.
    position: Vec<u32>,
    /// Positions, those of one parent side by side.
    by_parent: Vec<u32>,
    /// Where those of each parent begin.
    starts: Vec<u32>,
}

impl Children {
    /// Sorts `nodes`, which must be numbered from 1 without a gap, by their parents.
    fn of(nodes: &[ForeignNode]) -> Result<Self, Fault> {
        let numbers = nodes.len() + 1;
        let mut position = vec![u32::MAX; numbers];
        let mut starts = vec![0; numbers + 1];
        for (index, node) in (0..).zip(nodes) {
            let place = position.get_mut(node.id as usize).filter(|place| **place == u32::MAX && node.id > 0);
            let (Some(place), true) = (place, (node.parent as usize) < numbers) else {
                let reason = format!("node {} below {} does not fit {numbers} nodes", node.id, node.parent);
                return Err(Fault::in_tree(reason));
            };
            *place = index;
            starts[node.parent as usize + 1] += 1;
        }
        for parent in 0..numbers {
            starts[parent + 1] += starts[parent];
        }
        let mut next = starts.clone();
        let mut by_parent = vec![0; nodes.len()];
        for (index, node) in (0..).zip(nodes) {
            let slot = &mut next[node.parent as usize];
            by_parent[*slot as usize] = index;
            *slot += 1;
        }
        Ok(Self { position, by_parent, starts })
    }

    fn of_node(&self, id: u32) -> &[u32] {
        let id = id as usize;
        &self.by_parent[self.starts[id] as usize..self.starts[id + 1] as usize]
    }
}
