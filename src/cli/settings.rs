//! Settings of a stream: flag > `LOCI_…` variable > `--config` file > default.
//!
//! Flags and variables come through clap. The file has the same keys as the flags have names, and an
//! unknown key is refused.

use std::ffi::OsString;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::{env, fs};

use clap::{Args, ValueEnum};
use loci::pipeline::CpuBudget;
use loci::place_map::Durability;
use loci::source::PoseAddress;
use serde::{Deserialize, Deserializer};

use super::WrongArgument;
use super::size::Size;

/// What can be switched on and off.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Switch {
    On,
    Off,
}

/// Settings of a stream; what is not set anywhere is `None`.
#[derive(Args, Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub(super) struct StreamSettings {
    /// Folder of the map; made if need be. Without it the map is gone at the end
    #[arg(long, env = "LOCI_MAP", value_name = "DIR")]
    pub(super) map: Option<PathBuf>,
    /// When what was learnt is safe from a power cut: every (before the answer), interval=200ms, or none
    /// [default: interval=200ms]
    #[arg(long, env = "LOCI_DURABILITY", value_name = "WHEN")]
    pub(super) durability: Option<Durability>,
    /// Most bytes of the map's folder; what tells least is given up [default: 4GiB]
    #[arg(long, env = "LOCI_MAP_DISK", value_name = "SIZE")]
    pub(super) map_disk: Option<Size>,
    /// Most memory of what is searched and known of the map: index and CNN descriptors of the keyframes that are
    /// searched, places and experiences. The keyframes always get a quarter of it; places not seen for long wait on
    /// the disk [default: 256MiB]
    #[arg(long, env = "LOCI_MAP_MEMORY", value_name = "SIZE")]
    pub(super) map_memory: Option<Size>,
    /// Visual vocabulary; given again, a set that is switched by light [env: LOCI_VOCAB=, parted by ':']
    /// [default: vocab/default.lvoc]
    #[arg(long, value_name = "FILE")]
    pub(super) vocab: Vec<PathBuf>,
    /// Folder of the CNN with its card, or none for BoW+HV alone [default: models/efficientnet-lite0]
    #[arg(long, env = "LOCI_MODEL", value_name = "DIR")]
    pub(super) model: Option<PathBuf>,
    /// ONNX Runtime library [default: looked for; `loci doctor` says where]
    #[arg(long, env = "LOCI_ONNXRUNTIME", value_name = "PATH")]
    pub(super) onnxruntime: Option<PathBuf>,
    /// Where the robot was: a file of TUM's lines of time and pose, or CSV of time, lat, lon. For a camera also
    /// gpsd[:HOST[:PORT]], or unix:PATH, a socket to which such lines are written. Looked up at the time of every frame
    #[arg(long, env = "LOCI_POSE", value_name = "FROM")]
    pub(super) pose: Option<PoseAddress>,
    /// Play a recording at this rate, as a camera would give it: whoever is slow misses frames
    #[arg(long, env = "LOCI_PLAY_FPS", value_name = "FPS")]
    pub(super) play_fps: Option<f64>,
    /// Process every N-th frame [default: 1; of a camera or video about three a second]
    #[arg(long, env = "LOCI_SAMPLE_INTERVAL", value_name = "N")]
    pub(super) sample_interval: Option<NonZero<u32>>,
    /// δ_ep: processed frames that join a place unasked after its founding [default: 5]
    #[arg(long, env = "LOCI_PLACE_INTERVAL", value_name = "N")]
    pub(super) place_interval: Option<u32>,
    /// Whether what was seen before counts, or every frame by itself [default: on]
    #[arg(long, env = "LOCI_SEQUENCE", value_enum, value_name = "WHETHER")]
    pub(super) sequence: Option<Switch>,
    /// Localise only, never change the map
    #[arg(long, env = "LOCI_READ_ONLY", num_args = 0..=1, require_equals = true,
          default_missing_value = "true", value_name = "BOOL")]
    pub(super) read_only: Option<bool>,
    /// Learn words online where the vocabulary covers what is seen badly
    #[arg(long, env = "LOCI_GROW_VOCABULARY", num_args = 0..=1, require_equals = true,
          default_missing_value = "true", value_name = "BOOL")]
    pub(super) grow_vocabulary: Option<bool>,
    /// Show it in rerun: off, spawn, connect=ADDR, serve[=ADDR] or save=FILE.rrd; given again, there, too.
    /// 'save=FILE.rrd?mib=500&minutes=60&files=24' goes on in new files and keeps the newest [env: LOCI_RERUN=, parted
    /// by ','] [default: off]
    #[arg(long, value_name = "TARGET")]
    #[serde(deserialize_with = "one_or_several")]
    pub(super) rerun: Vec<String>,
    /// How much is shown: lean (answers, map, curves, a small picture a second), normal (similarities, too, and camera
    /// and matches of ten frames a second at most), full (all of every frame) [default: normal]
    #[arg(long, env = "LOCI_RERUN_DETAIL", value_name = "DETAIL")]
    pub(super) rerun_detail: Option<String>,
    /// Processor time that all of it may take: a share of one core such as 50%, or cores such as 1.5. Frames of a
    /// camera beyond that are left out, files are read more slowly [default: all there is]
    #[arg(long, env = "LOCI_CPU_BUDGET", value_name = "CORES")]
    pub(super) cpu_budget: Option<CpuBudget>,
    /// Threads of the CNN [default: 1, or what the CPU budget leaves beside one core]
    #[arg(long, env = "LOCI_THREADS", value_name = "N")]
    pub(super) threads: Option<NonZero<u32>>,
}

