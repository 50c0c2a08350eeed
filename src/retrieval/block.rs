//! A block of images: their postings side by side, word by word, so many that the nearest caches hold their scores.
//!
//! A posting is the image's place in the block, in 16 bits, and nothing else where the image shows the word once. A
//! word weighs the same in every image, so what two images share of it is known but for their lengths: those are
//! multiplied in once an image and not once a posting.

use super::bow::WeighedWord;
use super::numbers::Numbers;
use super::query::Query;
use crate::kernel;
use crate::vocabulary::WordId;

/// Most images of a block.
pub(super) const MOST_IMAGES: usize = if cfg!(test) { 64 } else { 1 << 14 };

/// A number for each image of a block.
pub(super) type Sums = [f32; MOST_IMAGES];

/// Words that a page tells of.
const PAGE_WORDS: u32 = u64::BITS;
/// Words whose postings are asked of memory ahead of time, and how much of each: what is longer is read in a row.
const AHEAD: usize = 12;
const MOST_AHEAD_BYTES: usize = 1024;

/// Images and the words that they show.
#[derive(Debug, Default)]
pub(super) struct Block {
    images: Vec<BlockImage>,
    /// Those of which some word is shown, in rising order.
    pages: Vec<Page>,
    /// One for every word that is shown, in rising order, and one where the last one ends.
    lists: Vec<List>,
    postings: Numbers,
}

/// An image of a block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BlockImage {
    pub(super) document: u32,
    /// 1 / L1 length of its words; 0 where it shows none.
    pub(super) inverse_length: f32,
}

/// Which of 64 words in a row are shown.
#[derive(Clone, Copy, Debug)]
pub(super) struct Page {
    /// The first of the words, divided by 64.
    pub(super) number: u32,
    /// Position of the list of the first of them that is shown.
    pub(super) first_list: u32,
    /// A bit a word.
    pub(super) shown: u64,
}

/// Where the postings of a word begin.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct List {
    pub(super) once: u32,
    pub(super) repeated: u32,
}

/// Where the postings of a word are; all zero where no image shows it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Span {
    once: u32,
    repeated: u32,
    end: u32,
}

/// The images that show a word, in rising order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Postings<'a> {
    /// Places in the block of those that show it once.
    pub(super) once: &'a [u16],
    /// Those of the others, each with how often they show it.
    pub(super) repeated: &'a [[u16; 2]],
}

impl Postings<'_> {
    pub(super) fn is_empty(&self) -> bool {
        self.once.is_empty() && self.repeated.is_empty()
    }
}

/// A block while the postings of its images are added, word by word.
pub(super) struct BlockBuilder {
    block: Block,
    postings: Vec<u16>,
}

impl BlockBuilder {
    /// Begins a block of these images.
    pub(super) fn new(images: Vec<BlockImage>) -> Self {
        let block = Block { images, lists: vec![List::default()], ..Block::default() };
        Self { block, postings: Vec::new() }
    }

    /// Adds the postings of a word, a higher one than those before.
    pub(super) fn push(&mut self, word: WordId, postings: Postings<'_>) {
        let Block { pages, lists, .. } = &mut self.block;
        let (number, bit) = (word.0 / PAGE_WORDS, 1 << (word.0 % PAGE_WORDS));
        let first_list = lists.len() as u32 - 1;
        match pages.last_mut().filter(|page| page.number == number) {
            Some(page) => page.shown |= bit,
            None => pages.push(Page { number, first_list, shown: bit }),
        }
        self.postings.extend_from_slice(postings.once);
        lists[first_list as usize].repeated = self.postings.len() as u32;
        self.postings.extend_from_slice(postings.repeated.as_flattened());
        lists.push(List { once: self.postings.len() as u32, repeated: 0 });
    }

    /// The block, with no memory in reserve.
    pub(super) fn finish(self) -> Block {
        let Self { mut block, mut postings } = self;
        block.pages.shrink_to_fit();
        block.lists.shrink_to_fit();
        postings.shrink_to_fit();
        Block { postings: Numbers::Owned(postings), ..block }
    }
}

