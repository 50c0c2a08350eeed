//! A folder on a simulated medium, for tests of what is left when power fails or the medium is full.
//!
//! It keeps what [`Folder`] and [`AppendFile`] promise, and nothing beyond. While there is power, everyone
//! sees everything that was done. After a power cut there is for certain what was synced; of what was done
//! since the last completed sync, each thing may have reached the medium or not, whatever happened to the
//! others:
//!
//! | Done | By which sync it stays | What may be left of it without |
//! |---|---|---|
//! | file made, renamed or removed | the folder's | all or nothing |
//! | truncation | the file's | all or nothing |
//! | append | the file's | of each sector of 512 bytes: nothing, its first bytes, or all |
//!
//! What is missing of an append before other bytes is found as zeros, and so may be what is missing at its end,
//! or some of it: a file's length and its bytes reach the medium each in their own time.
//!
//! Whatever is kept of one file or folder is kept in the order in which it was done. So a truncation may be lost of
//! which a later append is kept, then found amid the old bytes. Synced bytes are never hurt by what is appended.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::append_file::{AppendFile, refuse_deleted};
use super::folder::Folder;

/// What reaches the medium, or does not, whatever happens to the bytes before and behind.
const SECTOR_BYTES: usize = 512;

/// The number of an input/output error on Linux.
const EIO: i32 = 5;

/// Answers which of so many ways, at least two, a thing went that power may have cut: 0 is "lost", the last
/// one "kept whole".
type Choose<'a> = &'a mut dyn FnMut(usize) -> usize;

/// Files by their names, as indices into the medium's files.
type Names = BTreeMap<String, usize>;

/// A folder on a medium whose power may be cut at any operation, and that may become full. Clones are the
/// same folder.
#[derive(Clone, Default)]
pub(crate) struct FaultyFolder(Arc<Mutex<Medium>>);

impl FaultyFolder {
    /// Number of changing operations so far: appends, truncations, syncs of files, files made, renamed and removed,
    /// syncs of the folder. Those count that failed or were cut by the power, but not those tried without power or on a
    /// name that is not there. Opening an existing file and reading do not count.
    pub(crate) fn operations(&self) -> u64 {
        self.medium().operations
    }

    /// Cuts the power in the midst of operation number `operation`, counted from 0: it may have had its effect or not,
    /// and it and whatever is tried later fails, reading too, with `BrokenPipe`. If it is past, power is cut at once.
    pub(crate) fn cut_power_at(&self, operation: u64) {
        self.medium().cut_at = Some(operation);
    }

    /// Operation number `operation` alone fails, with an input/output error and no effect but for half of an append.
    /// A sync that does gives up what it was to bring to the medium, as systems do: it can be read, but no later sync
    /// brings it.
    pub(crate) fn fail_at(&self, operation: u64) {
        self.medium().failing = Some(operation);
    }

    /// From operation number `operation` on, every append is refused with `StorageFull` after half of its bytes.
    pub(crate) fn fill_up_at(&self, operation: u64) {
        self.medium().full_from = Some(operation);
    }

    /// What may be found if power is cut, or was: another folder on a healthy medium, where everything is
    /// synced and nothing was counted yet.
    ///
    /// `choose` answers a number below the one that it is given, which is at least 2, for each thing that may
    /// have been cut. 0 is "lost", the largest "kept whole", so `|_| 0` leaves what is certain alone and
    /// `|ways| ways - 1` everything. For a sector 1 is "torn", if it can be. Things are asked for in the order
    /// in which they were done, first those of the folder, then those of each file that is found.
    ///
    /// # Panics
    /// If an answer is too large. `choose` must leave this folder alone, which waits for it.
    pub(crate) fn after_power_cut(&self, choose: &mut dyn FnMut(usize) -> usize) -> FaultyFolder {
        let mut checked = |ways: usize| {
            let chosen = choose(ways);
            assert!(chosen < ways, "there are {ways} ways, number {chosen} is none of them");
            chosen
        };
        Self(Arc::new(Mutex::new(self.medium().after_power_cut(&mut checked))))
    }

