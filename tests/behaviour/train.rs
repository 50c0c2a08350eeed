//! `loci train`: from a map to a model that a run uses.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use loci::feature::Features;
use loci::frame::Frame;
use loci::onnx::{Dimension, GraphBuilder, OnnxModel, STORAGE_KEY};
use loci::place_map::{MapOptions, NewExperience, PlaceId, PlaceMap, Traits};
use loci::source::thumbnail_jpeg;
use serde_json::Value;

use crate::program::{Finished, loci, send, text};

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
    let network = OnnxModel::read(&fs::read(out.join("model.onnx")).unwrap()).unwrap();
    assert_eq!((network.described("name"), network.described("recipe")), (Some("site"), Some("loci train")));
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
    train(&["--model", "none"]).assert_failed(2, &["training needs a CNN to compare with"]);
    let no_backbone = ["--architecture", "paper", "--backbone", "models/efficientnet-lite0"];
    train(&no_backbone).assert_failed(2, &["--architecture paper has no backbone; leave --backbone out"]);
    train(&["--device", "cuda:999"]).assert_failed(2, &["no device cuda:999"]);
    for more in [["--dimensions", "8193"], ["--dimensions", "0"], ["--augment", "101"], ["--epochs", "0"]] {
        assert_eq!(train(&more).code, 2, "{more:?}");
    }
    assert!(!out.exists());
    // A link that leads nowhere is there, too.
    let aside = folder.path().join("site.rejected");
    for link in [&aside, &out] {
        std::os::unix::fs::symlink("nowhere", link).unwrap();
        train(&[]).assert_failed(2, &[text(link), "is there already; choose another --out"]);
    }
}

#[test]
fn what_cannot_be_begun_with_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    map_of(&path("map"), 10, |place, _| place);
    fs::write(path("file"), "").unwrap();
    let nowhere = train_on(&path("map"), &path("file/site"), &[]);
    nowhere.assert_failed(1, &["cannot make the folder ", text(&path("file"))]);
    fs::create_dir(path("damaged")).unwrap();
    fs::copy("models/efficientnet-lite0/card.toml", path("damaged/card.toml")).unwrap();
    fs::write(path("damaged/model.onnx"), "other bytes").unwrap();
    let damaged = path("damaged");
    let out = path("site");
    train_on(&path("map"), &out, &["--backbone", text(&damaged)])
        .assert_failed(1, &["damaged/model.onnx: sha256 is"]);
    // The paper's CNN asks for no backbone, only for one to compare with.
    fs::write(path("site.checkpoint"), "junk").unwrap();
    let paper = train_on(&path("map"), &out, &["--architecture", "paper"]);
    paper.assert_failed(2, &["site.checkpoint is of another training, or damaged; remove it"]);
    assert!(!out.exists());
}

#[test]
fn a_backbone_in_8_bits_stays_in_them_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    map_of(&path("map"), 10, |place, _| place);
    let (map, first) = (path("map"), path("first"));
    let train = |out: &Path, more: &[&str]| {
        let few = "--min-samples 8 --epochs 1 --augment 0 --accept --json".split(' ');
        let given = ["train", text(&map), "--out", text(out)];
        let arguments: Vec<&str> = given.into_iter().chain(few).chain(more.iter().copied()).collect();
        loci(&arguments)
    };
    let taken = |out: &Path, more: &[&str]| -> (Value, String) {
        let trained = train(out, more);
        assert_eq!(trained.code, 0, "{}", trained.stderr);
        let report: Value = serde_json::from_str(trained.stdout.trim()).unwrap();
        (report["precision"].clone(), fs::read_to_string(out.join("card.toml")).unwrap())
    };
    assert_eq!(taken(&first, &["--precision", "int8"]).0, "int8");
    for precision in ["auto", "int8"] {
        let out = path(precision);
        let more = ["--backbone", text(&first), "--precision", precision];
        let (computes_in, card) = taken(&out, &more);
        assert_eq!(computes_in, "int8", "{precision}");
        assert_eq!(card.matches("without labels").count(), 1, "{card}");
        let page = fs::read_to_string(out.join("report.html")).unwrap();
        assert!([&card, &page].iter().all(|text| !text.contains("copies in other light")), "{card}");
        let network = OnnxModel::read(&fs::read(out.join("model.onnx")).unwrap()).unwrap();
        assert_eq!(
            (network.described("name"), network.described(STORAGE_KEY)),
            (Some(precision), Some("int8"))
        );
    }
    let whole = train(&path("whole"), &["--backbone", text(&first), "--precision", "f32"]);
    whole.assert_failed(2, &["first computes in 8 bits", "name another --backbone"]);
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

/// Looks at the same four places of a street, lap after lap, as experiences of the place that `place_of` says, in a map
/// in `folder`.
fn map_of(folder: &Path, laps: u64, place_of: impl Fn(u64, u64) -> u64) {
    map_with(folder, laps, place_of, |frame| thumbnail_jpeg(&frame.colour));
}

