//! A model that is deployed while the robot drives.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::program::{Finished, loci, send, text};

const ENDLESS: &str = "synthetic:corridor?laps=500&size=160x160&frames=40";

/// A copy of the shipped model under another name, whose network has another hash and does the same.
fn other_model(folder: &Path) -> String {
    let shipped = Path::new("models/efficientnet-lite0");
    fs::create_dir(folder).unwrap();
    let mut network = fs::read(shipped.join("model.onnx")).unwrap();
    // The last of several producers' names counts: field 2 of the outermost message, a text of five bytes.
    network.extend(b"\x12\x05again");
    fs::write(folder.join("model.onnx"), network).unwrap();
    let card = fs::read_to_string(shipped.join("card.toml")).unwrap();
    let old = card.split('"').find(|part| part.len() == 64).unwrap().to_owned();
    let card = card.replace("efficientnet-lite0", "site-2");
    fs::write(folder.join("card.toml"), &card).unwrap();
    // The program says which hash the network has.
    let refused = loci(&["run", "synthetic:corridor?frames=1", "--model", text(folder)]).stderr;
    let new = refused.split_whitespace().map(|word| word.trim_end_matches(','));
    let new = new.filter(|word| word.len() == 64).find(|word| *word != old).unwrap().to_owned();
    fs::write(folder.join("card.toml"), card.replace(&old, &new)).unwrap();
    new
}

fn turn_over(link: &Path, folder: &Path) {
    let beside = link.with_extension("next");
    symlink(folder, &beside).unwrap();
    fs::rename(beside, link).unwrap();
}

/// A run that never ends, of which `deploy` is called after two laps, and which is ended some frames after another model
/// is in use.
fn run_under_which(model: &Path, map: &Path, deploy: impl FnOnce()) -> Finished {
    let mut run = Command::new(env!("CARGO_BIN_EXE_loci"))
        .args(["run", ENDLESS, "--json", "--place-interval", "1"])
        .args(["--map", text(map), "--model", text(model)])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(run.stdout.take().unwrap()).lines().map(Result::unwrap);
    let mut answered: Vec<String> = lines.by_ref().take(80).collect();
    deploy();
    for line in lines.by_ref() {
        let is_swapped = line.contains("\"model\":");
        answered.push(line);
        if is_swapped {
            break;
        }
    }
    answered.extend(lines.by_ref().take(60));
    send("TERM", &run);
    answered.extend(lines);
    let mut stderr = String::new();
    run.stderr.take().unwrap().read_to_string(&mut stderr).unwrap();
    Finished { code: run.wait().unwrap().code().unwrap(), stdout: answered.join("\n"), stderr }
}

#[test]
fn a_model_that_is_deployed_during_a_run_takes_over_and_every_frame_is_answered_once() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second, link, map] =
        ["first", "second", "current", "map"].map(|name| folder.path().join(name));
    let hash = other_model(&second);
    symlink(fs::canonicalize("models/efficientnet-lite0").unwrap(), &first).unwrap();
    turn_over(&link, &first);
    let run = run_under_which(&link, &map, || turn_over(&link, &second));
    assert_eq!(run.code, 0, "{}", run.stderr);
    let records = run.records();
    let frames: Vec<u64> = records.iter().map(|record| record["frame"].as_u64().unwrap()).collect();
    assert_eq!(frames, (0..records.len() as u64).collect::<Vec<_>>());
    assert!(records.iter().all(|record| record.get("cnn").is_none()), "without the CNN's answer");
    let swapped: Vec<&Value> = records.iter().filter(|record| record.get("model").is_some()).collect();
    assert_eq!((swapped.len(), &swapped[0]["model"]), (1, &hash.as_str().into()));
    let said: Vec<&str> = run.stderr.lines().filter(|line| line.starts_with("loci: ")).collect();
    assert_eq!(said.len(), 1, "{said:?}");
    let line = format!("loci: model site-2 is in use from frame {} on (", swapped[0]["frame"]);
    assert!(said[0].starts_with(&line) && said[0].ends_with(" described anew)"), "{said:?}");
    let by_cnn = |records: &[Value]| records.iter().filter(|record| record["by"] == "cnn").count();
    let after = &records[swapped[0]["frame"].as_u64().unwrap() as usize..];
    assert!(by_cnn(&after[..40]) >= by_cnn(&records[40..80]), "{:?}", run.decisions());
    let info = &loci(&["map", "info", text(&map), "--json"]).records()[0];
    assert!(info["models"].as_array().unwrap().contains(&hash.into()), "{info}");
    assert_eq!(loci(&["map", "verify", text(&map)]).code, 0);
}