    fn medium(&self) -> MutexGuard<'_, Medium> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Folder for FaultyFolder {
    fn path(&self) -> &Path {
        Path::new("faulty folder")
    }

    fn names(&self) -> io::Result<Vec<String>> {
        let medium = self.medium();
        medium.check_power()?;
        Ok(medium.names.keys().cloned().collect())
    }

    fn open(&self, name: &str, writable: bool) -> io::Result<Arc<dyn AppendFile>> {
        let mut medium = self.medium();
        let index = match medium.index_of(name) {
            Err(error) if writable && error.kind() == io::ErrorKind::NotFound => {
                let index = medium.files.len();
                medium.files.push(FileOnMedium::default());
                medium.change_names(NameChange { gone: None, given: Some((name.to_owned(), index)) })?;
                index
            }
            found => found?,
        };
        Ok(Arc::new(FaultyFile { folder: self.clone(), index, is_writable: writable }))
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        let mut medium = self.medium();
        let index = medium.index_of(from)?;
        medium.change_names(NameChange { gone: Some(from.to_owned()), given: Some((to.to_owned(), index)) })
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        let mut medium = self.medium();
        medium.index_of(name)?;
        medium.change_names(NameChange { gone: Some(name.to_owned()), given: None })
    }

    fn sync(&self) -> io::Result<()> {
        let mut medium = self.medium();
        medium.operate(|_| ())?;
        medium.durable_names = medium.names.clone();
        medium.pending.clear();
        Ok(())
    }
}

/// A file of a [`FaultyFolder`], by whatever name, or none.
struct FaultyFile {
    folder: FaultyFolder,
    index: usize,
    is_writable: bool,
}

impl FaultyFile {
    fn medium_to_write(&self) -> io::Result<MutexGuard<'_, Medium>> {
        if self.is_writable {
            Ok(self.folder.medium())
        } else {
            Err(io::Error::new(io::ErrorKind::PermissionDenied, "it was opened for reading"))
        }
    }
}

