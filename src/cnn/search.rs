//! Where ONNX Runtime is looked for, as a function of the surroundings, which tests make up.
//!
//! Order: the path that was named (`--onnxruntime`, or else `ORT_DYLIB_PATH`), alone; otherwise beside the
//! program, `../lib` from there, loci's cache (where `make deps` puts it), the dynamic linker's folders, the
//! `onnxruntime` packages of installed Pythons. What was named must work; what was merely found and does
//! not work is passed over and remembered for the error.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};

use super::card::read_bounded;
use super::error::CnnError;
use super::library::{LibraryFault, RuntimeVersion, inspect};

const LIBRARY_NAME: &str = "libonnxruntime.so";
const VARIABLES: [&str; 6] =
    ["ORT_DYLIB_PATH", "XDG_CACHE_HOME", "HOME", "LD_LIBRARY_PATH", "VIRTUAL_ENV", "CONDA_PREFIX"];
const LARGEST_LINKER_SETTINGS_BYTES: u64 = 1 << 16;

/// What the search depends on.
#[derive(Clone, Debug, Default)]
pub struct Surroundings {
    /// Environment variables by name; only those that the search reads matter.
    pub variables: BTreeMap<String, OsString>,
    /// The running program's file.
    pub executable: Option<PathBuf>,
    /// Root of the file system: `/`, except in tests.
    pub root: PathBuf,
}

/// A library that can be loaded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundLibrary {
    /// The file, absolute and with symbolic links resolved.
    pub path: PathBuf,
    /// Its version, read from the file.
    pub version: RuntimeVersion,
}

/// A place that the search came through without success.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SearchedPlace {
    /// A folder without a library, or a library that was turned down.
    pub path: PathBuf,
    /// Why the library was turned down.
    pub fault: Option<LibraryFault>,
}

impl fmt::Display for SearchedPlace {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.path.display())?;
        self.fault.as_ref().map_or(Ok(()), |fault| write!(out, " ({fault})"))
    }
}

/// Finds the library to load, newest first within a folder; `named` is the user's `--onnxruntime`, a file or a folder.
///
/// # Errors
/// [`CnnError::UnusableLibrary`] if a path was named and does not work, [`CnnError::RuntimeNotFound`] with the
/// places searched if none was named and nothing was found.
pub fn find_runtime(named: Option<&Path>, surroundings: &Surroundings) -> Result<FoundLibrary, CnnError> {
    if let Some(path) = named.map(Path::to_path_buf).or_else(|| surroundings.path("ORT_DYLIB_PATH")) {
        return named_library(&path).map_err(|fault| CnnError::UnusableLibrary { path, fault });
    }
    let mut searched = Vec::new();
    for folder in surroundings.folders() {
        let libraries = libraries_in(&folder);
        if libraries.is_empty() {
            searched.push(SearchedPlace { path: folder, fault: None });
        }
        for path in libraries {
            match checked(&path) {
                Ok(found) => return Ok(found),
                Err(fault) => searched.push(SearchedPlace { path, fault: Some(fault) }),
            }
        }
    }
    Err(CnnError::RuntimeNotFound { searched })
}

/// The library at a path that someone named, which is a library or a folder with one in it or in its `lib`.
fn named_library(path: &Path) -> Result<FoundLibrary, LibraryFault> {
    if !path.is_dir() {
        return checked(path);
    }
    let mut libraries = libraries_in(path);
    libraries.extend(libraries_in(&path.join("lib")));
    let mut fault = LibraryFault::EmptyFolder;
    for library in libraries {
        match checked(&library) {
            Ok(found) => return Ok(found),
            Err(other) => fault = other,
        }
    }
    Err(fault)
}

fn checked(path: &Path) -> Result<FoundLibrary, LibraryFault> {
    let version = inspect(path)?;
    let path = path.canonicalize().map_err(|error| LibraryFault::Unreadable(error.to_string()))?;
    Ok(FoundLibrary { path, version })
}

