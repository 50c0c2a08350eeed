//! Blocks made of new images, and of other blocks.

use std::collections::BTreeMap;

use super::block::{Block, BlockBuilder, BlockImage, Postings};
use crate::vocabulary::WordId;

/// That an image of a block shows a word.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NewPosting {
    pub(super) word: WordId,
    /// Place of the image in the block.
    pub(super) image: u16,
    pub(super) repetitions: u16,
}

/// The words that count as others from now on: under each of those, which ones.
pub(super) type Renames = BTreeMap<WordId, Vec<WordId>>;

/// That an image is in no block any more.
const GONE: u16 = u16::MAX;

/// The postings of one word, while they are put together.
#[derive(Default)]
struct Draft {
    once: Vec<u16>,
    repeated: Vec<[u16; 2]>,
}

impl Draft {
    fn add(&mut self, image: u16, repetitions: u16) {
        match repetitions {
            1 => self.once.push(image),
            _ => self.repeated.push([image, repetitions]),
        }
    }

    /// Adds the images of a block, which `moved` gives new places.
    fn append(&mut self, postings: Postings<'_>, moved: &Moved) {
        match moved {
            Moved::By(first) => {
                self.once.extend(postings.once.iter().map(|image| image + first));
                self.repeated.extend(postings.repeated.iter().map(|&[image, times]| [image + first, times]));
            }
            Moved::To(places) => {
                // Postings that are mapped may have changed since they were checked.
                let place = |image: u16| places.get(usize::from(image)).copied().unwrap_or(GONE);
                let is_there = |image: u16| place(image) != GONE;
                let once = postings.once.iter().filter(|&&image| is_there(image));
                self.once.extend(once.map(|&image| place(image)));
                let repeated = postings.repeated.iter().filter(|[image, _]| is_there(*image));
                self.repeated.extend(repeated.map(|&[image, times]| [place(image), times]));
            }
        }
    }

    /// Brings what several words had into order, and adds up what they had of the same image.
    fn unite(&mut self) {
        let mut all: Vec<[u16; 2]> = self.once.drain(..).map(|image| [image, 1]).collect();
        all.append(&mut self.repeated);
        all.sort_unstable();
        for run in all.chunk_by(|one, next| one[0] == next[0]) {
            let times = run.iter().fold(0_u16, |sum, [_, times]| sum.saturating_add(*times));
            self.add(run[0][0], times);
        }
    }

    /// Adds what there is to `block` as the postings of `word`, and begins anew.
    fn finish(&mut self, word: WordId, block: &mut BlockBuilder) {
        if !self.once.is_empty() || !self.repeated.is_empty() {
            block.push(word, Postings { once: &self.once, repeated: &self.repeated });
        }
        self.once.clear();
        self.repeated.clear();
    }
}

/// Where the images of a block are in a new one.
enum Moved {
    /// All behind so many others.
    By(u16),
    /// Each there, or [`GONE`].
    To(Vec<u16>),
}

/// A block of new images with these postings, sorted by word and image.
pub(super) fn of_images(images: Vec<BlockImage>, postings: &[NewPosting]) -> Block {
    let mut block = BlockBuilder::new(images);
    let mut draft = Draft::default();
    for run in postings.chunk_by(|one, next| one.word == next.word) {
        run.iter().for_each(|posting| draft.add(posting.image, posting.repetitions));
        draft.finish(run[0].word, &mut block);
    }
    block.finish()
}

/// One block of the images of `blocks` that are `wanted`, in their order, with some words renamed.
pub(super) fn merged(blocks: &[Block], wanted: impl Fn(u32) -> bool, renames: &Renames) -> Block {
    let mut images = Vec::new();
    let moves: Vec<Moved> = blocks.iter().map(|block| moved(block, &wanted, &mut images)).collect();
    let mut merged = BlockBuilder::new(images);
    let mut draft = Draft::default();
    let mut finders: Vec<_> = blocks.iter().map(Block::finder).collect();
    for word in words(blocks, renames) {
        for (finder, moved) in finders.iter_mut().zip(&moves) {
            draft.append(finder.postings(word), moved);
        }
        if let Some(others) = renames.get(&word) {
            for &other in others {
                for (block, moved) in blocks.iter().zip(&moves) {
                    draft.append(block.postings_of(other), moved);
                }
            }
            draft.unite();
        }
        draft.finish(word, &mut merged);
    }
    merged.finish()
}

/// Adds the wanted images of `block` to `images`; answers where they are now.
fn moved(block: &Block, wanted: impl Fn(u32) -> bool, images: &mut Vec<BlockImage>) -> Moved {
    let first = images.len();
    if block.images().iter().all(|image| wanted(image.document)) {
        images.extend_from_slice(block.images());
        return Moved::By(first as u16);
    }
    let place = |image: &BlockImage| {
        if !wanted(image.document) {
            return GONE;
        }
        images.push(*image);
        images.len() as u16 - 1
    };
    Moved::To(block.images().iter().map(place).collect())
}

/// The words of all blocks after some were renamed, in rising order.
fn words(blocks: &[Block], renames: &Renames) -> Vec<WordId> {
    let mut words: Vec<WordId> =
        blocks.iter().flat_map(Block::words).chain(renames.keys().copied()).collect();
    // Made of few runs that are in order already.
    words.sort();
    words.dedup();
    let mut gone: Vec<WordId> = renames.values().flatten().copied().collect();
    gone.sort_unstable();
    words.retain(|word| gone.binary_search(word).is_err());
    words
}
