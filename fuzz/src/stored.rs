//! Loci's own files. Few mutations of a checksummed file survive its checksum, so every input is read
//! twice: as it is, and with header, length and checksums mended.

use std::fs;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use loci::feature::Descriptor;
use loci::frame::Frame;
use loci::place_map::{MapError, MapOptions, NewExperience, PlaceMap};
use loci::raster::{GreyImage, RgbImage};
use loci::retrieval::{BowVector, DocumentId, InvertedIndex, SnapshotReader};
use loci::storage::{
    AppendFile, Envelope, FileBytes, FileKind, HEADER_BYTES, LogIdentity, MemoryFile, Reading, RecordLog,
    StorageError, Tail, checksum,
};
use loci::vocabulary::{Corpus, CorpusImage, TrainingFile, Vocabulary, Weighting, WordId, import};

use super::accepted;
use super::folder::{folder, write};

const VOCABULARY: FileKind = FileKind { magic: *b"LOCIVOC\0", version: 2, name: "vocabulary" };
const VOCABULARY_1: FileKind = FileKind { version: 1, ..VOCABULARY };
const COUNTS_BYTES: usize = 32;
/// Longest body that mending makes.
const MAX_MENDED_BYTES: u64 = 1 << 16;

const TRAINING: FileKind = FileKind { magic: *b"LOCITRN\0", version: 2, name: "training file" };
const FRAME: Envelope = Envelope { kind: 1, version: 1 };
const SNAPSHOT: FileKind = FileKind { magic: *b"LOCISNP\0", version: 1, name: "snapshot" };
const SNAPSHOT_NAME: &str = "snapshot.loci";
const JOURNAL: FileKind = FileKind { magic: *b"LOCIMAP\0", version: 2, name: "journal" };
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
    let records: Vec<_> = payloads(bytes).into_iter().map(|payload| (FRAME, payload)).collect();
    write(here.path(), "v.training", &written(&TRAINING, &records));
    read_training(&path);
}

