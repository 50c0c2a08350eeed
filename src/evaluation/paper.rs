//! The protocol of the paper's Tables I and II: BoW+HV forms clusters on one traverse, the largest of
//! them are the classes of a CNN classifier, and another traverse is rated with it.
//!
//! The paper defines neither which frames are in the denominator nor when a frame is right. Here every
//! scored frame of the test traverse is, and it is right when the class it was put into holds a training
//! frame of the same place. There is no unknown class, so a frame of a place that is in no class is
//! always wrong.

use std::sync::atomic::AtomicBool;

use super::EvaluationError;
use super::experiment::share_of;
use super::ground_truth::Relation;
use super::map::{Robot, RobotOptions};
use super::results::{Method, PaperProtocol, PublishedRow};
use super::scene::Scene;
use super::traverse::Eyes;
use crate::cnn::Descriptor;
use crate::proportion::Proportion;
use crate::recognition::RecognitionOptions;

/// Fewest frames of a cluster that becomes a class.
const MIN_CLASS_FRAMES: usize = 20;
/// Most classes: as many as the paper had.
const MAX_CLASSES: usize = 29;
/// δ_ep of the paper's first experiment, in sampled frames.
const PLACE_INTERVAL: u32 = 12;

/// Table II, the CNN trained on 100909_0845.
const TABLE_2: [PublishedRow; 6] = [
    row("180809_1545", 18.97, 1.07),
    row("190809_0845", 19.62, 24.91),
    row("190809_1410", 21.20, 0.12),
    row("210809_1000", 24.56, 22.48),
    row("210809_1210", 28.11, 11.26),
    row("mean of five traverses", 22.49, 11.97),
];

const fn row(traverse: &'static str, cnn_percent: f64, bow_hv_percent: f64) -> PublishedRow {
    PublishedRow { traverse, cnn_percent, bow_hv_percent, classes: 29, training_percent: 26.2 }
}

/// What the protocol fixes, by name.
pub(super) fn settings() -> [(String, String); 3] {
    [
        ("paper.place_interval".to_owned(), PLACE_INTERVAL.to_string()),
        ("paper.min_class_frames".to_owned(), MIN_CLASS_FRAMES.to_string()),
        ("paper.max_classes".to_owned(), MAX_CLASSES.to_string()),
    ]
}

/// Follows the protocol.
pub(super) fn protocol(
    scene: &Scene<'_>,
    eyes: &Eyes,
    options: &RobotOptions,
    stop: &AtomicBool,
) -> Result<PaperProtocol, EvaluationError> {
    let recognition = RecognitionOptions { place_interval: PLACE_INTERVAL, ..options.recognition.clone() };
    let options = RobotOptions { recognition, map: options.map };
    let mut robot = Robot::new(Method::BowHv, eyes, &options)?;
    robot.walk(scene.reference, stop)?;
    let clusters = robot.places();
    let by_bow_hv = robot.reading_only()?.walk(scene.query, stop)?.answers;
    let classes = classes(&clusters);
    let held: usize = classes.iter().map(|class| class.len()).sum();
    let means: Vec<Option<Descriptor>> = classes.iter().map(|class| mean(scene, class)).collect();
    let scored: Vec<usize> = (0..scene.query.len()).filter(|&query| scene.truth.is_scored(query)).collect();
    let shows = |query: usize, class: &[usize]| {
        class.iter().any(|&frame| scene.truth.relation(query, frame) == Relation::Same)
    };
    let by_cnn = |&query: &usize| {
        let descriptor = scene.query.observations[query].look.appearance.as_ref();
        let class = descriptor.and_then(|descriptor| nearest(&means, descriptor));
        class.is_some_and(|class| shows(query, classes[class]))
    };
    let matched = |&query: &usize| {
        let answer = &by_bow_hv[query];
        let place = answer.candidates.first().filter(|_| answer.is_given).and_then(|best| best.place);
        place.is_some_and(|place| shows(query, &clusters[place]))
    };
    Ok(PaperProtocol {
        clusters_founded: clusters.len() as u64,
        classes: classes.len() as u64,
        training_share: Proportion::new(held as u64, scene.reference.len() as u64),
        classifier: "nearest class mean of the loaded CNN's descriptors".to_owned(),
        cnn: eyes.model.as_ref().and_then(|_| share_of(scored.iter().map(by_cnn))),
        bow_hv: share_of(scored.iter().map(matched)),
        published: published(&scene.query.name),
    })
}

/// The largest clusters, of equally large ones the first.
fn classes(clusters: &[Vec<usize>]) -> Vec<&[usize]> {
    let mut classes: Vec<&[usize]> =
        clusters.iter().map(Vec::as_slice).filter(|cluster| cluster.len() >= MIN_CLASS_FRAMES).collect();
    classes.sort_by_key(|class| std::cmp::Reverse(class.len()));
    classes.truncate(MAX_CLASSES);
    classes
}

fn mean(scene: &Scene<'_>, class: &[usize]) -> Option<Descriptor> {
    let mut descriptors =
        class.iter().filter_map(|&frame| scene.reference.observations[frame].look.appearance.as_ref());
    let mut sum = descriptors.next()?.as_slice().to_vec();
    for descriptor in descriptors {
        sum.iter_mut().zip(descriptor.as_slice()).for_each(|(sum, value)| *sum += value);
    }
    Descriptor::from_values(sum)
}

fn nearest(means: &[Option<Descriptor>], descriptor: &Descriptor) -> Option<usize> {
    let cosines = means
        .iter()
        .enumerate()
        .filter_map(|(class, mean)| mean.as_ref().map(|mean| (class, descriptor.cosine(mean))));
    cosines.reduce(|best, next| if next.1 > best.1 { next } else { best }).map(|(class, _)| class)
}

/// The paper's row for a traverse of that name, or its mean.
fn published(traverse: &str) -> PublishedRow {
    let row = TABLE_2.iter().find(|row| traverse.contains(row.traverse));
    *row.unwrap_or(&TABLE_2[TABLE_2.len() - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_clusters_of_twenty_frames_become_classes_and_at_most_29_the_largest_first() {
        let clusters: Vec<Vec<usize>> = (0..60).map(|size| vec![0; size]).collect();
        let classes = classes(&clusters);
        assert_eq!(classes.len(), 29);
        assert_eq!((classes[0].len(), classes[28].len()), (59, 31));
        let few = [vec![0; 19], vec![0; 20]];
        assert_eq!(super::classes(&few).len(), 1);
    }

    #[test]
    fn the_row_of_the_paper_is_found_by_the_name_of_the_traverse() {
        assert_eq!(published("190809_1410, left"), row("190809_1410", 21.20, 0.12));
        assert_eq!(published("corridor").traverse, "mean of five traverses");
        let mean = TABLE_2[..5].iter().map(|row| row.cnn_percent).sum::<f64>() / 5.0;
        assert!((mean - TABLE_2[5].cnn_percent).abs() < 0.01);
    }
}
