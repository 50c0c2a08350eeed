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
//! | any that ends in `_visible` | the places in view, separated by spaces |
//!
//! A `reliable` or `usable` of 0 leaves a row unscored, and so does an empty cell of a column that ends in
//! `_visible`: a frame that shows none of the named places may have been taken anywhere, so that nothing
//! is said of it. A table may have several file columns instead (`place, summer, winter`): whoever reads
//! it names the one that is meant.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::hash::Hash;
use std::path::{Path, PathBuf};

use super::error::{GroundTruthError, listed};
use super::file::{self, MAX_FRAMES};
use super::{Spot, position};

/// Most values in a table.
const MAX_VALUES: usize = 4_000_000;
/// Most places that one frame shows.
const MAX_PLACES: usize = 1000;
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
    /// Which earlier frames show the same place.
    Earlier {
        /// For each row the rows of those frames; sorted.
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
        Self::parse(path, &file::read_text(path)?)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, GroundTruthError> {
        let refused = |reason: String| Err(GroundTruthError::malformed(path, reason));
        // Separators within quotes count too, which only matters to a table as large as that.
        if text.bytes().filter(|byte| matches!(byte, b',' | b'\n' | b'\r')).count() > MAX_VALUES {
            return refused(format!("more than {MAX_VALUES} values; keep fewer columns or frames"));
        }
        let mut reader =
            csv::ReaderBuilder::new().flexible(true).trim(csv::Trim::All).from_reader(text.as_bytes());
        let malformed = |error: csv::Error| GroundTruthError::malformed(path, error.to_string());
        let columns: Vec<String> = reader.headers().map_err(malformed)?.iter().map(str::to_owned).collect();
        let mut named = HashSet::new();
        if let Some(twice) = columns.iter().find(|name| !name.is_empty() && !named.insert(name.as_str())) {
            return refused(format!("column `{twice}` stands twice in the header; keep one"));
        }
        let mut rows = Vec::new();
        let mut lines = Lines { text, byte: 0, line: 1 };
        for record in reader.records() {
            let record = record.map_err(malformed)?;
            let line = lines.of(record.position().map_or(0, csv::Position::byte));
            rows.push(TableRow { line, values: record.iter().map(str::to_owned).collect() });
        }
        let ragged = rows.iter().filter(|row| row.values.len() != columns.len()).map(|row| row.line);
        let ragged: Vec<u64> = ragged.collect();
        if !ragged.is_empty() {
            let reason = format!("not {} values as in the header", columns.len());
            return Err(GroundTruthError::rows(path, ragged, reason));
        }
        if rows.is_empty() {
            return refused("no rows below the header".to_owned());
        }
        if rows.len() > MAX_FRAMES {
            return refused(file::too_many_frames());
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
            let reason = format!("no column `{name}`; there are {}", listed(&self.columns));
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
                listed(&self.columns)
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
        self.refuse_repeated(&files)?;
        Ok(files)
    }

    /// Fails with the rows whose file an earlier row has too, if there are any.
    fn refuse_repeated<T: Eq + Hash>(&self, files: &[T]) -> Result<(), GroundTruthError> {
        let mut first = HashMap::new();
        for (index, file) in files.iter().enumerate() {
            first.entry(file).or_insert(index);
        }
        self.refuse_rows("the file stands in an earlier row already", |index| first[&files[index]] != index)
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
        let is_scored = self.are_scored()?;
        if let Some(column) = self.find_column("same_place_as") {
            return Ok(TableSpots::Earlier { rows: self.earlier(column)?, is_scored });
        }
        let spots = self.spots_of_all_rows(as_ordinals)?.into_iter().zip(is_scored);
        Ok(TableSpots::Spots(
            spots.map(|(spot, is_scored)| if is_scored { spot } else { Spot::Unscored }).collect(),
        ))
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

    /// Which rows are to be scored.
    fn are_scored(&self) -> Result<Vec<bool>, GroundTruthError> {
        let mut are_scored = vec![true; self.rows.len()];
        for name in SCORED_COLUMNS {
            let Some(column) = self.find_column(name) else { continue };
            self.refuse_rows(&format!("`{name}` is neither 0 nor 1"), |index| {
                !matches!(self.rows[index].values[column].as_str(), "0" | "1")
            })?;
            for (is_scored, row) in are_scored.iter_mut().zip(&self.rows) {
                *is_scored &= row.values[column] == "1";
            }
        }
        Ok(are_scored)
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
            return if as_ordinals { self.ordinals(column) } else { Ok(self.named_places(column)) };
        }
        if let Some(column) = self.columns.iter().position(|name| name.ends_with("_visible")) {
            return self.places_in_view(column);
        }
        let reason = format!(
            "none of the columns {} says where a frame was taken; see `loci evaluate --help`",
            listed(&self.columns)
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

    /// A place a row by its whole name, which may have several words.
    fn named_places(&self, column: usize) -> Vec<Spot> {
        let mut numbers = PlaceNumbers::default();
        self.rows.iter().map(|row| Spot::Places(vec![numbers.of(&row.values[column])])).collect()
    }

    /// The places that each row lists, separated by spaces; nothing is said of a row that lists none.
    fn places_in_view(&self, column: usize) -> Result<Vec<Spot>, GroundTruthError> {
        let names = |index: usize| self.rows[index].values[column].split_whitespace();
        let reason = format!("`{}` has more than {MAX_PLACES} places", self.columns[column]);
        self.refuse_rows(&reason, |index| names(index).nth(MAX_PLACES).is_some())?;
        let mut numbers = PlaceNumbers::default();
        let spot = |index| {
            let mut places: Vec<u32> = names(index).map(|name| numbers.of(name)).collect();
            places.sort_unstable();
            places.dedup();
            if places.is_empty() { Spot::Unscored } else { Spot::Places(places) }
        };
        Ok((0..self.rows.len()).map(spot).collect())
    }

    /// For each row the rows of the files that `same_place_as` names.
    fn earlier(&self, column: usize) -> Result<Vec<Vec<u32>>, GroundTruthError> {
        let file_column = self.file_column(None)?;
        let files: Vec<&str> = self.rows.iter().map(|row| row.values[file_column].as_str()).collect();
        self.refuse_repeated(&files)?;
        let row_of: HashMap<&str, u32> = files.into_iter().zip(0..).collect();
        let names = |index: usize| self.rows[index].values[column].split_whitespace();
        self.refuse_rows("`same_place_as` names a file that has no row", |index| {
            names(index).any(|name| !row_of.contains_key(name))
        })?;
        self.refuse_rows("`same_place_as` names a file that is not earlier", |index| {
            names(index).any(|name| row_of[name] as usize >= index)
        })?;
        let earlier = |index| {
            let mut rows: Vec<u32> = names(index).map(|name| row_of[name]).collect();
            rows.sort_unstable();
            rows.dedup();
            rows
        };
        Ok((0..self.rows.len()).map(earlier).collect())
    }
}

/// Counts the lines of a table as an editor does. The reader has not yet passed the rest of the line
/// before, nor empty lines, where it says that a record begins.
struct Lines<'a> {
    text: &'a str,
    byte: usize,
    line: u64,
}

impl Lines<'_> {
    /// The line of the record that begins at `byte` or after line breaks; records come in order.
    fn of(&mut self, byte: u64) -> u64 {
        let bytes = self.text.as_bytes();
        let from = usize::try_from(byte).unwrap_or(bytes.len()).clamp(self.byte, bytes.len());
        let breaks = bytes[from..].iter().take_while(|byte| matches!(byte, b'\n' | b'\r')).count();
        let passed = &bytes[self.byte..from + breaks];
        self.line += passed.iter().filter(|&&byte| byte == b'\n').count() as u64;
        self.byte = from + breaks;
        self.line
    }
}

/// Places, numbered by their first appearance.
#[derive(Default)]
struct PlaceNumbers<'a>(BTreeMap<&'a str, u32>);

