//! Files of poses: TUM's lines of eight numbers, or CSV of latitude and longitude.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use super::position::LocalFrame;
use super::track::PoseTrack;
use crate::frame::Pose;
use crate::source::SourceError;

/// Longest file in bytes, and longest line.
const MOST_BYTES: u64 = 1 << 31;
const MOST_LINE_BYTES: u64 = 4096;
/// Characters of a wrong text that an error shows.
const MOST_SHOWN: usize = 60;
/// Most poses: half a day at 100 Hz, in 300 MB of memory.
const MOST_POSES: usize = 5_000_000;
/// Times beyond this many seconds from the epoch are no times.
const MOST_SECONDS: f64 = 9e9;

/// What the columns of a CSV may be called.
const TIME_NAMES: [&str; 4] = ["time", "timestamp", "t", "time_s"];
const LATITUDE_NAMES: [&str; 3] = ["lat", "latitude", "latitude_deg"];
const LONGITUDE_NAMES: [&str; 4] = ["lon", "lng", "longitude", "longitude_deg"];
const ALTITUDE_NAMES: [&str; 4] = ["alt", "altitude", "altitude_m", "height"];

impl PoseTrack {
    /// Reads the file at `path`: lines of `time tx ty tz qx qy qz qw` as of the TUM RGB-D benchmark (seconds, metres, a
    /// quaternion; `#` begins a comment), or CSV whose first line names time, lat and lon, and perhaps alt (seconds,
    /// degrees, metres).
    ///
    /// # Errors
    /// If the file cannot be read, is too long, or is neither; the line is named.
    pub fn read(path: &Path) -> Result<Self, SourceError> {
        let io = |source| SourceError::Io { path: path.to_owned(), source };
        let metadata = path.metadata().map_err(io)?;
        if !metadata.is_file() {
            return Err(io(std::io::Error::other("not a regular file")));
        }
        if metadata.len() > MOST_BYTES {
            return Err(io(std::io::Error::other("larger than 2 GiB; cut it into parts")));
        }
        let mut lines = BufReader::new(File::open(path).map_err(io)?.take(MOST_BYTES));
        let (mut format, mut poses, mut line, mut number) =
            (Format::Unknown, Vec::new(), String::new(), 0_usize);
        loop {
            line.clear();
            number += 1;
            if lines.by_ref().take(MOST_LINE_BYTES).read_line(&mut line).map_err(io)? == 0 {
                break;
            }
            let wrong =
                |reason: String| SourceError::BadPoses { path: path.to_owned(), line: number, reason };
            if line.len() as u64 == MOST_LINE_BYTES && !line.ends_with('\n') {
                return Err(wrong(format!("a line of {MOST_LINE_BYTES} bytes or more is too long")));
            }
            poses.extend(format.pose_of(line.trim()).map_err(wrong)?);
            if poses.len() > MOST_POSES {
                return Err(wrong(format!("more than {MOST_POSES} poses are too many")));
            }
        }
        if poses.is_empty() {
            let reason = "there is no pose in it".to_owned();
            return Err(SourceError::BadPoses { path: path.to_owned(), line: number, reason });
        }
        Ok(Self::new(poses))
    }
}

/// How the lines are to be read; the first one tells.
#[derive(Debug)]
pub(super) enum Format {
    Unknown,
    Tum,
    Positions { columns: Columns, frame: Option<LocalFrame> },
}

/// Where a CSV has what.
#[derive(Clone, Copy, Debug)]
pub(super) struct Columns {
    time: usize,
    latitude: usize,
    longitude: usize,
    altitude: Option<usize>,
}

impl Format {
    /// The pose of a line and its time in nanoseconds; `None` of a comment, an empty line, and of the one that names
    /// the columns.
    pub(super) fn pose_of(&mut self, line: &str) -> Result<Option<(i64, Pose)>, String> {
        if line.is_empty() || line.starts_with('#') { Ok(None) } else { self.pose(line) }
    }

    fn pose(&mut self, line: &str) -> Result<Option<(i64, Pose)>, String> {
        match self {
            Self::Unknown => {
                *self = Self::of(line)?;
                if let Self::Tum = self { self.pose(line) } else { Ok(None) }
            }
            Self::Tum => tum(line).map(Some),
            Self::Positions { columns, frame } => {
                let (nanos, degrees, altitude_metres) = columns.position(line)?;
                let frame = frame.get_or_insert_with(|| LocalFrame::near(degrees));
                let position_metres = frame.metres(degrees, altitude_metres);
                Ok(Some((nanos, Pose { position_metres, orientation: Pose::UPRIGHT })))
            }
        }
    }

    fn of(first: &str) -> Result<Self, String> {
        if tum(first).is_ok() {
            return Ok(Self::Tum);
        }
        let names: Vec<String> = first.split(',').map(|name| name.trim().to_ascii_lowercase()).collect();
        let find = |of: &[&str]| names.iter().position(|name| of.contains(&name.as_str()));
        let all = (find(&TIME_NAMES), find(&LATITUDE_NAMES), find(&LONGITUDE_NAMES));
        let (Some(time), Some(latitude), Some(longitude)) = all else {
            let tum = "lines of 'time tx ty tz qx qy qz qw'";
            return Err(format!(
                "expected {tum}, or CSV beginning with 'time,lat,lon', got '{}'",
                shown(first)
            ));
        };
        let columns = Columns { time, latitude, longitude, altitude: find(&ALTITUDE_NAMES) };
        Ok(Self::Positions { columns, frame: None })
    }
}

