//! The floors of ARCHITECTURE.md, kept by a plain scan of the source text: a module imports only from
//! floors below its own, each outside library has its home, and files and functions stay small.

use std::fs;
use std::path::{Path, PathBuf};

/// Modules and their floors; neighbours on one floor do not know each other.
const FLOORS: [(&str, u32); 22] = [
    ("cli", 9),
    ("evaluation", 8),
    ("training", 8),
    ("pipeline", 7),
    ("source", 6),
    ("telemetry", 6),
    ("recognition", 5),
    ("place_map", 4),
    ("retrieval", 4),
    ("verification", 3),
    ("vocabulary", 3),
    ("cnn", 2),
    ("feature", 2),
    ("codec", 1),
    ("kernel", 1),
    ("onnx", 1),
    ("storage", 1),
    ("frame", 0),
    ("geometry", 0),
    ("proportion", 0),
    ("raster", 0),
    // `main` and `lib` stand outside the house: they only open the doors.
    ("main", 10),
];

/// Outside libraries and the modules that may use them.
const HOMES: [(&str, &[&str]); 32] = [
    ("anyhow", &["cli", "main"]),
    ("bytesize", &["cli"]),
    ("clap", &["cli"]),
    ("indicatif", &["cli"]),
    ("parquet", &["cli"]),
    ("signal_hook", &["cli"]),
    ("crossbeam_channel", &["pipeline"]),
    ("rustix", &["pipeline", "source"]),
    ("hdrhistogram", &["pipeline"]),
    ("alphanumeric_sort", &["source"]),
    ("image", &["codec"]),
    ("zune_core", &["codec"]),
    ("zune_jpeg", &["codec"]),
    ("v4l", &["source"]),
    ("rerun", &["telemetry"]),
    ("bincode", &["place_map"]),
    ("ort", &["cnn"]),
    ("sha2", &["cnn", "evaluation"]),
    ("burn", &["training"]),
    ("half", &["onnx"]),
    ("prost", &["onnx"]),
    ("crc32fast", &["storage"]),
    ("memmap2", &["storage"]),
    ("serde_json", &["telemetry", "cli", "evaluation", "source"]),
    ("toml", &["cnn", "cli", "evaluation"]),
    ("base64", &["evaluation"]),
    ("csv", &["evaluation", "cli"]),
    ("flate2", &["evaluation", "vocabulary"]),
    ("plotters", &["evaluation", "training"]),
    ("heapless", &["recognition", "retrieval", "verification"]),
    ("rayon", &["vocabulary", "training", "cli"]),
    ("rand_pcg", &["vocabulary", "source", "evaluation", "training"]),
];

/// Modules of neighbours on the ground floor that may be used by the others there: a frame has pixels.
const GROUND_FLOOR_EXCEPTIONS: [(&str, &str); 1] = [("frame", "raster")];

const MAX_FUNCTION_LINES: usize = 60;
const MAX_FILE_LINES: usize = 400;
const MAX_LINE_CHARS: usize = 120;

struct SourceFile {
    path: PathBuf,
    module: String,
    text: String,
}

impl SourceFile {
    /// The text before the unit tests; nothing, where the whole file is tests.
    fn product(&self) -> &str {
        if self.path.file_name().is_some_and(|name| name.to_string_lossy().ends_with("tests.rs")) {
            return "";
        }
        let tests =
            self.text.find("\n#[cfg(test)]\nmod tests").or_else(|| self.text.find("\n#[cfg(all(test"));
        &self.text[..tests.unwrap_or(self.text.len())]
    }

    fn code_lines(&self) -> impl Iterator<Item = &str> {
        self.product().lines().filter(|line| !line.trim_start().starts_with("//"))
    }
}

fn source_files() -> Vec<SourceFile> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut folders = vec![root.clone()];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let below_root = path.strip_prefix(&root).unwrap().with_extension("");
                let module = below_root.iter().next().unwrap().to_string_lossy().into_owned();
                files.push(SourceFile { text: fs::read_to_string(&path).unwrap(), module, path });
            }
        }
    }
    assert!(files.len() > 40, "only {} files found", files.len());
    files
}

fn floor(module: &str) -> Option<u32> {
    FLOORS.iter().find(|(name, _)| *name == module).map(|&(_, floor)| floor)
}

/// Whatever follows `marker` in `line` as a name.
fn names_after<'a>(line: &'a str, marker: &'a str) -> impl Iterator<Item = &'a str> {
    line.match_indices(marker).filter_map(move |(start, _)| {
        let before = line[..start].chars().next_back();
        let is_word_start = !before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':');
        let rest = &line[start + marker.len()..];
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        (is_word_start && end > 0).then_some(&rest[..end])
    })
}

/// Imports that break the floors, as sentences.
fn broken_floors(file: &SourceFile) -> Vec<String> {
    let own = floor(&file.module);
    let mut broken = Vec::new();
    for line in file.code_lines() {
        for used in names_after(line, "crate::").chain(names_after(line, "loci::")) {
            let (Some(own), Some(other)) = (own, floor(used)) else { continue };
            let pair = (file.module.as_str(), used);
            if used != file.module && other >= own && !GROUND_FLOOR_EXCEPTIONS.contains(&pair) {
                broken.push(format!("{} (floor {own}) uses {used} (floor {other})", file.path.display()));
            }
        }
    }
    broken
}

