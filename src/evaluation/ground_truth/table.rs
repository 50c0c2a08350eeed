//! Ground truth as a table: a CSV file with a row a frame.
//!
//! The files stand in column `file` or `image`, relative to the table, and where each frame was taken in
//! the first of these that there is:
//!
//! | Column | What it holds |
//! |---|---|
//! | `same_place_as` | earlier files of the same place, separated by spaces |
//! | `lap_phase` | share of a lap, from 0 to below 1 |
//! | `easting`, `northing` | position in metres |
//! | `latitude`, `longitude` | position in degrees |
//! | `place` | name or number of the place |
//! | any that ends in `_visible` | the places in view, separated by spaces; without any the row is not scored |
//!
//! A `reliable` or `usable` of 0 leaves a row unscored. A table may have several file columns instead
//! (`place, summer, winter`): whoever reads it names the one that is meant.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use super::error::GroundTruthError;
use super::{Spot, file, position};

/// Most values in a table, which take far more memory than their commas.
const MAX_VALUES: usize = 8 << 20;
/// Names of the column that holds the files.
const FILE_COLUMNS: [&str; 2] = ["file", "image"];
/// Columns whose 0 leaves a row unscored.
const SCORED_COLUMNS: [&str; 2] = ["reliable", "usable"];

/// A ground-truth table.
#[derive(Clone, Debug)]
pub struct Table {
    path: PathBuf,
    columns: Vec<String>,
    rows: Vec<TableRow>,
}

/// One row.
#[derive(Clone, Debug, PartialEq)]
pub struct TableRow {
    /// The line on which it stands, from 1.
    pub line: u64,
    /// The value of each column.
    pub values: Vec<String>,
}

/// What a table says where a frame was taken.
pub enum TableSpots {
    /// A spot a row.
    Spots(Vec<Spot>),
    /// For each row the rows of earlier frames of the same place; sorted.
    Earlier {
        /// The rows.
        rows: Vec<Vec<u32>>,
        /// Whether anything is said about each row.
        is_scored: Vec<bool>,
    },
}

impl Table {
    /// Reads the table at `path`.
    ///
    /// # Errors
    /// If it cannot be read or its rows are not all as long as its header.
    pub fn read(path: &Path) -> Result<Self, GroundTruthError> {
        Self::parse(path, &file::read(path, file::MAX_TABLE_BYTES)?)
    }

    fn parse(path: &Path, bytes: &[u8]) -> Result<Self, GroundTruthError> {
        let mut reader = csv::ReaderBuilder::new().flexible(true).trim(csv::Trim::All).from_reader(bytes);
        let malformed = |error: csv::Error| GroundTruthError::malformed(path, error.to_string());
        let columns: Vec<String> = reader.headers().map_err(malformed)?.iter().map(str::to_owned).collect();
        let (mut rows, mut values) = (Vec::new(), 0);
        for record in reader.records() {
            let record = record.map_err(malformed)?;
            values += record.len();
            if values > MAX_VALUES {
                let reason = format!("it has more than {MAX_VALUES} values; is it the right table?");
                return Err(GroundTruthError::malformed(path, reason));
            }
            let line = record.position().map_or(0, csv::Position::line);
            rows.push(TableRow { line, values: record.iter().map(str::to_owned).collect() });
        }
        let ragged = rows.iter().filter(|row| row.values.len() != columns.len()).map(|row| row.line);
        let ragged: Vec<u64> = ragged.collect();
        if !ragged.is_empty() {
            let reason = format!("not {} values as in the header", columns.len());
            return Err(GroundTruthError::rows(path, ragged, reason));
        }
        if rows.is_empty() {
            return Err(GroundTruthError::malformed(path, "no rows below the header"));
        }
        Ok(Self { path: path.to_owned(), columns, rows })
    }

    /// The file it was read from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its rows.
    #[must_use]
    pub fn rows(&self) -> &[TableRow] {
        &self.rows
    }

    /// Position of the column called `name`.
    ///
    /// # Errors
    /// If there is none; the error lists those there are.
    pub fn column(&self, name: &str) -> Result<usize, GroundTruthError> {
        self.find_column(name).ok_or_else(|| {
            let reason = format!("no column `{name}`; there are {}", self.columns.join(", "));
            GroundTruthError::malformed(&self.path, reason)
        })
    }

