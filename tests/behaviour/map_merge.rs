//! `loci map merge`: two maps become a third one, or nothing is made.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use loci::place_map::{MapOptions, PlaceMap};
use loci::storage::WriterLock;
use serde_json::Value;

use crate::map_care::{damage_keyframes, files, learn, map, tear};
use crate::program::{Finished, finished, loci, send, text};

/// Has the CNN descriptors of a model that there is nowhere.
const FOREIGN: &str = "tests/data/map/version_2";

/// Runs `loci` where no model is found, in `folder`.
fn loci_without_model(folder: &Path, arguments: &[&str]) -> Finished {
    let program = folder.join("loci");
    // Not by this process: another test that starts one meanwhile would hold the new program open for writing.
    let copied = Command::new("cp").arg(env!("CARGO_BIN_EXE_loci")).arg(&program).status().unwrap();
    assert!(copied.success());
    let vocabulary = concat!(env!("CARGO_MANIFEST_DIR"), "/vocab/default.lvoc");
    let mut command = Command::new(program);
    command.current_dir(folder).env_remove("LOCI_MODEL").args(arguments).args(["--vocab", vocabulary]);
    finished(&mut command)
}

/// Drives once through a synthetic world and keeps the map at `map`.
fn drive(world: &str, map: &str) {
    assert_eq!(loci(&["run", &format!("synthetic:{world}"), "--map", map]).code, 0);
}

/// The joins that are planned, each as the places of the two maps.
fn planned(a: &str, b: &str) -> Vec<[u64; 2]> {
    let planned = loci(&["map", "merge", a, b, "--dry-run", "--json"]);
    assert_eq!(planned.code, 0, "{}", planned.stderr);
    let report: Value = serde_json::from_str(&planned.stdout).unwrap();
    let place = |join: &Value, key: &str| join[key].as_u64().unwrap();
    let joins = report["joins"].as_array().unwrap().iter();
    joins.map(|join| [place(join, "place"), place(join, "other")]).collect()
}

#[test]
fn two_drives_through_one_street_become_one_map_and_stay_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second, both] = ["a", "b", "both"].map(|name| folder.path().join(name).display().to_string());
    drive("street?laps=1&light=noon&frames=30&seed=21", &first);
    drive("street?laps=1&light=noon&frames=30&seed=21&offset=0.9&passers=9", &second);
    let contents = || [&first, &second].map(|map| loci(&["map", "export", map, "--out", "-"]).stdout);
    let before = contents();
    let sentences = loci(&["map", "merge", &first, &second, "--dry-run"]).stdout;
    for part in [" of B is place ", "the other way round, by geometry", "nothing was written"] {
        assert!(sentences.contains(part), "no '{part}' in: {sentences}");
    }
    let merged = loci(&["map", "merge", &first, &second, "--out", &both, "--json"]);
    assert_eq!(merged.code, 0, "{}", merged.stderr);
    let report: Value = serde_json::from_str(&merged.stdout).unwrap();
    let joins = report["joins"].as_array().unwrap();
    for said in joins.iter().flat_map(|join| [join, &join["back"]]) {
        let [matched, keyframes] = ["matched_keyframes", "keyframes"].map(|key| said[key].as_u64().unwrap());
        assert!(matched >= keyframes.min(2) && matched <= keyframes, "{report}");
    }
    let map = PlaceMap::open_read_only(Path::new(&both)).unwrap();
    let of = |path: &str| PlaceMap::open_read_only(Path::new(path)).unwrap().summary();
    let (a, b, summary) = (of(&first), of(&second), map.summary());
    assert_eq!(summary.places, a.places + b.places - joins.len());
    assert_eq!(summary.experiences, a.experiences + b.experiences);
    assert_eq!(loci(&["map", "verify", &both]).code, 0);
    let again = || loci(&["map", "merge", &first, &second, "--out", &both, "--json"]);
    let refused = again();
    assert_eq!((refused.code, refused.stderr.contains("is there already")), (2, true), "{}", refused.stderr);
    fs::remove_dir_all(&both).unwrap();
    assert_eq!(contents(), before, "a merge is undone by deleting what it made");
    assert_eq!(again().stdout, merged.stdout);
}

