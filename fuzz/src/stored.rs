//! Loci's own files. Few mutations of a checksummed file survive its checksum, so every input is read
//! twice: as it is, and with header, length and checksums mended.

use std::fs;
use std::path::Path;

use loci::feature::Descriptor;
use loci::place_map::PlaceMap;
use loci::storage::{FileKind, FileLog, HEADER_BYTES, RecordLog};
use loci::vocabulary::{Corpus, CorpusImage, TrainingFile, Vocabulary, WordId, import};

use super::accepted;
use super::folder::{folder, write};

const VOCABULARY: FileKind = FileKind { magic: *b"LOCIVOC\0", version: 2, name: "vocabulary" };
const VOCABULARY_1: FileKind = FileKind { version: 1, ..VOCABULARY };
const COUNTS_BYTES: usize = 32;
/// Longest body that mending makes.
const MAX_MENDED_BYTES: u64 = 1 << 16;

const TRAINING: FileKind = FileKind { magic: *b"LOCITRN\0", version: 1, name: "training file" };
const JOURNAL: FileKind = FileKind { magic: *b"LOCIMAP\0", version: 1, name: "journal" };
const JOURNAL_NAME: &str = "journal-000001.loci";
const JOURNAL_HEADER_BYTES: usize = 16;

/// `.lvoc` of both versions, [`Vocabulary::from_bytes`].
pub fn vocabulary_file(bytes: &[u8]) {
    read_vocabulary(bytes.to_vec());
    let Some((_, body)) = bytes.split_at_checked(HEADER_BYTES) else { return };
    let present = |nodes: u64, words: u64| 36 * nodes + nodes % 2 * 4 + 8 * words;
    let first = |nodes: u64, words: u64| 40 * nodes + 4 * words;
    for (kind, body) in [(VOCABULARY, mended(body, present)), (VOCABULARY_1, mended(body, first))] {
        if let Some(vocabulary) = read_vocabulary([&kind.header(&body)[..], &body].concat()) {
            vocabulary.verify(Path::new("mended")).expect("the mended checksum");
        }
    }
}

/// Vocabularies of other libraries, [`import::from_bytes`].
pub fn vocabulary_import(bytes: &[u8]) {
    if let Some((format, vocabulary)) = accepted(import::from_bytes(bytes, Path::new("foreign"))) {
        assert!(vocabulary.word_count() < vocabulary.node_count());
        use_vocabulary(&vocabulary, bytes);
        if format != import::VocabularyFormat::Loci {
            vocabulary.verify(Path::new("imported")).expect("a checksum of our own");
        }
    }
}

/// A training that was cut off, [`TrainingFile::open`].
pub fn training_file(bytes: &[u8]) {
    let here = folder();
    let path = write(here.path(), "v.training", bytes);
    read_training(&path);
    fs::remove_file(&path).expect("the training file");
    write_records(&path, &TRAINING, &payloads(bytes));
    read_training(&path);
}

fn read_training(path: &Path) {
    let Some(mut corpus) = accepted(TrainingFile::open(path, "images")) else { return };
    let image = CorpusImage { mean_luminance: 1.0, descriptors: vec![Descriptor([7; 32]); 2] };
    let (frames, descriptors) = (corpus.frame_count(), corpus.descriptor_count());
    corpus.push(Some(&image)).expect("a further frame");
    assert_eq!((corpus.frame_count(), corpus.descriptor_count()), (frames + 1, descriptors + 2));
    let mut visited = 0;
    accepted(corpus.visit(&mut |image| visited += image.len() as u64)).expect("the images that were counted");
    assert_eq!(visited, corpus.descriptor_count());
}

/// `body`, as long as its counts of nodes and words say.
fn mended(body: &[u8], tables_bytes: impl Fn(u64, u64) -> u64) -> Vec<u8> {
    let mut body = body.to_vec();
    if let Some(counts) = body.first_chunk::<COUNTS_BYTES>() {
        let count = |at: usize| u64::from(u32::from_le_bytes(std::array::from_fn(|i| counts[at + i])));
        let length = COUNTS_BYTES as u64 + tables_bytes(count(8), count(12));
        if length <= MAX_MENDED_BYTES {
            body.resize(length as usize, 0);
        }
    }
    body
}

