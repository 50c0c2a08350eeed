//! Vocabulary files of version 1, which had longer links and f32 weights: rewritten in memory when opened.
//!
//! | Offset | Bytes | Field |
//! |---|---|---|
//! | 32 | 4 × 5 | branching, depth, nodes n, words w, training images |
//! | 52 | 12 | zero |
//! | 64 | 32 n | descriptors of the nodes |
//! | 64 + 32 n | 8 n | links: first child (u32), children (u32); a leaf has its word and 0 |
//! | 64 + 40 n | 4 w | weights, f32 |

use super::Weighting;
use super::format::{self, COUNTS_BYTES, Counts, Link, MAX_BRANCHING, MAX_NODES};

/// The file of the present version with the tree of `body`, that of a version 1 file. An error is a reason.
pub(super) fn rewritten(body: &[u8]) -> Result<Vec<u8>, String> {
    let (head, rest) = body.split_first_chunk::<COUNTS_BYTES>().ok_or("the counts are missing")?;
    let fields = head.as_chunks::<4>().0;
    let field = |index: usize| u32::from_le_bytes(fields[index]);
    let counts = Counts {
        branching: field(0),
        depth: field(1),
        nodes: field(2),
        words: field(3),
        images: field(4),
        weighting: Weighting::TfIdf,
        luminance: None,
    };
    if u64::from(counts.nodes) * 40 + u64::from(counts.words) * 4 != rest.len() as u64 {
        return Err(format!("{} nodes and {} words do not fill its length", counts.nodes, counts.words));
    }
    if counts.nodes > MAX_NODES {
        return Err(format!("it has {} nodes, and at most {MAX_NODES} are read", counts.nodes));
    }
    let (descriptors, rest) = rest.split_at(counts.nodes as usize * 32);
    let (links, weights) = rest.split_at(counts.nodes as usize * 8);
    let links = links.as_chunks::<4>().0.as_chunks::<2>().0;
    let links: Result<Vec<Link>, String> = (0..).zip(links).map(|(node, pair)| link(node, *pair)).collect();
    let weights = weights.as_chunks().0.iter().map(|&bytes| f64::from(f32::from_le_bytes(bytes)));
    Ok(format::encode(&counts, descriptors.as_chunks().0, &links?, &weights.collect::<Vec<f64>>()))
}

fn link(node: u32, pair: [[u8; 4]; 2]) -> Result<Link, String> {
    let [first, children] = pair.map(u32::from_le_bytes);
    match children {
        0 if first < 1 << 31 => Ok(Link::Word(first)),
        1..=MAX_BRANCHING if first < MAX_NODES => Ok(Link::Children { first, children }),
        _ => Err(format!("node {node} points outside the tree")),
    }
}
