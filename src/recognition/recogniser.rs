//! The recogniser: retrieves candidates, verifies them, decides, and grows the map.

use std::sync::Arc;

use super::appearance::AppearanceIndex;
use super::calibration::{doubt, inlier_probability};
use super::candidate::{Candidate, Candidates, Evidence, MAX_CANDIDATES, Rejection};
use super::keyframe_index::KeyframeIndex;
use super::visits::Visits;
use super::{Decision, Recognition};
use crate::cnn;
use crate::feature::Features;
use crate::frame::Frame;
use crate::place_map::{Appearance, ExperienceId, MapError, NewExperience, PlaceId, PlaceMap};
use crate::verification::{MatchingView, Verification, VerificationOptions, verify};
use crate::vocabulary::{ConditionId, Light, Quantised, VocabularySet};

/// Settings of the decision.
#[derive(Clone, Debug, PartialEq)]
pub struct RecognitionOptions {
    /// δ_ep: sampled frames that join a place unasked after its founding; default 5.
    pub place_interval: u32,
    /// Fewest effective inliers of a verified match; default 12.
    pub min_inliers: u32,
    /// Never change the map; frames that match nothing are `unknown`. Default false.
    pub read_only: bool,
    /// Learn words online where the vocabulary covers the keyframes badly; default false.
    pub grow_vocabulary: bool,
    /// Tolerances of the verification.
    pub verification: VerificationOptions,
}

impl Default for RecognitionOptions {
    fn default() -> Self {
        Self {
            place_interval: 5,
            min_inliers: 12,
            read_only: false,
            grow_vocabulary: false,
            verification: VerificationOptions::default(),
        }
    }
}

/// What was seen in a frame.
#[derive(Clone, Debug, Default)]
pub struct Look {
    /// ORB features.
    pub features: Features,
    /// Under which light.
    pub light: Light,
    /// What the vocabulary of that light says of each feature.
    pub quantised: Vec<Quantised>,
    /// CNN descriptor, if a CNN is running.
    pub appearance: Option<cnn::Descriptor>,
}

impl Look {
    /// The words and nodes of `features` seen in `light`, with the CNN's descriptor of the same frame.
    #[must_use]
    pub fn new(
        features: Features,
        (vocabularies, light): (&VocabularySet, Light),
        appearance: Option<cnn::Descriptor>,
    ) -> Self {
        let quantised = vocabularies.vocabulary(light.condition).quantise_all(&features.descriptors);
        Self { features, light, quantised, appearance }
    }
}

/// Recognises places and grows the map.
pub struct Recogniser {
    options: RecognitionOptions,
    model: Option<cnn::ModelCard>,
    map: PlaceMap,
    keyframes: KeyframeIndex,
    appearances: AppearanceIndex,
    visits: Visits,
}

impl Recogniser {
    /// A recogniser over `map`; its indices are built from the map's keyframes. CNN descriptors that
    /// another model made are left out.
    #[must_use]
    pub fn new(
        vocabularies: Arc<VocabularySet>,
        map: PlaceMap,
        model: Option<cnn::ModelCard>,
        options: RecognitionOptions,
    ) -> Self {
        let mut recogniser = Self {
            visits: Visits::new(options.place_interval),
            keyframes: KeyframeIndex::new(vocabularies, options.grow_vocabulary),
            options,
            model,
            map,
            appearances: AppearanceIndex::default(),
        };
        for id in 0..recogniser.map.experiences().len() as u32 {
            recogniser.index(ExperienceId(id));
        }
        recogniser
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

    /// Whether a CNN takes part.
    #[must_use]
    pub fn has_cnn(&self) -> bool {
        self.model.is_some()
    }

    /// Writes everything that was learnt to the medium.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn sync(&mut self) -> Result<(), MapError> {
        self.map.sync()
    }

    /// Recognises one frame: [`retrieve`](Self::retrieve), [`verify`](Self::verify) and
    /// [`decide`](Self::decide) in turn.
    ///
    /// # Errors
    /// If the map cannot be written.
    pub fn recognise(
        &mut self,
        frame: &Frame,
        look: &Look,
        thumbnail_jpeg: impl FnOnce() -> Vec<u8>,
    ) -> Result<Recognition, MapError> {
        let mut candidates = self.retrieve(look);
        let verification = self.verify(look, &mut candidates);
        self.decide(frame, look, (candidates, verification), thumbnail_jpeg)
    }

