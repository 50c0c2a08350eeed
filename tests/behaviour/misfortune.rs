//! What goes wrong around a map: a full disk, a folder that may not be written, files that vanish, a clock that
//! jumps, others at the same map. The robot says so and goes on recognising.

use std::collections::BTreeMap;
use std::fs::{self, Permissions};
use std::io::{BufRead, BufReader, Read};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use loci::frame::Frame;
use loci::place_map::{MapOptions, NewExperience, PlaceMap};
use loci::raster::{GreyImage, RgbImage};
use serde_json::Value;

use crate::map_care::tear;
use crate::program::{Finished, finished, loci, send, text};

const LOCI: &str = env!("CARGO_BIN_EXE_loci");
/// Two laps through the same light: whatever the first one learns is known on the second.
const TWO_LAPS: &str = "synthetic:street?laps=2&light=noon&frames=30&seed=5";
const ENDLESS: &str = "synthetic:corridor?laps=500&size=160x160";

fn learnt(records: &[Value]) -> usize {
    records.iter().filter(|record| !record["experience"].is_null()).count()
}

fn recognised(records: &[Value]) -> usize {
    let names_place =
        |record: &&Value| ["recognised", "revisited"].map(Value::from).contains(&record["decision"]);
    records.iter().filter(names_place).count()
}

fn info(map: &Path) -> Value {
    let run = loci(&["map", "info", text(map), "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    run.records().remove(0)
}

/// The lines that a run said beside its summary and progress.
fn complaints(run: &Finished) -> Vec<&str> {
    run.stderr.lines().filter(|line| line.starts_with("loci: ")).collect()
}

/// Everything in a folder.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    paths.map(|path| (path.clone(), fs::read(path).unwrap())).collect()
}

/// Takes the right to write from a folder and what is in it, or gives it back.
fn set_writable(folder: &Path, is_writable: bool) {
    let mode = if is_writable { 0o200 } else { 0 };
    for path in contents(folder).into_keys() {
        fs::set_permissions(path, Permissions::from_mode(0o444 | mode)).unwrap();
    }
    fs::set_permissions(folder, Permissions::from_mode(0o555 | mode)).unwrap();
}

/// `loci`, which may not write where the permissions of `folder` say that nobody may, not even as root.
pub(crate) fn loci_of_a_mere_user(folder: &Path) -> Command {
    // This process made it.
    if fs::metadata(folder).unwrap().uid() != 0 {
        return Command::new(LOCI);
    }
    let mut command = Command::new("setpriv");
    command.args(["--bounding-set=-dac_override,-dac_read_search", LOCI]);
    command
}

#[test]
fn on_a_full_disk_the_robot_keeps_what_it_learnt_and_goes_on_recognising() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    // A file that may not grow is refused as one that has no room, once the signal is ignored.
    let limited = ["-c", "trap '' XFSZ; exec prlimit --fsize=200000 \"$@\"", "sh", LOCI];
    let run =
        finished(Command::new("sh").args(limited).args(["run", TWO_LAPS, "--json", "--map", text(&map)]));
    assert_eq!(run.code, 3, "{}", run.stderr);
    let said = complaints(&run);
    assert_eq!(said.len(), 1, "{said:?}");
    for part in ["journal-000001.loci", "too large", "going on read-only, nothing more is learnt"] {
        assert!(said[0].contains(part), "no '{part}' in: {said:?}");
    }
    assert!(run.stderr.contains("1 failure of the map"), "{}", run.stderr);
    let records = run.records();
    assert_eq!(records.len(), 60, "a line a frame");
    let kept = learnt(&records);
    assert!((5..30).contains(&kept), "{kept} learnt");
    let is_of_use = |record: &Value| !record["experience"].is_null() || record["decision"] == "unknown";
    let before = records.iter().position(|record| !is_of_use(record)).unwrap();
    assert_eq!(learnt(&records[..before]), kept, "something was learnt after the failure");
    assert!(recognised(&records[30..30 + kept]) * 10 >= kept * 8, "{:?}", run.decisions());
    assert_eq!((&info(&map)["experiences"], &info(&map)["torn_bytes"]), (&kept.into(), &0.into()));

    let with_room = loci(&["run", TWO_LAPS, "--json", "--map", text(&map)]);
    assert_eq!(with_room.code, 0, "{}", with_room.stderr);
    assert_eq!(info(&map)["experiences"], kept + learnt(&with_room.records()));
}

#[test]
fn in_a_folder_that_may_not_be_written_the_robot_recognises_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    assert_eq!(loci(&["run", TWO_LAPS, "--map", text(&map)]).code, 0);
    let before = contents(&map);
    set_writable(&map, false);
    let run = finished(loci_of_a_mere_user(&map).args(["run", TWO_LAPS, "--json", "--map", text(&map)]));
    let fresh = map.join("fresh");
    let new_map = finished(loci_of_a_mere_user(&map).args(["run", TWO_LAPS, "--map", text(&fresh)]));
    set_writable(&map, true);
    assert_eq!(run.code, 3, "{}", run.stderr);
    let said = complaints(&run);
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains(text(&map)) && said[0].contains("Permission denied"), "{said:?}");
    assert!(said[0].contains("going on read-only, nothing more is learnt"), "{said:?}");
    assert_eq!((run.records().len(), learnt(&run.records())), (60, 0));
    assert!(recognised(&run.records()) >= 54, "{:?}", run.decisions());
    assert!(contents(&map) == before, "something was written");
    new_map.assert_failed(1, &[text(&fresh), "Permission denied"]);
}

