//! `loci map`: maps looked at, verified, exported, named and compacted.

use std::collections::BTreeMap;
use std::fs::{self, File, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use loci::feature::{Descriptor, Features, Keypoint};
use loci::frame::{Frame, Pose};
use loci::geometry::Point;
use loci::place_map::{MapOptions, NewExperience, PlaceId, PlaceMap, Traits};
use loci::raster::{GreyImage, RgbImage};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::Field;
use serde_json::Value;
use tempfile::TempDir;

use crate::misfortune::loci_of_a_mere_user;
use crate::program::{finished, loci, text};

const STRANGE: &str = "he said \"hi\", then;\n\tleft – ü 雪";
const JOURNAL: &str = "journal-000001.loci";

fn features() -> Features {
    let keypoint =
        |x: f32| Keypoint { point: Point { x, y: 2.0 }, scale: 1.0, angle_radians: 0.5, response: 0 };
    Features {
        width_px: 640,
        height_px: 480,
        keypoints: vec![keypoint(1.0), keypoint(3.0)],
        descriptors: vec![Descriptor([7; 32]); 2],
    }
}

/// Learns a look at `place`, or at a new one; every second one is a keyframe with a pose.
pub(crate) fn learn(map: &mut PlaceMap, place: Option<u32>, index: u64, name: &str) {
    let is_keyframe = index.is_multiple_of(2);
    let pose = Pose { position_metres: [1.5, -2.0, index as f64], orientation: [0.0, 0.0, 0.6, 0.8] };
    let frame = Frame {
        index,
        capture_nanos: index as i64 * 1_000_000_007,
        name: name.to_owned(),
        colour: RgbImage::new(4, 4),
        grey: GreyImage::new(4, 4),
        jpeg: None,
        pose: is_keyframe.then_some(pose),
        true_place: None,
    };
    let (features, traits) = (features(), Traits::default());
    let thumbnail = format!("thumbnail {index}");
    let new = NewExperience {
        frame: &frame,
        view: index,
        mean_luminance: 80.25,
        thumbnail_jpeg: thumbnail.as_bytes(),
        keyframe: is_keyframe.then_some((&features, &traits)),
    };
    map.learn(place.map(PlaceId), &new).unwrap();
}

/// A map of three places, the second merged into the first, the third with a strange name; its snapshot written.
pub(crate) fn map() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site");
    let mut map = PlaceMap::open(&path, MapOptions::default()).unwrap();
    learn(&mut map, None, 0, "000.jpg");
    learn(&mut map, None, 1, STRANGE);
    learn(&mut map, None, 2, "=1+1,\r\n.jpg");
    learn(&mut map, Some(2), 3, "");
    map.merge_places(PlaceId(1), PlaceId(0)).unwrap();
    map.name_place(PlaceId(2), STRANGE).unwrap();
    map.close().unwrap();
    (folder, path)
}

/// The map, opened for writing again. A process that another test is just starting may hold its lock for a moment.
fn opened(path: &Path) -> PlaceMap {
    let mut attempts = (0..100).map(|_| PlaceMap::open(path, MapOptions::default()));
    let is_open = |map: &Result<PlaceMap, _>| {
        if map.is_err() {
            std::thread::sleep(Duration::from_millis(10));
        }
        map.is_ok()
    };
    attempts.find(is_open).expect("the lock is never free").unwrap()
}

pub(crate) fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    paths.map(|path| (path.clone(), fs::read(path).unwrap())).collect()
}

fn flip(path: &Path, position: usize) {
    let mut bytes = fs::read(path).unwrap();
    bytes[position] ^= 1;
    fs::write(path, bytes).unwrap();
}

/// Adds what a power cut may leave of a record to the map's journal.
pub(crate) fn tear(map: &Path) {
    let journal = map.join(JOURNAL);
    fs::write(&journal, [fs::read(&journal).unwrap(), vec![1; 99]].concat()).unwrap();
}

/// Damages the records of both keyframes of the [`map`].
pub(crate) fn damage_keyframes(map: &Path) {
    let journal = fs::read(map.join(JOURNAL)).unwrap();
    let at = |wanted: &[u8]| journal.windows(wanted.len()).position(|bytes| bytes == wanted).unwrap();
    [&b"000.jpg"[..], b"=1+1"].into_iter().for_each(|name| flip(&map.join(JOURNAL), at(name)));
}

