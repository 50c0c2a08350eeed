//! The posting lists, each found by the number of its word, beside those of the words next to it.

use crate::vocabulary::WordId;

/// Words a page. A vocabulary has many more words than a small map shows, so pages are small.
const PAGE_WORDS: usize = 8;
/// Pages a chapter.
const CHAPTER_PAGES: usize = 1024;

/// That an image shows a word.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Posting {
    pub(super) document: u32,
    pub(super) weight: f32,
}

/// The lists of `PAGE_WORDS` words in a row.
type Page = [Vec<Posting>; PAGE_WORDS];

/// The pages that there are of `CHAPTER_PAGES` in a row.
type Chapter = [Option<Box<Page>>; CHAPTER_PAGES];

/// For every word its postings; those of most words are empty. Chapters and pages are there only where one of their
/// words was shown: words that grow have ever higher numbers, and old ones are given up.
#[derive(Default)]
pub(super) struct PostingLists {
    chapters: Vec<Option<Box<Chapter>>>,
}

/// Where a word stands: chapter, page, and place in the page.
fn position(word: WordId) -> (usize, usize, usize) {
    let word = word.0 as usize;
    let page = word / PAGE_WORDS;
    (page / CHAPTER_PAGES, page % CHAPTER_PAGES, word % PAGE_WORDS)
}

impl PostingLists {
    #[inline]
    pub(super) fn get(&self, word: WordId) -> &[Posting] {
        let (chapter, page, within) = position(word);
        let chapter = self.chapters.get(chapter).and_then(Option::as_ref);
        chapter.and_then(|chapter| chapter[page].as_ref()).map_or(&[], |page| &page[within])
    }

    pub(super) fn get_mut(&mut self, word: WordId) -> &mut Vec<Posting> {
        let (chapter, page, within) = position(word);
        if chapter >= self.chapters.len() {
            self.chapters.resize_with(chapter + 1, || None);
        }
        let chapter = self.chapters[chapter].get_or_insert_with(|| Box::new([const { None }; CHAPTER_PAGES]));
        &mut chapter[page].get_or_insert_default()[within]
    }

    /// Takes the list of `word` out.
    pub(super) fn take(&mut self, word: WordId) -> Vec<Posting> {
        if self.get(word).is_empty() {
            return Vec::new();
        }
        let taken = std::mem::take(self.get_mut(word));
        let (chapter, page, _) = position(word);
        if let Some(chapter) = &mut self.chapters[chapter]
            && chapter[page].as_ref().is_some_and(|page| page.iter().all(Vec::is_empty))
        {
            chapter[page] = None;
        }
        taken
    }

    /// Keeps the postings that `wanted` accepts, and frees the memory of the others.
    pub(super) fn retain(&mut self, wanted: impl Fn(Posting) -> bool) {
        for chapter in &mut self.chapters {
            for page in chapter.iter_mut().flat_map(|chapter| chapter.iter_mut()) {
                for postings in page.iter_mut().flat_map(|page| page.iter_mut()) {
                    postings.retain(|&posting| wanted(posting));
                    postings.shrink_to(2 * postings.len());
                }
                page.take_if(|page| page.iter().all(Vec::is_empty));
            }
            chapter.take_if(|chapter| chapter.iter().all(Option::is_none));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_with_ever_higher_numbers_leave_no_page_behind_when_they_are_given_up() {
        let posting = Posting { document: 0, weight: 1.0 };
        let mut lists = PostingLists::default();
        let pages = |lists: &PostingLists| {
            lists.chapters.iter().flatten().map(|chapter| chapter.iter().flatten().count()).sum::<usize>()
        };
        for word in (0..100_000).map(WordId) {
            lists.get_mut(word).push(posting);
            assert_eq!(lists.take(word), [posting]);
            assert!(lists.take(word).is_empty() && lists.get(word).is_empty());
        }
        assert_eq!(pages(&lists), 0);
        (0..100_000).map(WordId).for_each(|word| lists.get_mut(word).push(posting));
        assert_eq!(pages(&lists), 100_000 / PAGE_WORDS);
        lists.retain(|_| false);
        assert!(lists.chapters.iter().all(Option::is_none));
    }
}
