//! A made-up report with everything in it, for the tests of its faces.

use std::collections::BTreeMap;

use crate::evaluation::definitions::DEFINITIONS;
use crate::evaluation::metrics::{
    Calibration, Estimate, PrecisionRecall, PrecisionRecallPoint, ReliabilityBin,
};
use crate::evaluation::results::{
    AnswerRecord, Asset, Baseline, Confusion, Database, Experiment, Figures, GroundTruthSummary, Header,
    ImagePair, Method, MethodResult, Mistake, PaperProtocol, Picture, PublishedRow, Report, SCHEMA,
    StageLatency, TraverseSummary,
};
use crate::proportion::Proportion;

/// A name that would break out of any quotation that is not escaped.
pub(super) const HOSTILE: &str = "a\"'><script>alert(1)</script>|`b` [c](x://d) \u{202e}.jpg";

/// Two experiments: one with all there can be, one with nothing.
pub(super) fn report() -> Report {
    Report {
        schema: SCHEMA,
        header: header(),
        definitions: BTreeMap::from(DEFINITIONS),
        experiments: vec![full(), empty()],
    }
}

fn header() -> Header {
    let settings = [
        ("recognition.threshold", "0.5"),
        ("recognition.min_inliers", "12"),
        ("features.max_keypoints", "1000"),
        ("recognition.place_interval", "10"),
    ];
    Header {
        loci: "0.1.0".into(),
        command: "loci evaluate street --reference summer --query winter --unknown \"old town\"".into(),
        cpu: "Made-up CPU @ 2.00GHz".into(),
        cpu_threads: 4_096,
        backend: "ONNX Runtime 1.32.0, CPU; AVX2 kernels".into(),
        vocabularies: vec![Asset { name: "street.lvoc".into(), sha256: "0123456789abcdef".repeat(4) }],
        model: Some(Asset { name: "places.onnx".into(), sha256: "fedcba9876543210".repeat(4) }),
        suite: Some(Asset { name: "suite.toml".into(), sha256: "89abcdef01234567".repeat(4) }),
        settings: settings.map(|(name, value)| (name.to_owned(), value.to_owned())).into(),
    }
}

/// An experiment that found nothing.
pub(super) fn empty() -> Experiment {
    Experiment {
        name: "A loop against its own past".into(),
        note: None,
        reference: None,
        query: TraverseSummary { name: "loop".into(), frames: 0, skipped: 0 },
        unknown: None,
        ground_truth: GroundTruthSummary {
            definition: "two frames show the same place if their positions are within 5 m".into(),
            sha256: None,
            known: 0,
            unknown: 0,
            unscored: 0,
        },
        settings: BTreeMap::from([("recent_frames".to_owned(), "20".to_owned())]),
        warnings: vec![],
        results: vec![],
        paper: None,
        baselines: vec![],
        latency: vec![],
        peak_memory_bytes: None,
    }
}

fn full() -> Experiment {
    let traverse = |name: &str, frames, skipped| TraverseSummary { name: name.into(), frames, skipped };
    Experiment {
        name: "Winter after summer <along the street>".into(),
        note: Some(
            "The same street half a year later, driven the same way. Summer founds the map; winter is asked about, \
             and 1,204 frames of another town must be refused."
                .into(),
        ),
        reference: Some(traverse("summer", 3_584, 3)),
        query: traverse(HOSTILE, 3_601, 0),
        unknown: Some(traverse("old town", 1_204, 0)),
        ground_truth: GroundTruthSummary {
            definition: "two frames show the same place if they were taken within 10 frames of each other".into(),
            sha256: Some("00112233445566778899aabbccddeeff".repeat(2)),
            known: 3_570,
            unknown: 1_204,
            unscored: 31,
        },
        settings: BTreeMap::from([
            ("sample_interval".to_owned(), "3".to_owned()),
            ("tolerance.frames".to_owned(), "10".to_owned()),
        ]),
        warnings: vec![
            format!("3 frames of the reference could not be read, the first {HOSTILE}"),
            "the vocabulary was trained on frames of this street".into(),
        ],
        results: results(),
        paper: Some(paper()),
        baselines: vec![
            Baseline { method: "NetVLAD (Arandjelović 2016)".into(), figure: "R@1 0.742".into() },
            Baseline { method: "SeqSLAM (Milford 2012)".into(), figure: "AUC 0.81".into() },
        ],
        latency: ["decode", "features", "cnn", "recognition"]
            .into_iter()
            .zip(1_u64..)
            .map(|(stage, k)| StageLatency {
                stage,
                n: 3_601,
                p50_us: 1_234 * k,
                p90_us: 2_345 * k * k,
                p99_us: 1_003_456 * k,
            })
            .collect(),
        peak_memory_bytes: Some(433_061_888),
    }
}

fn paper() -> PaperProtocol {
    PaperProtocol {
        clusters_founded: 1_127,
        classes: 84,
        training_share: Some(proportion(2_998, 3_584)),
        classifier: "logistic regression over the CNN's descriptor".into(),
        cnn: Some(proportion(3_111, 3_601)),
        bow_hv: Some(proportion(2_222, 3_601)),
        published: PublishedRow {
            traverse: "summer, winter",
            cnn_percent: 92.31,
            bow_hv_percent: 61.7,
            classes: 29,
            training_percent: 26.2,
        },
    }
}

fn results() -> Vec<MethodResult> {
    let mut results = Vec::new();
    for database in [Database::Frames, Database::Map] {
        for method in Method::ALL {
            results.push(result(method, database, results.len() as u32));
        }
    }
    results
}

