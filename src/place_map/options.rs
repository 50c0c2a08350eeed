//! How safe a map is to be against power cuts, and how large it may grow.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::Deserialize;

/// Smallest and largest segment of the journal in bytes.
const SEGMENT_BYTES: (u64, u64) = (64 << 10, 64 << 20);
/// Segments that the disk's budget is parted into, where that gives one of a sensible size.
const SEGMENTS: u64 = 32;
/// Segments that a larger budget is parted into: each keeps a file open.
const MOST_SEGMENTS: u64 = 200;
/// The same of a map that is larger than its budget, or has none, or is written again. The segments grow along with it,
/// so in the end there are more.
const GROWING_SEGMENTS: u64 = 100;
/// No offset may need more than 40 bits.
const LONGEST_SEGMENT_BYTES: u64 = 1 << 39;

/// When what was learnt is brought onto the medium.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum Durability {
    /// Before the answer is given: a power cut costs nothing that was answered.
    Every,
    /// So long after it was learnt at the latest: a power cut costs what was learnt within that time.
    Interval(Duration),
    /// When the operating system likes: a power cut costs what it had not written, often half a minute.
    None,
}

impl Default for Durability {
    fn default() -> Self {
        Self::Interval(Duration::from_millis(200))
    }
}

impl fmt::Display for Durability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Every => f.write_str("every"),
            Self::Interval(interval) => write!(f, "interval={}ms", interval.as_millis()),
            Self::None => f.write_str("none"),
        }
    }
}

impl FromStr for Durability {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("expected every, interval=200ms or none, got {text}");
        match text {
            "every" => Ok(Self::Every),
            "none" => Ok(Self::None),
            _ => {
                let interval = text.strip_prefix("interval=").ok_or_else(wrong)?;
                let (number, millis) = match interval.strip_suffix("ms") {
                    Some(number) => (number, 1),
                    None => (interval.strip_suffix('s').ok_or_else(wrong)?, 1000),
                };
                let number: u64 = number.parse().map_err(|_| wrong())?;
                let millis = number.checked_mul(millis).filter(|millis| (1..=3_600_000).contains(millis));
                Ok(Self::Interval(Duration::from_millis(millis.ok_or_else(wrong)?)))
            }
        }
    }
}

impl TryFrom<String> for Durability {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

/// Settings of a map that is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapOptions {
    /// When what was learnt is brought onto the medium; default every 200 ms.
    pub durability: Durability,
    /// Most bytes of the map's folder; default 4 GiB.
    pub disk_bytes: u64,
    /// Most experiences a place; default 100.
    pub place_experiences: usize,
}

impl Default for MapOptions {
    fn default() -> Self {
        Self { durability: Durability::default(), disk_bytes: 4 << 30, place_experiences: 100 }
    }
}

impl MapOptions {
    /// A map that keeps every experience: for evaluations, which end.
    #[must_use]
    pub fn unbounded() -> Self {
        Self { disk_bytes: u64::MAX, place_experiences: usize::MAX, ..Self::default() }
    }

    /// Bytes after which a journal that takes `journal_bytes` by now goes on in a new segment.
    pub(super) fn segment_bytes(&self, journal_bytes: u64) -> u64 {
        let usual = (self.disk_bytes / SEGMENTS).clamp(SEGMENT_BYTES.0, SEGMENT_BYTES.1);
        let share = if self.disk_bytes == u64::MAX { 0 } else { self.disk_bytes / MOST_SEGMENTS };
        usual.max(share).max(journal_bytes / GROWING_SEGMENTS).min(LONGEST_SEGMENT_BYTES)
    }

    /// The same while what counts is written again: the next budget may have room to empty no longer ones.
    pub(super) fn rewritten_segment_bytes(&self, journal_bytes: u64) -> u64 {
        let most = (journal_bytes / GROWING_SEGMENTS).max(SEGMENT_BYTES.0);
        self.segment_bytes(journal_bytes).min(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_durability_reads_back_as_it_is_written() {
        for text in ["every", "none", "interval=200ms", "interval=1ms", "interval=3600000ms"] {
            assert_eq!(text.parse::<Durability>().unwrap().to_string(), text);
        }
        assert_eq!("interval=2s".parse(), Ok(Durability::Interval(Duration::from_secs(2))));
        for wrong in [
            "",
            "always",
            "interval",
            "interval=",
            "interval=0ms",
            "interval=-1s",
            "interval=2h",
            "interval=4000s",
        ] {
            assert!(wrong.parse::<Durability>().unwrap_err().ends_with(&format!("got {wrong}")));
        }
    }

    #[test]
    fn a_map_of_any_budget_has_few_enough_segments_to_keep_them_open() {
        let segments = |options: MapOptions, bytes: u64| {
            let (mut count, mut total) = (0, 0);
            while total < bytes {
                total += options.segment_bytes(total);
                count += 1;
            }
            count
        };
        for gib in [1, 4, 12, 13, 100, 1000, 10_000] {
            let disk_bytes = gib << 30;
            let count = segments(MapOptions { disk_bytes, ..MapOptions::default() }, disk_bytes);
            assert!(count <= 200, "{count} segments of {gib} GiB");
            // One that outgrew its budget, and one without any.
            for options in [MapOptions::default(), MapOptions::unbounded()] {
                let count = segments(options, 100 << 30);
                assert!(count <= 400, "{count} segments of 100 GiB");
            }
        }
        assert_eq!(MapOptions::default().segment_bytes(4 << 30), 64 << 20);
        assert!(MapOptions::unbounded().segment_bytes(u64::MAX) < 1 << 40);
    }
}
