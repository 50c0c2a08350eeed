//! Bad input: one line that names the file and the fix, and never a panic.

use std::fs;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::process::{Command, Stdio};

use loci::raster::RgbImage;
use loci::source::jpeg;

use crate::program::{loci, send, text};

fn folder_with(files: &[(&str, &[u8])]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    folder
}

/// A JPEG with something to see.
fn picture() -> Vec<u8> {
    let pixels = (0..320 * 240 * 3).map(|i| (((i / 33) * 2_654_435_761_usize) >> 7) as u8).collect();
    jpeg(&RgbImage::from_pixels(320, 240, pixels).unwrap())
}

/// The header of a PNG of this size, without pixels.
fn png_header(width: u32, height: u32) -> Vec<u8> {
    let mut header = b"IHDR".to_vec();
    header.extend(width.to_be_bytes());
    header.extend(height.to_be_bytes());
    header.extend([8, 0, 0, 0, 0]);
    let checksum = header.iter().fold(!0_u32, |crc, &byte| {
        (0..8).fold(
            crc ^ u32::from(byte),
            |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 },
        )
    });
    [b"\x89PNG\r\n\x1a\n\0\0\0\x0d", &header[..], &(!checksum).to_be_bytes(), b"\0\0\0\0IDAT"].concat()
}

#[test]
fn one_bad_frame_among_many_is_reported_and_skipped() {
    let picture = picture();
    let bad: [(&str, &[u8], &str); 5] = [
        ("2.jpg", &picture[..picture.len() / 2], "2.jpg: the JPEG is cut off"),
        ("3.jpg", b"", "3.jpg: the file is empty"),
        ("4.png", &png_header(1, 1), "4.png: 1×1 px is too small"),
        ("5.png", &png_header(20_000, 20_000), "5.png: 20000×20000 px is too large"),
        ("6.jpg", b"hello", "6.jpg: neither JPEG nor PNG"),
    ];
    for (name, bytes, message) in bad {
        let folder = folder_with(&[("1.jpg", &picture), (name, bytes), ("9.jpg", &picture)]);
        let run = loci(&["run", text(folder.path()), "--json"]);
        assert_eq!(run.code, 3, "{}", run.stderr);
        assert_eq!(run.records().len(), 2);
        let skipped: Vec<&str> = run.stderr.lines().filter(|line| line.contains("skipped:")).collect();
        assert!(skipped.len() == 1 && skipped[0].contains(message), "{skipped:?}");
        assert!(run.stderr.contains("1 frame skipped"), "{}", run.stderr);
    }
}

#[test]
fn a_folder_of_nothing_but_bad_frames_fails() {
    let folder = folder_with(&[("1.jpg", b"x")]);
    let run = loci(&["run", text(folder.path())]);
    assert_eq!(run.code, 1);
    assert!(run.stderr.ends_with("loci: none of 1 frame could be read\n"), "{}", run.stderr);
}

#[test]
fn a_source_that_is_none_is_named_with_the_fix() {
    let empty = folder_with(&[]);
    loci(&["run", text(empty.path())]).assert_failed(1, &[text(empty.path()), "no images", ".jpg"]);
    loci(&["run", "/no/such/folder"]).assert_failed(1, &["cannot read /no/such/folder"]);
    let video = folder_with(&[("drive.mp4", b"x")]);
    let path = video.path().join("drive.mp4");
    loci(&["run", text(&path)])
        .assert_failed(1, &["drive.mp4", "no video that ffmpeg can read", "convert it again"]);
    loci(&["run", "v4l2:/dev/no-such-camera"]).assert_failed(1, &["camera /dev/no-such-camera"]);
    loci(&["run", "synthetic:moon"]).assert_failed(1, &["moon", "street", "corridor"]);
    loci(&["run", "synthetic:street?lapse=2"]).assert_failed(1, &["lapse", "laps"]);
}

