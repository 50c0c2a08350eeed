//! Ground truths as data sets publish them: loop matrices, tables, positions.

use std::path::Path;

use loci::evaluation::ground_truth::{LoopMatrix, RowFilter, Table};
use loci::evaluation::layout::{self, Images, Layout, LayoutOptions};

use super::accepted;
use super::folder::{folder, write};

/// Choices of rows that are made of every table.
const FILTERS: [&str; 3] = ["place=dock", "lap=..1", "light=25%..75%"];
/// Most images that a traverse is given.
const MAX_IMAGES: usize = 8;

/// MATLAB, NumPy and text, told apart by content; [`LoopMatrix::read`].
pub fn loop_matrix(bytes: &[u8]) {
    let here = folder();
    let name = match bytes {
        _ if bytes.starts_with(b"\x93NUMPY") => "truth.npy",
        _ if is_mat(bytes) => "truth.mat",
        _ => "truth.csv",
    };
    let Some(matrix) = accepted(LoopMatrix::read(&write(here.path(), name, bytes))) else { return };
    for row in 0..matrix.rows() {
        let matches = matrix.matches(row);
        assert!(matches.is_sorted());
        let last = matches.last().map_or(0, |&column| column as usize);
        assert!(matches.is_empty() || matrix.columns().is_none_or(|columns| last < columns));
    }
    let every_second = [0, 1].map(|first| matrix.every_second(first).rows());
    assert_eq!(every_second.iter().sum::<usize>(), matrix.rows());
}

fn is_mat(bytes: &[u8]) -> bool {
    bytes.get(126..128).is_some_and(|mark| mark == b"IM" || mark == b"MI")
}

/// A CSV table, [`Table::read`], and all that is asked of one.
pub fn truth_table(bytes: &[u8]) {
    let here = folder();
    let Some(table) = accepted(Table::read(&write(here.path(), "truth.csv", bytes))) else { return };
    if let Some(column) = accepted(table.file_column(None)) {
        accepted(table.files(column));
    }
    let columns = table.rows().first().map_or(0, |row| row.values.len());
    for column in 0..columns {
        let numbers = accepted(table.numbers(column));
        assert!(numbers.is_none_or(|numbers| numbers.len() == table.rows().len()));
    }
    accepted(table.spots(false));
    accepted(table.spots(true));
    accepted(table.positions_metres());
    for filter in FILTERS {
        let filter: RowFilter = filter.parse().expect("a filter");
        let chosen = accepted(filter.choose(&table));
        assert!(chosen.is_none_or(|rows| rows.iter().all(|&row| row < table.rows().len())));
    }
}

/// The positions beside the images of KITTI and St Lucia, as text or MATLAB; [`layout::read`].
pub fn layout(bytes: &[u8]) {
    let here = folder();
    let lines = bytes.split(|&byte| byte == b'\n').filter(|line| !line.trim_ascii().is_empty()).count();
    let camera = here.path().join("image_0");
    std::fs::create_dir(&camera).expect("a folder");
    for image in 0..lines.clamp(1, MAX_IMAGES) {
        write(&camera, &format!("{image}.png"), b"");
        write(here.path(), &format!("{image}.png"), b"");
    }
    if is_mat(bytes) {
        write(here.path(), "fGPS.mat", bytes);
    } else {
        write(here.path(), "fGPS.txt", bytes);
        write(here.path(), "poses.txt", bytes);
        read_layout(Layout::Kitti, here.path());
    }
    read_layout(Layout::StLucia, here.path());
}

fn read_layout(layout: Layout, folder: &Path) {
    let Some(traverse) = accepted(layout::read(layout, folder, &LayoutOptions::default())) else { return };
    if let (Images::Files(files), Some(positions)) = (&traverse.images, &traverse.positions_metres) {
        assert_eq!(files.len(), positions.len());
    }
}
