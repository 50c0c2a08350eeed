//! Real sequences, run by `make test-data`; found by `LOCI_DATA`, never part of the project.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use loci::place_map::{MapOptions, PlaceId, PlaceMap};
use serde_json::Value;

use crate::program::{loci, real_data, text};

/// Rows of a ground truth, without its header, cut at commas.
fn rows(path: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(path).unwrap();
    text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

/// Answers that name a place, those of them that are right, and frames that have a right answer.
#[derive(Debug, Default)]
struct Tally {
    named: usize,
    right: usize,
    frames: usize,
}

impl Tally {
    fn precision(&self) -> f64 {
        self.right as f64 / self.named as f64
    }

    fn recall(&self) -> f64 {
        self.right as f64 / self.frames as f64
    }

    fn count(&mut self, names_place: bool, right: bool) {
        self.frames += 1;
        self.named += usize::from(names_place);
        self.right += usize::from(names_place && right);
    }
}

fn names_place(record: &Value) -> bool {
    ["recognised", "revisited"].contains(&record["decision"].as_str().unwrap())
}

/// The ground truth of every frame of a drive of the robot's laps, in order.
fn rows_of_drive(folder: &Path, drive: &str) -> Vec<Vec<String>> {
    let number = |row: &Vec<String>| -> u64 {
        Path::new(&row[0]).file_stem().unwrap().to_str().unwrap().parse().unwrap()
    };
    let mut truth = rows(&folder.join("ground_truth.csv"));
    truth.retain(|row| row[1] == drive && folder.join(&row[0]).exists());
    truth.sort_by_key(number);
    truth
}

/// Whether two phases of a lap lie within 5 % of it.
fn are_near(one: f64, other: f64) -> bool {
    let apart = (one - other).abs();
    apart.min(1.0 - apart) <= 0.05
}

/// An answer is right when the place it names holds a frame that the ground truth lists for this one.
#[test]
#[ignore = "needs the real sequences"]
fn real_corridor_is_recognised_on_its_second_lap() {
    let folder = real_data().join("corridor_two_laps");
    let truth = rows(&folder.join("ground_truth.csv"));
    let map = tempfile::tempdir().unwrap();
    let run = loci(&["run", text(&folder), "--map", text(map.path()), "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let records = run.records();
    assert_eq!(records.len(), 84, "a line a frame");
    let mut tally = Tally::default();
    let mut frames_of_place: BTreeMap<u64, BTreeSet<&str>> = BTreeMap::new();
    let mut founded_in_first_lap = 0;
    for (record, row) in records.iter().zip(&truth) {
        let same_place: BTreeSet<&str> = row[2].split_whitespace().collect();
        let mut nowhere = BTreeSet::new();
        let known = match record["place"].as_u64() {
            Some(place) => frames_of_place.entry(place).or_default(),
            None => &mut nowhere,
        };
        if row[1] == "1" {
            founded_in_first_lap += usize::from(record["decision"] == "new_place");
        } else {
            tally.count(names_place(record), !known.is_disjoint(&same_place));
        }
        known.insert(&row[0]);
    }
    println!("corridor: {founded_in_first_lap} places in lap 1; laps 2-3 {tally:?}");
    assert!(founded_in_first_lap >= 5);
    assert_eq!(tally.frames, 44);
    assert!(tally.precision() >= 0.95, "{tally:?}");
    assert!(tally.recall() >= 0.75, "{tally:?}");
    assert_eq!(evaluated(&folder), (tally.named as u64, tally.right as u64, tally.frames as u64));
}

/// Answers about known frames, right ones and known frames as `loci evaluate` counts them, from the map along a
/// sequence.
fn evaluated(folder: &Path) -> (u64, u64, u64) {
    let truth = folder.join("ground_truth.csv");
    let methods = ["--methods", "cnn+bow_hv", "--databases", "map", "--json"];
    let run = loci(&[&["evaluate", text(folder), "--truth", text(&truth)], &methods[..]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    let report: Value = serde_json::from_str(&run.stdout).unwrap();
    let figures = &report["experiments"][0]["results"][0]["figures"];
    let count = |figure: &str, field: &str| figures[figure][field].as_u64().unwrap();
    // Precision counts what was named in the first lap too, where nothing is known yet.
    let named = count("precision", "n") - count("false_accepts", "successes");
    (named, count("recall", "successes"), count("recall", "n"))
}

/// An answer is right when the place it names was seen within ±5 % of a lap. Noted without a target.
#[test]
#[ignore = "needs the real sequences"]
fn real_robot_drives_run_through() {
    let folder = real_data().join("robot_laps");
    for drive in ["2023-12-06_car1", "2023-12-09_car1", "2024-03-06_car2"] {
        let truth = rows_of_drive(&folder, drive);
        let run = loci(&["run", text(&folder.join(drive)), "--json"]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let records = run.records();
        assert_eq!(records.len(), truth.len(), "a line a frame");
        let tally = tally_of_laps(&records, truth.iter());
        println!("{drive}: {tally:?} precision {:.3} recall {:.3}", tally.precision(), tally.recall());
        assert!(tally.frames > 50 && tally.named > 0, "{tally:?}");
    }
}

/// Half of the places are merged with the other half, each with one from about half a map away, in three ways, unless both
/// were seen at one part of the lap: a place that was founded twice does not drift.
#[test]
#[ignore = "needs the real sequences"]
fn real_places_that_were_merged_by_mistake_have_drifted_and_those_of_the_robot_have_not() {
    let (folder, drive) = (real_data().join("robot_laps"), "2023-12-06_car1");
    let map = tempfile::tempdir().unwrap();
    let run = loci(&["run", text(&folder.join(drive)), "--map", text(map.path()), "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let mut phases_of_place: BTreeMap<PlaceId, Vec<f64>> = BTreeMap::new();
    for (record, row) in run.records().iter().zip(rows_of_drive(&folder, drive)) {
        if let Some(place) = record["place"].as_u64().filter(|_| row[5] == "1") {
            phases_of_place.entry(PlaceId(place as u32)).or_default().push(row[4].parse().unwrap());
        }
    }
    let lie_apart = |one: &PlaceId, other: &PlaceId| {
        let (one, other) = (&phases_of_place[one], &phases_of_place[other]);
        !one.iter().any(|&one| other.iter().any(|&other| are_near(one, other)))
    };
    let drifted = |map: &Path| {
        let drift = loci(&["map", "drift", text(map), "--json"]);
        assert_eq!(drift.code, 0, "{}", drift.stderr);
        let report: Value = serde_json::from_str(&drift.stdout).unwrap();
        report["drifted"].as_array().unwrap().len()
    };
    let before = drifted(map.path());
    let (mut after, mut merged) = (0, 0);
    for shift in 0..3 {
        let copy = tempfile::tempdir().unwrap();
        for file in fs::read_dir(map.path()).unwrap().map(Result::unwrap) {
            fs::copy(file.path(), copy.path().join(file.file_name())).unwrap();
        }
        let mut known = PlaceMap::open(copy.path(), MapOptions::default()).unwrap();
        let living: Vec<PlaceId> =
            known.places().filter(|place| place.merged_into.is_none()).map(|place| place.id).collect();
        let (kept, others) = living.split_at(living.len() / 2);
        let pairs = others.iter().zip(kept.iter().cycle().skip(shift));
        let wrong: Vec<_> = pairs.filter(|(from, into)| lie_apart(from, into)).collect();
        wrong.iter().for_each(|&(&from, &into)| known.merge_places(from, into).unwrap());
        known.close().unwrap();
        drop(known);
        merged += wrong.len();
        after += drifted(copy.path());
    }
    println!("drifted: {before} before, {after} of {merged} merged ones");
    assert_eq!(before, 0);
    assert!(merged >= 15 && 4 * after >= 3 * merged, "{after} of {merged}");
}

/// Scores the reliable frames after the first lap that has any.
fn tally_of_laps<'a>(records: &[Value], rows: impl Iterator<Item = &'a Vec<String>>) -> Tally {
    let mut tally = Tally::default();
    let mut phases_of_place: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
    let mut first_lap = None;
    for (record, row) in records.iter().zip(rows).filter(|(_, row)| row[5] == "1") {
        let (lap, phase): (u32, f64) = (row[3].parse().unwrap(), row[4].parse().unwrap());
        let mut nowhere = Vec::new();
        let known = match record["place"].as_u64() {
            Some(place) => phases_of_place.entry(place).or_default(),
            None => &mut nowhere,
        };
        if lap > *first_lap.get_or_insert(lap) {
            tally.count(names_place(record), known.iter().any(|&other| are_near(other, phase)));
        }
        known.push(phase);
    }
    tally
}
