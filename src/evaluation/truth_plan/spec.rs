//! What can be asked for with `--truth`.

use std::path::{Path, PathBuf};
use std::str::FromStr;

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
