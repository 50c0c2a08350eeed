//! The posting lists, each found by the number of its word, beside those of the words next to it.

use crate::vocabulary::WordId;

/// Words a page. A vocabulary has many more words than a small map shows, so pages are small.
const PAGE_WORDS: usize = 32;
/// Postings that a list has room for at least.
const FEWEST_POSTINGS: usize = 4;

/// That an image shows a word.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Posting {
    pub(super) document: u32,
    pub(super) weight: f32,
}

/// The lists of `PAGE_WORDS` words in a row.
type Page = [Vec<Posting>; PAGE_WORDS];

/// For every word its postings; those of most words are empty.
#[derive(Default)]
pub(super) struct PostingLists {
    /// Only where one of the words was shown.
    pages: Vec<Option<Box<Page>>>,
}

/// The page of a word, and where it stands there.
fn position(word: WordId) -> (usize, usize) {
    let word = word.0 as usize;
    (word / PAGE_WORDS, word % PAGE_WORDS)
}

impl PostingLists {
    #[inline]
    pub(super) fn get(&self, word: WordId) -> &[Posting] {
        let (page, within) = position(word);
        self.pages.get(page).and_then(Option::as_ref).map_or(&[], |page| &page[within])
    }

    pub(super) fn get_mut(&mut self, word: WordId) -> &mut Vec<Posting> {
        let (page, within) = position(word);
        if page >= self.pages.len() {
            self.pages.resize_with(page + 1, || None);
        }
        &mut self.pages[page].get_or_insert_default()[within]
    }

    /// The list of `word`, with room for one more posting.
    pub(super) fn with_room(&mut self, word: WordId) -> &mut Vec<Posting> {
        let postings = self.get_mut(word);
        if postings.len() == postings.capacity() {
            // By half: doubling would leave a third of all memory unused.
            postings.reserve_exact(FEWEST_POSTINGS.max(postings.len() / 2));
        }
        postings
    }

    /// Keeps the postings that `wanted` accepts, and frees the memory of the others.
    pub(super) fn retain(&mut self, wanted: impl Fn(Posting) -> bool) {
        for slot in &mut self.pages {
            let Some(page) = slot else { continue };
            for postings in page.iter_mut() {
                postings.retain(|&posting| wanted(posting));
                postings.shrink_to(2 * postings.len());
            }
            if page.iter().all(Vec::is_empty) {
                *slot = None;
            }
        }
    }
}
