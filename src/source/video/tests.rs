//! Videos that ffmpeg makes here are read; without ffmpeg that this is said is all there is to test.

use std::fs;
use std::time::Instant;

use super::*;

const FPS: usize = 25;
const NANOS_PER_FRAME: i64 = 40_000_000;

/// A folder with a video that is made by `ffmpeg ARGUMENTS FILE`; `None` where there is no ffmpeg.
fn video(file: &str, arguments: &str) -> Option<(tempfile::TempDir, PathBuf)> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(file);
    let mut command = Command::new(INSTALLED.ffmpeg);
    command.args(["-nostdin", "-v", "error"]).args(arguments.split(' ')).arg(&path);
    match command.status() {
        Ok(status) => {
            assert!(status.success(), "ffmpeg {arguments}");
            Some((folder, path))
        }
        Err(error) => {
            eprintln!("no video to test with, ffmpeg cannot be started: {error}");
            fs::write(&path, "not empty").unwrap();
            assert!(message(VideoSource::open(&path, None)).contains("apt install ffmpeg"));
            None
        }
    }
}

/// Two seconds, 50 frames, of a moving pattern of 64×48 px.
fn pattern(file: &str, codec: &str) -> Option<(tempfile::TempDir, PathBuf)> {
    video(file, &format!("-f lavfi -i testsrc=size=64x48:rate={FPS}:duration=2 {codec}"))
}

fn message<T>(result: Result<T, SourceError>) -> String {
    let message = result.map(|_| ()).unwrap_err().to_string();
    assert!(!message.contains('\n'), "{message}");
    message
}

/// All frames, and the error that follows them, if one does.
fn read(mut source: VideoSource) -> (Vec<Frame>, Option<String>) {
    let mut frames = Vec::new();
    let mut error = None;
    while let Some(next) = source.next_frame() {
        assert_eq!(error, None, "something follows the error");
        match next {
            Ok(frame) => frames.push(frame),
            failed => error = Some(message(failed)),
        }
    }
    assert!(source.next_frame().is_none());
    (frames, error)
}

fn read_all(path: &Path) -> (Vec<Frame>, Option<String>) {
    read(VideoSource::open(path, Some(1)).unwrap())
}

fn indices(frames: &[Frame]) -> Vec<u64> {
    frames.iter().map(|frame| frame.index).collect()
}

#[test]
fn all_frames_of_the_usual_containers_come_with_their_times() {
    let containers = [
        ("a.mp4", "-c:v mpeg4 -bf 2", Some(50)),
        ("a.avi", "-c:v mjpeg", Some(50)),
        ("a.mkv", "-c:v ffv1", None),
        ("a.ts", "-c:v mpeg2video -bf 2", None),
    ];
    for (file, codec, frame_count) in containers {
        let Some((_folder, path)) = pattern(file, codec) else { return };
        let source = VideoSource::open(&path, Some(1)).unwrap();
        assert_eq!(source.frame_count(), frame_count, "{file}");
        let (frames, error) = read(source);
        assert_eq!((indices(&frames), error), ((0..50).collect(), None), "{file}");
        for frame in &frames {
            assert_eq!(frame.capture_nanos, frame.index as i64 * NANOS_PER_FRAME, "{file}");
        }
        assert_eq!(frames[7].name, format!("{file}#7"));
        assert_eq!((frames[7].colour.width(), frames[7].grey.height()), (64, 48));
        assert_eq!(frames[7].grey, luma(&frames[7].colour));
        assert!(frames[7].jpeg.is_none() && frames[7].pose.is_none());
    }
}

#[test]
fn about_three_frames_a_second_are_handed_out_by_default() {
    let Some((_folder, path)) = pattern("a.avi", "-c:v mjpeg") else { return };
    let source = VideoSource::open(&path, None).unwrap();
    assert_eq!(source.frame_count(), Some(7));
    let (frames, error) = read(source);
    assert_eq!((indices(&frames), error), (vec![0, 8, 16, 24, 32, 40, 48], None));
    assert_eq!(frames[3].capture_nanos, 24 * NANOS_PER_FRAME);
}