#[test]
fn a_vocabulary_of_the_wrong_kind_is_named() {
    let good = fs::read("vocab/default.lvoc").unwrap();
    let mut newer = good.clone();
    newer[8] = 99;
    let wrong: [(&str, &[u8], &str); 5] = [
        ("picture.lvoc", &picture(), "is not a vocabulary (.lvoc): it does not begin as one"),
        ("empty.lvoc", b"", "the file is empty"),
        ("cut.lvoc", &good[..good.len() / 2], "is damaged"),
        ("newer.lvoc", &newer, "update Loci"),
        ("short.lvoc", b"LOCIVOC", "shorter than its header"),
    ];
    for (name, bytes, message) in wrong {
        let folder = folder_with(&[(name, bytes)]);
        let path = folder.path().join(name);
        let run = loci(&["run", "synthetic:street?laps=1&frames=2", "--vocab", text(&path)]);
        run.assert_failed(1, &[name, message]);
        loci(&["vocab", "info", text(&path)]).assert_failed(1, &[name, message]);
    }
    let folder = folder_with(&[]);
    loci(&["vocab", "info", text(folder.path())]).assert_failed(1, &["not a regular file"]);
}

#[test]
fn a_vocabulary_of_another_library_is_named_with_the_command_that_imports_it() {
    let folder = folder_with(&[("ORBvoc.txt", b"10 6 0 0\n")]);
    let path = folder.path().join("ORBvoc.txt");
    loci(&["vocab", "info", text(&path)])
        .assert_failed(1, &["ORBvoc.txt", "ORB-SLAM text vocabulary", "`loci vocab import`"]);
    let out = folder.path().join("out.lvoc");
    loci(&["vocab", "import", text(&path), "--out", text(&out)])
        .assert_failed(1, &["nothing hangs from its root"]);
    assert!(!out.exists());
}

#[test]
fn a_training_does_not_go_on_with_the_file_of_another_one() {
    let folder = folder_with(&[]);
    let out = folder.path().join("v.lvoc");
    let train = |frames: &str| loci(&["vocab", "train", frames, "--depth", "2", "--out", text(&out)]);
    drop(
        loci::vocabulary::TrainingFile::open(&folder.path().join("v.lvoc.training"), "other photos").unwrap(),
    );
    train("synthetic:street?laps=1&frames=2")
        .assert_failed(1, &["v.lvoc.training was left behind by a training of other images, or by another version of Loci: delete it\n"]);
    assert!(!out.exists());
}

#[test]
fn an_output_does_not_take_the_place_of_an_input() {
    let picture = picture();
    let folder = folder_with(&[("1.jpg", &picture)]);
    let image = folder.path().join("1.jpg");
    let video = folder.path().join("drive.mp4");
    fs::write(&video, b"frames").unwrap();
    let train = |source: &Path, out: &Path| loci(&["vocab", "train", text(source), "--out", text(out)]);
    let import = |file: &Path| loci(&["vocab", "import", text(file), "--out", text(file)]);
    let links = folder_with(&[]);
    std::os::unix::fs::symlink(&image, links.path().join("1.jpg")).unwrap();
    for run in
        [train(folder.path(), &image), train(links.path(), &image), train(&video, &video), import(&video)]
    {
        run.assert_failed(2, &["--out", "would replace an input; name another file"]);
    }
    assert_eq!((fs::read(image).unwrap(), fs::read(video).unwrap()), (picture, b"frames".to_vec()));
}

