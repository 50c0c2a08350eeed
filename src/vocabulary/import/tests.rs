//! One small vocabulary in every format, with what DBoW2 itself computes from it
//! (`tests/data/vocabulary/README.md`).

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{Read, Write as _};

use flate2::Compression;
use flate2::write::GzEncoder;
use proptest::prelude::*;

use super::*;
use crate::feature::Descriptor;
use crate::vocabulary::WordId;

const TEXT: &[u8] = include_bytes!("../../../tests/data/vocabulary/orb_k8_l3.txt");
const YAML: &[u8] = include_bytes!("../../../tests/data/vocabulary/orb_k8_l3.yml.gz");
const DBOW3: &[u8] = include_bytes!("../../../tests/data/vocabulary/orb_k8_l3.dbow3");
const FBOW: &[u8] = include_bytes!("../../../tests/data/vocabulary/orb_k8_l3.fbow");
const QUERIES: &[u8] = include_bytes!("../../../tests/data/vocabulary/queries.bin");
const BAGS: &str = include_str!("../../../tests/data/vocabulary/bow_dbow2.csv");

fn read(file: &[u8]) -> (VocabularyFormat, Vocabulary) {
    from_bytes(file, Path::new("voc")).unwrap()
}

fn message(file: &[u8]) -> String {
    from_bytes(file, Path::new("voc")).unwrap_err().to_string()
}

/// The descriptors of the six images.
fn queries() -> Vec<Vec<Descriptor>> {
    let (mut images, mut rest) = (Vec::new(), QUERIES);
    while let Some((count, tail)) = rest.split_first_chunk::<4>() {
        let (image, tail) = tail.split_at(u32::from_le_bytes(*count) as usize * 32);
        images.push(image.as_chunks().0.iter().copied().map(Descriptor).collect());
        rest = tail;
    }
    images
}

/// DBoW2's words of each image, with their values.
fn bags() -> Vec<BTreeMap<u32, f64>> {
    let mut bags = vec![BTreeMap::new(); 6];
    for line in BAGS.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        bags[fields[0].parse::<usize>().unwrap()]
            .insert(fields[1].parse().unwrap(), fields[2].parse().unwrap());
    }
    bags
}

fn yaml_text() -> String {
    let mut text = String::new();
    MultiGzDecoder::new(YAML).read_to_string(&mut text).unwrap();
    text
}

#[test]
fn every_format_is_known_by_its_content() {
    let yaml = yaml_text();
    let files = [TEXT, YAML, yaml.as_bytes(), DBOW3, FBOW];
    let kinds = files.map(|file| read(file).0);
    use VocabularyFormat::{Dbow2Yaml, Dbow3, Fbow, OrbSlamText};
    assert_eq!(kinds, [OrbSlamText, Dbow2Yaml, Dbow2Yaml, Dbow3, Fbow]);
    for file in files {
        let vocabulary = read(file).1;
        let shape =
            (vocabulary.branching(), vocabulary.depth(), vocabulary.node_count(), vocabulary.word_count());
        assert_eq!(shape, (8, 3, 585, 512));
    }
}

#[test]
fn every_format_gives_the_words_of_dbow2() {
    for file in [TEXT, YAML, DBOW3, FBOW] {
        let vocabulary = read(file).1;
        for (image, bag) in queries().iter().zip(bags()) {
            let quantised = vocabulary.quantise_all(image);
            let mut words: Vec<u32> = quantised.iter().map(|q| q.word.0).collect();
            words.sort_unstable();
            words.dedup();
            // DBoW2 leaves out what weighs nothing, FBoW keeps all.
            let weighted = read(YAML).1;
            words.retain(|&word| weighted.weight(WordId(word)) > 0.0);
            assert_eq!(words, bag.keys().copied().collect::<Vec<u32>>());
        }
    }
}

#[test]
fn words_that_fbows_converter_overwrites_are_kept_without_weight() {
    let (fbow, dbow2) = (read(FBOW).1, read(YAML).1);
    for word in (0..512).map(WordId) {
        let expected = if (504..508).contains(&word.0) { 0.0 } else { dbow2.weight(word) as f32 };
        assert_eq!(fbow.weight(word) as f32, expected, "word {}", word.0);
    }
}

#[test]
fn an_imported_vocabulary_is_saved_and_opened_like_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("imported.lvoc");
    let imported = read(DBOW3).1;
    imported.save(&path).unwrap();
    let (format, again) = import(&path).unwrap();
    again.verify(&path).unwrap();
    assert_eq!(format, VocabularyFormat::Loci);
    for descriptor in queries().iter().flatten() {
        assert_eq!(again.quantise(descriptor), imported.quantise(descriptor));
    }
}

#[test]
fn a_file_of_no_known_kind_is_refused_by_name() {
    let error = message(b"\x89PNG\r\n");
    assert!(error.starts_with("voc is no vocabulary that Loci knows"), "{error}");
    assert!(message(b"").starts_with("voc is no vocabulary"));
}

