//! CNN descriptors computed anew: for a model that is to take over, and for keyframes that the running one did not see.
//!
//! Descriptors of two models are never compared, so a model that takes over needs one of its own of every keyframe.
//! Somebody else computes them, beside the stream, from the thumbnails that a [`Walk`] through the map shows. Here they
//! wait until their model is in use, and then until the map has them. The index of the model before is kept while the
//! new one is on trial, so going back costs nothing.

use std::collections::BTreeMap;

use super::appearance::{ALLOCATION_BYTES, AppearanceIndex};
use super::recogniser::Recogniser;
use crate::cnn::{CompactDescriptor, ModelCard};
use crate::place_map::{Appearance, Experience, ExperienceId, MapError, PlaceId};

/// Keyframes whose records a walk reads at most before it lets the next frame have its turn.
const READ_AT_ONCE: usize = 4;
/// Experiences that a walk passes at most without reading anything.
const PASSED_AT_ONCE: usize = 1024;
/// Descriptors that are written into the map with one frame at most; their keyframes are written again as a whole.
const STORED_AT_ONCE: usize = 2;
/// Share of the memory that descriptors may take which the map does not hold.
const MEMORY_SHARE: usize = 4;

/// A walk through the keyframes of a map, for those that have no descriptor of a model.
#[derive(Debug)]
pub struct Walk {
    model: String,
    /// The experience to be looked at next; `None` once all were.
    next: Option<ExperienceId>,
}

impl Walk {
    /// A walk for the model of this hash, from the oldest keyframe on.
    #[must_use]
    pub fn new(model: String) -> Self {
        Self { model, next: Some(ExperienceId(0)) }
    }

    /// Hash of the model.
    #[must_use]
    pub fn model(&self) -> &str {
        &self.model
    }

    /// Whether every keyframe was looked at.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.next.is_none()
    }
}

/// A keyframe that is to be described.
#[derive(Clone, Debug, PartialEq)]
pub struct Exhibit {
    /// Which.
    pub keyframe: ExperienceId,
    /// The place that it shows.
    pub place: PlaceId,
    /// The places next to that one, which it may show, too.
    pub neighbours: Vec<PlaceId>,
    /// What there is to be described: the bytes of a JPEG.
    pub thumbnail_jpeg: Vec<u8>,
}

/// A descriptor that was not made when its keyframe was learnt.
struct Renewed {
    descriptor: CompactDescriptor,
    /// Whether the map has it.
    is_stored: bool,
}

/// Descriptors computed anew, and the model before.
#[derive(Default)]
pub(super) struct Renewals {
    by_model: BTreeMap<String, BTreeMap<ExperienceId, Renewed>>,
    /// The model before with its index, while the one in use is on trial.
    before: Option<(ModelCard, AppearanceIndex)>,
    /// The map has no room for what is written again.
    is_map_full: bool,
}

impl Renewals {
    pub(super) fn get(&self, model: &str, keyframe: ExperienceId) -> Option<&CompactDescriptor> {
        Some(&self.by_model.get(model)?.get(&keyframe)?.descriptor)
    }

    /// Nothing is searched with the keyframe for now.
    pub(super) fn forget(&mut self, keyframe: ExperienceId) {
        if let Some((_, index)) = &mut self.before {
            index.remove(keyframe);
        }
    }

    /// The map has given the keyframe up.
    pub(super) fn give_up(&mut self, keyframe: ExperienceId) {
        self.by_model.values_mut().for_each(|renewed| drop(renewed.remove(&keyframe)));
    }

    /// From now on the keyframe is one of `place`.
    pub(super) fn rename(&mut self, keyframe: ExperienceId, place: PlaceId) {
        if let Some((_, index)) = &mut self.before {
            index.rename(keyframe, place);
        }
    }

