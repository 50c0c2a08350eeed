//! Experiments as they are asked for, in arguments or in the TOML file of a suite, and how they become
//! [`ExperimentPlan`]s.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::EvaluationError;
use super::experiment::{ExperimentPlan, PlannedFrames};
use super::ground_truth::{RowFilter, RowFilterError, Table, file};
use super::layout::{Camera, Layout, LayoutError, LayoutOptions};
use super::overlap::refuse_overlap;
use super::results::{Baseline, Database, Method};
use super::traverse::TraversePlan;
use super::truth_plan::{NamedTolerance, TruthPlan, TruthSpec};
use crate::source::{Address, ffmpeg_version};

/// Largest suite that is read, in bytes.
const MAX_SUITE_BYTES: u64 = 1 << 20;
/// How many of the frames that are looked at the past begins back, unless a layout has them closer in time.
const DEFAULT_RECENT_FRAMES: u64 = 20;

/// One experiment, as asked for.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ExperimentSpec {
    /// What is asked; by default the names of the traverses.
    pub name: Option<String>,
    /// What a reader should know about it.
    pub note: Option<String>,
    /// Which frames.
    pub frames: FramesSpec,
    /// What counts as right.
    pub truth: TruthSettings,
    /// Who answers: cnn, bow_hv, cnn+bow_hv, paper; all but the last where none is named.
    pub methods: Vec<String>,
    /// What is searched: frames, map; both where none is named.
    pub databases: Vec<String>,
    /// What others reach on the same data.
    pub baselines: Vec<BaselineSpec>,
}

/// A figure of somebody else.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct BaselineSpec {
    method: String,
    figure: String,
}

/// Which frames.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct FramesSpec {
    /// The traverse that is asked about: a source, or by default rows of the ground-truth table.
    pub query: Option<String>,
    /// The traverse that is known; without one and without `reference_rows`, the query's own past.
    pub reference: Option<String>,
    /// Frames of places that the reference does not show.
    pub unknown: Option<String>,
    /// Rows of the ground-truth table that the query is.
    pub query_rows: Option<String>,
    /// Rows of the ground-truth table that the reference is.
    pub reference_rows: Option<String>,
    /// How the folders are laid out.
    pub layout: Option<String>,
    /// Which camera of a layout that has two: left or right.
    pub camera: Option<String>,
    /// Least distance of kept frames in metres, where a layout knows positions.
    pub spacing: Option<f64>,
    /// Every how many frames one is looked at.
    pub sample_interval: Option<u64>,
}

/// What counts as right.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct TruthSettings {
    /// A file, `frames=N`, `radius=METRES`, `places=N`, `folders` or `none`.
    pub from: Option<String>,
    /// Largest distance of positions of one place in metres; default 25.
    pub radius: Option<f64>,
    /// Largest distance of lap phases of one place as a share of a lap; default 0.05.
    pub lap_tolerance: Option<f64>,
    /// Largest difference of place numbers of one place; default 0.
    pub place_tolerance: Option<i64>,
    /// How many frames back the past begins, counted before sampling; by default 20 of those that are looked
    /// at, or what the layout says.
    pub recent: Option<u64>,
}

/// Several experiments, in a TOML file.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Suite {
    /// The folder that paths start from, itself relative to the file.
    data: PathBuf,
    /// What is asked.
    #[serde(rename = "experiment")]
    pub experiments: Vec<ExperimentSpec>,
}

impl Suite {
    /// Reads the suite at `path`.
    ///
    /// # Errors
    /// If it cannot be read or has keys that nobody knows.
    pub fn read(path: &Path) -> Result<Self, EvaluationError> {
        let error =
            |reason: &str| EvaluationError::Suite { path: path.to_owned(), reason: reason.to_owned() };
        if !path.exists() {
            return Err(error("there is no such file; name a suite with --suite FILE.toml"));
        }
        let bytes = file::read(path, MAX_SUITE_BYTES)?;
        let text = std::str::from_utf8(&bytes).map_err(|_| error("it is no text"))?;
        let suite: Self = toml::from_str(text).map_err(|source| {
            let line = 1 + text[..source.span().map_or(0, |span| span.start)].matches('\n').count();
            let reason = source.message().split_whitespace().collect::<Vec<_>>().join(" ");
            error(&format!("line {line}: {reason}"))
        })?;
        Ok(Self { data: path.parent().unwrap_or(Path::new("")).join(suite.data), ..suite })
    }

