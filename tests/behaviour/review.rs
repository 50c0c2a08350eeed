//! `loci review`: maps and logs made into recordings, seen from outside.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use crate::program::{Finished, finished, loci, text};

/// A drive with its map and its log.
fn driven() -> (TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let (map, log) = (folder.path().join("site"), folder.path().join("drive.jsonl"));
    let world = "synthetic:street?laps=2&frames=8&size=160x160&seed=4";
    let run = loci(&["run", world, "--map", text(&map), "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    fs::write(&log, run.stdout).unwrap();
    (folder, map, log)
}

fn review(what: &Path, out: &Path, more: &[&str]) -> Finished {
    loci(&[&["review", text(what), "--no-open", "--out", text(out)], more].concat())
}

#[test]
fn a_map_and_the_log_of_a_run_become_recordings() {
    let (folder, map, log) = driven();
    let out = folder.path().join("review.rrd");
    for (what, more, told) in [
        (&map, &[][..], "experiences are in"),
        (&log, &[], "16 frames at "),
        (&log, &["--map", text(&map)], "16 frames at "),
    ] {
        let reviewed = review(what, &out, more);
        assert_eq!(reviewed.code, 0, "{}", reviewed.stderr);
        assert!(reviewed.stdout.contains(told), "{}", reviewed.stdout);
        assert!(fs::read(&out).unwrap().starts_with(b"RRF"));
        fs::remove_file(&out).unwrap();
    }
}

#[test]
fn a_recording_is_called_by_what_is_reviewed_and_takes_the_place_of_no_other() {
    let (folder, _, _) = driven();
    let live = folder.path().join("drive.rrd");
    fs::write(&live, "a recording of the drive").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_loci"));
    command.args(["review", "drive.jsonl", "--no-open"]).current_dir(folder.path());
    finished(command.env("RERUN", "off"))
        .assert_failed(1, &["the environment switches rerun off; unset RERUN"]);
    let reviewed = finished(command.env_remove("RERUN"));
    assert_eq!(reviewed.code, 0, "{}", reviewed.stderr);
    assert!(fs::read(folder.path().join("drive.jsonl.review.rrd")).unwrap().starts_with(b"RRF"));
    assert_eq!(fs::read_to_string(live).unwrap(), "a recording of the drive");
}

#[test]
fn what_is_left_of_a_map_is_reviewed_and_the_rest_told() {
    let (folder, map, _) = driven();
    let journal = map.join("journal-000001.loci");
    let mut bytes = fs::read(&journal).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    fs::write(&journal, bytes).unwrap();
    let reviewed = review(&map, &folder.path().join("review.rrd"), &[]);
    assert_eq!(reviewed.code, 3, "{} {}", reviewed.stdout, reviewed.stderr);
    assert!(reviewed.stderr.starts_with("loci: "), "{}", reviewed.stderr);
}

#[test]
fn what_is_left_of_a_log_is_reviewed_and_the_rest_counted() {
    let (folder, _, log) = driven();
    let whole = fs::read_to_string(&log).unwrap();
    fs::write(&log, &whole[..whole.len() - 40]).unwrap();
    let reviewed = review(&log, &folder.path().join("review.rrd"), &[]);
    assert_eq!(reviewed.code, 3, "{}", reviewed.stderr);
    assert!(reviewed.stdout.contains("15 frames"), "{}", reviewed.stdout);
    assert!(reviewed.stderr.contains("1 of its lines and pictures"), "{}", reviewed.stderr);
}

#[test]
fn what_is_neither_a_map_nor_a_log_is_refused_and_no_recording_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let (out, none) = (folder.path().join("review.rrd"), folder.path().join("none"));
    let prose = folder.path().join("prose.txt");
    fs::write(&prose, "It was a dark and stormy night.\n").unwrap();
    review(Path::new("/dev/null"), &out, &[]).assert_failed(1, &["/dev/null: neither", "it is no file"]);
    review(&none, &out, &[]).assert_failed(1, &["none: neither a map's folder nor a log"]);
    review(&prose, &out, &[]).assert_failed(1, &["prose.txt: line 1: not what `loci run --json` writes"]);
    review(folder.path(), &out, &[]).assert_failed(1, &["no map in"]);
    review(folder.path(), &out, &["--map", "x"]).assert_failed(2, &["--map goes with the log of a run"]);
    review(&prose, &out.with_extension("txt"), &[]).assert_failed(2, &["must end in .rrd"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}
