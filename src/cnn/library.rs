//! Is this file an ONNX Runtime of a version we can use? Answered by reading it, before any of it runs.
//!
//! Loading a library runs its code, and loading a truncated one kills the process, so the file is read
//! first: ELF header (kind, CPU), section table (nothing lies beyond the end of the file), and symbol
//! version definitions, where ONNX Runtime's linker script leaves its version as `VERS_1.32.0`. Formats:
//! System V ABI, chapters 4 and 5; Linux Standard Base 5.0, "Symbol Versioning".

use std::fmt;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use thiserror::Error;

/// Version of an ONNX Runtime.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RuntimeVersion {
    /// First number.
    pub major: u32,
    /// Second number: the programming interface, which newer libraries keep.
    pub minor: u32,
    /// Third number.
    pub patch: u32,
}

/// The oldest ONNX Runtime whose programming interface has all that we call.
pub const OLDEST_RUNTIME: RuntimeVersion = RuntimeVersion { major: 1, minor: 17, patch: 0 };

impl RuntimeVersion {
    /// `1.32.0` from `1.32.0`, `1.32`, or `1.32.0-rc1`; `None` if it does not begin with two numbers.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let mut parts = text.split('.').map(|part| {
            let digits = part.bytes().take_while(u8::is_ascii_digit).count();
            part[..digits].parse::<u32>().ok()
        });
        let (major, minor) = (parts.next()??, parts.next()??);
        Some(Self { major, minor, patch: parts.next().flatten().unwrap_or(0) })
    }
}

impl fmt::Display for RuntimeVersion {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}.{}.{}", self.major, self.minor, self.patch)
    }
}

/// Why a file cannot serve as ONNX Runtime.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum LibraryFault {
    /// Nothing has that path.
    #[error("no such file or folder")]
    Missing,
    /// The folder holds no file of a name that ONNX Runtime bears.
    #[error("this folder holds no libonnxruntime.so")]
    EmptyFolder,
    /// A pipe, a device, or the like.
    #[error("not a regular file")]
    NotAFile,
    /// The system does not let us read it.
    #[error("cannot be read: {0}")]
    Unreadable(String),
    /// Something else than a shared library of this kind of computer.
    #[error("not a 64-bit ELF shared library")]
    NotALibrary,
    /// A library for another CPU.
    #[error("built for another CPU (ELF machine {got}, this computer is {expected})")]
    OtherCpu {
        /// ELF machine number of this computer: 62 is x86-64, 183 aarch64.
        expected: u16,
        /// ELF machine number of the library.
        got: u16,
    },
    /// Its tables point beyond its end: the copy or the download broke off.
    #[error("truncated or damaged; fetch it again")]
    Truncated,
    /// A sound library, but it does not say that it is ONNX Runtime.
    #[error("not an ONNX Runtime library (it defines no symbol version VERS_x.y.z)")]
    NotOnnxRuntime,
    /// An ONNX Runtime from before [`OLDEST_RUNTIME`], or of another generation.
    #[error("is ONNX Runtime {0}; need {OLDEST_RUNTIME} or newer, below 2")]
    UnsupportedVersion(RuntimeVersion),
}

const HEADER_BYTES: usize = 64;
const SECTION_BYTES: usize = 64;
const SHARED_LIBRARY: u16 = 3;
const NO_BITS: u32 = 8;
const VERSION_DEFINITIONS: u32 = 0x6fff_fffd;
/// Far above what a real library has (32 sections, tables of 14 kB).
const MOST_SECTIONS: u64 = 4096;
const LARGEST_TABLE_BYTES: u64 = 1 << 24;

/// This computer's ELF machine number, where we know it.
const THIS_MACHINE: Option<u16> = if cfg!(target_arch = "x86_64") {
    Some(62)
} else if cfg!(target_arch = "aarch64") {
    Some(183)
} else {
    None
};

/// Reads the version of an ONNX Runtime library, or says why the file cannot serve as one.
pub(super) fn inspect(path: &Path) -> Result<RuntimeVersion, LibraryFault> {
    let metadata = std::fs::metadata(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => LibraryFault::Missing,
        _ => LibraryFault::Unreadable(error.to_string()),
    })?;
    // Asked before opening: to open a pipe waits for a writer.
    if !metadata.is_file() {
        return Err(LibraryFault::NotAFile);
    }
    let file = File::open(path).map_err(|error| LibraryFault::Unreadable(error.to_string()))?;
    let mut elf = Elf { file, length: metadata.len() };
    let sections = elf.sections()?;
    let version = elf.version(&sections)?;
    if version < OLDEST_RUNTIME || version.major != OLDEST_RUNTIME.major {
        return Err(LibraryFault::UnsupportedVersion(version));
    }
    Ok(version)
}

/// One line of the section table, as far as it matters here.
struct Section {
    kind: u32,
    offset: u64,
    length: u64,
    /// Index of the section that holds this one's names.
    names: u32,
}

