//! A recording that goes on in a new file once the one before is large or old enough: `run-000001.rrd`,
//! `run-000002.rrd`, … Numbers go on after those that earlier runs left, and the oldest files are removed where only so
//! many are to be kept.

use std::fs::{self, File};
use std::io;
use std::num::NonZero;
use std::path::{Path, PathBuf};

/// When a recording goes on in a new file, and how many are kept. Without size and age it never does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rotation {
    /// Size in MiB from which on a file is full.
    pub mib: Option<NonZero<u32>>,
    /// Minutes of capture time after which it is old.
    pub minutes: Option<NonZero<u32>>,
    /// Files that are kept, the one that is written included; all of them unless told otherwise.
    pub files: Option<NonZero<u32>>,
}

impl Rotation {
    /// Whether a recording goes on in new files at all.
    pub(super) fn happens(self) -> bool {
        self.mib.is_some() || self.minutes.is_some()
    }

    /// Whether a file of that size, whose first frame was captured so long ago, is done.
    pub(super) fn is_over(self, bytes: u64, age_nanos: i64) -> bool {
        const MINUTE_NANOS: i64 = 60_000_000_000;
        let is_full = self.mib.is_some_and(|mib| bytes >= u64::from(mib.get()) << 20);
        let is_old = self.minutes.is_some_and(|minutes| age_nanos / MINUTE_NANOS >= i64::from(minutes.get()));
        is_full || is_old
    }
}

/// The files of a recording that goes on.
#[derive(Debug)]
pub(super) struct Files {
    /// What the file would be called if it were the only one.
    named: PathBuf,
    most: Option<usize>,
    number: u64,
}

impl Files {
    /// Files beside `named`, after those that are there.
    pub(super) fn of(named: &Path, rotation: Rotation) -> io::Result<Self> {
        let number = numbers(named)?.last().copied().unwrap_or(0);
        let most = rotation.files.map(|files| files.get() as usize);
        Ok(Self { named: named.to_owned(), most, number })
    }

    /// The next file, which is claimed by that: two runs never write the same one. The oldest files make room where
    /// they have to; one that cannot be removed stays.
    pub(super) fn next(&mut self) -> io::Result<PathBuf> {
        loop {
            self.number = self.number.checked_add(1).ok_or(io::ErrorKind::AlreadyExists)?;
            let path = numbered(&self.named, self.number);
            match File::create_new(&path) {
                Ok(_) => {
                    self.make_room()?;
                    return Ok(path);
                }
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }

    fn make_room(&self) -> io::Result<()> {
        let Some(most) = self.most else { return Ok(()) };
        let numbers = numbers(&self.named)?;
        for number in &numbers[..numbers.len().saturating_sub(most)] {
            let _ = fs::remove_file(numbered(&self.named, *number));
        }
        Ok(())
    }
}

fn numbered(named: &Path, number: u64) -> PathBuf {
    let stem = named.file_stem().unwrap_or_default().to_string_lossy();
    named.with_file_name(format!("{stem}-{number:06}.rrd"))
}

/// The numbers of the files that are there, rising.
fn numbers(named: &Path) -> io::Result<Vec<u64>> {
    let folder = named.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let stem = named.file_stem().unwrap_or_default().to_string_lossy();
    let mut numbers = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = folder.join(entry?.file_name());
        let name = path.file_name().and_then(|name| name.to_str());
        let digits = name.and_then(|name| name.strip_prefix(&*stem)?.strip_prefix('-')?.strip_suffix(".rrd"));
        let number = digits.and_then(|digits| digits.parse::<u64>().ok());
        // Others may be called much the same.
        numbers.extend(number.filter(|number| numbered(named, *number).file_name() == path.file_name()));
    }
    numbers.sort_unstable();
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotation(mib: u32, minutes: u32, files: u32) -> Rotation {
        let [mib, minutes, files] = [mib, minutes, files].map(NonZero::new);
        Rotation { mib, minutes, files }
    }

    #[test]
    fn a_file_is_done_when_it_is_full_or_old() {
        let minute = 60_000_000_000;
        assert!(!rotation(0, 0, 3).happens() && !rotation(0, 0, 3).is_over(u64::MAX, i64::MAX));
        let full = rotation(2, 0, 0);
        assert!(full.happens() && full.is_over(2 << 20, 0) && !full.is_over((2 << 20) - 1, i64::MAX));
        let old = rotation(0, 5, 0);
        assert!(old.is_over(0, 5 * minute) && !old.is_over(u64::MAX, 5 * minute - 1));
        assert!(!old.is_over(0, -minute), "a clock that was set back");
        assert!(!rotation(0, u32::MAX, 0).is_over(0, i64::MAX / 100));
    }

    #[test]
    fn numbers_go_on_and_only_the_newest_files_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let named = folder.path().join("run.rrd");
        for other in [
            "run-000007.rrd",
            "run-000003.rrd",
            "run.rrd",
            "run-1.rrd",
            "run-0000008.rrd",
            "other-000009.rrd",
        ] {
            fs::write(folder.path().join(other), "x").unwrap();
        }
        let mut files = Files::of(&named, rotation(1, 0, 2)).unwrap();
        for number in [8, 9, 10] {
            let next = files.next().unwrap();
            assert_eq!(next, folder.path().join(format!("run-{number:06}.rrd")));
        }
        assert_eq!(numbers(&named).unwrap(), [9, 10]);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 6, "those of others stay");
    }

    #[test]
    fn all_files_are_kept_unless_told_otherwise() {
        let folder = tempfile::tempdir().unwrap();
        let named = folder.path().join("run.rrd");
        let mut files = Files::of(&named, rotation(1, 0, 0)).unwrap();
        (0..5).for_each(|_| drop(files.next().unwrap()));
        assert_eq!(numbers(&named).unwrap(), [1, 2, 3, 4, 5]);
    }

    #[test]
    fn two_runs_of_the_same_name_write_no_file_twice_and_what_cannot_be_removed_stays() {
        let folder = tempfile::tempdir().unwrap();
        let named = folder.path().join("run.rrd");
        fs::create_dir(folder.path().join("run-000001.rrd")).unwrap();
        let mut runs = [(); 2].map(|()| Files::of(&named, rotation(1, 0, 3)).unwrap());
        let written: Vec<PathBuf> = (0..4).map(|turn| runs[turn % 2].next().unwrap()).collect();
        let expected = [2, 3, 4, 5].map(|number| folder.path().join(format!("run-{number:06}.rrd")));
        assert_eq!(written, expected);
        assert_eq!(numbers(&named).unwrap(), [1, 3, 4, 5]);
    }
}
