//! The worst mistakes, as pairs of images with their inliers: what a figure cannot tell.

use super::answer::{Answer, Candidate};
use super::experiment::{Answers, Scene};
use super::frames::groups;
use super::ground_truth::Relation;
use super::judgement::Judged;
use super::results::{ImagePair, Mistake, Picture};
use super::traverse::Observation;
use crate::recognition::RecognitionOptions;
use crate::verification::{MatchingView, Verification, verify};

/// Most mistakes of a kind that are shown.
const MAX_SHOWN: usize = 4;
/// Mistakes that are shown lie at least this share of the traverse apart: neighbours tell the same story.
const MIN_APART: f64 = 0.02;

/// The false accepts of highest and the misses of lowest confidence.
pub(super) fn mistakes(
    scene: &Scene<'_>,
    answers: &Answers,
    judged: &[Judged],
    options: &RecognitionOptions,
) -> Vec<ImagePair> {
    let of_query = |judged: &&Judged| judged.query.is_some();
    let mut accepts: Vec<&Judged> = judged
        .iter()
        .filter(of_query)
        .filter(|judged| judged.is_given && judged.best == Relation::Different)
        .collect();
    accepts.sort_by(|a, b| b.probability.total_cmp(&a.probability).then(a.query.cmp(&b.query)));
    let mut misses: Vec<&Judged> =
        judged.iter().filter(of_query).filter(|judged| judged.is_known && !judged.is_given).collect();
    misses.sort_by(|a, b| a.probability.total_cmp(&b.probability).then(a.query.cmp(&b.query)));
    let mut pairs = Vec::new();
    for query in apart(&accepts, scene.query.len()) {
        let answer = &answers.query[query];
        pairs.extend(answer.candidates.first().map(|best| {
            let reason = best.reason.clone();
            pair(scene, (Mistake::FalseAccept, query, best.reference), (best.probability, reason), options)
        }));
    }
    for query in apart(&misses, scene.query.len()) {
        pairs.extend(miss(scene, answers, query, options));
    }
    pairs
}

/// The first of `mistakes` that lie far enough from each other.
fn apart(mistakes: &[&Judged], frames: usize) -> Vec<usize> {
    let gap = (frames as f64 * MIN_APART).ceil() as usize;
    let mut shown: Vec<usize> = Vec::new();
    for query in mistakes.iter().filter_map(|judged| judged.query) {
        if shown.len() < MAX_SHOWN && shown.iter().all(|&other| query.abs_diff(other) >= gap) {
            shown.push(query);
        }
    }
    shown
}

/// A miss beside the candidate that was right but not accepted; or, where none was right, beside a frame
/// that truly shows the place.
fn miss(
    scene: &Scene<'_>,
    answers: &Answers,
    query: usize,
    options: &RecognitionOptions,
) -> Option<ImagePair> {
    let answer: &Answer = &answers.query[query];
    let is_right =
        |candidate: &&Candidate| scene.truth.relation(query, candidate.reference) == Relation::Same;
    let (reference, reason) = match answer.candidates.iter().find(is_right) {
        Some(candidate) => (candidate.reference, candidate.reason.clone()),
        None => {
            let found = answer.candidates.len();
            let matched = scene.search.matches(query).next()?;
            (matched, format!("no frame of the place among the {found} candidates"))
        }
    };
    let probability = answer.candidates.first().map_or(0.0, |best| best.probability);
    Some(pair(scene, (Mistake::Miss, query, reference), (probability, reason), options))
}

fn pair(
    scene: &Scene<'_>,
    (mistake, query, reference): (Mistake, usize, usize),
    (confidence, reason): (f64, String),
    options: &RecognitionOptions,
) -> ImagePair {
    let query = &scene.query.observations[query];
    let reference = &scene.reference.observations[reference];
    let verification = geometry(query, reference, options);
    let share = |point: crate::geometry::Point, of: &Observation| {
        [point.x / of.look.features.width_px as f32, point.y / of.look.features.height_px as f32]
    };
    let inliers = verification.inliers.iter().map(|&index| {
        let pair = &verification.correspondences[index as usize];
        let (from, to) = (share(pair.query_point.point, query), share(pair.keyframe_point.point, reference));
        [from[0], from[1], to[0], to[1]]
    });
    ImagePair {
        mistake,
        confidence,
        reason,
        effective_inliers: verification.effective_inliers,
        inliers: inliers.collect(),
        query: picture(query),
        reference: picture(reference),
    }
}

fn geometry(query: &Observation, reference: &Observation, options: &RecognitionOptions) -> Verification {
    let (of_query, of_reference) = (groups(&query.look.quantised), groups(&reference.look.quantised));
    verify(
        MatchingView { features: &query.look.features, groups: &of_query },
        MatchingView { features: &reference.look.features, groups: &of_reference },
        &options.verification,
    )
}

fn picture(observation: &Observation) -> Picture {
    Picture {
        name: observation.name.clone(),
        jpeg: observation.picture_jpeg.clone(),
        width_px: observation.size_px.0,
        height_px: observation.size_px.1,
    }
}
