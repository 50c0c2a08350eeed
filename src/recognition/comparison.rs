//! Frames compared with keyframes by geometry.

use std::mem;

use super::candidate::{Candidates, Evidence, Verifications};
use super::look::Look;
use super::recogniser::Recogniser;
use crate::feature::Features;
use crate::place_map::{ExperienceId, FeatureReader};
use crate::verification::{MatchingView, Verification, Verifier};
use crate::vocabulary::ConditionId;

/// Memory of comparisons, from one to the next.
#[derive(Default)]
pub(super) struct Comparer {
    query_groups: Vec<u32>,
    keyframe_groups: Vec<u32>,
    reader: FeatureReader,
    verifier: Verifier,
}

impl Recogniser {
    /// Verifies the candidates that share visual words; answers the geometry of each, in their order.
    pub fn verify(&mut self, look: &Look, candidates: &mut Candidates) -> Verifications {
        self.comparing(look, |recogniser, query| {
            let by_words = candidates.iter_mut().filter(|candidate| candidate.by == Evidence::BowHv);
            let verified = by_words.map(|candidate| {
                let verification = recogniser.verify_keyframe(query, candidate.keyframe);
                candidate.votes = Some(verification.votes);
                candidate.inliers = Some(verification.effective_inliers);
                verification
            });
            verified.collect()
        })
    }

    /// Does something with `look` as geometry sees it.
    pub(super) fn comparing<T>(
        &mut self,
        look: &Look,
        compare: impl FnOnce(&mut Self, (MatchingView<'_>, ConditionId)) -> T,
    ) -> T {
        // Taken, so that the recogniser can be asked meanwhile.
        let mut groups = mem::take(&mut self.comparer.query_groups);
        groups.clear();
        groups.extend(look.groups());
        let query = MatchingView { features: &look.features, groups: &groups };
        let answer = compare(self, (query, look.light.condition));
        self.comparer.query_groups = groups;
        answer
    }

    /// The geometry between a query seen in a light and a keyframe. One that cannot be read matches nothing, and is not
    /// asked again: its failure is said once.
    pub(super) fn verify_keyframe(
        &mut self,
        query: (MatchingView<'_>, ConditionId),
        keyframe: ExperienceId,
    ) -> Verification {
        // Taken, so that the recogniser can be asked meanwhile.
        let mut reader = mem::take(&mut self.comparer.reader);
        let verification = match self.map.read_features(keyframe, &mut reader) {
            Ok(features) => self.geometry(query, features),
            Err(failure) => {
                self.keyframes.remove(keyframe);
                self.leave_out(keyframe, failure);
                Verification::default()
            }
        };
        self.comparer.reader = reader;
        verification
    }

    /// The geometry between a query seen in a light and the features of a keyframe.
    pub(super) fn geometry(
        &mut self,
        (query, condition): (MatchingView<'_>, ConditionId),
        features: &Features,
    ) -> Verification {
        let Self { keyframes, comparer: Comparer { keyframe_groups, verifier, .. }, options, .. } = self;
        let vocabulary = keyframes.vocabularies().vocabulary(condition);
        vocabulary.groups_into(&features.descriptors, keyframe_groups);
        let keyframe = MatchingView { features, groups: keyframe_groups };
        let mut found = self.spare.verification();
        verifier.verify((query, keyframe), &options.verification, &mut found);
        found
    }
}
