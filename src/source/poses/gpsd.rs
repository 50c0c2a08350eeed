//! Positions from gpsd, the daemon that reads GPS receivers, by its JSON protocol (`man gpsd_json`).

use std::io::Write;
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use serde::Deserialize;

use super::lines::{Connection, Lines};
use super::position::LocalFrame;
use crate::frame::Pose;

/// Where gpsd listens.
pub(super) const PORT: u16 = 2947;
/// Asks gpsd to say what it knows as soon as it knows it.
const WATCH: &[u8] = b"?WATCH={\"enable\":true,\"json\":true};\n";
/// How long a connection may take: frames wait meanwhile.
const CONNECTING: Duration = Duration::from_millis(50);
/// How long after a failure gpsd is looked for again.
const PAUSE: Duration = Duration::from_secs(5);
/// Least mode of a report that has a position, one in the plane.
const FIX_IN_THE_PLANE: u8 = 2;

/// A connection to gpsd, made again where it breaks.
#[derive(Debug)]
pub(super) struct Gpsd {
    address: String,
    stream: Option<TcpStream>,
    lines: Lines,
    frame: Option<LocalFrame>,
    retry_at: Instant,
}

/// A report of time, position and velocity; other reports have another class.
#[derive(Deserialize)]
struct Report {
    class: String,
    mode: Option<u8>,
    lat: Option<f64>,
    lon: Option<f64>,
    #[serde(rename = "altHAE", alias = "alt")]
    altitude_metres: Option<f64>,
}

impl Gpsd {
    /// Positions of the gpsd at `HOST:PORT`, which need not run yet.
    pub(super) fn new(address: String) -> Self {
        Self { address, stream: None, lines: Lines::default(), frame: None, retry_at: Instant::now() }
    }

    /// Hands every position that has come to `take`. Answers what people should know.
    pub(super) fn read(&mut self, mut take: impl FnMut(Pose)) -> Option<String> {
        let (mut notice, frame) = (None, &mut self.frame);
        if self.stream.is_none() && Instant::now() >= self.retry_at {
            self.retry_at = Instant::now() + PAUSE;
            self.stream = connected(&self.address);
            self.lines = Lines::default();
            notice = self.stream.as_ref().map(|_| format!("gpsd at {} answers", self.address));
        }
        let stream = self.stream.as_mut()?;
        let read = self.lines.read(stream, |line| {
            if let Some((degrees, altitude_metres)) = position(line) {
                let frame = frame.get_or_insert_with(|| LocalFrame::near(degrees));
                take(Pose {
                    position_metres: frame.metres(degrees, altitude_metres),
                    orientation: Pose::UPRIGHT,
                });
            }
        });
        if read == Connection::Ended {
            self.stream = None;
            let address = &self.address;
            notice = Some(format!("gpsd at {address} is gone; it is looked for every {} s", PAUSE.as_secs()));
        }
        notice
    }
}

fn connected(address: &str) -> Option<TcpStream> {
    let address = address.to_socket_addrs().ok()?.next()?;
    let mut stream = TcpStream::connect_timeout(&address, CONNECTING).ok()?;
    stream.set_nonblocking(true).ok()?;
    stream.write_all(WATCH).ok()?;
    Some(stream)
}

/// Latitude and longitude in degrees and altitude in metres of a report, if it has them.
fn position(line: &str) -> Option<([f64; 2], f64)> {
    let report: Report = serde_json::from_str(line).ok()?;
    let is_fix = report.class == "TPV" && report.mode? >= FIX_IN_THE_PLANE;
    let (latitude, longitude) = (report.lat?, report.lon?);
    let is_on_earth = latitude.abs() <= 90.0 && longitude.abs() <= 360.0;
    let altitude_metres = report.altitude_metres.filter(|metres| metres.abs() < 1e5).unwrap_or(0.0);
    (is_fix && is_on_earth).then_some(([latitude, longitude], altitude_metres))
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::net::TcpListener;
    use std::thread::sleep;

    use super::*;

    const FIX: &str = r#"{"class":"TPV","device":"/dev/ttyUSB0","mode":3,"time":"2026-05-04T10:11:12.000Z",
        "lat":48.5,"lon":11.25,"altHAE":510.5,"speed":0.1}"#;

    #[test]
    fn a_position_is_read_of_a_report_that_has_one() {
        assert_eq!(position(FIX), Some(([48.5, 11.25], 510.5)));
        let older = r#"{"class":"TPV","mode":2,"lat":1.0,"lon":2.0}"#;
        assert_eq!(position(older), Some(([1.0, 2.0], 0.0)));
        for other in [
            r#"{"class":"TPV","mode":1,"lat":1.0,"lon":2.0}"#,
            r#"{"class":"TPV","mode":3,"lon":2.0}"#,
            r#"{"class":"TPV","mode":3,"lat":91.0,"lon":2.0}"#,
            r#"{"class":"SKY","mode":3,"lat":1.0,"lon":2.0}"#,
            r#"{"class":"VERSION","release":"3.22"}"#,
            "no JSON",
            "",
        ] {
            assert_eq!(position(other), None, "{other}");
        }
    }

    /// Reads until a position came.
    fn awaited(gpsd: &mut Gpsd) -> (Pose, Option<String>) {
        let started = Instant::now();
        let (mut pose, mut said) = (None, None);
        while pose.is_none() {
            assert!(started.elapsed() < Duration::from_secs(10), "no position");
            said = gpsd.read(|come| pose = Some(come)).or(said);
            sleep(Duration::from_millis(1));
        }
        (pose.unwrap(), said)
    }

    #[test]
    fn gpsd_is_asked_to_watch_and_looked_for_again_when_it_is_gone() {
        let server = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let address = server.local_addr().unwrap().to_string();
        let mut gpsd = Gpsd::new(address.clone());
        assert_eq!(gpsd.read(|_| panic!("nothing came")), Some(format!("gpsd at {address} answers")));
        let (mut peer, _) = server.accept().unwrap();
        let mut asked = String::new();
        BufReader::new(peer.try_clone().unwrap()).read_line(&mut asked).unwrap();
        assert!(asked.starts_with("?WATCH="), "{asked}");
        writeln!(peer, "{}", FIX.replace('\n', " ")).unwrap();
        let (pose, _) = awaited(&mut gpsd);
        assert_eq!(pose.orientation, Pose::UPRIGHT);
        drop(peer);
        let started = Instant::now();
        let said = loop {
            assert!(started.elapsed() < Duration::from_secs(10), "nobody noticed");
            if let Some(said) = gpsd.read(|_| {}) {
                break said;
            }
        };
        assert_eq!(said, format!("gpsd at {address} is gone; it is looked for every 5 s"));
        gpsd.retry_at = Instant::now();
        assert_eq!(gpsd.read(|_| {}), Some(format!("gpsd at {address} answers")));
    }
}