impl<'a> PlaceNumbers<'a> {
    fn of(&mut self, name: &'a str) -> u32 {
        let next = self.0.len() as u32;
        *self.0.entry(name).or_insert(next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn parse(text: &str) -> Result<Table, GroundTruthError> {
        Table::parse(Path::new("truth.csv"), text)
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
    fn lines_are_counted_as_an_editor_does_whatever_ends_them() {
        let unix = "\nfile,place\na.jpg,1\n\nb.jpg,\"1\n2\"\n\n\nc.jpg,2\n";
        for text in [unix.to_owned(), unix.replace('\n', "\r\n")] {
            let lines: Vec<u64> = parse(&text).unwrap().rows().iter().map(|row| row.line).collect();
            assert_eq!(lines, [3, 5, 9], "{text:?}");
        }
    }

    #[test]
    fn a_table_that_says_nothing_about_places_is_refused_with_its_columns() {
        let message = error(spots("file,mood\na.jpg,good\n"));
        assert!(message.starts_with("truth.csv: none of the columns file, mood says"), "{message}");
        assert_eq!(error(parse("file,place\n")), "truth.csv: no rows below the header");
    }

    #[test]
    fn buildings_in_view_are_a_set_and_nothing_is_said_where_none_is_named() {
        let read = spots("image,building_ids_visible\na.jpg,id6\nb.jpg,id7 id6\nc.jpg,\n").unwrap();
        assert_eq!(read, [Spot::Places(vec![0]), Spot::Places(vec![0, 1]), Spot::Unscored]);
        let many = (0..=MAX_PLACES).map(|place| place.to_string()).collect::<Vec<_>>().join(" ");
        let text = format!("image,ids_visible\na.jpg,1\nb.jpg,{many}\n");
        assert_eq!(error(spots(&text)), "truth.csv, row 3: `ids_visible` has more than 1000 places");
    }

    #[test]
    fn the_name_of_a_place_may_have_several_words() {
        let read = spots("file,place\na.jpg,north dock\nb.jpg,south dock\nc.jpg,north dock\n").unwrap();
        assert_eq!(read, [0, 1, 0].map(|place| Spot::Places(vec![place])));
    }

    #[test]
    fn earlier_frames_are_rows_and_must_be_earlier() {
        let table = parse("file,same_place_as\na.jpg,\nb.jpg,\nc.jpg,b.jpg a.jpg\n").unwrap();
        let TableSpots::Earlier { rows, is_scored } = table.spots(false).unwrap() else { panic!("loops") };
        assert_eq!((rows, is_scored), (vec![vec![], vec![], vec![0, 1]], vec![true; 3]));
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

    #[test]
    fn rows_of_listed_files_may_be_unreliable_too() {
        let text = "file,same_place_as,reliable,usable\na.jpg,,1,1\nb.jpg,a.jpg,0,1\nc.jpg,a.jpg,1,0\n";
        let TableSpots::Earlier { rows, is_scored } = parse(text).unwrap().spots(false).unwrap() else {
            panic!("loops")
        };
        assert_eq!((rows.len(), is_scored), (3, vec![true, false, false]));
        assert_eq!(
            error(parse(&text.replace("1,0\n", "1,yes\n")).unwrap().spots(false)),
            "truth.csv, row 4: `usable` is neither 0 nor 1"
        );
        let twice = parse("file,same_place_as\na.jpg,\na.jpg,\nb.jpg,a.jpg\n").unwrap();
        assert_eq!(error(twice.spots(false)), "truth.csv, row 3: the file stands in an earlier row already");
    }

    #[test]
    fn a_table_may_begin_with_a_byte_order_mark() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.csv");
        fs::write(&path, "\u{feff}file,place\r\na.jpg,1\r\n").unwrap();
        let table = Table::read(&path).unwrap();
        assert_eq!((table.file_column(None).unwrap(), table.rows()[0].line), (0, 2));
    }

    #[test]
    fn a_table_is_bounded_and_has_each_column_once() {
        let wide = ",".repeat(MAX_VALUES + 1);
        assert!(error(parse(&wide)).contains("more than 4000000 values"));
        let long = format!("file\n{}", "a\n".repeat(MAX_FRAMES + 1));
        assert!(error(parse(&long)).contains("more than 1000000 frames"));
        assert_eq!(
            error(parse("file,place,place\na.jpg,1,2\n")),
            "truth.csv: column `place` stands twice in the header; keep one"
        );
    }
}
