//! What is said of a training, to people and to programs.

use std::path::Path;

use loci::training::{Clusters, DeviceChoice, Epoch, Pictures, Standing, TrainedModel, figure};
use serde::Serialize;

use super::super::console::counted;
use super::arguments::Precision;

/// Widest class of the histogram of cluster sizes.
const HISTOGRAM_STEP: usize = 20;

/// What came of a training.
#[derive(Serialize)]
pub(super) struct Report {
    classes: usize,
    /// Learnt or looked at.
    images: usize,
    small_places: usize,
    duplicates: usize,
    joined_by_pose: usize,
    skipped: usize,
    without_image: usize,
    /// Of places with too few experiences, on which the threshold is fitted, too.
    stranger_images: usize,
    epochs: usize,
    precision: Precision,
    /// What trained.
    device: String,
    held_out: StandingReport,
    held_out_before: StandingReport,
    /// The class means of the backbone or, where there is none, of the model before.
    held_out_untrained: StandingReport,
    accepted: bool,
    /// Why it would not be, or is not.
    fault: Option<String>,
    model: String,
}

/// How a model stands on what was held out.
#[derive(Serialize)]
struct StandingReport {
    images: usize,
    recall: f64,
    /// 95 %, by Wilson's score.
    recall_interval: [f64; 2],
    /// Nothing where nothing is recognised.
    precision: Option<f64>,
    recall_at_one: f64,
}

impl From<&Standing> for StandingReport {
    fn from(standing: &Standing) -> Self {
        Self {
            images: standing.asked,
            recall: standing.recall(),
            recall_interval: standing.recall_interval().into(),
            precision: standing.precision(),
            recall_at_one: standing.recall_at_one(),
        }
    }
}

impl StandingReport {
    fn text(&self) -> String {
        let Self { recall, recall_interval: [low, high], precision, recall_at_one, .. } = self;
        let precision = figure(*precision);
        format!("recall {recall:.3} ({low:.3} to {high:.3}) at precision {precision}; R@1 {recall_at_one:.3}")
    }
}

impl Report {
    pub(super) fn new(
        (clusters, pictures): (&Clusters, &Pictures<'_>),
        (model, epochs): (&TrainedModel, &[Epoch]),
        (precision, device): (Precision, DeviceChoice),
        (folder, accepted): (&Path, bool),
    ) -> Self {
        Self {
            classes: clusters.classes.len(),
            images: pictures.learnt.len() + pictures.checked.len(),
            small_places: clusters.strangers.len(),
            duplicates: clusters.duplicates,
            joined_by_pose: clusters.joined_by_pose,
            skipped: clusters.unreadable.len(),
            without_image: clusters.without_image,
            stranger_images: pictures.strangers.len(),
            epochs: epochs.len(),
            precision,
            device: device.to_string(),
            held_out: (&model.standing).into(),
            held_out_before: (&model.rivals.current).into(),
            held_out_untrained: (&model.rivals.prototypes).into(),
            accepted,
            fault: model.fault(),
            model: folder.display().to_string(),
        }
    }

    pub(super) fn text(&self) -> String {
        format!(
            "held out  {}: {}\nbefore    {}\nuntrained {}\nmodel     {}, {}, trained on {} (its report.html says more)",
            counted(self.held_out.images as u64, "image"),
            self.held_out.text(),
            self.held_out_before.text(),
            self.held_out_untrained.text(),
            self.model,
            self.precision.as_str(),
            self.device
        )
    }
}

/// Says what was left out since there is nothing to see of it.
pub(super) fn report_left_out(clusters: &Clusters) {
    if clusters.without_image > 0 {
        let count = counted(clusters.without_image as u64, "experience");
        eprintln!("loci: left out: {count}, whose image the map gave up before");
    }
    if !clusters.unreadable.is_empty() {
        let count = counted(clusters.unreadable.len() as u64, "experience");
        eprintln!("loci: skipped: {count}, for they cannot be read");
    }
}

/// Says that a model is not accepted for its `fault`, and what became of it.
pub(super) fn report_refusal(fault: &str, (out, aside): (&Path, &Path), is_taken: bool) {
    let (aside, out) = (aside.display(), out.display());
    let advice = match is_taken {
        true => "taken all the same".to_owned(),
        false => format!("kept aside; `mv {aside} {out}` takes it all the same"),
    };
    eprintln!("loci: the model {fault}: {advice}");
}

/// Classes, what was left out, and the sizes of the clusters as a histogram: the paper's Fig. 2.
pub(super) fn described(clusters: &Clusters) -> String {
    let images: usize = clusters.classes.iter().map(|class| class.learnt.len() + class.held_out.len()).sum();
    let (classes, places) = (clusters.classes.len(), clusters.sizes.len());
    let mut text = format!("classes   {classes} of {places} places, {}\n", counted(images as u64, "image"));
    text += &format!(
        "left out  {} with too few, {}; {} joined by pose\n",
        counted(clusters.strangers.len() as u64, "place"),
        counted(clusters.duplicates as u64, "duplicate"),
        clusters.joined_by_pose
    );
    let largest = clusters.sizes.first().copied().unwrap_or_default();
    for from in (0..=largest).step_by(HISTOGRAM_STEP) {
        let within = from..from + HISTOGRAM_STEP;
        let count = clusters.sizes.iter().filter(|&&size| within.contains(&size)).count();
        text += &format!("{from:>6}–{:<4}{} {count}\n", within.end - 1, "▇".repeat(count.min(60)));
    }
    text.trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_nothing_is_recognised_there_is_no_precision() {
        let nothing = Standing { asked: 9, recognised: 0, mistaken: 0, nearest: 3, calibration: None };
        let report = StandingReport::from(&nothing);
        assert!(report.text().contains(" at precision –; R@1 0.333"), "{}", report.text());
        assert_eq!(serde_json::to_value(&report).unwrap()["precision"], serde_json::Value::Null);
        let half = StandingReport::from(&Standing { recognised: 2, mistaken: 2, ..nothing });
        assert!(half.text().contains(" at precision 0.500; "), "{}", half.text());
    }
}
