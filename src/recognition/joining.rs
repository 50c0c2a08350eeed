//! Which places of two maps are one: the keyframes of each are looked up in the other.
//!
//! A wrong join makes two places one for every robot that gets the map; a missed one only leaves a place twice in it.
//! So a place of the other map is joined to one of this map if all of this holds:
//!
//! - **Strong matches**, of at least two of its keyframes or of the only one: geometry with twice the effective
//!   inliers that a match needs, or with just those where the CNN knows the same keyframe. The CNN alone proves
//!   nothing: it tells kinds of places apart, and the floors of a building are of one kind. Which of them it is, the
//!   features say, and that a frame has none is no evidence.
//! - **A majority**: more than half of those of its keyframes that match anything match that place best.
//! - **Both ways**: the keyframes of that place, looked up in the other map, find this one before any other, by strong
//!   matches as above. A majority is not asked of them, since a place may reach over several of the other map.
//! - **Half of one of both**: at least half of the keyframes of either place match the other strongly. Otherwise they
//!   share a view, as neighbours do, or furniture, as the floors of a building do. One of both is enough, since a place
//!   may be larger than its counterpart, or known in more lights.
//!
//! So every place is joined to one at most. Two of the other map that both are found to be one of this map would become
//! one by that, and they may be neighbours that share views, or a place that was founded twice. Of the latter kind the
//! recogniser makes one by itself, but only by several visits to places that were founded far apart; two maps have no
//! visits to show.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

use super::candidate::{Candidate, Evidence};
use super::identity::STRONG;
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
    /// What the keyframes of the other place say, looked up in this map.
    pub there: Support,
    /// What the keyframes of this place say, looked up in the other map.
    pub back: Support,
}

/// How a place's keyframes speak for a place of another map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Support {
    /// Keyframes that match it strongly, and better than any other place.
    pub matched: usize,
    /// All keyframes of the place.
    pub keyframes: usize,
    /// Most effective inliers of a match.
    pub inliers: u32,
    /// Greatest cosine of CNN descriptors that geometry agreed with.
    pub cosine: Option<f32>,
}

/// What a keyframe matches best in another map.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Match {
    place: PlaceId,
    inliers: u32,
    cosine: Option<f32>,
    is_strong: bool,
}

/// What the keyframes of one place match, those left out that match nothing.
#[derive(Clone, Debug, Default)]
struct Findings {
    keyframes: usize,
    matches: Vec<Match>,
}

impl Recogniser {
    /// The places of `other` that are places of this map. Both must search all their places. Nothing is changed;
    /// keyframes that are damaged are left out, which is a [failure of their map](Self::take_map_failure).
    ///
    /// # Errors
    /// If `stop` is set meanwhile, or the medium fails.
    pub fn joins(&mut self, other: &mut Self, stop: &AtomicBool) -> Result<Vec<Join>, MapError> {
        let there = self.look_up(other, stop)?;
        let back = other.look_up(self, stop)?;
        let failure = self.map_failure.take().or_else(|| other.map_failure.take());
        failure.map_or_else(|| Ok(joins_of(&there, &back)), Err)
    }

    /// What the keyframes of every place of `other` match in this map.
    fn look_up(
        &mut self,
        other: &mut Self,
        stop: &AtomicBool,
    ) -> Result<BTreeMap<PlaceId, Findings>, MapError> {
        let mut found: BTreeMap<PlaceId, Findings> = BTreeMap::new();
        let living = other.map.living_places();
        for place in living.map(|place| place.id).collect::<Vec<_>>() {
            let findings = found.entry(place).or_default();
            for keyframe in other.keyframes_of(place) {
                if stop.load(Ordering::Relaxed) {
                    return Err(MapError::Interrupted);
                }
                if other.working_set.is_left_out(keyframe) {
                    continue;
                }
                match self.look_of(&other.map, keyframe) {
                    Ok(look) => {
                        findings.keyframes += 1;
                        findings.matches.extend(self.best_match(&look));
                    }
                    Err(failure) if failure.is_damage() => other.leave_out(keyframe, failure),
                    Err(failure) => return Err(failure),
                }
            }
        }
        Ok(found)
    }

