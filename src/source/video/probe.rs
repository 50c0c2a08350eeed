//! What a video file says of itself, asked with `ffprobe`.

use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};

use super::process::{Process, channel};
use super::{PATIENCE, Programs, add_input};
use crate::codec;

/// Frames a second of a video that does not say.
const USUAL_FPS: f64 = 30.0;
/// More than the few lines that are asked for.
const MAX_ANSWER_BYTES: u64 = 64 << 10;
/// How much shorter than its frames a video may be before they cannot all be shown.
const SLACK_FRAMES: f64 = 2.0;

/// The picture stream of a video file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct VideoInfo {
    /// Frames a second, on average.
    pub(super) fps: f64,
    /// Number of frames, if the container says it.
    pub(super) frame_count: Option<u64>,
}

/// Asks for the first picture stream of `path`.
///
/// # Errors
/// If there is no ffprobe, or the file is no video or larger or smaller than images may be.
pub(super) fn probe(path: &Path, programs: Programs) -> Result<VideoInfo, String> {
    let (answer, theirs) = channel(PATIENCE).map_err(|error| error.to_string())?;
    let mut command = Command::new(programs.ffprobe);
    command
        .args(["-hide_banner", "-v", "error"])
        .args(["-select_streams", "V:0", "-of", "default=noprint_wrappers=1", "-show_entries"])
        .arg("stream=width,height,avg_frame_rate,r_frame_rate,nb_frames,duration:format=format_name")
        .stdin(Stdio::null())
        .stdout(theirs);
    add_input(&mut command, path);
    let mut process = Process::spawn(command, PATIENCE)?;
    let mut text = String::new();
    let is_read = answer.take(MAX_ANSWER_BYTES).read_to_string(&mut text);
    let ended = process.finish();
    is_read.map_err(|error| format!("ffprobe gave no answer: {error}"))?;
    match info(&text) {
        // A damaged video may complain and still be read for a good part.
        Ok(info) => Ok(info),
        Err(reason) => Err(ended.err().map_or(reason, |complaint| {
            format!("it is no video that ffmpeg can read ({complaint}); copy or convert it again")
        })),
    }
}

/// The version of ffmpeg, as it names itself; `None` if it does not run.
pub(super) fn version(programs: Programs) -> Option<String> {
    let (answer, theirs) = channel(PATIENCE).ok()?;
    let mut command = Command::new(programs.ffmpeg);
    command.args(["-hide_banner", "-version"]).stdin(Stdio::null()).stdout(theirs);
    let mut process = Process::spawn(command, PATIENCE).ok()?;
    let mut text = String::new();
    answer.take(MAX_ANSWER_BYTES).read_to_string(&mut text).ok()?;
    process.finish().ok()?;
    text.strip_prefix("ffmpeg version ")?.split_whitespace().next().map(str::to_owned)
}

fn info(answer: &str) -> Result<VideoInfo, String> {
    // A stream of a transport stream is told twice, in its program and by itself.
    let value = |key: &str| {
        let mut pairs = answer.lines().filter_map(|line| line.split_once('='));
        pairs.find(|(name, _)| *name == key).map(|(_, value)| value)
    };
    let number = |key| value(key).and_then(|text| text.parse::<u64>().ok());
    let (Some(width), Some(height)) = (number("width"), number("height")) else {
        return Err("it has no picture stream; name a file with video".to_owned());
    };
    let side = |pixels| usize::try_from(pixels).unwrap_or(usize::MAX);
    codec::check_size(side(width), side(height))?;
    let rate = |key| value(key).and_then(fraction);
    let fps = rate("avg_frame_rate").or_else(|| rate("r_frame_rate")).unwrap_or(USUAL_FPS);
    // MP4 counts frames that its edit list then leaves out; other containers know no such lists.
    let shown = value("duration").and_then(|text| text.parse::<f64>().ok()).map(|seconds| seconds * fps);
    let is_edited = value("format_name").is_some_and(|name| name.starts_with("mov,"))
        && number("nb_frames").zip(shown).is_some_and(|(count, shown)| count as f64 > shown + SLACK_FRAMES);
    let frame_count = number("nb_frames").filter(|&count| count > 0 && !is_edited);
    Ok(VideoInfo { fps, frame_count })
}

/// `30000/1001` as a number, if it is a positive one.
fn fraction(text: &str) -> Option<f64> {
    let (numerator, denominator) = text.split_once('/')?;
    let value = numerator.parse::<f64>().ok()? / denominator.parse::<f64>().ok()?;
    (value.is_finite() && value > 0.0).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_container_does_not_say_is_not_known() {
        let answer = "width=64\nheight=48\nr_frame_rate=50/1\navg_frame_rate=0/0\nduration=N/A\nnb_frames=N/A\n\
                      format_name=matroska,webm\n";
        assert_eq!(info(answer), Ok(VideoInfo { fps: 50.0, frame_count: None }));
        assert_eq!(info("width=64\nheight=48\n"), Ok(VideoInfo { fps: USUAL_FPS, frame_count: None }));
    }

    #[test]
    fn frames_that_an_edit_list_leaves_out_make_the_count_unknown() {
        let answer = |seconds, format| {
            format!(
                "width=64\nheight=48\navg_frame_rate=25/1\nduration={seconds}\nnb_frames=50\nformat_name={format}\n"
            )
        };
        let count = |seconds, format| info(&answer(seconds, format)).unwrap().frame_count;
        assert_eq!(count("2.0", "mov,mp4,m4a"), Some(50));
        assert_eq!(count("1.0", "mov,mp4,m4a"), None);
        assert_eq!(count("1.0", "avi"), Some(50));
    }

    #[test]
    fn absurd_answers_are_refused() {
        assert!(info("format_name=mp3\n").unwrap_err().contains("no picture stream"));
        assert!(info("width=8193\nheight=48\n").unwrap_err().contains("too large"));
        assert!(info("width=99999999999\nheight=48\n").unwrap_err().contains("too large"));
        assert!(info("width=0\nheight=0\n").unwrap_err().contains("too small"));
        assert_eq!([fraction("30/0"), fraction("-1/1"), fraction("nan/1"), fraction("x")], [None; 4]);
    }
}
