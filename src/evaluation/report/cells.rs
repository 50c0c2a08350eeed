//! Figures as text: the rows of the table of figures, one a measure, and the numbers in its cells.

use crate::evaluation::metrics::Estimate;
use crate::evaluation::results::{Figures, MethodResult, Report};
use crate::proportion::Proportion;

/// Stands where there is nothing to count.
pub(super) const NOTHING: &str = "–";

/// One figure of one method.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Cell {
    /// Rate, value or counts.
    pub(super) value: String,
    /// Low and high end of the 95 % interval.
    pub(super) interval: Option<(String, String)>,
    /// What was counted.
    pub(super) n: Option<u64>,
    /// How many of them succeeded, where the figure is a proportion.
    pub(super) successes: Option<u64>,
}

impl Cell {
    /// A proportion, if anything was counted.
    pub(super) fn proportion(figure: Option<&Proportion>) -> Option<Self> {
        figure.filter(|figure| figure.n > 0).map(|figure| Self {
            value: decimal(figure.rate),
            interval: Some((decimal(figure.low), decimal(figure.high))),
            n: Some(figure.n),
            successes: Some(figure.successes),
        })
    }

    fn estimate(figure: Option<&Estimate>) -> Option<Self> {
        figure.map(|figure| Self {
            value: decimal(figure.value),
            interval: Some((decimal(figure.low), decimal(figure.high))),
            n: Some(figure.n),
            successes: None,
        })
    }

    /// A count, if there is anything to tell.
    fn count(figure: Option<u64>) -> Option<Self> {
        let value = thousands(figure.filter(|&count| count > 0)?);
        Some(Self { value, interval: None, n: None, successes: None })
    }

    fn places(figures: &Figures) -> Option<Self> {
        let count = |places: Option<u64>| places.map_or_else(|| NOTHING.to_owned(), thousands);
        figures.places_founded.or(figures.true_places)?;
        let value = format!("{} / {}", count(figures.places_founded), count(figures.true_places));
        Some(Self { value, interval: None, n: None, successes: None })
    }
}

/// One row of the table of figures.
pub(super) struct Measure {
    /// Its name at the head of the row.
    pub(super) title: &'static str,
    /// The fields of [`Figures`] that it shows.
    pub(super) keys: &'static [&'static str],
    /// The figure, if there is one.
    pub(super) cell: fn(&Figures) -> Option<Cell>,
}

impl Measure {
    /// What the measure means, in the report's own words.
    pub(super) fn definition(&self, report: &Report) -> String {
        let sentences: Vec<&str> =
            self.keys.iter().filter_map(|key| report.definitions.get(key).copied()).collect();
        sentences.join(" / ")
    }

    /// The figure of each method, and what all of them counted where that is the same number.
    pub(super) fn row(&self, results: &[MethodResult]) -> (Vec<Option<Cell>>, Option<u64>) {
        let mut cells: Vec<Option<Cell>> =
            results.iter().map(|result| (self.cell)(&result.figures)).collect();
        let mut counted = cells.iter().flatten().map(|cell| cell.n);
        let shared = counted.next().flatten().filter(|&n| counted.all(|other| other == Some(n)));
        if shared.is_some() {
            cells.iter_mut().flatten().for_each(|cell| cell.n = None);
        }
        (cells, shared)
    }
}

const fn measure(
    title: &'static str,
    keys: &'static [&'static str],
    cell: fn(&Figures) -> Option<Cell>,
) -> Measure {
    Measure { title, keys, cell }
}

/// All of them, in the order of the definitions.
pub(super) const MEASURES: [Measure; 16] = [
    measure("Recognition rate", &["recognition_rate"], |f| Cell::proportion(f.recognition_rate.as_ref())),
    measure("Precision", &["precision"], |f| Cell::proportion(f.precision.as_ref())),
    measure("Recall", &["recall"], |f| Cell::proportion(f.recall.as_ref())),
    measure("Keyframe precision", &["keyframe_precision"], |f| {
        Cell::proportion(f.keyframe_precision.as_ref())
    }),
    measure("R@1", &["recall_at_1"], |f| Cell::proportion(f.recall_at_1.as_ref())),
    measure("R@5", &["recall_at_5"], |f| Cell::proportion(f.recall_at_5.as_ref())),
    measure("R@10", &["recall_at_10"], |f| Cell::proportion(f.recall_at_10.as_ref())),
    measure("AUC", &["auc"], |f| Cell::estimate(f.auc.as_ref())),
    measure("R@100P", &["recall_at_full_precision"], |f| {
        Cell::proportion(f.recall_at_full_precision.as_ref())
    }),
    measure("False accepts", &["false_accepts"], |f| Cell::proportion(f.false_accepts.as_ref())),
    measure("Unjudged answers", &["unjudged_answers"], |f| Cell::count(f.unjudged_answers)),
    measure("AUROC", &["auroc"], |f| Cell::estimate(f.auroc.as_ref())),
    measure("ECE", &["expected_calibration_error"], |f| {
        Cell::estimate(f.expected_calibration_error.as_ref())
    }),
    measure("Purity", &["purity"], |f| Cell::proportion(f.purity.as_ref())),
    measure("False merges", &["false_merges"], |f| Cell::proportion(f.false_merges.as_ref())),
    measure("Places founded / true", &["places_founded", "true_places"], Cell::places),
];