impl Columns {
    /// Time in nanoseconds, latitude and longitude in degrees, and altitude in metres.
    fn position(&self, line: &str) -> Result<(i64, [f64; 2], f64), String> {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let field = |column: usize, name: &str| match fields.get(column) {
            Some(text) => number(text, name),
            None => Err(format!("there is no {name}")),
        };
        let degrees = [field(self.latitude, "latitude")?, field(self.longitude, "longitude")?];
        for (degree, (most, name)) in degrees.iter().zip([(90.0, "latitude"), (360.0, "longitude")]) {
            if degree.abs() > most {
                return Err(format!("a {name} of {degree}° is none"));
            }
        }
        let altitude = self.altitude.map_or(Ok(0.0), |column| field(column, "altitude"))?;
        Ok((nanos(field(self.time, "time")?)?, degrees, altitude))
    }
}

/// A line of the TUM RGB-D benchmark (Sturm et al., IROS 2012).
fn tum(line: &str) -> Result<(i64, Pose), String> {
    let fields: Vec<&str> = line.split_ascii_whitespace().collect();
    let Ok([time, position @ .., qx, qy, qz, qw]) = <[&str; 8]>::try_from(fields) else {
        return Err("expected eight numbers: time tx ty tz qx qy qz qw".to_owned());
    };
    let mut position_metres = [0.0; 3];
    for (value, text) in position_metres.iter_mut().zip(position) {
        *value = number(text, "position")?;
    }
    let mut orientation = [0.0; 4];
    for (value, text) in orientation.iter_mut().zip([qx, qy, qz, qw]) {
        *value = number(text, "quaternion")?;
    }
    let length = orientation.iter().map(|part| part * part).sum::<f64>().sqrt();
    if !(0.5..2.0).contains(&length) {
        return Err(format!("a quaternion of length {length} is no orientation"));
    }
    let orientation = orientation.map(|part| part / length);
    Ok((nanos(number(time, "time")?)?, Pose { position_metres, orientation }))
}

fn number(text: &str, name: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite() && number.abs() < 1e15);
    number.ok_or_else(|| format!("'{}' is no {name}", shown(text)))
}

/// The beginning of a text from outside, such that a terminal may show it.
fn shown(text: &str) -> String {
    let beginning: String = text.chars().take(MOST_SHOWN).collect();
    let more = if beginning.len() < text.len() { "…" } else { "" };
    format!("{}{more}", beginning.escape_debug())
}

/// Seconds as nanoseconds.
fn nanos(seconds: f64) -> Result<i64, String> {
    if seconds.abs() > MOST_SECONDS {
        return Err(format!("{seconds} is no time in seconds"));
    }
    Ok((seconds * 1e9).round() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<PoseTrack, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("poses.txt");
        std::fs::write(&path, text).unwrap();
        PoseTrack::read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn lines_of_tum_are_read_with_their_comments() {
        let track = read("# ground truth\n1.5 1 2 3 0 0 0 1\n\n2.0 3 2 3 0 0 0.7071 0.7071\n").unwrap();
        assert_eq!(track.span_nanos(), Some([1_500_000_000, 2_000_000_000]));
        let pose = track.at(1_750_000_000).unwrap();
        assert_eq!(pose.position_metres, [2.0, 2.0, 3.0]);
        assert!((pose.orientation.iter().map(|part| part * part).sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn positions_of_a_csv_are_metres_apart() {
        let track = read("Timestamp, lat, lon, alt\n10,48.001,11.5,500\n11,48.002,11.5,500\n").unwrap();
        let [from, to] = [10, 11].map(|second| track.at(second * 1_000_000_000).unwrap().position_metres);
        let metres = from.iter().zip(to).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        assert!((metres - 111.2).abs() < 0.2, "{metres}");
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (text, part) in [
            ("", "line 1: there is no pose"),
            ("hello\n", "line 1: expected lines of"),
            ("1 2 3\n", "line 1: expected lines of"),
            ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0\n", "line 2: expected eight numbers"),
            ("1 0 0 0 0 0 0 1\n2 0 0 x 0 0 0 1\n", "line 2: 'x' is no position"),
            ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 0\n", "line 2: a quaternion of length 0"),
            ("1 0 0 0 0 0 0 1\n1e30 0 0 0 0 0 0 1\n", "line 2: '1e30' is no time"),
            ("time,lat,lon\n1,91,0\n", "line 2: a latitude of 91°"),
            ("time,lat,lon\n1,48\n", "line 2: there is no longitude"),
            ("time,lat,lon\nnan,48,11\n", "line 2: 'nan' is no time"),
            ("time,lat,lon\n", "there is no pose"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(part) && !error.contains('\n'), "{text:?}: {error}");
        }
    }

    #[test]
    fn a_folder_is_no_file_of_poses() {
        let folder = tempfile::tempdir().unwrap();
        assert!(PoseTrack::read(folder.path()).unwrap_err().to_string().contains("not a regular file"));
    }
}