impl StreamSettings {
    /// These settings, completed from the environment and the file at `config`, if there is one.
    pub(super) fn completed(mut self, config: Option<&Path>) -> anyhow::Result<Self> {
        if self.vocab.is_empty() {
            self.vocab = vocabularies_in(env::var_os("LOCI_VOCAB"));
        }
        if self.rerun.is_empty() {
            self.rerun = targets_in(env::var_os("LOCI_RERUN"))?;
        }
        let Some(path) = config else { return Ok(self) };
        let text = fs::read_to_string(path)
            .map_err(|error| WrongArgument(format!("cannot read --config {}: {error}", path.display())))?;
        let file: Self = toml::from_str(&text)
            .map_err(|error| WrongArgument(format!("{}{}", path.display(), one_line(&error, &text))))?;
        Ok(self.or(file))
    }

    /// Whether BoW+HV is to decide alone.
    pub(super) fn is_without_cnn(&self) -> bool {
        self.model.as_deref() == Some(Path::new("none"))
    }

    fn or(self, other: Self) -> Self {
        Self {
            map: self.map.or(other.map),
            durability: self.durability.or(other.durability),
            map_disk: self.map_disk.or(other.map_disk),
            map_memory: self.map_memory.or(other.map_memory),
            vocab: if self.vocab.is_empty() { other.vocab } else { self.vocab },
            model: self.model.or(other.model),
            onnxruntime: self.onnxruntime.or(other.onnxruntime),
            pose: self.pose.or(other.pose),
            play_fps: self.play_fps.or(other.play_fps),
            sample_interval: self.sample_interval.or(other.sample_interval),
            place_interval: self.place_interval.or(other.place_interval),
            sequence: self.sequence.or(other.sequence),
            read_only: self.read_only.or(other.read_only),
            grow_vocabulary: self.grow_vocabulary.or(other.grow_vocabulary),
            rerun: if self.rerun.is_empty() { other.rerun } else { self.rerun },
            rerun_detail: self.rerun_detail.or(other.rerun_detail),
            cpu_budget: self.cpu_budget.or(other.cpu_budget),
            threads: self.threads.or(other.threads),
        }
    }
}

/// The files that a variable names, parted like those of PATH: clap would part those of flags, too.
fn vocabularies_in(variable: Option<OsString>) -> Vec<PathBuf> {
    let names = variable.iter().flat_map(env::split_paths);
    names.filter(|name| !name.as_os_str().is_empty()).collect()
}

