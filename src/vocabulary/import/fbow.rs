//! FBoW's file: a head of 128 bytes, then one block of equal length for the children of each inner node.
//! All numbers little-endian:
//!
//! | Offset | Bytes | Field |
//! |---|---|---|
//! | 0 | 8 | magic 55824124 |
//! | 8 | 50 | name of the descriptors |
//! | 64 | 4 | blocks |
//! | 72, 80 | 8, 8 | bytes from a descriptor to the next; bytes of a block |
//! | 88, 96 | 8, 8 | where in a block its descriptors, and its links, begin |
//! | 104 | 8 | bytes of all blocks |
//! | 112, 116, 120 | 4 each | type of the descriptors (OpenCV's), bytes of one, branching |
//!
//! A block begins with its number of children (u16). A link is the number of the child's block (u32), or of
//! its word with the highest bit set, and a weight (f32). What FBoW trains itself weighs one.
//!
//! FBoW's converter of ORB-SLAM's text reads past its end and adds a node too many to the last block. The
//! descriptor of that phantom lies over the first links of the block: those words are found again as the
//! ones that no other link names, their weights are lost.

use std::collections::VecDeque;

use super::Fault;
use super::foreign_tree::{ForeignNode, ForeignTree};
use crate::vocabulary::Weighting;
use crate::vocabulary::format::{MAX_BRANCHING, MAX_DEPTH};

pub(super) const MAGIC: u64 = 55_824_124;

const HEAD_BYTES: usize = 128;
const LINK_BYTES: usize = 8;
const WORD: u32 = 1 << 31;
/// Links that the descriptor of a phantom node lies over.
const LOST_LINKS: usize = 32 / LINK_BYTES;

/// Where things stand in a block, in bytes.
struct Layout {
    branching: usize,
    block_bytes: usize,
    descriptor_stride: usize,
    descriptors_at: usize,
    links_at: usize,
}

impl Layout {
    fn read(head: &[u8; HEAD_BYTES], blocks_bytes: usize) -> Result<Self, Fault> {
        let size = |offset: usize| usize::try_from(u64_at(head, offset)).unwrap_or(usize::MAX);
        let (kind, descriptor_bytes, branching) = (u32_at(head, 112), u32_at(head, 116), u32_at(head, 120));
        if (kind, descriptor_bytes) != (0, 32) {
            let reason =
                format!("descriptors of type {kind} with {descriptor_bytes} bytes, expected 32 bytes");
            return Err(Fault::at_byte(112, reason));
        }
        if !(1..=MAX_BRANCHING).contains(&branching) {
            let reason = format!("the branching is {branching}, expected 1 to {MAX_BRANCHING}");
            return Err(Fault::at_byte(120, reason));
        }
        let branching = branching as usize;
        let layout = Self {
            branching,
            block_bytes: size(80),
            descriptor_stride: size(72),
            descriptors_at: size(88),
            links_at: size(96),
        };
        let table = |start: usize, stride: usize| start.checked_add(branching.checked_mul(stride)?);
        let fits = layout.descriptor_stride >= 32
            && layout.descriptors_at >= 2
            && table(layout.descriptors_at, layout.descriptor_stride)
                .is_some_and(|end| end <= layout.links_at)
            && table(layout.links_at, LINK_BYTES).is_some_and(|end| end <= layout.block_bytes);
        let blocks = u32_at(head, 64) as usize;
        if !fits || blocks.checked_mul(layout.block_bytes) != Some(blocks_bytes) || blocks == 0 {
            return Err(Fault::at_byte(64, format!("{blocks} blocks so long do not fill it")));
        }
        Ok(layout)
    }
}

pub(super) fn read(file: &[u8]) -> Result<ForeignTree, Fault> {
    let short = || Fault::at_byte(file.len(), "it ends within its head");
    let (head, blocks) = file.split_first_chunk::<HEAD_BYTES>().ok_or_else(short)?;
    let layout = Layout::read(head, blocks.len())?;
    let mut tree = ForeignTree { weighting: Weighting::TfIdf, nodes: Vec::new(), words: Vec::new() };
    let blocks: Vec<&[u8]> = blocks.chunks_exact(layout.block_bytes).collect();
    let mut is_read = vec![false; blocks.len()];
    let mut wordless = Vec::new();
    // Block, the node whose children it holds, and their level.
    let mut queue = VecDeque::from([(0, 0, 1)]);
    while let Some((block, parent, level)) = queue.pop_front() {
        let fault = |reason: String| Fault::at_byte(HEAD_BYTES + block * layout.block_bytes, reason);
        if level > MAX_DEPTH || std::mem::replace(&mut is_read[block], true) {
            return Err(fault("its blocks hang together in a circle, or too deep".to_owned()));
        }
        let may_have_phantom = block + 1 == blocks.len();
        for Child { link, descriptor, weight } in
            children(blocks[block], &layout, may_have_phantom).map_err(fault)?
        {
            let id = tree.nodes.len() as u32 + 1;
            match link {
                None => wordless.push(id),
                Some(link) if link & WORD != 0 => tree.words.push((link & !WORD, id)),
                Some(link) if (link as usize) < blocks.len() => {
                    queue.push_back((link as usize, id, level + 1));
                }
                Some(link) => return Err(fault(format!("there is no block {link}"))),
            }
            tree.push(ForeignNode { id, parent, descriptor, weight }).map_err(fault)?;
        }
    }
    give_words_back(&mut tree, wordless);
    Ok(tree)
}

/// A child in a block; one whose link is lost has no weight either.
struct Child {
    link: Option<u32>,
    descriptor: [u8; 32],
    weight: f64,
}

fn children(
    block: &[u8],
    layout: &Layout,
    may_have_phantom: bool,
) -> Result<impl Iterator<Item = Child>, String> {
    let count = usize::from(u16::from_le_bytes([block[0], block[1]]));
    let has_phantom = may_have_phantom && count == layout.branching + 1;
    if !has_phantom && !(1..=layout.branching).contains(&count) {
        return Err(format!("a block of {count} children, expected 1 to {}", layout.branching));
    }
    let child = move |index: usize| {
        let descriptor = &block[layout.descriptors_at + index * layout.descriptor_stride..];
        let descriptor = std::array::from_fn(|byte| descriptor[byte]);
        if has_phantom && index < LOST_LINKS {
            return Child { link: None, descriptor, weight: 0.0 };
        }
        let link = &block[layout.links_at + index * LINK_BYTES..];
        Child { link: Some(u32_at(link, 0)), descriptor, weight: f64::from(f32::from_bits(u32_at(link, 4))) }
    };
    Ok((0..count - usize::from(has_phantom)).map(child))
}

/// Gives each of the `wordless` leaves the next word that no other leaf has.
fn give_words_back(tree: &mut ForeignTree, wordless: Vec<u32>) {
    let mut is_taken = vec![false; tree.words.len() + wordless.len()];
    for &(word, _) in &tree.words {
        if let Some(taken) = is_taken.get_mut(word as usize) {
            *taken = true;
        }
    }
    let free = (0..).zip(is_taken).filter(|&(_, taken)| !taken).map(|(word, _)| word);
    tree.words.extend(free.zip(wordless));
}

fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|index| bytes[offset + index]))
}

fn u64_at(bytes: &[u8], offset: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|index| bytes[offset + index]))
}
