//! Experiments as they are asked for, in arguments or in the TOML file of a suite, and how they become
//! [`ExperimentPlan`]s.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::EvaluationError;
use super::experiment::{ExperimentPlan, PlannedFrames};
use super::ground_truth::{RowFilter, Table, Tolerance};
use super::layout::{Camera, Layout, LayoutError, LayoutOptions};
use super::results::{Baseline, Database, Method};
use super::traverse::TraversePlan;
use super::truth_plan::{TruthPlan, TruthSpec};

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
    /// How many frames back the past begins; by default what the layout says, 20 or 300.
    pub recent: Option<usize>,
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
        let error = |reason: String| EvaluationError::Suite { path: path.to_owned(), reason };
        let text = fs::read_to_string(path).map_err(|source| error(source.to_string()))?;
        let suite: Self = toml::from_str(&text)
            .map_err(|source| error(source.message().split_whitespace().collect::<Vec<_>>().join(" ")))?;
        Ok(Self { data: path.parent().unwrap_or(Path::new("")).join(suite.data), ..suite })
    }

    /// The folder that paths start from: `named`, or what the file says.
    #[must_use]
    pub fn data(&self, named: Option<&Path>) -> PathBuf {
        named.unwrap_or(&self.data).to_owned()
    }
}

/// `text` below `folder`, if it is a path rather than a source with a scheme.
fn located(folder: &Path, text: &str) -> String {
    if text.starts_with("synthetic:") || text.starts_with("v4l2:") {
        return text.to_owned();
    }
    folder.join(text).display().to_string()
}

impl ExperimentSpec {
    /// The plan of this experiment; its paths start from `folder`.
    ///
    /// # Errors
    /// If something is asked for that makes no sense, or the ground truth does not fit the frames.
    pub fn plan(&self, folder: &Path) -> Result<ExperimentPlan, EvaluationError> {
        let truth = self.truth.spec(folder)?;
        let traverses = self.frames.traverses(folder, truth.as_ref())?;
        let Traverses { query, reference, unknown } = traverses;
        let prepared =
            TruthPlan::prepare(truth.as_ref(), self.truth.tolerance(), &query, reference.as_ref())?;
        let (methods, paper) = self.methods()?;
        let name = self.name.clone().unwrap_or_else(|| match &reference {
            Some(reference) => format!("{}, known from {}", query.name, reference.name),
            None => format!("{}, known from its own past", query.name),
        });
        Ok(ExperimentPlan {
            name,
            note: self.note.clone(),
            frames: PlannedFrames { reference, query, unknown, truth: prepared },
            methods,
            databases: self.databases()?,
            paper,
            recent: self.truth.recent.unwrap_or(self.frames.layout()?.recent_frames()),
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
        self.databases.iter().map(database).collect()
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

    fn tolerance(&self) -> Tolerance {
        let defaults = Tolerance::default();
        Tolerance {
            lap_share: self.lap_tolerance.unwrap_or(defaults.lap_share),
            radius_metres: self.radius.unwrap_or(defaults.radius_metres),
            ordinals: self.place_tolerance.unwrap_or(defaults.ordinals),
        }
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

    fn traverses(&self, folder: &Path, truth: Option<&TruthSpec>) -> Result<Traverses, EvaluationError> {
        let wrong = |reason: String| EvaluationError::Wrong(reason);
        let layout = self.layout()?;
        let camera = match self.camera.as_deref() {
            None | Some("left") => Camera::Left,
            Some("right") => Camera::Right,
            Some(other) => return Err(wrong(format!("no camera '{other}'; there are left and right"))),
        };
        let options = LayoutOptions { spacing_metres: self.spacing, camera };
        let sample_interval = self.sample_interval.unwrap_or(1).max(1);
        let open =
            |source: &String| TraversePlan::open(&located(folder, source), layout, &options, sample_interval);
        let of_rows = |rows: Option<&String>| -> Result<TraversePlan, EvaluationError> {
            let Some(TruthSpec::File(path)) = truth else {
                let reason = "rows are rows of a ground-truth table: name it with --truth FILE.csv";
                return Err(wrong(reason.to_owned()));
            };
            let filter: RowFilter = rows
                .map_or("", String::as_str)
                .parse()
                .map_err(|error: super::ground_truth::RowFilterError| wrong(error.to_string()))?;
            Ok(TraversePlan::of_rows(&Table::read(path)?, &filter)?)
        };
        let query = match (&self.query, &self.query_rows) {
            (Some(_), Some(_)) => return Err(wrong("a query is a source or rows, not both".into())),
            (Some(source), None) => open(source)?,
            (None, rows) => of_rows(rows.as_ref())?,
        };
        let reference = match (&self.reference, &self.reference_rows) {
            (Some(_), Some(_)) => return Err(wrong("a reference is a source or rows, not both".into())),
            (Some(source), None) => Some(open(source)?),
            (None, Some(rows)) => Some(of_rows(Some(rows))?),
            (None, None) => None,
        };
        let unknown = self.unknown.as_ref().map(open).transpose()?;
        Ok(Traverses { query, reference, unknown })
    }
}

#[cfg(test)]
mod tests {
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
        assert!(message.contains("unknown field `qeury`"), "{message}");
        fs::write(&path, "data = 'd'\n[[experiment]]\nname = 'x'\n").unwrap();
        assert_eq!(Suite::read(&path).unwrap().data(None), folder.path().join("d"));
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
}
