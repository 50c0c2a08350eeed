//! Where recordings go: files, viewers, and nobody.

use std::net::TcpListener;
use std::num::NonZero;
use std::path::PathBuf;
use std::time::Instant;

use ::rerun::log::Chunk;

use super::tests::{chunks_of, insightful, matched, record, rows, save};
use super::*;
use crate::recognition::Decision;

#[test]
fn a_recording_goes_on_in_files_that_are_each_complete() {
    let folder = tempfile::tempdir().unwrap();
    let rotation = Rotation { minutes: NonZero::new(1), files: NonZero::new(2), ..Rotation::default() };
    let target = RerunTarget::Save(folder.path().join("run.rrd"), rotation);
    let mut sink = RerunSink::open(&target, RerunDetail::Normal).unwrap();
    // Four minutes, with a frame every six seconds.
    for index in (0..2400).step_by(60) {
        sink.record(&insightful(index, index as u32 / 60)).unwrap();
    }
    sink.finish().unwrap();
    let mut names: Vec<_> =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    names.sort();
    assert_eq!(names, ["run-000003.rrd", "run-000004.rrd"].map(|name| folder.path().join(name)));
    let parts: Vec<_> = names.iter().map(|name| chunks_of(name)).collect();
    for chunks in &parts {
        assert_eq!((rows(chunks, style::LOG), rows(chunks, style::CAMERA_IMAGE)), (10, 10));
        assert!(chunks[&format!("/{}", style::MAP)].iter().any(Chunk::is_static), "colours are there again");
        assert!(rows(chunks, style::SIMILARITY) > 0 && rows(chunks, style::PLACES) > 0);
    }
}

#[test]
fn a_file_that_cannot_be_written_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let refusal = |file: PathBuf| {
        let message = RerunSink::open(&save(file.clone()), RerunDetail::Normal).err().unwrap().to_string();
        assert!(message.starts_with(&format!("rerun save={}: ", file.display())), "{message}");
        assert!(!message.contains('\n'), "{message}");
        message
    };
    let missing = folder.path().join("missing");
    assert!(refusal(missing.join("run.rrd")).contains("there is no folder"));
    assert!(!missing.exists());
    let taken = folder.path().join("folder.rrd");
    std::fs::create_dir(&taken).unwrap();
    assert!(refusal(taken).contains("that is a folder"));
    assert!(refusal("/proc/run.rrd".into()).contains("cannot write the file"));
}

#[test]
fn a_full_disk_is_reported_at_the_end() {
    let full = PathBuf::from("/dev/full");
    if !full.exists() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.rrd");
    std::os::unix::fs::symlink(full, &file).unwrap();
    let message = match RerunSink::open(&save(file), RerunDetail::Normal) {
        Err(error) => error.to_string(),
        Ok(mut sink) => {
            sink.record(&record(0, Decision::NewPlace)).unwrap();
            sink.finish().unwrap_err().to_string()
        }
    };
    assert!(message.contains("run.rrd: ") && !message.contains('\n'), "{message}");
}

#[test]
fn nothing_is_shown_when_rerun_is_off_or_over() {
    let mut off = RerunSink::open(&RerunTarget::Off, RerunDetail::Normal).unwrap();
    assert!(!off.looks_on());
    off.record(&matched(0)).unwrap();
    off.finish().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut over = RerunSink::open(&save(folder.path().join("run.rrd")), RerunDetail::Normal).unwrap();
    assert!(over.looks_on());
    over.finish().unwrap();
    over.record(&matched(0)).unwrap();
    over.finish().unwrap();
}

#[test]
fn a_viewer_that_is_absent_holds_up_nobody_and_is_named_at_the_end() {
    // Free a moment ago; that somebody takes it just now is most unlikely.
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut sink = RerunSink::open(&RerunTarget::Connect(nobody.to_string()), RerunDetail::Normal).unwrap();
    let started = Instant::now();
    for index in 0..500 {
        sink.record(&matched(index)).unwrap();
    }
    assert!(started.elapsed() < Duration::from_secs(10), "recording took {:?}", started.elapsed());
    let message = sink.finish().unwrap_err().to_string();
    assert_eq!(message, format!("rerun connect={nobody}: no viewer answered; start one with `rerun`"));
    assert!(started.elapsed() < Duration::from_secs(20), "took {:?} in all", started.elapsed());
}

#[test]
fn a_viewer_that_answers_the_door_and_then_nothing_holds_up_nobody() {
    let mute = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut sink =
        RerunSink::open(&RerunTarget::Connect(mute.local_addr().unwrap().to_string()), RerunDetail::Normal)
            .unwrap();
    let started = Instant::now();
    for index in 0..500 {
        sink.record(&matched(index)).unwrap();
    }
    let _ = sink.finish();
    assert!(started.elapsed() < Duration::from_secs(20), "took {:?}", started.elapsed());
}

#[test]
fn what_is_served_or_sent_reaches_whoever_listens() {
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut server = RerunSink::open(&RerunTarget::Serve(free), RerunDetail::Normal).unwrap();
    let mut client = RerunSink::open(&RerunTarget::Connect(free.to_string()), RerunDetail::Normal).unwrap();
    client.record(&matched(0)).unwrap();
    client.finish().unwrap();
    server.record(&matched(0)).unwrap();
    server.finish().unwrap();
}
