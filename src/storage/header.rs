//! The first 32 bytes of every file of ours: what it is, which version, how long, and a checksum.
//!
//! | Offset | Bytes | Field |
//! |---|---|---|
//! | 0 | 8 | magic |
//! | 8 | 4 | version, u32 little-endian |
//! | 12 | 4 | CRC-32 of the body |
//! | 16 | 8 | length of the body in bytes, u64 little-endian |
//! | 24 | 8 | zero |

use std::path::Path;

use super::StorageError;

/// Length of the header in bytes.
pub const HEADER_BYTES: usize = 32;

/// A kind of file: its magic, the newest version that can be read, and its name for people.
#[derive(Clone, Copy, Debug)]
pub struct FileKind {
    /// The first eight bytes.
    pub magic: [u8; 8],
    /// The newest version that this program reads, and the one that it writes.
    pub version: u32,
    /// What a person calls it.
    pub name: &'static str,
}

impl FileKind {
    /// The header for `body`.
    #[must_use]
    pub fn header(&self, body: &[u8]) -> [u8; HEADER_BYTES] {
        self.header_of(&[body])
    }

    /// The header for a body of several parts.
    #[must_use]
    pub fn header_of(&self, parts: &[&[u8]]) -> [u8; HEADER_BYTES] {
        let mut checksum = crc32fast::Hasher::new();
        parts.iter().for_each(|part| checksum.update(part));
        let length_bytes: u64 = parts.iter().map(|part| part.len() as u64).sum();
        let mut header = [0; HEADER_BYTES];
        header[..8].copy_from_slice(&self.magic);
        header[8..12].copy_from_slice(&self.version.to_le_bytes());
        header[12..16].copy_from_slice(&checksum.finalize().to_le_bytes());
        header[16..24].copy_from_slice(&length_bytes.to_le_bytes());
        header
    }

    /// The version and body of `file`, whose header and length are checked; its checksum is not.
    ///
    /// # Errors
    /// If the file is of another kind, newer than this program, or has lost or gained bytes.
    pub fn body<'a>(&self, file: &'a [u8], path: &Path) -> Result<(u32, &'a [u8]), StorageError> {
        let wrong = |reason: &str| StorageError::WrongKind {
            path: path.to_owned(),
            kind: self.name,
            reason: reason.to_owned(),
        };
        if file.is_empty() {
            return Err(wrong("the file is empty"));
        }
        let Some((header, body)) = file.split_first_chunk::<HEADER_BYTES>() else {
            return Err(wrong("the file is shorter than its header"));
        };
        if header[..8] != self.magic {
            return Err(wrong("it does not begin as one"));
        }
        let version = field_u32(header, 8);
        if version > self.version {
            let (path, kind) = (path.to_owned(), self.name);
            return Err(StorageError::TooNew { path, kind, got: version, newest: self.version });
        }
        if version == 0 || header[24..] != [0; 8] {
            let reason = "its header holds what no version has".to_owned();
            return Err(StorageError::Damaged { path: path.to_owned(), reason });
        }
        let expected = u64::from(field_u32(header, 16)) | u64::from(field_u32(header, 20)) << 32;
        if body.len() as u64 != expected {
            let reason = format!("expected {expected} bytes after the header, got {}", body.len());
            return Err(StorageError::Damaged { path: path.to_owned(), reason });
        }
        Ok((version, body))
    }

    /// The checksum that the header of `file` states, 0 if there is none.
    #[must_use]
    pub fn checksum(&self, file: &[u8]) -> u32 {
        file.first_chunk::<HEADER_BYTES>().map_or(0, |header| field_u32(header, 12))
    }

    /// Checks the body of `file` against the checksum in its header.
    ///
    /// # Errors
    /// As [`body`](Self::body), and if the checksum differs.
    pub fn verify(&self, file: &[u8], path: &Path) -> Result<(), StorageError> {
        let (_, body) = self.body(file, path)?;
        let (expected, got) = (field_u32(file, 12), crc32fast::hash(body));
        if expected != got {
            let reason = format!("expected checksum {expected:08x}, got {got:08x}");
            return Err(StorageError::Damaged { path: path.to_owned(), reason });
        }
        Ok(())
    }
}

/// CRC-32 of `bytes`.
#[must_use]
pub fn checksum(bytes: &[u8]) -> u32 {
    crc32fast::hash(bytes)
}

/// The little-endian u32 at `offset`, which lies inside the header.
fn field_u32(header: &[u8], offset: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|index| header[offset + index]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const KIND: FileKind = FileKind { magic: *b"LOCITEST", version: 2, name: "test file" };

    fn file(kind: FileKind, body: &[u8]) -> Vec<u8> {
        [&kind.header(body), body].concat()
    }

    fn message(result: Result<(u32, &[u8]), StorageError>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn a_body_comes_back_with_its_version() {
        let older = FileKind { version: 1, ..KIND };
        assert_eq!(KIND.body(&file(older, b"abc"), Path::new("f")).unwrap(), (1, &b"abc"[..]));
        assert_eq!(KIND.header_of(&[b"a", b"", b"bc"]), KIND.header(b"abc"));
    }

    #[test]
    fn foreign_newer_and_cut_files_are_named_in_one_line() {
        let path = Path::new("some.file");
        let newer = FileKind { version: 3, ..KIND };
        let cut = &file(KIND, b"abc")[..HEADER_BYTES + 2];
        assert_eq!(message(KIND.body(b"", path)), "some.file is not a test file: the file is empty");
        assert!(message(KIND.body(&[7; 100], path)).contains("does not begin as one"));
        assert!(message(KIND.body(&file(newer, b""), path)).contains("update Loci"));
        assert!(message(KIND.body(cut, path)).contains("expected 3 bytes after the header, got 2"));
        for (offset, value) in [(8, 0), (24, 1), (31, 128)] {
            let mut odd = file(KIND, b"abc");
            odd[offset] = value;
            assert!(message(KIND.body(&odd, path)).contains("what no version has"));
        }
    }

    #[test]
    fn a_flipped_bit_is_found_on_verification() {
        let mut bytes = file(KIND, b"abcdef");
        assert!(KIND.verify(&bytes, Path::new("f")).is_ok());
        bytes[HEADER_BYTES + 3] ^= 4;
        assert!(KIND.verify(&bytes, Path::new("f")).unwrap_err().to_string().contains("checksum"));
    }
}
