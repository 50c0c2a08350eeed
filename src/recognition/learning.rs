//! What the recogniser learns: which frames become keyframes, and how they become findable.

use super::look::Look;
use super::recogniser::Recogniser;
use super::{Decision, Recognition};
use crate::feature::Features;
use crate::frame::Frame;
use crate::kernel::difference_hash;
use crate::place_map::{
    Appearance, Experience, ExperienceId, Learnt, MapError, NewExperience, PlaceId, Traits,
};
use crate::vocabulary::Light;

/// Grey levels by which a frame's mean luminance differs from that of all keyframes of its place where it becomes one.
const OTHER_LIGHT_LUMINANCE: f32 = 16.0;
/// Least probability of a place that gets a keyframe for its light.
const SURE: f32 = 0.9;
/// Probability of another place from which a frame that joins one unasked becomes no keyframe.
const LIKELY_OTHER: f32 = 0.1;

impl Recogniser {
    /// Whether the frame shows its place as none of the keyframes does. The CNN judges; without one, whatever BoW+HV
    /// did not match is new. Where the place was taken for known by what was seen before, or another one is likely,
    /// too, no frame becomes a keyframe.
    pub(super) fn is_new_look(&self, recognition: &Recognition) -> bool {
        let is_doubtful = match recognition.decision {
            Decision::Recognised | Decision::Revisited => {
                recognition.inliers < Some(self.options.min_inliers)
            }
            _ => recognition.candidates.iter().any(|candidate| {
                Some(candidate.place) != recognition.place && candidate.probability > LIKELY_OTHER
            }),
        };
        if is_doubtful || self.model.is_none() {
            return !is_doubtful && recognition.decision != Decision::Revisited;
        }
        !recognition
            .candidates
            .iter()
            .any(|candidate| Some(candidate.place) == recognition.place && self.is_known_by_cnn(candidate))
    }

    /// Whether a place that is known for sure has no keyframe in this light yet: by these, dusk links the day to the
    /// night. Only light makes a keyframe of a frame late in a visit, so a place does not grow along with the robot.
    pub(super) fn is_in_new_light(&self, (place, confidence): (PlaceId, f32), light: Light) -> bool {
        let vocabularies = self.keyframes.vocabularies();
        let experiences = self.map.place(place).into_iter().flat_map(|place| &place.experiences);
        let keyframes = experiences.filter_map(|&id| self.map.experience(id)).filter(|e| e.is_keyframe);
        let mut lights = keyframes.filter_map(|keyframe| keyframe.mean_luminance);
        let is_alike = |luminance: f32| {
            (luminance - light.mean_luminance).abs() < OTHER_LIGHT_LUMINANCE
                && vocabularies.may_count_as(light.condition, luminance)
        };
        confidence >= SURE && !lights.any(is_alike)
    }

    /// Adds the frame to `place`, or to a new one, and makes it findable if it is a keyframe.
    pub(super) fn learn(
        &mut self,
        frame: &Frame,
        look: &Look,
        (place, is_keyframe): (Option<PlaceId>, bool),
        thumbnail_jpeg: &[u8],
    ) -> Result<Learnt, MapError> {
        let features = is_keyframe.then(|| look.features.foremost(self.options.keyframe_features));
        let keyframe = features.map(|features| {
            let words = self.keyframes.words_of(&features);
            (features, Traits { words, appearance: self.appearance(look) })
        });
        let new = NewExperience {
            frame,
            view: difference_hash(&frame.grey),
            mean_luminance: look.light.mean_luminance,
            thumbnail_jpeg,
            keyframe: keyframe.as_ref().map(|(features, traits)| (features, traits)),
        };
        let learnt = self.map.learn(place, &new)?;
        learnt.given_up.iter().for_each(|&given_up| self.give_up(given_up));
        if let (Some(experience), Some((features, traits))) = (learnt.experience, keyframe) {
            self.make_findable((learnt.place, experience), traits, Some(&features))?;
        }
        Ok(learnt)
    }

    /// Makes a keyframe not findable any more.
    pub(super) fn forget(&mut self, keyframe: ExperienceId) {
        self.keyframes.remove(keyframe);
        self.appearances.remove(keyframe);
        self.renewals.forget(keyframe);
    }

    /// The map has given a keyframe up.
    pub(super) fn give_up(&mut self, keyframe: ExperienceId) {
        self.forget(keyframe);
        self.renewals.give_up(keyframe);
    }

    /// Forgets the keyframes that the map has given up; a change that failed half-way does not say which.
    pub(super) fn forget_given_up(&mut self) {
        let is_gone = |keyframe: &ExperienceId| self.map.experience(*keyframe).is_none();
        let gone: Vec<ExperienceId> = self.keyframes.experiences().filter(is_gone).collect();
        gone.into_iter().for_each(|keyframe| self.give_up(keyframe));
    }

    fn appearance(&self, look: &Look) -> Option<Appearance> {
        let (model, descriptor) = self.model.as_ref().zip(look.appearance.as_ref())?;
        Some(Appearance { model: model.sha256.clone(), descriptor: descriptor.into() })
    }

    /// Makes a keyframe of the map findable; one whose words are indexed already, by the CNN.
    pub(super) fn index(&mut self, id: ExperienceId) -> Result<(), MapError> {
        let Some(&Experience { learnt_as, .. }) = self.map.experience(id) else { return Ok(()) };
        let Some(place) = self.map.place(learnt_as).map(|place| place.id) else { return Ok(()) };
        if self.keyframes.contains(id) {
            if self.has_cnn() {
                let appearance = self.map.traits(id)?.appearance;
                self.make_known((place, id), appearance);
            }
            return Ok(());
        }
        let traits = self.map.traits(id)?;
        self.make_findable((place, id), traits, None)
    }

    /// The keyframe's features, if they are not given, are read only if the words of `traits` are not enough.
    fn make_findable(
        &mut self,
        keyframe: (PlaceId, ExperienceId),
        traits: Traits,
        features: Option<&Features>,
    ) -> Result<(), MapError> {
        if self.keyframes.is_satisfied_by(&traits.words) {
            self.keyframes.add(keyframe, &traits.words);
        } else {
            let read = features.is_none().then(|| self.map.features(keyframe.1)).transpose()?;
            if let Some(features) = features.or(read.as_ref()) {
                self.keyframes.add_growing(keyframe, features);
            }
        }
        self.make_known(keyframe, traits.appearance);
        Ok(())
    }

    /// Has the CNN know a keyframe, if it has a descriptor of its model.
    fn make_known(&mut self, (place, keyframe): (PlaceId, ExperienceId), stored: Option<Appearance>) {
        let Some(model) = &self.model else { return };
        let descriptor = match stored {
            Some(Appearance { model: maker, descriptor }) if maker == model.sha256 => Some(descriptor),
            stored => {
                let renewed = self.renewals.get(&model.sha256, keyframe).cloned();
                self.foreign_descriptors += usize::from(stored.is_some() && renewed.is_none());
                renewed
            }
        };
        if let Some(descriptor) = descriptor {
            self.appearances.add(place, keyframe, descriptor);
        }
    }
}
