//! A sequence of KITTI odometry (Geiger, Lenz and Urtasun, CVPR 2012): `image_0/000000.png` and on, with
//! a line of twelve numbers a frame in the poses file: the upper three rows of a transform.
//!
//! The poses are those of the left grey camera; the right ones drive half a metre beside it.

use std::path::{Path, PathBuf};

use super::{Camera, Layout, LayoutError, LayoutOptions, LayoutTraverse, different, placed};
use crate::evaluation::ground_truth::{GroundTruthError, file};
use crate::source::image_files;

/// The folders of the left and the right cameras, grey ones first.
const LEFT: [&str; 2] = ["image_0", "image_2"];
const RIGHT: [&str; 2] = ["image_1", "image_3"];
/// Frames of one place lie within this, in metres.
const RADIUS_METRES: f64 = 10.0;

pub(super) fn read(folder: &Path, options: &LayoutOptions) -> Result<LayoutTraverse, LayoutError> {
    let different = |reason: String| different(Layout::Kitti, folder, reason);
    let cameras = match options.camera.unwrap_or_default() {
        Camera::Left => LEFT,
        Camera::Right => RIGHT,
    };
    let files = cameras.iter().find_map(|name| image_files(&folder.join(name)).ok());
    let files = files.ok_or_else(|| different(format!("no images in {}", cameras.join(" or "))))?;
    let path = poses_file(folder).ok_or_else(|| {
        different("no poses, neither poses.txt in it nor ../../poses/SEQUENCE.txt".to_owned())
    })?;
    let positions = positions(&path)?;
    if positions.len() != files.len() {
        return Err(different(format!("{} images but {} poses", files.len(), positions.len())));
    }
    Ok(placed(files, &positions, options.spacing_metres, RADIUS_METRES))
}

fn poses_file(folder: &Path) -> Option<PathBuf> {
    let folder = folder.canonicalize().ok()?;
    let name = format!("{}.txt", folder.file_name()?.to_string_lossy());
    let candidates = [folder.join("poses.txt"), folder.join(&name), folder.join("../../poses").join(&name)];
    candidates.into_iter().find(|path| path.is_file())
}

/// x and z of every pose: the ground plane of a camera that looks along z.
fn positions(path: &Path) -> Result<Vec<[f64; 2]>, GroundTruthError> {
    let text = file::read_text(path)?;
    let position = |line: &str| {
        let numbers: Vec<f64> = line.split_whitespace().map_while(|word| word.parse().ok()).collect();
        let is_whole = numbers.len() == 12 && numbers.iter().all(|number: &f64| number.is_finite());
        is_whole.then(|| [numbers[3], numbers[11]])
    };
    let lines = || (1_u64..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let wrong: Vec<u64> = lines().filter(|(_, line)| position(line).is_none()).map(|(row, _)| row).collect();
    if !wrong.is_empty() {
        return Err(GroundTruthError::rows(path, wrong, "not 12 numbers"));
    }
    Ok(lines().filter_map(|(_, line)| position(line)).collect())
}
