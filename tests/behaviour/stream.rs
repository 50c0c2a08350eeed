//! The main job on synthetic drives, whose true places are known.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use loci::raster::RgbImage;
use loci::source::{self, FrameSource};

use crate::program::{Finished, loci, loci_without_runtime, send, text};

const FRAMES_PER_LAP: usize = 60;

/// The true place of every frame of a synthetic drive.
fn true_places(world: &str) -> Vec<u32> {
    let mut source: Box<dyn FrameSource> = source::open(world, None).unwrap();
    std::iter::from_fn(|| source.next_frame()).map(|frame| frame.unwrap().true_place.unwrap()).collect()
}

/// Answers of the laps after the first: how many name a place, how many of these rightly, of how many.
/// Right is a place that the first lap saw at most one true place away.
fn score(run: &Finished, truth: &[u32]) -> (usize, usize, usize) {
    let mut seen_at: BTreeMap<u64, BTreeSet<u32>> = BTreeMap::new();
    let (mut named, mut right) = (0, 0);
    let records = run.records();
    assert_eq!(records.len(), truth.len(), "a line a frame");
    for (index, (record, &place)) in records.iter().zip(truth).enumerate() {
        let Some(answer) = record["place"].as_u64() else { continue };
        if index < FRAMES_PER_LAP {
            seen_at.entry(answer).or_default().insert(place);
        } else if ["recognised", "revisited"].contains(&record["decision"].as_str().unwrap()) {
            named += 1;
            let near = place.saturating_sub(1)..=place + 1;
            right +=
                usize::from(seen_at.get(&answer).is_some_and(|places| places.range(near).next().is_some()));
        }
    }
    (named, right, truth.len() - FRAMES_PER_LAP)
}

#[test]
fn a_second_lap_at_the_same_light_is_known() {
    let world = "synthetic:street?laps=2&light=noon&frames=60&seed=21";
    let (named, right, frames) = score(&loci(&["run", world, "--json"]), &true_places(world));
    assert!(named * 100 >= frames * 90, "{named} of {frames} named");
    assert!(right * 100 >= named * 95, "{right} of {named} right");
}

