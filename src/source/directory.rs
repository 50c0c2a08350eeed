//! A folder of images in natural order: `2.jpg` before `10.jpg`.

use std::fs;
use std::path::{Path, PathBuf};

use super::{FrameSource, SourceError, codec};
use crate::frame::Frame;
use crate::kernel::luma;

/// Images carry no clock: they count as captured at this nominal interval, from time 0.
const NOMINAL_INTERVAL_NANOS: i64 = 100_000_000;
const EXTENSIONS: [&str; 3] = ["jpg", "jpeg", "png"];

/// The images of `folder`, not of its subfolders, in natural order.
///
/// # Errors
/// If the folder cannot be read or holds no images.
pub fn image_files(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let error = |source| SourceError::Io { path: folder.to_owned(), source };
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(error)? {
        let path = entry.map_err(error)?.path();
        // Neither a folder called `x.jpg` nor a pipe, which would block, is an image.
        if is_image(&path) {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        return Err(SourceError::NoImages { path: folder.to_owned() });
    }
    sort_naturally(&mut paths);
    Ok(paths)
}

/// Whether there is a file at `path` that is called like an image.
#[must_use]
pub fn is_image(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    EXTENSIONS.contains(&extension.as_str()) && path.is_file()
}

/// Sorts paths as people would: `2.jpg` before `10.jpg`.
pub fn sort_naturally(paths: &mut [PathBuf]) {
    alphanumeric_sort::sort_path_slice(paths);
}

/// Image files, in a given order.
#[derive(Debug)]
pub struct DirectorySource {
    paths: Vec<PathBuf>,
    next: usize,
    sample_interval: usize,
}

impl DirectorySource {
    /// Hands out every `sample_interval`-th of the images of `folder`.
    ///
    /// # Errors
    /// If the folder cannot be read or holds no images.
    pub fn open(folder: &Path, sample_interval: u64) -> Result<Self, SourceError> {
        let sample_interval = usize::try_from(sample_interval).unwrap_or(usize::MAX).max(1);
        Ok(Self { sample_interval, ..Self::of_files(image_files(folder)?) })
    }

    /// Hands out the images at `paths`.
    #[must_use]
    pub fn of_files(paths: Vec<PathBuf>) -> Self {
        Self { paths, next: 0, sample_interval: 1 }
    }

    fn read(&self, index: usize) -> Result<Frame, SourceError> {
        let path = &self.paths[index];
        let bytes = codec::read_image_file(path)?;
        let colour = codec::decode(&bytes, &path.display().to_string())?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Frame {
            index: index as u64,
            capture_nanos: index as i64 * NOMINAL_INTERVAL_NANOS,
            name,
            grey: luma(&colour),
            colour,
            jpeg: codec::is_jpeg(&bytes).then_some(bytes),
            pose: None,
            true_place: None,
        })
    }
}

impl FrameSource for DirectorySource {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        let index = self.next;
        self.next = index.saturating_add(self.sample_interval);
        (index < self.paths.len()).then(|| self.read(index))
    }

    fn frame_count(&self) -> Option<u64> {
        Some(self.paths.len().div_ceil(self.sample_interval) as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::RgbImage;

    fn folder_with(names: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            fs::write(folder.path().join(name), codec::jpeg(&RgbImage::new(40, 40))).unwrap();
        }
        folder
    }

    fn names(folder: &Path, sample_interval: u64) -> Vec<String> {
        let mut source = DirectorySource::open(folder, sample_interval).unwrap();
        let names: Vec<String> =
            std::iter::from_fn(|| source.next_frame()).map(|frame| frame.unwrap().name).collect();
        assert_eq!(source.frame_count(), Some(names.len() as u64));
        names
    }

    #[test]
    fn images_come_in_natural_order_and_other_files_not_at_all() {
        let folder = folder_with(&["10.jpg", "2.JPG", "1.jpeg", "notes.txt"]);
        fs::create_dir(folder.path().join("3.jpg")).unwrap();
        assert_eq!(names(folder.path(), 1), ["1.jpeg", "2.JPG", "10.jpg"]);
        assert_eq!(names(folder.path(), 2), ["1.jpeg", "10.jpg"]);
    }

    #[test]
    fn a_folder_without_images_is_named_with_the_fix() {
        let folder = folder_with(&["readme.md"]);
        let error = DirectorySource::open(folder.path(), 1).unwrap_err().to_string();
        assert!(error.starts_with(&format!("no images in {}", folder.path().display())), "{error}");
    }

    #[test]
    fn one_bad_image_does_not_end_the_stream() {
        let folder = folder_with(&["1.jpg", "3.jpg"]);
        fs::write(folder.path().join("2.jpg"), b"").unwrap();
        let mut source = DirectorySource::open(folder.path(), 1).unwrap();
        assert!(source.next_frame().unwrap().is_ok());
        let error = source.next_frame().unwrap().unwrap_err().to_string();
        assert!(error.contains("2.jpg: the file is empty"), "{error}");
        assert_eq!(source.next_frame().unwrap().unwrap().name, "3.jpg");
        assert!(source.next_frame().is_none());
    }
}
