//! `loci evaluate`: what it counts, what it refuses, and that its figures can be trusted.

use std::fs;
use std::path::{Path, PathBuf};

use loci::source;
use serde_json::Value;

use crate::program::{Finished, loci, loci_without_runtime, text};

const FRAMES_PER_LAP: usize = 24;

/// Two laps of a corridor as images, with a ground truth that may be spoilt.
struct Drive {
    folder: tempfile::TempDir,
}

impl Drive {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let world =
            format!("synthetic:corridor?laps=2&light=noon&frames={FRAMES_PER_LAP}&seed=5&size=320x240");
        let mut source = source::open(&world, None).unwrap();
        let frames = std::iter::from_fn(|| source.next_frame());
        for (index, frame) in frames.enumerate() {
            fs::write(folder.path().join(file(index)), source::jpeg(&frame.unwrap().colour)).unwrap();
        }
        Self { folder }
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Writes a table in which a frame of lap 2 shows the same place as the frame of lap 1 that
    /// `same_as` names.
    fn truth(&self, name: &str, same_as: impl Fn(usize) -> usize) -> PathBuf {
        let mut table = "file,same_place_as\n".to_owned();
        for index in 0..2 * FRAMES_PER_LAP {
            let earlier = index.checked_sub(FRAMES_PER_LAP).map(|index| file(same_as(index)));
            table += &format!("{},{}\n", file(index), earlier.unwrap_or_default());
        }
        let path = self.path().join(name);
        fs::write(&path, table).unwrap();
        path
    }

    fn evaluate(&self, truth: &Path) -> Finished {
        loci(&["evaluate", text(self.path()), "--truth", text(truth), "--recent", "12", "--json"])
    }
}

fn file(index: usize) -> String {
    format!("{index:03}.jpg")
}

fn report(run: &Finished) -> Value {
    serde_json::from_str(&run.stdout).unwrap_or_else(|error| panic!("{error}: {}", run.stderr))
}

/// The result of one method from one database.
fn result<'a>(report: &'a Value, method: &str, database: &str) -> &'a Value {
    let results = report["experiments"][0]["results"].as_array().unwrap();
    let found = results.iter().find(|r| r["method"] == method && r["database"] == database);
    found.unwrap_or_else(|| panic!("no {method} from {database}"))
}

fn rate(report: &Value, method: &str, database: &str, figure: &str) -> f64 {
    result(report, method, database)["figures"][figure]["rate"].as_f64().unwrap()
}

/// The report without what may differ from run to run.
fn without_timing(mut report: Value) -> Value {
    for experiment in report["experiments"].as_array_mut().unwrap() {
        let experiment = experiment.as_object_mut().unwrap();
        experiment.remove("latency").unwrap();
        experiment.remove("peak_memory_bytes").unwrap();
    }
    report
}

#[test]
fn the_right_ground_truth_is_met_a_planted_wrong_one_and_an_off_by_one_are_not() {
    let drive = Drive::new();
    let right = report(&drive.evaluate(&drive.truth("right.csv", |frame| frame)));
    let known = &right["experiments"][0]["ground_truth"];
    assert_eq!((known["known"].as_u64(), known["unknown"].as_u64()), (Some(24), Some(24)));
    assert!(rate(&right, "cnn+bow_hv", "frames", "recall_at_1") >= 0.9, "{right:#}");
    assert!(right["experiments"][0]["warnings"].as_array().unwrap().is_empty());

    let planted = drive.truth("planted.csv", |frame| (frame + FRAMES_PER_LAP / 2) % FRAMES_PER_LAP);
    let planted = report(&drive.evaluate(&planted));
    assert!(rate(&planted, "cnn+bow_hv", "frames", "recall_at_1") <= 0.1, "a wrong truth was met");

    let shifted = drive.evaluate(&drive.truth("shifted.csv", |frame| (frame + 1) % FRAMES_PER_LAP));
    assert_eq!(shifted.code, 3, "doubtful figures do not end with 0");
    let shifted = report(&shifted);
    assert!(rate(&shifted, "cnn+bow_hv", "frames", "recall_at_1") <= 0.2, "an off-by-one was met");
    let warning = shifted["experiments"][0]["warnings"][0].as_str().unwrap();
    assert!(warning.contains("looks shifted") && warning.contains("+1 further"), "{warning}");
}

#[test]
fn the_same_command_gives_the_same_figures_but_timing_and_says_how_to_repeat_it() {
    let worlds = [
        "evaluate",
        "synthetic:corridor?laps=1&light=dusk&frames=16&seed=5&size=320x240",
        "--reference=synthetic:corridor?laps=1&light=noon&frames=16&seed=5&size=320x240",
        "--unknown=synthetic:street?laps=1&light=noon&frames=6&seed=9&size=320x240",
        "--truth=places=1",
        "--json",
    ];
    let first = report(&loci(&worlds));
    assert_eq!(first["schema"], "loci-evaluation-1");
    let header = &first["header"];
    assert!(header["command"].as_str().unwrap().starts_with("loci evaluate 'synthetic:corridor?laps=1&"));
    assert_eq!(header["vocabularies"][0]["sha256"].as_str().unwrap().len(), 64);
    assert_eq!(header["settings"]["min_inliers"], "8");
    let strangers = &result(&first, "bow_hv", "map")["figures"]["false_accepts"];
    assert!(strangers["n"].as_u64().unwrap() >= 6, "{strangers}");
    assert_eq!(without_timing(first), without_timing(report(&loci(&worlds))));
}

