//! An index as bytes, and back; its postings stay where they are mapped.
//!
//! All numbers are little-endian, and of 32 bits but for the postings, which are of 16, followed by a zero where they
//! are odd in number. First how many documents there are, and how many blocks; then of every block how many images,
//! pages, lists and postings, and these.

use std::borrow::Cow;
use std::sync::Arc;

use super::InvertedIndex;
use super::block::{Block, BlockImage, List, Page};
use super::numbers::Numbers;
use crate::storage::FileBytes;

/// Reads numbers from a file one after the other.
pub struct SnapshotReader {
    file: Arc<FileBytes>,
    position: usize,
}

impl SnapshotReader {
    /// Reads `file` from `position`, a multiple of four, on.
    #[must_use]
    pub fn new(file: FileBytes, position: usize) -> Self {
        Self { file: Arc::new(file), position }
    }

    /// The next so many rows of `N` numbers; `None` if there are fewer.
    pub fn rows<const N: usize>(&mut self, count: usize) -> Option<impl Iterator<Item = [u32; N]>> {
        let end = self.position.checked_add(count.checked_mul(N * size_of::<u32>())?)?;
        let (numbers, _) = self.file.get(self.position..end)?.as_chunks();
        let (rows, _) = numbers.as_chunks::<N>();
        self.position = end;
        Some(rows.iter().map(|row| row.map(u32::from_le_bytes)))
    }

    /// So many numbers of 16 bits, which stay where they are.
    fn postings(&mut self, count: usize) -> Option<Numbers> {
        let end = self.position.checked_add(count.checked_mul(size_of::<u16>())?)?;
        let postings = Numbers::mapped(&self.file, self.position..end)?;
        self.position = end.checked_next_multiple_of(size_of::<u32>())?;
        Some(postings)
    }
}

impl InvertedIndex {
    /// The index as bytes, in parts that follow each other. What was removed is swept out.
    pub fn snapshot(&mut self) -> Vec<Cow<'_, [u8]>> {
        self.sweep();
        let (documents, blocks) = self.settled();
        let mut parts = vec![Cow::Owned(bytes([documents, blocks.len() as u32]))];
        for block in blocks {
            let (pages, lists, postings) = block.contents();
            let counts = [block.images().len(), pages.len(), lists.len(), block.postings_len()];
            let counts = counts.into_iter().map(|count| count as u32);
            let images = block.images().iter().flat_map(|i| [i.document, i.inverse_length.to_bits()]);
            let pages = pages.iter().flat_map(|&Page { number, first_list, shown }| {
                [number, first_list, shown as u32, (shown >> u32::BITS) as u32]
            });
            let lists = lists.iter().flat_map(|list| [list.once, list.repeated]);
            parts.push(Cow::Owned(bytes(counts.chain(images).chain(pages).chain(lists))));
            parts.push(Cow::Borrowed(postings));
            if !postings.len().is_multiple_of(size_of::<u32>()) {
                parts.push(Cow::Borrowed(&[0; size_of::<u16>()]));
            }
        }
        parts
    }

    /// The index that [became](Self::snapshot) what comes next in the file; `None` if that is none, or one of another
    /// number of documents.
    #[must_use]
    pub fn restored(reader: &mut SnapshotReader, documents: u32) -> Option<Self> {
        let [count, blocks] = reader.rows(1)?.next()?;
        let mut restored = Vec::new();
        for _ in 0..blocks {
            restored.push(block(reader)?);
        }
        (count == documents).then(|| Self::of_blocks(documents, restored))?
    }
}