    /// A keyframe of a map as if it were a frame. CNN descriptors of another model are not compared.
    pub(super) fn look_of(&self, map: &PlaceMap, keyframe: ExperienceId) -> Result<Look, MapError> {
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

    /// The match with most inliers, the strong ones first. Geometry is asked of what the CNN is sure of, too.
    fn best_match(&mut self, look: &Look) -> Option<Match> {
        let mut candidates = self.retrieve(look);
        candidates.retain(|candidate| {
            candidate.rejected.is_none() && (candidate.by != Evidence::Cnn || self.is_known_by_cnn(candidate))
        });
        let min_inliers = self.options.min_inliers;
        let matches: Vec<Match> = self.comparing(look, |recogniser, query| {
            let matched = candidates.iter().filter_map(|candidate| {
                let verification = recogniser.verify_keyframe(query, candidate.keyframe);
                judged(candidate, verification.effective_inliers, min_inliers)
            });
            matched.collect()
        });
        // The CNN's candidates come first: of equal ones they say more.
        matches.into_iter().rev().max_by_key(|found| (found.is_strong, found.inliers))
    }
}

/// What so many effective inliers make of a candidate that was retrieved.
fn judged(candidate: &Candidate, inliers: u32, min_inliers: u32) -> Option<Match> {
    let is_known_by_cnn = candidate.by == Evidence::Cnn;
    (inliers >= min_inliers).then_some(Match {
        place: candidate.place,
        inliers,
        cosine: is_known_by_cnn.then_some(candidate.score),
        is_strong: is_known_by_cnn || inliers >= STRONG * min_inliers,
    })
}

impl Findings {
    fn matches_of(&self, place: PlaceId) -> impl Iterator<Item = &Match> {
        self.matches.iter().filter(move |found| found.place == place)
    }

    /// The place that most keyframes match strongly, if they are enough; of two as good ones that with more inliers.
    fn best(&self) -> Option<PlaceId> {
        let mut votes: BTreeMap<PlaceId, (usize, u32)> = BTreeMap::new();
        for found in self.matches.iter().filter(|found| found.is_strong) {
            let (matched, inliers) = votes.entry(found.place).or_default();
            *matched += 1;
            *inliers += found.inliers;
        }
        let (place, (matched, _)) = votes.into_iter().max_by_key(|&(_, vote)| vote)?;
        (matched >= self.keyframes.min(2)).then_some(place)
    }

    /// Whether more than half of the keyframes that match anything match `place`.
    fn mostly_match(&self, place: PlaceId) -> bool {
        2 * self.matches_of(place).count() > self.matches.len()
    }