/// The same, with the image that `jpeg_of` makes of each frame.
fn map_with(
    folder: &Path,
    laps: u64,
    place_of: impl Fn(u64, u64) -> u64,
    jpeg_of: impl Fn(&Frame) -> Vec<u8>,
) {
    let spec = format!("synthetic:street?laps={laps}&frames=4&size=224x168&seed=3");
    let mut source = loci::source::open(&spec, None).unwrap();
    let mut map = PlaceMap::open(folder, MapOptions::default()).unwrap();
    let (features, traits) = (Features::default(), Traits::default());
    let mut founded: BTreeMap<u64, PlaceId> = BTreeMap::new();
    while let Some(frame) = source.next_frame() {
        let frame = frame.unwrap();
        let place = place_of(frame.index % 4, frame.index / 4);
        let known = founded.get(&place).copied();
        let new = NewExperience {
            frame: &frame,
            // No two are the same.
            view: frame.index + 1,
            mean_luminance: 100.0,
            thumbnail_jpeg: &jpeg_of(&frame),
            keyframe: known.is_none().then_some((&features, &traits)),
        };
        founded.insert(place, map.learn(known, &new).unwrap().place);
    }
    map.close().unwrap();
}

/// Trains on the map in `folder`, a little.
fn train_on(folder: &Path, out: &Path, more: &[&str]) -> Finished {
    let few = ["--min-samples", "8", "--epochs", "3", "--augment", "1", "--precision", "f32"];
    loci(&[&["train", text(folder), "--out", text(out)], &few[..], more].concat())
}

#[test]
fn a_model_of_places_that_are_told_apart_is_taken_and_one_of_shuffled_places_kept_aside() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    map_of(&path("map"), 16, |place, _| place);
    let taken = train_on(&path("map"), &path("site"), &[]);
    assert_eq!(taken.code, 0, "{}", taken.stderr);
    assert!(path("site/model.onnx").exists() && !path("site.rejected").exists());
    // Each place by what it looks like in one lap, and by what another one does in the next.
    map_of(&path("shuffled"), 16, |place, lap| (place + lap * (lap + 1) / 2) % 4);
    let refused = train_on(&path("shuffled"), &path("other"), &[]);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    assert!(
        refused.stderr.contains("the model recognises nothing of what was held out"),
        "{}",
        refused.stderr
    );
    assert!(refused.stderr.contains("other.rejected"), "{}", refused.stderr);
    assert!(!path("other").exists() && path("other.rejected/report.html").exists());
    let insisted = train_on(&path("shuffled"), &path("third"), &["--accept"]);
    assert_eq!(insisted.code, 0, "{}", insisted.stderr);
    assert!(insisted.stderr.contains("taken all the same"), "{}", insisted.stderr);
    assert!(path("third/model.onnx").exists());
}

#[test]
fn an_image_that_cannot_be_read_ends_the_training_by_number_unless_it_is_to_be_skipped() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let jpeg_of = |frame: &Frame| match frame.index {
        13 | 21 => b"no JPEG".to_vec(),
        _ => thumbnail_jpeg(&frame.colour),
    };
    map_with(&path("map"), 12, |place, _| place, jpeg_of);
    let ended = train_on(&path("map"), &path("site"), &[]);
    let first = format!("the first is number 13 of {}", text(&path("map")));
    ended.assert_failed(1, &["2 experiences of those looked at cannot be read", &first, "--skip-unreadable"]);
    assert!(!path("site").exists() && !path("site.rejected").exists());
    let skipped = train_on(&path("map"), &path("site"), &["--skip-unreadable", "--accept"]);
    assert_eq!(skipped.code, 3, "{}", skipped.stderr);
    assert!(skipped.stderr.contains("skipped: 2 experiences, for they cannot be read"), "{}", skipped.stderr);
    assert!(path("site/model.onnx").exists());
}

#[test]
fn a_training_that_nothing_is_left_to_judge_by_ends_before_it_begins() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let refuses = |map: &str, said: &[&str]| {
        let ended = train_on(&path(map), &path("site"), &["--skip-unreadable"]);
        let says_so = said.iter().all(|part| ended.stderr.contains(part));
        assert!(ended.code == 1 && says_so, "{map}: {} {}", ended.code, ended.stderr);
    };
    let without = |map: &str, is_broken: fn(u64) -> bool, place_of: fn(u64, u64) -> u64| {
        let jpeg_of = |frame: &Frame| match is_broken(frame.index) {
            true => b"no JPEG".to_vec(),
            false => thumbnail_jpeg(&frame.colour),
        };
        map_with(&path(map), 10, place_of, jpeg_of);
    };
    // Ten laps of four places: of the last laps nothing can be read; or of all places but one.
    without("late", |frame| frame >= 32, |place, _| place);
    refuses("late", &["skipped: 8 experiences", "no image that can be looked at is held out"]);
    without("one", |frame| frame % 4 != 2, |place, _| place);
    refuses("one", &["skipped: 30 experiences", "needs two places at least, not 1"]);
    without("next", |_| false, |place, _| place / 2);
    refuses("next", &["all places that can be looked at are next to each other"]);
    assert!(!path("site").exists() && !path("site.rejected").exists());
}