    /// The places that `look` may show: those the CNN finds most alike, then those that share the most
    /// visual words. Each CNN candidate that cannot be accepted is already marked as rejected.
    pub fn retrieve(&mut self, look: &Look) -> Candidates {
        let mut candidates = Candidates::new();
        if let (Some(model), Some(descriptor)) = (&self.model, &look.appearance) {
            let needed = model.decision.recognise_above;
            for mut candidate in self.appearances.query(descriptor) {
                candidate.rejected = if self.visits.founded_within_interval() == Some(candidate.place) {
                    Some(Rejection::WithinPlaceInterval)
                } else if candidate.score < needed {
                    Some(Rejection::Score { got: candidate.score, needed })
                } else {
                    None
                };
                let _ = candidates.push(candidate);
            }
        }
        candidates.extend(self.retrieve_by_words(look));
        candidates
    }

    fn retrieve_by_words(&mut self, look: &Look) -> Vec<Candidate> {
        let mut candidates: Vec<Candidate> = Vec::with_capacity(MAX_CANDIDATES);
        for keyframe in self.keyframes.query(look, self.visits.founded_within_interval()) {
            let is_known = candidates.iter().any(|candidate| candidate.place == keyframe.place);
            if is_known || candidates.len() == MAX_CANDIDATES {
                continue;
            }
            candidates.push(Candidate {
                place: keyframe.place,
                keyframe: keyframe.experience,
                by: Evidence::BowHv,
                score: keyframe.score,
                inliers: None,
                rejected: None,
            });
        }
        candidates
    }

    /// Verifies the BoW candidates, unless the CNN recognised a place; answers the geometry of the one
    /// with the most effective inliers, if they are enough.
    pub fn verify(&self, look: &Look, candidates: &mut Candidates) -> Option<Verification> {
        if accepted(candidates, Evidence::Cnn).is_some() {
            return None;
        }
        let groups: Vec<u32> = look.quantised.iter().map(|q| q.node.0).collect();
        let query = MatchingView { features: &look.features, groups: &groups };
        let mut best: Option<Verification> = None;
        for candidate in candidates.iter_mut().filter(|candidate| candidate.by == Evidence::BowHv) {
            let verification = self.verify_keyframe((query, look.light.condition), candidate.keyframe);
            let got = verification.effective_inliers;
            candidate.inliers = Some(got);
            if got < self.options.min_inliers {
                candidate.rejected = Some(Rejection::Inliers { got, needed: self.options.min_inliers });
            } else if best.as_ref().is_none_or(|best| got > best.effective_inliers) {
                best = Some(verification);
            }
        }
        best
    }

