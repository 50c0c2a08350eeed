//! Which rows of a table make a traverse: `lap=1..2`, `mean_luminance=..30%`, `files=winter`.

use std::fmt;
use std::str::FromStr;

use super::error::GroundTruthError;
use super::table::Table;

/// A choice of rows: terms separated by commas, all of which must hold.
///
/// `COLUMN=VALUE` keeps rows with that value; `COLUMN=FROM..TO` those between two numbers, both
/// included, either left out; `COLUMN=FROM%..TO%` those between two percentiles, from 0 to 100, of the
/// rows of the same `place`. `files=COLUMN` names the column that holds the files.
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
            if column.is_empty() {
                return Err(error("not COLUMN=VALUE"));
            }
            if column == "files" {
                if value.is_empty() || filter.files.is_some() {
                    return Err(error("files= names one column"));
                }
                filter.files = Some(value.to_owned());
                continue;
            }
            let condition = match value.split_once("..") {
                None => Condition::Equals(value.to_owned()),
                Some(bounds) => range(bounds).map_err(error)?,
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

fn range((from, to): (&str, &str)) -> Result<Condition, &'static str> {
    let is_percent = from.ends_with('%') || to.ends_with('%');
    let bound = |text: &str, open: f64| match text.strip_suffix('%').unwrap_or(text).parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ if text.is_empty() => Ok(open),
        _ => Err("not a range of numbers"),
    };
    let (least, most) = if is_percent { (0.0, 100.0) } else { (f64::NEG_INFINITY, f64::INFINITY) };
    let (from, to) = (bound(from, least)?, bound(to, most)?);
    if from.max(to) > most || from.min(to) < least {
        return Err("percentages are from 0 to 100");
    }
    if from > to {
        return Err("the range ends before it begins");
    }
    Ok(if is_percent { Condition::Percentiles(from, to) } else { Condition::Between(from, to) })
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
        assert!(choose("=1", LAPS).unwrap_err().contains("not COLUMN=VALUE"));
        for range in ["one..2", "nan..2", "..inf", "nan%..", "..%", "1%%..2%"] {
            let message = choose(&format!("lap={range}"), LAPS).unwrap_err();
            assert!(message.contains("not a range of numbers"), "{message}");
        }
        for range in ["-1%..30%", "..101%", "200%.."] {
            let message = choose(&format!("lap={range}"), LAPS).unwrap_err();
            assert!(message.contains("percentages are from 0 to 100"), "{message}");
        }
        for range in ["2..1", "50%..30%"] {
            let message = choose(&format!("lap={range}"), LAPS).unwrap_err();
            assert!(message.contains("the range ends before it begins"), "{message}");
        }
        for files in ["files=", "files=file,files=drive"] {
            assert!(choose(files, LAPS).unwrap_err().contains("files= names one column"));
        }
        assert!(
            choose("speed=1", LAPS).unwrap_err().contains("no column `speed`; there are file, drive, lap")
        );
        assert!(choose("drive=1..2", LAPS).unwrap_err().contains("`drive` is not a number"));
        assert!(choose("drive=z", LAPS).unwrap_err().ends_with("no row has drive=z"));
    }
}
