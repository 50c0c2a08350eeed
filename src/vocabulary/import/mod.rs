//! Vocabularies of other libraries: ORB-SLAM's text, DBoW2's YAML, DBoW3's binary, FBoW.
//!
//! A file says itself which of them it is. Each reader answers a tree as it stands there; it becomes ours
//! with the children of a node and the words numbered as they were, so that descents and bags of words
//! come out as in the library that wrote it. No count is believed before the file was seen to hold as much.

mod dbow3;
mod fbow;
mod foreign_tree;
mod lines;
mod orb_slam;
mod yaml;

use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use flate2::read::MultiGzDecoder;

use self::foreign_tree::ForeignTree;
use super::{Vocabulary, VocabularyError};
use crate::storage::FileBytes;

/// What a compressed file begins with.
const GZIP: [u8; 2] = [0x1f, 0x8b];
/// Bytes of a text that say what it is.
const TEXT_BYTES: u64 = 64;

/// Kinds of file that are imported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VocabularyFormat {
    /// Loci's own; of an older version, too.
    Loci,
    /// ORB-SLAM's text file.
    OrbSlamText,
    /// DBoW2's YAML, plain or compressed by gzip.
    Dbow2Yaml,
    /// DBoW3's binary file.
    Dbow3,
    /// FBoW's binary file.
    Fbow,
}

impl VocabularyFormat {
    /// The name for people and records.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Loci => "Loci vocabulary",
            Self::OrbSlamText => "ORB-SLAM text vocabulary",
            Self::Dbow2Yaml => "DBoW2 YAML vocabulary",
            Self::Dbow3 => "DBoW3 binary vocabulary",
            Self::Fbow => "FBoW vocabulary",
        }
    }

    /// The format that a file begins as, compressed or not.
    pub(super) fn of(beginning: &[u8]) -> Option<Self> {
        if !beginning.starts_with(&GZIP) {
            return Self::of_plain(beginning);
        }
        let mut text = Vec::new();
        // What was cut off in the middle fails at its end: what came before is enough.
        let _ = MultiGzDecoder::new(beginning).take(TEXT_BYTES).read_to_end(&mut text);
        Self::of_plain(&text).filter(|format| matches!(format, Self::Dbow2Yaml | Self::OrbSlamText))
    }

    fn of_plain(beginning: &[u8]) -> Option<Self> {
        let begins_with = |magic: &[u8]| beginning.starts_with(magic);
        let text = beginning.trim_ascii_start();
        if begins_with(b"LOCIVOC\0") {
            Some(Self::Loci)
        } else if begins_with(&dbow3::MAGIC.to_le_bytes()) {
            Some(Self::Dbow3)
        } else if begins_with(&fbow::MAGIC.to_le_bytes()) {
            Some(Self::Fbow)
        } else if text.starts_with(b"%YAML") || text.starts_with(b"vocabulary:") {
            Some(Self::Dbow2Yaml)
        } else {
            orb_slam::begins(text).then_some(Self::OrbSlamText)
        }
    }
}

/// What is wrong in a file, and where.
#[derive(Debug)]
struct Fault {
    /// "byte 17" or "line 3".
    place: String,
    reason: String,
}

impl Fault {
    fn at_byte(offset: usize, reason: impl Into<String>) -> Self {
        Self { place: format!("byte {offset}"), reason: reason.into() }
    }

    fn at_line(line: u64, reason: impl Into<String>) -> Self {
        Self { place: format!("line {line}"), reason: reason.into() }
    }

    fn in_tree(reason: impl Into<String>) -> Self {
        Self { place: "its end".to_owned(), reason: reason.into() }
    }
}

/// Reads the vocabulary at `path`, whichever of the known kinds it is.
///
/// # Errors
/// If it cannot be read, is of no known kind, or does not hold what its kind says; the error says where.
pub fn import(path: &Path) -> Result<(VocabularyFormat, Vocabulary), VocabularyError> {
    let file = FileBytes::map(path)?;
    match VocabularyFormat::of(&file) {
        Some(VocabularyFormat::Loci) => own(file, path),
        _ => from_bytes(&file, path),
    }
}

fn own(file: FileBytes, path: &Path) -> Result<(VocabularyFormat, Vocabulary), VocabularyError> {
    let vocabulary = Vocabulary::check(file, path)?;
    vocabulary.verify(path)?;
    Ok((VocabularyFormat::Loci, vocabulary))
}

/// The vocabulary in the bytes of a file; `path` only serves messages.
///
/// # Errors
/// As [`import`].
pub fn from_bytes(file: &[u8], path: &Path) -> Result<(VocabularyFormat, Vocabulary), VocabularyError> {
    if file.starts_with(&GZIP) {
        return from_text(BufReader::new(MultiGzDecoder::new(file)), path);
    }
    let format = VocabularyFormat::of(file);
    let tree = match format {
        Some(VocabularyFormat::Loci) => return own(FileBytes::Owned(file.to_vec()), path),
        Some(VocabularyFormat::Dbow3) => dbow3::read(file),
        Some(VocabularyFormat::Fbow) => fbow::read(file),
        Some(VocabularyFormat::OrbSlamText | VocabularyFormat::Dbow2Yaml) | None => {
            return from_text(file, path);
        }
    };
    finish(format, tree, path)
}

fn from_text(mut text: impl BufRead, path: &Path) -> Result<(VocabularyFormat, Vocabulary), VocabularyError> {
    let mut beginning = Vec::new();
    let read = (&mut text).take(TEXT_BYTES).read_to_end(&mut beginning);
    let format = VocabularyFormat::of_plain(&beginning);
    let text = beginning.chain(text);
    let tree = match (read, format) {
        (Err(error), _) => Err(Fault::at_byte(0, error.to_string())),
        (_, Some(VocabularyFormat::OrbSlamText)) => orb_slam::read(text),
        (_, Some(VocabularyFormat::Dbow2Yaml)) => yaml::read(text),
        _ => return Err(VocabularyError::UnknownFormat { path: path.to_owned() }),
    };
    finish(format, tree, path)
}

fn finish(
    format: Option<VocabularyFormat>,
    tree: Result<ForeignTree, Fault>,
    path: &Path,
) -> Result<(VocabularyFormat, Vocabulary), VocabularyError> {
    let Some(format) = format else { return Err(VocabularyError::UnknownFormat { path: path.to_owned() }) };
    let file = tree.and_then(ForeignTree::into_file).map_err(|Fault { place, reason }| {
        VocabularyError::Malformed { path: path.to_owned(), format: format.as_str(), place, reason }
    })?;
    Ok((format, Vocabulary::from_bytes(file, path)?))
}

#[cfg(test)]
mod tests;
