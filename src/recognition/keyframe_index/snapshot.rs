//! The index of the keyframes as bytes, and back, so that a map opens without reading the words of every keyframe.
//!
//! All numbers are little-endian, of 32 bits: how many vocabularies there are, and how many documents; the fingerprint
//! of every vocabulary; of every document the experience, or [`NONE`], and its postings; then an inverted index for
//! each vocabulary.

use std::borrow::Cow;

use super::super::recogniser::Recogniser;
use super::{IndexedKeyframe, KeyframeIndex};
use crate::place_map::{ExperienceId, KeptIndex, PlaceId};
use crate::retrieval::{DocumentId, InvertedIndex, SnapshotReader};

/// Stands for the experience of a document that was removed.
const NONE: u32 = u32::MAX;
/// Keyframes from which on reading the index is quicker than making it by more than anybody notices.
const FEWEST_KEPT: usize = if cfg!(test) { 2 } else { 1000 };

/// The lower half, and the upper one.
fn halves(fingerprint: u64) -> [u32; 2] {
    [fingerprint as u32, (fingerprint >> u32::BITS) as u32]
}

impl KeyframeIndex {
    /// The index as bytes, in parts that follow each other; `None` if its words may grow.
    fn snapshot(&mut self) -> Option<Vec<Cow<'_, [u8]>>> {
        if self.may_grow() {
            return None;
        }
        self.sweep();
        let mut keyframes = vec![[NONE, 0]; self.keyframes.len()];
        for (experience, document) in &self.documents {
            let document = document.0 as usize;
            keyframes[document] = [experience.0, self.keyframes[document].postings];
        }
        let counts = [self.words.len() as u32, keyframes.len() as u32];
        let fingerprints = self.fingerprints().flat_map(halves);
        let numbers = counts.into_iter().chain(fingerprints).chain(keyframes.into_iter().flatten());
        let mut parts = vec![Cow::Owned(numbers.flat_map(u32::to_le_bytes).collect())];
        self.words.iter_mut().for_each(|index| parts.extend(index.inverted.snapshot()));
        Some(parts)
    }

    /// Becomes the index that was kept, with those of its keyframes that are `wanted`, if it is of these vocabularies
    /// and `place_of` knows where all of them are; else stays as it is.
    fn restore(
        &mut self,
        kept: KeptIndex,
        place_of: impl Fn(ExperienceId) -> Option<PlaceId>,
        wanted: impl Fn(ExperienceId) -> bool,
    ) -> Option<()> {
        let mut reader = SnapshotReader::new(kept.file, kept.begin);
        let [vocabularies, documents] = reader.rows(1)?.next()?;
        let is_own = vocabularies as usize == self.words.len()
            && reader.rows(self.words.len())?.eq(self.fingerprints().map(halves))
            && !self.may_grow();
        let rows = reader.rows::<2>(documents as usize).filter(|_| is_own)?.zip(0..);
        let mut restored = Self::new(self.vocabularies().clone(), false);
        let nowhere = IndexedKeyframe { place: PlaceId(NONE), experience: ExperienceId(NONE), postings: 0 };
        restored.keyframes = vec![nowhere; documents as usize];
        for ([experience, postings], document) in rows.filter(|([experience, _], _)| *experience != NONE) {
            let experience = ExperienceId(experience);
            let keyframe = IndexedKeyframe { place: place_of(experience)?, experience, postings };
            restored.keyframes[document as usize] = keyframe;
            restored.documents.insert(experience, DocumentId(document));
        }
        for index in &mut restored.words {
            index.inverted = InvertedIndex::restored(&mut reader, documents)?;
            let are_there = restored.documents.values().all(|&document| index.inverted.contains(document));
            (are_there && index.inverted.len() == restored.documents.len()).then_some(())?;
        }
        let stated: u64 = restored.keyframes.iter().map(|keyframe| u64::from(keyframe.postings)).sum();
        let counted: usize = restored.words.iter().map(|index| index.inverted.postings()).sum();
        (stated == counted as u64).then_some(())?;
        restored.retain(wanted);
        *self = restored;
        Some(())
    }
}

impl Recogniser {
    /// Takes over the index that was kept with the map, with those of its keyframes that are `wanted`, if it is of the
    /// map's present state.
    pub(in super::super) fn restore_index(&mut self, wanted: impl Fn(ExperienceId) -> bool) {
        let Some(kept) = self.map.take_index() else { return };
        let Self { map, keyframes, .. } = self;
        let place_of = |keyframe| {
            let experience = map.experience(keyframe).filter(|experience| experience.is_keyframe)?;
            map.place(experience.learnt_as).map(|place| place.id)
        };
        // Without it, all keyframes are indexed one by one.
        let _ = keyframes.restore(kept, place_of, wanted);
    }

