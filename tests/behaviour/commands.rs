//! The commands: their help, their exit codes, and what they print.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::program::{finished, loci, loci_with_vocabulary_variable, text};

#[test]
fn commands_that_are_not_built_say_so_and_fail() {
    for command in ["sync", "bench"] {
        let message = format!("`loci {command}` is not built yet");
        loci(&[command, "--with", "anything"]).assert_failed(1, &[&message]);
    }
    #[cfg(not(feature = "train"))]
    loci(&["train", "maps/site", "--out", "models/site"])
        .assert_failed(1, &["build with `--features train`"]);
}

#[test]
fn help_of_every_built_command_shows_an_example() {
    let commands: [&[&str]; 16] = [
        &["run"],
        &["demo"],
        &["evaluate"],
        &["vocab", "train"],
        &["vocab", "import"],
        &["vocab", "bench"],
        &["vocab", "info"],
        &["map", "info"],
        &["map", "verify"],
        &["map", "export"],
        &["map", "rename"],
        &["map", "merge"],
        &["map", "compact"],
        &["review"],
        &["doctor"],
        &["devices"],
    ];
    for command in commands {
        let help = loci(&[command, &["--help"]].concat());
        assert_eq!(help.code, 0);
        assert!(help.stdout.contains("Example"), "{command:?}: {}", help.stdout);
        assert!(help.stdout.contains("  loci "), "{command:?}: {}", help.stdout);
    }
}

#[test]
fn wrong_arguments_end_with_2() {
    assert_eq!(loci(&["run"]).code, 2);
    assert_eq!(loci(&["fly"]).code, 2);
    assert_eq!(loci(&["map", "merge", "a", "b"]).code, 2);
    assert_eq!(loci(&["run", "synthetic:street", "--sample-interval", "0"]).code, 2);
    loci(&["run", "synthetic:street", "--read-only"]).assert_failed(2, &["--map"]);
    loci(&["run", "synthetic:street", "--rerun", "paint"]).assert_failed(2, &["save=FILE.rrd"]);
    loci(&["run", "synthetic:street", "--config", "/none.toml"]).assert_failed(2, &["/none.toml"]);
}

#[test]
fn sizes_that_are_none_or_too_small_are_refused_wherever_they_stand() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("loci.toml");
    let run = |arguments: &[&str]| loci(&[&["run", "synthetic:street?laps=1&frames=1"], arguments].concat());
    let run_with = |variable: &str, value: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_loci"));
        finished(command.args(["run", "synthetic:street?laps=1&frames=1"]).env(variable, value))
    };
    for (flag, variable) in [("--map-disk", "LOCI_MAP_DISK"), ("--map-memory", "LOCI_MAP_MEMORY")] {
        fs::write(&config, format!("threads = 1\n{} = \"banana\"", &flag[2..])).unwrap();
        run(&["--config", text(&config)]).assert_failed(2, &["loci.toml, line 2", "a size such as 64MiB"]);
        for refused in [run(&[flag, "banana"]), run_with(variable, "banana")] {
            assert_eq!(refused.code, 2);
            let reason =
                format!("'banana' for '{flag} <SIZE>': expected a size such as 64MiB or 1.5GB, got banana\n");
            assert!(refused.stderr.contains(&reason), "{}", refused.stderr);
        }
        fs::write(&config, format!("{} = 1", &flag[2..])).unwrap();
        for refused in [run(&[flag, "1"]), run_with(variable, "1"), run(&["--config", text(&config)])] {
            refused.assert_failed(2, &[flag, "at least 1MiB"]);
        }
        assert_eq!(run(&[flag, "1MiB"]).code, 0);
    }
}

#[test]
fn settings_come_from_a_file_too_and_unknown_keys_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("loci.toml");
    fs::write(&config, "sample-interval = 3").unwrap();
    let run = loci(&["run", "synthetic:street?laps=1&frames=6", "--json", "--config", text(&config)]);
    assert_eq!(run.records().len(), 2);
    fs::write(&config, "sample-intervall = 3").unwrap();
    let run = loci(&["run", "synthetic:street?laps=1&frames=6", "--config", text(&config)]);
    run.assert_failed(2, &["loci.toml", "unknown field `sample-intervall`"]);
}

