//! Traverses: what was seen along a route, kept without its pixels so that every method answers about
//! the same features and descriptors.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::EvaluationError;
use super::ground_truth::{GroundTruthError, LoopMatrix, RowFilter, Table, position};
use super::layout::{self, Layout, LayoutOptions};
use super::results::TraverseSummary;
use crate::cnn::DescriptorModel;
use crate::feature::OrbExtractor;
use crate::frame::Frame;
use crate::pipeline::{Perception, PerceptionLatency, Seen, Watcher};
use crate::raster::{GreyImage, RgbImage};
use crate::recognition::Look;
use crate::source::{
    self, Address, DirectorySource, FrameSource, SourceError, VideoSource, image_files, is_image,
    thumbnail_jpeg,
};
use crate::vocabulary::VocabularySet;

/// What looks at the frames.
pub struct Eyes {
    /// Finds features.
    pub extractor: OrbExtractor,
    /// Knows their words, in every light.
    pub vocabularies: Arc<VocabularySet>,
    /// The CNN, if there is one.
    pub model: Option<DescriptorModel>,
}

/// Where the frames of a traverse come from.
#[derive(Clone, Debug, PartialEq)]
pub enum Frames {
    /// A source as `loci run` takes it.
    Source {
        /// Its address.
        address: String,
        /// How many frames it announces, where it does.
        count: Option<usize>,
    },
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

/// A traverse that was not looked at yet.
#[derive(Clone, Debug)]
pub struct TraversePlan {
    /// Its name.
    pub name: String,
    /// Its frames.
    pub frames: Frames,
    /// Every how many frames one is looked at.
    pub sample_interval: u64,
    /// Where each frame was taken, in metres, where a layout says it.
    pub positions_metres: Option<Vec<[f64; 2]>>,
    /// Which frames show the same place, where a layout says it.
    pub loops: Option<(PathBuf, LoopMatrix)>,
    /// When frames show the same place by the usual protocol of the layout.
    pub rule: layout::Rule,
    /// The rows of the ground-truth table that the frames are, if they come from one.
    pub table_rows: Option<Vec<usize>>,
}

impl TraversePlan {
    /// The traverse at `source`: a folder laid out in a known way, or whatever `loci run` reads.
    ///
    /// # Errors
    /// If the folder is not laid out so.
    pub fn open(
        source: &str,
        layout: Layout,
        options: &LayoutOptions,
        sample_interval: u64,
    ) -> Result<Self, EvaluationError> {
        let path = Path::new(source);
        if is_image(path) {
            return Ok(Self::of_frames(folder_name(path), Frames::Files(vec![path.to_owned()]), 1));
        }
        if !path.is_dir() {
            return Self::of_source(source, sample_interval);
        }
        if layout == Layout::Images && image_files(path).is_err() {
            if *options != LayoutOptions::default() {
                let reason = format!("spacing and camera have no meaning for the subfolders of {source}");
                return Err(EvaluationError::Wrong(reason));
            }
            let files = files_of_subfolders(path)?;
            return Ok(Self::of_frames(folder_name(path), Frames::Files(files), sample_interval));
        }
        let read = layout::read(layout, path, options)?;
        let frames = match read.images {
            layout::Images::Files(files) => Frames::Files(files),
            layout::Images::Video { path, frames } => Frames::Video { path, frames },
        };
        Ok(Self {
            positions_metres: read.positions_metres,
            loops: read.loops,
            rule: read.rule,
            ..Self::of_frames(read.name, frames, sample_interval)
        })
    }

    /// Whatever `loci run` reads and ends by itself. It says how many frames it announces.
    fn of_source(address: &str, sample_interval: u64) -> Result<Self, EvaluationError> {
        if matches!(Address::from(address), Address::Camera(_)) {
            let reason = format!("{address} never ends: record it, and evaluate the video");
            return Err(EvaluationError::Wrong(reason));
        }
        let count = source::announced_frames(address)?.and_then(|count| count.try_into().ok());
        let frames = Frames::Source { address: address.to_owned(), count };
        Ok(Self::of_frames(address.to_owned(), frames, sample_interval))
    }