struct Elf {
    file: File,
    length: u64,
}

impl Elf {
    /// The section table, after checking that file and CPU are right and that every section lies in the file.
    fn sections(&mut self) -> Result<Vec<Section>, LibraryFault> {
        let header = self.read(0, HEADER_BYTES as u64).map_err(|fault| match fault {
            LibraryFault::Truncated => LibraryFault::NotALibrary,
            other => other,
        })?;
        let little_endian_64_bit = header.starts_with(b"\x7fELF\x02\x01");
        if !little_endian_64_bit || u16_at(&header, 16) != Some(SHARED_LIBRARY) {
            return Err(LibraryFault::NotALibrary);
        }
        let got = u16_at(&header, 18).ok_or(LibraryFault::Truncated)?;
        if let Some(expected) = THIS_MACHINE.filter(|&expected| expected != got) {
            return Err(LibraryFault::OtherCpu { expected, got });
        }
        let offset = u64_at(&header, 40).ok_or(LibraryFault::Truncated)?;
        let count = u64::from(u16_at(&header, 60).ok_or(LibraryFault::Truncated)?);
        if usize::from(u16_at(&header, 58).unwrap_or(0)) != SECTION_BYTES || count > MOST_SECTIONS {
            return Err(LibraryFault::NotOnnxRuntime);
        }
        let table = self.read(offset, count * SECTION_BYTES as u64)?;
        table
            .chunks_exact(SECTION_BYTES)
            .map(|row| self.section(row).ok_or(LibraryFault::Truncated))
            .collect()
    }

    fn section(&self, row: &[u8]) -> Option<Section> {
        let section = Section {
            kind: u32_at(row, 4)?,
            offset: u64_at(row, 24)?,
            length: u64_at(row, 32)?,
            names: u32_at(row, 40)?,
        };
        let inside = section.offset.checked_add(section.length).is_some_and(|end| end <= self.length);
        (inside || section.kind == NO_BITS).then_some(section)
    }

    /// The `VERS_x.y.z` among the versions that the library defines (not those it needs of others).
    fn version(&mut self, sections: &[Section]) -> Result<RuntimeVersion, LibraryFault> {
        let definitions = sections
            .iter()
            .find(|section| section.kind == VERSION_DEFINITIONS)
            .ok_or(LibraryFault::NotOnnxRuntime)?;
        let names = sections.get(definitions.names as usize).ok_or(LibraryFault::Truncated)?;
        let names = self.read(names.offset, names.length)?;
        let definitions = self.read(definitions.offset, definitions.length)?;
        let mut rest = definitions.as_slice();
        loop {
            let name = defined_name(rest, &names).ok_or(LibraryFault::Truncated)?;
            if let Some(version) = name.strip_prefix("VERS_").and_then(RuntimeVersion::parse) {
                return Ok(version);
            }
            match u32_at(rest, 16).ok_or(LibraryFault::Truncated)? {
                0 => return Err(LibraryFault::NotOnnxRuntime),
                next => rest = rest.get(next as usize..).ok_or(LibraryFault::Truncated)?,
            }
        }
    }

    fn read(&mut self, offset: u64, length: u64) -> Result<Vec<u8>, LibraryFault> {
        let inside = offset.checked_add(length).is_some_and(|end| end <= self.length);
        if !inside || length > LARGEST_TABLE_BYTES {
            return Err(LibraryFault::Truncated);
        }
        let mut bytes = vec![0; length as usize];
        let read = self.file.seek(SeekFrom::Start(offset)).and_then(|_| self.file.read_exact(&mut bytes));
        read.map_err(|error| match error.kind() {
            std::io::ErrorKind::UnexpectedEof => LibraryFault::Truncated,
            _ => LibraryFault::Unreadable(error.to_string()),
        })?;
        Ok(bytes)
    }
}

/// The name of the version definition at the beginning of `definitions`, through its first auxiliary entry.
fn defined_name<'names>(definitions: &[u8], names: &'names [u8]) -> Option<&'names str> {
    let entry = u32_at(definitions, 12)? as usize;
    let name = names.get(u32_at(definitions, entry)? as usize..)?;
    let end = name.iter().position(|&byte| byte == 0)?;
    std::str::from_utf8(&name[..end]).ok()
}

fn bytes_at<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes_at(bytes, at).map(u16::from_le_bytes)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes_at(bytes, at).map(u32::from_le_bytes)
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    bytes_at(bytes, at).map(u64::from_le_bytes)
}

#[cfg(test)]
pub(super) mod tests {
    use proptest::prelude::*;
    use tempfile::TempDir;

    use super::*;

