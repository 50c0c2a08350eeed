//! The whole report in one table: a row an experiment, for the decision of the product.
//!
//! That decision is `cnn+bow_hv` over the map that Loci founds by itself. Where an experiment did not ask
//! for it, the last of its results stands in, and the row says which.

use super::cells::{Cell, counts, thousands};
use super::palette::label;
use crate::evaluation::results::{Database, Experiment, Figures, Method, MethodResult, Report};

/// What the table shows.
pub(super) const SENTENCE: &str = "Each row is one experiment, answered as the product does, by cnn+bow_hv over \
     the map that it founds by itself, unless the row names another. A number after + counts frames of a \
     further traverse of unknown places; brackets hold what was counted; the 95 % intervals \
     stand with each experiment.";

/// Heads of the columns.
pub(super) const HEAD: [&str; 6] =
    ["Experiment", "Query frames known / unknown", "R@1", "Precision", "Recall", "False accepts"];

/// One experiment.
pub(super) struct Row<'a> {
    /// Which.
    pub(super) experiment: &'a Experiment,
    /// Query frames of known and of unknown places, and those of the traverse of unknown places.
    pub(super) frames: String,
    /// Method and database, where they are not the product's.
    pub(super) stand_in: Option<String>,
    /// The figures of the last four columns: rate, and successes of how many.
    pub(super) figures: [Option<(String, String)>; 4],
}

/// All rows; none where there is but one experiment, whose own table says more.
pub(super) fn rows(report: &Report) -> Vec<Row<'_>> {
    if report.experiments.len() < 2 {
        return Vec::new();
    }
    report.experiments.iter().map(row).collect()
}

fn row(experiment: &Experiment) -> Row<'_> {
    let product = experiment.results.iter().find(|result| is_product(result));
    let shown = product.or(experiment.results.last());
    Row {
        experiment,
        frames: frames(experiment),
        stand_in: shown.filter(|result| !is_product(result)).map(label),
        figures: shown.map_or_else(Default::default, |result| figures(&result.figures)),
    }
}

fn frames(experiment: &Experiment) -> String {
    let truth = &experiment.ground_truth;
    let [known, unknown] = [truth.known, truth.unknown].map(thousands);
    let beside = experiment
        .unknown
        .as_ref()
        .map_or_else(String::new, |traverse| format!(" + {}", thousands(traverse.frames)));
    format!("{known} / {unknown}{beside}")
}

fn is_product(result: &MethodResult) -> bool {
    (result.method, result.database) == (Method::CnnBowHv, Database::Map)
}

fn figures(figures: &Figures) -> [Option<(String, String)>; 4] {
    [&figures.recall_at_1, &figures.precision, &figures.recall, &figures.false_accepts].map(|figure| {
        let cell = Cell::proportion(figure.as_ref())?;
        let counts = counts(&cell)?;
        Some((cell.value, counts))
    })
}

#[cfg(test)]
mod tests {
    use super::super::sample;
    use super::*;

    #[test]
    fn the_products_decision_is_shown_wherever_it_stands() {
        let mut report = sample::report();
        report.experiments[0].results.reverse();
        let rows = rows(&report);
        let [at_1, precision, ..] = &rows[0].figures;
        // The sixth result of the sample: its skill is 0.63.
        assert_eq!(at_1.as_ref().unwrap(), &("0.724".to_owned(), "2,585/3,570".to_owned()));
        assert_eq!(precision.as_ref().unwrap().1, "1,890/2,112");
        assert_eq!(rows[0].stand_in, None);
    }

    #[test]
    fn another_result_stands_in_and_is_named() {
        let mut report = sample::report();
        report.experiments[0].results.truncate(2);
        let rows = rows(&report);
        assert_eq!(rows[0].stand_in.as_deref(), Some("bow_hv · frames"));
        assert_eq!(rows[0].figures[3].as_ref().unwrap().1, "17/1,204");
        assert!(rows[1].stand_in.is_none() && rows[1].figures.iter().all(Option::is_none));
    }

    #[test]
    fn one_experiment_needs_no_table() {
        let mut report = sample::report();
        report.experiments.truncate(1);
        assert!(rows(&report).is_empty());
    }
}
