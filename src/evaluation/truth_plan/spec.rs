//! What can be asked for with `--truth`.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::evaluation::ground_truth::Tolerance;

/// How far apart two frames of one place may be, where it was named.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NamedTolerance {
    /// `lap-tolerance`, as a share of a lap.
    pub lap_share: Option<f64>,
    /// `radius`, in metres.
    pub radius_metres: Option<f64>,
    /// `place-tolerance`, in place numbers.
    pub ordinals: Option<i64>,
}

impl NamedTolerance {
    /// What was named, the rest by default.
    #[must_use]
    pub fn or_default(self) -> Tolerance {
        let defaults = Tolerance::default();
        Tolerance {
            lap_share: self.lap_share.unwrap_or(defaults.lap_share),
            radius_metres: self.radius_metres.unwrap_or(defaults.radius_metres),
            ordinals: self.ordinals.unwrap_or(defaults.ordinals),
        }
    }

    /// The options that were named.
    pub(super) fn names(self) -> impl Iterator<Item = &'static str> {
        let named = [
            self.lap_share.map(|_| "lap-tolerance"),
            self.radius_metres.map(|_| "radius"),
            self.ordinals.map(|_| "place-tolerance"),
        ];
        named.into_iter().flatten()
    }
}

/// When two frames show the same place, as asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum TruthSpec {
    /// A table with a row a frame, or a loop matrix.
    File(PathBuf),
    /// Frame numbers of aligned traverses at most so far apart.
    Frames(i64),
    /// Positions at most so many metres apart.
    Radius(f64),
    /// Places that a synthetic world numbers, at most so far apart.
    Places(i64),
    /// Frames of different folders show different places; nothing is said of those of one folder.
    Folders,
    /// The reference shows none of the query's places.
    Strangers,
}

/// A `--truth` that makes no sense.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("ground truth '{given}': {reason}; give FILE, frames=N, radius=METRES, places=N, folders or none")]
pub struct TruthSpecError {
    given: String,
    reason: &'static str,
}

impl FromStr for TruthSpec {
    type Err = TruthSpecError;

    fn from_str(text: &str) -> Result<Self, TruthSpecError> {
        let error = |reason| TruthSpecError { given: text.to_owned(), reason };
        let count = |number: &str| {
            let number: Option<i64> = number.parse().ok().filter(|number| *number >= 0);
            number.ok_or_else(|| error("not a whole number of 0 or more"))
        };
        match text.split_once('=') {
            Some(("frames", number)) => Ok(Self::Frames(count(number)?)),
            Some(("places", number)) => Ok(Self::Places(count(number)?)),
            Some(("radius", metres)) => {
                let metres: Option<f64> =
                    metres.parse().ok().filter(|metres: &f64| metres.is_finite() && *metres > 0.0);
                Ok(Self::Radius(metres.ok_or_else(|| error("not a number of metres above 0"))?))
            }
            _ if text == "folders" => Ok(Self::Folders),
            _ if text == "none" => Ok(Self::Strangers),
            _ if Path::new(text).is_file() => Ok(Self::File(text.into())),
            _ => Err(error("there is no such file")),
        }
    }
}