    /// Bytes of memory that they take, roughly; nodes of trees are two thirds full.
    pub(super) fn memory_bytes(&self) -> usize {
        let entry_bytes = size_of::<(ExperienceId, Renewed)>() * 3 / 2 + ALLOCATION_BYTES;
        let bytes = |renewed: &BTreeMap<ExperienceId, Renewed>| {
            let first = renewed.first_key_value();
            renewed.len() * first.map_or(0, |(_, first)| first.descriptor.values().len() + entry_bytes)
        };
        let before_bytes = self.before.as_ref().map_or(0, |(_, index)| index.memory_bytes());
        self.by_model.values().map(bytes).sum::<usize>() + before_bytes
    }
}

impl Recogniser {
    /// The next keyframe of the walk that has a thumbnail but no descriptor of the walk's model. `None` if the walk is
    /// over, or if so many keyframes need none that the next frame is to have its turn. Where memory has no room for
    /// more descriptors, the walk ends early.
    pub fn walk_on(&mut self, walk: &mut Walk) -> Option<Exhibit> {
        if self.renewals.memory_bytes() > self.budget_bytes() / MEMORY_SHARE {
            walk.next = None;
        }
        let mut read = 0;
        for _ in 0..PASSED_AT_ONCE {
            let ahead = self.map.experiences_from(walk.next?).next().copied();
            walk.next = ahead.and_then(|experience| experience.id.0.checked_add(1)).map(ExperienceId);
            let experience = ahead?;
            if !experience.is_keyframe || self.is_described(experience.id, &walk.model) {
                continue;
            }
            if let Some(exhibit) = self.exhibit(&experience, &walk.model) {
                return Some(exhibit);
            }
            read += 1;
            if read == READ_AT_ONCE {
                break;
            }
        }
        None
    }

    fn is_described(&self, keyframe: ExperienceId, model: &str) -> bool {
        let is_in_use = self.model.as_ref().is_some_and(|in_use| in_use.sha256 == model);
        is_in_use && self.appearances.contains(keyframe)
            || self.renewals.get(model, keyframe).is_some()
            || self.working_set.is_left_out(keyframe)
    }

    /// The keyframe as it is to be described, unless the map has a descriptor of the model: that is taken over. What
    /// cannot be read is not described; whoever searches with it says so.
    fn exhibit(&mut self, experience: &Experience, model: &str) -> Option<Exhibit> {
        let keyframe = experience.id;
        let stored = self.map.traits(keyframe).ok()?.appearance;
        if let Some(appearance) = stored.filter(|appearance| appearance.model == model) {
            self.take_renewed(keyframe, appearance, true);
            return None;
        }
        let thumbnail_jpeg = self.map.thumbnail_jpeg(keyframe).ok().filter(|jpeg| !jpeg.is_empty())?;
        let place = self.map.place(experience.learnt_as)?;
        Some(Exhibit { keyframe, place: place.id, neighbours: place.neighbours.clone(), thumbnail_jpeg })
    }

    /// Takes a keyframe's descriptor that was computed anew. The model may be one that is to be used later.
    pub fn renew(&mut self, keyframe: ExperienceId, appearance: Appearance) {
        self.take_renewed(keyframe, appearance, false);
    }

    fn take_renewed(&mut self, keyframe: ExperienceId, appearance: Appearance, is_stored: bool) {
        let Some(&Experience { learnt_as, is_keyframe: true, .. }) = self.map.experience(keyframe) else {
            return;
        };
        let Some(place) = self.map.place(learnt_as).map(|place| place.id) else { return };
        let Appearance { model, descriptor } = appearance;
        let is_in_use = self.model.as_ref().is_some_and(|in_use| in_use.sha256 == model);
        if is_in_use && self.keyframes.contains(keyframe) {
            self.appearances.add(place, keyframe, descriptor.clone());
        }
        // Of the model in use, what waits is read from the map when it comes in.
        if !(is_in_use && is_stored) {
            let renewed = Renewed { descriptor, is_stored };
            self.renewals.by_model.entry(model).or_default().insert(keyframe, renewed);
        }
    }