fn read_vocabulary(bytes: Vec<u8>) -> Option<Vocabulary> {
    let vocabulary = accepted(Vocabulary::from_bytes(bytes.clone(), Path::new("vocabulary")))?;
    use_vocabulary(&vocabulary, &bytes);
    accepted(vocabulary.verify(Path::new("vocabulary")));
    Some(vocabulary)
}

/// Every question that a vocabulary answers, with descriptors from `bytes`.
fn use_vocabulary(vocabulary: &Vocabulary, bytes: &[u8]) {
    let patterns = [[0; 32], [0xFF; 32], [0x55; 32]].into_iter();
    let descriptors: Vec<Descriptor> =
        patterns.chain(bytes.as_chunks().0.iter().take(8).copied()).map(Descriptor).collect();
    let all = vocabulary.quantise_all(&descriptors);
    for (descriptor, quantised) in descriptors.iter().zip(all) {
        assert_eq!(vocabulary.quantise(descriptor), quantised);
        assert!(quantised.word.0 < vocabulary.word_count() && quantised.node.0 < vocabulary.node_count());
    }
    let is_weight = |word| (0.0..1e6).contains(&vocabulary.weight(WordId(word)));
    assert!((0..vocabulary.word_count()).all(is_weight));
    assert_eq!(vocabulary.weight(WordId(vocabulary.word_count())), 0.0);
}

/// A map's journal, [`PlaceMap::open`].
pub fn map_journal(bytes: &[u8]) {
    let here = folder();
    let path = write(here.path(), JOURNAL_NAME, bytes);
    read_map(here.path());
    fs::remove_file(&path).expect("the journal");
    write_records(&path, &JOURNAL, &payloads(bytes));
    read_map(here.path());
}

/// Opens a map as the program does: whatever is repaired and read must be there again the next time.
fn read_map(folder: &Path) {
    let found = accepted(PlaceMap::open_read_only(folder)).map(|map| contents(&map));
    let Some(mut map) = accepted(PlaceMap::open(folder)) else {
        assert!(found.is_none(), "what can be read cannot be opened for writing");
        return;
    };
    let written = contents(&map);
    assert_eq!(found, Some(written.clone()), "what can be written cannot be read");
    for experience in map.experiences() {
        accepted(map.thumbnail_jpeg(experience.id)).expect("the record that was just read");
    }
    let place = map.found_place().expect("a further place");
    assert_eq!(place.0 as usize, written.0);
    drop(map);
    let map = accepted(PlaceMap::open_read_only(folder)).expect("the map that was just repaired");
    assert_eq!((map.summary().torn_bytes, contents(&map)), (0, (written.0 + 1, written.1)));
}

fn contents(map: &PlaceMap) -> (usize, Vec<String>) {
    // As text, because a stored number may be NaN.
    let experiences = map.experiences().iter().map(|experience| format!("{experience:?}"));
    (map.places().len(), experiences.collect())
}

/// The payloads that the frames of a journal enclose; the last one may be cut.
fn payloads(journal: &[u8]) -> Vec<&[u8]> {
    let mut payloads = Vec::new();
    let mut rest = journal.get(JOURNAL_HEADER_BYTES..).unwrap_or_default();
    while let Some((frame, after)) = rest.split_first_chunk::<8>() {
        let length = u32::from_le_bytes(std::array::from_fn(|at| frame[at])) as usize;
        let (payload, next) = after.split_at(length.min(after.len()));
        payloads.extend((!payload.is_empty()).then_some(payload));
        rest = next;
    }
    payloads
}

fn write_records(path: &Path, kind: &FileKind, payloads: &[&[u8]]) {
    let store = Box::new(FileLog::open(path, true).expect("a new journal"));
    let (mut log, _) = RecordLog::open(store, kind, path, true, |_, _| Ok(())).expect("an empty journal");
    for payload in payloads {
        log.append(payload).expect("a record");
    }
}