fn result(method: Method, database: Database, index: u32) -> MethodResult {
    let skill = 0.93 - 0.06 * f64::from(index);
    MethodResult {
        method,
        database,
        figures: figures(u64::from(index), skill, database == Database::Map),
        precision_recall: curve(skill),
        calibration: calibration(skill),
        confusion: (database == Database::Map).then(|| confusion(if index == 3 { 48 } else { 181 }, index)),
        worst: if index == 2 { pairs() } else { vec![] },
        answers: answers(database),
    }
}

fn answers(database: Database) -> Vec<AnswerRecord> {
    let given = AnswerRecord {
        query: "winter/000001.jpg".into(),
        is_known: Some(true),
        is_given: true,
        confidence: 0.874_321_4,
        reference: Some("summer/7.jpg".into()),
        place: (database == Database::Map).then_some(3),
        is_right: Some(true),
        reason: "cosine 0.874 ≥ 0.700".into(),
    };
    let silent = AnswerRecord {
        query: HOSTILE.into(),
        is_known: None,
        is_given: false,
        confidence: 0.0,
        reference: None,
        place: None,
        is_right: None,
        reason: "no candidate".into(),
    };
    vec![given, silent]
}

fn figures(index: u64, skill: f64, founds_places: bool) -> Figures {
    let recall_at = |spread: u64| Some(proportion(3_570 - 137 * index - 300 / spread, 3_570));
    let known = (skill * 3_000.0) as u64;
    Figures {
        recognition_rate: Some(proportion(known + 1_100, 4_774)),
        precision: Some(proportion(known, known + 37 * (index + 1))),
        recall: Some(proportion(known, 3_570)),
        keyframe_precision: (index != 1).then(|| proportion(known - 91, known + 37 * (index + 1))),
        recall_at_1: recall_at(1),
        recall_at_5: recall_at(2),
        recall_at_10: recall_at(3),
        auc: Some(estimate(skill + 0.031, 3_570)),
        recall_at_full_precision: Some(proportion(known / 3, 3_570)),
        false_accepts: Some(proportion(17 * index, 1_204)),
        unjudged_answers: Some(7 * index),
        auroc: Some(estimate(skill + 0.042, 4_774)),
        expected_calibration_error: Some(estimate(0.0123 * (index + 1) as f64, 4_774)),
        purity: founds_places.then(|| proportion(3_401, 3_584)),
        false_merges: founds_places.then(|| proportion(12, 3_560)),
        places_founded: founds_places.then_some(1_127),
        true_places: founds_places.then_some(1_181),
    }
}

/// Not Wilson's interval, but one around the rate.
pub(super) fn proportion(successes: u64, n: u64) -> Proportion {
    let rate = successes as f64 / n as f64;
    Proportion { successes, n, rate, low: (rate - 0.0107).max(0.0), high: (rate + 0.0093).min(1.0) }
}

fn estimate(value: f64, n: u64) -> Estimate {
    Estimate { value, n, low: value - 0.0081, high: value + 0.0079 }
}

fn curve(skill: f64) -> PrecisionRecall {
    let point = |step: u32| {
        let share = f64::from(step) / 3_000.0;
        let ripple = 0.012 * (f64::from(step) / 13.0).sin() * share;
        PrecisionRecallPoint {
            threshold: 1.0 - share,
            precision: (1.0 - (1.0 - skill) * 3.0 * share.powi(4) + ripple).clamp(0.0, 1.0),
            recall: skill * share,
        }
    };
    PrecisionRecall { points: (1..=3_000).map(point).collect() }
}

fn calibration(skill: f64) -> Calibration {
    let bin = |index: u32| {
        let low = f64::from(index) / 10.0;
        let n = [812, 401, 96, 0, 88, 151, 204, 377, 891, 1_754][index as usize];
        let right = ((low + 0.07) * skill * n as f64) as u64;
        ReliabilityBin {
            low,
            high: low + 0.1,
            n,
            mean_confidence: (n > 0).then_some(low + 0.052),
            accuracy: (n > 0).then(|| proportion(right, n)),
        }
    };
    Calibration { bins: (0..10).map(bin).collect() }
}

fn confusion(true_places: u32, seed: u32) -> Confusion {
    let mut cells: Vec<(u32, u32, u64)> =
        (0..true_places).map(|place| (place, place, u64::from(3 + place * 7 % 11))).collect();
    cells.extend((0..true_places).step_by(5).map(|place| (place, (place * 31 + seed) % true_places, 1)));
    Confusion { true_places, cells, of_unknown: 12, near_misses: 3 }
}

fn pairs() -> Vec<ImagePair> {
    let pair = |mistake, query: &str, reference: &str, lines: u16| ImagePair {
        mistake,
        query: picture(query),
        reference: picture(reference),
        confidence: 0.874,
        reason: format!("the rival place had 3 inliers fewer than {lines} & < 12"),
        effective_inliers: u32::from(lines) + 1_000,
        inliers: (0..lines)
            .map(|line| {
                let share = f32::from(line) / f32::from(lines);
                [
                    0.1 + 0.8 * share,
                    0.3 + 0.4 * (share * 9.0).sin().abs(),
                    0.15 + 0.75 * share,
                    0.32 + 0.3 * share,
                ]
            })
            .collect(),
    };
    vec![
        pair(Mistake::FalseAccept, "winter/000123.jpg", HOSTILE, 24),
        pair(Mistake::Miss, "winter/002011.jpg", "summer/001987.jpg", 9),
    ]
}

/// Four bytes that begin a JPEG: enough to be passed on.
fn picture(name: &str) -> Picture {
    Picture { name: name.into(), jpeg: vec![0xff, 0xd8, 0xff, 0xe0], width_px: 640, height_px: 480 }
}
