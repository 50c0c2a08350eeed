//! Positions from gpsd, the daemon that reads GPS receivers, by its JSON protocol (`man gpsd_json`).
//!
//! A thread of its own looks for it and listens, since looking up a name and connecting may take long, and a position
//! counts as of when it arrives.

use std::io::{self, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use serde::Deserialize;

use super::lines::{Connection, Lines};
use super::position::LocalFrame;
use crate::frame::Pose;
use crate::source::{SourceError, wall_nanos};

/// Where gpsd listens.
pub(super) const PORT: u16 = 2947;
/// Asks gpsd to say what it knows as soon as it knows it.
const WATCH: &[u8] = b"?WATCH={\"enable\":true,\"json\":true};\n";
/// How long a connection may take.
const CONNECTING: Duration = Duration::from_secs(2);
/// How often it is looked whether anybody still wants positions.
const TICK: Duration = Duration::from_millis(500);
/// How long after a failure gpsd is looked for again.
const PAUSE: Duration = Duration::from_secs(if cfg!(test) { 1 } else { 5 });
/// How long gpsd may say nothing before it is connected anew: its computer may have gone without a word.
const SILENCE: Duration = Duration::from_secs(30);
/// News that wait to be heard at most; what comes beyond is lost.
const MOST_NEWS: usize = 256;
/// Least mode of a report that has a position, one in the plane.
const FIX_IN_THE_PLANE: u8 = 2;

/// What a gpsd says, as it comes.
#[derive(Debug)]
pub(super) struct Gpsd {
    news: Receiver<News>,
    frame: Option<LocalFrame>,
    is_over: Arc<AtomicBool>,
}

#[derive(Debug)]
enum News {
    Position { nanos: i64, degrees: [f64; 2], altitude_metres: f64 },
    Notice(String),
}

/// A report of time, position and velocity; other reports have another class.
#[derive(Deserialize)]
struct Report {
    class: String,
    mode: Option<u8>,
    lat: Option<f64>,
    lon: Option<f64>,
    /// Above the ellipsoid; what older ones have is called `alt`, and newer ones have both.
    #[serde(rename = "altHAE")]
    above_ellipsoid_metres: Option<f64>,
    alt: Option<f64>,
}

impl Gpsd {
    /// Positions of the gpsd at `HOST:PORT`, which need not run yet.
    ///
    /// # Errors
    /// If the system has no thread left.
    pub(super) fn watch(address: String) -> Result<Self, SourceError> {
        let (to_news, news) = sync_channel(MOST_NEWS);
        let is_over = Arc::new(AtomicBool::new(false));
        let watching = Watching { address: address.clone(), to_news, is_over: Arc::clone(&is_over) };
        let started = thread::Builder::new().name("loci-gpsd".to_owned()).spawn(move || watching.run());
        started.map_err(|source| SourceError::Io { path: address.into(), source })?;
        Ok(Self { news, frame: None, is_over })
    }

    /// Hands every position that has come, with its time in nanoseconds, to `take`. Answers what people should know.
    pub(super) fn read(&mut self, mut take: impl FnMut(i64, Pose)) -> Option<String> {
        let (mut notice, frame) = (None, &mut self.frame);
        for news in self.news.try_iter().take(MOST_NEWS) {
            match news {
                News::Notice(said) => notice = Some(said),
                News::Position { nanos, degrees, altitude_metres } => {
                    let frame = frame.get_or_insert_with(|| LocalFrame::near(degrees));
                    let position_metres = frame.metres(degrees, altitude_metres);
                    take(nanos, Pose { position_metres, orientation: Pose::UPRIGHT });
                }
            }
        }
        notice
    }
}

impl Drop for Gpsd {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
    }
}

/// The thread that listens.
struct Watching {
    address: String,
    to_news: SyncSender<News>,
    is_over: Arc<AtomicBool>,
}

impl Watching {
    fn run(self) {
        let (address, every) = (&self.address, PAUSE.as_secs());
        let mut is_known_to_be_away = false;
        while !self.is_over.load(Ordering::Relaxed) {
            match connected(address) {
                Ok(mut stream) => {
                    self.say(format!("gpsd at {address} answers"));
                    is_known_to_be_away = false;
                    if self.listen(&mut stream) == Connection::Ended {
                        self.say(format!("gpsd at {address} is gone; it is looked for every {every} s"));
                        is_known_to_be_away = true;
                    } else {
                        continue;
                    }
                }
                Err(error) if !is_known_to_be_away => {
                    self.say(format!("gpsd at {address}: {error}; it is looked for every {every} s"));
                    is_known_to_be_away = true;
                }
                Err(_) => {}
            }
            let again_at = Instant::now() + PAUSE;
            while Instant::now() < again_at && !self.is_over.load(Ordering::Relaxed) {
                thread::sleep(TICK);
            }
        }
    }