    fn support(&self, place: PlaceId) -> Support {
        let strong = || self.matches_of(place).filter(|found| found.is_strong);
        Support {
            matched: strong().count(),
            keyframes: self.keyframes,
            inliers: strong().map(|found| found.inliers).max().unwrap_or(0),
            cosine: strong().filter_map(|found| found.cosine).reduce(f32::max),
        }
    }
}

/// The joins by what the places of the other map find in this one, and back.
fn joins_of(there: &BTreeMap<PlaceId, Findings>, back: &BTreeMap<PlaceId, Findings>) -> Vec<Join> {
    let join = |(&other, findings): (&PlaceId, &Findings)| {
        let place = findings.best().filter(|&place| findings.mostly_match(place))?;
        let found_back = back.get(&place).filter(|back| back.best() == Some(other))?;
        let (there, back) = (findings.support(place), found_back.support(other));
        let is_half = |support: Support| 2 * support.matched >= support.keyframes;
        (is_half(there) || is_half(back)).then_some(Join { place, other, there, back })
    };
    there.iter().filter_map(join).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIN_INLIERS: u32 = 8;
    const STRONGLY: u32 = STRONG * MIN_INLIERS;

    /// The findings of a place each of whose keyframes matches a place with so many inliers, if it matches any.
    fn findings(keyframes: &[Option<(u32, u32)>]) -> Findings {
        let candidate = |place| Candidate {
            place: PlaceId(place),
            keyframe: ExperienceId(0),
            by: Evidence::BowHv,
            score: 0.1,
            votes: None,
            inliers: None,
            probability: 0.5,
            rejected: None,
        };
        let found = keyframes.iter().flatten();
        let matches = found.filter_map(|&(place, inliers)| judged(&candidate(place), inliers, MIN_INLIERS));
        Findings { keyframes: keyframes.len(), matches: matches.collect() }
    }

    /// The joins of maps whose places, numbered from 0, find this in each other: place of the other map, place.
    fn joined(there: &[Findings], back: &[Findings]) -> Vec<(u32, u32)> {
        let numbered = |all: &[Findings]| (0..).map(PlaceId).zip(all.iter().cloned()).collect();
        let joins = joins_of(&numbered(there), &numbered(back));
        joins.iter().map(|join| (join.other.0, join.place.0)).collect()
    }

    #[test]
    fn the_cnn_counts_where_geometry_agrees_and_alone_proves_nothing() {
        let by = |by| Candidate {
            place: PlaceId(0),
            keyframe: ExperienceId(0),
            by,
            score: 0.95,
            votes: None,
            inliers: None,
            probability: 0.5,
            rejected: None,
        };
        let is_strong = |evidence, inliers| judged(&by(evidence), inliers, MIN_INLIERS).map(|m| m.is_strong);
        assert_eq!(is_strong(Evidence::Cnn, MIN_INLIERS - 1), None);
        assert_eq!(is_strong(Evidence::Cnn, MIN_INLIERS), Some(true));
        assert_eq!(is_strong(Evidence::BowHv, STRONGLY - 1), Some(false));
        assert_eq!(is_strong(Evidence::BowHv, STRONGLY), Some(true));
    }

    #[test]
    fn two_strong_keyframes_each_way_join_places_and_one_does_not() {
        let strong = |count: usize| {
            findings(&(0..4).map(|i| (i < count).then_some((0, STRONGLY))).collect::<Vec<_>>())
        };
        assert_eq!(joined(&[strong(2)], &[strong(2)]), [(0, 0)]);
        assert_eq!(joined(&[strong(1)], &[strong(2)]), []);
        assert_eq!(joined(&[strong(2)], &[strong(1)]), []);
        let only = findings(&[Some((0, STRONGLY))]);
        assert_eq!(joined(std::slice::from_ref(&only), std::slice::from_ref(&only)), [(0, 0)]);
    }

    #[test]
    fn weak_matches_join_nothing_however_many() {
        let weak = findings(&[Some((0, STRONGLY - 1)); 9]);
        assert_eq!(joined(std::slice::from_ref(&weak), std::slice::from_ref(&weak)), []);
    }

    #[test]
    fn half_of_the_keyframes_that_match_anything_are_no_majority() {
        let back = [findings(&[Some((0, STRONGLY)); 2])];
        let elsewhere = Some((1, MIN_INLIERS));
        let half = findings(&[Some((0, STRONGLY)), Some((0, STRONGLY)), elsewhere, elsewhere, None]);
        assert_eq!(joined(&[half], &back), []);
        let more = findings(&[Some((0, STRONGLY)), Some((0, STRONGLY)), elsewhere, None, None]);
        assert_eq!(joined(&[more], &back), [(0, 0)]);
    }

    #[test]
    fn places_that_share_less_than_half_of_either_are_not_joined() {
        let two_of = |keyframes: usize| {
            findings(&(0..keyframes).map(|i| (i < 2).then_some((0, STRONGLY))).collect::<Vec<_>>())
        };
        assert_eq!(joined(&[two_of(5)], &[two_of(5)]), []);
        assert_eq!(joined(&[two_of(4)], &[two_of(12)]), [(0, 0)]);
        assert_eq!(joined(&[two_of(12)], &[two_of(4)]), [(0, 0)]);
    }

    #[test]
    fn of_two_places_that_find_one_place_only_the_one_that_it_finds_is_joined() {
        let there = [findings(&[Some((0, STRONGLY)); 3]), findings(&[Some((0, STRONGLY)); 3])];
        let found = |first, second| {
            let back = [Some((0, first)), Some((0, first)), Some((1, second)), Some((1, second))];
            joined(&there, &[findings(&back)])
        };
        assert_eq!(found(STRONGLY, STRONGLY + 1), [(1, 0)]);
        assert_eq!(found(STRONGLY + 1, STRONGLY), [(0, 0)]);
    }
}