#[test]
fn two_drives_through_one_world_are_joined_whichever_comes_first() {
    // Over eight seeds four fifths of the streets' places are joined and seven tenths of the corridors'. Of three seeds
    // it is half at least, for their twenty places are few.
    for world in ["street", "corridor"] {
        let (mut joined, mut places) = ([0; 2], 0);
        for seed in 23..26 {
            let folder = tempfile::tempdir().unwrap();
            let [a, b] = ["a", "b"].map(|name| folder.path().join(name).display().to_string());
            let world = format!("{world}?laps=1&light=noon&frames=40&seed={seed}");
            drive(&world, &a);
            drive(&format!("{world}&offset=0.6&passers=9"), &b);
            places += PlaceMap::open_read_only(Path::new(&b)).unwrap().summary().places;
            for (sum, joins) in joined.iter_mut().zip([planned(&a, &b).len(), planned(&b, &a).len()]) {
                assert!(joins >= 2, "{world}: {joins}");
                *sum += joins;
            }
        }
        assert!(joined.iter().all(|&joins| 2 * joins >= places), "{world}: {joined:?} of {places}");
    }
}

#[test]
fn worlds_that_look_alike_are_joined_nowhere() {
    // Where keyframes vote by any match, these two corridors have three places in common.
    for world in ["corridor?laps=1&light=noon", "street?laps=1&light=noon&frames=30"] {
        let folder = tempfile::tempdir().unwrap();
        let [a, b] = ["a", "b"].map(|name| folder.path().join(name).display().to_string());
        drive(&format!("{world}&seed=104"), &a);
        drive(&format!("{world}&seed=108"), &b);
        for joins in [planned(&a, &b), planned(&b, &a)] {
            assert_eq!(joins, Vec::<[u64; 2]>::new(), "{world}");
        }
    }
}

#[test]
fn without_a_model_geometry_goes_on_alone_and_a_model_that_is_named_must_be_there() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["a", "b"].map(|name| folder.path().join(name).display().to_string());
    for map in [&first, &second] {
        assert_eq!(loci(&["run", "synthetic:street?laps=1&frames=12&seed=21", "--map", map]).code, 0);
    }
    let merge = ["map", "merge", &first, &second, "--dry-run"];
    let merged = loci_without_model(folder.path(), &merge);
    assert_eq!((merged.code, merged.stderr.lines().count()), (0, 1), "{}", merged.stderr);
    for part in ["NO CNN", "geometry alone", "models/efficientnet-lite0 not found", "--model"] {
        assert!(merged.stderr.contains(part), "no '{part}' in: {}", merged.stderr);
    }
    assert!(merged.stdout.contains("by geometry"), "{}", merged.stdout);
    assert!(!merged.stdout.contains("by the CNN"), "{}", merged.stdout);
    let named = loci_without_model(folder.path(), &[&merge[..], &["--model", "missing"]].concat());
    named.assert_failed(1, &["missing/card.toml"]);
    let unwanted = loci_without_model(folder.path(), &[&merge[..], &["--model", "none"]].concat());
    assert_eq!((unwanted.code, unwanted.stderr.as_str()), (0, ""));
}

#[test]
fn descriptors_of_another_model_are_reported() {
    let (_folder, b) = map();
    let merged = loci(&["map", "merge", FOREIGN, text(&b), "--dry-run"]);
    assert_eq!((merged.code, merged.stderr.lines().count()), (0, 1), "{}", merged.stderr);
    assert!(merged.stderr.contains("CNN descriptors of another model than"), "{}", merged.stderr);
    assert_eq!(merged.stdout, "0 places would be joined; nothing was written\n");
}

#[test]
fn a_map_is_not_merged_with_itself_nor_into_itself() {
    let (folder, a) = map();
    let (_other, b) = map();
    let before = files(&a);
    let link = folder.path().join("link");
    std::os::unix::fs::symlink(&a, &link).unwrap();
    for same in [&a, &a.join("."), &a.join("../site"), &link] {
        let merged = loci(&["map", "merge", text(&a), text(same), "--dry-run"]);
        merged.assert_failed(2, &["are one map", "two different ones"]);
    }
    for out in [a.join("both"), link.join("both")] {
        let merged =
            |[one, other]: [&Path; 2]| loci(&["map", "merge", text(one), text(other), "--out", text(&out)]);
        merged([&a, &b]).assert_failed(2, &["--out", "lies in the map"]);
        merged([&b, &a]).assert_failed(2, &["--out", "lies in the map"]);
    }
    assert!(files(&a) == before);
}