/// The measures that hold anything in these results.
pub(super) fn measures_in_use(results: &[MethodResult]) -> Vec<&'static Measure> {
    const ALL: &[Measure] = &MEASURES;
    ALL.iter()
        .filter(|measure| results.iter().any(|result| (measure.cell)(&result.figures).is_some()))
        .collect()
}

/// Three decimals; [`NOTHING`] where there is no number.
pub(super) fn decimal(value: f64) -> String {
    if !value.is_finite() {
        return NOTHING.to_owned();
    }
    let text = format!("{value:.3}");
    if text == "-0.000" { "0.000".to_owned() } else { text }
}

/// A count with a comma before each three digits.
pub(super) fn thousands(count: u64) -> String {
    let digits = count.to_string();
    let mut grouped = String::with_capacity(digits.len() + digits.len() / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    grouped
}

/// Microseconds as milliseconds, exactly.
pub(super) fn milliseconds(micros: u64) -> String {
    format!("{}.{:03}", thousands(micros / 1000), micros % 1000)
}

/// Bytes as MiB with one decimal.
pub(super) fn mebibytes(bytes: u64) -> String {
    format!("{}.{}", thousands(bytes >> 20), ((bytes & ((1 << 20) - 1)) * 10) >> 20)
}

/// A proportion in one line: rate, interval and n.
pub(super) fn proportion(figure: Option<&Proportion>) -> String {
    line(Cell::proportion(figure).as_ref())
}

/// A cell in one line: `rate [low, high] n`, as far as the cell has them.
pub(super) fn line(cell: Option<&Cell>) -> String {
    let Some(cell) = cell else { return NOTHING.to_owned() };
    let mut text = cell.value.clone();
    if let Some((low, high)) = &cell.interval {
        text = format!("{text} [{low}, {high}]");
    }
    if let Some(n) = cell.n {
        text = format!("{text} {}", thousands(n));
    }
    text
}

/// A proportion as what it was counted from: `42/44`.
pub(super) fn counts(cell: &Cell) -> Option<String> {
    Some(format!("{}/{}", thousands(cell.successes?), thousands(cell.n?)))
}

/// A number of things, which are one or more.
pub(super) fn counted(count: u64, one: &str, more: &str) -> String {
    format!("{} {}", thousands(count), if count == 1 { one } else { more })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped_and_rounded() {
        assert_eq!(thousands(0), "0");
        assert_eq!(thousands(999), "999");
        assert_eq!(thousands(1_000), "1,000");
        assert_eq!(thousands(u64::MAX), "18,446,744,073,709,551,615");
        assert_eq!(decimal(0.9996), "1.000");
        assert_eq!(decimal(-0.0001), "0.000");
        assert_eq!(decimal(f64::NAN), NOTHING);
        assert_eq!(milliseconds(1_234_005), "1,234.005");
        assert_eq!(mebibytes(1_572_864), "1.5");
        assert_eq!(mebibytes(u64::MAX), "17,592,186,044,415.9");
    }

    #[test]
    fn every_definition_has_its_measure() {
        let shown: Vec<&str> = MEASURES.iter().flat_map(|measure| measure.keys.iter().copied()).collect();
        let defined: Vec<&str> =
            crate::evaluation::definitions::DEFINITIONS.iter().map(|&(key, _)| key).collect();
        assert_eq!(shown, defined);
    }

    #[test]
    fn nothing_counted_is_a_dash() {
        let empty = Proportion { successes: 0, n: 0, rate: 0.0, low: 0.0, high: 1.0 };
        assert_eq!(proportion(Some(&empty)), NOTHING);
        assert_eq!(proportion(None), NOTHING);
    }
}