fn read_training(path: &Path) {
    let Some(mut corpus) = accepted(TrainingFile::open(path, "images")) else { return };
    let image = CorpusImage { mean_luminance: 1.0, descriptors: vec![Descriptor([7; 32]); 2] };
    let (frames, descriptors) = (corpus.frame_count(), corpus.descriptor_count());
    corpus.push(Some(&image)).expect("a further frame");
    assert_eq!((corpus.frame_count(), corpus.descriptor_count()), (frames + 1, descriptors + 2));
    let mut visited = 0;
    let mut visit = |image: &[Descriptor]| {
        visited += image.len() as u64;
        ControlFlow::Continue(())
    };
    accepted(corpus.visit(&mut visit)).expect("the images that were counted");
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

/// A map's journal of either version, [`PlaceMap::open`].
pub fn map_journal(bytes: &[u8]) {
    let journals = [bytes.to_vec(), first_journal(&payloads(bytes)), second_journal(bytes)];
    for journal in journals {
        let here = folder();
        write(here.path(), JOURNAL_NAME, &journal);
        read_map(here.path());
    }
}

/// A map's snapshot beside a journal of two experiences, [`PlaceMap::open`].
pub fn map_snapshot(bytes: &[u8]) {
    let mended = [&SNAPSHOT.header(bytes)[..], bytes].concat();
    for snapshot in [bytes, &mended] {
        let here = folder();
        write(here.path(), JOURNAL_NAME, include_bytes!("../seeds/map_journal/version_2.loci"));
        write(here.path(), SNAPSHOT_NAME, snapshot);
        read_map(here.path());
    }
}

/// An index of words, [`InvertedIndex::restored`].
pub fn map_index(bytes: &[u8]) {
    let Some(documents) = bytes.first_chunk().map(|count| u32::from_le_bytes(*count) % (1 << 16)) else {
        return;
    };
    let mut reader = SnapshotReader::new(FileBytes::Owned(bytes.to_vec()), 0);
    let Some(mut index) = InvertedIndex::restored(&mut reader, documents) else { return };
    let words = (0..64).chain(bytes.iter().map(|&byte| 64 * u32::from(byte))).map(|word| (WordId(word), 1.0));
    let bow = BowVector::weighted(words, Weighting::TfIdf);
    let ask = |index: &mut InvertedIndex| {
        let found = index.query(&bow, |_| true);
        assert!(found.iter().all(|found| found.score > 0.0 && found.score <= 1.0));
    };
    ask(&mut index);
    index.add(&bow);
    index.remove(DocumentId(0));
    index.rename(&[(WordId(0), WordId(1))]);
    ask(&mut index);
    let bytes = index.snapshot().concat();
    let mut reader = SnapshotReader::new(FileBytes::Owned(bytes), 0);
    let documents = reader.rows(1).and_then(|mut rows| rows.next()).map(|[documents]| documents);
    assert!(documents.is_some(), "an index begins with the number of its documents");
}

/// Opens a map as the program does: whatever is mended and read must be there again the next time.
fn read_map(folder: &Path) {
    let verified = accepted(PlaceMap::verify(folder, &|_, _| ()));
    let read = accepted(PlaceMap::open_read_only(folder));
    let is_whole = read.as_ref().is_some_and(|map| map.passed_over().is_none());
    let found = read.map(|map| contents(&map));
    let is_sound = verified.is_some_and(|verified| !verified.is_damaged());
    assert!(found.is_some() || !is_sound, "what is sound cannot be read");
    let opened = PlaceMap::open(folder, MapOptions::default());
    // Then the journal may have lost its end: it is read, but not written.
    let is_ahead = matches!(opened, Err(MapError::Storage(StorageError::Ahead { .. })));
    let Some(mut map) = accepted(opened) else {
        assert!(!is_whole || is_ahead, "what can be read cannot be opened for writing");
        return repair(folder, found.filter(|_| !is_ahead));
    };
    assert!(is_whole, "what cannot be read was opened for writing");
    let (places, experiences) = contents(&map);
    assert_eq!(found, Some((places.clone(), experiences.clone())), "what can be written cannot be read");
    for experience in map.experiences() {
        accepted(map.thumbnail_jpeg(experience.id));
        accepted(map.features(experience.id));
        accepted(map.traits(experience.id));
    }
    if accepted(map.learn(None, &look(&frame()))).is_none() {
        return;
    }
    let grown = contents(&map);
    assert_eq!((grown.0.len(), grown.1.len()), (places.len() + 1, experiences.len() + 1));
    drop(map);
    let map = accepted(PlaceMap::open_read_only(folder)).expect("the map that was just mended");
    assert_eq!((map.summary().torn_bytes, contents(&map)), (0, grown));
}

/// Repairs a damaged map, of which `found` could be read: then it is sound.
fn repair(folder: &Path, found: Option<(Vec<String>, Vec<String>)>) {
    let Some(mut map) = accepted(PlaceMap::open_damaged(folder, MapOptions::default())) else {
        assert!(found.is_none(), "what can be read cannot be repaired");
        return;
    };
    assert!(found.is_none_or(|found| found == contents(&map)), "what can be read is lost by the repair");
    if accepted(map.compact()).is_none() {
        return;
    }
    let kept = contents(&map);
    drop(map);
    let verified = accepted(PlaceMap::verify(folder, &|_, _| ())).expect("the map that was just repaired");
    assert!(!verified.is_damaged() && verified.refusal.is_none(), "{verified:?}");
    let map =
        accepted(PlaceMap::open(folder, MapOptions::default())).expect("the map that was just repaired");
    assert_eq!(contents(&map), kept);
}

/// Places and experiences, as text because a stored number may be NaN.
fn contents(map: &PlaceMap) -> (Vec<String>, Vec<String>) {
    let experiences = map.experiences().map(|experience| format!("{experience:?}"));
    (map.places().map(|place| format!("{place:?}")).collect(), experiences.collect())
}

fn frame() -> Frame {
    Frame {
        index: 0,
        capture_nanos: 0,
        name: String::new(),
        colour: RgbImage::new(1, 1),
        grey: GreyImage::new(1, 1),
        jpeg: None,
        pose: None,
        true_place: None,
    }
}

fn look(frame: &Frame) -> NewExperience<'_> {
    NewExperience { frame, view: 0, mean_luminance: 0.0, thumbnail_jpeg: &[1], keyframe: None }
}

/// The payloads that the frames of a journal of version 1 enclose; the last one may be cut.
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

/// A journal of version 1 with these payloads.
fn first_journal(payloads: &[&[u8]]) -> Vec<u8> {
    let mut journal = [&b"LOCIMAP\0"[..], &[1, 0, 0, 0, 0, 0, 0, 0]].concat();
    for payload in payloads {
        journal.extend((payload.len() as u32).to_le_bytes());
        journal.extend(checksum(payload).to_le_bytes());
        journal.extend_from_slice(payload);
    }
    journal
}

/// A journal of version 2 with the records that `bytes` name: kind, length (u16), payload.
fn second_journal(bytes: &[u8]) -> Vec<u8> {
    let mut records = Vec::new();
    let mut rest = bytes;
    while let Some(([kind, low, high], after)) = rest.split_first_chunk::<3>() {
        let length = usize::from(u16::from_le_bytes([*low, *high])).min(after.len());
        let (payload, next) = after.split_at(length);
        records.extend((length > 0).then_some((Envelope { kind: *kind, version: 1 }, payload)));
        rest = next;
    }
    written(&JOURNAL, &records)
}

/// The bytes of a log with these records.
fn written(kind: &FileKind, records: &[(Envelope, &[u8])]) -> Vec<u8> {
    let file = Arc::new(MemoryFile::default());
    let reading = Reading { from: 0, wanted: |_| true, visit: &mut |_| Ok(()) };
    let opened = RecordLog::open(
        file.clone(),
        LogIdentity { kind, number: 0, path: Path::new("log") },
        Tail::Mended,
        reading,
    );
    let (mut log, _) = opened.expect("an empty log");
    log.append(records).expect("records");
    let mut bytes = vec![0; file.length_bytes().expect("a length") as usize];
    file.read_at(0, &mut bytes).expect("what was written");
    bytes
}