/// `libonnxruntime.so`, `libonnxruntime.so.1`, then `libonnxruntime.so.1.*`, the newest first.
fn libraries_in(folder: &Path) -> Vec<PathBuf> {
    let mut libraries: Vec<_> = children(folder, LIBRARY_NAME)
        .into_iter()
        .filter_map(|path| {
            let name = path.file_name()?.to_str()?.strip_prefix(LIBRARY_NAME)?.to_owned();
            let rank = match name.strip_prefix('.') {
                None if name.is_empty() => (0, None),
                Some("1") => (1, None),
                Some(version) => (2, Some(Reverse(RuntimeVersion::parse(version)?))),
                None => return None,
            };
            Some((rank, path))
        })
        .collect();
    libraries.sort();
    libraries.into_iter().map(|(_, path)| path).collect()
}

impl Surroundings {
    /// Those of this process.
    #[must_use]
    pub fn of_this_process() -> Self {
        let variable = |name: &str| std::env::var_os(name).map(|value| (name.to_owned(), value));
        Self {
            variables: VARIABLES.iter().filter_map(|name| variable(name)).collect(),
            executable: std::env::current_exe().ok(),
            root: PathBuf::from("/"),
        }
    }

    /// A variable that holds one path; an empty one counts as unset.
    fn path(&self, name: &str) -> Option<PathBuf> {
        self.variables.get(name).filter(|value| !value.is_empty()).map(PathBuf::from)
    }

    /// All folders to search, in order, each once.
    fn folders(&self) -> Vec<PathBuf> {
        let mut folders = Vec::new();
        if let Some(folder) = self.executable.as_deref().and_then(Path::parent) {
            folders.push(folder.to_path_buf());
            folders.extend(folder.parent().map(|above| above.join("lib")));
        }
        let cache = self.path("XDG_CACHE_HOME").or_else(|| Some(self.path("HOME")?.join(".cache")));
        folders.extend(cache.map(|cache| cache.join("loci")));
        folders.extend(self.linker_folders());
        folders.extend(self.python_folders());
        let mut seen = std::collections::BTreeSet::new();
        folders.retain(|folder| seen.insert(folder.clone()));
        folders
    }

    /// `LD_LIBRARY_PATH`, the folders in /etc/ld.so.conf and /etc/ld.so.conf.d, and the usual ones.
    fn linker_folders(&self) -> Vec<PathBuf> {
        let path = self.variables.get("LD_LIBRARY_PATH").cloned().unwrap_or_default();
        // An empty entry would mean the working folder: nothing that happens to lie there is loaded.
        let mut folders: Vec<_> =
            std::env::split_paths(&path).filter(|folder| !folder.as_os_str().is_empty()).collect();
        let mut settings = vec![self.root.join("etc/ld.so.conf")];
        settings.extend(children(&self.root.join("etc/ld.so.conf.d"), ""));
        for file in settings {
            let text = read_bounded(&file, LARGEST_LINKER_SETTINGS_BYTES).unwrap_or_default();
            let text = String::from_utf8_lossy(&text).into_owned();
            folders
                .extend(text.lines().filter_map(|line| Some(self.root.join(line.trim().strip_prefix('/')?))));
        }
        let multiarch = format!("{}-linux-gnu", std::env::consts::ARCH);
        for parent in ["usr/local/lib", "usr/lib", "lib"] {
            let parent = self.root.join(parent);
            folders.extend([parent.join(&multiarch), parent]);
        }
        folders.extend(["usr/lib64", "lib64"].map(|folder| self.root.join(folder)));
        folders
    }

    /// `onnxruntime/capi` of every Python package folder that exists.
    fn python_folders(&self) -> Vec<PathBuf> {
        let home = self.path("HOME");
        let mut prefixes: Vec<_> =
            ["VIRTUAL_ENV", "CONDA_PREFIX"].iter().filter_map(|name| self.path(name)).collect();
        prefixes.extend(home.as_ref().map(|home| home.join(".local")));
        prefixes.extend(["usr/local", "usr"].map(|prefix| self.root.join(prefix)));
        prefixes.extend(home.iter().flat_map(|home| children(&home.join(".pyenv/versions"), "")));
        let pythons = prefixes.iter().flat_map(|prefix| children(&prefix.join("lib"), "python3"));
        let packages =
            pythons.flat_map(|python| ["site-packages", "dist-packages"].map(|name| python.join(name)));
        packages.map(|packages| packages.join("onnxruntime/capi")).filter(|folder| folder.is_dir()).collect()
    }
}

