//! The running ffmpeg: a line for every frame it decodes, and the pictures of those that are selected.
//!
//! Two channels come from it. On one the filter `metadata` tells every decoded frame's number and
//! presentation time before the frame is selected or not, so we know how many there were, that ffmpeg is
//! alive, and for which frames a picture follows. On the other come the pictures as PPM, each with its
//! size. Lines run ahead of pictures, never behind, so reading a line and then its picture cannot block
//! for good. The second channel is the standard input, which ffmpeg does not otherwise need and writes to
//! like to any descriptor: it is the only one left that a safe program can hand to a child.

use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command;

use super::process::{Process, channel};
use super::selection::Selection;
use super::{PATIENCE, Programs, add_input};
use crate::codec;
use crate::raster::RgbImage;

/// Longer than any line that ffmpeg writes here.
const MAX_LINE_BYTES: u64 = 256;

/// Number and time of a decoded frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stamp {
    /// Number of the frame in the video.
    pub(super) index: u64,
    /// Presentation time in nanoseconds from the start of the video, if the frame has one.
    pub(super) nanos: Option<i64>,
}

/// ffmpeg at work on one file.
#[derive(Debug)]
pub(super) struct Decoder {
    process: Process,
    stamps: BufReader<UnixStream>,
    pictures: BufReader<UnixStream>,
    decoded: u64,
}

impl Decoder {
    /// Starts to decode `path`.
    pub(super) fn start(path: &Path, selection: &Selection, programs: Programs) -> Result<Self, String> {
        let open = || channel(PATIENCE).map_err(|error| error.to_string());
        let ((stamps, their_stamps), (pictures, their_pictures)) = (open()?, open()?);
        let mut command = Command::new(programs.ffmpeg);
        command
            .args(["-nostdin", "-hide_banner", "-v", "error"])
            // A change of size within the video must not begin the numbers anew: pictures are scaled.
            .args(["-reinit_filter", "0"])
            .stdin(their_stamps)
            .stdout(their_pictures);
        add_input(&mut command, path);
        command
            .args(["-map", "0:V:0", "-vf", &filters(selection), "-r", "25"])
            // An encoder with several threads would hold pictures back until more are selected.
            .args(["-threads", "1", "-pix_fmt", "rgb24", "-c:v", "ppm", "-f", "image2pipe", "pipe:1"]);
        let process = Process::spawn(command, PATIENCE)?;
        Ok(Self { process, stamps: BufReader::new(stamps), pictures: BufReader::new(pictures), decoded: 0 })
    }

    /// Number of frames decoded so far.
    pub(super) fn decoded(&self) -> u64 {
        self.decoded
    }

    /// The stamp of the next frame; `None` at the end.
    pub(super) fn next_stamp(&mut self) -> Result<Option<Stamp>, String> {
        loop {
            let line = read_line(&mut self.stamps).map_err(|error| self.reason(&error))?;
            if line.is_empty() {
                return Ok(None);
            }
            let Some((number, nanos)) = parse_stamp(&line) else { continue };
            let index = self.decoded;
            if number != index {
                return Err(format!("ffmpeg lost count at frame {index}; convert the video again"));
            }
            self.decoded += 1;
            return Ok(Some(Stamp { index, nanos }));
        }
    }

    /// The picture of the frame whose stamp was read last, which must be one that is sent.
    pub(super) fn picture(&mut self) -> Result<RgbImage, String> {
        let (width, height) = read_ppm_header(&mut self.pictures).map_err(|error| self.reason(&error))?;
        codec::check_size(width, height)?;
        let mut pixels = vec![0; width * height * 3];
        self.pictures.read_exact(&mut pixels).map_err(|error| self.reason(&error))?;
        RgbImage::from_pixels(width, height, pixels).ok_or_else(|| "a picture has no size".to_owned())
    }

    /// Waits for ffmpeg's end.
    ///
    /// # Errors
    /// What it complained of first.
    pub(super) fn finish(&mut self) -> Result<(), String> {
        self.process.finish()
    }