    /// The plans of its experiments, their paths below `data`, by default where the file says.
    ///
    /// # Errors
    /// If there is no such folder, or an experiment cannot be planned; the error names it.
    pub fn plans(&self, data: Option<&Path>) -> Result<Vec<ExperimentPlan>, EvaluationError> {
        let data = data.unwrap_or(&self.data);
        if !data.is_dir() {
            return Err(EvaluationError::Wrong(format!(
                "the suite's data are looked for in {}, which is no folder; name it with --data or LOCI_DATA",
                data.display()
            )));
        }
        let plan = |spec: &ExperimentSpec| {
            spec.plan(data).map_err(|error| EvaluationError::Experiment {
                name: spec.name.clone().unwrap_or_default(),
                data: data.to_owned(),
                error: Box::new(error),
            })
        };
        self.experiments.iter().map(plan).collect()
    }
}

/// `text` below `folder`, if it is a path rather than a source with a scheme.
fn located(folder: &Path, text: &str) -> String {
    match Address::from(text) {
        Address::Path(path) => folder.join(path).display().to_string(),
        _ => text.to_owned(),
    }
}

impl ExperimentSpec {
    /// The plan of this experiment; its paths start from `folder`.
    ///
    /// # Errors
    /// If something is asked for that makes no sense, or the ground truth does not fit the frames.
    pub fn plan(&self, folder: &Path) -> Result<ExperimentPlan, EvaluationError> {
        self.truth.check()?;
        let truth = self.truth.spec(folder)?;
        let (methods, paper) = self.methods()?;
        let Traverses { query, reference, unknown } = self.frames.traverses(folder, truth.as_ref())?;
        if reference.is_some() && self.truth.recent.is_some() {
            let reason =
                "recent is about a query's own past, and a reference is given; leave one of them out";
            return Err(EvaluationError::Wrong(reason.to_owned()));
        }
        if paper && reference.is_none() {
            return Err(EvaluationError::PaperNeedsReference);
        }
        let prepared =
            TruthPlan::prepare(truth.as_ref(), self.truth.tolerance(), &query, reference.as_ref())?;
        let name = self.name.clone().unwrap_or_else(|| match &reference {
            Some(reference) => format!("{}, known from {}", query.name, reference.name),
            None => format!("{}, known from its own past", query.name),
        });
        let least_recent = DEFAULT_RECENT_FRAMES * self.frames.sample_interval();
        let of_layout = self.frames.layout()?.recent_frames().max(least_recent);
        let mut options = self.frames.options();
        if [Some(&query), reference.as_ref(), unknown.as_ref()]
            .into_iter()
            .flatten()
            .any(TraversePlan::is_video)
        {
            options.extend(ffmpeg_version().map(|version| ("ffmpeg".to_owned(), version)));
        }
        Ok(ExperimentPlan {
            name,
            note: self.note.clone(),
            frames: PlannedFrames { reference, query, unknown, truth: prepared },
            methods,
            databases: self.databases()?,
            paper,
            recent_frames: self.truth.recent.unwrap_or(of_layout),
            options,
            baselines: self.baselines.iter().map(BaselineSpec::baseline).collect(),
        })
    }

    /// The methods, and whether the paper's protocol is among them.
    fn methods(&self) -> Result<(Vec<Method>, bool), EvaluationError> {
        let mut methods = Vec::new();
        let mut paper = false;
        for name in &self.methods {
            match Method::ALL.into_iter().find(|method| method.as_str() == name) {
                Some(method) => methods.push(method),
                None if name == "paper" => paper = true,
                None => {
                    let reason = format!("no method '{name}'; there are cnn, bow_hv, cnn+bow_hv, paper");
                    return Err(EvaluationError::Wrong(reason));
                }
            }
        }
        if self.methods.is_empty() {
            methods.extend(Method::ALL);
        }
        methods.sort_unstable();
        methods.dedup();
        Ok((methods, paper))
    }

    fn databases(&self) -> Result<Vec<Database>, EvaluationError> {
        let all = [Database::Frames, Database::Map];
        if self.databases.is_empty() {
            return Ok(all.to_vec());
        }
        let database = |name: &String| {
            all.into_iter().find(|database| database.as_str() == name).ok_or_else(|| {
                EvaluationError::Wrong(format!("no database '{name}'; there are frames and map"))
            })
        };
        let mut databases = self.databases.iter().map(database).collect::<Result<Vec<_>, _>>()?;
        databases.sort_unstable();
        databases.dedup();
        Ok(databases)
    }
}

impl BaselineSpec {
    fn baseline(&self) -> Baseline {
        Baseline { method: self.method.clone(), figure: self.figure.clone() }
    }
}