#[test]
fn a_vocabulary_is_trained_and_described() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("small.lvoc");
    let world = "synthetic:street?laps=1&frames=5";
    let trained =
        loci(&["vocab", "train", world, "--branching", "6", "--depth", "3", "--out", text(&path), "--json"]);
    assert_eq!(trained.code, 0, "{}", trained.stderr);
    let info = &loci(&["vocab", "info", text(&path), "--verify", "--json"]).records()[0];
    let trained = &trained.records()[0];
    for (key, value) in info.as_object().unwrap() {
        assert_eq!(&trained[key], value, "{key}");
    }
    let distortion = trained["mean_distortion_bits"].as_f64().unwrap();
    assert!((5.0..80.0).contains(&distortion), "{distortion}");
    assert_eq!(trained["descriptors"], trained["sampled_descriptors"]);
    let occupancy = trained["descriptors"].as_f64().unwrap() / trained["words"].as_f64().unwrap();
    assert!((trained["mean_occupancy"].as_f64().unwrap() - occupancy).abs() < 1e-9);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left behind");
    assert_eq!((&info["branching"], &info["depth"], &info["images"]), (&6.into(), &3.into(), &5.into()));
    assert!((100..=216).contains(&info["words"].as_u64().unwrap()), "{info}");
    let run = loci(&["run", world, "--vocab", text(&path), "--json"]);
    assert_eq!(run.records().len(), 5);
}

#[test]
fn a_vocabulary_is_timed() {
    let bench = loci(&["vocab", "bench", "vocab/default.lvoc", "--json"]);
    assert_eq!(bench.code, 0, "{}", bench.stderr);
    let report = &bench.records()[0];
    assert_eq!((&report["words"], &report["descriptors"]), (&99_149.into(), &1000.into()));
    let sets = report["different_sets"].as_u64().unwrap();
    assert!((12..=24).contains(&sets), "about one of each of the 24 frames: {report}");
    for time in ["open_to_first_word_us", "bow_us"] {
        assert!(report[time].as_f64().unwrap() > 1.0, "{report}");
    }
    assert!(report["private_bytes"].as_u64().unwrap() < 1 << 20, "{report}");
}

#[test]
fn a_vocabulary_of_dbow2_is_imported_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("orb.lvoc");
    let imported = loci(&["vocab", "import", "tests/data/vocabulary/orb_k8_l3.yml.gz", "--out", text(&path)]);
    assert_eq!(imported.code, 0, "{}", imported.stderr);
    for part in ["DBoW2 YAML vocabulary", "branching 8, depth 3", "512, 2 of them without weight; tf-idf"] {
        assert!(imported.stdout.contains(part), "no '{part}' in: {}", imported.stdout);
    }
    let run = loci(&["run", "synthetic:street?laps=1&frames=3", "--vocab", text(&path), "--json"]);
    assert_eq!(run.records().len(), 3);
}

#[test]
fn an_older_vocabulary_is_brought_up_to_date_and_one_by_which_nothing_is_found_is_pointed_out() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("new.lvoc");
    let import = |file: &str| loci(&["vocab", "import", file, "--out", text(&out), "--json"]);
    let imported = import("tests/data/vocabulary/version_1.lvoc");
    assert_eq!((imported.code, imported.stderr.as_str()), (0, ""));
    let bytes = std::fs::metadata(&out).unwrap().len();
    assert_eq!(
        (&imported.records()[0]["version"], &imported.records()[0]["bytes"]),
        (&2.into(), &bytes.into())
    );
    let flat = folder.path().join("flat.txt");
    let leaf = |byte: u8| format!("0 1{} 0\n", format!(" {byte}").repeat(32));
    std::fs::write(&flat, format!("2 1 0 0\n{}{}", leaf(1), leaf(254))).unwrap();
    let imported = import(text(&flat));
    assert_eq!(imported.code, 0, "{}", imported.stderr);
    assert!(imported.stderr.contains("no word of the file weighs anything"), "{}", imported.stderr);
}

#[test]
fn a_vocabulary_without_weights_learns_them_from_images() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("orb.lvoc");
    let fbow = "tests/data/vocabulary/orb_k8_l3.fbow";
    let weigh = |images: &str| {
        loci(&["vocab", "import", fbow, "--weights-from", images, "--out", text(&path), "--json"])
    };
    let bare = loci(&["vocab", "import", fbow, "--out", text(&path)]);
    assert!(bare.stderr.contains("6 words of the file without weight"), "{}", bare.stderr);
    let weighed = weigh("synthetic:street?laps=1&frames=3");
    assert!(weighed.code == 0 && weighed.stderr.is_empty(), "{}", weighed.stderr);
    let info = &weighed.records()[0];
    assert_eq!((&info["images"], &info["weighting"]), (&3.into(), &"tf-idf".into()));
    assert!((1..512).contains(&info["weightless_words"].as_u64().unwrap()), "{info}");
    assert!(info["mean_luminance"].as_f64().unwrap() > 20.0, "{info}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left behind");
    weigh(text(folder.path())).assert_failed(1, &["no images in", text(folder.path())]);
}

