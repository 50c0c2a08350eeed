//! Opening, and the recovery of a camera, which is played by a script.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use v4l::buffer::Metadata;

use super::device::Delivery;
use super::pixels::{Layout, Range};
use super::search::{Identity, Node};
use super::spec::PixelFormat;
use super::*;

const SIDE_PX: usize = 32;
const OPENED: &str = "vivid on platform gives grey";
const UNPLUGGED_MESSAGE: &str = "camera /dev/video0: it was unplugged; waiting for it to come back";
const SILENT_MESSAGE: &str = "camera /dev/video0: no frame within 2 s; check the cable and the USB port";

/// What the camera does next.
#[derive(Clone, Copy, Debug)]
enum Act {
    /// A frame of this number.
    Frame(u32),
    /// Half a frame of this number.
    Half(u32),
    /// An error of this number, or a time without frames.
    Error(i32),
    Silence,
}

/// What is there and what it does, shared with the test.
#[derive(Default)]
struct Script {
    acts: VecDeque<Act>,
    nodes: Vec<Node>,
    refusal: Option<String>,
    is_gone: bool,
    has_changed: bool,
    /// Where the camera was opened, each time.
    opened: Vec<PathBuf>,
}

#[derive(Clone, Default)]
struct Stage(Arc<Mutex<Script>>);

impl Stage {
    fn script<T>(&self, change: impl FnOnce(&mut Script) -> T) -> T {
        change(&mut self.0.lock().unwrap())
    }
}

struct ScriptedStream {
    stage: Stage,
    bytes: Vec<u8>,
}

impl Stream for ScriptedStream {
    fn next(&mut self, _: Instant) -> io::Result<(&[u8], Metadata)> {
        let act = self.stage.script(|script| script.acts.pop_front()).unwrap_or(Act::Silence);
        let (sequence, length) = match act {
            Act::Frame(sequence) => (sequence, self.bytes.len()),
            Act::Half(sequence) => (sequence, self.bytes.len() / 2),
            Act::Error(number) => return Err(io::Error::from_raw_os_error(number)),
            Act::Silence => return Err(io::ErrorKind::TimedOut.into()),
        };
        Ok((&self.bytes[..length], Metadata { sequence, ..Metadata::default() }))
    }

    fn is_gone(&self) -> bool {
        self.stage.script(|script| script.is_gone)
    }

    fn has_changed(&self, _: &Delivery) -> bool {
        self.stage.script(|script| script.has_changed)
    }
}

fn identity() -> Identity {
    Identity { card: "vivid".to_owned(), bus: "platform".to_owned(), index: None }
}

fn node(number: u32) -> Node {
    Node { path: format!("/dev/video{number}").into(), camera: Some(identity()) }
}

impl Driver for Stage {
    type Stream = ScriptedStream;

    fn node(&self, path: &Path) -> Option<Node> {
        self.nodes().into_iter().find(|node| node.path == path)
    }

    fn nodes(&self) -> Vec<Node> {
        self.script(|script| script.nodes.clone())
    }

    fn open(&self, path: &Path, _: &CameraSpec) -> Result<Connected<ScriptedStream>, String> {
        self.script(|script| {
            script.opened.push(path.to_owned());
            script.refusal.clone().map_or(Ok(()), Err)
        })?;
        let layout = Layout { width_px: SIDE_PX, height_px: SIDE_PX, stride_bytes: SIDE_PX };
        let delivery = Delivery { format: PixelFormat::Grey, layout, range: Range::Full, fps: Some(3.0) };
        let stream = ScriptedStream { stage: self.clone(), bytes: vec![7; SIDE_PX * SIDE_PX] };
        Ok(Connected { stream, delivery, identity: identity(), description: OPENED.to_owned() })
    }
}

/// A camera at /dev/video0 that does `acts` and is silent from there on.
fn scripted(acts: impl IntoIterator<Item = Act>) -> (CameraSource<Stage>, Stage) {
    let stage = Stage::default();
    stage.script(|script| (script.acts, script.nodes) = (acts.into_iter().collect(), vec![node(0)]));
    let mut source = CameraSource::open(stage.clone(), "/dev/video0", Some(1)).unwrap();
    source.times = Times { answer: Duration::from_millis(8), pause: Duration::from_millis(2), ..TIMES };
    (source, stage)
}

/// The number of the next frame, or why there is none.
fn next(source: &mut CameraSource<Stage>) -> Result<u64, String> {
    let answer = source.next_frame().expect("a camera never ends");
    answer.map(|frame| frame.index).map_err(|error| match error {
        SourceError::NotYet => "not yet".to_owned(),
        error => error.to_string(),
    })
}