#[test]
fn a_training_that_is_interrupted_says_how_it_goes_on() {
    let folder = folder_with(&[]);
    let out = folder.path().join("v.lvoc");
    let train = ["vocab", "train", "synthetic:street?laps=9&frames=60", "--depth", "2", "--out", text(&out)];
    let mut process = Command::new(env!("CARGO_BIN_EXE_loci"));
    let process = process.args(train).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let unfinished = folder.path().join("v.lvoc.training");
    while fs::metadata(&unfinished).map_or(0, |file| file.len()) < 100_000 {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    send("INT", &process);
    let ended = process.wait_with_output().unwrap();
    let stderr = String::from_utf8(ended.stderr).unwrap();
    assert_eq!(ended.status.code(), Some(1), "{stderr}");
    assert!(stderr.starts_with("loci: interrupted; the same command goes on with the "), "{stderr}");
    assert!(unfinished.exists() && !out.exists());
}

/// Trains for `out` and kills the training while it extracts.
fn kill_in_between(train: &[&str], out: &Path) {
    let mut process = Command::new(env!("CARGO_BIN_EXE_loci"));
    let process = process.args(train).stdout(Stdio::null()).stderr(Stdio::null());
    let mut process = process.spawn().unwrap();
    let unfinished = format!("{}.training", out.display());
    let extracted = || fs::metadata(&unfinished).map_or(0, |file| file.len());
    while extracted() < 100_000 {
        assert!(process.try_wait().unwrap().is_none(), "it ended before it could be killed");
    }
    process.kill().unwrap();
    process.wait().unwrap();
    assert!(!out.exists());
}

#[test]
fn a_training_that_is_killed_goes_on_and_ends_in_the_same_file() {
    let folder = folder_with(&[]);
    let path = |name: &str| folder.path().join(name);
    let out = path("v.lvoc");
    let train = ["vocab", "train", "synthetic:street?laps=1&frames=60", "--depth", "2", "--out"];
    let whole = path("whole.lvoc");
    assert_eq!(loci(&[&train[..], &[text(&whole)]].concat()).code, 0);

    kill_in_between(&[&train[..], &[text(&out)]].concat(), &out);
    let resumed = loci(&[&train[..], &[text(&out)]].concat());
    assert_eq!(resumed.code, 0, "{}", resumed.stderr);
    assert!(resumed.stderr.contains("going on with the"), "{}", resumed.stderr);
    assert!(fs::read(&out).unwrap() == fs::read(&whole).unwrap());
    assert!(!path("v.lvoc.training").exists());
}

#[test]
fn a_training_goes_on_beside_its_images_whatever_else_lies_there_and_not_with_other_images() {
    let folder = folder_with(&[]);
    let mut source = loci::source::open("synthetic:street?laps=1&frames=6", None).unwrap();
    while let Some(frame) = source.next_frame() {
        let frame = frame.unwrap();
        for copy in 0..20 {
            let name = format!("{copy}_{}.jpg", frame.index);
            fs::write(folder.path().join(name), jpeg(&frame.colour)).unwrap();
        }
    }
    let out = folder.path().join("site.lvoc");
    let train = ["vocab", "train", text(folder.path()), "--depth", "2", "--out", text(&out)];
    kill_in_between(&train, &out);
    fs::write(folder.path().join("notes.txt"), "the hall, by noon").unwrap();
    let added = folder.path().join("added.jpg");
    fs::write(&added, picture()).unwrap();
    loci(&train).assert_failed(1, &["site.lvoc.training was left behind by a training of other images"]);
    fs::remove_file(added).unwrap();
    let resumed = loci(&train);
    assert_eq!(resumed.code, 0, "{}", resumed.stderr);
    assert!(resumed.stderr.contains("going on with the"), "{}", resumed.stderr);
    assert!(out.exists());
}

#[test]
fn one_bad_image_among_those_of_a_bench_is_reported_and_skipped() {
    let picture = picture();
    let folder = folder_with(&[("1.jpg", b""), ("2.jpg", &picture)]);
    let bench = |folder: &Path| loci(&["vocab", "bench", "vocab/default.lvoc", "--images", text(folder)]);
    let timed = bench(folder.path());
    assert_eq!(timed.code, 3, "{}", timed.stderr);
    assert!(timed.stderr.starts_with("loci: skipped: ") && timed.stderr.contains("1.jpg: the file is empty"));
    assert!(timed.stdout.contains("look up"), "{}", timed.stdout);
    fs::remove_file(folder.path().join("2.jpg")).unwrap();
    let timed = bench(folder.path());
    assert!(timed.code == 1 && timed.stderr.contains("no features in"), "{}", timed.stderr);
}

#[test]
fn images_without_features_leave_nothing_behind() {
    let blank = jpeg(&RgbImage::new(320, 240));
    let folder = folder_with(&[("blank.jpg", &blank)]);
    let out = folder.path().join("v.lvoc");
    loci(&["vocab", "train", text(folder.path()), "--out", text(&out)]).assert_failed(1, &["no features"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_shape_that_makes_no_tree_is_a_wrong_argument() {
    for shape in [["--branching", "1"], ["--branching", "33"], ["--depth", "0"], ["--depth", "9"]] {
        let run = loci(&["vocab", "train", "photos", shape[0], shape[1], "--out", "v.lvoc"]);
        assert!(run.code == 2 && run.stderr.contains(shape[0]), "{}", run.stderr);
    }
}

#[test]
fn a_device_is_not_replaced_by_a_file() {
    let import = loci(&["vocab", "import", "vocab/default.lvoc", "--out", "/dev/null"]);
    import.assert_failed(1, &["/dev/null", "a device"]);
    assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
}

#[test]
fn a_full_stdout_is_an_error_and_a_closed_one_is_none() {
    let info = |stdout: Stdio| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_loci"));
        let output = command.args(["vocab", "info", "vocab/default.lvoc"]).stdout(stdout).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, error) = info(fs::OpenOptions::new().write(true).open("/dev/full").unwrap().into());
    assert!(code == Some(1) && error.starts_with("loci: cannot write to stdout: No space left"), "{error}");
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    assert_eq!(info(writer.into()), (Some(0), String::new()));
}

#[test]
fn a_flipped_bit_in_a_vocabulary_is_found_when_asked() {
    let mut bytes = fs::read("vocab/default.lvoc").unwrap();
    bytes[4096] ^= 1;
    let folder = folder_with(&[("flipped.lvoc", &bytes)]);
    let path = folder.path().join("flipped.lvoc");
    assert_eq!(loci(&["vocab", "info", text(&path)]).code, 0);
    loci(&["vocab", "info", text(&path), "--verify"]).assert_failed(1, &["flipped.lvoc", "checksum"]);
    let out = folder.path().join("out.lvoc");
    loci(&["vocab", "import", text(&path), "--out", text(&out)])
        .assert_failed(1, &["flipped.lvoc", "checksum"]);
    assert!(!out.exists());
}

#[cfg(feature = "cnn")]
#[test]
fn a_model_of_the_wrong_kind_is_named() {
    let run = |model: &Path| loci(&["run", "synthetic:street?laps=1&frames=2", "--model", text(model)]);
    let empty = folder_with(&[]);
    run(empty.path()).assert_failed(1, &["card.toml"]);
    let card = fs::read("models/efficientnet-lite0/card.toml").unwrap();
    let foreign = folder_with(&[("card.toml", &card), ("model.onnx", b"not a network")]);
    run(foreign.path()).assert_failed(1, &["model.onnx", "sha256", "rebuild or fetch the model again"]);
    let unreadable = folder_with(&[("card.toml", b"name = 3"), ("model.onnx", b"x")]);
    run(unreadable.path()).assert_failed(1, &["card.toml"]);
}

#[cfg(feature = "cnn")]
#[test]
fn an_onnx_runtime_that_is_none_is_named() {
    let folder = folder_with(&[("libonnxruntime.so", b"not a library")]);
    let path = folder.path().join("libonnxruntime.so");
    let run = loci(&["run", "synthetic:street?laps=1&frames=2", "--onnxruntime", text(&path)]);
    run.assert_failed(1, &["libonnxruntime.so", "make deps"]);
}

#[test]
fn an_unwritable_map_folder_is_named() {
    let run = loci(&["run", "synthetic:street?laps=1&frames=2", "--map", "/proc/map"]);
    run.assert_failed(1, &["/proc/map", "cannot create map folder"]);
    let file = folder_with(&[("map", b"x")]);
    let path = file.path().join("map");
    loci(&["run", "synthetic:street?laps=1&frames=2", "--map", text(&path)]).assert_failed(1, &[text(&path)]);
    let foreign = folder_with(&[("journal-000001.loci", b"something else entirely")]);
    let run = loci(&["run", "synthetic:street?laps=1&frames=2", "--map", text(foreign.path())]);
    run.assert_failed(1, &["journal-000001.loci", "is not a map journal"]);
    let none = folder_with(&[]);
    loci(&["map", "info", text(none.path())]).assert_failed(1, &["no map in", "loci run"]);
}

#[cfg(feature = "rerun")]
#[test]
fn a_recording_that_cannot_be_written_is_named() {
    let run = loci(&["run", "synthetic:street?laps=1&frames=2", "--rerun", "save=/no/such/folder/x.rrd"]);
    run.assert_failed(1, &["/no/such/folder"]);
}