    /// Listens until the connection ends, or as long as it is not silent for long.
    fn listen(&self, stream: &mut TcpStream) -> Connection {
        let (mut lines, mut heard_at) = (Lines::default(), Instant::now());
        while heard_at.elapsed() < SILENCE && !self.is_over.load(Ordering::Relaxed) {
            let read = lines.read(stream, |line| {
                heard_at = Instant::now();
                if let Some((degrees, altitude_metres)) = position(line) {
                    self.tell(News::Position { nanos: wall_nanos(), degrees, altitude_metres });
                }
            });
            if read == Connection::Ended {
                return Connection::Ended;
            }
        }
        Connection::Open
    }

    fn say(&self, notice: String) {
        self.tell(News::Notice(notice));
    }

    fn tell(&self, news: News) {
        // Nobody waits for one who does not listen.
        let _ = self.to_news.try_send(news);
    }
}

fn connected(address: &str) -> io::Result<TcpStream> {
    let mut failure = io::Error::new(io::ErrorKind::NotFound, "there is no such host");
    for address in address.to_socket_addrs()? {
        let connected = TcpStream::connect_timeout(&address, CONNECTING).and_then(|mut stream| {
            stream.set_read_timeout(Some(TICK))?;
            stream.write_all(WATCH)?;
            Ok(stream)
        });
        match connected {
            Ok(stream) => return Ok(stream),
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

/// Latitude and longitude in degrees and altitude in metres of a report, if it has them.
fn position(line: &str) -> Option<([f64; 2], f64)> {
    let report: Report = serde_json::from_str(line).ok()?;
    let is_fix = report.class == "TPV" && report.mode? >= FIX_IN_THE_PLANE;
    let (latitude, longitude) = (report.lat?, report.lon?);
    let is_on_earth = latitude.abs() <= 90.0 && longitude.abs() <= 360.0;
    let altitude_metres = report.above_ellipsoid_metres.or(report.alt).filter(|metres| metres.abs() < 1e5);
    (is_fix && is_on_earth).then_some(([latitude, longitude], altitude_metres.unwrap_or(0.0)))
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::net::TcpListener;

    use super::*;

    const FIX: &str = concat!(
        r#"{"class":"TPV","device":"/dev/ttyUSB0","mode":3,"time":"2026-05-04T10:11:12.000Z","ept":0.005,"#,
        r#""lat":48.5,"lon":11.25,"altHAE":510.5,"altMSL":463.1,"alt":463.1,"epx":8.1,"speed":0.1}"#,
    );

    #[test]
    fn a_position_is_read_of_a_report_that_has_one() {
        assert_eq!(position(FIX), Some(([48.5, 11.25], 510.5)));
        let older = r#"{"class":"TPV","mode":2,"lat":1.0,"lon":2.0,"alt":7.0}"#;
        assert_eq!(position(older), Some(([1.0, 2.0], 7.0)));
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

    /// Reads until something is said, or a position came.
    fn news(gpsd: &mut Gpsd) -> (Option<String>, Vec<(i64, Pose)>) {
        let started = Instant::now();
        loop {
            let mut poses = Vec::new();
            let said = gpsd.read(|nanos, pose| poses.push((nanos, pose)));
            if said.is_some() || !poses.is_empty() {
                return (said, poses);
            }
            assert!(started.elapsed() < Duration::from_secs(60), "nothing is heard");
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn gpsd_is_asked_to_watch_and_looked_for_again_when_it_is_gone() {
        let server = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let address = server.local_addr().unwrap().to_string();
        let mut gpsd = Gpsd::watch(address.clone()).unwrap();
        assert_eq!(news(&mut gpsd).0, Some(format!("gpsd at {address} answers")));
        let (mut peer, _) = server.accept().unwrap();
        let mut asked = String::new();
        BufReader::new(peer.try_clone().unwrap()).read_line(&mut asked).unwrap();
        assert!(asked.starts_with("?WATCH="), "{asked}");
        writeln!(peer, "{FIX}").unwrap();
        let (_, poses) = news(&mut gpsd);
        assert_eq!(poses[0].1.orientation, Pose::UPRIGHT);
        assert!((wall_nanos() - poses[0].0).abs() < 60_000_000_000);
        drop(peer);
        let gone = format!("gpsd at {address} is gone; it is looked for every 1 s");
        assert_eq!(news(&mut gpsd).0, Some(gone));
        assert_eq!(news(&mut gpsd).0, Some(format!("gpsd at {address} answers")));
    }

    #[test]
    fn a_gpsd_that_is_not_there_is_named_once() {
        let closed = TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap().to_string();
        let mut gpsd = Gpsd::watch(closed.clone()).unwrap();
        let said = news(&mut gpsd).0.unwrap();
        assert!(said.starts_with(&format!("gpsd at {closed}: ")) && said.ends_with("every 1 s"), "{said}");
    }
}