#[test]
fn faults_say_where_they_are() {
    let text = String::from_utf8(TEXT.to_vec()).unwrap();
    let broken = text.replacen("0 0 125 117", "0 0 125 317", 1);
    assert!(
        message(broken.as_bytes()).contains("line 2: \"317\" is no byte"),
        "{}",
        message(broken.as_bytes())
    );
    let cut: String = text.lines().take(40).flat_map(|line| [line, "\n"]).collect();
    assert!(message(cut.as_bytes()).contains("at its end: leaf"), "{}", message(cut.as_bytes()));
    let compressed: Vec<u8> = [&DBOW3[..8], &[1], &DBOW3[9..]].concat();
    assert!(message(&compressed).contains("at byte 8: compressed files are not read"));
    assert!(
        message(&DBOW3[..100]).contains("at byte 9: it is too short for 584"),
        "{}",
        message(&DBOW3[..100])
    );
    assert!(message(&FBOW[..4000]).contains("at byte 64: 73 blocks so long do not fill it"));
    assert!(message(&YAML[..4000]).contains("line "), "{}", message(&YAML[..4000]));
    assert!(message(yaml_text().replace("L: 3", "L: 99").as_bytes()).contains("the depth is 99"));
    assert!(message(b"99999 6 0 0\n").contains("the branching is 99999"));
}

#[test]
fn a_tree_that_bites_its_tail_is_refused() {
    let mut file = DBOW3.to_vec();
    // The parent of the first node becomes one of its own descendants.
    file[33..37].copy_from_slice(&9_u32.to_le_bytes());
    assert!(message(&file).contains("circle"), "{}", message(&file));
    let mut file = FBOW.to_vec();
    // The first child of the root has the root's block.
    file[128 + 264..128 + 268].copy_from_slice(&0_u32.to_le_bytes());
    assert!(message(&file).contains("circle"), "{}", message(&file));
}

#[test]
fn a_tree_that_floats_beside_its_root_is_refused() {
    // The children of the root become those of node 1, which is one of them.
    let file = yaml_text().replace("parentId:0,", "parentId:1,");
    assert!(file != yaml_text());
    assert!(message(file.as_bytes()).contains("nothing hangs from its root"), "{}", message(file.as_bytes()));
}

#[test]
fn a_text_that_ends_within_its_last_number_is_refused() {
    let text = TEXT.trim_ascii_end();
    assert!(message(&text[..text.len() - 6]).contains("it ends within a line"));
}

#[test]
fn lines_that_say_nothing_are_not_read_for_ever() {
    let yaml = "%YAML:1.0\nk: 8\nL: 3\nscoringType: 0\nweightingType: 0\nnodes:\n";
    for (head, idle, reason) in [
        ("8 3 0 0\n", "\n", "only empty lines"),
        (yaml, "\n", "only empty lines"),
        ("%YAML:1.0\n", "\n", "expected k, L"),
        ("%YAML:1.0\n", "a: b\n", "expected k, L"),
    ] {
        let text = head.to_owned() + &idle.repeat(1 << 20);
        assert!(message(text.as_bytes()).contains(reason), "{}", message(text.as_bytes()));
    }
}

#[test]
fn words_that_begin_again_and_again_are_refused() {
    let yaml = "%YAML:1.0\nk: 8\nL: 3\nscoringType: 0\nweightingType: 0\nnodes:\n".to_owned();
    let text = yaml + &"words:\n".repeat(1 << 20);
    assert!(message(text.as_bytes()).contains("line 8: its words begin a second time"));
}

#[test]
fn branching_and_depth_are_those_of_the_tree_whatever_its_head_says() {
    let text = String::from_utf8(TEXT.to_vec()).unwrap();
    let text = text.replacen("8 3 0 0", "10 6 0 0", 1);
    let vocabulary = read(text.as_bytes()).1;
    assert_eq!((vocabulary.branching(), vocabulary.depth()), (8, 3));
}

#[test]
fn a_compressed_file_is_known_by_what_it_holds() {
    let compressed = |text: &[u8]| {
        let mut file = GzEncoder::new(Vec::new(), Compression::fast());
        file.write_all(text).unwrap();
        file.finish().unwrap()
    };
    let kinds = [TEXT, yaml_text().as_bytes(), b"a letter to a friend", DBOW3]
        .map(|content| VocabularyFormat::of(&compressed(content)[..512.min(compressed(content).len())]));
    use VocabularyFormat::{Dbow2Yaml, OrbSlamText};
    assert_eq!(kinds, [Some(OrbSlamText), Some(Dbow2Yaml), None, None]);
    assert!(message(&compressed(b"a letter")).starts_with("voc is no vocabulary"));
    assert_eq!(read(&compressed(TEXT)).0, OrbSlamText);
}

#[test]
fn a_line_without_end_takes_no_memory() {
    let mut text = "8 3 0 0\n".to_owned();
    write!(text, "{}", "0 ".repeat(1 << 20)).unwrap();
    assert!(message(text.as_bytes()).contains("line 2: the line does not end"));
}

proptest! {
    #[test]
    fn damaged_files_are_refused_or_read_without_panic(
        kind in 0..4_usize, position in any::<prop::sample::Index>(), byte in any::<u8>(),
        cut in any::<prop::sample::Index>(),
    ) {
        let yaml = yaml_text();
        let file = [TEXT, yaml.as_bytes(), DBOW3, FBOW][kind];
        let _ = from_bytes(&file[..cut.index(file.len())], Path::new("voc"));
        let mut file = file.to_vec();
        let position = position.index(file.len().min(3000));
        file[position] = byte;
        if let Ok((_, vocabulary)) = from_bytes(&file, Path::new("voc")) {
            for descriptor in &queries()[0] {
                prop_assert!(vocabulary.weight(vocabulary.quantise(descriptor).word).is_finite());
            }
        }
    }
}