impl TruthSettings {
    fn spec(&self, folder: &Path) -> Result<Option<TruthSpec>, EvaluationError> {
        let Some(text) = &self.from else { return Ok(None) };
        let file = folder.join(text);
        let text = if file.is_file() { file.display().to_string() } else { text.clone() };
        text.parse()
            .map(Some)
            .map_err(|error: super::TruthSpecError| EvaluationError::Wrong(error.to_string()))
    }

    /// Refuses numbers that make no sense.
    fn check(&self) -> Result<(), EvaluationError> {
        above_zero("radius", self.radius, "metres")?;
        above_zero("lap-tolerance", self.lap_tolerance, "laps")?;
        match self.place_tolerance {
            Some(places) if places < 0 => {
                Err(EvaluationError::Wrong(format!("place-tolerance {places} is below 0")))
            }
            _ => Ok(()),
        }
    }

    fn tolerance(&self) -> NamedTolerance {
        NamedTolerance {
            lap_share: self.lap_tolerance,
            radius_metres: self.radius,
            ordinals: self.place_tolerance,
        }
    }
}

fn above_zero(name: &str, number: Option<f64>, unit: &str) -> Result<(), EvaluationError> {
    match number {
        Some(number) if !(number.is_finite() && number > 0.0) => {
            Err(EvaluationError::Wrong(format!("{name} {number} is not a number of {unit} above 0")))
        }
        _ => Ok(()),
    }
}

struct Traverses {
    query: TraversePlan,
    reference: Option<TraversePlan>,
    unknown: Option<TraversePlan>,
}

impl FramesSpec {
    fn layout(&self) -> Result<Layout, EvaluationError> {
        let parse = |name: &String| {
            name.parse().map_err(|error: LayoutError| EvaluationError::Wrong(error.to_string()))
        };
        self.layout.as_ref().map_or(Ok(Layout::Images), parse)
    }

    fn sample_interval(&self) -> u64 {
        self.sample_interval.unwrap_or(1).max(1)
    }

    /// What was asked for and bears on the figures, by name.
    fn options(&self) -> BTreeMap<String, String> {
        let named = [
            ("layout", self.layout.clone()),
            ("camera", self.camera.clone()),
            ("spacing_metres", self.spacing.map(|metres| metres.to_string())),
            ("sample_interval", self.sample_interval.map(|interval| interval.to_string())),
        ];
        named.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
    }

    /// The sources that were named, as paths from `folder`.
    fn sources(&self, folder: &Path) -> [Option<String>; 3] {
        [&self.query, &self.reference, &self.unknown]
            .map(|source| source.as_ref().map(|source| located(folder, source)))
    }

    /// Refuses what only folders have, where none is given.
    fn check(&self, sources: &[Option<String>; 3]) -> Result<(), EvaluationError> {
        above_zero("spacing", self.spacing, "metres")?;
        let has_rows = sources[0].is_none() || self.reference_rows.is_some();
        let of_folders = [
            self.layout.as_ref().map(|_| "layout"),
            self.camera.as_ref().map(|_| "camera"),
            self.spacing.filter(|_| !has_rows).map(|_| "spacing"),
        ];
        let has_folder = sources.iter().flatten().any(|source| Path::new(source).is_dir());
        match of_folders.into_iter().flatten().next().filter(|_| !has_folder) {
            Some(name) => {
                Err(EvaluationError::Wrong(format!("{name} is about folders of frames, and none is given")))
            }
            None => Ok(()),
        }
    }

    fn traverses(&self, folder: &Path, truth: Option<&TruthSpec>) -> Result<Traverses, EvaluationError> {
        let wrong = |reason: &str| Err(EvaluationError::Wrong(reason.to_owned()));
        let sources = self.sources(folder);
        let (layout, options) = (self.layout()?, self.layout_options()?);
        self.check(&sources)?;
        let open = |source: &String| TraversePlan::open(source, layout, &options, self.sample_interval());
        let of_rows = |rows: &String| self.rows(rows, truth);
        let [query, reference, unknown] = &sources;
        let query = match (query, &self.query_rows) {
            (Some(_), Some(_)) => return wrong("a query is a source or rows, not both"),
            (Some(source), None) => open(source)?,
            (None, Some(rows)) => of_rows(rows)?,
            (None, None) => of_rows(&String::new())?,
        };
        let reference = match (reference, &self.reference_rows) {
            (Some(_), Some(_)) => return wrong("a reference is a source or rows, not both"),
            (Some(source), None) => Some(open(source)?),
            (None, Some(rows)) => Some(of_rows(rows)?),
            (None, None) => None,
        };
        let unknown = unknown.as_ref().map(open).transpose()?;
        let all: Vec<&TraversePlan> =
            [Some(&query), reference.as_ref(), unknown.as_ref()].into_iter().flatten().collect();
        for (index, one) in all.iter().enumerate() {
            all[..index].iter().try_for_each(|other| refuse_overlap(one, other))?;
        }
        Ok(Traverses { query, reference, unknown })
    }

