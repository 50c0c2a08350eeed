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
    /// Images in natural order; named `@EASTING@NORTHING@…` where positions are known.
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Camera {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

/// What may be chosen of a layout.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LayoutOptions {
    /// Least distance of kept frames in metres; by default the set's usual one.
    pub spacing_metres: Option<f64>,
    /// Which camera, where there are two; by default the left one.
    pub camera: Option<Camera>,
}

impl LayoutOptions {
    /// Fails if an option was named that would change nothing.
    fn refuse_unused(self, layout: Layout, folder: &Path, has_positions: bool) -> Result<(), LayoutError> {
        let has_cameras = matches!(layout, Layout::CityCentre | Layout::NewCollege | Layout::Kitti);
        let useless = |option, reason| LayoutError::Useless { folder: folder.to_owned(), option, reason };
        if self.camera.is_some() && !has_cameras {
            Err(useless("camera", "has one camera"))
        } else if self.spacing_metres.is_some() && !has_positions {
            Err(useless("spacing", "has no positions"))
        } else {
            Ok(())
        }
    }
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
    /// An option would change nothing.
    #[error("{option} has no meaning, since {} {reason}; leave it out", folder.display())]
    Useless {
        /// The folder.
        folder: PathBuf,
        /// The option.
        option: &'static str,
        /// Why it would change nothing.
        reason: &'static str,
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
/// If it is not laid out so, or its files do not fit each other.
pub fn read(layout: Layout, folder: &Path, options: &LayoutOptions) -> Result<LayoutTraverse, LayoutError> {
    let name =
        folder.file_name().map_or_else(|| folder.display().to_string(), |name| name.to_string_lossy().into());
    let traverse = match layout {
        Layout::Images => images(folder, options)?,
        Layout::StLucia => st_lucia::read(folder, options)?,
        Layout::CityCentre | Layout::NewCollege => fab_map::read(layout, folder, options)?,
        Layout::Kitti => kitti::read(folder, options)?,
        // Both are walked or driven at one frame a second or less; these tolerances are the usual ones.
        Layout::Nordland => aligned(folder, 10)?,
        Layout::GardensPoint => aligned(folder, 2)?,
    };
    options.refuse_unused(layout, folder, traverse.positions_metres.is_some())?;
    Ok(LayoutTraverse { name, ..traverse })
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
    Ok(match files.iter().map(at).collect::<Option<Vec<[f64; 2]>>>() {
        Some(positions) => placed(files, &positions, options.spacing_metres, 25.0),
        None => unplaced(files),
    })
}

fn aligned(folder: &Path, tolerance: u32) -> Result<LayoutTraverse, LayoutError> {
    Ok(LayoutTraverse { rule: Rule::Frames { tolerance }, ..unplaced(image_files(folder)?) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

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

    /// A video of so many frames.
    fn film(path: &Path, frames: u32) {
        let input = format!("testsrc=size=64x48:rate=5:duration={}", f64::from(frames) / 5.0);
        let mut ffmpeg = std::process::Command::new("ffmpeg");
        ffmpeg.args(["-v", "error", "-y", "-f", "lavfi", "-i", &input, "-c:v", "mjpeg"]).arg(path);
        assert!(ffmpeg.status().expect("ffmpeg is installed for tests").success());
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
        let set = folder(&[("fGPS.txt", gps)]);
        let video = set.path().join("webcam_video.avi");
        film(&video, 3);
        let traverse = read_all("st-lucia", set.path()).unwrap();
        assert_eq!(traverse.images, Images::Video { path: video.clone(), frames: vec![0, 2] });
        let positions = traverse.positions_metres.unwrap();
        assert!((positions[1][1] - positions[0][1] + 5.54).abs() < 0.01, "south of the first: {positions:?}");
        assert_eq!(traverse.rule, Rule::Radius { metres: 25.0 });
        film(&video, 5);
        let message = read_all("st-lucia", set.path()).unwrap_err();
        assert!(message.contains("5 frames but 3 positions"), "{message}");

        let frames =
            folder(&[("fGPS.txt", gps), ("frames/1.png", ""), ("frames/2.png", ""), ("frames/10.png", "")]);
        assert_eq!(names(&read_all("st-lucia", frames.path()).unwrap()), ["1.png", "10.png"]);
        let wide = LayoutOptions { spacing_metres: Some(0.0), ..LayoutOptions::default() };
        assert_eq!(names(&read(Layout::StLucia, frames.path(), &wide).unwrap()).len(), 3);
    }

    #[test]
    fn st_lucia_positions_may_stand_in_a_matlab_file() {
        let set = folder(&[("1.jpg", ""), ("2.jpg", ""), ("3.jpg", "")]);
        fs::write(set.path().join("fGPS.mat"), fixture("fgps.mat")).unwrap();
        let positions = read_all("st-lucia", set.path()).unwrap().positions_metres.unwrap();
        assert_eq!(positions.len(), 3, "11 m apart");
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
    fn options_that_would_change_nothing_are_refused() {
        let plain = folder(&[("1.jpg", "")]);
        let refused =
            |layout, options: LayoutOptions| read(layout, plain.path(), &options).unwrap_err().to_string();
        let spacing = LayoutOptions { spacing_metres: Some(5.0), camera: None };
        assert!(refused(Layout::Nordland, spacing).contains("spacing has no meaning"));
        assert!(refused(Layout::Images, spacing).contains("has no positions"));
        let camera = LayoutOptions { spacing_metres: None, camera: Some(Camera::Left) };
        assert!(refused(Layout::GardensPoint, camera).contains("camera has no meaning"));
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
        let right = LayoutOptions { camera: Some(Camera::Right), ..LayoutOptions::default() };
        let message = read(Layout::Kitti, &set.path().join("sequences/05"), &right).unwrap_err().to_string();
        assert!(message.contains("no images in image_1 or image_3"), "{message}");
        fs::write(set.path().join("poses/05.txt"), pose(0.0, 0.0)).unwrap();
        let message = read_all("kitti", &set.path().join("sequences/05")).unwrap_err();
        assert!(message.contains("2 images but 1 poses"), "{message}");
        fs::write(set.path().join("poses/05.txt"), pose(0.0, 0.0) + "1 2 3\n").unwrap();
        let message = read_all("kitti", &set.path().join("sequences/05")).unwrap_err();
        assert!(message.contains("05.txt, row 2: not 12 numbers"), "{message}");
    }
}