    /// The smallest library that says it is ONNX Runtime `version`: header, two tables, three section rows.
    pub(in crate::cnn) fn fake_library(version: &str) -> Vec<u8> {
        let names = [b"\0libonnxruntime.so.1\0VERS_".as_slice(), version.as_bytes(), b"\0"].concat();
        let definition = |name: u32, next: u32| {
            let head = [1_u16, 1, 1, 1].iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>();
            let tail =
                [0_u32, 20, next, name, 0].iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>();
            [head, tail].concat()
        };
        let definitions = [definition(1, 28), definition(21, 0)].concat();
        let section = |kind: u32, offset: usize, length: usize, names: u32| {
            let mut row = vec![0; SECTION_BYTES];
            row[4..8].copy_from_slice(&kind.to_le_bytes());
            row[24..32].copy_from_slice(&(offset as u64).to_le_bytes());
            row[32..40].copy_from_slice(&(length as u64).to_le_bytes());
            row[40..44].copy_from_slice(&names.to_le_bytes());
            row
        };
        let names_at = HEADER_BYTES + definitions.len();
        let mut header = b"\x7fELF\x02\x01\x01".to_vec();
        header.resize(HEADER_BYTES, 0);
        header[16..18].copy_from_slice(&SHARED_LIBRARY.to_le_bytes());
        header[18..20].copy_from_slice(&THIS_MACHINE.unwrap_or(0).to_le_bytes());
        header[40..48].copy_from_slice(&((names_at + names.len()) as u64).to_le_bytes());
        header[58..60].copy_from_slice(&(SECTION_BYTES as u16).to_le_bytes());
        header[60..62].copy_from_slice(&3_u16.to_le_bytes());
        let rows = [
            section(0, 0, 0, 0),
            section(3, names_at, names.len(), 0),
            section(VERSION_DEFINITIONS, HEADER_BYTES, definitions.len(), 1),
        ];
        [header, definitions, names, rows.concat()].concat()
    }

    fn inspect_bytes(bytes: &[u8]) -> Result<RuntimeVersion, LibraryFault> {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("libonnxruntime.so");
        std::fs::write(&path, bytes).unwrap();
        inspect(&path)
    }

    #[test]
    fn the_version_is_read_from_the_symbol_versions() {
        let version = RuntimeVersion { major: 1, minor: 32, patch: 4 };
        assert_eq!(inspect_bytes(&fake_library("1.32.4")), Ok(version));
    }

    #[test]
    fn versions_before_1_17_and_from_2_on_are_refused_by_number() {
        for version in ["1.16.3", "1.9.0", "0.20.0", "2.17.0"] {
            let fault = inspect_bytes(&fake_library(version)).unwrap_err();
            assert!(fault.to_string().contains(version), "{fault}");
        }
        assert!(inspect_bytes(&fake_library("1.17.0")).is_ok());
    }

    #[test]
    fn a_library_for_another_cpu_is_refused() {
        let mut library = fake_library("1.32.0");
        library[18..20].copy_from_slice(&243_u16.to_le_bytes());
        assert!(matches!(inspect_bytes(&library), Err(LibraryFault::OtherCpu { got: 243, .. })));
    }

    #[test]
    fn a_library_cut_off_anywhere_is_refused() {
        let library = fake_library("1.32.0");
        for length in 0..library.len() {
            let fault = inspect_bytes(&library[..length]).unwrap_err();
            let expected =
                if length < HEADER_BYTES { LibraryFault::NotALibrary } else { LibraryFault::Truncated };
            assert_eq!(fault, expected, "at {length}");
        }
    }

    #[test]
    fn a_library_with_a_section_beyond_its_end_is_refused() {
        let mut library = fake_library("1.32.0");
        let past_the_end = (library.len() as u64).to_le_bytes();
        let first_row = library.len() - 3 * SECTION_BYTES;
        library[first_row + 4] = 1;
        library[first_row + 24..first_row + 32].copy_from_slice(&past_the_end);
        assert!(inspect_bytes(&library).is_ok(), "an empty section may lie at the end");
        library[first_row + 32] = 1;
        assert_eq!(inspect_bytes(&library), Err(LibraryFault::Truncated));
    }

    #[test]
    fn text_is_not_a_library() {
        assert_eq!(inspect_bytes(b"not a library\n"), Err(LibraryFault::NotALibrary));
        assert_eq!(inspect_bytes(&[b'#'; 5000]), Err(LibraryFault::NotALibrary));
    }

    #[test]
    fn a_library_that_only_needs_onnx_runtime_is_not_onnx_runtime() {
        let mut library = fake_library("1.32.0");
        let needed_versions = 0x6fff_fffe_u32.to_le_bytes();
        let kind_at = library.len() - SECTION_BYTES + 4;
        library[kind_at..kind_at + 4].copy_from_slice(&needed_versions);
        assert_eq!(inspect_bytes(&library), Err(LibraryFault::NotOnnxRuntime));
    }

    proptest! {
        #[test]
        fn damaged_libraries_never_panic(at in 0_usize..400, byte in any::<u8>()) {
            let mut library = fake_library("1.32.0");
            let at = at % library.len();
            library[at] = byte;
            let _ = inspect_bytes(&library);
        }
    }
}