/// Runs `loci map COMMAND MAP ARGUMENTS` and gives the JSON object on stdout.
fn json(command: &str, map: &Path, arguments: &[&str]) -> Value {
    let run = loci(&[&["map", command, text(map), "--json"], arguments].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    run.records().remove(0)
}

#[test]
fn a_place_whose_last_look_nothing_links_to_the_first_is_listed_and_the_map_stays_as_it_is() {
    let (_folder, path) = map();
    let drift = |more: &[&str]| loci(&[&["map", "drift", text(&path)], more].concat()).stdout;
    assert_eq!(drift(&[]), "0 of 2 places drifted\n");
    let mut map = opened(&path);
    // So few features verify nothing, and too much lies between for one go.
    (4..10).for_each(|index| learn(&mut map, Some(2), 2 * index + 1, ""));
    learn(&mut map, Some(0), 30, "");
    map.close().unwrap();
    drop(map);
    let before = files(&path);
    assert_eq!(drift(&[]), "place 0 falls into 2 parts: experiences 0; 10\n1 of 2 places drifted\n");
    let report: Value = serde_json::from_str(&drift(&["--json"])).unwrap();
    assert_eq!(report["places"], 2);
    assert_eq!(report["drifted"], serde_json::json!([{ "place": 0, "name": null, "parts": [[0], [10]] }]));
    assert_eq!(files(&path), before);
}

#[test]
fn info_counts_places_experiences_and_bytes() {
    let (_folder, map) = map();
    let info = json("info", &map, &[]);
    let counts =
        ["places", "named_places", "merged_places", "experiences", "keyframes", "segments", "torn_bytes"];
    assert_eq!(counts.map(|name| info[name].as_u64().unwrap()), [2, 1, 1, 4, 2, 1, 0]);
    let bytes = |name: &str| info[name].as_u64().unwrap();
    assert_eq!(bytes("journal_bytes"), fs::metadata(map.join(JOURNAL)).unwrap().len());
    assert!(bytes("live_bytes") < bytes("journal_bytes") && bytes("snapshot_bytes") > 0, "{info}");
    let said = loci(&["map", "info", text(&map)]).stdout;
    for part in ["2 (1 named), 1 other merged", "4 (2 keyframes)", "1 segment,", "snapshot"] {
        assert!(said.contains(part), "no '{part}' in: {said}");
    }
    flip(&map.join("snapshot.loci"), 40);
    assert!(json("info", &map, &[])["snapshot_fault"].as_str().unwrap().contains("checksum"));
}

#[test]
fn every_command_names_a_map_that_is_not_there_and_makes_none() {
    let folder = tempfile::tempdir().unwrap();
    let gone = folder.path().join("gone");
    let elsewhere = tempfile::tempdir().unwrap();
    let out = elsewhere.path().join("out.csv");
    let commands: [&[&str]; 5] =
        [&["info"], &["verify"], &["export", "--out", text(&out)], &["rename", "0", "dock"], &["compact"]];
    for command in commands {
        let (name, arguments) = command.split_first().unwrap();
        let mut line = vec!["map", name, text(&gone)];
        line.extend(arguments);
        loci(&line).assert_failed(1, &["no map in", "gone", "loci run"]);
        line[2] = text(folder.path());
        loci(&line).assert_failed(1, &["no map in"]);
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_sound_map_is_verified_and_not_touched() {
    let (_folder, map) = map();
    let before = files(&map);
    let report = json("verify", &map, &[]);
    assert_eq!(
        (&report["segments"], &report["snapshot"], &report["damaged"]),
        (&1.into(), &"right".into(), &false.into())
    );
    assert_eq!(report["problems"].as_array().unwrap().len(), 0);
    assert!(loci(&["map", "verify", text(&map)]).stdout.contains("says the same as the journal"));
    for version in ["version_1", "version_2"] {
        let report = json("verify", &Path::new("tests/data/map").join(version), &[]);
        assert_eq!(report["damaged"], false, "{report}");
    }
    json("info", &map, &[]);
    assert!(files(&map) == before);
}

#[test]
fn damage_is_listed_with_file_and_byte_also_where_the_map_cannot_be_written() {
    let (_folder, map) = map();
    let journal = map.join(JOURNAL);
    let whole = fs::read(&journal).unwrap();
    flip(&journal, 60);
    flip(&journal, whole.len() - 1);
    let verified = loci(&["map", "verify", text(&map), "--json"]);
    verified.assert_failed(1, &["site is damaged, problems found: 2"]);
    let report = &verified.records()[0];
    assert_eq!((&report["snapshot"], &report["damaged"]), (&"not_compared".into(), &true.into()));
    assert_eq!(report["problems"][0]["file"], text(&journal), "{report}");
    assert_eq!(report["problems"][0]["offset"], 58, "{report}");
    fs::write(&journal, &whole[..100]).unwrap();
    let compacted = loci(&["map", "compact", text(&map)]);
    compacted.assert_failed(1, &["snapshot.loci knows more than the journal beside it"]);
    let verified = loci(&["map", "verify", text(&map)]);
    verified
        .assert_failed(1, &["site cannot be used as it is", compacted.stderr.trim_start_matches("loci: ")]);
    let problem = format!("problem   {}, byte ", journal.display());
    assert!(verified.stdout.contains(&problem), "{}", verified.stdout);
}

#[test]
fn a_snapshot_that_is_of_no_use_is_no_damage_and_verify_says_of_it_what_info_says() {
    let (_folder, map) = map();
    let snapshot = map.join("snapshot.loci");
    let whole = fs::read(&snapshot).unwrap();
    let foreign = fs::read("tests/data/map/version_2/snapshot.loci").unwrap();
    for bytes in [&whole[..whole.len() - 5], b"", b"nothing of the kind", &foreign] {
        fs::write(&snapshot, bytes).unwrap();
        let fault = json("info", &map, &[])["snapshot_fault"].as_str().unwrap().to_owned();
        let verified = loci(&["map", "verify", text(&map), "--json"]);
        assert_eq!((verified.code, verified.stderr), (0, format!("loci: {fault}\n")));
        let report: Value = serde_json::from_str(&verified.stdout).unwrap();
        assert_eq!((&report["damaged"], &report["snapshot"]), (&false.into(), &"useless".into()));
        assert_eq!(report["snapshot_fault"], fault);
    }
    fs::write(&snapshot, &whole).unwrap();
    fs::remove_file(map.join(JOURNAL)).unwrap();
    let verified = loci(&["map", "verify", text(&map)]);
    verified.assert_failed(
        1,
        &["snapshot.loci knows more than the journal", JOURNAL, ", or delete the snapshot"],
    );
    for command in ["info", "compact"] {
        assert_eq!(loci(&["map", command, text(&map)]).stderr, verified.stderr);
    }
}

#[test]
fn what_may_not_be_read_is_no_damage() {
    let (_folder, map) = map();
    for name in [JOURNAL, "snapshot.loci"] {
        let path = map.join(name);
        fs::set_permissions(&path, Permissions::from_mode(0o000)).unwrap();
        let verified = finished(loci_of_a_mere_user(&map).args(["map", "verify", text(&map)]));
        verified.assert_failed(1, &["cannot open", name, "Permission denied"]);
        assert_eq!(verified.stdout, "");
        fs::set_permissions(&path, Permissions::from_mode(0o644)).unwrap();
    }
}

#[test]
fn damaged_keyframes_are_counted_by_info_and_given_up_by_compact() {
    let (_folder, map) = map();
    damage_keyframes(&map);
    let info = loci(&["map", "info", text(&map), "--json"]);
    assert_eq!((info.code, info.stderr.lines().count()), (3, 1), "{}", info.stderr);
    for part in
        ["cannot be read: 2 (", "journal-000001.loci: bad record at byte ", "`loci map compact` gives"]
    {
        assert!(info.stderr.contains(part), "no '{part}' in: {}", info.stderr);
    }
    assert_eq!(info.records()[0]["unreadable_keyframes"], 2);
    let verified = loci(&["map", "verify", text(&map)]);
    verified.assert_failed(1, &["site is damaged, problems found: 2; `loci map compact` gives up"]);
    let compacted = loci(&["map", "compact", text(&map)]);
    assert_eq!((compacted.code, compacted.stderr.lines().count()), (3, 1), "{}", compacted.stderr);
    assert!(compacted.stderr.contains("given up") && !compacted.stderr.contains("from a copy"));
    assert_eq!(json("info", &map, &[])["experiences"], 2);
    assert_eq!(json("verify", &map, &[])["damaged"], false);
}

#[test]
fn a_map_that_is_too_damaged_to_be_opened_is_opened_again_once_compact_gave_that_up() {
    let (_folder, map) = map();
    assert_eq!(loci(&["map", "rename", text(&map), "0", "dock"]).code, 0);
    fs::remove_file(map.join("snapshot.loci")).unwrap();
    let journal = fs::read(map.join(JOURNAL)).unwrap();
    let experience = journal.windows(4).position(|bytes| bytes == b"=1+1").unwrap();
    flip(&map.join(JOURNAL), experience);
    let before = fs::read(map.join(JOURNAL)).unwrap();
    let way_out = ["bad record at byte ", "keep the rest by `loci map compact --repair`"];
    for command in [&["compact"][..], &["verify"], &["rename", "0", "quay"]] {
        let arguments = [&["map", command[0], text(&map)], &command[1..]].concat();
        loci(&arguments).assert_failed(1, &way_out);
    }
    // Whoever only reads goes on with the rest.
    for run in [
        loci(&["map", "info", text(&map)]),
        loci(&["map", "export", text(&map), "--out", "-"]),
        loci(&["run", "synthetic:street?frames=3", "--map", text(&map), "--read-only"]),
    ] {
        assert_eq!(run.code, 3, "{}", run.stderr);
        assert!(run.stderr.contains("passed over, for it cannot be read: 1 record ("), "{}", run.stderr);
    }
    // A robot goes on recognising, and learns nothing.
    let run = loci(&["run", "synthetic:street?frames=3", "--map", text(&map)]);
    assert_eq!(run.code, 3, "{}", run.stderr);
    for part in [way_out[0], way_out[1], "going on read-only, nothing more is learnt"] {
        assert!(run.stderr.contains(part), "{}", run.stderr);
    }
    assert!(fs::read(map.join(JOURNAL)).unwrap() == before, "the damaged map was changed");
    let compacted = loci(&["map", "compact", text(&map), "--repair"]);
    assert_eq!((compacted.code, compacted.stderr.lines().count()), (3, 1), "{}", compacted.stderr);
    assert!(compacted.stderr.contains("1 record (") && compacted.stderr.contains(JOURNAL));
    let info = json("info", &map, &[]);
    assert_eq!((&info["experiences"], &info["places"]), (&3.into(), &2.into()));
    assert_eq!(json("verify", &map, &[])["damaged"], false);
}

#[test]
fn a_torn_tail_ends_with_3() {
    let (folder, map) = map();
    tear(&map);
    let verified = loci(&["map", "verify", text(&map), "--json"]);
    assert_eq!((verified.code, verified.stderr.lines().count()), (3, 1), "{}", verified.stderr);
    let report = &verified.records()[0];
    assert_eq!((&report["damaged"], &report["problems"][0]["torn_tail"]), (&false.into(), &true.into()));
    let info = loci(&["map", "info", text(&map), "--json"]);
    assert_eq!((info.code, &info.records()[0]["torn_bytes"]), (3, &99.into()));
    assert!(info.stderr.contains("site: 99 bytes of a torn last record"), "{}", info.stderr);
    let export = loci(&["map", "export", text(&map), "--out", text(&folder.path().join("out.csv"))]);
    assert_eq!(export.code, 3, "{}", export.stderr);
    let renamed = loci(&["map", "rename", text(&map), "0", "dock"]);
    assert!(renamed.code == 3 && renamed.stderr.contains("99 bytes"), "{}", renamed.stderr);
    assert_eq!(loci(&["map", "rename", text(&map), "0", "quay"]).code, 0, "it was cut off");
    tear(&map);
    let compacted = loci(&["map", "compact", text(&map)]);
    assert!(compacted.code == 3 && compacted.stderr.contains("99 bytes"), "{}", compacted.stderr);
    assert_eq!(loci(&["map", "verify", text(&map)]).code, 0);
}

/// The rows of the exported map, however they were written.
fn assert_rows(rows: &[BTreeMap<String, String>]) {
    let of = |name: &str| rows.iter().map(|row| row[name].as_str()).collect::<Vec<_>>();
    assert_eq!(of("experience"), ["0", "1", "2", "3"]);
    assert_eq!(of("place"), ["0", "0", "2", "2"]);
    assert_eq!(of("learnt_as"), ["0", "1", "2", "2"]);
    assert_eq!(of("place_name"), ["", "", STRANGE, STRANGE]);
    assert_eq!(of("is_keyframe"), ["true", "false", "true", "false"]);
    assert_eq!(of("frame_name"), ["000.jpg", STRANGE, "=1+1,\r\n.jpg", ""]);
    assert_eq!(of("capture_nanos")[3], "3000000021");
    assert_eq!([of("x"), of("z"), of("qw")].map(|column| column[2].to_owned()), ["1.5", "2", "0.8"]);
    assert_eq!([of("x")[1], of("qw")[3], of("model")[0]], ["", "", ""]);
    assert_eq!(of("mean_luminance"), ["80.25"; 4]);
    assert_eq!(of("features"), ["2", "", "2", ""]);
    assert_eq!(rows[0].len(), 19);
}

#[test]
fn a_csv_file_holds_every_experience_whatever_the_names_hold() {
    let (folder, map) = map();
    let out = folder.path().join("out.csv");
    let report = json("export", &map, &["--out", text(&out)]);
    assert_eq!(
        (&report["experiences"], &report["format"], &report["skipped"]),
        (&4.into(), &"csv".into(), &0.into())
    );
    let rows: Vec<BTreeMap<String, String>> =
        csv::Reader::from_path(&out).unwrap().deserialize().map(Result::unwrap).collect();
    assert_rows(&rows);
    let piped = loci(&["map", "export", text(&map), "--out", "-", "--format", "csv"]);
    assert_eq!((piped.code, piped.stdout), (0, fs::read_to_string(&out).unwrap()));
}

/// A JSON value as a CSV file has it.
fn plain(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        Value::Number(number) => number
            .as_f64()
            .filter(|number| number.fract() == 0.0)
            .map_or_else(|| number.to_string(), |number| format!("{number}")),
        other => other.to_string(),
    }
}

#[test]
fn json_has_the_places_too_and_goes_to_stdout_by_default() {
    let (_folder, map) = map();
    let export = loci(&["map", "export", text(&map), "--out", "-"]);
    assert_eq!((export.code, export.stderr.as_str()), (0, ""));
    let whole: Value = serde_json::from_str(&export.stdout).unwrap();
    let rows = whole["experiences"].as_array().unwrap().iter().map(|row| {
        let row = row.as_object().unwrap();
        row.iter().map(|(name, value)| (name.clone(), plain(value))).collect()
    });
    assert_rows(&rows.collect::<Vec<_>>());
    let places = whole["places"].as_array().unwrap();
    assert_eq!(places.len(), 3);
    assert_eq!(
        (&places[1]["merged_into"], &places[1]["experiences"]),
        (&0.into(), &Value::Array(Vec::new()))
    );
    assert_eq!((&places[2]["name"], &places[2]["neighbours"]), (&STRANGE.into(), &serde_json::json!([1])));
    assert_eq!(places[0]["experiences"], serde_json::json!([0, 1]));
}

/// A value of a Parquet file as a CSV file has it.
fn field_text(field: &Field) -> String {
    match field {
        Field::Null => String::new(),
        Field::Bool(flag) => flag.to_string(),
        Field::Long(number) => number.to_string(),
        Field::ULong(number) => number.to_string(),
        Field::Float(number) => number.to_string(),
        Field::Double(number) => number.to_string(),
        Field::Str(text) => text.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_parquet_file_reads_back_with_its_types() {
    let (folder, map) = map();
    let out = folder.path().join("out.parquet");
    json("export", &map, &["--out", text(&out)]);
    let reader = SerializedFileReader::new(File::open(&out).unwrap()).unwrap();
    let rows: Vec<BTreeMap<String, String>> = reader
        .get_row_iter(None)
        .unwrap()
        .map(|row| {
            let fields = row.unwrap().into_columns().into_iter();
            fields.map(|(name, field)| (name, field_text(&field))).collect()
        })
        .collect();
    assert_rows(&rows);
    let schema = reader.metadata().file_metadata().schema_descr();
    let types: Vec<String> =
        schema.columns().iter().map(|column| column.physical_type().to_string()).collect();
    assert_eq!((types[0].as_str(), types[4].as_str(), types[8].as_str()), ("INT64", "BOOLEAN", "DOUBLE"));
}

#[test]
fn a_parquet_file_of_many_experiences_has_many_row_groups() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site");
    let mut map = PlaceMap::open(&path, MapOptions::unbounded()).unwrap();
    for index in 0..10_005 {
        learn(&mut map, (index > 0).then_some(0), index, "x");
    }
    drop(map);
    let out = folder.path().join("out.parquet");
    json("export", &path, &["--out", text(&out)]);
    let reader = SerializedFileReader::new(File::open(&out).unwrap()).unwrap();
    let rows = reader.metadata().row_groups().iter().map(|group| group.num_rows()).collect::<Vec<_>>();
    assert_eq!(rows, [10_000, 5]);
}

#[test]
fn thumbnails_are_written_and_named_in_the_table() {
    let (folder, map) = map();
    let (out, pictures) = (folder.path().join("out.json"), folder.path().join("a/b"));
    let report = json("export", &map, &["--out", text(&out), "--thumbnails", text(&pictures)]);
    assert_eq!(report["thumbnails"], 4);
    let whole: Value = serde_json::from_slice(&fs::read(&out).unwrap()).unwrap();
    assert_eq!(whole["experiences"][3]["thumbnail"], "000003.jpg");
    assert_eq!(fs::read(pictures.join("000003.jpg")).unwrap(), b"thumbnail 3");
    assert_eq!(fs::read_dir(&pictures).unwrap().count(), 4);
}

#[test]
fn maps_of_version_1_are_exported_too() {
    let export = loci(&["map", "export", "tests/data/map/version_1", "--out", "-"]);
    let whole: Value = serde_json::from_str(&export.stdout).unwrap();
    assert_eq!((export.code, whole["experiences"].as_array().unwrap().len()), (0, 4), "{}", export.stderr);
    assert_eq!(whole["experiences"][1]["features"], 12);
    assert!(whole["experiences"][0]["model"].as_str().unwrap().starts_with("abab"), "{whole}");
}

#[test]
fn what_cannot_be_read_is_skipped_and_reported_and_the_export_ends_with_3() {
    let (folder, map) = map();
    let journal = fs::read(map.join(JOURNAL)).unwrap();
    let at = |wanted: &[u8]| journal.windows(wanted.len()).position(|bytes| bytes == wanted).unwrap();
    flip(&map.join(JOURNAL), at(b"thumbnail 0"));
    flip(&map.join(JOURNAL), at(b"=1+1"));
    let out = folder.path().join("out.csv");
    let pictures = folder.path().join("pictures");
    let export =
        loci(&["map", "export", text(&map), "--out", text(&out), "--thumbnails", text(&pictures), "--json"]);
    assert_eq!(export.code, 3, "{}", export.stderr);
    let report = &export.records()[0];
    assert_eq!((&report["experiences"], &report["thumbnails"]), (&3.into(), &2.into()));
    let reported: Vec<&str> = export.stderr.lines().collect();
    assert!(
        reported.len() == 2 && reported[0].contains("skipped: thumbnail of experience 0: "),
        "{reported:?}"
    );
    assert!(reported[1].contains("skipped: experience 2: "), "{reported:?}");
    loci(&["map", "verify", text(&map)]).assert_failed(1, &["problems found: 2"]);
}

#[test]
fn a_format_that_cannot_be_told_is_a_wrong_argument() {
    let (folder, map) = map();
    let out = folder.path().join("out.xls");
    let export = |arguments: &[&str]| loci(&[&["map", "export", text(&map)], arguments].concat());
    export(&["--out", text(&out)]).assert_failed(2, &["out.xls", ".parquet", "--format"]);
    export(&["--out", "-", "--format", "parquet"]).assert_failed(2, &["--out FILE.parquet"]);
    assert_eq!(export(&["--out", text(&out), "--format", "xls"]).code, 2);
    let both = ["--out", text(&out), "--format", "csv", "--thumbnails", text(&out)];
    export(&both).assert_failed(2, &["out.xls cannot be both --out and --thumbnails"]);
    assert!(!out.exists());
    assert_eq!(export(&[]).code, 2);
    assert_eq!(export(&["--out", text(&out), "--format", "csv"]).code, 0);
    assert!(fs::read_to_string(&out).unwrap().starts_with("experience,place,"));
}

#[test]
fn an_export_replaces_neither_devices_nor_the_map_itself() {
    let (folder, map) = map();
    let before = files(&map);
    let export = |out: &Path| loci(&["map", "export", text(&map), "--out", text(out), "--format", "json"]);
    export(Path::new("/dev/null")).assert_failed(1, &["/dev/null", "a device"]);
    export(&folder.path().join("gone/out.json")).assert_failed(1, &["cannot write", "gone/out.json"]);
    export(folder.path()).assert_failed(1, &["cannot write"]);
    export(&map.join(JOURNAL)).assert_failed(2, &["--out", JOURNAL, "choose another folder"]);
    assert!(files(&map) == before);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left behind");
}

#[test]
fn thumbnails_do_not_go_into_the_map_however_its_folder_is_spelt() {
    let (folder, map) = map();
    let before = files(&map);
    let link = folder.path().join("link");
    std::os::unix::fs::symlink(&map, &link).unwrap();
    let out = folder.path().join("out.csv");
    let export = |pictures: &Path| {
        loci(&["map", "export", text(&map), "--out", text(&out), "--thumbnails", text(pictures)])
    };
    let below = ["", ".", "new", "new/newer", "gone/..", "../site"];
    for pictures in [&map, &link].into_iter().flat_map(|map| below.map(|below| map.join(below))) {
        export(&pictures).assert_failed(2, &["--thumbnails", "lies in the map", "choose another folder"]);
    }
    assert!(files(&map) == before && !out.exists());
    assert_eq!(export(&map.join("../pictures")).code, 0);
    assert!(folder.path().join("pictures/000003.jpg").exists());
}

#[test]
fn an_export_whose_disk_is_full_says_so() {
    let (_folder, map) = map();
    let line = format!("'{}' map export '{}' --out - > /dev/full", env!("CARGO_BIN_EXE_loci"), text(&map));
    let output = Command::new("sh").args(["-c", &line]).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr.starts_with("loci: cannot write stdout: ") && stderr.lines().count() == 1, "{stderr}");
}

#[test]
fn an_export_that_nobody_reads_to_its_end_ends_quietly() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site");
    let mut map = PlaceMap::open(&path, MapOptions::unbounded()).unwrap();
    for index in 0..2000 {
        learn(&mut map, (index > 0).then_some(0), index, "x");
    }
    drop(map);
    let program = env!("CARGO_BIN_EXE_loci");
    let line = format!("set -o pipefail; '{program}' map export '{}' --out - | head -n 1", text(&path));
    let output = Command::new("bash").args(["-c", &line]).output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
}

#[test]
fn a_place_is_named_by_its_number_its_name_and_the_number_of_a_place_merged_into_it() {
    let (_folder, map) = map();
    let renamed = json("rename", &map, &["0", "dock 3"]);
    assert_eq!((&renamed["place"], &renamed["name_before"]), (&0.into(), &Value::Null));
    assert_eq!(json("rename", &map, &["dock 3", "dock 4"])["name_before"], "dock 3");
    assert_eq!(json("rename", &map, &["1", "dock 5"])["place"], 0);
    assert_eq!(json("rename", &map, &[STRANGE, "雪 «hall»"])["place"], 2);
    // The same name again is no clash.
    json("rename", &map, &["2", "雪 «hall»"]);
    let names: Vec<Option<String>> = PlaceMap::open_read_only(&map)
        .unwrap()
        .places()
        .map(|place| place.name.as_deref().map(str::to_owned))
        .collect();
    assert_eq!(names, [Some("dock 5".to_owned()), None, Some("雪 «hall»".to_owned())]);
    let said = loci(&["map", "rename", text(&map), "0", "dock"]);
    assert_eq!(said.stdout, "place 0 is called \"dock\", before \"dock 5\"\n");
    json("verify", &map, &[]);
}

#[test]
fn names_that_would_confuse_are_refused() {
    let (_folder, map) = map();
    let before = files(&map);
    let rename = |place: &str, name: &str| loci(&["map", "rename", text(&map), place, name]);
    for (name, reason) in [
        ("", "empty"),
        ("  ", "empty"),
        (" dock", "a space"),
        ("a\nb", "nobody sees"),
        ("\u{1b}[2J", "nobody sees"),
        ("a\u{202e}b", "nobody sees"),
        ("a\u{200b}", "nobody sees"),
        ("17", "a number"),
        (&"ü".repeat(201), "200 characters"),
    ] {
        rename("0", name).assert_failed(2, &["cannot name a place", reason, "name it like \"dock 3\""]);
    }
    assert!(files(&map) == before);
    rename("9", "dock").assert_failed(1, &["there is no place 9 in the map"]);
    rename("nowhere", "dock").assert_failed(1, &["no place in the map is called \"nowhere\""]);
    assert_eq!(rename("0", "M\u{fc}ller's \"e\u{301}\" \\ 雪").code, 0);
    assert_eq!(rename("0", &"ü".repeat(200)).code, 0);
    rename("2", &"ü".repeat(200)).assert_failed(1, &["place 0 is called", "already"]);
}

#[test]
fn the_name_of_a_merged_place_leads_to_what_it_became_until_another_one_is_called_so() {
    let (_folder, path) = map();
    let mut map = opened(&path);
    learn(&mut map, None, 4, "004.jpg");
    map.name_place(PlaceId(0), "dock").unwrap();
    map.name_place(PlaceId(3), "yard").unwrap();
    map.merge_places(PlaceId(3), PlaceId(0)).unwrap();
    drop(map);
    assert_eq!(json("rename", &path, &["yard", "quay"])["place"], 0);
    assert_eq!(json("rename", &path, &["2", "yard"])["place"], 2);
    assert_eq!(json("rename", &path, &["yard", "hall"])["place"], 2);
    loci(&["map", "rename", text(&path), "2", "quay"]).assert_failed(1, &["place 0 is called", "already"]);
}

#[test]
fn a_name_that_two_places_have_needs_the_number() {
    let (_folder, path) = map();
    let mut map = opened(&path);
    map.name_place(PlaceId(0), "hall").unwrap();
    map.name_place(PlaceId(2), "hall").unwrap();
    drop(map);
    loci(&["map", "rename", text(&path), "hall", "dock"])
        .assert_failed(1, &["places 0, 2 are called", "number"]);
}

#[test]
fn a_second_writer_is_told_who_holds_the_map_while_readers_go_on() {
    let (folder, path) = map();
    let mut held = opened(&path);
    learn(&mut held, Some(0), 7, "live.jpg");
    let holder = format!("process {} is writing there", std::process::id());
    loci(&["map", "rename", text(&path), "0", "dock"]).assert_failed(1, &[&holder]);
    loci(&["map", "compact", text(&path)]).assert_failed(1, &[&holder]);
    assert_eq!(json("info", &path, &[])["experiences"], 5);
    assert_eq!(json("verify", &path, &[])["damaged"], false);
    assert_eq!(json("export", &path, &["--out", text(&folder.path().join("o.csv"))])["experiences"], 5);
}

#[test]
fn compacting_makes_the_map_smaller_and_keeps_all_of_it() {
    let (folder, path) = map();
    let export = |name: &str| {
        let out = folder.path().join(name);
        json("export", &path, &["--out", text(&out)]);
        fs::read(out).unwrap()
    };
    let mut map = opened(&path);
    for round in 0..50 {
        map.name_place(PlaceId(2), &format!("round {round}")).unwrap();
    }
    drop(map);
    let before = export("before.json");
    let report = json("compact", &path, &[]);
    let bytes = |name: &str| report[name].as_u64().unwrap();
    assert!(bytes("bytes_after") + 1000 < bytes("bytes_before"), "{report}");
    assert_eq!(json("info", &path, &[])["journal_bytes"], report["bytes_after"]);
    assert!(export("after.json") == before);
    assert_eq!(json("verify", &path, &[])["snapshot"], "right");
    let again = loci(&["map", "compact", text(&path)]);
    assert!(again.stdout.starts_with("journal  "), "{}", again.stdout);
    loci(&["map", "compact", text(&path), "--map-disk", "1KiB"]).assert_failed(2, &["--map-disk"]);
}

#[test]
fn a_map_that_lost_its_end_is_read_and_neither_named_nor_compacted_nor_changed() {
    let (_folder, map) = map();
    let journal = map.join(JOURNAL);
    fs::write(&journal, &fs::read(&journal).unwrap()[..100]).unwrap();
    for command in [&["rename", "0", "dock"][..], &["compact"]] {
        let (name, arguments) = command.split_first().unwrap();
        let mut line = vec!["map", name, text(&map)];
        line.extend(arguments);
        loci(&line).assert_failed(1, &[JOURNAL, "knows more than the journal"]);
    }
    assert_eq!(loci(&["map", "export", text(&map), "--out", "-"]).code, 3, "what is there can be read");
    assert_eq!(fs::metadata(&journal).unwrap().len(), 100);
}