impl AppendFile for FaultyFile {
    fn length_bytes(&self) -> io::Result<u64> {
        let medium = self.folder.medium();
        medium.check_power()?;
        Ok(medium.files[self.index].bytes.len() as u64)
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
        let medium = self.folder.medium();
        medium.check_power()?;
        let start = usize::try_from(offset).unwrap_or(usize::MAX);
        let part = medium.files[self.index].bytes.get(start..start.saturating_add(buffer.len()));
        buffer.copy_from_slice(part.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    fn append(&self, bytes: &[u8]) -> io::Result<()> {
        let mut medium = self.medium_to_write()?;
        let full = medium.full_from.is_some_and(|from| from <= medium.operations);
        let refusal = full.then(|| io::ErrorKind::StorageFull.into()).or_else(|| medium.failure());
        let taken = if refusal.is_some() { &bytes[..bytes.len() / 2] } else { bytes };
        let at = medium.files[self.index].bytes.len();
        medium.write(self.index, Write::Appended { at, bytes: taken.to_vec() })?;
        refusal.map_or(Ok(()), Err)
    }

    fn truncate(&self, length_bytes: u64) -> io::Result<()> {
        let length = usize::try_from(length_bytes).unwrap_or(usize::MAX);
        self.medium_to_write()?.write(self.index, Write::Truncated { length })
    }

    fn sync(&self) -> io::Result<()> {
        let mut medium = self.folder.medium();
        if let Some(failure) = medium.failure() {
            medium.files[self.index].forget_pending();
            medium.operate(|_| ())?;
            return Err(failure);
        }
        medium.operate(|_| ())?;
        medium.files[self.index].sync();
        drop(medium);
        refuse_deleted(self)
    }

    fn is_linked(&self) -> io::Result<bool> {
        let medium = self.folder.medium();
        medium.check_power()?;
        Ok(medium.is_named(self.index))
    }
}

/// What there is, and what of it would be found after a power cut.
#[derive(Default)]
struct Medium {
    /// Every file that ever was: one without a name may still be open, or get its name back.
    files: Vec<FileOnMedium>,
    names: Names,
    /// The names as they were when the folder was last synced.
    durable_names: Names,
    /// What led from those to these.
    pending: Vec<NameChange>,
    operations: u64,
    cut_at: Option<u64>,
    full_from: Option<u64>,
    failing: Option<u64>,
}

impl Medium {
    fn check_power(&self) -> io::Result<()> {
        match self.cut_at {
            Some(cut_at) if cut_at < self.operations => {
                Err(io::Error::new(io::ErrorKind::BrokenPipe, "the power is cut"))
            }
            _ => Ok(()),
        }
    }

    /// Does what can be lost until it is synced, and fails if power is cut before or in the midst of it.
    fn operate(&mut self, operation: impl FnOnce(&mut Self)) -> io::Result<()> {
        self.check_power()?;
        let failure = self.failure();
        if failure.is_none() {
            operation(self);
        }
        self.operations += 1;
        failure.map_or_else(|| self.check_power(), Err)
    }

    /// The error of the next operation, if it is the one that is to fail.
    fn failure(&mut self) -> Option<io::Error> {
        self.failing.take_if(|failing| *failing == self.operations).map(|_| io::Error::from_raw_os_error(EIO))
    }

    fn index_of(&self, name: &str) -> io::Result<usize> {
        self.check_power()?;
        self.names.get(name).copied().ok_or_else(|| io::ErrorKind::NotFound.into())
    }

    fn is_named(&self, index: usize) -> bool {
        self.names.values().any(|&named| named == index)
    }

    fn change_names(&mut self, change: NameChange) -> io::Result<()> {
        self.operate(|medium| {
            change.apply(&mut medium.names);
            medium.pending.push(change);
        })
    }

    fn write(&mut self, index: usize, write: Write) -> io::Result<()> {
        self.operate(|medium| {
            let file = &mut medium.files[index];
            write.apply(&mut file.bytes);
            file.pending.push(write);
        })
    }

    fn after_power_cut(&self, choose: Choose<'_>) -> Self {
        let mut names = self.durable_names.clone();
        for change in &self.pending {
            if choose(2) == 1 {
                change.apply(&mut names);
            }
        }
        let mut found = Self { names: names.clone(), durable_names: names, ..Self::default() };
        for (index, file) in self.files.iter().enumerate() {
            // Indices stay what they were, so that names go on meaning the same files.
            let bytes = if found.is_named(index) { file.after_power_cut(choose) } else { Vec::new() };
            found.files.push(FileOnMedium { durable: bytes.clone(), bytes, pending: Vec::new() });
        }
        found
    }
}

/// What happened to the names in a folder, all or nothing: a file that was made was given its name, one that
/// was removed lost it, one that was renamed did both. It names the file itself, so a file whose first name
/// never reached the medium may still be found under its second.
struct NameChange {
    gone: Option<String>,
    given: Option<(String, usize)>,
}

impl NameChange {
    fn apply(&self, names: &mut Names) {
        if let Some(name) = &self.gone {
            names.remove(name);
        }
        if let Some((name, index)) = &self.given {
            names.insert(name.clone(), *index);
        }
    }
}

/// A file's bytes.
#[derive(Default)]
struct FileOnMedium {
    bytes: Vec<u8>,
    /// The bytes as they were when the file was last synced.
    durable: Vec<u8>,
    /// What led from those to these.
    pending: Vec<Write>,
}

impl FileOnMedium {
    /// What was appended since the last sync will not be brought to the medium any more.
    fn forget_pending(&mut self) {
        for write in &mut self.pending {
            if let Write::Appended { bytes, .. } = write {
                bytes.fill(0);
            }
        }
    }

    fn sync(&mut self) {
        for write in self.pending.drain(..) {
            write.apply(&mut self.durable);
        }
    }

    fn after_power_cut(&self, choose: Choose<'_>) -> Vec<u8> {
        let mut found = self.durable.clone();
        for write in &self.pending {
            match write {
                Write::Appended { at, bytes } => keep_sectors((*at, bytes), &mut found, choose),
                Write::Truncated { .. } if choose(2) == 1 => write.apply(&mut found),
                Write::Truncated { .. } => {}
            }
        }
        found
    }
}

/// What was done to a file's bytes.
enum Write {
    Appended { at: usize, bytes: Vec<u8> },
    Truncated { length: usize },
}

impl Write {
    fn apply(&self, file: &mut Vec<u8>) {
        match self {
            Self::Appended { bytes, .. } => file.extend_from_slice(bytes),
            Self::Truncated { length } => file.truncate(*length),
        }
    }
}

/// Brings those sectors of what was `appended` at an offset into the `found` bytes that reached the medium.
fn keep_sectors((mut at, appended): (usize, &[u8]), found: &mut Vec<u8>, choose: Choose<'_>) {
    let mut rest = appended;
    while !rest.is_empty() {
        let sector_bytes = (SECTOR_BYTES - at % SECTOR_BYTES).min(rest.len());
        let (sector, behind) = rest.split_at(sector_bytes);
        let kept = &sector[..kept_bytes(sector_bytes, choose)];
        if !kept.is_empty() {
            found.resize(found.len().max(at + kept.len()), 0);
            found[at..at + kept.len()].copy_from_slice(kept);
        }
        at += sector_bytes;
        rest = behind;
    }
    // The length is written apart from the bytes, and may say more than there is.
    let missing = at.saturating_sub(found.len());
    if missing > 0 {
        found.resize(found.len() + choose(missing + 1), 0);
    }
}

/// How many bytes of a sector reached the medium.
fn kept_bytes(sector_bytes: usize, choose: Choose<'_>) -> usize {
    // A byte cannot be torn, and one of two is the only way to tear those.
    match choose(sector_bytes.min(2) + 1) {
        0 => 0,
        1 if sector_bytes == 2 => 1,
        1 if sector_bytes > 2 => 1 + choose(sector_bytes - 1),
        _ => sector_bytes,
    }
}

#[cfg(test)]
mod tests {
    use super::super::folder::replace;
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    fn lost(_ways: usize) -> usize {
        0
    }

    fn kept(ways: usize) -> usize {
        ways - 1
    }

    fn content(folder: &dyn Folder, name: &str) -> io::Result<Vec<u8>> {
        let file = folder.open(name, false)?;
        let mut bytes = vec![0; file.length_bytes()? as usize];
        file.read_at(0, &mut bytes)?;
        Ok(bytes)
    }

    /// The file's bytes; `None` if it is not there.
    fn found(folder: &FaultyFolder, name: &str) -> Option<Vec<u8>> {
        match content(folder, name) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            bytes => Some(bytes.unwrap()),
        }
    }

    /// A synced file "a" of so many ones.
    fn with_ones(count: usize) -> (FaultyFolder, Arc<dyn AppendFile>) {
        let folder = FaultyFolder::default();
        let file = folder.open("a", true).unwrap();
        file.append(&vec![1; count]).unwrap();
        file.sync().unwrap();
        folder.sync().unwrap();
        (folder, file)
    }

    /// What file `name` may be after a power cut: every way there is.
    fn outcomes(folder: &FaultyFolder, name: &str) -> BTreeSet<Option<Vec<u8>>> {
        let mut outcomes = BTreeSet::new();
        let mut path: Vec<usize> = Vec::new();
        loop {
            let mut asked = Vec::new();
            let after = folder.after_power_cut(&mut |ways| {
                asked.push(ways);
                let depth = asked.len() - 1;
                path.resize(path.len().max(depth + 1), 0);
                path[depth]
            });
            outcomes.insert(found(&after, name));
            path.truncate(asked.len());
            while let Some(last) = path.pop() {
                if last + 1 < asked[path.len()] {
                    path.push(last + 1);
                    break;
                }
            }
            if path.is_empty() {
                return outcomes;
            }
        }
    }

    /// Answers evenly spread numbers, others for every seed.
    fn random(seed: u64) -> impl FnMut(usize) -> usize {
        let mut state = seed;
        move |ways| {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mixed = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((mixed ^ (mixed >> 31)) % ways as u64) as usize
        }
    }

    #[derive(Clone, Copy, Debug)]
    enum Step {
        Append(&'static str, u8, usize),
        Truncate(&'static str, u64),
        SyncFile(&'static str),
        Rename(&'static str, &'static str),
        Remove(&'static str),
        SyncFolder,
    }

    impl Step {
        fn take(&self, folder: &FaultyFolder) -> io::Result<()> {
            match *self {
                Self::Append(name, byte, count) => folder.open(name, true)?.append(&vec![byte; count]),
                Self::Truncate(name, length) => folder.open(name, true)?.truncate(length),
                Self::SyncFile(name) => folder.open(name, true)?.sync(),
                Self::Rename(from, to) => folder.rename(from, to),
                Self::Remove(name) => folder.remove(name),
                Self::SyncFolder => folder.sync(),
            }
        }
    }

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let name = || prop::sample::select(vec!["a", "b", "c"]);
        let step = prop_oneof![
            4 => (name(), 1..=255_u8, 0..1500_usize).prop_map(|(name, byte, count)| Step::Append(name, byte, count)),
            1 => (name(), 0..1500_u64).prop_map(|(name, length)| Step::Truncate(name, length)),
            3 => name().prop_map(Step::SyncFile),
            1 => (name(), name()).prop_map(|(from, to)| Step::Rename(from, to)),
            1 => name().prop_map(Step::Remove),
            2 => Just(Step::SyncFolder),
        ];
        prop::collection::vec(step, 1..40)
    }

    /// What is certain of a file: the bytes that it begins with, and whether its name stays.
    #[derive(Clone, Default)]
    struct Certain {
        bytes: Vec<u8>,
        is_named: bool,
    }

    /// Follows what was tried and, if it was done, what is certain by it.
    fn learn(certain: &mut BTreeMap<&'static str, Certain>, step: &Step, done: Option<&FaultyFolder>) {
        match (*step, done) {
            (Step::Append(name, ..), _) => drop(certain.entry(name).or_default()),
            (Step::Truncate(name, length), _) => {
                certain.entry(name).or_default().bytes.truncate(length as usize);
            }
            (Step::SyncFile(name), Some(folder)) => {
                certain.entry(name).or_default().bytes = content(folder, name).unwrap();
            }
            (Step::Rename(from, to), _) if from != to => {
                if let Some(moved) = certain.remove(from) {
                    certain.insert(to, Certain { is_named: false, ..moved });
                }
            }
            (Step::Remove(name), _) => drop(certain.remove(name)),
            (Step::SyncFolder, Some(_)) => certain.values_mut().for_each(|file| file.is_named = true),
            _ => {}
        }
    }

    proptest! {
        #[test]
        fn what_was_synced_is_found_whatever_else_is_lost(steps in steps(), cut_at in 0..60_u64, seed: u64) {
            let folder = FaultyFolder::default();
            folder.cut_power_at(cut_at);
            let mut certain = BTreeMap::new();
            for step in &steps {
                let taken = step.take(&folder);
                let is_cut = taken.as_ref().is_err_and(|error| error.kind() == io::ErrorKind::BrokenPipe);
                learn(&mut certain, step, taken.is_ok().then_some(&folder));
                if is_cut {
                    break;
                }
            }
            for choose in [&mut lost as &mut dyn FnMut(usize) -> usize, &mut |_| 1, &mut kept, &mut random(seed)] {
                let after = folder.after_power_cut(choose);
                for (name, file) in certain.iter().filter(|(_, file)| file.is_named) {
                    let bytes = found(&after, name);
                    prop_assert!(bytes.is_some_and(|bytes| bytes.starts_with(&file.bytes)), "{name}");
                }
            }
        }

        #[test]
        fn everything_is_found_where_nothing_is_lost(steps in steps()) {
            let folder = FaultyFolder::default();
            for step in &steps {
                let _ = step.take(&folder);
            }
            let after = folder.after_power_cut(&mut kept);
            prop_assert_eq!(after.names().unwrap(), folder.names().unwrap());
            for name in folder.names().unwrap() {
                prop_assert_eq!(found(&after, &name), found(&folder, &name));
            }
            let again = after.after_power_cut(&mut |_| panic!("what was found is certain"));
            prop_assert_eq!(again.names().unwrap(), folder.names().unwrap());
        }
    }

    #[test]
    fn appended_bytes_that_were_not_synced_may_be_lost_torn_or_zeros() {
        let (folder, file) = with_ones(1);
        file.append(&[2, 3]).unwrap();
        let expected: [&[u8]; 5] = [&[1], &[1, 0], &[1, 0, 0], &[1, 2], &[1, 2, 0]];
        let mut expected: BTreeSet<_> = expected.iter().map(|bytes| Some(bytes.to_vec())).collect();
        expected.insert(Some(vec![1, 2, 3]));
        assert_eq!(outcomes(&folder, "a"), expected);
    }

    #[test]
    fn a_later_sector_may_be_kept_where_an_earlier_one_is_lost() {
        let (folder, file) = with_ones(500);
        file.append(&[2; 1000]).unwrap();
        let mut sectors = [0, 2, 0, 300].into_iter();
        let after = folder.after_power_cut(&mut |_| sectors.next().unwrap());
        let expected = [vec![1; 500], vec![0; 12], vec![2; 512], vec![0; 300]].concat();
        assert_eq!(found(&after, "a").unwrap(), expected);
        assert_eq!(sectors.next(), None);
    }

    #[test]
    fn a_sector_may_be_torn_anywhere() {
        let (folder, file) = with_ones(0);
        file.append(&[2; SECTOR_BYTES]).unwrap();
        for torn_bytes in 1..SECTOR_BYTES {
            let mut answers = [1, torn_bytes - 1, 0].into_iter();
            let after = folder.after_power_cut(&mut |_| answers.next().unwrap());
            assert_eq!(found(&after, "a").unwrap(), vec![2; torn_bytes]);
        }
    }

    #[test]
    fn a_truncation_may_be_lost_of_which_a_later_append_is_kept() {
        let (folder, file) = with_ones(3);
        file.truncate(1).unwrap();
        file.append(&[2]).unwrap();
        let expected: [&[u8]; 5] = [&[1, 1, 1], &[1, 2, 1], &[1], &[1, 0], &[1, 2]];
        assert_eq!(outcomes(&folder, "a"), expected.iter().map(|bytes| Some(bytes.to_vec())).collect());
        file.sync().unwrap();
        assert_eq!(outcomes(&folder, "a"), BTreeSet::from([Some(vec![1, 2])]));
    }

    #[test]
    fn a_name_that_was_not_synced_may_be_lost_though_the_bytes_were_synced() {
        let folder = FaultyFolder::default();
        let file = folder.open("a", true).unwrap();
        file.append(b"synced").unwrap();
        file.sync().unwrap();
        assert_eq!(outcomes(&folder, "a"), BTreeSet::from([None, Some(b"synced".to_vec())]));
        folder.sync().unwrap();
        assert_eq!(outcomes(&folder, "a"), BTreeSet::from([Some(b"synced".to_vec())]));
    }

    #[test]
    fn a_rename_is_all_or_nothing_and_does_not_need_the_first_name() {
        let (folder, _) = with_ones(1);
        let file = folder.open("b", true).unwrap();
        file.append(&[2]).unwrap();
        file.sync().unwrap();
        folder.rename("b", "a").unwrap();
        let mut seen = BTreeSet::new();
        for (is_made, is_renamed) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let mut answers = [is_made, is_renamed].into_iter();
            let after = folder.after_power_cut(&mut |_| answers.next().unwrap());
            seen.insert((is_made, is_renamed, found(&after, "a"), found(&after, "b")));
        }
        let (old, new) = (Some(vec![1]), Some(vec![2]));
        assert_eq!(
            seen,
            BTreeSet::from([
                (0, 0, old.clone(), None),
                (0, 1, new.clone(), None),
                (1, 0, old, new.clone()),
                (1, 1, new, None),
            ])
        );
        folder.rename("a", "a").unwrap();
        assert_eq!(found(&folder.after_power_cut(&mut kept), "a"), Some(vec![2]));
    }

    #[test]
    fn a_removed_file_may_be_back_until_the_folder_is_synced() {
        let (folder, file) = with_ones(1);
        folder.remove("a").unwrap();
        assert_eq!(outcomes(&folder, "a"), BTreeSet::from([None, Some(vec![1])]));
        file.append(&[2]).unwrap();
        assert_eq!(file.length_bytes().unwrap(), 2);
        assert!(file.sync().unwrap_err().to_string().contains("deleted"));
        folder.sync().unwrap();
        assert_eq!(outcomes(&folder, "a"), BTreeSet::from([None]));
    }

    #[test]
    fn changing_operations_are_counted_and_no_others() {
        let (folder, file) = with_ones(1);
        assert_eq!(folder.operations(), 4);
        file.truncate(0).unwrap();
        folder.rename("a", "b").unwrap();
        folder.clone().remove("b").unwrap();
        assert_eq!(folder.operations(), 7);
        folder.names().unwrap();
        file.length_bytes().unwrap();
        assert!(folder.remove("b").is_err() && folder.rename("b", "a").is_err());
        assert!(folder.open("b", false).is_err() && file.read_at(0, &mut [0]).is_err());
        assert_eq!(folder.operations(), 7);
        folder.open("b", true).unwrap();
        let reading = folder.open("b", false).unwrap();
        assert_eq!(reading.append(b"x").unwrap_err().kind(), io::ErrorKind::PermissionDenied);
        assert_eq!(folder.operations(), 8);
    }

    #[test]
    fn nothing_works_once_power_is_cut() {
        let (folder, file) = with_ones(1);
        folder.cut_power_at(folder.operations() + 1);
        file.append(&[2]).unwrap();
        assert_eq!(found(&folder, "a").unwrap(), [1, 2]);
        let errors = [
            file.sync().err(),
            file.length_bytes().err(),
            file.read_at(0, &mut [0]).err(),
            file.append(&[3]).err(),
            file.truncate(0).err(),
            folder.names().err(),
            folder.open("a", false).err(),
            folder.open("b", true).err(),
            folder.rename("a", "b").err(),
            folder.remove("a").err(),
            folder.sync().err(),
        ];
        for error in errors {
            assert_eq!(error.unwrap().kind(), io::ErrorKind::BrokenPipe);
        }
        assert_eq!(folder.operations(), 6);
        let lost = folder.after_power_cut(&mut lost);
        assert_eq!(found(&lost, "a").unwrap(), [1], "the sync was not completed");
        let kept = folder.after_power_cut(&mut kept);
        assert_eq!(found(&kept, "a").unwrap(), [1, 2]);
    }

    #[test]
    fn the_operation_in_whose_midst_power_is_cut_may_have_had_its_effect() {
        let (folder, file) = with_ones(1);
        folder.cut_power_at(folder.operations());
        assert_eq!(file.append(&[2]).unwrap_err().kind(), io::ErrorKind::BrokenPipe);
        let expected = [vec![1], vec![1, 0], vec![1, 2]].map(Some);
        assert_eq!(outcomes(&folder, "a"), BTreeSet::from(expected));
    }

    #[test]
    fn a_full_medium_takes_half_and_refuses_the_rest() {
        let (folder, file) = with_ones(1);
        folder.fill_up_at(folder.operations() + 1);
        file.append(&[2; 4]).unwrap();
        assert_eq!(file.append(&[3; 5]).unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert_eq!(found(&folder, "a").unwrap(), [1, 2, 2, 2, 2, 3, 3]);
        file.truncate(5).unwrap();
        file.sync().unwrap();
        folder.rename("a", "b").unwrap();
        folder.sync().unwrap();
        assert_eq!(outcomes(&folder, "b"), BTreeSet::from([Some(vec![1, 2, 2, 2, 2])]));
    }

    #[test]
    fn a_replaced_file_is_old_or_new_wherever_power_is_cut() {
        for old in [None, Some(b"old".to_vec())] {
            let mut cut_at = 0;
            loop {
                let folder = FaultyFolder::default();
                if let Some(old) = &old {
                    replace(&folder, "a", &[old]).unwrap();
                }
                folder.cut_power_at(folder.operations() + cut_at);
                let replaced = replace(&folder, "a", &[b"ne", b"w"]);
                let new = Some(b"new".to_vec());
                if replaced.is_ok() {
                    assert_eq!(outcomes(&folder, "a"), BTreeSet::from([new]));
                    assert_eq!(cut_at, 7, "every operation was cut once");
                    break;
                }
                let either = BTreeSet::from([old.clone(), new]);
                let outcomes = outcomes(&folder, "a");
                assert!(outcomes.contains(&old) && outcomes.is_subset(&either), "{cut_at}: {outcomes:?}");
                cut_at += 1;
            }
        }
    }

    #[test]
    fn a_file_replaced_without_a_sync_may_be_neither_old_nor_new() {
        let (folder, _) = with_ones(2);
        folder.open("b", true).unwrap().append(&[2, 2]).unwrap();
        folder.rename("b", "a").unwrap();
        folder.sync().unwrap();
        assert!(outcomes(&folder, "a").contains(&Some(vec![2, 0])));
        assert!(outcomes(&folder, "a").contains(&Some(Vec::new())));
    }

    #[test]
    fn a_replacement_that_a_full_medium_refuses_leaves_the_old_file_alone() {
        let (folder, _) = with_ones(1);
        folder.fill_up_at(folder.operations());
        assert_eq!(replace(&folder, "a", &[&[2; 4]]).unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert_eq!(folder.names().unwrap(), ["a"]);
        assert_eq!(outcomes(&folder, "a"), BTreeSet::from([Some(vec![1])]));
    }

    #[test]
    fn an_operation_that_is_to_fail_does_so_once_and_the_others_work() {
        let (folder, file) = with_ones(1);
        let fail_next = || folder.fail_at(folder.operations());
        fail_next();
        assert_eq!(file.append(&[2; 4]).unwrap_err().raw_os_error(), Some(EIO));
        assert_eq!(found(&folder, "a").unwrap(), [1, 2, 2]);
        fail_next();
        assert!(file.truncate(1).is_err() && found(&folder, "a").unwrap().len() == 3);
        file.truncate(1).unwrap();
        fail_next();
        assert!(folder.rename("a", "b").is_err() && folder.names().unwrap() == ["a"]);
        fail_next();
        assert!(folder.remove("a").is_err() && folder.sync().is_ok());
        fail_next();
        assert!(folder.open("b", true).is_err() && folder.names().unwrap() == ["a"]);
    }

    #[test]
    fn what_a_sync_that_failed_was_to_bring_is_not_brought_by_a_later_one() {
        let (folder, file) = with_ones(1);
        file.append(&[2]).unwrap();
        folder.fail_at(folder.operations());
        file.sync().unwrap_err();
        file.append(&[3]).unwrap();
        file.sync().unwrap();
        assert_eq!(found(&folder, "a").unwrap(), [1, 2, 3], "it can still be read");
        assert_eq!(outcomes(&folder, "a"), BTreeSet::from([Some(vec![1, 0, 3])]));
    }
}
