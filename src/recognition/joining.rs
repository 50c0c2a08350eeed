//! Which places of two maps are one: every keyframe of the one is recognised in the other.

use std::collections::BTreeMap;

use super::candidate::{Candidate, Evidence};
use super::look::Look;
use super::recogniser::Recogniser;
use crate::cnn;
use crate::place_map::{ExperienceId, MapError, PlaceId, PlaceMap};
use crate::vocabulary::Light;

/// A place of another map that is a place of this one, and what says so.
#[derive(Clone, Debug, PartialEq)]
pub struct Join {
    /// The place in this map.
    pub place: PlaceId,
    /// The place in the other one.
    pub other: PlaceId,
    /// Keyframes of the other place that were recognised as this one.
    pub matched: usize,
    /// Keyframes of the other place.
    pub keyframes: usize,
    /// Most effective inliers of a match, if geometry was asked.
    pub inliers: Option<u32>,
    /// Greatest cosine of CNN descriptors that was accepted.
    pub cosine: Option<f32>,
}

/// What the keyframes of a place say for one place of this map.
#[derive(Default)]
struct Votes {
    matched: usize,
    inliers: Option<u32>,
    cosine: Option<f32>,
}

impl Recogniser {
    /// The places of `other` that are places of this map: those of which two keyframes at least, or the only one,
    /// are recognised as the same place, and more than as any other. Nothing is changed.
    ///
    /// # Errors
    /// If a keyframe cannot be read.
    pub fn joins(&mut self, other: &PlaceMap) -> Result<Vec<Join>, MapError> {
        let mut joins = Vec::new();
        for place in other.places().filter(|place| place.merged_into.is_none()) {
            let is_keyframe = |id: &&ExperienceId| other.experience(**id).is_some_and(|e| e.is_keyframe);
            let keyframes: Vec<ExperienceId> =
                place.experiences.iter().filter(is_keyframe).copied().collect();
            let mut votes: BTreeMap<PlaceId, Votes> = BTreeMap::new();
            for &keyframe in &keyframes {
                let look = self.look_of(other, keyframe)?;
                if let Some(found) = self.find(&look) {
                    votes.entry(found.place).or_default().add(&found);
                }
            }
            if let Some((&found, votes)) =
                most(&votes).filter(|(_, votes)| votes.matched >= keyframes.len().min(2))
            {
                let &Votes { matched, inliers, cosine } = votes;
                let (other, keyframes) = (place.id, keyframes.len());
                joins.push(Join { place: found, other, matched, keyframes, inliers, cosine });
            }
        }
        self.take_map_failure().map_or(Ok(joins), Err)
    }

    /// A keyframe of another map as if it were a frame. CNN descriptors of another model are not compared.
    fn look_of(&self, map: &PlaceMap, keyframe: ExperienceId) -> Result<Look, MapError> {
        let vocabularies = self.vocabularies();
        let mean_luminance = map.experience(keyframe).and_then(|experience| experience.mean_luminance);
        let light = mean_luminance.map_or(Light::default(), |mean_luminance| Light {
            condition: vocabularies.nearest(mean_luminance),
            mean_luminance,
        });
        let model = self.model.as_ref().map(|model| model.sha256.as_str());
        let appearance = map.traits(keyframe)?.appearance.filter(|a| Some(a.model.as_str()) == model);
        let descriptor = appearance.and_then(|appearance| {
            let values = appearance.descriptor.values().iter().map(|&value| f32::from(value)).collect();
            cnn::Descriptor::from_values(values)
        });
        Ok(Look::new(map.features(keyframe)?, (vocabularies, light), descriptor))
    }

    /// What the look is recognised as.
    fn find(&mut self, look: &Look) -> Option<Candidate> {
        let mut candidates = self.retrieve(look);
        self.verify(look, &mut candidates);
        let accepted = candidates.into_iter().filter(|candidate| candidate.rejected.is_none());
        accepted.reduce(|best, next| {
            // What the CNN accepts comes before what geometry does, as in the decision.
            let rank = |candidate: &Candidate| (candidate.by == Evidence::Cnn, candidate.inliers);
            match rank(&next).cmp(&rank(&best)) {
                std::cmp::Ordering::Greater => next,
                std::cmp::Ordering::Equal if next.score > best.score => next,
                _ => best,
            }
        })
    }
}

impl Votes {
    fn add(&mut self, found: &Candidate) {
        self.matched += 1;
        self.inliers = self.inliers.max(found.inliers);
        if found.by == Evidence::Cnn {
            self.cosine = Some(self.cosine.map_or(found.score, |cosine| cosine.max(found.score)));
        }
    }
}

/// The place with most votes, if there is but one.
fn most(votes: &BTreeMap<PlaceId, Votes>) -> Option<(&PlaceId, &Votes)> {
    let best = votes.iter().max_by_key(|(_, votes)| votes.matched)?;
    let is_alone = votes.values().filter(|votes| votes.matched == best.1.matched).count() == 1;
    is_alone.then_some(best)
}