    /// The traverse that the chosen rows of a ground-truth table are; with `spacing_metres`, those at least so
    /// far from the one kept before.
    ///
    /// # Errors
    /// If no row is chosen, one names a file that is not there, or positions are missing.
    pub fn of_rows(
        table: &Table,
        filter: &RowFilter,
        (sample_interval, spacing_metres): (u64, Option<f64>),
    ) -> Result<Self, GroundTruthError> {
        let mut rows = filter.choose(table)?;
        if let Some(metres) = spacing_metres {
            let all = table.positions_metres()?;
            let positions: Vec<[f64; 2]> = rows.iter().map(|&row| all[row]).collect();
            rows = position::spaced(&positions, metres).into_iter().map(|index| rows[index]).collect();
        }
        let files = table.files(table.file_column(filter.files())?)?;
        let folder = table.path().parent().map(folder_name).unwrap_or_default();
        let name = match filter.to_string() {
            text if text.is_empty() => folder,
            text => format!("{folder}, {text}"),
        };
        let frames = Frames::Files(rows.iter().map(|&row| files[row].clone()).collect());
        Ok(Self { table_rows: Some(rows), ..Self::of_frames(name, frames, sample_interval) })
    }

    fn of_frames(name: String, frames: Frames, sample_interval: u64) -> Self {
        Self {
            name,
            frames,
            sample_interval,
            positions_metres: None,
            loops: None,
            rule: layout::Rule::None,
            table_rows: None,
        }
    }

    /// Number of frames before sampling, where it is known beforehand.
    #[must_use]
    pub fn frame_count(&self) -> Option<usize> {
        match &self.frames {
            Frames::Source { count, .. } => *count,
            Frames::Files(files) => Some(files.len()),
            Frames::Video { frames, .. } => Some(frames.len()),
        }
    }

    /// Whether its files do not all stand in one folder.
    fn spans_folders(&self) -> bool {
        let Frames::Files(files) = &self.frames else { return false };
        files.iter().any(|file| file.parent() != files[0].parent())
    }

    /// Whether its frames carry where they were taken, as those of a synthetic world do.
    #[must_use]
    pub fn is_synthetic(&self) -> bool {
        let Frames::Source { address, .. } = &self.frames else { return false };
        matches!(Address::from(address.as_str()), Address::Synthetic(_))
    }

    /// Whether its frames come from a video.
    #[must_use]
    pub fn is_video(&self) -> bool {
        match &self.frames {
            Frames::Video { .. } => true,
            Frames::Source { .. } => !self.is_synthetic(),
            Frames::Files(_) => false,
        }
    }

    fn source(&self) -> Result<Box<dyn FrameSource>, SourceError> {
        let step = usize::try_from(self.sample_interval).unwrap_or(usize::MAX).max(1);
        Ok(match &self.frames {
            Frames::Source { address, .. } => source::open(address, Some(self.sample_interval))?,
            Frames::Files(files) => {
                Box::new(DirectorySource::of_files(files.iter().step_by(step).cloned().collect()))
            }
            Frames::Video { path, frames } => {
                Box::new(VideoSource::with_frames(path, frames.iter().copied().step_by(step).collect())?)
            }
        })
    }

    /// The number of a frame in the traverse before sampling.
    fn number(&self, frame: &Frame) -> u64 {
        match &self.frames {
            Frames::Source { .. } => frame.index,
            Frames::Files(_) => frame.index * self.sample_interval.max(1),
            Frames::Video { frames, .. } => frames.binary_search(&frame.index).unwrap_or_default() as u64,
        }
    }

    /// Looks at every frame; with `keeps_pictures` a small JPEG of each stays for reports.
    ///
    /// # Errors
    /// If the source cannot be opened, holds no readable frame, or `stop` was set meanwhile.
    pub fn observe(
        &self,
        eyes: &mut Eyes,
        keeps_pictures: bool,
        (stop, watcher): (&AtomicBool, &dyn Watcher),
    ) -> Result<Traverse, EvaluationError> {
        let mut observations = Vec::new();
        let spans_folders = self.spans_folders();
        let perception = Perception::new(&mut eyes.extractor, &eyes.vocabularies, eyes.model.as_mut());
        let losses = perception.run(self.source()?, stop, watcher, |seen| {
            let number = self.number(&seen.frame);
            observations.push(self.observation(seen, number, (spans_folders, keeps_pictures)));
            Ok::<_, EvaluationError>(ControlFlow::Continue(()))
        })?;
        if stop.load(Ordering::Relaxed) {
            return Err(EvaluationError::Interrupted);
        }
        if observations.is_empty() {
            return Err(EvaluationError::NoFrames { name: self.name.clone() });
        }
        let end = observations.last().map_or(0, |last| last.number + self.sample_interval.max(1));
        Ok(Traverse { name: self.name.clone(), observations, skipped: losses.unreadable, end })
    }

