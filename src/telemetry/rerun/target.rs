//! Where a recording goes, as it is written on the command line.
//!
//! ```text
//! off | spawn | connect[=HOST[:PORT]] | serve[=IP[:PORT]] | save=FILE.rrd[?mib=N&minutes=N&files=N]
//! ```
//!
//! Pure text: nothing here knows rerun.

use std::fmt;
use std::iter;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::rotation::Rotation;
use crate::telemetry::TelemetryError;

/// The port that rerun viewers listen on.
pub(super) const DEFAULT_PORT: u16 = 9876;
/// Everything is for this machine alone unless another address is named.
pub(super) const LOCALHOST: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

const ALLOWED: &str = "use off, spawn, connect[=HOST:PORT], serve[=IP:PORT] or save=FILE.rrd";
const ROTATION: &str = "a new file begins by save=FILE.rrd?mib=500&minutes=60, and files=24 keeps so many";

/// Where a recording goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RerunTarget {
    /// Nowhere.
    Off,
    /// To a viewer on this machine, started if none is there.
    Spawn,
    /// To a viewer that is running, at `HOST:PORT`.
    Connect(String),
    /// To whoever connects to this address while the stream runs.
    Serve(SocketAddr),
    /// To a file, or one after the other, for later.
    Save(PathBuf, Rotation),
}

impl FromStr for RerunTarget {
    type Err = TelemetryError;

    fn from_str(given: &str) -> Result<Self, Self::Err> {
        let (kind, value) = match given.split_once('=') {
            Some((kind, value)) => (kind, Some(value)),
            None => (given, None),
        };
        let parsed = match (kind, value) {
            ("off", None) => Ok(Self::Off),
            ("spawn", None) => Ok(Self::Spawn),
            ("connect", None) => Ok(Self::Connect(SocketAddr::new(LOCALHOST, DEFAULT_PORT).to_string())),
            ("connect", Some(address)) => host_and_port(address).map(Self::Connect),
            ("serve", None) => Ok(Self::Serve(SocketAddr::new(LOCALHOST, DEFAULT_PORT))),
            ("serve", Some(address)) => ip_and_port(address).map(Self::Serve),
            ("save", Some(file)) => recording(file),
            ("off" | "spawn", Some(_)) => Err(format!("'{kind}' takes no value; {ALLOWED}")),
            ("save", None) => Err("'save' needs a file, as in save=run.rrd".to_owned()),
            _ => Err(ALLOWED.to_owned()),
        };
        parsed.map_err(|reason| TelemetryError::Rerun { target: format!("'{}'", one_line(given)), reason })
    }
}

impl RerunTarget {
    /// Whether both would write the same files, or one show to itself what the other serves.
    #[must_use]
    pub fn clashes_with(&self, other: &Self) -> bool {
        let own = |address: &SocketAddr| [Self::Spawn, Self::Connect(address.to_string())];
        let is_spawned = |address: &SocketAddr| address.port() == DEFAULT_PORT;
        match (self, other) {
            (Self::Save(one, _), Self::Save(two, _)) => whole(one) == whole(two),
            (Self::Serve(address), shown) | (shown, Self::Serve(address)) => {
                let is_own = own(address).contains(shown) && (*shown != Self::Spawn || is_spawned(address));
                is_own || self == other
            }
            _ => self == other,
        }
    }
}

/// The path of a file that may not be there yet, whatever leads to it.
fn whole(file: &Path) -> PathBuf {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    folder.join(file.file_name().unwrap_or_default())
}

/// As it is written on the command line.
impl fmt::Display for RerunTarget {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => formatter.write_str("off"),
            Self::Spawn => formatter.write_str("spawn"),
            Self::Connect(address) => write!(formatter, "connect={address}"),
            Self::Serve(address) => write!(formatter, "serve={address}"),
            Self::Save(file, rotation) => {
                write!(formatter, "save={}", file.display())?;
                let Rotation { mib, minutes, files } = rotation;
                let given = [("mib", mib), ("minutes", minutes), ("files", files)];
                let given = given.into_iter().filter_map(|(key, value)| Some((key, (*value)?)));
                let separators = iter::once('?').chain(iter::repeat('&'));
                given
                    .zip(separators)
                    .try_for_each(|((key, value), by)| write!(formatter, "{by}{key}={value}"))
            }
        }
    }
}