impl Block {
    /// In the order of adding.
    pub(super) fn images(&self) -> &[BlockImage] {
        &self.images
    }

    /// What it is made of besides its images: pages, lists, and the bytes of the postings.
    pub(super) fn contents(&self) -> (&[Page], &[List], &[u8]) {
        (&self.pages, &self.lists, bytemuck::cast_slice(&self.postings))
    }

    /// The block of these images that had such [contents](Self::contents); `None` if none has.
    pub(super) fn restored(
        images: Vec<BlockImage>,
        pages: Vec<Page>,
        lists: Vec<List>,
        postings: Numbers,
    ) -> Option<Self> {
        let block = Self { images, pages, lists, postings };
        block.is_sound().then_some(block)
    }

    /// Whether no question can lead beyond what is there.
    fn is_sound(&self) -> bool {
        let Some((last, lists)) = self.lists.split_last() else { return false };
        let mut next_list = 0;
        let are_pages_sound = self.pages.iter().enumerate().all(|(index, page)| {
            let is_in_turn = self.pages[..index].last().is_none_or(|before| before.number < page.number);
            let is_first = page.first_list as usize == next_list;
            next_list += page.shown.count_ones() as usize;
            is_in_turn && is_first && page.number <= u32::MAX / PAGE_WORDS
        });
        let is_there = |image: &u16| usize::from(*image) < self.images.len();
        let is_list_sound = |(list, next): (&List, &List)| {
            let once = self.postings.get(list.once as usize..list.repeated as usize);
            let repeated = self.postings.get(list.repeated as usize..next.once as usize);
            let (Some(once), Some((pairs, []))) = (once, repeated.map(<[u16]>::as_chunks::<2>)) else {
                return false;
            };
            once.iter().all(is_there) && pairs.iter().all(|[image, _]| is_there(image))
        };
        (1..=MOST_IMAGES).contains(&self.images.len())
            && are_pages_sound
            && next_list == lists.len()
            && last.once as usize == self.postings.len()
            && lists.iter().zip(&self.lists[1..]).all(is_list_sound)
    }

    /// Number of postings.
    pub(super) fn postings_count(&self) -> usize {
        let pairs = self.lists.windows(2).map(|lists| (lists[1].once - lists[0].repeated) as usize / 2);
        self.postings.len() - pairs.sum::<usize>()
    }

    /// Length of all lists together, in numbers of 16 bits.
    pub(super) fn postings_len(&self) -> usize {
        self.postings.len()
    }