/// Libraries used away from home, as sentences.
fn strayed_libraries(file: &SourceFile) -> Vec<String> {
    let mut strayed = Vec::new();
    for (library, homes) in HOMES {
        let marker = format!("{library}::");
        let uses = |line: &str| {
            line.match_indices(&marker).any(|(start, _)| {
                let before = line[..start].trim_end_matches("::");
                !before.ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':')
                    && !line[..start].ends_with("crate::")
                    && !line[..start].ends_with("super::")
            })
        };
        if !homes.contains(&file.module.as_str()) && file.code_lines().any(uses) {
            strayed.push(format!("{} uses {library}, whose home is {homes:?}", file.path.display()));
        }
    }
    strayed
}

/// Functions longer than allowed, by the indentation that rustfmt gives their closing brace.
fn long_functions(file: &SourceFile) -> Vec<String> {
    let lines: Vec<&str> = file.text.lines().collect();
    let mut long = Vec::new();
    for (start, line) in lines.iter().enumerate() {
        let trimmed = line.trim_start();
        let is_function =
            ["fn ", "pub fn ", "pub(super) fn ", "pub(crate) fn ", "const fn ", "pub const fn "]
                .iter()
                .any(|head| trimmed.starts_with(head));
        if !is_function || line.ends_with(';') {
            continue;
        }
        let indent = &line[..line.len() - trimmed.len()];
        let (body, declaration) = (format!("{indent}}}"), format!("{indent})"));
        let is_end = |line: &&str| **line == body || line.starts_with(&declaration) && line.ends_with(';');
        let length = lines[start..].iter().position(is_end).map_or(0, |last| last + 1);
        if length > MAX_FUNCTION_LINES {
            long.push(format!("{}:{} has {length} lines", file.path.display(), start + 1));
        }
    }
    long
}

fn assert_none(complaints: Vec<String>) {
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
}

#[test]
fn modules_import_only_from_floors_below() {
    assert_none(source_files().iter().flat_map(broken_floors).collect());
}

#[test]
fn every_module_has_a_floor() {
    let homeless =
        source_files().into_iter().filter(|file| file.module != "lib" && floor(&file.module).is_none());
    assert_none(homeless.map(|file| file.path.display().to_string()).collect());
}

#[test]
fn every_library_stays_in_its_home() {
    assert_none(source_files().iter().flat_map(strayed_libraries).collect());
}

#[test]
fn every_file_begins_with_what_lives_there() {
    let silent = source_files().into_iter().filter(|file| !file.text.starts_with("//! "));
    assert_none(silent.map(|file| file.path.display().to_string()).collect());
}

#[test]
fn files_and_functions_stay_small() {
    let files = source_files();
    let mut complaints: Vec<String> = files.iter().flat_map(long_functions).collect();
    for file in &files {
        let lines = file.product().lines().count();
        if lines > MAX_FILE_LINES {
            complaints.push(format!("{} has {lines} lines before its tests", file.path.display()));
        }
        if let Some(line) = file.text.lines().position(|line| line.chars().count() > MAX_LINE_CHARS) {
            complaints.push(format!("{}:{} is too wide", file.path.display(), line + 1));
        }
    }
    assert_none(complaints);
}

#[test]
fn threads_are_started_only_by_the_pipeline_and_by_those_who_wait_for_others() {
    let strayed = source_files().into_iter().filter(|file| {
        let starts = ["thread::spawn", "thread::Builder", "thread::scope"];
        let waits = ["telemetry/rerun/live.rs", "source/poses/gpsd.rs", "cli/voice.rs"];
        let may_start = file.module == "pipeline" || waits.iter().any(|path| file.path.ends_with(path));
        !may_start && starts.iter().any(|start| file.product().contains(start))
    });
    assert_none(strayed.map(|file| file.path.display().to_string()).collect());
}

#[test]
fn the_guards_themselves_can_fail() {
    let file = |module: &str, text: &str| SourceFile {
        path: PathBuf::from(format!("src/{module}.rs")),
        module: module.to_owned(),
        text: text.to_owned(),
    };
    assert_eq!(broken_floors(&file("kernel", "use crate::recognition::Decision;")).len(), 1);
    assert_eq!(broken_floors(&file("retrieval", "use crate::place_map::PlaceId;")).len(), 1);
    assert_eq!(broken_floors(&file("recognition", "use crate::place_map::PlaceId;")).len(), 0);
    assert_eq!(strayed_libraries(&file("kernel", "let map = memmap2::Mmap::map(f);")).len(), 1);
    assert_eq!(strayed_libraries(&file("storage", "use memmap2::Mmap;")).len(), 0);
    let long = format!("fn long() {{\n{}}}\n", "    step();\n".repeat(60));
    assert_eq!(long_functions(&file("kernel", &long)).len(), 1);
}