/// The entries of a folder whose names begin with `prefix`, by name; none if it cannot be read.
fn children(folder: &Path, prefix: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<_> = entries
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(prefix))
        .map(|entry| entry.path())
        .collect();
    paths.sort();
    paths
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::super::library::tests::fake_library;
    use super::*;

    /// A made-up computer in a temporary folder.
    struct Computer {
        root: TempDir,
        surroundings: Surroundings,
    }

    impl Computer {
        fn new() -> Self {
            let root = TempDir::new().unwrap();
            // The search answers canonical paths, and a temporary folder may lie behind a link.
            let path = root.path().canonicalize().unwrap();
            let mut surroundings = Surroundings { root: path.clone(), ..Surroundings::default() };
            surroundings.executable = Some(path.join("opt/loci/bin/loci"));
            surroundings.variables.insert("HOME".to_owned(), path.join("home/robot").into());
            Self { root, surroundings }
        }

        fn set(&mut self, variable: &str, path: &str) {
            let value = if path.is_empty() { OsString::new() } else { self.at(path).into() };
            self.surroundings.variables.insert(variable.to_owned(), value);
        }

        fn at(&self, path: &str) -> PathBuf {
            self.surroundings.root.join(path)
        }

        fn write(&self, path: &str, bytes: &[u8]) {
            let path = self.root.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }

        fn install(&self, path: &str, version: &str) {
            self.write(path, &fake_library(version));
        }

        fn find(&self) -> Result<PathBuf, CnnError> {
            find_runtime(None, &self.surroundings).map(|found| found.path)
        }

        fn find_named(&self, path: &str) -> Result<PathBuf, CnnError> {
            find_runtime(Some(&self.at(path)), &self.surroundings).map(|found| found.path)
        }
    }

    #[test]
    fn places_are_searched_in_the_documented_order() {
        let mut computer = Computer::new();
        for (variable, path) in
            [("LD_LIBRARY_PATH", "ros/lib"), ("VIRTUAL_ENV", "venv"), ("CONDA_PREFIX", "conda")]
        {
            computer.set(variable, path);
        }
        computer.write("etc/ld.so.conf.d/ai.conf", b"# accelerators\n/opt/ai/lib\ninclude x\n");
        let multiarch = format!("usr/lib/{}-linux-gnu/libonnxruntime.so.1.21.0", std::env::consts::ARCH);
        let order = [
            "opt/loci/bin/libonnxruntime.so",
            "opt/loci/lib/libonnxruntime.so.1",
            "home/robot/.cache/loci/libonnxruntime.so",
            "ros/lib/libonnxruntime.so",
            "opt/ai/lib/libonnxruntime.so",
            "usr/local/lib/libonnxruntime.so.1.20.1",
            &multiarch,
            "usr/lib/libonnxruntime.so",
            "usr/lib64/libonnxruntime.so",
            "venv/lib/python3.11/site-packages/onnxruntime/capi/libonnxruntime.so.1.32.0",
            "conda/lib/python3.12/site-packages/onnxruntime/capi/libonnxruntime.so.1.32.0",
            "home/robot/.local/lib/python3.10/site-packages/onnxruntime/capi/libonnxruntime.so.1.23.2",
            "usr/local/lib/python3.11/dist-packages/onnxruntime/capi/libonnxruntime.so.1.23.2",
            "usr/lib/python3/dist-packages/onnxruntime/capi/libonnxruntime.so.1.19.0",
            "home/robot/.pyenv/versions/3.11.7/lib/python3.11/site-packages/onnxruntime/capi/libonnxruntime.so.1.17.0",
        ];
        for place in order.iter().rev() {
            computer.install(place, "1.32.0");
            assert_eq!(computer.find().unwrap(), computer.at(place));
        }
    }

    #[test]
    fn a_named_path_goes_before_the_variable_and_the_variable_before_the_search() {
        let mut computer = Computer::new();
        for place in ["a/ort.so", "b/ort.so", "opt/loci/bin/libonnxruntime.so"] {
            computer.install(place, "1.20.0");
        }
        computer.set("ORT_DYLIB_PATH", "b/ort.so");
        assert_eq!(computer.find_named("a/ort.so").unwrap(), computer.at("a/ort.so"));
        assert_eq!(computer.find().unwrap(), computer.at("b/ort.so"));
        computer.set("ORT_DYLIB_PATH", "");
        assert_eq!(computer.find().unwrap(), computer.at("opt/loci/bin/libonnxruntime.so"));
    }

    #[test]
    fn a_named_path_that_does_not_work_is_an_error_and_not_passed_over() {
        let mut computer = Computer::new();
        computer.install("opt/loci/bin/libonnxruntime.so", "1.20.0");
        computer.install("old.so", "1.16.0");
        computer.write("text.so", b"text");
        std::fs::create_dir(computer.at("empty")).unwrap();
        for path in ["nowhere.so", "old.so", "text.so", "empty"] {
            let error = computer.find_named(path).unwrap_err();
            assert!(matches!(error, CnnError::UnusableLibrary { .. }), "{error}");
            assert!(error.to_string().contains(path) && !error.to_string().contains('\n'), "{error}");
        }
        computer.set("ORT_DYLIB_PATH", "nowhere.so");
        assert!(matches!(
            computer.find(),
            Err(CnnError::UnusableLibrary { fault: LibraryFault::Missing, .. })
        ));
    }

    #[test]
    fn a_named_folder_is_searched_for_the_newest_library_it_holds() {
        let computer = Computer::new();
        for version in ["1.9.0", "1.20.0", "1.32.0"] {
            computer.install(&format!("ort/lib/libonnxruntime.so.{version}"), version);
        }
        computer.install("ort/lib/libonnxruntime_providers_shared.so", "1.40.0");
        assert_eq!(computer.find_named("ort").unwrap(), computer.at("ort/lib/libonnxruntime.so.1.32.0"));
        assert_eq!(computer.find_named("ort/lib").unwrap(), computer.at("ort/lib/libonnxruntime.so.1.32.0"));
    }

    #[test]
    fn unusable_libraries_on_the_way_are_passed_over_and_remembered() {
        let computer = Computer::new();
        computer.install("home/robot/.cache/loci/libonnxruntime.so", "1.16.0");
        computer.write("usr/local/lib/libonnxruntime.so", b"text");
        let error = computer.find().unwrap_err().to_string();
        assert!(
            error.contains(".cache/loci/libonnxruntime.so (is ONNX Runtime 1.16.0; need 1.17.0"),
            "{error}"
        );
        assert!(error.contains("usr/local/lib/libonnxruntime.so (not a 64-bit ELF"), "{error}");
        computer.install("usr/lib/libonnxruntime.so", "1.20.0");
        assert_eq!(computer.find().unwrap(), computer.at("usr/lib/libonnxruntime.so"));
    }

    #[test]
    fn a_computer_without_onnx_runtime_is_told_the_fix_and_the_places() {
        let computer = Computer::new();
        let error = computer.find().unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains("`make deps`") && text.contains("--onnxruntime PATH") && !text.contains('\n'),
            "{text}"
        );
        for place in ["opt/loci/bin", "opt/loci/lib", "home/robot/.cache/loci", "usr/local/lib", "lib64"] {
            assert!(text.contains(computer.at(place).to_str().unwrap()), "{place}: {text}");
        }
    }

    #[test]
    fn empty_surroundings_find_nothing() {
        let nowhere = Surroundings { root: PathBuf::from("/nonexistent"), ..Surroundings::default() };
        assert!(matches!(find_runtime(None, &nowhere), Err(CnnError::RuntimeNotFound { .. })));
    }

    #[test]
    fn the_working_folder_is_never_searched() {
        let mut computer = Computer::new();
        computer.surroundings.variables.insert("LD_LIBRARY_PATH".to_owned(), "::".into());
        assert!(computer.surroundings.folders().iter().all(|folder| folder.is_absolute()));
    }
}