/// Starts a run that never ends, takes something away under it, and answers what it did then.
fn run_that_loses(map: &Path, take_away: impl FnOnce()) -> Finished {
    let mut run = Command::new(LOCI)
        .args(["run", ENDLESS, "--json", "--durability", "every", "--map", text(map)])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(run.stdout.take().unwrap()).lines().map(Result::unwrap);
    let mut said: Vec<String> = lines.by_ref().take(5).collect();
    take_away();
    // More than were on their way meanwhile.
    said.extend(lines.by_ref().take(100));
    send("TERM", &run);
    said.extend(lines);
    let mut stderr = String::new();
    run.stderr.take().unwrap().read_to_string(&mut stderr).unwrap();
    Finished { code: run.wait().unwrap().code().unwrap(), stdout: said.join("\n"), stderr }
}

#[test]
fn a_robot_whose_map_is_deleted_under_it_says_so_and_acknowledges_nothing_more() {
    for takes_folder in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let map = folder.path().join("map");
        let journal = map.join("journal-000001.loci");
        let run = run_that_loses(&map, || match takes_folder {
            true => fs::remove_dir_all(&map).unwrap(),
            false => fs::remove_file(&journal).unwrap(),
        });
        assert_eq!(run.code, 3, "{}", run.stderr);
        let said = complaints(&run);
        assert_eq!(said.len(), 1, "{said:?}");
        for part in [text(&journal), "deleted while it was being written", "going on read-only"] {
            assert!(said[0].contains(part), "no '{part}' in: {said:?}");
        }
        let records = run.records();
        let last = &records[records.len() - 50..];
        assert_eq!(learnt(last), 0, "acknowledged though there is no file");
        assert!(recognised(last) > 0, "{:?}", run.decisions());
    }
}

#[test]
fn a_run_that_leaves_out_or_cuts_off_a_torn_record_says_so_and_ends_with_3() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    let run = |arguments: &[&str]| {
        loci(&[&["run", "synthetic:street?laps=1&frames=3", "--map", text(&map)], arguments].concat())
    };
    assert_eq!(run(&[]).code, 0);
    tear(&map);
    let torn = contents(&map);
    for arguments in [&["--read-only"][..], &[]] {
        assert!(contents(&map) == torn, "a reader mends nothing");
        let ended = run(arguments);
        assert_eq!(ended.code, 3, "{}", ended.stderr);
        let said = complaints(&ended);
        assert_eq!(said, ["loci: the map's last record was torn (99 bytes) and is left out"]);
    }
    let mended = run(&[]);
    assert_eq!((mended.code, complaints(&mended)), (0, Vec::new()), "{}", mended.stderr);
}

#[test]
fn a_clock_that_jumps_changes_nothing_but_the_times_that_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    let times = [5_000_000_000, 4_000_000_000, i64::MIN, i64::MAX, 0];
    let mut grown = PlaceMap::open(&map, MapOptions::default()).unwrap();
    for (index, capture_nanos) in times.into_iter().enumerate() {
        let frame = Frame {
            index: index as u64,
            capture_nanos,
            name: String::new(),
            colour: RgbImage::new(4, 4),
            grey: GreyImage::new(4, 4),
            jpeg: None,
            pose: None,
            true_place: None,
        };
        let new = NewExperience {
            frame: &frame,
            view: 0,
            mean_luminance: 80.0,
            thumbnail_jpeg: &[],
            keyframe: None,
        };
        grown.learn(None, &new).unwrap();
    }
    grown.close().unwrap();
    assert_eq!(loci(&["map", "verify", text(&map)]).code, 0);
    let exported = loci(&["map", "export", text(&map), "--out", "-"]);
    assert_eq!(exported.code, 0, "{}", exported.stderr);
    let exported: Value = serde_json::from_str(&exported.stdout).unwrap();
    let experiences = exported["experiences"].as_array().unwrap();
    let written: Vec<i64> = experiences.iter().map(|e| e["capture_nanos"].as_i64().unwrap()).collect();
    assert_eq!(written, times);
}

#[test]
fn whoever_reads_a_map_that_is_being_written_finds_it_whole() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    // So small that segments are filled, emptied and deleted all the time.
    let arguments = ["run", ENDLESS, "--map-disk", "1MiB", "--map", text(&map)];
    let mut writer =
        Command::new(LOCI).args(arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut lines = BufReader::new(writer.stdout.take().unwrap()).lines();
    lines.next().unwrap().unwrap();
    let first_segment = map.join("journal-000001.loci");
    let read = |arguments: &[&str]| {
        let reads_until_segments_go = (0..1000).take_while(|&read| read < 10 || first_segment.exists());
        for _ in reads_until_segments_go {
            let run = loci(&[&["map", arguments[0], text(&map)], &arguments[1..]].concat());
            // A record that is just being written looks as a torn one does.
            assert!([0, 3].contains(&run.code), "{arguments:?}: {} {}", run.stdout, run.stderr);
        }
    };
    let readers: [&[&str]; 4] =
        [&["info"], &["verify"], &["export", "--out", "-"], &["export", "--format", "csv", "--out", "-"]];
    std::thread::scope(|scope| {
        let readers = readers.map(|arguments| scope.spawn(move || read(arguments)));
        scope.spawn(move || lines.for_each(|line| drop(line.unwrap())));
        let read = readers.map(|reader| reader.join());
        writer.kill().unwrap();
        assert!(read.iter().all(Result::is_ok), "a reader failed");
    });
    writer.wait().unwrap();
    assert!(!first_segment.exists(), "no segment was deleted meanwhile");
    assert_eq!(loci(&["map", "verify", text(&map)]).stderr.matches("damaged").count(), 0);
}
