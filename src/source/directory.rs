//! A folder of images in natural order: `2.jpg` before `10.jpg`. Where all of their names are times, as in many data
//! sets, they were captured then.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use super::{FrameSource, SourceError, decode_in};
use crate::codec;
use crate::frame::{Frame, FrameMemory};
use crate::kernel::luma_in;

/// Largest image file in bytes.
const MAX_FILE_BYTES: u64 = 64 << 20;
/// Images whose names are no times count as captured at this nominal interval, from time 0.
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
    /// Times of capture in nanoseconds; none unless all names are times.
    times_nanos: Vec<i64>,
    next: usize,
    sample_interval: usize,
}

impl DirectorySource {
    /// Hands out every `sample_interval`-th of the images of `folder`, in natural order, or that of the times by which
    /// they are called.
    ///
    /// # Errors
    /// If the folder cannot be read or holds no images.
    pub fn open(folder: &Path, sample_interval: u64) -> Result<Self, SourceError> {
        let sample_interval = usize::try_from(sample_interval).unwrap_or(usize::MAX).max(1);
        let mut paths = image_files(folder)?;
        if paths.iter().all(|path| named_nanos(path).is_some()) {
            paths.sort_by_cached_key(|path| named_nanos(path));
        }
        Ok(Self { sample_interval, ..Self::of_files(paths) })
    }

    /// Hands out the images at `paths`.
    #[must_use]
    pub fn of_files(paths: Vec<PathBuf>) -> Self {
        let times_nanos = paths.iter().map_while(|path| named_nanos(path)).collect::<Vec<i64>>();
        let are_times = times_nanos.len() == paths.len();
        let times_nanos = if are_times { times_nanos } else { Vec::new() };
        Self { paths, times_nanos, next: 0, sample_interval: 1 }
    }

    fn capture_nanos(&self, index: usize) -> i64 {
        self.times_nanos.get(index).copied().unwrap_or(index as i64 * NOMINAL_INTERVAL_NANOS)
    }

    /// The image at this position, in the memory of `spare`.
    fn read(&self, index: usize, spare: Option<Frame>) -> Result<Frame, SourceError> {
        let path = &self.paths[index];
        let FrameMemory { mut name, colour, grey, jpeg } = FrameMemory::of(spare);
        let bytes = read_image_file(path, jpeg)?;
        let colour = decode_in(&bytes, &path.display().to_string(), colour)?;
        name.clear();
        name.push_str(&path.file_name().unwrap_or_default().to_string_lossy());
        Ok(Frame {
            index: index as u64,
            capture_nanos: self.capture_nanos(index),
            name,
            grey: luma_in(&colour, grey),
            colour,
            jpeg: codec::is_jpeg(&bytes).then_some(bytes),
            pose: None,
            true_place: None,
        })
    }
}

/// The bytes of the image file at `path`, at most 64 MiB, in memory that served before.
fn read_image_file(path: &Path, mut bytes: Vec<u8>) -> Result<Vec<u8>, SourceError> {
    let error = |source| SourceError::Io { path: path.to_owned(), source };
    bytes.clear();
    File::open(path).map_err(error)?.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(error)?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        let reason = format!("the file is larger than {} MiB", MAX_FILE_BYTES >> 20);
        return Err(SourceError::BadImage { name: path.display().to_string(), reason });
    }
    Ok(bytes)
}

/// The time in nanoseconds since the epoch that a file is called by: seconds with a decimal point (TUM's RGB-D data),
/// or whole milli-, micro- or nanoseconds (13, 16 or 19 digits: EuRoC, Oxford, others). `None` of any other name.
fn named_nanos(path: &Path) -> Option<i64> {
    let stem = path.file_stem()?.to_str()?;
    let (whole, fraction) = stem.split_once('.').unwrap_or((stem, ""));
    if [whole, fraction].iter().any(|digits| digits.bytes().any(|byte| !byte.is_ascii_digit())) {
        return None;
    }
    let unit_nanos: i64 = match (whole.len(), fraction.len()) {
        (9.., 1..) => 1_000_000_000,
        (13, 0) => 1_000_000,
        (16, 0) => 1_000,
        (19, 0) => 1,
        _ => return None,
    };
    let nanos = format!("{fraction:0<9}").get(..9)?.parse::<i64>().ok()?;
    whole.parse::<i64>().ok()?.checked_mul(unit_nanos)?.checked_add(nanos)
}

impl FrameSource for DirectorySource {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        self.next_frame_in(None)
    }

    fn next_frame_in(&mut self, spare: Option<Frame>) -> Option<Result<Frame, SourceError>> {
        let index = self.next;
        self.next = index.saturating_add(self.sample_interval);
        (index < self.paths.len()).then(|| self.read(index, spare))
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
    fn images_that_are_called_by_their_times_were_captured_then() {
        let captured = |names: &[&str]| -> Vec<i64> {
            let folder = folder_with(names);
            let mut source = DirectorySource::open(folder.path(), 1).unwrap();
            std::iter::from_fn(|| source.next_frame()).map(|frame| frame.unwrap().capture_nanos).collect()
        };
        let tum = ["1305031102.175304.jpg", "1305031102.2.jpg"];
        assert_eq!(captured(&tum), [1_305_031_102_175_304_000, 1_305_031_102_200_000_000]);
        let euroc = ["1403636579763555584.jpg", "1403636579813555456.jpg"];
        assert_eq!(captured(&euroc), [1_403_636_579_763_555_584, 1_403_636_579_813_555_456]);
        assert_eq!(captured(&["1403636579763555.jpg"]), [1_403_636_579_763_555_000]);
        assert_eq!(captured(&["1403636579763.jpg"]), [1_403_636_579_763_000_000]);
        for others in [
            ["000.jpg", "1305031102.175304.jpg"],
            ["9999999999999999999.jpg", "a.jpg"],
            ["1.5.jpg", "2.5.jpg"],
        ] {
            assert_eq!(captured(&others), [0, NOMINAL_INTERVAL_NANOS], "{others:?}");
        }
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