    fn verify_keyframe(
        &self,
        (query, condition): (MatchingView<'_>, ConditionId),
        keyframe: ExperienceId,
    ) -> Verification {
        let groups = self.keyframes.groups(keyframe, condition);
        let stored = self.map.experience(keyframe).and_then(|experience| experience.keyframe.as_ref());
        let (Some(groups), Some(stored)) = (groups, stored) else { return Verification::default() };
        let view = MatchingView { features: &stored.features, groups };
        verify(query, view, &self.options.verification)
    }

    /// Decides from verified candidates, and adds to the map what was learnt. `thumbnail_jpeg` is asked
    /// for only if the frame is stored.
    ///
    /// # Errors
    /// If the map cannot be written.
    pub fn decide(
        &mut self,
        frame: &Frame,
        look: &Look,
        (mut candidates, verification): (Candidates, Option<Verification>),
        thumbnail_jpeg: impl FnOnce() -> Vec<u8>,
    ) -> Result<Recognition, MapError> {
        let chosen = accepted(&candidates, Evidence::Cnn).or(accepted(&candidates, Evidence::BowHv)).cloned();
        if let Some(chosen) = &chosen {
            mark_outdone(&mut candidates, chosen);
        }
        let mut recognition = self.judge(chosen, candidates, verification);
        if self.options.read_only {
            return Ok(recognition);
        }
        let is_new = recognition.decision == Decision::NewPlace;
        let place = match recognition.place {
            Some(place) => place,
            None => self.map.found_place()?,
        };
        recognition.place = Some(place);
        let is_keyframe = self.visits.is_young(place) && self.is_new_look(&recognition)
            || self.is_in_new_light(place, look.light);
        let id = self.learn(frame, look, (place, is_keyframe), &thumbnail_jpeg())?;
        if is_new {
            recognition.keyframe = Some(id);
        }
        self.visits.move_to(place, is_new);
        Ok(recognition)
    }

    /// The decision, before anything is written. A new place has no number yet.
    fn judge(
        &self,
        chosen: Option<Candidate>,
        candidates: Candidates,
        verification: Option<Verification>,
    ) -> Recognition {
        let doubt = self.doubt(&candidates);
        let (decision, by, place, confidence) = match (&chosen, self.visits.founded_within_interval()) {
            (Some(chosen), _) => {
                let is_cnn = chosen.by == Evidence::Cnn;
                let decision = if is_cnn { Decision::Recognised } else { Decision::Revisited };
                (decision, Some(chosen.by), Some(chosen.place), self.probability(chosen))
            }
            (None, Some(place)) => {
                (Decision::SamePlace, Some(Evidence::PlaceInterval), Some(place), 1.0 - doubt)
            }
            (None, None) if self.options.read_only => (Decision::Unknown, None, None, 1.0 - doubt),
            (None, None) => (Decision::NewPlace, None, None, 1.0 - doubt),
        };
        Recognition {
            decision,
            by,
            place,
            name: place.and_then(|place| self.map.place(place)).and_then(|place| place.name.clone()),
            keyframe: chosen.as_ref().map(|chosen| chosen.keyframe),
            confidence,
            inliers: chosen.as_ref().and_then(|chosen| chosen.inliers),
            candidates,
            verification,
        }
    }

    /// Probability that one of the rejected candidates is right all the same.
    fn doubt(&self, candidates: &Candidates) -> f32 {
        let likeliest = |by: Evidence| {
            candidates.iter().filter(|c| c.by == by).map(|c| self.probability(c)).reduce(f32::max)
        };
        doubt(likeliest(Evidence::Cnn), likeliest(Evidence::BowHv))
    }

    /// Probability that a candidate shows the same place; the place we are in raises no doubt.
    #[must_use]
    pub fn probability(&self, candidate: &Candidate) -> f32 {
        match (candidate.by, candidate.rejected, &self.model) {
            (_, Some(Rejection::WithinPlaceInterval), _) => 0.0,
            (Evidence::Cnn, _, Some(model)) => model.probability(candidate.score),
            (Evidence::BowHv, _, _) => inlier_probability(candidate.inliers.unwrap_or(0)),
            _ => 0.0,
        }
    }

    /// Whether the frame shows its place as none of the keyframes does. The CNN judges; without one,
    /// whatever BoW+HV did not match is new.
    fn is_new_look(&self, recognition: &Recognition) -> bool {
        let Some(model) = &self.model else { return recognition.decision != Decision::Revisited };
        let known_by_cnn = recognition.candidates.iter().any(|candidate| {
            candidate.by == Evidence::Cnn
                && Some(candidate.place) == recognition.place
                && candidate.score >= model.decision.recognise_above
        });
        !known_by_cnn
    }

    /// Whether the place has no keyframe that may count as the condition yet: a place first seen by day is to
    /// be known by night once it was seen by night.
    fn is_in_new_light(&self, place: PlaceId, light: Light) -> bool {
        let vocabularies = self.keyframes.vocabularies();
        if vocabularies.conditions().count() == 1 {
            return false;
        }
        let experiences = self.map.place(place).into_iter().flat_map(|place| &place.experiences);
        let lights = experiences
            .filter_map(|&id| self.map.experience(id))
            .filter_map(|experience| experience.keyframe.as_ref().and(experience.mean_luminance));
        !lights.into_iter().any(|luminance| vocabularies.may_count_as(light.condition, luminance))
    }

    fn learn(
        &mut self,
        frame: &Frame,
        look: &Look,
        (place, is_keyframe): (PlaceId, bool),
        thumbnail_jpeg: &[u8],
    ) -> Result<ExperienceId, MapError> {
        let appearance = self.model.as_ref().zip(look.appearance.as_ref()).map(|(model, descriptor)| {
            Appearance { model: model.sha256.clone(), descriptor: descriptor.clone() }
        });
        let new = NewExperience {
            frame,
            features: &look.features,
            appearance: appearance.as_ref(),
            mean_luminance: look.light.mean_luminance,
            thumbnail_jpeg,
            is_keyframe,
        };
        let id = self.map.add_experience(place, &new)?;
        self.index(id);
        Ok(id)
    }

    /// Makes an experience findable, if it is a keyframe.
    fn index(&mut self, id: ExperienceId) {
        let Some(experience) = self.map.experience(id) else { return };
        let Some(keyframe) = &experience.keyframe else { return };
        self.keyframes.add(experience.place, id, &keyframe.features);
        if let (Some(model), Some(appearance)) = (&self.model, &keyframe.appearance)
            && appearance.model == model.sha256
        {
            self.appearances.add(experience.place, id, appearance.descriptor.clone());
        }
    }
}

/// The best candidate of this kind that nothing speaks against.
fn accepted(candidates: &Candidates, by: Evidence) -> Option<&Candidate> {
    let open = candidates.iter().filter(|candidate| candidate.by == by && candidate.rejected.is_none());
    open.reduce(|best, next| {
        let better = match by {
            Evidence::BowHv => next.inliers > best.inliers,
            _ => next.score > best.score,
        };
        if better { next } else { best }
    })
}

/// Marks everything but the chosen one as turned down, and puts that first.
fn mark_outdone(candidates: &mut Candidates, chosen: &Candidate) {
    for candidate in candidates.iter_mut().filter(|candidate| *candidate != chosen) {
        candidate.rejected.get_or_insert(Rejection::Outdone { by: chosen.place });
    }
    if let Some(position) = candidates.iter().position(|candidate| candidate == chosen) {
        candidates[..=position].rotate_right(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::{Descriptor, Keypoint};
    use crate::geometry::Point;
    use crate::raster::{GreyImage, RgbImage};
    use crate::vocabulary::{LightSwitch, MemoryCorpus, TrainingOptions, train, train_on};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    const DIMENSIONS: usize = 16;

    /// The features that are seen at a made-up place.
    fn features(place: u64) -> Features {
        let mut random = Pcg64::seed_from_u64(place);
        let mut features = Features { width_px: 640, height_px: 480, ..Features::default() };
        for _ in 0..200 {
            let point = Point { x: random.random_range(0.0..640.0), y: random.random_range(0.0..480.0) };
            features.keypoints.push(Keypoint { point, scale: 1.0, angle_radians: 0.0, response: 20 });
            features.descriptors.push(Descriptor(random.random()));
        }
        features
    }

    /// A CNN descriptor that has nothing in common with that of another look below [`DIMENSIONS`].
    fn appearance(look: usize) -> cnn::Descriptor {
        cnn::Descriptor::from_values((0..DIMENSIONS).map(|i| f32::from(i == look)).collect()).unwrap()
    }

    fn card() -> cnn::ModelCard {
        let text = "
            name = 'test'\nversion = '1'\ndescription = ''\nlicence = ''\nsource = ''\nrecipe = ''
            sha256 = '0000000000000000000000000000000000000000000000000000000000000000'
            input = { name = 'image', width_px = 32, height_px = 32, mean = 0.0, scale = 1.0 }
            descriptor = { name = 'descriptor', dimensions = 16 }
            decision = { recognise_above = 0.8, calibration_slope = 20.0, calibration_offset = -15.0 }
            training = { data = '' }\nmetrics = {}";
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("card.toml");
        std::fs::write(&path, text).unwrap();
        cnn::ModelCard::read(&path).unwrap()
    }

    /// No frame joins a place unasked.
    fn no_interval() -> RecognitionOptions {
        RecognitionOptions { place_interval: 0, ..RecognitionOptions::default() }
    }

    /// A robot in a made-up world.
    struct Robot {
        recogniser: Recogniser,
        light: LightSwitch,
        frames: u64,
    }

    impl Robot {
        fn new(model: Option<cnn::ModelCard>, options: RecognitionOptions, map: PlaceMap) -> Self {
            let images: Vec<Vec<Descriptor>> = (0..8).map(|place| features(place).descriptors).collect();
            let vocabulary =
                train(&images, TrainingOptions { branching: 6, depth: 3, ..TrainingOptions::default() })
                    .unwrap();
            let recogniser = Recogniser::new(Arc::new(vocabulary.into()), map, model, options);
            Self { recogniser, light: LightSwitch::default(), frames: 0 }
        }

        fn with_cnn() -> Self {
            Self::new(Some(card()), no_interval(), PlaceMap::in_memory().unwrap())
        }

        fn without_cnn() -> Self {
            Self::new(None, no_interval(), PlaceMap::in_memory().unwrap())
        }

        /// A robot with two vocabularies, for the light of 40 and of 120.
        fn by_day_and_night() -> Self {
            let vocabulary = |places: std::ops::Range<u64>, luminance: f32| {
                let images: Vec<Vec<Descriptor>> = places.map(|place| features(place).descriptors).collect();
                let corpus = MemoryCorpus { images: &images, mean_luminance: Some(luminance) };
                let options = TrainingOptions { branching: 6, depth: 3, ..TrainingOptions::default() };
                (format!("{luminance}").into(), train_on(&corpus, options, &|_| {}).unwrap().vocabulary)
            };
            let set = VocabularySet::new(vec![vocabulary(0..8, 120.0), vocabulary(100..108, 40.0)]).unwrap();
            let map = PlaceMap::in_memory().unwrap();
            let recogniser = Recogniser::new(Arc::new(set), map, Some(card()), no_interval());
            Self { recogniser, light: LightSwitch::default(), frames: 0 }
        }

        /// Looks at the features of one place and the CNN descriptor of a look, if there is a CNN.
        fn see(&mut self, place: u64, look: usize) -> Recognition {
            self.see_in(120.0, place, look)
        }

        /// The same in a frame of that luminance.
        fn see_in(&mut self, mean_luminance: f32, place: u64, look: usize) -> Recognition {
            let frame = Frame {
                index: self.frames,
                capture_nanos: 0,
                name: String::new(),
                colour: RgbImage::new(1, 1),
                grey: GreyImage::new(1, 1),
                jpeg: None,
                pose: None,
                true_place: None,
            };
            self.frames += 1;
            let appearance = self.recogniser.has_cnn().then(|| appearance(look));
            let vocabularies = self.recogniser.vocabularies();
            let light = self.light.follow(vocabularies, mean_luminance);
            let look = Look::new(features(place), (vocabularies, light), appearance);
            self.recogniser.recognise(&frame, &look, Vec::new).unwrap()
        }

        /// Goes to a place that no test looks at.
        fn leave(&mut self) {
            self.see(7, 15);
        }

        fn keyframes(&self) -> usize {
            self.recogniser.map().summary().keyframes
        }
    }

    #[test]
    fn the_first_frame_founds_a_place_and_the_next_ones_join_it() {
        let options = RecognitionOptions::default();
        let mut robot = Robot::new(Some(card()), options, PlaceMap::in_memory().unwrap());
        assert_eq!(robot.see(0, 0).decision, Decision::NewPlace);
        for look in 1..=5 {
            let joined = robot.see(look as u64, look);
            assert_eq!((joined.decision, joined.place), (Decision::SamePlace, Some(PlaceId(0))));
        }
        assert_eq!(robot.see(6, 6).decision, Decision::NewPlace);
    }

    #[test]
    fn a_known_look_is_recognised_by_the_cnn_before_anything_is_verified() {
        let mut robot = Robot::with_cnn();
        robot.see(0, 0);
        robot.leave();
        let answer = robot.see(3, 0);
        assert_eq!((answer.decision, answer.place), (Decision::Recognised, Some(PlaceId(0))));
        assert_eq!((answer.by, answer.inliers), (Some(Evidence::Cnn), None));
        assert!(answer.confidence > 0.99, "{}", answer.confidence);
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
        assert!(cnn.rejected.unwrap().to_string().ends_with("< 0.800"));
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
        assert_eq!(robot.recogniser.map().places()[0].experiences.len(), 2);
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
    fn one_more_look_in_a_known_light_becomes_no_keyframe() {
        let mut robot = Robot::by_day_and_night();
        robot.see(0, 0);
        robot.leave();
        robot.see_in(40.0, 100, 0);
        let keyframes = robot.keyframes();
        for luminance in [40.0, 60.0, 120.0, 200.0] {
            robot.see_in(luminance, 100, 0);
        }
        assert_eq!(robot.keyframes(), keyframes);
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
            let mut robot = Robot::new(None, options, PlaceMap::in_memory().unwrap());
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
        let mut robot = Robot::new(None, options.clone(), PlaceMap::open(folder.path()).unwrap());
        for place in [20, 21, 20, 22, 23, 21, 24] {
            robot.see(place, 0);
        }
        let before = retrieved(&mut robot.recogniser, 20);
        drop(robot);
        let mut robot = Robot::new(None, options, PlaceMap::open(folder.path()).unwrap());
        assert_eq!(retrieved(&mut robot.recogniser, 20), before);
    }

    #[test]
    fn a_read_only_map_answers_unknown_and_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let mut robot = Robot::new(Some(card()), no_interval(), PlaceMap::open(folder.path()).unwrap());
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

    #[test]
    fn descriptors_of_another_model_are_never_compared() {
        let folder = tempfile::tempdir().unwrap();
        let mut robot = Robot::new(Some(card()), no_interval(), PlaceMap::open(folder.path()).unwrap());
        robot.see(0, 0);
        drop(robot);
        let other = cnn::ModelCard { sha256: "f".repeat(64), ..card() };
        let map = PlaceMap::open(folder.path()).unwrap();
        let mut robot = Robot::new(Some(other), no_interval(), map);
        let answer = robot.see(0, 0);
        assert_eq!(answer.decision, Decision::Revisited, "found by BoW+HV alone");
        assert!(answer.candidates.iter().all(|candidate| candidate.by == Evidence::BowHv));
    }
}
