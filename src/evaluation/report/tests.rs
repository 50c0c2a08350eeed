//! What a reader of the reports may rely on.

use super::sample::{HOSTILE, empty, report};
use super::*;
use crate::evaluation::metrics::{PrecisionRecall, PrecisionRecallPoint};
use crate::evaluation::results::Asset;

/// The names of the open tags are balanced, attributes are quoted, and no bare markup is left in text.
/// Panics with what is wrong.
fn assert_well_formed(page: &str) {
    let (_, mut rest) = page.split_once("<!DOCTYPE html>").expect("a doctype");
    let mut open: Vec<&str> = Vec::new();
    while let Some(start) = rest.find('<') {
        assert_text(&rest[..start]);
        let tag = &rest[start + 1..];
        let end = end_of_tag(tag);
        let (inside, after) = (&tag[..end], &tag[end + 1..]);
        rest = after;
        if let Some(name) = inside.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name), "closed in another order");
        } else {
            let name = inside.split([' ', '/']).next().unwrap_or_default();
            assert!(
                !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric()),
                "odd tag <{inside}>"
            );
            if !inside.ends_with('/') {
                open.push(name);
            }
        }
    }
    assert_eq!(open, Vec::<&str>::new(), "left open");
    assert_eq!(rest.trim(), "");
}

/// The `>` that ends a tag: not one within a quoted attribute.
fn end_of_tag(tag: &str) -> usize {
    let mut quoted = false;
    for (index, byte) in tag.bytes().enumerate() {
        match byte {
            b'"' => quoted = !quoted,
            b'<' => panic!("markup within the tag {}", &tag[..index]),
            b'>' if !quoted => return index,
            _ => {}
        }
    }
    panic!("a tag without an end: {tag}")
}

fn assert_text(text: &str) {
    for (index, _) in text.match_indices('&') {
        let entity = text[index..].split(';').next().unwrap_or_default();
        assert!(["&amp", "&lt", "&gt", "&quot", "&apos", "&#39"].contains(&entity), "bare & in {text}");
    }
}

#[test]
fn all_else_that_was_found_stands_in_both_reports() {
    let report = report();
    let hash = "0123456789abcdef".repeat(4);
    let suite_hash = "89abcdef01234567".repeat(4);
    let truth_hash = "00112233445566778899aabbccddeeff".repeat(2);
    let expected = [
        "0.1.0",
        "Made-up CPU",
        "4,096",
        "ONNX Runtime 1.32.0",
        "street.lvoc",
        &hash,
        "places.onnx",
        &truth_hash,
        "recognition.min_inliers",
        "summer",
        "3,584",
        "3,601",
        "old town",
        "1,204",
        "3,570",
        "31",
        "the vocabulary was trained on frames of this street",
        "NetVLAD",
        "AUC 0.81",
        "1,127 / 84",
        "logistic regression",
        "summer, winter",
        "0.923",
        "92.31 %",
        "0.617",
        "61.7 %",
        "1.234",
        "9.380",
        "1,003.456",
        "413.0",
        "two frames show the same place if they were taken within 10 frames of each other",
        "half a year later",
        "unknown frames that were given an answer / unknown frames",
        "suite.toml",
        &suite_hash,
        "tolerance.frames",
        "sample_interval",
        "neighbouring frames are not, so the true intervals are wider",
        "the CNN alone, which compares whole images",
        "the map is searched that Loci founds by itself",
    ];
    let flat = markdown(&report).replace("\n  ", " ").replace('\n', " ");
    let page = html(&report).unwrap();
    for words in expected {
        assert!(page.contains(words), "{words} is not in the page");
        assert!(flat.contains(words), "{words} is not in Markdown");
    }
    for words in ["winter/000123.jpg", "0.874", "1,024 effective inliers", "4 places share", "&amp; &lt; 12"]
    {
        assert!(page.contains(words), "{words} is not in the page");
    }
}