fn not_yet() -> Result<u64, String> {
    Err("not yet".to_owned())
}

#[test]
fn a_camera_is_live_and_says_once_what_it_gives() {
    let (mut source, _) = scripted([Act::Frame(0)]);
    assert!(source.is_live());
    assert_eq!(source.take_notice().unwrap(), format!("camera /dev/video0: {OPENED}"));
    assert_eq!(next(&mut source), Ok(0));
    assert_eq!((source.take_notice(), source.lost_frames()), (None, 0));
}

#[test]
fn an_unplugged_camera_is_told_once_and_found_again_under_another_number() {
    let (mut source, stage) = scripted([Act::Frame(0), Act::Frame(3), Act::Error(ENODEV)]);
    source.take_notice();
    assert_eq!((next(&mut source), next(&mut source)), (Ok(0), Ok(3)));
    stage.script(|script| script.nodes = vec![]);
    assert_eq!(next(&mut source).unwrap_err(), UNPLUGGED_MESSAGE);
    assert_eq!((next(&mut source), next(&mut source)), (not_yet(), not_yet()));
    assert_eq!(source.take_notice(), None);
    stage.script(|script| {
        (script.nodes, script.acts) = (vec![node(2)], [Act::Frame(0), Act::Frame(2)].into())
    });
    assert_eq!((next(&mut source), next(&mut source)), (Ok(4), Ok(6)));
    let notice = format!("camera /dev/video0: it is back at /dev/video2: {OPENED}");
    assert_eq!((source.take_notice(), source.take_notice()), (Some(notice), None));
    // Two before it was unplugged, one since; what it took meanwhile nobody knows.
    assert_eq!(source.lost_frames(), 3);
    // The next time it is told again.
    stage.script(|script| (script.nodes, script.acts) = (vec![], [Act::Error(ENODEV)].into()));
    assert_eq!(next(&mut source).unwrap_err(), UNPLUGGED_MESSAGE);
}

#[test]
fn a_camera_that_fails_otherwise_before_it_is_gone_was_unplugged() {
    let (mut source, stage) = scripted([Act::Error(5)]);
    stage.script(|script| script.is_gone = true);
    assert_eq!(next(&mut source).unwrap_err(), UNPLUGGED_MESSAGE);
}

#[test]
fn a_silent_camera_is_told_once_and_opened_anew_until_it_sends_again() {
    let (mut source, stage) = scripted([]);
    source.take_notice();
    assert_eq!(next(&mut source).unwrap_err(), SILENT_MESSAGE);
    assert_eq!((next(&mut source), next(&mut source), next(&mut source)), (not_yet(), not_yet(), not_yet()));
    assert_eq!(stage.script(|script| script.opened.len()), 3);
    stage.script(|script| script.acts = [Act::Frame(0)].into());
    assert_eq!(next(&mut source), Ok(0));
    assert!(source.take_notice().unwrap().contains("it is back at /dev/video0: "));
}

#[test]
fn after_one_silence_the_stream_is_enough() {
    let (mut source, stage) = scripted([Act::Silence, Act::Frame(0)]);
    source.take_notice();
    assert_eq!(next(&mut source).unwrap_err(), SILENT_MESSAGE);
    assert_eq!(next(&mut source), Ok(0));
    assert_eq!(source.take_notice().unwrap(), "camera /dev/video0: it sends frames again");
    assert_eq!(stage.script(|script| script.opened.len()), 1);
}

#[test]
fn a_silent_camera_that_is_then_unplugged_is_told_of_both() {
    let (mut source, stage) = scripted([]);
    assert_eq!(next(&mut source).unwrap_err(), SILENT_MESSAGE);
    stage.script(|script| script.nodes = vec![]);
    assert_eq!(next(&mut source), not_yet());
    assert_eq!(next(&mut source).unwrap_err(), UNPLUGGED_MESSAGE);
    assert_eq!(next(&mut source), not_yet());
}

#[test]
fn a_camera_that_comes_back_but_refuses_is_told_once_it_does_so_for_a_while() {
    let (mut source, stage) = scripted([Act::Error(ENODEV)]);
    assert_eq!(next(&mut source).unwrap_err(), UNPLUGGED_MESSAGE);
    stage.script(|script| script.refusal = Some("another program uses it; close that one".to_owned()));
    assert_eq!(next(&mut source), not_yet());
    assert_eq!(
        next(&mut source).unwrap_err(),
        "camera /dev/video0: it is there, but cannot be used: another program uses it; close that one"
    );
    assert_eq!(next(&mut source), not_yet());
    stage.script(|script| (script.refusal, script.acts) = (None, [Act::Frame(0)].into()));
    assert_eq!(next(&mut source), Ok(0));
}