#[test]
fn a_torn_map_is_merged_up_to_its_tail_which_is_reported() {
    let (folder, a) = map();
    let (_other, b) = map();
    tear(&b);
    let before = files(&b);
    let out = folder.path().join("both");
    let merged = loci(&["map", "merge", text(&a), text(&b), "--out", text(&out)]);
    assert_eq!((merged.code, merged.stderr.lines().count()), (3, 1), "{}", merged.stderr);
    assert!(merged.stderr.contains(&format!("{}: 99 bytes of a torn", b.display())), "{}", merged.stderr);
    assert!(files(&b) == before);
    assert_eq!(PlaceMap::open_read_only(&out).unwrap().summary().experiences, 8);
}

#[test]
fn what_is_damaged_of_a_map_is_left_out_and_said() {
    let (folder, a) = map();
    let (_other, b) = map();
    damage_keyframes(&b);
    let planned = loci(&["map", "merge", text(&a), text(&b), "--dry-run"]);
    assert_eq!((planned.code, planned.stderr.lines().count()), (3, 1), "{}", planned.stderr);
    for part in ["keyframes left out", "cannot be read: 2 (", "`loci map compact`", text(&b)] {
        assert!(planned.stderr.contains(part), "no '{part}' in: {}", planned.stderr);
    }
    let out = folder.path().join("both");
    let merged = loci(&["map", "merge", text(&a), text(&b), "--out", text(&out)]);
    assert_eq!((merged.code, merged.stderr.lines().count()), (3, 1), "{}", merged.stderr);
    for part in
        ["cannot be read (experiences: 2, keyframes: 0, thumbnails: 0): ", "`loci map compact`", text(&b)]
    {
        assert!(merged.stderr.contains(part), "no '{part}' in: {}", merged.stderr);
    }
    assert_eq!(PlaceMap::open_read_only(&out).unwrap().summary().experiences, 6);
    assert_eq!(loci(&["map", "verify", text(&out)]).code, 0);
}

#[test]
fn what_a_merge_left_behind_that_was_ended_at_once_is_deleted_by_the_next_one() {
    let (folder, a) = map();
    let (_other, b) = map();
    let path = |name: &str| folder.path().join(name);
    let [ended, held, foreign, elsewhere] =
        ["both.7.part", "both.8.part", "both.x.part", "botha.7.part"].map(path);
    for leftover in [&ended, &held, &foreign, &elsewhere] {
        fs::create_dir(leftover).unwrap();
    }
    let _held = WriterLock::acquire(&held).unwrap();
    assert_eq!(loci(&["map", "merge", text(&a), text(&b), "--out", text(&path("both"))]).code, 0);
    assert!(!ended.exists() && held.exists() && foreign.exists() && elsewhere.exists());
}

/// A map of one place with so many experiences that no copy of it is made in an instant.
fn large_map(path: &Path) {
    let mut map = PlaceMap::open(path, MapOptions::unbounded()).unwrap();
    for index in 0..30_000 {
        // Odd ones are no keyframes.
        learn(&mut map, (index > 0).then_some(0), 2 * index + 1, "x");
    }
    map.close().unwrap();
}

#[test]
fn a_merge_that_is_interrupted_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
    large_map(&a);
    large_map(&b);
    let names = || {
        let mut names: Vec<PathBuf> =
            fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        names.sort_unstable();
        names
    };
    let mut merge = Command::new(env!("CARGO_BIN_EXE_loci"));
    merge.args(["map", "merge", text(&a), text(&b), "--out", text(&folder.path().join("both"))]);
    let merge = merge.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let patience = Instant::now() + Duration::from_secs(60);
    while names().len() == 2 {
        assert!(Instant::now() < patience, "nothing is being written");
        std::thread::sleep(Duration::from_millis(1));
    }
    send("TERM", &merge);
    let ended = merge.wait_with_output().unwrap();
    let stderr = String::from_utf8(ended.stderr).unwrap();
    assert_eq!((ended.status.code(), stderr.as_str()), (Some(1), "loci: interrupted: no map was made\n"));
    assert_eq!(names(), [a, b]);
}
