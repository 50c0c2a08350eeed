//! Data sets as they are published: where their frames lie, where each was taken, and when two of them
//! count as the same place.
//!
//! A traverse is one folder of its set. What the folder does not say (a ground truth that lies
//! elsewhere, another tolerance) is named by the user.

mod fab_map;
mod kitti;
mod st_lucia;

use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::ground_truth::{GroundTruthError, LoopMatrix, position};
use crate::source::{SourceError, image_files};

/// How a folder is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// A folder of `.jpg`, `.jpeg` or `.png` files in natural order; all or none are named
    /// `@EASTING@NORTHING@…`, in metres. Of a folder without any its subfolders are read.
    Images,
    /// UQ St Lucia (Glover et al., ICRA 2010): `webcam_video.avi` or images, with `fGPS.txt`.
    StLucia,
    /// FAB-MAP's City Centre (Cummins and Newman, IJRR 2008): two cameras that take turns.
    CityCentre,
    /// FAB-MAP's New College, laid out as City Centre.
    NewCollege,
    /// A sequence of KITTI odometry (Geiger et al., CVPR 2012), with its poses.
    Kitti,
    /// Nordland (Sünderhauf et al., 2013): a season a folder, frame by frame aligned.
    Nordland,
    /// Gardens Point Walking (Glover, 2014): a walk a folder, frame by frame aligned.
    GardensPoint,
}

impl Layout {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Images,
        Self::StLucia,
        Self::CityCentre,
        Self::NewCollege,
        Self::Kitti,
        Self::Nordland,
        Self::GardensPoint,
    ];

    /// The name in arguments.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Images => "images",
            Self::StLucia => "st-lucia",
            Self::CityCentre => "city-centre",
            Self::NewCollege => "new-college",
            Self::Kitti => "kitti",
            Self::Nordland => "nordland",
            Self::GardensPoint => "gardens-point",
        }
    }
}

impl Layout {
    /// How many frames back a sequence's own past begins, at the frame rate of the set: KITTI has ten a
    /// second, so that half a minute lies in between; the others were thinned before they were published.
    #[must_use]
    pub fn recent_frames(self) -> u64 {
        match self {
            Self::Kitti => 300,
            _ => 20,
        }
    }
}

impl FromStr for Layout {
    type Err = LayoutError;

    fn from_str(name: &str) -> Result<Self, LayoutError> {
        let found = Self::ALL.into_iter().find(|layout| layout.as_str() == name);
        found.ok_or_else(|| LayoutError::Unknown { given: name.to_owned() })
    }
}

/// Which of two cameras.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Camera {
    /// The left one.
    #[default]
    Left,
    /// The right one.
    Right,
}

/// What may be chosen of a layout.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LayoutOptions {
    /// Least distance of kept frames in metres; by default the set's usual one. Only for layouts that
    /// know where frames were taken, other than by a loop matrix.
    pub spacing_metres: Option<f64>,
    /// Which camera, only for layouts that have two; by default the left one.
    pub camera: Option<Camera>,
}

/// Where the frames of a traverse lie.
#[derive(Clone, Debug, PartialEq)]
pub enum Images {
    /// Image files, in order.
    Files(Vec<PathBuf>),
    /// Frames of a video file, by index.
    Video {
        /// The file.
        path: PathBuf,
        /// Which frames.
        frames: Vec<u64>,
    },
}

/// When two frames show the same place by a set's usual protocol.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rule {
    /// Positions at most so far apart.
    Radius {
        /// In metres.
        metres: f64,
    },
    /// Frame numbers of aligned traverses at most so far apart.
    Frames {
        /// In frames.
        tolerance: u32,
    },
    /// A loop matrix says it.
    Loops,
    /// Nothing says it.
    None,
}

/// A folder, read as it is laid out.
#[derive(Clone, Debug)]
pub struct LayoutTraverse {
    /// Its name.
    pub name: String,
    /// Its frames.
    pub images: Images,
    /// Where each was taken, east and north in metres.
    pub positions_metres: Option<Vec<[f64; 2]>>,
    /// Which frames show the same place, and the file that says so.
    pub loops: Option<(PathBuf, LoopMatrix)>,
    /// When two frames show the same place.
    pub rule: Rule,
}