    #[cfg(test)]
    pub(super) fn process_id(&self) -> u32 {
        self.process.id()
    }

    /// Why nothing more could be read.
    fn reason(&mut self, error: &io::Error) -> String {
        let reason = match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut => {
                format!("ffmpeg decoded nothing within {} s", PATIENCE.as_secs())
            }
            ErrorKind::UnexpectedEof => match self.process.finish() {
                Ok(()) => "ffmpeg stopped within a picture".to_owned(),
                Err(complaint) => format!("ffmpeg stopped: {complaint}"),
            },
            _ => error.to_string(),
        };
        format!("frame {}: {reason}; see whether `ffmpeg -i` reads it", self.decoded)
    }
}

/// Tells number and time in nanoseconds of every frame, then selects. Where pictures must come at a
/// constant rate ffmpeg repeats and leaves out frames, and the option against that has another name in
/// every other version: so the selected frames are given times that are constant.
fn filters(selection: &Selection) -> String {
    let expression = selection.expression();
    format!(
        "settb=1/1000000000,metadata=mode=add:key=loci:value=1,\
         metadata=mode=print:key=loci:file='pipe\\:0':direct=1,\
         select='{expression}',settb=1/25,setpts=N"
    )
}

/// A line without its end; empty at the end of the stream.
fn read_line(from: &mut impl BufRead) -> io::Result<String> {
    let mut line = Vec::new();
    from.take(MAX_LINE_BYTES).read_until(b'\n', &mut line)?;
    Ok(String::from_utf8_lossy(&line).into_owned())
}

/// Number and time of `frame:12   pts:480000000 pts_time:0.48`; other lines hold the metadata.
fn parse_stamp(line: &str) -> Option<(u64, Option<i64>)> {
    let mut words = line.split_whitespace();
    let number = words.next()?.strip_prefix("frame:")?.parse().ok()?;
    let time = words.next()?.strip_prefix("pts:")?;
    Some((number, time.parse().ok()))
}

/// Width and height of a PPM whose three header lines are next.
fn read_ppm_header(from: &mut impl BufRead) -> io::Result<(usize, usize)> {
    let magic = read_line(from)?;
    if magic.is_empty() {
        return Err(ErrorKind::UnexpectedEof.into());
    }
    let (size, depth) = (read_line(from)?, read_line(from)?);
    let mut sides = size.split_whitespace().map(str::parse);
    match (magic.trim_end(), sides.next(), sides.next(), depth.trim_end()) {
        ("P6", Some(Ok(width)), Some(Ok(height)), "255") => Ok((width, height)),
        _ => Err(io::Error::new(ErrorKind::InvalidData, "ffmpeg sent no PPM picture")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_is_a_number_and_perhaps_a_time() {
        assert_eq!(parse_stamp("frame:12   pts:480000000 pts_time:0.48\n"), Some((12, Some(480_000_000))));
        assert_eq!(parse_stamp("frame:0    pts:-40   pts_time:-4e-08"), Some((0, Some(-40))));
        assert_eq!(parse_stamp("frame:3    pts:NOPTS pts_time:NOPTS"), Some((3, None)));
        assert_eq!(parse_stamp("loci=1"), None);
    }

    #[test]
    fn a_ppm_header_is_read_and_nothing_behind_it() {
        let mut bytes = &b"P6\n64 48\n255\n\x0a\x0b"[..];
        assert_eq!(read_ppm_header(&mut bytes).unwrap(), (64, 48));
        assert_eq!(bytes, [10, 11]);
        for bad in ["P5\n64 48\n255\n", "P6\n64\n255\n", "P6\n-1 48\n255\n", "P6\n64 48\n65535\n", "P6\n"] {
            assert_eq!(read_ppm_header(&mut bad.as_bytes()).unwrap_err().kind(), ErrorKind::InvalidData);
        }
        assert_eq!(read_ppm_header(&mut &b""[..]).unwrap_err().kind(), ErrorKind::UnexpectedEof);
        assert!(read_ppm_header(&mut &[b'1'; 10_000][..]).is_err());
    }
}