#[test]
fn a_ground_truth_that_fits_only_half_is_refused_with_its_rows() {
    let drive = Drive::new();
    let write = |name: &str, table: &str| {
        let path = drive.path().join(name);
        fs::write(&path, table).unwrap();
        path
    };
    let missing = write("missing.csv", "file,place\n000.jpg,1\n001.jpg,1\n");
    drive.evaluate(&missing).assert_failed(1, &["missing.csv", "46 of the 48 frames", "002.jpg"]);
    let gone = write("gone.csv", "file,place\n000.jpg,1\n900.jpg,1\n901.jpg,2\n");
    drive.evaluate(&gone).assert_failed(1, &["gone.csv, rows 3, 4", "does not exist"]);
    let matrix = write("loops.txt", "0 0\n1 0\n");
    drive.evaluate(&matrix).assert_failed(1, &["loops.txt", "2 rows", "48 frames"]);
}

#[test]
fn what_makes_no_sense_is_refused_before_any_frame_is_looked_at() {
    let world = "synthetic:corridor?laps=1&frames=4&size=160x160";
    loci(&["evaluate"]).assert_failed(2, &["nothing to evaluate"]);
    loci(&["evaluate", world, "--truth", "places=1", "--methods", "netvlad"])
        .assert_failed(2, &["no method 'netvlad'", "cnn+bow_hv"]);
    loci(&["evaluate", world, "--truth", "metres=3"]).assert_failed(2, &["metres=3", "radius=METRES"]);
    loci(&["evaluate", world, "--truth", "places=1", "--layout", "atlantis"])
        .assert_failed(2, &["atlantis", "st-lucia"]);
    loci(&["evaluate", world]).assert_failed(1, &["--truth"]);
    loci(&["evaluate", world, "--truth", "places=1", "--methods", "paper"])
        .assert_failed(2, &["--reference"]);
    loci(&["evaluate", world, "--truth", "places=1", "--report", "/nowhere/page.html"])
        .assert_failed(1, &["cannot write /nowhere/page.html"]);
    loci(&["evaluate", world, "--truth", "places=1", "--report", "x.html", "--markdown", "x.html"])
        .assert_failed(2, &["x.html", "twice"]);
    let run = loci(&["evaluate", "--suite", "--radius", "5"]);
    assert!(run.code == 2 && run.stderr.contains("--radius"), "{}", run.stderr);
    loci(&["evaluate", world, "--data", "/tmp"]).assert_failed(2, &["--data", "--suite"]);
    loci(&["evaluate", "--suite", "/nowhere.toml"]).assert_failed(1, &["/nowhere.toml", "--suite FILE.toml"]);
    loci(&["evaluate", "--suite", "--data", "/nowhere"]).assert_failed(2, &["/nowhere", "LOCI_DATA"]);
    loci(&["evaluate", "/nowhere", "--truth", "none"]).assert_failed(1, &["/nowhere"]);
}

#[test]
fn without_a_cnn_geometry_is_evaluated_alone_and_says_so() {
    let world = "synthetic:corridor?laps=1&frames=6&size=320x240";
    let run = loci_without_runtime(&["evaluate", world, "--truth", "places=1", "--recent", "2", "--json"]);
    assert_eq!(run.code, 3, "{}", run.stderr);
    let report = report(&run);
    let results = report["experiments"][0]["results"].as_array().unwrap();
    assert!(results.iter().all(|result| result["method"] == "bow_hv"));
    assert!(report["experiments"][0]["warnings"][0].as_str().unwrap().contains("no CNN ran"));
    let stages = report["experiments"][0]["latency"].as_array().unwrap();
    assert!(stages.iter().all(|stage| stage["stage"] != "cnn"), "{stages:?}");
    let run = loci_without_runtime(&["evaluate", world, "--truth", "places=1", "--methods", "cnn"]);
    assert!(run.code == 1 && run.stderr.contains("needs a CNN"), "{}", run.stderr);
}

#[test]
fn a_suite_writes_its_figures_and_a_page_that_needs_no_network() {
    let drive = Drive::new();
    drive.truth("truth.csv", |frame| frame);
    let suite = drive.path().join("suite.toml");
    let experiments = "data = '.'\n[[experiment]]\nname = 'Two <laps>'\nframes = { query = '.' }\n\
                       truth = { from = 'truth.csv', recent = 12 }\nbaselines = [{ method = 'guessing', figure = 'R@1 0.04' }]\n";
    fs::write(&suite, experiments).unwrap();
    let (page, markdown) = (drive.path().join("r.html"), drive.path().join("B.md"));
    let arguments =
        ["evaluate", "--suite", text(&suite), "--report", text(&page), "--markdown", text(&markdown)];
    let by_hand = "\n<!-- From here on written by hand: `loci evaluate` keeps it. -->\n\nOur benches.\n";
    fs::write(&markdown, format!("yesterday's figures{by_hand}")).unwrap();
    let run = loci(&arguments);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let markdown = fs::read_to_string(markdown).unwrap();
    assert!(markdown.ends_with(by_hand) && !markdown.contains("yesterday"), "{markdown}");
    for part in [r"Two \<laps>", "cnn+bow_hv", "guessing", "R@1 0.04"] {
        assert!(markdown.contains(part), "no {part} in {markdown}");
    }
    let page = fs::read_to_string(page).unwrap();
    assert!(page.contains("Two &lt;laps&gt;") && page.contains("<svg"));
    let outside = page.replace("http://www.w3.org/2000/svg", "");
    assert!(!outside.contains("http://") && !outside.contains("https://") && !outside.contains("<script"));
}
