//! UQ St Lucia (Glover, Maddern, Milford and Wyeth, ICRA 2010): a folder a traverse, with a webcam video
//! or its frames and a GPS position a frame.
//!
//! `fGPS.txt` has a line `LATITUDE,LONGITUDE` a frame. Latitudes are southern; published files leave out
//! their sign. A few frames or positions may be left over at the end; more of them mean that the two do
//! not belong together.

use std::path::{Path, PathBuf};

use super::{
    Images, Layout, LayoutError, LayoutOptions, LayoutTraverse, Rule, different, images, kept, placed,
    refuse_camera,
};
use crate::evaluation::ground_truth::{GroundTruthError, file, position};
use crate::source::{FrameSource, VideoSource, image_files};

/// Latitude and longitude, in degrees, from which positions are counted: one origin for all traverses.
const ORIGIN: [f64; 2] = [-27.5, 153.0];
const VIDEO: &str = "webcam_video.avi";
/// Where extracted frames may lie.
const FRAME_FOLDERS: [&str; 3] = ["", "frames", "images"];
/// Spacing and radius of the visual geo-localization benchmark (Berton et al., CVPR 2022), in metres.
const SPACING_METRES: f64 = 5.0;
const RADIUS_METRES: f64 = 25.0;
/// Frames or positions that may be left over at the end, and as a share of all.
const MAX_LEFT_OVER: (u64, f64) = (30, 0.01);

pub(super) fn read(folder: &Path, options: &LayoutOptions) -> Result<LayoutTraverse, LayoutError> {
    refuse_camera(Layout::StLucia, options)?;
    let files = FRAME_FOLDERS.iter().find_map(|name| image_files(&folder.join(name)).ok());
    let options =
        LayoutOptions { spacing_metres: options.spacing_metres.or(Some(SPACING_METRES)), ..*options };
    let converted = files.as_ref().and_then(|files| files.first()).is_some_and(|file| {
        position::from_file_name(&file.file_name().unwrap_or_default().to_string_lossy()).is_some()
    });
    if converted {
        return images(folder, &options);
    }
    let positions = positions(folder)?;
    if let Some(files) = files {
        return of_files(folder, files, &positions, &options);
    }
    let path = folder.join(VIDEO);
    if !path.is_file() {
        return Err(different(
            Layout::StLucia,
            folder,
            format!("neither {VIDEO} nor images, in it or in frames/"),
        ));
    }
    of_video(folder, path, &positions, &options)
}

fn of_video(
    folder: &Path,
    path: PathBuf,
    positions: &[[f64; 2]],
    options: &LayoutOptions,
) -> Result<LayoutTraverse, LayoutError> {
    // Some containers do not say how many frames they hold; then reading them shows whether they last.
    let common = match VideoSource::open(&path, Some(1))?.frame_count() {
        Some(frames) => common(folder, frames, positions.len())?,
        None => positions.len(),
    };
    let kept = kept(&positions[..common], options.spacing_metres);
    Ok(LayoutTraverse {
        name: String::new(),
        positions_metres: Some(kept.iter().map(|&frame| positions[frame]).collect()),
        images: Images::Video { path, frames: kept.iter().map(|&frame| frame as u64).collect() },
        loops: None,
        rule: Rule::Radius { metres: RADIUS_METRES },
    })
}

fn of_files(
    folder: &Path,
    files: Vec<PathBuf>,
    positions: &[[f64; 2]],
    options: &LayoutOptions,
) -> Result<LayoutTraverse, LayoutError> {
    let common = common(folder, files.len() as u64, positions.len())?;
    Ok(placed(files, &positions[..common], options.spacing_metres, RADIUS_METRES))
}

/// How many frames have a position.
fn common(folder: &Path, frames: u64, positions: usize) -> Result<usize, LayoutError> {
    let common = usize::try_from(frames).unwrap_or(usize::MAX).min(positions);
    let left_over = frames.max(positions as u64) - common as u64;
    let (most, share) = MAX_LEFT_OVER;
    if left_over > most || left_over as f64 > share * common as f64 {
        let reason = format!("{frames} frames but {positions} positions");
        return Err(different(Layout::StLucia, folder, reason));
    }
    Ok(common)
}

/// East and north in metres, a pair a frame.
fn positions(folder: &Path) -> Result<Vec<[f64; 2]>, LayoutError> {
    let (text, mat) = (folder.join("fGPS.txt"), folder.join("fGPS.mat"));
    let degrees = if text.is_file() {
        degrees_from_text(&text)?
    } else if mat.is_file() {
        degrees_from_mat(&mat)?
    } else {
        return Err(different(Layout::StLucia, folder, "neither fGPS.txt nor fGPS.mat in it"));
    };
    if degrees.is_empty() {
        return Err(different(Layout::StLucia, folder, "no position in its fGPS file"));
    }
    let metres =
        |&[latitude, longitude]: &[f64; 2]| position::metres_from_degrees(-latitude.abs(), longitude, ORIGIN);
    Ok(degrees.iter().map(metres).collect())
}

fn are_degrees([latitude, longitude]: &[f64; 2]) -> bool {
    latitude.abs() <= 90.0 && longitude.abs() <= 180.0
}

fn degrees_from_mat(path: &Path) -> Result<Vec<[f64; 2]>, GroundTruthError> {
    let pairs = position::pairs_from_mat(path, "fGPS")?;
    let wrong: Vec<u64> =
        (0..).zip(&pairs).filter(|(_, pair)| !are_degrees(pair)).map(|(entry, _)| entry).collect();
    if !wrong.is_empty() {
        return Err(GroundTruthError::entries(path, wrong, "not LATITUDE,LONGITUDE in degrees"));
    }
    Ok(pairs)
}

fn degrees_from_text(path: &Path) -> Result<Vec<[f64; 2]>, GroundTruthError> {
    let text = file::read_text(path)?;
    let pair = |line: &str| {
        let (latitude, longitude) = line.split_once(',')?;
        let pair = [latitude.trim().parse().ok()?, longitude.trim().parse().ok()?];
        are_degrees(&pair).then_some(pair)
    };
    let lines = || (1_u64..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let wrong: Vec<u64> = lines().filter(|(_, line)| pair(line).is_none()).map(|(row, _)| row).collect();
    if !wrong.is_empty() {
        return Err(GroundTruthError::rows(path, wrong, "not LATITUDE,LONGITUDE in degrees"));
    }
    Ok(lines().filter_map(|(_, line)| pair(line)).collect())
}