    fn find_column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    /// The column that holds the files: the one called `named`, or `file` or `image`.
    ///
    /// # Errors
    /// If there is none.
    pub fn file_column(&self, named: Option<&str>) -> Result<usize, GroundTruthError> {
        if let Some(name) = named {
            return self.column(name);
        }
        FILE_COLUMNS.iter().find_map(|name| self.find_column(name)).ok_or_else(|| {
            let reason = format!(
                "no column `file` or `image`; name one of {} with files=COLUMN",
                self.columns.join(", ")
            );
            GroundTruthError::malformed(&self.path, reason)
        })
    }

    /// The image files of a column, a path a row.
    ///
    /// # Errors
    /// If rows name no file, one that does not exist, or the same as another row.
    pub fn files(&self, column: usize) -> Result<Vec<PathBuf>, GroundTruthError> {
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let files: Vec<PathBuf> = self.rows.iter().map(|row| folder.join(&row.values[column])).collect();
        self.refuse_rows("the file does not exist", |index| !files[index].is_file())?;
        let mut first = HashMap::new();
        for (index, file) in files.iter().enumerate() {
            first.entry(file).or_insert(index);
        }
        self.refuse_rows("the file stands in an earlier row already", |index| first[&files[index]] != index)?;
        Ok(files)
    }

    /// Fails with the rows, by index, about which `is_wrong` holds, if there are any.
    fn refuse_rows(&self, reason: &str, is_wrong: impl Fn(usize) -> bool) -> Result<(), GroundTruthError> {
        let wrong = (0..self.rows.len()).filter(|&index| is_wrong(index));
        let lines: Vec<u64> = wrong.map(|index| self.rows[index].line).collect();
        if lines.is_empty() { Ok(()) } else { Err(GroundTruthError::rows(&self.path, lines, reason)) }
    }

    /// Numbers of a column.
    ///
    /// # Errors
    /// If rows hold something else.
    pub fn numbers(&self, column: usize) -> Result<Vec<f64>, GroundTruthError> {
        let parse = |row: &TableRow| row.values[column].parse::<f64>().ok().filter(|value| value.is_finite());
        let numbers: Vec<Option<f64>> = self.rows.iter().map(parse).collect();
        let reason = format!("`{}` is not a number", self.columns[column]);
        self.refuse_rows(&reason, |index| numbers[index].is_none())?;
        Ok(numbers.into_iter().flatten().collect())
    }

    /// Where each row's frame was taken. With `as_ordinals`, places are numbers along a route.
    ///
    /// # Errors
    /// If rows are wrong, or no column says it.
    pub fn spots(&self, as_ordinals: bool) -> Result<TableSpots, GroundTruthError> {
        let is_scored = self.scored_rows()?;
        if let Some(column) = self.find_column("same_place_as") {
            return Ok(TableSpots::Earlier { rows: self.earlier(column)?, is_scored });
        }
        let mut spots = self.spots_of_all_rows(as_ordinals)?;
        for (spot, _) in spots.iter_mut().zip(is_scored).filter(|(_, is_scored)| !is_scored) {
            *spot = Spot::Unscored;
        }
        Ok(TableSpots::Spots(spots))
    }

    /// Where each row's frame was taken, in metres.
    ///
    /// # Errors
    /// If rows are wrong, or no columns say it.
    pub fn positions_metres(&self) -> Result<Vec<[f64; 2]>, GroundTruthError> {
        let at = |spot| match spot {
            Spot::Metres(at) => Some(at),
            _ => None,
        };
        let positions: Option<Vec<[f64; 2]>> = self.spots_of_all_rows(false)?.into_iter().map(at).collect();
        positions.ok_or_else(|| {
            let reason = "a spacing needs the columns easting and northing, or latitude and longitude";
            GroundTruthError::malformed(&self.path, reason)
        })
    }

    /// Whether anything is said about each row.
    fn scored_rows(&self) -> Result<Vec<bool>, GroundTruthError> {
        let mut is_scored = vec![true; self.rows.len()];
        for name in SCORED_COLUMNS {
            let Some(column) = self.find_column(name) else { continue };
            self.refuse_rows(&format!("`{name}` is neither 0 nor 1"), |index| {
                !matches!(self.rows[index].values[column].as_str(), "0" | "1")
            })?;
            for (is_scored, row) in is_scored.iter_mut().zip(&self.rows) {
                *is_scored &= row.values[column] != "0";
            }
        }
        Ok(is_scored)
    }

