//! The program under test, and what its runs leave behind.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};

use serde_json::Value;

/// What a finished run left: exit code, output and error text.
pub(crate) struct Finished {
    pub(crate) code: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Finished {
    /// The JSON object of every line on stdout.
    pub(crate) fn records(&self) -> Vec<Value> {
        self.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    /// The decision of every record.
    pub(crate) fn decisions(&self) -> Vec<String> {
        self.records().iter().map(|record| record["decision"].as_str().unwrap().to_owned()).collect()
    }

    /// Asserts that the program failed with `code` and one line that contains all of `parts`.
    pub(crate) fn assert_failed(&self, code: i32, parts: &[&str]) {
        assert_eq!(self.code, code, "{}", self.stderr);
        let errors: Vec<&str> = self.stderr.lines().collect();
        assert_eq!(errors.len(), 1, "not one line: {}", self.stderr);
        assert!(self.stderr.starts_with("loci: "), "{}", self.stderr);
        let mut said: Vec<&str> = self.stderr.trim_end().split(": ").collect();
        said.sort_unstable();
        assert!(said.windows(2).all(|pair| pair[0] != pair[1]), "said twice: {}", self.stderr);
        for part in parts {
            assert!(self.stderr.contains(part), "no '{part}' in: {}", self.stderr);
        }
    }
}

/// Runs `loci` in the project's folder.
pub(crate) fn loci<A: AsRef<OsStr>>(arguments: &[A]) -> Finished {
    finished(Command::new(env!("CARGO_BIN_EXE_loci")).args(arguments))
}

/// Runs `loci` with `LOCI_VOCAB` set.
pub(crate) fn loci_with_vocabulary_variable<A: AsRef<OsStr>>(vocabulary: &Path, arguments: &[A]) -> Finished {
    finished(Command::new(env!("CARGO_BIN_EXE_loci")).args(arguments).env("LOCI_VOCAB", vocabulary))
}

/// Runs `loci` where no ONNX Runtime can be found.
pub(crate) fn loci_without_runtime<A: AsRef<OsStr>>(arguments: &[A]) -> Finished {
    let nowhere = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_loci"));
    command.args(arguments).env("HOME", nowhere.path()).env("XDG_CACHE_HOME", nowhere.path());
    for variable in ["ORT_DYLIB_PATH", "LD_LIBRARY_PATH", "VIRTUAL_ENV", "CONDA_PREFIX"] {
        command.env_remove(variable);
    }
    finished(&mut command)
}

/// Runs `command` to its end.
pub(crate) fn finished(command: &mut Command) -> Finished {
    // Suites start from LOCI_DATA where it is set; those of tests stand beside their data.
    let output = command.env("RUST_BACKTRACE", "0").env_remove("LOCI_DATA").output().unwrap();
    Finished {
        code: output.status.code().expect("ended by a signal"),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

/// Sends `process` a signal, such as `INT`.
pub(crate) fn send(signal: &str, process: &Child) {
    let process = process.id().to_string();
    assert!(Command::new("kill").args(["-s", signal, &process]).status().unwrap().success());
}

/// `path` as an argument.
pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The folder of real sequences.
pub(crate) fn real_data() -> PathBuf {
    let folder = std::env::var_os("LOCI_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
    assert!(folder.is_dir(), "no real sequences in {}: set LOCI_DATA", folder.display());
    folder
}