/// `HOST:PORT` from `HOST`, `HOST:PORT`, `IPv6` or `[IPv6]:PORT`.
fn host_and_port(address: &str) -> Result<String, String> {
    if let Ok(address) = ip_and_port(address) {
        return Ok(address.to_string());
    }
    let (host, port) = match address.rsplit_once(':') {
        Some((host, port)) => (host, port.parse().ok()),
        None => (address, Some(DEFAULT_PORT)),
    };
    let is_name = !host.is_empty() && host.chars().all(|c| c.is_ascii_alphanumeric() || "-._".contains(c));
    match port {
        Some(port) if is_name && port != 0 => Ok(format!("{host}:{port}")),
        _ => Err(format!("'{}' is no HOST:PORT, as in connect=192.168.1.20:9876", one_line(address))),
    }
}

/// A socket address from `IP`, `IP:PORT` or `[IPv6]:PORT`.
fn ip_and_port(address: &str) -> Result<SocketAddr, String> {
    let with_port = || address.parse::<IpAddr>().map(|ip| SocketAddr::new(ip, DEFAULT_PORT));
    match address.parse().or_else(|_| with_port()) {
        Ok(address) if SocketAddr::port(&address) != 0 => Ok(address),
        _ => Err(format!(
            "'{}' is no IP:PORT; serve alone is 127.0.0.1:9876, serve=0.0.0.0:9876 is for all",
            one_line(address)
        )),
    }
}

/// `FILE.rrd` or `FILE.rrd?mib=N&minutes=N&files=N`.
fn recording(text: &str) -> Result<RerunTarget, String> {
    // A file may be called with a question mark, as long as nothing like a setting follows.
    let (file, settings) = match text.rsplit_once(".rrd?") {
        Some((stem, settings)) => (format!("{stem}.rrd"), settings),
        None => (text.to_owned(), ""),
    };
    let mut rotation = Rotation::default();
    for setting in settings.split('&').filter(|setting| !setting.is_empty()) {
        let (key, value) = setting.split_once('=').unwrap_or((setting, ""));
        let place = match key {
            "mib" => &mut rotation.mib,
            "minutes" => &mut rotation.minutes,
            "files" => &mut rotation.files,
            _ => return Err(format!("there is no setting '{}'; {ROTATION}", one_line(key))),
        };
        let wrong = |_| format!("'{}' is no number from 1 on; {ROTATION}", one_line(setting));
        *place = Some(value.parse().map_err(wrong)?);
    }
    if rotation.files.is_some() && !rotation.happens() {
        return Err("files=N needs mib=N or minutes=N, or there is only one".to_owned());
    }
    Ok(RerunTarget::Save(rrd_file(&file)?, rotation))
}

fn rrd_file(file: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(file);
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("rrd")) {
        Ok(path)
    } else {
        Err("the file must end in .rrd, or the viewer does not know it; as in save=run.rrd".to_owned())
    }
}

/// `text` without line breaks and other control characters.
pub(super) fn one_line(text: &str) -> String {
    text.split(|c: char| c.is_control() || c.is_whitespace())
        .filter(|word| !word.is_empty())
        .collect::<Vec<_>>()
        .join(" ")
}

#[cfg(test)]
mod tests {
    use std::num::NonZero;

    use super::*;
    use proptest::prelude::*;

    fn parsed(text: &str) -> RerunTarget {
        text.parse().unwrap()
    }

    fn refusal(text: &str) -> String {
        let message = text.parse::<RerunTarget>().unwrap_err().to_string();
        assert!(!message.contains('\n'), "{message}");
        message
    }