#[test]
fn exactly_the_frames_asked_for_come_and_look_as_among_all() {
    let Some((_folder, path)) = pattern("a.mkv", "-c:v ffv1") else { return };
    let (all, _) = read_all(&path);
    let wanted = [0, 5, 7, 31, 49];
    let source = VideoSource::with_frames(&path, wanted.to_vec()).unwrap();
    assert_eq!(source.frame_count(), Some(5));
    let (frames, error) = read(source);
    assert_eq!((indices(&frames), error), (wanted.to_vec(), None));
    for frame in frames {
        let same = &all[frame.index as usize];
        assert_eq!((&frame.colour, frame.capture_nanos), (&same.colour, same.capture_nanos));
    }
    assert!(read(VideoSource::with_frames(&path, vec![]).unwrap()).0.is_empty());
}

#[test]
fn frames_that_the_video_lacks_are_named_after_those_it_has() {
    let Some((_folder, path)) = pattern("a.mkv", "-c:v ffv1") else { return };
    let (frames, error) = read(VideoSource::with_frames(&path, vec![48, 60, 70]).unwrap());
    assert_eq!(indices(&frames), [48]);
    assert!(error.unwrap().ends_with("a.mkv: there is no frame 60; the last is 49"));
    let unsorted = message(VideoSource::with_frames(&path, vec![2, 1]));
    assert!(unsorted.contains("a.mkv: frames must be asked for in ascending order"), "{unsorted}");
}

#[test]
fn a_known_colour_comes_out_as_it_went_in() {
    let colour = "-f lavfi -i color=c=0xC86432:size=64x48:rate=5:duration=1";
    for (file, codec, tolerance) in
        [("a.mkv", ",format=bgr0 -c:v ffv1", 0), ("a.mp4", " -c:v mpeg4 -q:v 2", 6)]
    {
        let Some((_folder, path)) = video(file, &format!("{colour}{codec}")) else { return };
        let (frames, error) = read_all(&path);
        assert_eq!((frames.len(), error), (5, None));
        for pixel in frames[3].colour.pixels().chunks(3) {
            let difference = pixel.iter().zip([0xC8, 0x64, 0x32]).map(|(a, b)| a.abs_diff(b)).max();
            assert!(difference <= Some(tolerance), "{file}: {pixel:?}");
        }
    }
}

#[test]
fn where_the_rate_varies_each_frame_keeps_its_own_time() {
    let codec = "-vf setpts='(N+4*gte(N,10))/25/TB' -c:v ffv1";
    let Some((_folder, path)) = pattern("a.mkv", codec) else { return };
    let (frames, error) = read(VideoSource::open(&path, Some(3)).unwrap());
    assert_eq!((frames.len(), error), (17, None));
    for frame in &frames {
        let pause = if frame.index >= 10 { 4 } else { 0 };
        assert_eq!(frame.capture_nanos, (frame.index as i64 + pause) * NANOS_PER_FRAME);
    }
}

#[test]
fn a_picture_is_turned_as_the_file_says() {
    let Some((_folder, path)) = pattern("a.mp4", "-c:v mpeg4") else { return };
    let mut bytes = fs::read(&path).unwrap();
    let header = bytes.windows(4).position(|window| window == b"tkhd").unwrap();
    let quarter_turn: [i32; 9] = [0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30];
    let matrix = quarter_turn.map(i32::to_be_bytes).concat();
    bytes[header + 44..header + 80].copy_from_slice(&matrix);
    fs::write(&path, bytes).unwrap();
    let (frames, error) = read_all(&path);
    assert_eq!((frames.len(), error), (50, None));
    assert_eq!((frames[0].colour.width(), frames[0].colour.height()), (48, 64));
}