    /// Bytes of memory that it takes, those that are mapped among them.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(self.images.as_slice())
            + size_of_val(self.pages.as_slice())
            + size_of_val(self.lists.as_slice())
            + size_of_val(&*self.postings)
    }

    /// The words that some image shows, in rising order.
    pub(super) fn words(&self) -> impl Iterator<Item = WordId> {
        let of_page = |page: &Page| {
            let Page { number, shown, .. } = *page;
            (0..PAGE_WORDS).filter(move |bit| shown >> bit & 1 == 1).map(move |bit| number * PAGE_WORDS + bit)
        };
        self.pages.iter().flat_map(of_page).map(WordId)
    }

    /// Finds words in rising order.
    pub(super) fn finder(&self) -> Finder<'_> {
        Finder { block: self, page: 0 }
    }

    /// The postings of `word`; none if no image shows it.
    pub(super) fn postings_of(&self, word: WordId) -> Postings<'_> {
        let page = self.pages.partition_point(|page| page.number < word.0 / PAGE_WORDS);
        Finder { block: self, page }.postings(word)
    }

    /// Where the postings of the list at this position are.
    #[inline]
    pub(super) fn span(&self, list: u32) -> Span {
        let [List { once, repeated }, next] = [0, 1].map(|after| self.lists[list as usize + after]);
        Span { once, repeated, end: next.once }
    }

    #[inline]
    fn postings(&self, Span { once, repeated, end }: Span) -> Postings<'_> {
        Postings {
            once: &self.postings[once as usize..repeated as usize],
            repeated: self.postings[repeated as usize..end as usize].as_chunks().0,
        }
    }

    /// Scores every image against `query`: fills in what of `sums` it has images for, all zero before. It may answer
    /// false and leave them zero if none of the images scores above `least`.
    pub(super) fn score(&self, query: &mut Query, least: f32, sums: &mut Sums) -> bool {
        query.look_up(self);
        // What is left for the more frequent words can lift a score by half of what is needed: is one that high?
        let split = query.split(least / 2.0);
        let (rare, frequent) = (0..split, split..query.len());
        rare.for_each(|position| self.add(query, position, sums));
        let left = query.left(split);
        // Sums of the same numbers differ by that much at most when they are added up in another order.
        let rounding = 2.0 * f32::EPSILON * query.len() as f32;
        if !frequent.is_empty() && (self.best(query, sums) + left) * (1.0 + rounding) < least {
            sums[..self.images.len()].fill(0.0);
            return false;
        }
        frequent.for_each(|position| self.add(query, position, sums));
        for (sum, image) in sums.iter_mut().zip(&self.images) {
            *sum = (*sum * image.inverse_length.min(query.inverse_length)).min(1.0);
        }
        true
    }

    fn best(&self, query: &Query, sums: &Sums) -> f32 {
        let scores = sums.iter().zip(&self.images);
        scores.fold(0.0, |best, (sum, image)| best.max(sum * image.inverse_length.min(query.inverse_length)))
    }

    /// Adds to the sum of every image that shows the query's word at `position`, the rarest first, what both show of
    /// it, by the shorter of their inverse lengths: Σ min(v, w) of the normalised vectors, once multiplied by that.
    #[inline]
    fn add(&self, query: &Query, position: usize, sums: &mut Sums) {
        if position + AHEAD < query.len() {
            let Span { once, end, .. } = query.word(position + AHEAD).1;
            kernel::prefetch(&self.postings[once as usize..end as usize], MOST_AHEAD_BYTES);
        }
        let (WeighedWord { weight, repetitions, .. }, span) = query.word(position);
        let Postings { once, repeated } = self.postings(span);
        let shared = |image: u16, times: u16| {
            // Postings that are mapped may have changed since they were checked.
            let known = self.images.get(usize::from(image)).map_or(0.0, |image| image.inverse_length);
            let asked = query.inverse_length;
            let shorter = asked.min(known);
            if shorter == 0.0 {
                return 0.0;
            }
            weight * (f32::from(repetitions) * asked).min(f32::from(times) * known) / shorter
        };
        if repetitions == 1 {
            for &image in once {
                sums[usize::from(image) % MOST_IMAGES] += weight;
            }
        } else {
            once.iter().for_each(|&image| sums[usize::from(image) % MOST_IMAGES] += shared(image, 1));
        }
        for &[image, times] in repeated {
            sums[usize::from(image) % MOST_IMAGES] += shared(image, times);
        }
    }
}

/// Where the lists of words are that are asked for in rising order.
pub(super) struct Finder<'a> {
    block: &'a Block,
    page: usize,
}

impl<'a> Finder<'a> {
    /// Position of the list of `word`, if some image shows it; memory is asked for it.
    #[inline]
    pub(super) fn find(&mut self, word: WordId) -> Option<u32> {
        let number = word.0 / PAGE_WORDS;
        while self.block.pages.get(self.page).is_some_and(|page| page.number < number) {
            self.page += 1;
        }
        let page = self.block.pages.get(self.page).filter(|page| page.number == number)?;
        let bit = 1 << (word.0 % PAGE_WORDS);
        let list = page.first_list + (page.shown & (bit - 1)).count_ones();
        kernel::prefetch(&self.block.lists[list as usize..], size_of::<List>());
        (page.shown & bit != 0).then_some(list)
    }

    /// The postings of `word`; none if no image shows it.
    pub(super) fn postings(&mut self, word: WordId) -> Postings<'a> {
        let list = self.find(word);
        list.map_or_else(Postings::default, |list| self.block.postings(self.block.span(list)))
    }
}