/// Arguments of a training on `map`, whatever comes of it.
fn training_on((map, out): (&Path, &Path), more: &str) -> Vec<String> {
    let given = ["train", text(map), "--out", text(out), "--min-samples", "6", "--augment", "0", "--accept"];
    given.into_iter().chain(more.split(' ')).map(str::to_owned).collect()
}

/// What a training says that is interrupted as soon as there is a checkpoint.
fn interrupted(arguments: &[String], checkpoint: &Path) -> String {
    let mut process = Command::new(env!("CARGO_BIN_EXE_loci"));
    let process = process.args(arguments).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut process = process.spawn().unwrap();
    while !checkpoint.exists() {
        assert!(process.try_wait().unwrap().is_none(), "it ended before it could be interrupted");
        std::thread::sleep(Duration::from_millis(2));
    }
    send("INT", &process);
    let ended = process.wait_with_output().unwrap();
    let stderr = String::from_utf8(ended.stderr).unwrap();
    assert_eq!(ended.status.code(), Some(1), "{stderr}");
    assert!(stderr.starts_with("loci: interrupted; the same command goes on with what is in "), "{stderr}");
    assert!(checkpoint.exists());
    stderr
}

#[test]
fn a_training_that_is_interrupted_behind_its_last_epoch_says_how_it_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    map_of(&path("map"), 10, |place, _| place);
    let (map, out, checkpoint) = (path("map"), path("site"), path("site.checkpoint"));
    let arguments = training_on((&map, &out), "--epochs 1 --precision int8");
    let said = interrupted(&arguments, &checkpoint);
    assert!(said.contains("site.checkpoint") && !out.exists(), "{said}");
    let resumed = loci(&arguments);
    assert_eq!(resumed.code, 0, "{}", resumed.stderr);
    assert!(resumed.stderr.contains("going on after 1 epoch"), "{}", resumed.stderr);
}

#[test]
fn a_training_that_is_interrupted_goes_on_and_ends_in_the_same_network() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    map_of(&path("map"), 10, |place, _| place);
    // Of one name, for the name is in the file.
    let (map, out, checkpoint) = (path("map"), path("one/site"), path("one/site.checkpoint"));
    let arguments = |out: &Path| training_on((&map, out), "--epochs 200 --precision f32");
    interrupted(&arguments(&out), &checkpoint);
    assert!(!out.exists());
    let resumed = loci(&arguments(&out));
    assert_eq!(resumed.code, 0, "{}", resumed.stderr);
    assert!(resumed.stderr.contains("going on after"), "{}", resumed.stderr);
    let whole = loci(&arguments(&path("other/site")));
    assert!(!whole.stderr.contains("going on after"), "{}", whole.stderr);
    let network = |folder: &str| fs::read(path(folder).join("model.onnx")).unwrap();
    assert!(network("one/site") == network("other/site"), "the networks differ");
}

#[test]
fn the_papers_cnn_is_trained_with_a_generators_images_and_computes_in_the_precision_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    map_of(&path("map"), 10, |place, _| place);
    // A negative: no camera makes one, but a network does.
    let mut graph = GraphBuilder::new("negative");
    let open = [Dimension::Batch, Dimension::Fixed(3), Dimension::Fixed(64), Dimension::Fixed(64)];
    let image = graph.input("image", &open);
    let negative = graph.node("Neg", &[&image], &[]);
    graph.output("negative", &negative, &open).unwrap();
    fs::write(path("negative.onnx"), graph.finish().to_bytes()).unwrap();
    let generator = path("negative.onnx");
    let more = [
        "--architecture",
        "paper",
        "--augment-model",
        text(&generator),
        "--accept",
        "--json",
        "--device",
        "cpu",
    ];
    for precision in ["f32", "int8"] {
        let out = path(precision);
        let few = ["--min-samples", "6", "--epochs", "1", "--precision", precision];
        let map = path("map");
        let given = ["train", text(&map), "--out", text(&out)];
        let trained = loci(&[&given[..], &few, &more].concat());
        assert_eq!(trained.code, 0, "{}", trained.stderr);
        let report: Value = serde_json::from_str(trained.stdout.trim()).unwrap();
        assert_eq!((&report["precision"], &report["device"]), (&precision.into(), &"cpu".into()), "{report}");
        let used = loci(&["doctor", "--model", text(&out)]);
        let answers = format!("{precision} answers with 256 values");
        assert!(used.stdout.contains(&answers), "{}", used.stdout);
    }
    let bytes = |precision: &str| fs::metadata(path(precision).join("model.onnx")).unwrap().len();
    assert!(bytes("int8") < bytes("f32"), "{} {}", bytes("int8"), bytes("f32"));
    let (map, out) = (path("map"), path("nowhere"));
    let contrary = ["--augment-model", text(&generator), "--augment", "0"];
    let none = loci(&[&["train", text(&map), "--out", text(&out)], &contrary[..]].concat());
    none.assert_failed(2, &["--augment-model makes nothing of --augment 0"]);
}