#[test]
fn hostile_names_stay_text() {
    let mut report = report();
    report.header.cpu = HOSTILE.into();
    report.header.command = format!("loci evaluate '{HOSTILE}'");
    report.header.settings.insert(HOSTILE.into(), HOSTILE.into());
    report.header.suite = Some(Asset { name: HOSTILE.into(), sha256: HOSTILE.into() });
    report.experiments[0].settings.insert(HOSTILE.into(), HOSTILE.into());
    report.experiments[0].name = HOSTILE.into();
    report.experiments[1].baselines = report.experiments[0].baselines.clone();
    report.experiments[1].baselines[0].figure = HOSTILE.into();
    let page = html(&report).unwrap();
    assert_well_formed(&page);
    assert!(!page.contains("<script"));
    assert!(page.contains("a&quot;&#39;&gt;&lt;script&gt;alert(1)&lt;/script&gt;"));
    let text = markdown(&report);
    for both in [&page, &text] {
        assert!(!both.contains('\u{202e}'));
    }
    assert_tables_are_even(&text);
    assert!(text.contains("## a\"'>\\<script>alert(1)\\</script>"));
}

#[test]
fn the_page_is_well_formed_and_loads_nothing() {
    let page = html(&report()).unwrap();
    assert_well_formed(&page);
    let without_namespace = page.replace("http://www.w3.org/2000/svg", "");
    for reference in ["http:", "https:", "src=", "url(", "@import", "<script", "<link", "javascript:"] {
        assert!(!without_namespace.contains(reference), "{reference}");
    }
    let hrefs = page.match_indices("href=\"").map(|(index, found)| &page[index + found.len()..]);
    assert!(hrefs.clone().count() > 4);
    assert!(
        hrefs
            .into_iter()
            .all(|target| target.starts_with('#') || target.starts_with("data:image/jpeg;base64,"))
    );
}

#[test]
fn links_within_the_page_lead_somewhere_and_headings_keep_their_order() {
    let page = html(&report()).unwrap();
    for (index, found) in page.match_indices("href=\"#") {
        let target = page[index + found.len()..].split('"').next().unwrap();
        assert_eq!(page.matches(&format!("id=\"{target}\"")).count(), 1, "{target}");
    }
    let mut last = 0;
    for (index, _) in page.match_indices("<h") {
        let Some(level) = page[index + 2..].chars().next().and_then(|c| c.to_digit(10)) else { continue };
        assert!(level <= last + 1, "h{level} after h{last}");
        last = level;
    }
    assert_eq!(page.matches("<h1").count(), 1);
    assert_eq!(page.matches("<table").count(), page.matches("<caption>").count());
}

fn assert_tables_are_even(text: &str) {
    let mut columns = None;
    let mut rows = 0;
    for line in text.lines() {
        if !line.starts_with('|') {
            columns = None;
            continue;
        }
        let bars = line.replace("\\|", "").matches('|').count();
        assert_eq!(*columns.get_or_insert(bars), bars, "{line}");
        rows += 1;
    }
    assert!(rows > 20);
}

#[test]
fn markdown_has_even_tables_and_lines_that_fit() {
    let text = markdown(&report());
    assert_tables_are_even(&text);
    for line in text.lines().filter(|line| !line.starts_with('|')) {
        assert!(line.chars().count() <= 120, "{line}");
    }
    assert!(!text.contains("\n\n\n") && text.ends_with('\n'));
}

#[test]
fn rows_without_a_figure_are_left_out_and_single_gaps_are_dashes() {
    let mut report = report();
    for result in &mut report.experiments[0].results {
        result.figures.auroc = None;
    }
    let (page, text) = (html(&report).unwrap(), markdown(&report));
    assert!(!text.contains("| AUROC") && text.contains("| ECE"));
    assert!(!page.contains(">AUROC</span>") && page.contains(">ECE</span>"));
    // One keyframe precision, one method without unjudged answers, and no places in the frames.
    assert_eq!(page.matches("<td class=\"quiet\">–</td>").count(), 1 + 1 + 3 + 3 + 3);
    let gaps = |title: &str| {
        let row = text.lines().find(|line| line.starts_with(&format!("| {title}"))).unwrap();
        row.split('|').filter(|cell| cell.trim() == "–").count()
    };
    assert_eq!(["Keyframe", "Unjudged", "Purity", "False m", "Places", "ECE"].map(gaps), [1, 1, 3, 3, 3, 0]);
}

