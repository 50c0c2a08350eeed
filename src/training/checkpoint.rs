//! What a training has come to, written after every epoch, so that one that was cut off goes on.
//!
//! | Bytes | Field |
//! |---|---|
//! | 32 | header of every file of ours |
//! | 4 + 4 | length in bytes and CRC-32 of a text that says what is trained on what, how, and by which version |
//! | 4 | number of epochs |
//! | 24 each | their number, loss and recall, u64 and f64 |
//! | 8 + 8 + 8 | the best one, its recall and its loss on what is only looked at |
//! | 8 + n, three times | network, best network, optimiser, in burn's own format |

use std::path::{Path, PathBuf};

use burn::module::Module;
use burn::optim::ModuleOptimizer;
use burn::store::{ModuleRecord, RecordError};
use burn::tensor::Bytes;

use super::error::TrainingError;
use super::fitting::{self, Epoch, Fitted, Lesson};
use super::labelled::Glance;
use crate::storage::{FileBytes, FileKind, HEADER_BYTES, checksum, replace_file};

const KIND: FileKind = FileKind { magic: *b"LOCICKP\0", version: 1, name: "training checkpoint" };

/// Where a training has come to.
pub(super) struct State<N> {
    pub(super) network: N,
    pub(super) optimiser: ModuleOptimizer,
    pub(super) best: Fitted<N>,
}

impl<N: Module> State<N> {
    /// Before the first epoch.
    pub(super) fn begin<L: Lesson<Network = N>>(network: N, lesson: &L) -> Result<Self, TrainingError> {
        let glance = lesson.glance(&network)?;
        let best = Fitted { network: network.clone(), epoch: 0, glance, epochs: Vec::new() };
        Ok(Self { network, optimiser: fitting::optimiser(), best })
    }
}

/// The file in which a training keeps what it has come to.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    path: PathBuf,
    fingerprint: u64,
}

impl Checkpoint {
    /// The checkpoint at `path` of a training that `what` describes: one of another training, or of another version of
    /// the program, is not gone on with.
    #[must_use]
    pub fn new(path: &Path, what: &str) -> Self {
        let what = format!("{} {what}", env!("CARGO_PKG_VERSION"));
        let fingerprint =
            what.len() as u64 & u64::from(u32::MAX) | u64::from(checksum(what.as_bytes())) << 32;
        Self { path: path.to_owned(), fingerprint }
    }

    /// Whether there is a checkpoint at `path`, of whatever training, and it is whole.
    #[must_use]
    pub fn is_at(path: &Path) -> bool {
        FileBytes::map(path).is_ok_and(|file| KIND.verify(&file, path).is_ok())
    }

    /// Epochs that a training would go on from; 0 if there is none to go on with.
    #[must_use]
    pub fn epochs(&self) -> usize {
        self.file().and_then(|file| self.parsed(&file).map(|parsed| parsed.epochs.len())).unwrap_or(0)
    }

    /// Its bytes, if there is one and it is whole.
    fn file(&self) -> Option<FileBytes> {
        let file = FileBytes::map(&self.path).ok()?;
        KIND.verify(&file, &self.path).ok()?;
        Some(file)
    }

    fn parsed<'a>(&self, file: &'a [u8]) -> Option<Parsed<'a>> {
        let mut body = file.get(HEADER_BYTES..)?;
        if u64::from_le_bytes(take(&mut body)?) != self.fingerprint {
            return None;
        }
        let mut epochs = Vec::new();
        for _ in 0..u32::from_le_bytes(take(&mut body)?) {
            let number = u64::from_le_bytes(take(&mut body)?) as usize;
            let [loss, recall] = [take(&mut body)?, take(&mut body)?].map(f64::from_le_bytes);
            epochs.push(Epoch { number, loss, recall });
        }
        let epoch = u64::from_le_bytes(take(&mut body)?) as usize;
        let [recall, loss] = [take(&mut body)?, take(&mut body)?].map(f64::from_le_bytes);
        let glance = Glance { recall, loss };
        let records = [take_record(&mut body)?, take_record(&mut body)?, take_record(&mut body)?];
        Some(Parsed { epochs, epoch, glance, records })
    }

    /// What it holds; nothing if there is none, it is damaged, or of another training.
    pub(super) fn read<N: Module>(&self, network: &N) -> Option<State<N>> {
        let file = self.file()?;
        let Parsed { epochs, epoch, glance, records: [latest, best, optimiser] } = self.parsed(&file)?;
        let network_of = |record: &[u8]| {
            let record = ModuleRecord::from_bytes(Bytes::from_bytes_vec(record.to_vec())).ok()?;
            network.clone().try_load_record(record).ok()
        };
        let best = Fitted { network: network_of(best)?, epoch, glance, epochs };
        let optimiser = Bytes::from_bytes_vec(optimiser.to_vec());
        let optimiser = fitting::optimiser().from_bytes(optimiser).ok()?;
        Some(State { network: network_of(latest)?, optimiser, best })
    }

    /// Takes the place of what it held before, whole or not at all.
    pub(super) fn write<N: Module>(&self, state: &State<N>) -> Result<(), TrainingError> {
        let Fitted { network, epoch, glance, epochs } = &state.best;
        let mut body = self.fingerprint.to_le_bytes().to_vec();
        body.extend((epochs.len() as u32).to_le_bytes());
        for Epoch { number, loss, recall } in epochs {
            body.extend((*number as u64).to_le_bytes());
            body.extend(loss.to_le_bytes());
            body.extend(recall.to_le_bytes());
        }
        body.extend((*epoch as u64).to_le_bytes());
        body.extend(glance.recall.to_le_bytes());
        body.extend(glance.loss.to_le_bytes());
        let device = |error: RecordError| TrainingError::Device { reason: error.to_string() };
        let networks = [state.network.clone(), network.clone()];
        let [latest, best] = networks.map(|network| network.into_record().into_bytes().map_err(device));
        for record in [latest?, best?, state.optimiser.into_bytes().map_err(device)?] {
            body.extend((record.len() as u64).to_le_bytes());
            body.extend(&record[..]);
        }
        Ok(replace_file(&self.path, &[&KIND.header(&body), &body])?)
    }
}

/// What a checkpoint's file says.
struct Parsed<'a> {
    epochs: Vec<Epoch>,
    epoch: usize,
    glance: Glance,
    /// Network, best network, optimiser.
    records: [&'a [u8]; 3],
}

fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (taken, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    Some(*taken)
}

fn take_record<'a>(bytes: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = usize::try_from(u64::from_le_bytes(take(bytes)?)).ok()?;
    let (record, rest) = bytes.split_at_checked(length)?;
    *bytes = rest;
    Some(record)
}
