//! ONNX Runtime, found, checked and loaded.

use std::path::{Path, PathBuf};

use super::engine;
use super::error::CnnError;
use super::library::RuntimeVersion;
use super::search::{FoundLibrary, Surroundings, find_runtime};

/// A loaded ONNX Runtime. Clones share it; it stays loaded until the process ends.
#[derive(Clone, Debug)]
pub struct OnnxRuntime {
    path: PathBuf,
    version: RuntimeVersion,
    pub(super) library: engine::Library,
}

impl OnnxRuntime {
    /// Finds and loads ONNX Runtime; `named` is the path the user gave, a file or a folder ([`find_runtime`]).
    ///
    /// # Errors
    /// [`CnnError::NotBuilt`] in a build without the feature `cnn`, else those of [`find_runtime`] and
    /// [`Self::load`].
    pub fn open(named: Option<&Path>) -> Result<Self, CnnError> {
        engine::built()?;
        Self::load(find_runtime(named, &Surroundings::of_this_process())?)
    }

    /// Loads a library that was found. Loading the same file again gives the same runtime.
    ///
    /// # Errors
    /// [`CnnError::RuntimeStart`] if the dynamic linker or the library refuses,
    /// [`CnnError::AnotherRuntimeLoaded`] if this process holds another one.
    pub fn load(found: FoundLibrary) -> Result<Self, CnnError> {
        let library = engine::load(&found.path)?;
        Ok(Self { path: found.path, version: found.version, library })
    }

    /// The library's file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The library's version.
    #[must_use]
    pub fn version(&self) -> RuntimeVersion {
        self.version
    }
}

#[cfg(all(test, feature = "cnn"))]
mod tests {
    use tempfile::TempDir;

    use super::super::library::tests::fake_library;
    use super::*;

    fn error_of(path: &Path) -> String {
        let text = OnnxRuntime::open(Some(path)).unwrap_err().to_string();
        assert!(text.contains(path.to_str().unwrap()), "{text}");
        assert!(!text.contains('\n'), "{text}");
        text
    }

    #[test]
    fn each_bad_library_gives_one_line_with_its_path() {
        let folder = TempDir::new().unwrap();
        let folder = folder.path().canonicalize().unwrap();
        let file = |name: &str, bytes: &[u8]| {
            std::fs::write(folder.join(name), bytes).unwrap();
            folder.join(name)
        };
        assert!(error_of(&folder.join("missing.so")).contains("no such file"));
        assert!(error_of(&folder).contains("holds no libonnxruntime.so"));
        assert!(error_of(&file("text.so", b"#!/bin/sh\n")).contains("not a 64-bit ELF"));
        assert!(error_of(&file("empty.so", b"")).contains("not a 64-bit ELF"));
        assert!(error_of(&file("old.so", &fake_library("1.16.3"))).contains("1.16.3"));
        assert!(error_of(Path::new("/dev/null")).contains("not a regular file"));
    }

    /// What passes our checks and is no library all the same is refused by the dynamic linker, more than once.
    #[test]
    fn a_library_that_the_linker_refuses_gives_one_line_and_can_be_tried_again() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().canonicalize().unwrap().join("hollow.so");
        std::fs::write(&path, fake_library("1.32.0")).unwrap();
        for _ in 0..2 {
            let error = OnnxRuntime::open(Some(&path)).unwrap_err();
            let expected =
                matches!(error, CnnError::RuntimeStart { .. } | CnnError::AnotherRuntimeLoaded { .. });
            assert!(expected && !error.to_string().contains('\n'), "{error}");
        }
    }

    #[test]
    #[cfg(unix)]
    fn a_named_pipe_does_not_block() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("libonnxruntime.so");
        let made =
            std::process::Command::new("mkfifo").arg(&path).status().is_ok_and(|status| status.success());
        assert!(made, "mkfifo (coreutils) is missing");
        // A thread of its own, so that a search that does block fails this test and does not hold it up.
        let (sender, answer) = std::sync::mpsc::channel();
        std::thread::spawn(move || sender.send(error_of(&path)));
        let text =
            answer.recv_timeout(std::time::Duration::from_secs(20)).expect("an answer without a writer");
        assert!(text.contains("not a regular file"), "{text}");
    }
}

#[cfg(all(test, not(feature = "cnn")))]
mod tests {
    use super::*;

    #[test]
    fn a_build_without_cnn_says_so() {
        let error = OnnxRuntime::open(None).unwrap_err();
        assert_eq!(error.to_string(), "this build has no CNN; build with `--features cnn`");
    }
}