#[test]
fn images_that_weigh_no_word_are_refused_for_an_import_and_reported_by_a_training() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("orb.lvoc");
    let fbow = "tests/data/vocabulary/orb_k8_l3.fbow";
    let weigh =
        |images: &str| loci(&["vocab", "import", fbow, "--weights-from", images, "--out", text(&path)]);
    let one_image = "synthetic:street?laps=1&frames=1";
    weigh(one_image).assert_failed(1, &["no word weighs anything", "add images of other scenes"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left behind");
    let weighed = weigh("synthetic:street?laps=1&frames=2");
    assert!(weighed.code == 0 && weighed.stderr.is_empty(), "{}", weighed.stderr);

    let train =
        |images: &str| loci(&["vocab", "train", images, "--depth", "3", "--out", text(&path), "--json"]);
    let trained = train(one_image);
    assert_eq!(trained.code, 0, "{}", trained.stderr);
    assert!(trained.stderr.starts_with("loci: no word weighs anything: "), "{}", trained.stderr);
    let info = &trained.records()[0];
    assert_eq!(info["weightless_words"], info["words"]);
    let trained = train("synthetic:street?laps=1&frames=2");
    assert!(trained.code == 0 && trained.stderr.is_empty(), "{}", trained.stderr);
}

#[test]
fn the_demo_tells_a_newcomer_what_happened() {
    let demo = loci(&["demo"]);
    assert_eq!(demo.code, 0, "{}", demo.stderr);
    for part in ["Lap 1, noon", "founded", "Lap 2, dusk", "the right one", "Next: loci run"] {
        assert!(demo.stdout.contains(part), "no '{part}' in: {}", demo.stdout);
    }
}

#[test]
fn cameras_are_listed_or_it_is_said_why_none_are() {
    if cfg!(not(feature = "v4l")) {
        loci(&["devices"]).assert_failed(1, &["build with `--features v4l`"]);
        return;
    }
    let devices = loci(&["devices", "--json"]);
    let listing = devices.records()[0].clone();
    assert_eq!(listing["schema"], "loci-devices-1");
    let (cameras, refusals) =
        (listing["cameras"].as_array().unwrap(), listing["refusals"].as_array().unwrap());
    assert_eq!(devices.code, if refusals.is_empty() { 0 } else { 3 });
    if cameras.is_empty() && refusals.is_empty() {
        assert!(devices.stderr.contains("no cameras; plug one in"), "{}", devices.stderr);
        assert_eq!(loci(&["devices"]).stdout, "");
    }
}

#[cfg(feature = "cnn")]
#[test]
fn the_doctor_finds_every_part_in_order() {
    let doctor = loci(&["doctor", "--json"]);
    assert_eq!(doctor.code, 0, "{}{}", doctor.stdout, doctor.stderr);
    let findings = doctor.records()[0].as_array().unwrap().clone();
    for part in ["vocabulary", "onnx runtime", "model", "rerun", "processor"] {
        assert!(findings.iter().any(|finding| finding["part"] == part), "no {part}");
    }
    let broken = loci(&["doctor", "--vocab", "/dev/null"]);
    assert_eq!(broken.code, 1);
    assert!(broken.stdout.contains("FAIL  vocabulary"), "{}", broken.stdout);
}

#[test]
fn the_doctor_looks_at_the_vocabulary_that_a_variable_names() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("orb.lvoc");
    loci(&["vocab", "import", "tests/data/vocabulary/orb_k8_l3.yml.gz", "--out", text(&path)]);
    let vocabulary = |variable: &Path, arguments: &[&str]| {
        let doctor = loci_with_vocabulary_variable(variable, &[&["doctor", "--json"], arguments].concat());
        let finding = doctor.records()[0][0].clone();
        assert_eq!(finding["part"], "vocabulary");
        finding
    };
    let detail = format!("512 words in {}", path.display());
    assert_eq!(vocabulary(&path, &[])["detail"], *detail);
    let missing = Path::new("/none.lvoc");
    assert_eq!(vocabulary(missing, &[])["health"], "fail");
    assert_eq!(vocabulary(missing, &["--vocab", text(&path)])["detail"], *detail, "the flag wins");
}

#[test]
fn the_demo_uses_the_vocabulary_that_a_variable_names() {
    let demo = loci_with_vocabulary_variable(Path::new("/none.lvoc"), &["demo"]);
    demo.assert_failed(1, &["/none.lvoc"]);
}

#[test]
fn a_reader_that_stops_reading_ends_the_run_quietly() {
    let program = env!("CARGO_BIN_EXE_loci");
    let line =
        format!("set -o pipefail; '{program}' run 'synthetic:street?laps=1&frames=40' --json | head -n 1");
    let output = std::process::Command::new("bash").args(["-c", &line]).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{stderr}");
    assert_eq!(output.stdout.iter().filter(|&&byte| byte == b'\n').count(), 1);
    assert!(!stderr.contains("panicked"), "{stderr}");
}