    fn layout_options(&self) -> Result<LayoutOptions, EvaluationError> {
        let camera = match self.camera.as_deref() {
            None => None,
            Some("left") => Some(Camera::Left),
            Some("right") => Some(Camera::Right),
            Some(other) => {
                let reason = format!("no camera '{other}'; there are left and right");
                return Err(EvaluationError::Wrong(reason));
            }
        };
        Ok(LayoutOptions { spacing_metres: self.spacing, camera })
    }

    /// The traverse that rows of the ground-truth table are.
    fn rows(&self, rows: &str, truth: Option<&TruthSpec>) -> Result<TraversePlan, EvaluationError> {
        let Some(TruthSpec::File(path)) = truth else {
            let reason = "rows are rows of a ground-truth table: name it with --truth FILE.csv";
            return Err(EvaluationError::Wrong(reason.to_owned()));
        };
        let filter: RowFilter =
            rows.parse().map_err(|error: RowFilterError| EvaluationError::Wrong(error.to_string()))?;
        let thinning = (self.sample_interval(), self.spacing);
        Ok(TraversePlan::of_rows(&Table::read(path)?, &filter, thinning)?)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn methods(names: &[&str]) -> Result<(Vec<Method>, bool), String> {
        let methods = names.iter().map(|&name| name.to_owned()).collect();
        let spec = ExperimentSpec { methods, ..ExperimentSpec::default() };
        spec.methods().map_err(|error| error.to_string())
    }

    #[test]
    fn methods_are_named_and_the_paper_protocol_is_asked_for_by_name_only() {
        assert_eq!(methods(&[]).unwrap(), (Method::ALL.to_vec(), false));
        assert_eq!(methods(&["paper", "cnn"]).unwrap(), (vec![Method::Cnn], true));
        assert_eq!(
            methods(&["netvlad"]).unwrap_err(),
            "no method 'netvlad'; there are cnn, bow_hv, cnn+bow_hv, paper"
        );
    }

    #[test]
    fn a_suite_refuses_keys_that_nobody_knows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("suite.toml");
        fs::write(&path, "data = 'd'\n[[experiment]]\nname = 'x'\nframes = { qeury = 'a' }\n").unwrap();
        let message = Suite::read(&path).unwrap_err().to_string();
        assert!(message.contains("line 4: unknown field `qeury`"), "{message}");
        fs::write(&path, "data = 'd'\n[[experiment]]\nname = 'x'\n").unwrap();
        let message = Suite::read(&path).unwrap().plans(None).unwrap_err().to_string();
        assert!(message.contains(&folder.path().join("d").display().to_string()), "{message}");
    }