#[test]
fn answers_to_frames_of_unknown_places_are_told_beside_the_confusion() {
    let mut report = report();
    let page = html(&report).unwrap();
    assert!(page.contains("answers to frames of known places, over 181 true places"));
    assert!(page.contains("12 more answers were given to frames of unknown places, which have no row."));
    assert!(page.contains(">\nTrue place of the matched keyframe\n</text>"));
    for result in &mut report.experiments[0].results {
        result.confusion.iter_mut().for_each(|confusion| confusion.of_unknown = 1);
    }
    assert!(html(&report).unwrap().contains("1 more answer was given to frames of unknown places"));
}

#[test]
fn what_varies_from_run_to_run_stands_in_its_own_table() {
    let mut slower = report();
    for stage in &mut slower.experiments[0].latency {
        stage.p99_us += 1;
    }
    slower.experiments[0].peak_memory_bytes = Some(1 << 40);
    let (before, after) = (markdown(&report()), markdown(&slower));
    let stable = |text: &str| {
        let (before, timing) = text.split_once("Timing (varies from run to run):").unwrap();
        let rest = timing.trim_start().lines().skip_while(|line| line.starts_with('|'));
        before.to_owned() + &rest.collect::<Vec<_>>().join("\n")
    };
    assert_ne!(before, after);
    assert_eq!(stable(&before), stable(&after));
}

#[test]
fn an_experiment_without_anything_is_shown() {
    let mut report = report();
    report.experiments = vec![empty()];
    let page = html(&report).unwrap();
    assert_well_formed(&page);
    assert!(page.contains("Nothing was counted.") && !page.contains("<figure"));
    assert!(markdown(&report).contains("Nothing was counted."));
    report.experiments.clear();
    report.header.settings.clear();
    report.header.model = None;
    assert_well_formed(&html(&report).unwrap());
    assert!(markdown(&report).contains("| CNN              | –"));
}

#[test]
fn a_curve_of_no_or_one_point_and_odd_bins_do_not_fail() {
    let mut report = report();
    let results = &mut report.experiments[0].results;
    results[0].precision_recall.points.clear();
    results[1].precision_recall = PrecisionRecall {
        points: vec![PrecisionRecallPoint { threshold: 0.5, precision: 1.0, recall: 0.0 }],
    };
    results[2].precision_recall.points.iter_mut().for_each(|point| point.recall = f64::NAN);
    results[3].figures = Default::default();
    results[4].calibration.bins.clear();
    let bin = &mut results[5].calibration.bins[0];
    (bin.low, bin.mean_confidence, bin.n) = (f64::INFINITY, Some(f64::NAN), u64::MAX);
    results[5].calibration.bins[1].n = u64::MAX;
    results[4].confusion.as_mut().unwrap().true_places = 0;
    let page = html(&report).unwrap();
    assert_well_formed(&page);
    assert!(!page.contains("NaN") && !markdown(&report).contains("NaN"));
    assert!(!page.contains("/> cnn · frames</li>"));
}

#[test]
fn the_same_report_gives_the_same_bytes() {
    let report = report();
    assert_eq!(html(&report).unwrap(), html(&report.clone()).unwrap());
    assert_eq!(markdown(&report), markdown(&report.clone()));
}

#[test]
fn json_ends_with_a_newline_and_leaves_the_pictures_out() {
    let text = json(&report()).unwrap();
    assert!(text.ends_with("}\n") && text.contains("\"schema\": \"loci-evaluation-1\""));
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    let pair = &value["experiments"][0]["results"][2]["worst"][0];
    assert_eq!(pair["mistake"], "false_accept");
    assert!(pair["query"].get("jpeg").is_none() && pair.get("inliers").is_none());
}