    #[test]
    fn every_form_is_understood() {
        let connect = |address: &str| RerunTarget::Connect(address.to_owned());
        let serve = |address: &str| RerunTarget::Serve(address.parse().unwrap());
        assert_eq!(parsed("off"), RerunTarget::Off);
        assert_eq!(parsed("spawn"), RerunTarget::Spawn);
        assert_eq!(parsed("connect"), connect("127.0.0.1:9876"));
        assert_eq!(parsed("connect=laptop.local"), connect("laptop.local:9876"));
        assert_eq!(parsed("connect=10.0.0.7:9000"), connect("10.0.0.7:9000"));
        assert_eq!(parsed("connect=::1"), connect("[::1]:9876"));
        assert_eq!(parsed("connect=[::1]:9000"), connect("[::1]:9000"));
        assert_eq!(parsed("serve"), serve("127.0.0.1:9876"));
        assert_eq!(parsed("serve=0.0.0.0"), serve("0.0.0.0:9876"));
        assert_eq!(parsed("serve=127.0.0.1:9000"), serve("127.0.0.1:9000"));
        let save = |file: &str, rotation| RerunTarget::Save(file.into(), rotation);
        assert_eq!(parsed("save=a=b/run.rrd"), save("a=b/run.rrd", Rotation::default()));
        let [mib, minutes, files] = [500, 60, 24].map(NonZero::new);
        assert_eq!(
            parsed("save=why?/run.rrd?mib=500&files=24&minutes=60"),
            save("why?/run.rrd", Rotation { mib, minutes, files })
        );
    }

    #[test]
    fn a_target_is_written_as_it_is_read() {
        for text in [
            "off",
            "spawn",
            "connect=laptop:9876",
            "serve=127.0.0.1:9876",
            "save=run.rrd",
            "save=run.rrd?minutes=60&files=2",
        ] {
            assert_eq!(parsed(text).to_string(), text);
        }
    }

    #[test]
    fn targets_that_write_the_same_or_show_each_other_clash() {
        for (one, other) in [
            ("spawn", "spawn"),
            ("save=a.rrd", "save=./a.rrd"),
            ("save=a.rrd?mib=5", "save=a.rrd?mib=6"),
            ("serve", "spawn"),
            ("connect", "serve"),
        ] {
            assert!(
                parsed(one).clashes_with(&parsed(other)) && parsed(other).clashes_with(&parsed(one)),
                "{one}"
            );
        }
        for (one, other) in
            [("save=a.rrd", "save=b.rrd"), ("serve=0.0.0.0:9000", "spawn"), ("spawn", "save=a.rrd")]
        {
            assert!(!parsed(one).clashes_with(&parsed(other)), "{one} {other}");
        }
    }

    #[test]
    fn what_is_not_understood_is_named_with_what_would_be() {
        for text in ["", "on", "conect=laptop", "Spawn", "SAVE=x.rrd"] {
            let message = refusal(text);
            assert!(message.starts_with(&format!("rerun '{text}': use off, spawn, connect")), "{message}");
        }
        assert!(refusal("spawn=1").contains("takes no value"));
        assert!(refusal("save").contains("save=run.rrd"));
        assert!(refusal("save=").contains(".rrd"));
        assert!(refusal("save=run.mcap").contains(".rrd"));
        assert!(refusal("save=run.rrd?mb=5").contains("there is no setting 'mb'; a new file begins"));
        for value in ["0", "", "-1", "1.5", "99999999999"] {
            assert!(
                refusal(&format!("save=run.rrd?mib={value}")).contains("is no number from 1 on"),
                "{value}"
            );
        }
        assert!(refusal("save=run.rrd?files=3").contains("needs mib=N or minutes=N"));
        for text in [
            "connect=",
            "connect=:9876",
            "connect=a b",
            "connect=http://x:1",
            "connect=x:99999",
            "connect=x:0",
        ] {
            assert!(refusal(text).contains("is no HOST:PORT"), "{text}");
        }
        for text in ["serve=", "serve=robot:9876", "serve=127.0.0.1:0", "serve=9876"] {
            assert!(refusal(text).contains("is no IP:PORT"), "{text}");
        }
    }

    proptest! {
        #[test]
        fn whatever_is_given_never_panics_and_is_refused_in_one_line(
            text in "(off|spawn|connect|serve|save)?=?\\PC{0,12}\n?",
        ) {
            if let Err(error) = text.parse::<RerunTarget>() {
                prop_assert!(!error.to_string().contains('\n'));
            }
        }
    }
}
