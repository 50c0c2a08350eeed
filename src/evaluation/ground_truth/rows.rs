//! Which rows of a table make a traverse: `lap=1..2`, `mean_luminance=..30%`, `files=winter`.

use std::fmt;
use std::str::FromStr;

use super::error::GroundTruthError;
use super::table::Table;

/// A choice of rows: terms separated by commas, all of which must hold.
///
/// `COLUMN=VALUE` keeps rows with that value; `COLUMN=FROM..TO` those between two numbers, both
/// included, either left out; `COLUMN=FROM%..TO%` those between two percentiles of the rows of the same
/// `place`. `files=COLUMN` names the column that holds the files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowFilter {
    files: Option<String>,
    terms: Vec<(String, Condition)>,
    text: String,
}

#[derive(Clone, Debug, PartialEq)]
enum Condition {
    Equals(String),
    Between(f64, f64),
    /// Between two percentiles within each place.
    Percentiles(f64, f64),
}

/// A choice of rows that makes no sense.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("rows '{given}': {reason}; examples: lap=1..2 or place=dock or mean_luminance=..30%")]
pub struct RowFilterError {
    given: String,
    reason: &'static str,
}

impl FromStr for RowFilter {
    type Err = RowFilterError;

    fn from_str(text: &str) -> Result<Self, RowFilterError> {
        let error = |reason| RowFilterError { given: text.to_owned(), reason };
        let mut filter = Self { text: text.to_owned(), ..Self::default() };
        for term in text.split(',').filter(|term| !term.trim().is_empty()) {
            let (column, value) = term.split_once('=').ok_or_else(|| error("not COLUMN=VALUE"))?;
            let (column, value) = (column.trim().to_owned(), value.trim());
            if column == "files" {
                if value.is_empty() {
                    return Err(error("files= names no column"));
                }
                filter.files = Some(value.to_owned());
                continue;
            }
            let condition = match value.split_once("..") {
                None => Condition::Equals(value.to_owned()),
                Some(bounds) => range(bounds).ok_or_else(|| {
                    error("not a range of numbers from low to high, or of percentages from 0 to 100")
                })?,
            };
            filter.terms.push((column, condition));
        }
        Ok(filter)
    }
}

impl fmt::Display for RowFilter {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.text)
    }
}

fn range((from, to): (&str, &str)) -> Option<Condition> {
    let is_percent = from.ends_with('%') || to.ends_with('%');
    let bound = |text: &str, open: f64| match text.trim_end_matches('%') {
        "" => Some(open),
        number => number.parse::<f64>().ok().filter(|number| number.is_finite()),
    };
    let (from, to) = (bound(from, f64::NEG_INFINITY)?, bound(to, f64::INFINITY)?);
    let is_percentage = |bound: f64| !is_percent || bound.is_infinite() || (0.0..=100.0).contains(&bound);
    if from > to || !is_percentage(from) || !is_percentage(to) {
        return None;
    }
    Some(if is_percent { Condition::Percentiles(from, to) } else { Condition::Between(from, to) })
}

impl RowFilter {
    /// The column that holds the files, if one was named.
    #[must_use]
    pub fn files(&self) -> Option<&str> {
        self.files.as_deref()
    }

    /// The chosen rows of `table`, by index.
    ///
    /// # Errors
    /// If a column does not exist, holds no numbers where a range is asked for, or no row is left.
    pub fn choose(&self, table: &Table) -> Result<Vec<usize>, GroundTruthError> {
        let mut chosen: Vec<usize> = (0..table.rows().len()).collect();
        for (name, condition) in &self.terms {
            let column = table.column(name)?;
            match condition {
                Condition::Equals(value) => {
                    chosen.retain(|&row| table.rows()[row].values[column] == *value);
                }
                Condition::Between(from, to) => {
                    let numbers = table.numbers(column)?;
                    chosen.retain(|&row| (*from..=*to).contains(&numbers[row]));
                }
                Condition::Percentiles(from, to) => {
                    let ranks = percentiles_within_places(table, &table.numbers(column)?);
                    chosen.retain(|&row| *from <= ranks[row] && ranks[row] < *to);
                }
            }
        }
        if chosen.is_empty() {
            return Err(GroundTruthError::malformed(table.path(), format!("no row has {self}")));
        }
        Ok(chosen)
    }
}

/// For each row the percentage of the rows of its place that stand before it in the order of `numbers`.
fn percentiles_within_places(table: &Table, numbers: &[f64]) -> Vec<f64> {
    let place = table.column("place").ok();
    let place_of = |row: usize| place.map_or("", |column| table.rows()[row].values[column].as_str());
    let mut order: Vec<usize> = (0..numbers.len()).collect();
    order.sort_by(|&a, &b| {
        place_of(a).cmp(place_of(b)).then(numbers[a].total_cmp(&numbers[b])).then(a.cmp(&b))
    });
    let mut percentiles = vec![0.0; numbers.len()];
    for rows in order.chunk_by(|&a, &b| place_of(a) == place_of(b)) {
        for (position, &row) in rows.iter().enumerate() {
            percentiles[row] = 100.0 * position as f64 / rows.len() as f64;
        }
    }
    percentiles
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choose(filter: &str, csv: &str) -> Result<Vec<usize>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        std::fs::write(&path, csv).unwrap();
        let filter: RowFilter = filter.parse().map_err(|error: RowFilterError| error.to_string())?;
        filter.choose(&Table::read(&path).unwrap()).map_err(|error| error.to_string())
    }

    const LAPS: &str = "file,drive,lap\na,x,0\nb,x,1\nc,x,2\nd,y,1\n";

    #[test]
    fn rows_are_chosen_by_value_and_by_range_with_both_ends() {
        assert_eq!(choose("", LAPS).unwrap(), [0, 1, 2, 3]);
        assert_eq!(choose("drive=x,lap=1..2", LAPS).unwrap(), [1, 2]);
        assert_eq!(choose("lap=..1", LAPS).unwrap(), [0, 1, 3]);
        assert_eq!(choose("files=drive,lap=2..", LAPS).unwrap(), [2]);
    }

    #[test]
    fn percentiles_are_taken_within_each_place() {
        let table = "file,place,light\na,p,10\nb,p,40\nc,p,20\nd,p,30\ne,q,1\nf,q,2\n";
        assert_eq!(choose("light=50%..", table).unwrap(), [1, 3, 5]);
        assert_eq!(choose("light=..50%", table).unwrap(), [0, 2, 4]);
    }

    #[test]
    fn what_cannot_be_chosen_is_said() {
        assert!(choose("lap", LAPS).unwrap_err().contains("not COLUMN=VALUE"));
        assert!(choose("lap=one..2", LAPS).unwrap_err().contains("not a range of numbers"));
        for range in ["lap=2..1", "lap=..101%", "lap=-1%..", "lap=nan..2"] {
            assert!(choose(range, LAPS).unwrap_err().contains("not a range"), "{range}");
        }
        assert!(choose("files=", LAPS).unwrap_err().contains("names no column"));
        assert!(
            choose("speed=1", LAPS).unwrap_err().contains("no column `speed`; there are file, drive, lap")
        );
        assert!(choose("drive=1..2", LAPS).unwrap_err().contains("`drive` is not a number"));
        assert!(choose("drive=z", LAPS).unwrap_err().ends_with("no row has drive=z"));
    }
}