fn block(reader: &mut SnapshotReader) -> Option<Block> {
    let [images, pages, lists, postings] = reader.rows(1)?.next()?.map(|count| count as usize);
    let image = |[document, inverse_length]: [u32; 2]| {
        let inverse_length = f32::from_bits(inverse_length);
        (0.0..=f32::MAX).contains(&inverse_length).then_some(BlockImage { document, inverse_length })
    };
    let images = reader.rows(images)?.map(image).collect::<Option<Vec<_>>>()?;
    let page = |[number, first_list, low, high]: [u32; 4]| Page {
        number,
        first_list,
        shown: u64::from(high) << u32::BITS | u64::from(low),
    };
    let pages = reader.rows(pages)?.map(page).collect();
    let lists = reader.rows(lists)?.map(|[once, repeated]| List { once, repeated }).collect();
    Block::restored(images, pages, lists, reader.postings(postings)?)
}

fn bytes(numbers: impl IntoIterator<Item = u32>) -> Vec<u8> {
    numbers.into_iter().flat_map(u32::to_le_bytes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retrieval::{BowVector, DocumentId};
    use crate::vocabulary::{Weighting, WordId};
    use proptest::prelude::*;

    fn bow(words: &[u32]) -> BowVector {
        BowVector::weighted(words.iter().map(|&word| (WordId(word), 1.0)), Weighting::TfIdf)
    }

    fn reader(index: &mut InvertedIndex) -> SnapshotReader {
        let bytes = index.snapshot().concat();
        SnapshotReader::new(FileBytes::Owned([&[0; 8][..], &bytes].concat()), 8)
    }

    fn images() -> impl Strategy<Value = Vec<Vec<u32>>> {
        proptest::collection::vec(proptest::collection::vec(0..300_u32, 1..12), 1..200)
    }

    proptest! {
        #[test]
        fn an_index_that_was_bytes_answers_as_before_and_goes_on_growing(
            images in images(), removed in proptest::collection::vec(0..200_u32, 0..90), more in images(),
        ) {
            let mut index = InvertedIndex::default();
            for image in &images {
                index.add(&bow(image));
            }
            for &document in &removed {
                index.remove(DocumentId(document));
            }
            let mut restored = InvertedIndex::restored(&mut reader(&mut index), images.len() as u32).unwrap();
            for image in &more {
                prop_assert_eq!(restored.len(), index.len());
                prop_assert_eq!(restored.query(&bow(image), |_| true), index.query(&bow(image), |_| true));
                prop_assert_eq!(restored.add(&bow(image)), index.add(&bow(image)));
                prop_assert_eq!(restored.remove(DocumentId(image[0])), index.remove(DocumentId(image[0])));
            }
        }

        #[test]
        fn whatever_the_bytes_are_no_question_fails(
            images in images(), flips in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
            cut in any::<prop::sample::Index>(),
        ) {
            let mut index = InvertedIndex::default();
            for image in &images {
                index.add(&bow(image));
            }
            let whole = index.snapshot().concat();
            let mut bytes = whole.clone();
            flips.iter().for_each(|(at, value)| bytes[at.index(whole.len())] = *value);
            let restore = |bytes: &[u8]| {
                let mut reader = SnapshotReader::new(FileBytes::Owned(bytes.to_vec()), 0);
                InvertedIndex::restored(&mut reader, images.len() as u32)
            };
            if let Some(mut other) = restore(&bytes) {
                for image in &images {
                    let found = other.query(&bow(image), |_| true);
                    prop_assert!(found.is_sorted_by(|one, next| one.score >= next.score));
                    prop_assert!(found.iter().all(|found| found.score > 0.0 && found.score <= 1.0));
                }
                other.remove(DocumentId(0));
                other.add(&bow(&images[0]));
                other.rename(&[(WordId(images[0][0]), WordId(300))]);
                other.sweep();
            }
            // Behind the last posting there may be two bytes of padding, and nothing else.
            prop_assert!(restore(&whole[..cut.index(whole.len() - 2)]).is_none());
        }
    }

    #[test]
    fn an_index_of_other_documents_is_none() {
        let mut index = InvertedIndex::default();
        index.add(&bow(&[1, 2]));
        assert!(InvertedIndex::restored(&mut reader(&mut index), 2).is_none());
        assert!(InvertedIndex::restored(&mut reader(&mut index), 1).is_some());
    }
}