    /// Keeps the index with the map, as it is now, if making it anew would take long.
    pub(in super::super) fn keep_index(&mut self) {
        if self.options.read_only || self.keyframes.documents.len() < FEWEST_KEPT {
            return;
        }
        if let Some(parts) = self.keyframes.snapshot() {
            let parts: Vec<&[u8]> = parts.iter().map(AsRef::as_ref).collect();
            self.map.keep_index(&parts);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::super::super::world_for_tests::{Robot, card, no_interval, opened};
    use super::super::super::{Recognition, RecognitionOptions};
    use super::*;
    use crate::place_map::PlaceMap;

    /// A map of six places in `folder`, two of which were merged, closed properly.
    fn write_map(folder: &Path) {
        let mut robot = Robot::new(Some(card()), no_interval(), opened(folder));
        (0..6).for_each(|place| drop(robot.see(place, place as usize)));
        let mut map = robot.recogniser.into_map();
        map.merge_places(PlaceId(4), PlaceId(1)).unwrap();
        map.close().unwrap();
        Robot::new(Some(card()), no_interval(), map).recogniser.close().unwrap();
    }

    fn answers(folder: &Path, options: RecognitionOptions, model: bool) -> (Robot, Vec<Recognition>) {
        let options = RecognitionOptions { read_only: true, ..options };
        let map = PlaceMap::open_read_only(folder).unwrap();
        let mut robot = Robot::new(model.then(card), options, map);
        let answers = (0..8).map(|place| robot.see(place, place as usize)).collect();
        (robot, answers)
    }

    #[test]
    fn a_map_that_is_opened_with_its_index_answers_as_without_it() {
        let folder = tempfile::tempdir().unwrap();
        write_map(folder.path());
        let index = folder.path().join("index.loci");
        let kept = fs::read(&index).unwrap();
        for model in [true, false] {
            fs::write(&index, &kept).unwrap();
            let (with, answers_with) = answers(folder.path(), no_interval(), model);
            assert!(with.recogniser.map().places().count() == 6 && index.exists());
            fs::remove_file(&index).unwrap();
            let (without, answers_without) = answers(folder.path(), no_interval(), model);
            assert_eq!(format!("{answers_with:?}"), format!("{answers_without:?}"));
            assert_eq!(with.recogniser.index_bytes(), without.recogniser.index_bytes());
            assert!(with.recogniser.into_map().take_index().is_none(), "it was taken over");
            assert!(answers_with.iter().filter(|answer| answer.place.is_some()).count() >= 5);
        }
    }

    #[test]
    fn the_index_of_another_vocabulary_or_of_words_that_may_grow_is_not_taken_over() {
        let folder = tempfile::tempdir().unwrap();
        write_map(folder.path());
        let kept = || PlaceMap::open_read_only(folder.path()).unwrap().take_index().unwrap();
        let place_of = |_| Some(PlaceId(0));
        let mut own = Robot::without_cnn();
        assert_eq!(own.recogniser.keyframes.restore(kept(), place_of, |_| true), Some(()));
        assert_eq!(own.recogniser.keyframes.experiences().count(), 6);
        assert_eq!(own.recogniser.keyframes.restore(kept(), |_| None, |_| true), None);
        let few = |keyframe: ExperienceId| keyframe.0 < 2;
        assert_eq!(own.recogniser.keyframes.restore(kept(), place_of, few), Some(()));
        assert_eq!(own.recogniser.keyframes.experiences().count(), 2);
        let mut by_light = Robot::by_day_and_night();
        assert_eq!(by_light.recogniser.keyframes.restore(kept(), place_of, |_| true), None);
        let growing = RecognitionOptions { grow_vocabulary: true, ..no_interval() };
        let mut growing = Robot::new(None, growing, opened(&folder.path().join("growing")));
        assert_eq!(growing.recogniser.keyframes.restore(kept(), place_of, |_| true), None);
        assert!(growing.recogniser.keyframes.snapshot().is_none());
    }

    #[test]
    fn places_that_memory_has_no_room_for_are_left_out_of_it() {
        let folder = tempfile::tempdir().unwrap();
        write_map(folder.path());
        let (all, _) = answers(folder.path(), no_interval(), false);
        let bytes = all.recogniser.map().memory_bytes() + all.recogniser.index_bytes() / 2;
        let (few, _) =
            answers(folder.path(), RecognitionOptions { memory_bytes: bytes, ..no_interval() }, false);
        assert!(few.recogniser.working_places() < all.recogniser.working_places());
        assert!(few.recogniser.index_bytes() <= few.recogniser.budget_bytes());
    }
}