    /// The descriptors that were computed for the model of this hash are of no use any more.
    pub fn forget_renewed(&mut self, model: &str) {
        self.renewals.by_model.remove(model);
    }

    /// From now on frames are described by the model of `card`, and compared with what was [renewed](Self::renew) for
    /// it: answers how many keyframes that is, or `None` if it is in use already or no CNN takes part. The model before
    /// stays at hand until [this one is settled](Self::settle_model); going back to it gives back what it knew.
    pub fn use_model(&mut self, card: &ModelCard) -> Option<usize> {
        self.model.as_ref().filter(|in_use| in_use.sha256 != card.sha256)?;
        let (index, goes_back) = match self.renewals.before.take() {
            Some((before, index)) if before.sha256 == card.sha256 => (index, true),
            _ => (self.index_renewed(&card.sha256), false),
        };
        let known = match self.renewals.by_model.get(&card.sha256) {
            Some(renewed) if !goes_back => renewed.len(),
            _ => index.len(),
        };
        let index_before = std::mem::replace(&mut self.appearances, index);
        if index_before.keeps_similarities() {
            self.appearances.keep_similarities();
        }
        let model_before = self.model.replace(card.clone());
        self.renewals.before = model_before.filter(|_| !goes_back).map(|model| (model, index_before));
        Some(known)
    }

    /// What was renewed for a model, of the keyframes that are searched.
    fn index_renewed(&self, model: &str) -> AppearanceIndex {
        let mut index = AppearanceIndex::default();
        for (&keyframe, renewed) in self.renewals.by_model.get(model).into_iter().flatten() {
            let learnt_as = self.map.experience(keyframe).map(|experience| experience.learnt_as);
            let place = learnt_as.and_then(|place| self.map.place(place));
            if let Some(place) = place.filter(|_| self.keyframes.contains(keyframe)) {
                index.add(place.id, keyframe, renewed.descriptor.clone());
            }
        }
        index
    }

    /// The model in use has proved itself: nobody goes back to the one before.
    pub fn settle_model(&mut self) {
        let Some((before, _)) = self.renewals.before.take() else { return };
        self.renewals.by_model.remove(&before.sha256);
        let in_use = self.model.as_ref().and_then(|model| self.renewals.by_model.get_mut(&model.sha256));
        if let Some(renewed) = in_use {
            renewed.retain(|_, renewed| !renewed.is_stored);
        }
    }

    /// Writes a few of the descriptors that were computed anew into the map, unless it is only read or the model in use
    /// is on trial. A map that is full keeps what it has.
    pub fn store_renewed(&mut self) {
        if self.options.read_only || self.renewals.before.is_some() || self.renewals.is_map_full {
            return;
        }
        let in_use = self.model.as_ref().map(|model| &model.sha256);
        let Some((model, renewed)) = in_use.and_then(|model| self.renewals.by_model.get_key_value(model))
        else {
            return;
        };
        let model = model.clone();
        let appearance =
            |renewed: &Renewed| Appearance { model: model.clone(), descriptor: renewed.descriptor.clone() };
        let next = renewed.iter().take(STORED_AT_ONCE).map(|(&id, renewed)| (id, appearance(renewed)));
        let next: Vec<(ExperienceId, Appearance)> = next.collect();
        if next.is_empty() {
            self.renewals.by_model.remove(&model);
            return;
        }
        match self.map.renew_appearances(&next) {
            Ok(given_up) => {
                if let Some(renewed) = self.renewals.by_model.get_mut(&model) {
                    next.iter().for_each(|(id, _)| drop(renewed.remove(id)));
                }
                given_up.into_iter().for_each(|keyframe| self.give_up(keyframe));
            }
            Err(failure) => {
                self.forget_given_up();
                match failure {
                    MapError::Full { .. } => self.renewals.is_map_full = true,
                    failure => self.read_only_because(failure),
                }
            }
        }
    }
}