#[test]
fn poses_of_a_file_are_stored_with_the_experiences_of_their_time() {
    let folder = tempfile::tempdir().unwrap();
    let [images, map, poses] = ["images", "map", "poses.txt"].map(|name| folder.path().join(name));
    std::fs::create_dir(&images).unwrap();
    let mut street = source::open("synthetic:street?laps=1&frames=60&seed=21", None).unwrap();
    for second in 0..3 {
        let frame = street.next_frame().unwrap().unwrap();
        std::fs::write(images.join(format!("10000000{second}0.5.jpg")), source::jpeg(&frame.colour)).unwrap();
    }
    // Of the third image nobody knows: the track ends before.
    std::fs::write(
        &poses,
        "1000000000 1 2 3 0 0 0 1\n1000000001 3 2 3 0 0 0 1\n1000000010.5 9 9 9 0 0 0 1\n",
    )
    .unwrap();
    let run = ["run", text(&images), "--map", text(&map), "--pose", text(&poses)];
    let run = loci(&[&run[..], &["--model", "none"]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    let export = loci(&["map", "export", text(&map), "--out", "-"]);
    let export: serde_json::Value = serde_json::from_str(&export.stdout).unwrap();
    let x: Vec<_> = export["experiences"].as_array().unwrap().iter().map(|row| row["x"].as_f64()).collect();
    assert_eq!(x, [Some(2.0), Some(9.0), None]);

    std::fs::write(&poses, "1000000000 1 2 3 0 0 0 1\n1000000001 3 2\n").unwrap();
    let run = loci(&["run", text(&images), "--pose", text(&poses)]);
    run.assert_failed(1, &[text(&poses), "line 2", "eight numbers"]);
}

#[test]
fn without_onnx_runtime_bow_and_hough_voting_go_on_alone_and_say_so() {
    let world = "synthetic:corridor?laps=2&light=noon&frames=60&seed=22";
    let run = loci_without_runtime(&["run", world, "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stderr.contains("NO CNN, going on with BoW+HV alone"), "{}", run.stderr);
    assert!(run.stderr.contains("make deps"), "{}", run.stderr);
    assert!(run.records().iter().all(|record| record["cnn"] == "unavailable"));
    let (named, right, frames) = score(&run, &true_places(world));
    assert!(named * 100 >= frames * 60, "{named} of {frames} named");
    assert!(right * 100 >= named * 90, "{right} of {named} right");
}

#[test]
fn where_no_cnn_is_wanted_bow_and_hough_voting_decide_alone_without_a_word() {
    let run = loci(&["run", "synthetic:corridor?laps=1&frames=10&seed=22", "--json", "--model", "none"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(!run.stderr.contains("NO CNN"), "{}", run.stderr);
    assert!(run.records().iter().all(|record| record["cnn"] == "unavailable"));
}

#[test]
fn the_same_stream_gives_the_same_decisions() {
    let run = || {
        let mut records = loci(&["run", "synthetic:street?laps=1&frames=20&seed=3", "--json"]).records();
        for record in &mut records {
            // How long it took and what waited meanwhile is another matter.
            assert_eq!(record["flow"]["dropped"], 0, "{record}");
            let record = record.as_object_mut().unwrap();
            for timing in ["latency_us", "flow"] {
                record.remove(timing).unwrap();
            }
        }
        records
    };
    assert_eq!(run(), run());
}

#[test]
fn a_map_is_kept_and_localised_in_without_changing_it() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    let world = "synthetic:street?laps=1&frames=30&seed=5";
    assert_eq!(loci(&["run", world, "--map", text(&map)]).code, 0);
    let before = loci(&["map", "info", text(&map), "--json"]).stdout;
    let again = loci(&["run", world, "--map", text(&map), "--read-only", "--json"]);
    assert_eq!(again.code, 0, "{}", again.stderr);
    let known = again.decisions().iter().filter(|decision| *decision == "recognised").count();
    assert!(known >= 27, "{known} of 30 recognised");
    let elsewhere =
        loci(&["run", "synthetic:corridor?laps=1&frames=10", "--map", text(&map), "--read-only", "--json"]);
    let decisions = elsewhere.decisions();
    assert!(decisions.iter().all(|decision| decision == "unknown"), "{decisions:?}");
    assert_eq!(loci(&["map", "info", text(&map), "--json"]).stdout, before);
}

#[test]
fn sigterm_ends_a_run_with_everything_committed() {
    let folder = tempfile::tempdir().unwrap();
    let arguments =
        ["run", "synthetic:corridor?laps=50&size=160x160", "--map", text(folder.path()), "--json"];
    let mut program = Command::new(env!("CARGO_BIN_EXE_loci"))
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(program.stdout.take().unwrap()).lines();
    let first: Vec<_> = lines.by_ref().take(5).collect();
    send("TERM", &program);
    let answered: Vec<String> = first.into_iter().chain(lines).map(Result::unwrap).collect();
    assert_eq!(program.wait().unwrap().code(), Some(0));
    let map = &loci(&["map", "info", text(folder.path()), "--json"]).records()[0];
    let learnt = answered.iter().filter(|line| !line.contains(r#""experience":null"#)).count();
    assert_eq!((&map["experiences"], &map["torn_bytes"]), (&learnt.into(), &0.into()));
    assert!(learnt > 0 && answered.len() < 3000, "it ran to the end");
}

#[test]
fn a_hand_before_the_camera_founds_no_place() {
    let folder = tempfile::tempdir().unwrap();
    let mut street = source::open("synthetic:street?laps=1&light=noon&frames=60&seed=21", None).unwrap();
    let frames: Vec<_> =
        std::iter::from_fn(|| street.next_frame()).map(|frame| frame.unwrap().colour).collect();
    let hand = RgbImage::new(640, 480);
    for (index, picture) in
        [&frames[0], &frames[20], &hand, &frames[40], &hand, &hand].into_iter().enumerate()
    {
        std::fs::write(folder.path().join(format!("{index}.jpg")), source::jpeg(picture)).unwrap();
    }
    let run = loci(&["run", text(folder.path()), "--place-interval", "0", "--json"]);
    let expected = ["new_place", "new_place", "unknown", "new_place", "unknown", "new_place"];
    assert_eq!(run.decisions(), expected, "the second one does: it may be dark here");
}

#[test]
fn sampling_keeps_every_nth_frame() {
    let run = loci(&["run", "synthetic:street?laps=1&frames=9", "--sample-interval", "4", "--json"]);
    let frames: Vec<u64> = run.records().iter().map(|record| record["frame"].as_u64().unwrap()).collect();
    assert_eq!(frames, [0, 4, 8]);
}

#[cfg(feature = "rerun")]
#[test]
fn a_recording_is_written_for_rerun() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("drive.rrd");
    let target = format!("save={}", recording.display());
    let run = loci(&["run", "synthetic:street?laps=1&frames=4&size=160x160", "--rerun", &target]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(std::fs::read(recording).unwrap().starts_with(b"RRF"));
}

#[test]
fn a_frame_is_explained_with_its_candidates_belief_and_thresholds_and_no_other_line_is_printed() {
    let world = "synthetic:street?laps=2&light=noon&frames=60&seed=21";
    let run = loci(&["run", world, "--explain", "70", "--explain", "3"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    for part in ["frame 3, synthetic:street#0003: same_place", "within the place interval", "frame 70, "] {
        assert!(run.stdout.contains(part), "no '{part}' in: {}", run.stdout);
    }
    for part in [
        "votes",
        "log odds",
        "before",
        "after",
        "accepted",
        "elsewhere",
        "needed: probability 0.500",
        "poor below 256",
    ] {
        assert!(run.stdout.contains(part), "no '{part}' in: {}", run.stdout);
    }
    assert!(!run.stdout.contains("frame 4, "), "{}", run.stdout);
    let missed = loci(&["run", "synthetic:street?laps=1&frames=3", "--explain", "3"]);
    assert_eq!(missed.code, 1);
    assert!(
        missed.stderr.contains("frame 3 cannot be explained, for it was not looked at"),
        "{}",
        missed.stderr
    );
    assert_eq!(loci(&["run", world, "--explain", "3", "--json"]).code, 2);
}

#[test]
fn with_the_frames_before_it_more_of_a_night_is_named_than_frame_by_frame_and_no_more_of_another_world() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    let map = map.to_str().unwrap();
    assert_eq!(loci(&["run", "synthetic:street?laps=1&light=noon&frames=60&seed=21", "--map", map]).code, 0);
    let named = |world: &str, sequence: &str| {
        let run = loci(&["run", world, "--map", map, "--read-only", "--json", "--sequence", sequence]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        run.records().iter().filter(|record| record["decision"] != "unknown").count()
    };
    let night = "synthetic:street?laps=1&light=night&frames=60&seed=21";
    let (alone, in_sequence) = (named(night, "off"), named(night, "on"));
    assert!(in_sequence > alone, "{in_sequence} in sequence, {alone} alone");
    let elsewhere = named("synthetic:street?laps=1&light=noon&frames=60&seed=99", "on");
    assert!(elsewhere <= 6, "{elsewhere} of 60 frames of another world");
}