    #[test]
    fn what_cannot_be_planned_is_said_with_the_fix() {
        let message = |spec: ExperimentSpec| spec.plan(Path::new(".")).unwrap_err().to_string();
        assert!(message(ExperimentSpec::default()).contains("--truth FILE.csv"));
        let truth = TruthSettings { from: Some("nowhere.csv".into()), ..TruthSettings::default() };
        assert!(
            message(ExperimentSpec { truth, ..ExperimentSpec::default() }).contains("there is no such file")
        );
    }
    /// A table of four frames on a line, 10 m apart.
    fn line() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let mut table = "file,easting,northing,lap\n".to_owned();
        for frame in 0..4 {
            fs::write(folder.path().join(format!("{frame}.jpg")), "").unwrap();
            table += &format!("{frame}.jpg,{}0,0,{}\n", frame, frame / 2);
        }
        let path = folder.path().join("truth.csv");
        fs::write(&path, table).unwrap();
        (folder, path)
    }

    fn refused(spec: &ExperimentSpec) -> String {
        match spec.plan(Path::new("")) {
            Ok(_) => panic!("{spec:?} was planned"),
            Err(error) => error.to_string(),
        }
    }

    fn spec_of(toml: &str) -> ExperimentSpec {
        toml::from_str(toml).unwrap()
    }

    #[test]
    fn what_is_known_may_not_be_what_is_asked_about() {
        let (folder, table) = line();
        let truth = format!("truth.from = '{}'\n", table.display());
        let both = spec_of(&format!("{truth}frames = {{ query-rows = '', reference-rows = 'lap=1' }}"));
        let message = refused(&both);
        assert!(message.contains("frames in common (2.jpg, 3.jpg)"), "{message}");
        let unknown = format!("frames = {{ query-rows = 'lap=1', unknown = '{}' }}", folder.path().display());
        let message = refused(&spec_of(&format!("{truth}{unknown}")));
        assert!(message.contains("2.jpg"), "{message}");
        let apart = spec_of(&format!("{truth}frames = {{ query-rows = 'lap=1', reference-rows = 'lap=0' }}"));
        assert!(apart.plan(Path::new("")).is_ok());
        let world = "'synthetic:corridor?laps=1&frames=4'";
        let same = format!("truth.from = 'places=1'\nframes = {{ query = {world}, reference = {world} }}");
        assert!(refused(&spec_of(&same)).contains("frames in common"));
    }

    #[test]
    fn an_option_that_would_change_nothing_is_refused_rather_than_ignored() {
        let (_folder, table) = line();
        let rows = |more: &str| spec_of(&format!("truth.from = '{}'\n{more}", table.display()));
        for (option, named) in [
            ("truth.lap-tolerance = 0.1", "lap-tolerance"),
            ("truth.place-tolerance = 1", "place-tolerance"),
            ("frames.layout = 'kitti'", "layout"),
            ("frames.camera = 'left'", "camera"),
        ] {
            let message = refused(&rows(option));
            assert!(message.contains(named), "{option}: {message}");
        }
        let known = "frames = { query-rows = 'lap=1', reference-rows = 'lap=0' }\ntruth.recent = 3";
        assert!(refused(&rows(known)).contains("recent"));
        let world = "frames.query = 'synthetic:corridor?laps=1&frames=4'\n";
        let twice = format!("{world}truth = {{ from = 'radius=3', radius = 25.0 }}");
        assert!(refused(&spec_of(&twice)).contains("radius"));
        assert!(rows("truth.radius = 5.0").plan(Path::new("")).is_ok(), "positions have a radius");
    }

    #[test]
    fn rows_of_positions_are_thinned_and_other_rows_cannot_be() {
        let (_folder, table) = line();
        let spaced = spec_of(&format!("truth.from = '{}'\nframes.spacing = 15.0", table.display()));
        assert_eq!(spaced.plan(Path::new("")).unwrap().frames.query.frame_count(), Some(2), "0, 20 m");
        let text = fs::read_to_string(&table).unwrap().replace("easting,northing", "place,x");
        fs::write(&table, text).unwrap();
        assert!(refused(&spaced).contains("a spacing needs the columns easting and northing"));
    }

    #[test]
    fn numbers_that_make_no_sense_are_refused_by_name() {
        let (_folder, table) = line();
        for (option, named) in [
            ("truth.radius = nan", "radius NaN"),
            ("truth.radius = -1.0", "radius -1"),
            ("truth.lap-tolerance = inf", "lap-tolerance inf"),
            ("truth.place-tolerance = -2", "place-tolerance -2"),
            ("frames.spacing = 0.0", "spacing 0"),
        ] {
            let message = refused(&spec_of(&format!("truth.from = '{}'\n{option}", table.display())));
            assert!(message.contains(named), "{option}: {message}");
        }
    }

    #[test]
    fn what_the_frames_do_not_carry_is_noticed_before_they_are_looked_at() {
        let (folder, _) = line();
        let images = format!("frames.query = '{}'\n", folder.path().display());
        for truth in ["radius=5", "places=1"] {
            let message = refused(&spec_of(&format!("{images}truth.from = '{truth}'")));
            assert!(message.contains("do not carry"), "{truth}: {message}");
        }
        assert!(
            refused(&spec_of("frames.query = 'v4l2:/dev/video0'\ntruth.from = 'none'")).contains("record it")
        );
        let mistyped = "frames = { query = 'synthetic:corridor?laps=1&frames=4', unknown = '/nowhere' }\n\
                        truth.from = 'none'";
        assert!(refused(&spec_of(mistyped)).contains("/nowhere"));
    }

    #[test]
    fn the_past_begins_as_far_back_as_sampling_makes_it() {
        let world = "frames = { query = 'synthetic:corridor?laps=1&frames=4', sample-interval = 3 }\n";
        let plan =
            |more: &str| spec_of(&format!("{world}truth.from = 'places=1'\n{more}")).plan(Path::new(""));
        assert_eq!(plan("").unwrap().recent_frames, 60);
        assert_eq!(plan("truth.recent = 5").unwrap().recent_frames, 5);
        assert_eq!(plan("").unwrap().options["sample_interval"], "3");
    }
}