/// The targets that a variable names.
fn targets_in(variable: Option<OsString>) -> Result<Vec<String>, WrongArgument> {
    let text = variable.unwrap_or_default().into_string();
    let text = text.map_err(|_| WrongArgument("LOCI_RERUN is no text in UTF-8".to_owned()))?;
    Ok(text.split(',').map(str::trim).filter(|target| !target.is_empty()).map(str::to_owned).collect())
}

/// A text, or a list of them.
fn one_or_several<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected a text or a list of texts")]
    enum Texts {
        One(String),
        Several(Vec<String>),
    }
    Ok(match Texts::deserialize(deserializer)? {
        Texts::One(text) => vec![text],
        Texts::Several(texts) => texts,
    })
}

/// What is wrong with the file's `text`, behind the file's name.
fn one_line(error: &toml::de::Error, text: &str) -> String {
    let before = error.span().and_then(|span| text.get(..span.start));
    let line = before.map_or(String::new(), |before| format!(", line {}", before.matches('\n').count() + 1));
    format!("{line}: {}", error.message().split_whitespace().collect::<Vec<_>>().join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn completed(flags: StreamSettings, file: &str) -> anyhow::Result<StreamSettings> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("loci.toml");
        fs::write(&path, file).unwrap();
        flags.completed(Some(&path))
    }

    #[test]
    fn a_flag_wins_over_the_file_and_the_file_over_nothing() {
        let flags = StreamSettings { place_interval: Some(9), ..StreamSettings::default() };
        let settings = completed(flags, "place-interval = 2\nthreads = 2\nread-only = true").unwrap();
        assert_eq!(settings.place_interval, Some(9));
        assert_eq!(settings.threads, NonZero::new(2));
        assert_eq!(settings.read_only, Some(true));
    }

    #[test]
    fn where_it_is_shown_may_be_one_or_a_list() {
        assert_eq!(targets_in(Some("spawn, save=a.rrd,".into())).unwrap(), ["spawn", "save=a.rrd"]);
        assert!(targets_in(None).unwrap().is_empty());
        let shown = |file: &str| completed(StreamSettings::default(), file).map(|settings| settings.rerun);
        assert_eq!(shown("rerun = 'spawn'").unwrap(), ["spawn"]);
        assert_eq!(shown("rerun = ['spawn', 'save=a.rrd']").unwrap(), ["spawn", "save=a.rrd"]);
        let error = shown("rerun = 7").unwrap_err().to_string();
        assert!(error.ends_with("loci.toml, line 1: expected a text or a list of texts"), "{error}");
    }

    #[test]
    fn a_variable_names_several_vocabularies_as_path_names_folders() {
        let names = |variable: &str| vocabularies_in(Some(variable.into()));
        assert_eq!(names("day.lvoc:a,b/night.lvoc"), ["day.lvoc", "a,b/night.lvoc"].map(PathBuf::from));
        assert!(names("").is_empty() && vocabularies_in(None).is_empty());
    }

    #[test]
    fn an_unknown_key_is_refused_by_name() {
        let error = completed(StreamSettings::default(), "place-intervall = 2").unwrap_err();
        assert!(error.is::<WrongArgument>());
        assert!(error.to_string().contains("loci.toml, line 1: unknown field `place-intervall`"), "{error}");
    }

    #[test]
    fn a_size_may_be_text_or_a_number_and_what_is_none_is_refused_with_its_line() {
        let settings = completed(StreamSettings::default(), "map-disk = \"64MiB\"\nmap-memory = 7").unwrap();
        assert_eq!([settings.map_disk, settings.map_memory].map(|size| size.unwrap().bytes()), [64 << 20, 7]);
        let error = completed(StreamSettings::default(), "threads = 2\nmap-disk = \"banana\"").unwrap_err();
        let reason = "loci.toml, line 2: expected a size such as 64MiB or 1.5GB, got banana";
        assert!(error.to_string().ends_with(reason), "{error}");
    }
}