#[test]
fn damaged_frames_are_told_each_and_many_of_them_have_the_camera_opened_anew() {
    let (mut source, stage) = scripted([0, 1, 2].map(Act::Half).into_iter().chain([Act::Frame(0)]));
    for number in 0..3 {
        let expected = format!("camera /dev/video0: frame {number}: the frame is cut off: ");
        assert!(next(&mut source).unwrap_err().starts_with(&expected));
    }
    assert_eq!(next(&mut source), Ok(3));
    assert_eq!(stage.script(|script| script.opened.len()), 2);
}

#[test]
fn a_camera_that_sends_nothing_but_damaged_frames_is_not_said_to_be_back() {
    let (mut source, stage) = scripted((0..9).map(Act::Half));
    source.take_notice();
    for _ in 0..9 {
        assert!(next(&mut source).unwrap_err().contains("is cut off"));
        assert_eq!(source.take_notice(), None);
    }
    assert_eq!(stage.script(|script| script.opened.len()), 3);
}

#[test]
fn a_changed_format_is_agreed_on_anew_at_once() {
    let (mut source, stage) = scripted([Act::Half(0), Act::Frame(0)]);
    stage.script(|script| script.has_changed = true);
    assert_eq!(next(&mut source).unwrap_err(), "camera /dev/video0: its format changed; opening it anew");
    assert_eq!(next(&mut source), Ok(1));
    assert_eq!(stage.script(|script| script.opened.len()), 2);
}

#[test]
fn a_format_that_changed_while_the_camera_was_silent_is_agreed_on_anew_before_a_frame_is_believed() {
    let (mut source, stage) = scripted([Act::Silence, Act::Frame(0), Act::Frame(1)]);
    assert_eq!(next(&mut source).unwrap_err(), SILENT_MESSAGE);
    stage.script(|script| script.has_changed = true);
    assert_eq!(next(&mut source).unwrap_err(), "camera /dev/video0: its format changed; opening it anew");
    // A driver that never says what was agreed on is believed once it has just been asked.
    assert_eq!((next(&mut source), next(&mut source)), (Ok(0), Ok(1)));
    assert_eq!(stage.script(|script| script.opened.len()), 2);
}

#[test]
fn a_signal_is_no_fault_of_the_camera() {
    const EINTR: i32 = 4;
    let (mut source, _) = scripted([Act::Error(EINTR), Act::Frame(0)]);
    source.take_notice();
    assert_eq!(next(&mut source), not_yet());
    assert_eq!((next(&mut source), source.take_notice()), (Ok(0), None));
}

#[test]
fn a_camera_that_samples_seldom_says_that_nothing_is_due() {
    let (mut source, _) = scripted([]);
    source.sampling = Sampling::new(Some(1_000_000_000), None);
    source.times.answer = Duration::ZERO;
    source.driver.script(|script| script.acts = [Act::Frame(0), Act::Frame(1)].into());
    assert_eq!((next(&mut source), next(&mut source)), (Ok(0), not_yet()));
}

#[test]
fn slow_cameras_are_awaited_for_longer() {
    let (source, _) = scripted([]);
    let seconds = |fps| source.patience(fps).as_secs_f64();
    assert_eq!([None, Some(30.0), Some(0.5), Some(1e-300)].map(seconds), [2.0, 2.0, 4.0, 10.0]);
}

fn reason(text: &str) -> String {
    let message = open(text, None).map(|_| ()).unwrap_err().to_string();
    assert!(!message.contains('\n'), "{message}");
    message
}

#[test]
fn a_device_that_cannot_be_a_camera_is_named_with_the_fix() {
    let missing = reason("/dev/video-of-nobody?size=640x480");
    assert!(missing.starts_with("camera /dev/video-of-nobody: there is no such device; "), "{missing}");
    let file = tempfile::NamedTempFile::new().unwrap();
    for path in ["/dev/null", "/dev", file.path().to_str().unwrap()] {
        let message = reason(path);
        let expected = format!("camera {path}: it is not a video capture device; ");
        assert!(message.starts_with(&expected), "{message}");
    }
    assert!(reason("?fps=30").starts_with("camera (none): no device is named; "));
    assert!(
        reason("/dev/video0?sise=1x1")
            .starts_with("camera /dev/video0: there is no key 'sise' that takes '1x1'; ")
    );
}
