//! The recogniser: retrieves candidates, verifies them, decides, and grows the map.

use std::sync::Arc;

use heapless::Vec as FixedVec;

use super::appearance::AppearanceIndex;
use super::belief::Belief;
use super::candidate::{Candidate, Candidates, Evidence, MAX_CANDIDATES, Rejection, Verifications};
use super::comparison::Comparer;
use super::decision::{SHOWN_LOG_ODDS, Weighed};
use super::identity::Identities;
use super::keyframe_index::KeyframeIndex;
use super::look::Look;
use super::options::RecognitionOptions;
use super::renewal::Renewals;
use super::spare::Spare;
use super::visits::Visits;
use super::working_set::WorkingSet;
use super::{Decision, Recognition};
use crate::cnn;
use crate::frame::Frame;
use crate::place_map::{Learnt, MapError, PlaceMap};
use crate::vocabulary::VocabularySet;

/// Recognises places and grows the map.
pub struct Recogniser {
    pub(super) options: RecognitionOptions,
    pub(super) model: Option<cnn::ModelCard>,
    pub(super) map: PlaceMap,
    pub(super) keyframes: KeyframeIndex,
    pub(super) appearances: AppearanceIndex,
    pub(super) visits: Visits,
    pub(super) working_set: WorkingSet,
    pub(super) identities: Identities,
    pub(super) renewals: Renewals,
    pub(super) comparer: Comparer,
    pub(super) weighed: Weighed,
    pub(super) spare: Spare,
    /// Where the robot is.
    pub(super) belief: Belief,
    /// Whether the frame before showed a known place; never where every frame counts by itself.
    pub(super) has_shown: bool,
    /// Whether the frame before was poor.
    pub(super) was_poor: bool,
    pub(super) foreign_descriptors: usize,
    /// Whether those who look on have to be told of the map anew.
    pub(super) is_map_untold: bool,
    /// Why the map cannot be read or changed, until somebody asks.
    pub(super) map_failure: Option<MapError>,
}

impl Recogniser {
    /// A recogniser over `map`; its indices are built from the map's keyframes. CNN descriptors that
    /// another model made are left out, as are keyframes whose records are damaged: that is a
    /// [failure of the map](Self::take_map_failure).
    ///
    /// # Errors
    /// If the medium fails.
    pub fn new(
        vocabularies: Arc<VocabularySet>,
        map: PlaceMap,
        model: Option<cnn::ModelCard>,
        options: RecognitionOptions,
    ) -> Result<Self, MapError> {
        let mut recogniser = Self {
            visits: Visits::new(options.place_interval),
            keyframes: KeyframeIndex::new(vocabularies, options.grow_vocabulary),
            options,
            model,
            map,
            appearances: AppearanceIndex::default(),
            renewals: Renewals::default(),
            comparer: Comparer::default(),
            weighed: Weighed::default(),
            spare: Spare::default(),
            belief: Belief::default(),
            has_shown: false,
            was_poor: false,
            working_set: WorkingSet::default(),
            identities: Identities::default(),
            foreign_descriptors: 0,
            is_map_untold: false,
            map_failure: None,
        };
        recogniser.fill_working_set()?;
        Ok(recogniser)
    }

    /// The map.
    #[must_use]
    pub fn map(&self) -> &PlaceMap {
        &self.map
    }

    /// Gives the map away.
    #[must_use]
    pub fn into_map(self) -> PlaceMap {
        self.map
    }

    /// The vocabularies.
    #[must_use]
    pub fn vocabularies(&self) -> &Arc<VocabularySet> {
        self.keyframes.vocabularies()
    }

    /// Number of keyframes whose CNN descriptors another model made, so that they are not compared.
    #[must_use]
    pub fn foreign_descriptors(&self) -> usize {
        self.foreign_descriptors
    }

    /// Whether the map is only read.
    #[must_use]
    pub fn is_read_only(&self) -> bool {
        self.options.read_only
    }

