//! DBoW3's binary file, uncompressed. All numbers little-endian:
//!
//! | Offset | Bytes | Field |
//! |---|---|---|
//! | 0 | 8 | magic 88877711233 |
//! | 8 | 1 | whether QuickLZ compressed the rest |
//! | 9 | 4 | nodes, the root included |
//! | 13 | 16 | branching, depth, scoring, weighting |
//! | 29 | 60 each | nodes but the root |
//! | then | 4 | words |
//! | then | 8 each | number of the word, number of its node |
//!
//! A node is its number, its parent, its weight (f64), columns, rows and type of its descriptor, and its 32 bytes.

use super::Fault;
use super::foreign_tree::{ForeignNode, ForeignTree, Parameters};

pub(super) const MAGIC: u64 = 88_877_711_233;

const NODES_OFFSET: usize = 29;
const NODE_BYTES: usize = 60;

pub(super) fn read(file: &[u8]) -> Result<ForeignTree, Fault> {
    let short = || Fault::at_byte(file.len(), "it ends within its head");
    let (&head, rest) = file.split_first_chunk::<NODES_OFFSET>().ok_or_else(short)?;
    if head[8] != 0 {
        let reason = "compressed files are not read; save it again with DBoW3, uncompressed";
        return Err(Fault::at_byte(8, reason));
    }
    let parameters = Parameters {
        branching: i64::from(i32_at(&head, 13)),
        depth: i64::from(i32_at(&head, 17)),
        scoring: i64::from(i32_at(&head, 21)),
        weighting: i64::from(i32_at(&head, 25)),
    };
    let mut tree = parameters.tree().map_err(|reason| Fault::at_byte(13, reason))?;
    let nodes = (u32_at(&head, 9) as usize).saturating_sub(1);
    let Some((nodes, rest)) = nodes.checked_mul(NODE_BYTES).and_then(|bytes| rest.split_at_checked(bytes))
    else {
        return Err(Fault::at_byte(9, format!("it is too short for {nodes} nodes")));
    };
    for (index, bytes) in nodes.as_chunks::<NODE_BYTES>().0.iter().enumerate() {
        let fault = |reason| Fault::at_byte(NODES_OFFSET + index * NODE_BYTES, reason);
        tree.push(node(bytes).map_err(fault)?).map_err(fault)?;
    }
    let words_offset = NODES_OFFSET + nodes.len();
    let Some((count, words)) = rest.split_first_chunk::<4>() else {
        return Err(Fault::at_byte(words_offset, "its words are missing"));
    };
    let words = words.as_chunks::<8>();
    if words.0.len() != u32::from_le_bytes(*count) as usize || !words.1.is_empty() {
        let reason = format!("{} words do not fill the rest of it", u32::from_le_bytes(*count));
        return Err(Fault::at_byte(words_offset, reason));
    }
    tree.words = words.0.iter().map(|pair| (u32_at(pair, 0), u32_at(pair, 4))).collect();
    Ok(tree)
}

fn node(bytes: &[u8; NODE_BYTES]) -> Result<ForeignNode, String> {
    let [columns, rows, kind] = [16, 20, 24].map(|offset| u32_at(bytes, offset));
    if (columns, rows, kind) != (32, 1, 0) {
        return Err(format!("a descriptor of {rows} × {columns} of type {kind}, expected 1 × 32 bytes"));
    }
    Ok(ForeignNode {
        id: u32_at(bytes, 0),
        parent: u32_at(bytes, 4),
        weight: f64::from_le_bytes(std::array::from_fn(|index| bytes[8 + index])),
        descriptor: std::array::from_fn(|index| bytes[28 + index]),
    })
}

fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|index| bytes[offset + index]))
}

fn i32_at(bytes: &[u8], offset: usize) -> i32 {
    i32::from_le_bytes(std::array::from_fn(|index| bytes[offset + index]))
}
