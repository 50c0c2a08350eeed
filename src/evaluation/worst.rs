//! The worst mistakes, as pairs of images with their inliers: what a figure cannot tell.

use super::answer::Candidate;

use super::frames::geometry;
use super::ground_truth::Relation;
use super::judgement::{Asked, Judged};
use super::results::{ImagePair, Mistake, Picture};
use super::scene::{Answers, Scene};
use super::traverse::{Observation, Traverse};
use crate::recognition::RecognitionOptions;
use crate::vocabulary::VocabularySet;

/// Most mistakes of a kind that are shown.
const MAX_SHOWN: usize = 4;
/// Mistakes that are shown lie at least this share of the traverse apart: neighbours tell the same story.
const MIN_APART: f64 = 0.02;

/// The false accepts of highest and the misses of lowest confidence.
pub(super) fn mistakes(
    scene: &Scene<'_>,
    answers: &Answers,
    judged: &[Judged],
    eyes: (&VocabularySet, &RecognitionOptions),
) -> Vec<ImagePair> {
    let mut accepts: Vec<&Judged> =
        judged.iter().filter(|judged| judged.is_given && judged.best == Relation::Different).collect();
    accepts.sort_by(|a, b| b.confidence.total_cmp(&a.confidence).then(a.asked.cmp(&b.asked)));
    let mut misses: Vec<&Judged> =
        judged.iter().filter(|judged| judged.is_known && !judged.is_given).collect();
    misses.sort_by(|a, b| a.confidence.total_cmp(&b.confidence).then(a.asked.cmp(&b.asked)));
    let accepts = apart(scene, &accepts).into_iter().filter_map(|asked| {
        let answer = answers.of(asked)?;
        let best = answer.candidates.first()?;
        let why = (answer.confidence, best.reason.clone());
        pair(scene, (Mistake::FalseAccept, asked, best.reference), why, eyes)
    });
    let misses = apart(scene, &misses).into_iter().filter_map(|asked| miss(scene, answers, asked, eyes));
    accepts.chain(misses).collect()
}

/// The first of `mistakes` that lie far enough from each other.
fn apart(scene: &Scene<'_>, mistakes: &[&Judged]) -> Vec<Asked> {
    let near = |a: Asked, b: Asked| match (a, b) {
        (Asked::Query(a), Asked::Query(b)) => is_near(a, b, scene.query),
        (Asked::Stranger(a), Asked::Stranger(b)) => {
            scene.unknown.is_some_and(|unknown| is_near(a, b, unknown))
        }
        _ => false,
    };
    let mut shown: Vec<Asked> = Vec::new();
    for mistake in mistakes {
        if shown.len() < MAX_SHOWN && !shown.iter().any(|&other| near(other, mistake.asked)) {
            shown.push(mistake.asked);
        }
    }
    shown
}

fn is_near(a: usize, b: usize, traverse: &Traverse) -> bool {
    a.abs_diff(b) < (traverse.len() as f64 * MIN_APART).ceil() as usize
}

/// A miss beside the candidate that was right but not accepted; or, where none was right, beside a frame
/// that truly shows the place.
fn miss(
    scene: &Scene<'_>,
    answers: &Answers,
    asked: Asked,
    eyes: (&VocabularySet, &RecognitionOptions),
) -> Option<ImagePair> {
    let Asked::Query(query) = asked else { return None };
    let answer = answers.of(asked)?;
    let is_right =
        |candidate: &&Candidate| scene.search.relation(query, candidate, &answers.places) == Relation::Same;
    let (reference, reason) = match answer.candidates.iter().find(is_right) {
        Some(candidate) => (candidate.reference, candidate.reason.clone()),
        None => {
            let found = answer.candidates.len();
            let matched = scene.search.matches(query).next()?;
            (matched, format!("not among the {found} candidates"))
        }
    };
    pair(scene, (Mistake::Miss, asked, reference), (answer.confidence, reason), eyes)
}

fn pair(
    scene: &Scene<'_>,
    (mistake, asked, reference): (Mistake, Asked, usize),
    (confidence, reason): (f64, String),
    eyes: (&VocabularySet, &RecognitionOptions),
) -> Option<ImagePair> {
    let query = scene.observation(asked)?;
    let reference = scene.reference.observations.get(reference)?;
    let (vocabularies, options) = eyes;
    let keyframe = reference.look.features.foremost(options.keyframe_features);
    let verification = geometry(query, &keyframe, (vocabularies, &options.verification));
    let share = |point: crate::geometry::Point, of: &Observation| {
        [point.x / of.look.features.width_px as f32, point.y / of.look.features.height_px as f32]
    };
    let inliers = verification.inliers.iter().map(|&index| {
        let pair = &verification.correspondences[index as usize];
        let (from, to) = (share(pair.query_point.point, query), share(pair.keyframe_point.point, reference));
        [from[0], from[1], to[0], to[1]]
    });
    Some(ImagePair {
        mistake,
        confidence,
        reason,
        effective_inliers: verification.effective_inliers,
        inliers: inliers.collect(),
        query: picture(query),
        reference: picture(reference),
    })
}

fn picture(observation: &Observation) -> Picture {
    Picture {
        name: observation.name.clone(),
        jpeg: observation.picture_jpeg.clone(),
        width_px: observation.size_px.0,
        height_px: observation.size_px.1,
    }
}