#[test]
fn pictures_that_change_their_size_are_numbered_on_and_scaled() {
    let Some((folder, path)) = pattern("small.ts", "-c:v mpeg2video") else { return };
    let source = "-f lavfi -i testsrc=size=96x64:rate=25:duration=2 -c:v mpeg2video";
    let (_folder, large) = video("large.ts", source).unwrap();
    let both = folder.path().join("both.ts");
    fs::write(&both, [fs::read(path).unwrap(), fs::read(large).unwrap()].concat()).unwrap();
    let (frames, _) = read_all(&both);
    assert!(frames.len() > 90, "{}", frames.len());
    assert_eq!(indices(&frames), (0..frames.len() as u64).collect::<Vec<_>>());
    assert!(frames.iter().all(|frame| frame.colour.width() == 64));
}

#[test]
fn a_video_that_is_cut_off_gives_what_it_has_and_then_one_error() {
    let containers = [
        ("a.avi", "-c:v mjpeg"),
        ("a.mkv", "-c:v ffv1"),
        ("a.mp4", "-c:v mpeg4 -movflags +faststart"),
        ("b.avi", "-c:v rawvideo -pix_fmt bgr24"),
    ];
    for (file, codec) in containers {
        let Some((_folder, path)) = pattern(file, codec) else { return };
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
        for interval in [1, 7] {
            let (frames, error) = read(VideoSource::open(&path, Some(interval)).unwrap());
            assert!((1..50).contains(&frames.len()), "{file}: {}", frames.len());
            let error = error.unwrap();
            assert!(error.contains(file) && error.contains("cut off; "), "{error}");
        }
    }
}

#[test]
fn a_video_that_is_cut_off_between_two_frames_is_reported_too() {
    let Some((_folder, path)) = pattern("a.avi", "-c:v rawvideo -pix_fmt bgr24") else { return };
    let bytes = fs::read(&path).unwrap();
    let mut chunks = bytes.windows(4).enumerate().filter(|(_, window)| window == b"00dc");
    // The index names the chunks before the first one comes.
    let (end_of_30_frames, _) = chunks.nth(31).unwrap();
    fs::write(&path, &bytes[..end_of_30_frames]).unwrap();
    let (frames, error) = read_all(&path);
    assert_eq!(frames.len(), 30);
    assert!(
        error
            .unwrap()
            .ends_with("a.avi: cut off; 30 of 50 frames were read; copy or convert the video again")
    );
}

#[test]
fn frames_that_an_edit_list_hides_are_not_missed() {
    let Some((folder, path)) = pattern("a.mp4", "-c:v mpeg4 -g 50") else { return };
    let edited = folder.path().join("edited.mp4");
    let mut command = Command::new(INSTALLED.ffmpeg);
    command.args(["-nostdin", "-v", "error", "-ss", "1", "-i"]).arg(&path).args(["-c", "copy"]).arg(&edited);
    assert!(command.status().unwrap().success());
    let source = VideoSource::open(&edited, Some(1)).unwrap();
    assert_eq!(source.frame_count(), None);
    let (frames, error) = read(source);
    assert_eq!((frames.len(), error), (25, None));
}