    fn observation(
        &self,
        seen: Seen,
        number: u64,
        (spans_folders, keeps_picture): (bool, bool),
    ) -> Observation {
        let Seen { frame, look, latency, .. } = seen;
        let file = match &self.frames {
            Frames::Files(files) => files.get(number as usize),
            _ => None,
        };
        let name = file.map(|path| if spans_folders { name_with_folder(path) } else { folder_name(path) });
        Observation {
            number,
            name: name.unwrap_or_else(|| frame.name.clone()),
            folder: file.and_then(|path| path.parent()).unwrap_or(Path::new(&self.name)).to_owned(),
            position_metres: frame.pose.map(|pose| [pose.position_metres[0], pose.position_metres[1]]),
            true_place: frame.true_place,
            size_px: (frame.colour.width() as u32, frame.colour.height() as u32),
            picture_jpeg: if keeps_picture { thumbnail_jpeg(&frame.colour) } else { Vec::new() },
            look,
            latency,
        }
    }
}

/// The images of all subfolders of `folder`, in natural order.
fn files_of_subfolders(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let error = |source| SourceError::Io { path: folder.to_owned(), source };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(error)? {
        let path = entry.map_err(error)?.path();
        if path.is_dir() {
            files.extend(image_files(&path).unwrap_or_default());
        }
    }
    if files.is_empty() {
        return Err(SourceError::NoImages { path: folder.to_owned() });
    }
    source::sort_naturally(&mut files);
    Ok(files)
}

/// The last part of a path, or all of it where that is `.` or `..`.
fn folder_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

fn name_with_folder(path: &Path) -> String {
    format!("{}/{}", path.parent().map(folder_name).unwrap_or_default(), folder_name(path))
}

/// A frame as evaluation keeps it.
#[derive(Clone, Debug)]
pub struct Observation {
    /// Its number in the traverse before sampling.
    pub number: u64,
    /// What a person would call it.
    pub name: String,
    /// The folder of its file, or the source it comes from.
    pub folder: PathBuf,
    /// Where the camera was, if the source knows.
    pub position_metres: Option<[f64; 2]>,
    /// The place it truly shows, if the source knows.
    pub true_place: Option<u32>,
    /// Width and height in pixels.
    pub size_px: (u32, u32),
    /// A small JPEG of it, if it was asked for.
    pub picture_jpeg: Vec<u8>,
    /// What was seen.
    pub look: Look,
    /// How long seeing took.
    pub latency: PerceptionLatency,
}

impl Observation {
    /// The frame without its pixels, which recognition does not look at.
    #[must_use]
    pub fn frame(&self, index: usize) -> Frame {
        Frame {
            index: index as u64,
            capture_nanos: 0,
            name: self.name.clone(),
            colour: RgbImage::new(1, 1),
            grey: GreyImage::new(1, 1),
            jpeg: None,
            pose: None,
            true_place: None,
        }
    }
}

/// A traverse that was looked at.
#[derive(Clone, Debug)]
pub struct Traverse {
    /// Its name.
    pub name: String,
    /// Its frames, in order.
    pub observations: Vec<Observation>,
    /// Frames that could not be read.
    pub skipped: u64,
    /// The number that a next frame would have at least, were there one.
    pub end: u64,
}

impl Traverse {
    /// Number of frames that were looked at.
    #[must_use]
    pub fn len(&self) -> usize {
        self.observations.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.observations.is_empty()
    }

    /// The number of each frame before sampling; they ascend.
    #[must_use]
    pub fn numbers(&self) -> Vec<u64> {
        self.observations.iter().map(|observation| observation.number).collect()
    }

    /// What reports say of it.
    #[must_use]
    pub fn summary(&self) -> TraverseSummary {
        TraverseSummary { name: self.name.clone(), frames: self.len() as u64, skipped: self.skipped }
    }
}