    fn spots_of_all_rows(&self, as_ordinals: bool) -> Result<Vec<Spot>, GroundTruthError> {
        if let Some(column) = self.find_column("lap_phase") {
            let phases = self.numbers(column)?;
            self.refuse_rows("`lap_phase` is not in [0, 1)", |i| !(0.0..1.0).contains(&phases[i]))?;
            return Ok(phases.into_iter().map(Spot::LapPhase).collect());
        }
        if let (Some(east), Some(north)) = (self.find_column("easting"), self.find_column("northing")) {
            let pairs = self.numbers(east)?.into_iter().zip(self.numbers(north)?);
            return Ok(pairs.map(|(east, north)| Spot::Metres([east, north])).collect());
        }
        if let (Some(lat), Some(lon)) = (self.find_column("latitude"), self.find_column("longitude")) {
            return self.degrees(lat, lon);
        }
        if let Some(column) = self.find_column("place") {
            self.refuse_rows("`place` is empty", |i| self.rows[i].values[column].is_empty())?;
            return if as_ordinals { self.ordinals(column) } else { Ok(self.places(column)) };
        }
        if let Some(column) = self.columns.iter().position(|name| name.ends_with("_visible")) {
            return Ok(self.places(column));
        }
        let reason = format!(
            "none of the columns {} says where a frame was taken; see `loci evaluate --help`",
            self.columns.join(", ")
        );
        Err(GroundTruthError::malformed(&self.path, reason))
    }

    fn degrees(&self, latitude: usize, longitude: usize) -> Result<Vec<Spot>, GroundTruthError> {
        let (latitudes, longitudes) = (self.numbers(latitude)?, self.numbers(longitude)?);
        self.refuse_rows("`latitude` is not in [-90, 90]", |i| latitudes[i].abs() > 90.0)?;
        self.refuse_rows("`longitude` is not in [-180, 180]", |i| longitudes[i].abs() > 180.0)?;
        let origin = [latitudes[0], longitudes[0]];
        let pairs = latitudes.into_iter().zip(longitudes);
        Ok(pairs.map(|(lat, lon)| Spot::Metres(position::metres_from_degrees(lat, lon, origin))).collect())
    }

    fn ordinals(&self, column: usize) -> Result<Vec<Spot>, GroundTruthError> {
        let numbers: Vec<Option<i64>> = self.rows.iter().map(|row| row.values[column].parse().ok()).collect();
        self.refuse_rows("`place` is not a whole number, which a tolerance between places needs", |i| {
            numbers[i].is_none()
        })?;
        Ok(numbers.into_iter().flatten().map(Spot::Ordinal).collect())
    }

    /// Places by name, several to a row separated by spaces; numbered by their first appearance.
    fn places(&self, column: usize) -> Vec<Spot> {
        let mut numbers: BTreeMap<&str, u32> = BTreeMap::new();
        let mut spots = Vec::with_capacity(self.rows.len());
        for row in &self.rows {
            let mut places = Vec::new();
            for name in row.values[column].split_whitespace() {
                let next = numbers.len() as u32;
                places.push(*numbers.entry(name).or_insert(next));
            }
            places.sort_unstable();
            spots.push(if places.is_empty() { Spot::Unscored } else { Spot::Places(places) });
        }
        spots
    }

