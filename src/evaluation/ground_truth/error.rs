//! Why a ground truth cannot be used, and which of its rows are to blame.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// Most rows that an error lists one by one.
const MAX_LISTED: usize = 8;

/// Why a ground truth cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GroundTruthError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The file is not of a kind that is understood.
    #[error("{}: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// Some rows are wrong or fit no frame.
    #[error("{}, {rows}: {reason}", path.display())]
    Rows {
        /// The file.
        path: PathBuf,
        /// Which rows.
        rows: Rows,
        /// What is wrong with them, and what to do.
        reason: String,
    },
    /// The ground truth and the frames do not fit each other.
    #[error("ground truth: {0}")]
    Mismatch(String),
}

impl GroundTruthError {
    pub(in crate::evaluation) fn read(path: &Path, source: io::Error) -> Self {
        Self::Read { path: path.to_owned(), source }
    }

    pub(in crate::evaluation) fn malformed(path: &Path, reason: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), reason: reason.into() }
    }

    pub(in crate::evaluation) fn rows(
        path: &Path,
        rows: impl IntoIterator<Item = u64>,
        reason: impl Into<String>,
    ) -> Self {
        Self::Rows { path: path.to_owned(), rows: Rows(rows.into_iter().collect()), reason: reason.into() }
    }
}

/// Rows of a file as an editor numbers its lines, from 1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rows(pub Vec<u64>);

impl fmt::Display for Rows {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let listed: Vec<String> = self.0.iter().take(MAX_LISTED).map(u64::to_string).collect();
        write!(formatter, "{} {}", if self.0.len() == 1 { "row" } else { "rows" }, listed.join(", "))?;
        match self.0.len().saturating_sub(MAX_LISTED) {
            0 => Ok(()),
            more => write!(formatter, " and {more} more"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_lists_its_rows_but_not_without_end() {
        assert_eq!(Rows(vec![4]).to_string(), "row 4");
        assert_eq!(Rows((1..=11).collect()).to_string(), "rows 1, 2, 3, 4, 5, 6, 7, 8 and 3 more");
    }
}