    /// From now on the map is only read, as if this failure had just happened.
    pub fn read_only_because(&mut self, failure: MapError) {
        self.options.read_only = true;
        // No place is founded any more, so no frame joins one unasked.
        self.visits = Visits::new(self.options.place_interval);
        self.map_failure = Some(failure);
    }

    /// Whether a CNN takes part.
    #[must_use]
    pub fn has_cnn(&self) -> bool {
        self.model.is_some()
    }

    /// Writes everything that was learnt to the medium.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn close(&mut self) -> Result<(), MapError> {
        self.map.close()?;
        self.keep_index();
        Ok(())
    }

    /// Why the map could not be read or changed, or what it gave up since it is damaged; once. If it could not be
    /// changed, it is only read from then on: the robot goes on recognising.
    pub fn take_map_failure(&mut self) -> Option<MapError> {
        let failure = self.map_failure.take();
        let failure = failure.or_else(|| self.working_set.take_unreadable().map(MapError::from));
        failure.or_else(|| self.map.take_loss())
    }

    /// Recognises one frame: [`retrieve`](Self::retrieve), [`verify`](Self::verify) and
    /// [`decide`](Self::decide) in turn.
    pub fn recognise(
        &mut self,
        frame: &Frame,
        look: &Look,
        thumbnail_jpeg: impl FnOnce() -> Vec<u8>,
    ) -> Recognition {
        let mut candidates = self.retrieve(look);
        let verifications = self.verify(look, &mut candidates);
        self.decide(frame, look, (candidates, verifications), thumbnail_jpeg)
    }

    /// The places that `look` may show: those the CNN finds most alike, then those that share the most visual words.
    pub fn retrieve(&mut self, look: &Look) -> Candidates {
        let mut candidates = Candidates::new();
        if let (Some(_), Some(descriptor)) = (&self.model, &look.appearance) {
            for mut candidate in self.appearances.query(descriptor) {
                let is_here = self.visits.founded_within_interval() == Some(candidate.place);
                candidate.rejected = is_here.then_some(Rejection::WithinPlaceInterval);
                let _ = candidates.push(candidate);
            }
        }
        candidates.extend(self.retrieve_by_words(look));
        candidates
    }

    fn retrieve_by_words(&mut self, look: &Look) -> FixedVec<Candidate, MAX_CANDIDATES> {
        let mut candidates: FixedVec<Candidate, MAX_CANDIDATES> = FixedVec::new();
        for keyframe in self.keyframes.query(look, self.visits.founded_within_interval()) {
            // Of a place that was merged from two, each half is asked: they may turn out to be two.
            let learnt_as = |id| self.map.experience(id).map(|experience| experience.learnt_as);
            let half = learnt_as(keyframe.experience);
            let is_known = candidates
                .iter()
                .any(|known| known.place == keyframe.place && learnt_as(known.keyframe) == half);
            if is_known {
                continue;
            }
            // Those that there is no room for are the worst.
            let _ = candidates.push(Candidate {
                place: keyframe.place,
                keyframe: keyframe.experience,
                by: Evidence::BowHv,
                score: keyframe.score,
                votes: None,
                inliers: None,
                probability: 0.0,
                rejected: None,
            });
        }
        candidates
    }

    /// Decides from candidates and the [geometry](Self::verify) of those that have one, and adds to the map what was
    /// learnt. `thumbnail_jpeg` is asked for only if the frame is stored.
    pub fn decide(
        &mut self,
        frame: &Frame,
        look: &Look,
        (mut candidates, mut verifications): (Candidates, Verifications),
        thumbnail_jpeg: impl FnOnce() -> Vec<u8>,
    ) -> Recognition {
        let grounds = self.weigh_candidates(&mut candidates);
        let chosen = self.chosen(&candidates);
        let mut by_words = candidates.iter().filter(|candidate| candidate.by == Evidence::BowHv);
        let position = by_words.position(|candidate| Some(candidate) == chosen.as_ref());
        let verification = position.filter(|&position| position < verifications.len());
        let verification = verification.map(|position| verifications.swap_remove(position));
        self.spare.take_verifications(verifications);
        if let Some(chosen) = &chosen {
            self.mark_outdone(&mut candidates, chosen);
        }
        let is_shown = chosen.as_ref().map(|chosen| grounds.shows(chosen.place, SHOWN_LOG_ODDS));
        let mut recognition = self.judge(look, chosen, (candidates, grounds), verification);
        self.has_shown = is_shown == Some(true) && self.options.sequence;
        self.was_poor = look.is_poor(self.options.keyframe_features);
        let says_something = recognition.decision != Decision::Unknown && is_shown != Some(false);
        if says_something && !self.options.read_only {
            self.remember((frame, look), &mut recognition, thumbnail_jpeg);
        }
        let is_lost = matches!(recognition.decision, Decision::NewPlace | Decision::Unknown);
        let moved = if is_lost { self.look_around() } else { Ok(()) };
        let moved = moved.and_then(|()| recognition.place.map_or(Ok(()), |place| self.stay_near(place)));
        if let Err(failure) = moved {
            self.map_failure.get_or_insert(failure);
        }
        recognition
    }

    /// Adds the frame to the place that it was recognised as, or to a new one.
    fn remember(
        &mut self,
        (frame, look): (&Frame, &Look),
        recognition: &mut Recognition,
        thumbnail_jpeg: impl FnOnce() -> Vec<u8>,
    ) {
        let is_keyframe = recognition.place.is_none_or(|place| {
            self.visits.is_young(place) && self.is_new_look(recognition)
                || self.is_in_new_light((place, recognition.confidence), look.light)
        });
        match self.learn(frame, look, (recognition.place, is_keyframe), &thumbnail_jpeg()) {
            Ok(Learnt { place, experience, .. }) => {
                let is_new = recognition.decision == Decision::NewPlace;
                if is_new {
                    recognition.keyframe = experience;
                    self.belief = Belief::after_founding(place);
                }
                recognition.place = Some(place);
                recognition.experience = experience;
                self.visits.move_to(place, is_new);
                if let Err(failure) = self.weigh_identities(&recognition.candidates) {
                    self.read_only_because(failure);
                }
            }
            Err(failure) => {
                self.forget_given_up();
                self.read_only_because(failure);
                if recognition.place.is_none() {
                    recognition.decision = Decision::Unknown;
                }
            }
        }
    }

    /// Takes an answer that nobody needs any more: the next one is written into its memory. So, of a stream in which
    /// nothing is new, the frames take none.
    pub fn reuse(&mut self, answer: Recognition) {
        self.spare.take(answer);
    }

    /// From now on the robot may be anywhere: what comes next has nothing to do with what was seen before.
    pub fn begin_anew(&mut self) {
        self.belief = Belief::default();
        self.has_shown = false;
        self.was_poor = false;
        self.visits = Visits::new(self.options.place_interval);
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::atomic::AtomicBool;

    use super::super::world_for_tests::{Robot, appearance, card, features, in_memory, no_interval, opened};
    use super::super::{Join, Support, Walk};
    use super::*;
    use crate::place_map::{Appearance, NewExperience, PlaceId, Traits};
    use crate::vocabulary::Light;

    #[test]
    fn the_first_frame_founds_a_place_and_the_next_ones_join_it() {
        let options = RecognitionOptions::default();
        let mut robot = Robot::new(Some(card()), options, in_memory());
        assert_eq!(robot.see(0, 0).decision, Decision::NewPlace);
        for look in 1..=5 {
            let joined = robot.see(look as u64, look);
            assert_eq!((joined.decision, joined.place), (Decision::SamePlace, Some(PlaceId(0))));
        }
        assert_eq!(robot.see(6, 6).decision, Decision::NewPlace);
    }

    #[test]
    fn a_known_look_is_recognised_by_the_cnn_even_where_geometry_finds_nothing() {
        let mut robot = Robot::with_cnn();
        robot.see(0, 0);
        robot.leave();
        let answer = robot.see(3, 0);
        assert_eq!((answer.decision, answer.place), (Decision::Recognised, Some(PlaceId(0))));
        assert_eq!((answer.by, answer.inliers), (Some(Evidence::Cnn), None));
        assert!(answer.confidence > 0.95, "{}", answer.confidence);
        assert_eq!(answer.candidates[0].rejected, None);
    }

    #[test]
    fn a_look_that_the_cnn_does_not_know_is_revisited_by_geometry_and_known_from_then_on() {
        let mut robot = Robot::with_cnn();
        robot.see(0, 0);
        robot.leave();
        let answer = robot.see(0, 9);
        assert_eq!((answer.decision, answer.place), (Decision::Revisited, Some(PlaceId(0))));
        assert!(answer.inliers >= Some(100) && answer.verification.is_some(), "{:?}", answer.inliers);
        let cnn = answer.candidates.iter().find(|c| c.by == Evidence::Cnn && c.place == PlaceId(0)).unwrap();
        assert!(cnn.score < 0.1 && cnn.rejected.is_some(), "{cnn:?}");
        robot.leave();
        assert_eq!(robot.see(5, 9).decision, Decision::Recognised);
    }

    #[test]
    fn without_a_cnn_geometry_decides_alone() {
        let mut robot = Robot::without_cnn();
        robot.see(0, 0);
        robot.leave();
        assert_eq!(robot.see(0, 0).place, Some(PlaceId(0)));
        robot.leave();
        // A single frame in which nothing is known founds nothing where the place before was.
        assert_eq!(robot.see(4, 0).decision, Decision::Unknown);
        let elsewhere = robot.see(4, 0);
        assert_eq!(elsewhere.decision, Decision::NewPlace);
        assert!(elsewhere.candidates.iter().all(|candidate| candidate.rejected.is_some()));
    }

    #[test]
    fn a_view_that_is_known_already_becomes_no_keyframe() {
        let mut robot = Robot::with_cnn();
        robot.see(0, 0);
        robot.leave();
        let before = robot.keyframes();
        robot.see(0, 0);
        assert_eq!(robot.keyframes(), before);
        assert_eq!(robot.recogniser.map().place(PlaceId(0)).unwrap().experiences.len(), 2);
    }

    #[test]
    fn a_place_first_seen_by_day_is_matched_by_night_once_it_has_a_night_experience() {
        let mut robot = Robot::by_day_and_night();
        let (day, night) = (0, 100);
        let dock = robot.see(day, 0).place;
        robot.leave();
        // By night the CNN still knows the place; its features are others.
        assert_eq!(robot.see_in(40.0, night, 0).decision, Decision::Recognised);
        robot.leave();
        // Now the CNN does not, but the words of the night do.
        let answer = robot.see_in(40.0, night, 9);
        assert_eq!((answer.decision, answer.place), (Decision::Revisited, dock));
        robot.leave();
        assert_eq!(robot.see(day, 8).place, dock, "and the day is not forgotten");
    }

    #[test]
    fn late_in_a_visit_a_place_gets_a_keyframe_in_a_new_light_and_none_in_a_known_one() {
        let mut robot = Robot::new(Some(card()), no_interval(), in_memory());
        (0..6).for_each(|place| drop(robot.see(place, place as usize)));
        (0..3).for_each(|_| drop(robot.see(0, 0)));
        let before = robot.keyframes();
        for (luminance, brought) in [(110.0, 0), (80.0, 1), (85.0, 1), (50.0, 2), (120.0, 2), (60.0, 2)] {
            assert_eq!(robot.see_in(luminance, 0, 0).place, Some(PlaceId(0)));
            assert_eq!(robot.keyframes() - before, brought, "{luminance}");
        }
    }

    #[test]
    fn dusk_at_the_border_of_two_conditions_brings_one_keyframe() {
        let mut robot = Robot::by_day_and_night();
        robot.see_in(40.0, 7, 15);
        for _ in 0..20 {
            // Nearer to the day, but counted as night as long as the night was before.
            robot.see_in(82.0, 0, 0);
        }
        assert_eq!(robot.keyframes(), 2);
    }

    /// Indices of the BoW candidates' places and their scores, for the features of one place.
    fn retrieved(recogniser: &mut Recogniser, place: u64) -> Vec<(PlaceId, f32)> {
        let look = Look::new(features(place), (recogniser.vocabularies(), Light::default()), None);
        recogniser.retrieve(&look).iter().map(|candidate| (candidate.place, candidate.score)).collect()
    }

    #[test]
    fn words_that_grew_find_what_the_vocabulary_covers_badly() {
        // Random descriptors lie about 128 bits from those of other places: places 20 to 29 were not trained.
        let scores = [false, true].map(|grow_vocabulary| {
            let options = RecognitionOptions { grow_vocabulary, place_interval: 1, ..no_interval() };
            let mut robot = Robot::new(None, options, in_memory());
            for place in 20..30 {
                robot.see(place, 0);
                robot.see(place, 0);
            }
            retrieved(&mut robot.recogniser, 20)
        });
        let lead = scores.map(|found| {
            assert_eq!(found[0].0, PlaceId(0));
            found[0].1 - found.get(1).map_or(0.0, |second| second.1)
        });
        assert!(lead[1] > lead[0] + 0.1, "{lead:?}");
    }

    #[test]
    fn a_map_that_is_opened_again_grows_the_same_words() {
        let folder = tempfile::tempdir().unwrap();
        let options = RecognitionOptions { grow_vocabulary: true, ..no_interval() };
        let mut robot = Robot::new(None, options.clone(), opened(folder.path()));
        for place in [20, 21, 20, 22, 23, 21, 24] {
            robot.see(place, 0);
        }
        let before = retrieved(&mut robot.recogniser, 20);
        drop(robot);
        let mut robot = Robot::new(None, options, opened(folder.path()));
        assert_eq!(retrieved(&mut robot.recogniser, 20), before);
    }

    #[test]
    fn places_that_memory_has_no_room_for_come_back_when_the_robot_approaches_them() {
        let options = RecognitionOptions { memory_bytes: 27_000, place_interval: 0, ..no_interval() };
        let mut robot = Robot::new(None, options, in_memory());
        let there: Vec<Option<PlaceId>> = (0..64).map(|place| robot.see(place, 0).place).collect();
        let working_places = robot.recogniser.working_places();
        assert!((8..40).contains(&working_places), "{working_places}");
        assert!(robot.recogniser.index_bytes() < 27_000, "{}", robot.recogniser.index_bytes());
        // Back to the beginning, step by step: each place brings the ones before it.
        let back: Vec<Option<PlaceId>> = (0..64).rev().map(|place| robot.see(place, 0).place).collect();
        assert_eq!(back, there.into_iter().rev().collect::<Vec<_>>());
    }

    #[test]
    fn a_robot_carried_to_places_that_wait_looks_around_until_it_knows_where_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let mut robot = Robot::new(None, no_interval(), opened(folder.path()));
        let there: Vec<Option<PlaceId>> = (0..64).map(|place| robot.see(place, 0).place).collect();
        drop(robot);
        let options = RecognitionOptions { memory_bytes: 27_000, read_only: true, ..no_interval() };
        let map = PlaceMap::open_read_only(folder.path()).unwrap();
        let mut robot = Robot::new(None, options, map);
        assert!(robot.recogniser.working_places() < 40);
        let answers: Vec<Recognition> = (0..12).map(|_| robot.see(5, 0)).collect();
        assert_eq!(answers[0].decision, Decision::Unknown);
        assert_eq!((answers[11].decision, answers[11].place), (Decision::Revisited, there[5]));
    }

    /// A map of two places of one keyframe each, between whose foundings so many frames showed a third one.
    fn map_of(first: u64, between: u64, second: u64) -> PlaceMap {
        let robot = Robot::without_cnn();
        let mut map = in_memory();
        let mut learn = |place: Option<PlaceId>, seed: u64| {
            let traits =
                Traits { words: robot.recogniser.keyframes.words_of(&features(seed)), appearance: None };
            let (frame, features) = (robot.frame(), features(seed));
            let keyframe = place.is_none().then_some((&features, &traits));
            let new = NewExperience {
                frame: &frame,
                view: seed,
                mean_luminance: 120.0,
                thumbnail_jpeg: &[],
                keyframe,
            };
            map.learn(place, &new).unwrap();
        };
        learn(None, first);
        learn(None, 7);
        (0..between).for_each(|seed| learn(Some(PlaceId(1)), seed));
        learn(None, second);
        map
    }

    /// Sees `place` on so many visits, and what it was recognised as.
    fn visits(robot: &mut Robot, place: u64, count: usize) -> Option<PlaceId> {
        let mut seen = None;
        for _ in 0..count {
            seen = robot.see(place, 0).place;
            (0..25).for_each(|_| robot.leave());
        }
        seen
    }

    #[test]
    fn a_place_that_was_founded_twice_becomes_one_after_three_visits() {
        let options = RecognitionOptions { place_interval: 1, ..no_interval() };
        let mut robot = Robot::new(None, options, map_of(0, 60, 0));
        visits(&mut robot, 0, 2);
        assert_eq!(robot.recogniser.map().summary().merged_places, 0, "two visits are no proof");
        visits(&mut robot, 0, 1);
        assert_eq!(robot.recogniser.map().summary().merged_places, 1);
        assert_eq!(robot.recogniser.map().place(PlaceId(2)).unwrap().id, PlaceId(0), "old numbers resolve");
        assert_eq!(visits(&mut robot, 0, 1), Some(PlaceId(0)));
    }

    #[test]
    fn places_founded_one_after_the_other_share_views_and_are_never_merged() {
        let options = RecognitionOptions { place_interval: 1, ..no_interval() };
        let mut robot = Robot::new(None, options, map_of(0, 10, 0));
        visits(&mut robot, 0, 5);
        assert_eq!(robot.recogniser.map().summary().merged_places, 0);
    }

    #[test]
    fn places_of_another_map_are_recognised_with_their_evidence() {
        let mut other = Robot::new(None, no_interval(), map_of(0, 0, 20)).recogniser;
        let mut robot = Robot::without_cnn();
        let places = [5, 7, 0].map(|place| robot.see(place, 0).place.unwrap());
        let stopped = robot.recogniser.joins(&mut other, &AtomicBool::new(true));
        assert!(matches!(stopped, Err(MapError::Interrupted)));
        let joins = robot.recogniser.joins(&mut other, &AtomicBool::new(false)).unwrap();
        let found = |joins: &[Join]| joins.iter().map(|join| (join.other, join.place)).collect::<Vec<_>>();
        assert_eq!(found(&joins), [(PlaceId(0), places[2]), (PlaceId(1), places[1])]);
        for Support { matched, keyframes, inliers, cosine } in joins.iter().flat_map(|j| [j.there, j.back]) {
            assert_eq!((matched, keyframes, cosine), (1, 1, None));
            assert!(inliers > 50, "{inliers}");
        }
        let back = other.joins(&mut robot.recogniser, &AtomicBool::new(false)).unwrap();
        assert_eq!(found(&back), [(places[1], PlaceId(1)), (places[2], PlaceId(0))]);
        assert_eq!(robot.recogniser.map().summary().experiences, 3, "nothing is changed");
    }

    #[test]
    fn places_of_another_map_that_only_the_cnn_knows_are_not_joined() {
        let [mut robot, mut other] = [0, 1].map(|_| Robot::with_cnn());
        for place in 0..3 {
            robot.see(place, place as usize);
            other.see(10 + place, place as usize);
        }
        assert_eq!(robot.recogniser.joins(&mut other.recogniser, &AtomicBool::new(false)).unwrap(), []);
    }

    #[test]
    fn a_merge_of_places_that_only_looked_alike_is_undone() {
        let mut map = map_of(0, 60, 1);
        map.merge_places(PlaceId(2), PlaceId(0)).unwrap();
        let mut robot = Robot::new(None, RecognitionOptions { place_interval: 1, ..no_interval() }, map);
        visits(&mut robot, 0, 5);
        assert_eq!(robot.recogniser.map().summary().merged_places, 1);
        visits(&mut robot, 0, 1);
        assert_eq!(robot.recogniser.map().summary().merged_places, 0);
        assert_eq!(visits(&mut robot, 1, 1), Some(PlaceId(2)), "what was learnt as it is its own again");
        assert_eq!(visits(&mut robot, 0, 1), Some(PlaceId(0)));
    }

    #[test]
    fn a_read_only_map_answers_unknown_and_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let mut robot = Robot::new(Some(card()), no_interval(), opened(folder.path()));
        robot.see(0, 0);
        robot.leave();
        let before = robot.recogniser.map().summary();
        drop(robot);
        let options = RecognitionOptions { read_only: true, ..no_interval() };
        let map = PlaceMap::open_read_only(folder.path()).unwrap();
        let mut robot = Robot::new(Some(card()), options, map);
        assert_eq!(robot.see(0, 0).place, Some(PlaceId(0)));
        let unknown = robot.see(4, 4);
        assert_eq!((unknown.decision, unknown.place, unknown.keyframe), (Decision::Unknown, None, None));
        assert_eq!(robot.recogniser.map().summary(), before);
    }

    /// Flips the last bit of the first record of a kind in a map's journal.
    fn damage_first(folder: &Path, kind: u8) {
        let path = folder.join("journal-000001.loci");
        let mut bytes = std::fs::read(&path).unwrap();
        let header = |at: usize| bytes[at..at + 4] == [0xb7, b'R', b'e', b'c'] && bytes[at + 4] == kind;
        let at = (16..bytes.len() - 28).find(|&at| header(at)).unwrap();
        let length = u32::from_le_bytes(bytes[at + 8..at + 12].try_into().unwrap());
        bytes[at + 28 + length as usize - 1] ^= 1;
        std::fs::write(path, bytes).unwrap();
    }

    #[test]
    fn a_keyframe_whose_records_are_damaged_is_left_out_said_once_and_the_others_are_found() {
        for damaged in [2, 3] {
            let folder = tempfile::tempdir().unwrap();
            let mut robot = Robot::new(None, no_interval(), opened(folder.path()));
            (0..4).for_each(|place| drop(robot.see(place, 0)));
            robot.recogniser.close().unwrap();
            drop(robot);
            damage_first(folder.path(), damaged);
            let map = PlaceMap::open_read_only(folder.path()).unwrap();
            let options = RecognitionOptions { read_only: true, ..no_interval() };
            let mut robot = Robot::new(None, options, map);
            let mut said = Vec::new();
            for place in [0, 1, 2, 0, 3, 0, 1] {
                let answer = robot.see(place, 0);
                assert_eq!(answer.place, (place > 0).then_some(PlaceId(place as u32)), "{damaged}");
                said.extend(robot.recogniser.take_map_failure().map(|failure| failure.to_string()));
            }
            assert_eq!(said.len(), 1, "{said:?}");
            let part = "they cannot be read: 1 (";
            assert!(said[0].contains(part) && said[0].contains("journal-000001.loci: bad"), "{said:?}");
        }
    }

    fn other_card() -> cnn::ModelCard {
        cnn::ModelCard { sha256: "f".repeat(64), ..card() }
    }

    /// Keyframes of three places, with thumbnails, and the looks that the other model has of them: the next ones.
    fn robot_with_thumbnails(map: PlaceMap) -> Robot {
        let mut robot = Robot::new(Some(card()), no_interval(), map);
        (0..3).for_each(|place| drop(robot.see(place, place as usize)));
        robot
    }

    /// Walks through the map and describes what it shows as the other model does.
    fn describe_anew(robot: &mut Robot) -> Vec<u32> {
        let mut walk = Walk::new(other_card().sha256);
        let mut shown = Vec::new();
        while !walk.is_over() {
            let Some(exhibit) = robot.recogniser.walk_on(&mut walk) else { continue };
            let look = usize::from(exhibit.thumbnail_jpeg[0]) + 1;
            let descriptor = (&appearance(look)).into();
            shown.push(exhibit.keyframe.0);
            robot.recogniser.renew(exhibit.keyframe, Appearance { model: other_card().sha256, descriptor });
        }
        shown
    }

    #[test]
    fn a_model_that_takes_over_compares_with_its_own_descriptors_and_the_one_before_with_its_own_again() {
        let mut robot = robot_with_thumbnails(in_memory());
        assert_eq!(describe_anew(&mut robot), [0, 1, 2]);
        assert_eq!(robot.see(9, 1).place, Some(PlaceId(1)), "nothing has changed yet");
        assert_eq!(robot.recogniser.use_model(&other_card()), Some(3));
        assert_eq!(robot.see(9, 1).place, Some(PlaceId(0)));
        assert_eq!(robot.recogniser.use_model(&other_card()), None, "it is in use");
        assert_eq!(robot.recogniser.use_model(&card()), Some(3));
        assert_eq!(robot.see(9, 1).place, Some(PlaceId(1)));
    }

    #[test]
    fn what_was_described_anew_is_in_the_map_once_its_model_has_proved_itself_and_not_before() {
        let folder = tempfile::tempdir().unwrap();
        let mut robot = robot_with_thumbnails(opened(folder.path()));
        describe_anew(&mut robot);
        robot.recogniser.use_model(&other_card());
        (0..9).for_each(|_| robot.recogniser.store_renewed());
        assert_eq!(robot.recogniser.map().models().unwrap().0, [card().sha256]);
        robot.recogniser.settle_model();
        (0..9).for_each(|_| robot.recogniser.store_renewed());
        assert_eq!(robot.recogniser.map().models().unwrap().0, [other_card().sha256]);
        assert_eq!(robot.recogniser.renewals.memory_bytes(), 0);
        assert!(robot.recogniser.take_map_failure().is_none());
        drop(robot);
        let mut robot = Robot::new(Some(other_card()), no_interval(), opened(folder.path()));
        assert_eq!(robot.recogniser.foreign_descriptors(), 0);
        assert_eq!(robot.see(9, 3).place, Some(PlaceId(2)));
        assert!(describe_anew(&mut robot).is_empty(), "nothing is left to do");
    }

    #[test]
    fn a_keyframe_that_was_described_before_its_model_came_back_needs_no_second_look() {
        let folder = tempfile::tempdir().unwrap();
        drop(robot_with_thumbnails(opened(folder.path())));
        let mut robot = Robot::new(Some(other_card()), no_interval(), opened(folder.path()));
        let mut walk = Walk::new(card().sha256);
        while !walk.is_over() {
            assert_eq!(robot.recogniser.walk_on(&mut walk), None);
        }
        assert_eq!(robot.recogniser.use_model(&card()), Some(3));
        assert_eq!(robot.see(9, 2).place, Some(PlaceId(2)));
    }

    #[test]
    fn memory_ends_the_walk_before_descriptors_take_more_than_their_share() {
        let options = RecognitionOptions { memory_bytes: 8_000, ..no_interval() };
        let mut robot = Robot::new(Some(card()), options, in_memory());
        (0..15).for_each(|place| drop(robot.see(place, place as usize)));
        let described = describe_anew(&mut robot).len();
        assert!((3..10).contains(&described), "{described}");
        assert!(robot.recogniser.renewals.memory_bytes() < 1_000);
        robot.recogniser.forget_renewed(&other_card().sha256);
        assert_eq!(robot.recogniser.renewals.memory_bytes(), 0);
    }

    #[test]
    fn descriptors_of_another_model_are_never_compared() {
        let folder = tempfile::tempdir().unwrap();
        let mut robot = Robot::new(Some(card()), no_interval(), opened(folder.path()));
        robot.see(0, 0);
        drop(robot);
        let other = cnn::ModelCard { sha256: "f".repeat(64), ..card() };
        let map = opened(folder.path());
        let mut robot = Robot::new(Some(other), no_interval(), map);
        let answer = robot.see(0, 0);
        assert_eq!(answer.decision, Decision::Revisited, "found by BoW+HV alone");
        assert!(answer.candidates.iter().all(|candidate| candidate.by == Evidence::BowHv));
    }
}