/// Why a folder could not be read as it should be laid out.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LayoutError {
    /// There is no layout of that name.
    #[error("no layout '{given}'; there are {}", Layout::ALL.map(Layout::as_str).join(", "))]
    Unknown {
        /// What was asked for.
        given: String,
    },
    /// The folder is laid out differently.
    #[error("{} is not laid out as {}: {reason}", folder.display(), layout.as_str())]
    Different {
        /// The folder.
        folder: PathBuf,
        /// How it should be laid out.
        layout: Layout,
        /// What is missing, or does not fit.
        reason: String,
    },
    /// The layout has no use for an option, or its value makes no sense.
    #[error("--{option}: {reason}")]
    BadOption {
        /// The option, `spacing` or `camera`.
        option: &'static str,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// A ground-truth file of the folder is wrong.
    #[error(transparent)]
    GroundTruth(#[from] GroundTruthError),
    /// Its images cannot be listed.
    #[error(transparent)]
    Source(#[from] SourceError),
}

/// Reads the traverse in `folder`.
///
/// # Errors
/// If it is not laid out so, its files do not fit each other, or it has no use for an option.
pub fn read(layout: Layout, folder: &Path, options: &LayoutOptions) -> Result<LayoutTraverse, LayoutError> {
    if let Some(metres) = options.spacing_metres.filter(|metres| !(metres.is_finite() && *metres >= 0.0)) {
        return Err(bad_option("spacing", format!("{metres} is not a number of metres of 0 or more")));
    }
    let name =
        folder.file_name().map_or_else(|| folder.display().to_string(), |name| name.to_string_lossy().into());
    let traverse = match layout {
        Layout::Images => {
            refuse_camera(layout, options)?;
            images(folder, options)?
        }
        Layout::StLucia => st_lucia::read(folder, options)?,
        Layout::CityCentre | Layout::NewCollege => fab_map::read(layout, folder, options)?,
        Layout::Kitti => kitti::read(folder, options)?,
        // Both are walked or driven at one frame a second or less; these tolerances are the usual ones.
        Layout::Nordland => aligned(layout, folder, options, 10)?,
        Layout::GardensPoint => aligned(layout, folder, options, 2)?,
    };
    Ok(LayoutTraverse { name, ..traverse })
}

fn bad_option(option: &'static str, reason: impl Into<String>) -> LayoutError {
    LayoutError::BadOption { option, reason: reason.into() }
}

/// Fails if a camera was chosen of a layout that has one.
fn refuse_camera(layout: Layout, options: &LayoutOptions) -> Result<(), LayoutError> {
    if options.camera.is_none() {
        return Ok(());
    }
    let reason = format!(
        "{} has one camera; leave it out, or say --layout city-centre, new-college or kitti",
        layout.as_str()
    );
    Err(bad_option("camera", reason))
}

/// Fails if a spacing was chosen of a layout that does not say where frames were taken.
fn refuse_spacing(layout: Layout, options: &LayoutOptions) -> Result<(), LayoutError> {
    if options.spacing_metres.is_none() {
        return Ok(());
    }
    let reason = format!("{} carries no positions; take fewer with --sample-interval N", layout.as_str());
    Err(bad_option("spacing", reason))
}

fn different(layout: Layout, folder: &Path, reason: impl Into<String>) -> LayoutError {
    LayoutError::Different { folder: folder.to_owned(), layout, reason: reason.into() }
}

/// Frames without more than their order.
fn unplaced(files: Vec<PathBuf>) -> LayoutTraverse {
    LayoutTraverse {
        name: String::new(),
        images: Images::Files(files),
        positions_metres: None,
        loops: None,
        rule: Rule::None,
    }
}

/// Frames with a position each, thinned to the spacing that is asked for.
fn placed(files: Vec<PathBuf>, positions: &[[f64; 2]], spacing: Option<f64>, radius: f64) -> LayoutTraverse {
    let kept = kept(positions, spacing);
    LayoutTraverse {
        positions_metres: Some(kept.iter().map(|&frame| positions[frame]).collect()),
        rule: Rule::Radius { metres: radius },
        ..unplaced(kept.iter().map(|&frame| files[frame].clone()).collect())
    }
}

fn kept(positions: &[[f64; 2]], spacing: Option<f64>) -> Vec<usize> {
    match spacing {
        Some(metres) => position::spaced(positions, metres),
        None => (0..positions.len()).collect(),
    }
}

fn images(folder: &Path, options: &LayoutOptions) -> Result<LayoutTraverse, LayoutError> {
    let files = image_files(folder)?;
    let at = |file: &PathBuf| position::from_file_name(&file.file_name()?.to_string_lossy());
    let positions: Vec<[f64; 2]> = files.iter().filter_map(at).collect();
    if positions.is_empty() {
        refuse_spacing(Layout::Images, options)?;
        return Ok(unplaced(files));
    }
    if positions.len() < files.len() {
        let reason = format!(
            "only {} of {} images are named @EASTING@NORTHING@…; name all of them so, or none",
            positions.len(),
            files.len()
        );
        return Err(different(Layout::Images, folder, reason));
    }
    Ok(placed(files, &positions, options.spacing_metres, 25.0))
}

fn aligned(
    layout: Layout,
    folder: &Path,
    options: &LayoutOptions,
    tolerance: u32,
) -> Result<LayoutTraverse, LayoutError> {
    refuse_camera(layout, options)?;
    refuse_spacing(layout, options)?;
    Ok(LayoutTraverse { rule: Rule::Frames { tolerance }, ..unplaced(image_files(folder)?) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::process::Command;

    /// A folder with these files; images are empty, since nobody decodes them here.
    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, content) in files {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, content).unwrap();
        }
        folder
    }

    fn fixture(name: &str) -> Vec<u8> {
        fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/ground_truth").join(name)).unwrap()
    }

    fn read_all(layout: &str, folder: &Path) -> Result<LayoutTraverse, String> {
        read(layout.parse().unwrap(), folder, &LayoutOptions::default()).map_err(|error| error.to_string())
    }

    fn names(traverse: &LayoutTraverse) -> Vec<String> {
        let Images::Files(files) = &traverse.images else { panic!("a video") };
        files.iter().map(|file| file.file_name().unwrap().to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn a_layout_is_found_by_its_name_or_all_names_are_told() {
        for layout in Layout::ALL {
            assert_eq!(layout.as_str().parse::<Layout>().unwrap(), layout);
        }
        let message = "oxford".parse::<Layout>().unwrap_err().to_string();
        assert_eq!(
            message,
            "no layout 'oxford'; there are images, st-lucia, city-centre, new-college, kitti, nordland, gardens-point"
        );
    }

    #[test]
    fn images_of_the_benchmark_carry_their_positions() {
        let set = folder(&[("@10@20@x@.jpg", ""), ("@13@24@x@.jpg", "")]);
        let traverse = read_all("images", set.path()).unwrap();
        assert_eq!(traverse.positions_metres, Some(vec![[10.0, 20.0], [13.0, 24.0]]));
        assert_eq!(traverse.rule, Rule::Radius { metres: 25.0 });
        let mixed = folder(&[("@10@20@x@.jpg", ""), ("2.jpg", "")]);
        let message = read_all("images", mixed.path()).unwrap_err();
        assert!(message.contains("only 1 of 2 images are named @EASTING@NORTHING@…"), "{message}");
        let plain = folder(&[("2.jpg", ""), ("10.jpg", "")]);
        let traverse = read_all("images", plain.path()).unwrap();
        assert_eq!((names(&traverse), traverse.rule), (vec!["2.jpg".into(), "10.jpg".into()], Rule::None));
    }

    #[test]
    fn seasons_and_walks_are_aligned_frame_by_frame() {
        let set = folder(&[("images-00010.png", ""), ("images-00002.png", "")]);
        let nordland = read_all("nordland", set.path()).unwrap();
        assert_eq!(names(&nordland), ["images-00002.png", "images-00010.png"]);
        assert_eq!(nordland.rule, Rule::Frames { tolerance: 10 });
        assert_eq!(read_all("gardens-point", set.path()).unwrap().rule, Rule::Frames { tolerance: 2 });
    }

    #[test]
    fn st_lucia_has_a_line_of_southern_degrees_a_frame_and_keeps_frames_five_metres_apart() {
        // One thousandth of a degree of latitude is 111 m: 4e-5 degrees are 4.4 m, 5e-5 are 5.5 m.
        let gps = "27.500000,153.0\n27.500040,153.0\n27.500050,153.0\n";
        let frames =
            folder(&[("fGPS.txt", gps), ("frames/1.png", ""), ("frames/2.png", ""), ("frames/10.png", "")]);
        let traverse = read_all("st-lucia", frames.path()).unwrap();
        assert_eq!(names(&traverse), ["1.png", "10.png"]);
        let positions = traverse.positions_metres.unwrap();
        assert!((positions[1][1] - positions[0][1] + 5.54).abs() < 0.01, "south of the first: {positions:?}");
        assert_eq!(traverse.rule, Rule::Radius { metres: 25.0 });
        let wide = LayoutOptions { spacing_metres: Some(0.0), ..LayoutOptions::default() };
        assert_eq!(names(&read(Layout::StLucia, frames.path(), &wide).unwrap()).len(), 3);
    }

    /// Makes St Lucia's video with that many frames in `folder`; `false` where there is no ffmpeg.
    fn make_video(folder: &Path, frames: usize) -> bool {
        let path = folder.join("webcam_video.avi");
        let arguments = format!("-f lavfi -i testsrc=size=64x48:rate=25 -frames:v {frames} -c:v mjpeg");
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-y", "-v", "error"]).args(arguments.split(' ')).arg(&path);
        match command.status() {
            Ok(status) => {
                assert!(status.success(), "ffmpeg {arguments}");
                true
            }
            Err(_) => {
                fs::write(path, "not empty").unwrap();
                assert!(read_all("st-lucia", folder).unwrap_err().contains("apt install ffmpeg"));
                false
            }
        }
    }

    #[test]
    fn the_video_of_st_lucia_must_have_a_frame_a_position() {
        // 150 positions, 5.5 m apart, of which one in a hundred may be left over.
        let gps: String = (0..150).map(|frame| format!("27.5{:04},153.0\n", 5 * frame)).collect();
        let set = folder(&[("fGPS.txt", gps.as_str())]);
        if !make_video(set.path(), 150) {
            return;
        }
        let frames = |set: &Path| match read_all("st-lucia", set)?.images {
            Images::Video { path, frames } => Ok((path, frames)),
            Images::Files(_) => Err("files".to_owned()),
        };
        let path = set.path().join("webcam_video.avi");
        assert_eq!(frames(set.path()), Ok((path, (0..150).collect())));
        make_video(set.path(), 149);
        assert_eq!(frames(set.path()).unwrap().1, (0..149).collect::<Vec<u64>>(), "the last has no frame");
        make_video(set.path(), 151);
        assert_eq!(frames(set.path()).unwrap().1.len(), 150);
        make_video(set.path(), 147);
        let message = frames(set.path()).unwrap_err();
        assert!(message.contains("not laid out as st-lucia: 147 frames but 150 positions"), "{message}");
        fs::write(set.path().join("webcam_video.avi"), "").unwrap();
        assert!(frames(set.path()).unwrap_err().contains("the file is empty"));
    }

    #[test]
    fn st_lucia_positions_may_stand_in_a_matlab_file() {
        let set = folder(&[("1.jpg", ""), ("2.jpg", ""), ("3.jpg", "")]);
        fs::write(set.path().join("fGPS.mat"), fixture("fgps.mat")).unwrap();
        let positions = read_all("st-lucia", set.path()).unwrap().positions_metres.unwrap();
        assert_eq!(positions.len(), 3, "11 m apart");
        // The latitude of the first, a double with its exponent at the end of the eight bytes.
        let mut bytes = fixture("fgps.mat");
        let latitude = bytes.windows(8).position(|bytes| bytes == (-27.5_f64).to_le_bytes()).unwrap();
        bytes[latitude..latitude + 8].copy_from_slice(&f64::NAN.to_le_bytes());
        fs::write(set.path().join("fGPS.mat"), bytes).unwrap();
        let message = read_all("st-lucia", set.path()).unwrap_err();
        assert!(
            message.ends_with("entry 0 (counted from 0): not LATITUDE,LONGITUDE in degrees"),
            "{message}"
        );
    }

    #[test]
    fn st_lucia_that_does_not_fit_is_refused() {
        let short = folder(&[("fGPS.txt", "27.5,153\n"), ("1.jpg", ""), ("2.jpg", "")]);
        let message = read_all("st-lucia", short.path()).unwrap_err();
        assert!(message.contains("2 frames but 1 positions"), "{message}");
        let words = folder(&[("fGPS.txt", "27.5,153\nnorth,east\n"), ("1.jpg", ""), ("2.jpg", "")]);
        let message = read_all("st-lucia", words.path()).unwrap_err();
        assert!(message.contains("fGPS.txt, row 2: not LATITUDE,LONGITUDE"), "{message}");
        let message = read_all("st-lucia", folder(&[("1.jpg", "")]).path()).unwrap_err();
        assert!(message.contains("neither fGPS.txt nor fGPS.mat"), "{message}");
    }

    #[test]
    fn the_left_camera_of_city_centre_has_every_second_image_and_its_part_of_the_matrix() {
        let images: Vec<(String, &str)> = (1..=6).map(|i| (format!("Images/{i:04}.jpg"), "")).collect();
        let images: Vec<(&str, &str)> =
            images.iter().map(|(name, content)| (name.as_str(), *content)).collect();
        let set = folder(&images);
        let truth = "0 0 0 0 0 0\n0 0 0 0 0 0\n1 0 0 0 0 0\n0 1 0 0 0 0\n0 0 1 0 0 0\n0 0 0 1 0 0\n";
        fs::write(set.path().join("CityCentreGroundTruth.txt"), truth).unwrap();
        let traverse = read_all("city-centre", set.path()).unwrap();
        assert_eq!(names(&traverse), ["0001.jpg", "0003.jpg", "0005.jpg"]);
        let (_, loops) = traverse.loops.unwrap();
        assert_eq!([loops.matches(0), loops.matches(1), loops.matches(2)], [&[][..], &[0], &[1]]);
        let right = LayoutOptions { camera: Some(Camera::Right), ..LayoutOptions::default() };
        assert_eq!(names(&read(Layout::CityCentre, set.path(), &right).unwrap())[0], "0002.jpg");
        fs::write(set.path().join("CityCentreGroundTruth.txt"), "0 0\n1 0\n").unwrap();
        let message = read_all("city-centre", set.path()).unwrap_err();
        assert!(message.contains("2 rows for 6 images of both cameras, 3 of one"), "{message}");
        let message = read_all("new-college", set.path()).unwrap_err();
        assert!(message.contains("NewCollegeGroundTruth.mat"), "{message}");
    }

    #[test]
    fn kitti_has_its_poses_beside_the_sequences_or_inside() {
        let pose = |x: f64, z: f64| format!("1 0 0 {x} 0 1 0 -1.5 0 0 1 {z}\n");
        let poses = pose(0.0, 0.0) + &pose(0.5, 12.0);
        let files = [
            ("sequences/05/image_0/000000.png", ""),
            ("sequences/05/image_0/000001.png", ""),
            ("poses/05.txt", &poses),
        ];
        let set = folder(&files);
        let traverse = read_all("kitti", &set.path().join("sequences/05")).unwrap();
        assert_eq!(traverse.positions_metres, Some(vec![[0.0, 0.0], [0.5, 12.0]]));
        assert_eq!(traverse.rule, Rule::Radius { metres: 10.0 });
        fs::write(set.path().join("poses/05.txt"), pose(0.0, 0.0)).unwrap();
        let message = read_all("kitti", &set.path().join("sequences/05")).unwrap_err();
        assert!(message.contains("2 images but 1 poses"), "{message}");
        fs::write(set.path().join("poses/05.txt"), pose(0.0, 0.0) + "1 2 3\n").unwrap();
        let message = read_all("kitti", &set.path().join("sequences/05")).unwrap_err();
        assert!(message.contains("05.txt, row 2: not 12 numbers"), "{message}");
    }

    #[test]
    fn the_right_camera_of_kitti_lies_in_folders_of_its_own() {
        let pose = "1 0 0 0 0 1 0 0 0 0 1 0\n";
        let set = folder(&[("image_2/a.png", ""), ("image_3/b.png", ""), ("poses.txt", pose)]);
        let read = |camera| {
            let options = LayoutOptions { camera, ..LayoutOptions::default() };
            read(Layout::Kitti, set.path(), &options).map(|traverse| names(&traverse))
        };
        assert_eq!([read(None).unwrap(), read(Some(Camera::Left)).unwrap()], [["a.png"], ["a.png"]]);
        assert_eq!(read(Some(Camera::Right)).unwrap(), ["b.png"]);
        fs::remove_dir_all(set.path().join("image_3")).unwrap();
        let message = read(Some(Camera::Right)).unwrap_err().to_string();
        assert!(message.ends_with("no images in image_1 or image_3"), "{message}");
    }

    #[test]
    fn an_option_without_a_use_is_refused_rather_than_passed_over() {
        let set = folder(&[("1.jpg", ""), ("fGPS.txt", "27.5,153\n"), ("poses.txt", "")]);
        let message = |layout: Layout, options: &LayoutOptions| {
            read(layout, set.path(), options).unwrap_err().to_string()
        };
        let camera = LayoutOptions { camera: Some(Camera::Left), ..LayoutOptions::default() };
        for layout in [Layout::Images, Layout::StLucia, Layout::Nordland, Layout::GardensPoint] {
            let expected = format!("--camera: {} has one camera; leave it out,", layout.as_str());
            assert!(message(layout, &camera).starts_with(&expected), "{layout:?}");
        }
        let spacing = |metres| LayoutOptions { spacing_metres: Some(metres), ..LayoutOptions::default() };
        for layout in
            [Layout::Images, Layout::CityCentre, Layout::NewCollege, Layout::Nordland, Layout::GardensPoint]
        {
            let expected = format!("--spacing: {} carries no positions;", layout.as_str());
            assert!(message(layout, &spacing(5.0)).starts_with(&expected), "{layout:?}");
        }
        for metres in [-1.0, f64::NAN, f64::INFINITY] {
            let expected = format!("--spacing: {metres} is not a number of metres of 0 or more");
            assert_eq!(message(Layout::StLucia, &spacing(metres)), expected);
        }
    }
}