#[test]
fn files_that_are_no_video_are_refused_by_name() {
    let Some((folder, audio)) = video("sound.m4a", "-f lavfi -i sine=duration=1") else { return };
    assert!(message(VideoSource::open(&audio, None)).contains("sound.m4a: it has no picture stream; name"));
    let Some((_folder, whole)) = pattern("a.mp4", "-c:v mpeg4") else { return };
    let bytes = fs::read(&whole).unwrap();
    let list = format!("#EXTM3U\n#EXTINF:2,\n{}\n#EXT-X-ENDLIST\n", whole.display());
    let noise: Vec<u8> = (0..20_000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let files =
        [("cut.mp4", &bytes[..bytes.len() * 2 / 3]), ("list.m3u8", list.as_bytes()), ("noise.mkv", &noise)];
    for (file, content) in files {
        let path = folder.path().join(file);
        fs::write(&path, content).unwrap();
        let error = message(VideoSource::open(&path, None));
        assert!(error.contains(&format!("{file}: it is no video that ffmpeg can read (")), "{error}");
    }
}

#[test]
fn what_cannot_hold_a_video_is_refused_without_asking_ffmpeg() {
    let folder = tempfile::tempdir().unwrap();
    let open = |path: &Path| message(VideoSource::open(path, None));
    assert!(open(folder.path()).contains("it is a folder"));
    assert!(open(Path::new("/dev/null")).contains("it is not a regular file"));
    let missing = folder.path().join("missing.mp4");
    assert!(open(&missing).starts_with(&format!("cannot read {}: ", missing.display())));
    let empty = folder.path().join("empty.mp4");
    fs::write(&empty, "").unwrap();
    assert!(open(&empty).contains("empty.mp4: the file is empty; copy it again"));
}

#[test]
fn a_missing_ffmpeg_is_named_with_the_fix() {
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), "not empty").unwrap();
    let programs = Programs { ffmpeg: "ffmpeg-of-nobody", ffprobe: "ffprobe-of-nobody" };
    let error = message(VideoSource::open_with(file.path(), programs, |_| Selection::every(1)));
    let expected = "ffprobe-of-nobody is not installed; install ffmpeg: `apt install ffmpeg`";
    assert_eq!(error, format!("video {}: {expected}", file.path().display()));
    let Some((_folder, path)) = pattern("a.avi", "-c:v mjpeg") else { return };
    let programs = Programs { ffmpeg: "ffmpeg-of-nobody", ..INSTALLED };
    let error = message(VideoSource::open_with(&path, programs, |_| Selection::every(1)));
    assert!(error.contains("ffmpeg-of-nobody is not installed"), "{error}");
}

#[test]
fn a_name_means_nothing_but_itself() {
    let Some((folder, path)) = pattern("a.avi", "-c:v mjpeg") else { return };
    for name in ["-i:strange 'name' %03d*.avi", "http:x.avi", "concat:a|b.avi"] {
        let strange = folder.path().join(name);
        fs::copy(&path, &strange).unwrap();
        let (frames, error) = read(VideoSource::open(&strange, Some(10)).unwrap());
        assert_eq!((frames.len(), error), (5, None));
        assert_eq!(frames[1].name, format!("{name}#10"));
    }
    let mut command = Command::new("ffmpeg");
    add_input(&mut command, Path::new("-y"));
    assert_eq!(command.get_args().last().unwrap(), "file:-y");
}

#[test]
fn pictures_too_large_or_too_small_are_refused_before_they_are_decoded() {
    for (size, what) in [("8200x40", "8200×40 px is too large"), ("16x16", "16×16 px is too small")] {
        let arguments = format!("-f lavfi -i color=size={size}:rate=5:duration=1 -c:v ffv1");
        let Some((_folder, path)) = video("a.mkv", &arguments) else { return };
        let error = message(VideoSource::open(&path, None));
        assert!(error.contains(what), "{error}");
    }
}

#[test]
fn a_source_that_is_dropped_early_leaves_no_process() {
    let arguments = "-f lavfi -i testsrc=size=640x480:rate=25:duration=4 -c:v mpeg4";
    let Some((_folder, path)) = video("a.mp4", arguments) else { return };
    let mut source = VideoSource::open(&path, Some(1)).unwrap();
    source.next_frame().unwrap().unwrap();
    let process = PathBuf::from(format!("/proc/{}", source.decoder.as_ref().unwrap().process_id()));
    assert!(process.exists());
    let start = Instant::now();
    drop(source);
    assert!(!process.exists());
    assert!(start.elapsed() < Duration::from_secs(5));
    let mut source = VideoSource::with_frames(&path, vec![2]).unwrap();
    let process = PathBuf::from(format!("/proc/{}", source.decoder.as_ref().unwrap().process_id()));
    source.next_frame().unwrap().unwrap();
    assert!(!process.exists(), "nothing more is wanted of it");
}

#[test]
fn ffmpeg_names_its_version_and_what_is_not_installed_has_none() {
    let version = super::ffmpeg_version().expect("ffmpeg is installed for tests");
    assert!(version.starts_with(|first: char| first.is_ascii_alphanumeric()), "{version}");
    let absent = Programs { ffmpeg: "no-such-ffmpeg", ffprobe: "no-such-ffprobe" };
    assert_eq!(probe::version(absent), None);
}