    /// For each row the rows of the files that `same_place_as` names.
    fn earlier(&self, column: usize) -> Result<Vec<Vec<u32>>, GroundTruthError> {
        let files = self.file_column(None)?;
        let row_of: HashMap<&str, u32> =
            (0..).zip(&self.rows).map(|(index, row)| (row.values[files].as_str(), index)).collect();
        let named = |row: &TableRow| -> Vec<Option<u32>> {
            row.values[column].split_whitespace().map(|name| row_of.get(name).copied()).collect()
        };
        let named: Vec<Vec<Option<u32>>> = self.rows.iter().map(named).collect();
        self.refuse_rows("`same_place_as` names a file that has no row", |i| named[i].contains(&None))?;
        self.refuse_rows("`same_place_as` names a file that is not earlier", |index| {
            named[index].iter().flatten().any(|&earlier| earlier as usize >= index)
        })?;
        let sorted = |row: Vec<Option<u32>>| {
            let mut row: Vec<u32> = row.into_iter().flatten().collect();
            row.sort_unstable();
            row.dedup();
            row
        };
        Ok(named.into_iter().map(sorted).collect())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn parse(text: &str) -> Result<Table, GroundTruthError> {
        Table::parse(Path::new("truth.csv"), text.as_bytes())
    }

    fn spots(text: &str) -> Result<Vec<Spot>, GroundTruthError> {
        match parse(text)?.spots(false)? {
            TableSpots::Spots(spots) => Ok(spots),
            TableSpots::Earlier { .. } => panic!("{text} has spots"),
        }
    }

    fn error<T>(result: Result<T, GroundTruthError>) -> String {
        result.err().expect("an error").to_string()
    }

    #[test]
    fn laps_are_read_and_unreliable_rows_left_unscored() {
        let read = spots("file,lap_phase,reliable\na.jpg,0.25,1\nb.jpg,0.5,0\n").unwrap();
        assert_eq!(read, [Spot::LapPhase(0.25), Spot::Unscored]);
    }

    #[test]
    fn wrong_rows_are_named_by_their_lines() {
        let text = "file,lap_phase,reliable\na.jpg,0.25,1\nb.jpg,1.0,1\nc.jpg,-0.1,1\n";
        assert_eq!(error(spots(text)), "truth.csv, rows 3, 4: `lap_phase` is not in [0, 1)");
        let text = "file,lap_phase,reliable\na.jpg,0.25,1\nb.jpg,0.1,maybe\n";
        assert_eq!(error(spots(text)), "truth.csv, row 3: `reliable` is neither 0 nor 1");
        let text = "file,easting,northing\na.jpg,1,2\nb.jpg,1,north\n";
        assert_eq!(error(spots(text)), "truth.csv, row 3: `northing` is not a number");
        assert_eq!(
            error(parse("file,place\na.jpg,1\nb.jpg\n")),
            "truth.csv, row 3: not 2 values as in the header"
        );
        assert_eq!(error(spots("file,place\na.jpg,\n")), "truth.csv, row 2: `place` is empty");
    }

    #[test]
    fn a_table_that_says_nothing_about_places_is_refused_with_its_columns() {
        let message = error(spots("file,mood\na.jpg,good\n"));
        assert!(message.starts_with("truth.csv: none of the columns file, mood says"), "{message}");
        assert_eq!(error(parse("file,place\n")), "truth.csv: no rows below the header");
    }

    #[test]
    fn buildings_in_view_are_a_set_that_may_be_empty() {
        let read = spots("image,building_ids_visible\na.jpg,id6\nb.jpg,id7 id6\nc.jpg,\n").unwrap();
        assert_eq!(read, [Spot::Places(vec![0]), Spot::Places(vec![0, 1]), Spot::Unscored]);
    }

    #[test]
    fn earlier_frames_are_rows_and_must_be_earlier() {
        let table = parse("file,same_place_as\na.jpg,\nb.jpg,\nc.jpg,b.jpg a.jpg\n").unwrap();
        let TableSpots::Earlier { rows, .. } = table.spots(false).unwrap() else { panic!("loops") };
        assert_eq!(rows, [vec![], vec![], vec![0, 1]]);
        let usable = parse("file,usable,same_place_as\na.jpg,1,\nb.jpg,0,a.jpg\n").unwrap();
        let TableSpots::Earlier { is_scored, .. } = usable.spots(false).unwrap() else { panic!("loops") };
        assert_eq!(is_scored, [true, false]);
        let shifted = parse("file,same_place_as\na.jpg,\nb.jpg,c.jpg\nc.jpg,\n").unwrap();
        assert_eq!(
            error(shifted.spots(false)),
            "truth.csv, row 3: `same_place_as` names a file that is not earlier"
        );
        let unknown = parse("file,same_place_as\na.jpg,\nb.jpg,z.jpg\n").unwrap();
        assert_eq!(
            error(unknown.spots(false)),
            "truth.csv, row 3: `same_place_as` names a file that has no row"
        );
    }

    #[test]
    fn files_must_exist_and_stand_in_one_row_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.csv");
        fs::write(folder.path().join("a.jpg"), b"").unwrap();
        fs::write(&path, "file,place\na.jpg,1\nb.jpg,1\n").unwrap();
        let message = error(Table::read(&path).and_then(|table| table.files(0)));
        assert!(message.ends_with("row 3: the file does not exist"), "{message}");
        fs::write(&path, "file,place\na.jpg,1\na.jpg,2\n").unwrap();
        let message = error(Table::read(&path).and_then(|table| table.files(0)));
        assert!(message.ends_with("row 3: the file stands in an earlier row already"), "{message}");
    }

    #[test]
    fn numbered_places_may_count_as_ordinals() {
        let table = parse("file,place\na.jpg,3\nb.jpg,4\n").unwrap();
        let TableSpots::Spots(spots) = table.spots(true).unwrap() else { panic!("spots") };
        assert_eq!(spots, [Spot::Ordinal(3), Spot::Ordinal(4)]);
        let named = parse("file,place\na.jpg,dock\n").unwrap();
        assert!(error(named.spots(true)).contains("row 2: `place` is not a whole number"));
    }
}
