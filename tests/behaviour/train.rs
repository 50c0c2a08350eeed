//! `loci train`: from a map to a model that a run uses.

use std::fs;

use serde_json::Value;

use crate::program::{loci, text};

#[test]
fn a_model_is_trained_from_the_places_of_a_map_and_used_like_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let (map, out) = (folder.path().join("map"), folder.path().join("site"));
    let drive = |laps: &str| format!("synthetic:street?laps={laps}&seed=3&frames=40&size=320x240");
    let run = loci(&["run", &drive("4"), "--map", text(&map)]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let train = |more: &[&str]| {
        let arguments = [
            "train",
            text(&map),
            "--out",
            text(&out),
            "--min-samples",
            "8",
            "--epochs",
            "3",
            "--augment",
            "1",
        ];
        loci(&[&arguments[..], more].concat())
    };
    let trained = train(&["--accept", "--json"]);
    assert_eq!(trained.code, 0, "{}", trained.stderr);
    let report: Value = serde_json::from_str(trained.stdout.trim()).unwrap();
    assert!(report["classes"].as_u64() >= Some(2), "{report}");
    assert!(report["held_out"]["recall_at_one"].as_f64() > Some(0.3), "{report}");
    let card = fs::read_to_string(out.join("card.toml")).unwrap();
    assert!(card.contains("name = \"site\"") && card.contains("[[class]]"), "{card}");
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("<h1>Training of site</h1>") && page.contains("<svg"), "{page}");
    assert!(!folder.path().join("site.checkpoint").exists());
    let doctor = loci(&["doctor", "--map", text(&map), "--model", text(&out)]);
    let classes = report["classes"].as_u64().unwrap();
    let known = format!("it has {classes} of the {classes} places that site was trained on");
    assert!(doctor.stdout.contains(&known), "{}", doctor.stdout);
    // Its descriptors are none of the map's: a new map is learnt with it, and found again.
    let other = folder.path().join("other");
    let again = loci(&["run", &drive("2"), "--map", text(&other), "--model", text(&out), "--json"]);
    assert_eq!(again.code, 0, "{}", again.stderr);
    let by_cnn = again.records().iter().filter(|record| record["by"] == "cnn").count();
    assert!(by_cnn > 0, "{}", again.stdout);
    train(&[]).assert_failed(2, &["site is there already; choose another --out"]);
    // What another training has come to is not gone on with, nor lost.
    let (third, kept) = (folder.path().join("third"), folder.path().join("third.checkpoint"));
    fs::write(&kept, "of another training").unwrap();
    let refused = loci(&["train", text(&map), "--out", text(&third), "--min-samples", "8", "--augment", "0"]);
    refused.assert_failed(2, &["third.checkpoint is of another training, or damaged; remove it"]);
    assert_eq!(fs::read_to_string(&kept).unwrap(), "of another training");
}

#[test]
fn what_makes_no_sense_is_refused_before_an_image_is_looked_at() {
    let folder = tempfile::tempdir().unwrap();
    let (map, out) = ("tests/data/map/version_2", folder.path().join("site"));
    let train = |more: &[&str]| loci(&[&["train", map, "--out", text(&out)], more].concat());
    train(&[map]).assert_failed(2, &["version_2 is named twice"]);
    for more in [["--dimensions", "8193"], ["--dimensions", "0"], ["--augment", "101"], ["--epochs", "0"]] {
        assert_eq!(train(&more).code, 2, "{more:?}");
    }
    assert!(!out.exists());
}

#[test]
fn a_map_without_two_places_to_tell_apart_trains_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("site");
    let train = loci(&["train", "tests/data/map/version_2", "--out", text(&out)]);
    train.assert_failed(1, &["a training needs two places at least, not 0"]);
    assert!(!out.exists());
    loci(&["train", text(folder.path()), "--out", text(&out)]).assert_failed(1, &["no map in "]);
    assert_eq!(loci(&["train", "--out", text(&out)]).code, 2);
}
