//! FAB-MAP's City Centre and New College (Cummins and Newman, IJRR 2008): `Images/0001.jpg` and on, the
//! left camera's odd and the right one's even, with a loop matrix over all of them.

use std::path::{Path, PathBuf};

use super::{
    Camera, Layout, LayoutError, LayoutOptions, LayoutTraverse, Rule, different, refuse_spacing, unplaced,
};
use crate::evaluation::ground_truth::LoopMatrix;
use crate::source::image_files;

/// Where the matrix may lie.
const TRUTH_FOLDERS: [&str; 3] = ["", "masks", ".."];
const EXTENSIONS: [&str; 3] = ["mat", "txt", "csv"];

pub(super) fn read(
    layout: Layout,
    folder: &Path,
    options: &LayoutOptions,
) -> Result<LayoutTraverse, LayoutError> {
    refuse_spacing(layout, options)?;
    let files = image_files(&folder.join("Images")).or_else(|_| image_files(folder))?;
    let set = if layout == Layout::NewCollege { "NewCollege" } else { "CityCentre" };
    let path = truth_file(folder, set)
        .ok_or_else(|| different(layout, folder, format!("no {set}GroundTruth.mat in it or in masks/")))?;
    let matrix = LoopMatrix::read(&path)?;
    let first = match options.camera.unwrap_or_default() {
        Camera::Left => 0,
        Camera::Right => 1,
    };
    let one_camera = files.len().saturating_sub(first as usize).div_ceil(2);
    let loops = if matrix.rows() == files.len() {
        matrix.every_second(first)
    } else if matrix.rows() == one_camera {
        matrix
    } else {
        let (rows, images) = (matrix.rows(), files.len());
        let reason = format!(
            "its ground truth has {rows} rows for {images} images of both cameras, {one_camera} of one"
        );
        return Err(different(layout, folder, reason));
    };
    let files = files.into_iter().skip(first as usize).step_by(2).collect();
    Ok(LayoutTraverse { loops: Some((path, loops)), rule: Rule::Loops, ..unplaced(files) })
}

fn truth_file(folder: &Path, set: &str) -> Option<PathBuf> {
    let file = |folder: PathBuf, extension: &str| folder.join(format!("{set}GroundTruth.{extension}"));
    TRUTH_FOLDERS
        .iter()
        .flat_map(|name| EXTENSIONS.iter().map(move |extension| file(folder.join(name), extension)))
        .find(|path| path.is_file())
}
