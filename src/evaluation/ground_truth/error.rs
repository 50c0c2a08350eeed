//! Why a ground truth cannot be used, and which of its rows are to blame.
//!
//! Long lists and names from outside are cut.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// Most rows or names that an error lists one by one.
const MAX_LISTED: usize = 8;
/// Most characters of a name that an error shows.
const MAX_NAME_CHARS: usize = 60;

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
        Fault::from(reason.into()).at(path)
    }

    /// About lines of a text file, from 1.
    pub(in crate::evaluation) fn rows(
        path: &Path,
        lines: impl IntoIterator<Item = u64>,
        reason: impl Into<String>,
    ) -> Self {
        Fault::of(Rows::Lines(lines.into_iter().collect()), reason).at(path)
    }

    /// About query frames, which are the rows of a matrix or list, from 0.
    pub(in crate::evaluation) fn queries(
        path: &Path,
        frames: impl IntoIterator<Item = u64>,
        reason: impl Into<String>,
    ) -> Self {
        Fault::of(Rows::Queries(frames.into_iter().collect()), reason).at(path)
    }

    /// About entries of an array, from 0.
    pub(in crate::evaluation) fn entries(
        path: &Path,
        entries: impl IntoIterator<Item = u64>,
        reason: impl Into<String>,
    ) -> Self {
        Fault::of(Rows::Entries(entries.into_iter().collect()), reason).at(path)
    }
}

/// What is wrong with the content of a file, before it is said which file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Fault {
    rows: Option<Rows>,
    reason: String,
}

impl Fault {
    /// About some rows only.
    pub(super) fn of(rows: Rows, reason: impl Into<String>) -> Self {
        Self { rows: Some(rows), reason: reason.into() }
    }

    /// The error about the file at `path`.
    pub(super) fn at(self, path: &Path) -> GroundTruthError {
        // A reason may quote the file, line breaks and all; an error is one line.
        let reason = self.reason.split_whitespace().collect::<Vec<_>>().join(" ");
        let path = path.to_owned();
        match self.rows {
            Some(rows) => GroundTruthError::Rows { path, rows, reason },
            None => GroundTruthError::Malformed { path, reason },
        }
    }
}

impl From<String> for Fault {
    fn from(reason: String) -> Self {
        Self { rows: None, reason }
    }
}

impl From<&str> for Fault {
    fn from(reason: &str) -> Self {
        reason.to_owned().into()
    }
}

/// Rows of a ground truth, by what numbers them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Rows {
    /// Lines of a text file as an editor numbers them, from 1.
    Lines(Vec<u64>),
    /// Query frames, from 0: the rows of a matrix that has no lines.
    Queries(Vec<u64>),
    /// Entries of an array, from 0, where they need not stand in the order of the frames.
    Entries(Vec<u64>),
}

impl fmt::Display for Rows {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (one, several, counted, numbers) = match self {
            Self::Lines(numbers) => ("row", "rows", "", numbers),
            Self::Queries(numbers) => ("query frame", "query frames", " (counted from 0)", numbers),
            Self::Entries(numbers) => ("entry", "entries", " (counted from 0)", numbers),
        };
        let what = if numbers.len() == 1 { one } else { several };
        write!(formatter, "{what} {}{counted}", listed(numbers))
    }
}

/// The first few of `items` and how many more there are.
pub(super) fn listed<T: ToString>(items: &[T]) -> String {
    let first: Vec<String> = items.iter().take(MAX_LISTED).map(|item| cut(&item.to_string())).collect();
    let first = first.join(", ");
    match items.len().saturating_sub(MAX_LISTED) {
        0 => first,
        more => format!("{first} and {more} more"),
    }
}

fn cut(name: &str) -> String {
    match name.char_indices().nth(MAX_NAME_CHARS) {
        Some((end, _)) => format!("{}…", &name[..end]),
        None => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_lists_its_rows_but_not_without_end() {
        assert_eq!(Rows::Lines(vec![4]).to_string(), "row 4");
        assert_eq!(Rows::Lines((1..=11).collect()).to_string(), "rows 1, 2, 3, 4, 5, 6, 7, 8 and 3 more");
        assert_eq!(listed(&["é".repeat(100)]), format!("{}…", "é".repeat(60)));
    }

    #[test]
    fn what_has_no_lines_says_that_it_counts_from_0() {
        assert_eq!(Rows::Queries(vec![0, 1]).to_string(), "query frames 0, 1 (counted from 0)");
        assert_eq!(Rows::Entries(vec![2]).to_string(), "entry 2 (counted from 0)");
    }
}
