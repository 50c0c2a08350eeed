//! A robot that drives for ever, in a process of its own: `make soak`. Its memory must stay flat, its map within its
//! budget, and it must go on recognising.
//!
//! What the program holds is counted by its allocator. What the heap takes for that is no measure of growth: it goes up
//! and down by a MiB as the heap has holes; it is bounded.

use std::alloc::System;
use std::sync::Arc;
use std::time::Instant;

use loci::feature::{Descriptor, Features, Keypoint};
use loci::frame::Frame;
use loci::geometry::Point;
use loci::place_map::{Durability, MapOptions, PlaceMap};
use loci::raster::{GreyImage, RgbImage};
use loci::recognition::{Decision, Look, Recogniser, RecognitionOptions};
use loci::vocabulary::{Light, VocabularySet};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use stats_alloc::{INSTRUMENTED_SYSTEM, StatsAlloc};

#[global_allocator]
static HEAP: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const DEFAULT_FRAMES: u64 = 1_000_000;
const PLACES: u64 = 300;
const FRAMES_A_PLACE: u64 = 4;
const FEATURES: u64 = 150;
/// Of a hundred features of a place, so many differ from one look of it to the next.
const RENEWED_PERCENT: u64 = 10;
const FRAMES_A_LOOK: u64 = 100_000;
/// Frames after which the robot is carried elsewhere.
const CARRIED_EVERY: u64 = 5_000;
const DISK_BYTES: u64 = 64 << 20;
const MEMORY_BYTES: usize = 7 << 18;
/// Samples of memory that the report has.
const SAMPLES: u64 = 20;
/// Frames from one count of the memory to the next.
const FRAMES_A_COUNT: u64 = 250;
/// Growth of held memory that counts as flat, in KiB per 100,000 frames: a robot at 10 Hz gains 1.1 MiB a day at most.
const FLAT_KIB: f64 = 128.0;
/// Private memory that there may be for what is held: holes in the heap, what it keeps for later, stacks and tables.
const MOST_PRIVATE: f64 = 4.0;
/// Share of the frames since the last sample that must be recognised, in percent, once every place has been seen.
const LEAST_RECOGNISED: f64 = 95.0;
/// Frames in which the world is new to the robot: it is carried to every part of it.
const LEARNING_FRAMES: u64 = 10_000;

/// The feature numbered `index` of a place, as it looks in that period of time.
fn feature(place: u64, index: u64, period: u64) -> (Point, Descriptor) {
    let is_renewed = (index * 7 + place) % 100 < RENEWED_PERCENT;
    let seed = place << 32 | index << 16 | if is_renewed { period } else { 0 };
    let mut random = Pcg64::seed_from_u64(seed);
    let point = Point { x: random.random_range(0.0..600.0), y: random.random_range(0.0..440.0) };
    (point, Descriptor(random.random()))
}

/// A look at a place: most of its features, a little moved, with a sixteenth of their bits flipped.
fn features(place: u64, period: u64, random: &mut Pcg64) -> Features {
    let (dx, dy) = (random.random_range(-20.0..20.0), random.random_range(-20.0..20.0));
    let mut features = Features { width_px: 640, height_px: 480, ..Features::default() };
    for index in 0..FEATURES {
        let (point, Descriptor(mut bits)) = feature(place, index, period);
        if random.random_ratio(1, 10) {
            continue;
        }
        for byte in &mut bits {
            *byte ^=
                random.random::<u8>() & random.random::<u8>() & random.random::<u8>() & random.random::<u8>();
        }
        let point = Point { x: (point.x + dx).clamp(0.0, 640.0), y: (point.y + dy).clamp(0.0, 480.0) };
        features.keypoints.push(Keypoint { point, scale: 1.0, angle_radians: 0.0, response: 20 });
        features.descriptors.push(Descriptor(bits));
    }
    features
}

fn frame(index: u64, random: &mut Pcg64) -> Frame {
    let pixels: Vec<u8> = (0..90 * 80).map(|_| random.random()).collect();
    Frame {
        index,
        capture_nanos: index as i64 * 100_000_000,
        name: format!("{index}"),
        colour: RgbImage::new(1, 1),
        grey: GreyImage::from_pixels(90, 80, pixels).unwrap(),
        jpeg: None,
        pose: None,
        true_place: None,
    }
}

/// The memory of this process after some frames.
struct Memory {
    frames: f64,
    /// What the program allocated and did not free.
    held_kib: f64,
    /// What no file backs.
    private_kib: f64,
}

impl Memory {
    fn after(frames: u64) -> Self {
        let heap = HEAP.stats();
        let rollup = std::fs::read_to_string("/proc/self/smaps_rollup").unwrap();
        let private = rollup.lines().find_map(|line| line.strip_prefix("Anonymous:")).unwrap();
        Self {
            frames: frames as f64,
            held_kib: (heap.bytes_allocated - heap.bytes_deallocated) as f64 / 1024.0,
            private_kib: private.split_whitespace().next().unwrap().parse().unwrap(),
        }
    }
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

/// Held memory that each frame adds, in KiB: the slope of a line through the counts, by least squares.
fn held_kib_a_frame(counts: &[Memory]) -> f64 {
    let frames = mean(counts.iter().map(|count| count.frames));
    let held_kib = mean(counts.iter().map(|count| count.held_kib));
    let covariance = mean(counts.iter().map(|count| (count.frames - frames) * (count.held_kib - held_kib)));
    covariance / mean(counts.iter().map(|count| (count.frames - frames).powi(2)))
}

/// The robot, and what it met since the last sample.
struct Soak {
    folder: tempfile::TempDir,
    vocabularies: Arc<VocabularySet>,
    recogniser: Recogniser,
    random: Pcg64,
    position: u64,
    recognised: u64,
}

impl Soak {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (durability, disk_bytes) = (Durability::None, DISK_BYTES);
        let options = MapOptions { durability, disk_bytes, ..MapOptions::default() };
        let map = PlaceMap::open(folder.path(), options).unwrap();
        let vocabulary = concat!(env!("CARGO_MANIFEST_DIR"), "/vocab/default.lvoc");
        let vocabularies = Arc::new(VocabularySet::open(&[vocabulary.into()]).unwrap());
        let options = RecognitionOptions { memory_bytes: MEMORY_BYTES, ..RecognitionOptions::default() };
        let recogniser = Recogniser::new(Arc::clone(&vocabularies), map, None, options).unwrap();
        Self { folder, vocabularies, recogniser, random: Pcg64::seed_from_u64(1), position: 0, recognised: 0 }
    }

    /// Shows the robot what is at its next position.
    fn drive(&mut self, index: u64) {
        let random = &mut self.random;
        self.position = match index % CARRIED_EVERY {
            0 => random.random_range(0..PLACES * FRAMES_A_PLACE),
            _ => (self.position + 1) % (PLACES * FRAMES_A_PLACE),
        };
        let mean_luminance = random.random_range(40.0..200.0);
        let light = Light { mean_luminance, ..Light::default() };
        let features = features(self.position / FRAMES_A_PLACE, index / FRAMES_A_LOOK, random);
        let look = Look::new(features, (&self.vocabularies, light), None);
        let frame = frame(index, random);
        let recognition = self.recogniser.recognise(&frame, &look, || vec![0x5a; 2_000]);
        self.recognised += u64::from(recognition.decision == Decision::Revisited);
        assert!(self.recogniser.take_map_failure().is_none(), "frame {index}");
    }

    fn folder_bytes(&self) -> u64 {
        let files = std::fs::read_dir(self.folder.path()).unwrap();
        files.map(|file| file.unwrap().metadata().unwrap().len()).sum()
    }

    /// A line of the table.
    fn sample(&mut self, frames: u64, since: u64, counts: &[Memory], ms_a_frame: f64) {
        let folder_bytes = self.folder_bytes();
        assert!(folder_bytes <= DISK_BYTES, "{folder_bytes} bytes after frame {frames}");
        let map = self.recogniser.map().summary();
        let recognised_percent = self.recognised as f64 * 100.0 / since as f64;
        println!(
            "| {frames} | {:.2} | {:.1} | {:.1} | {} | {} | {} | {} | {} | {recognised_percent:.1} | {ms_a_frame:.2} |",
            mean(counts.iter().map(|count| count.held_kib)) / 1024.0,
            mean(counts.iter().map(|count| count.private_kib)) / 1024.0,
            folder_bytes as f64 / f64::from(1 << 20),
            map.places,
            map.merged_places,
            self.recogniser.working_places(),
            map.keyframes,
            map.experiences,
        );
        assert!(
            frames <= LEARNING_FRAMES || recognised_percent > LEAST_RECOGNISED,
            "{recognised_percent} % recognised after {frames} frames"
        );
        self.recognised = 0;
    }
}

#[test]
#[ignore = "takes many minutes: `make soak`"]
fn a_million_frames_leave_memory_flat_and_the_map_within_its_budget() {
    let frames: u64 = std::env::var("LOCI_SOAK_FRAMES").map_or(DEFAULT_FRAMES, |text| text.parse().unwrap());
    assert!(frames >= 2 * LEARNING_FRAMES, "LOCI_SOAK_FRAMES is at least {}", 2 * LEARNING_FRAMES);
    let mut soak = Soak::new();
    println!(
        "| Frames | Held, MiB | Private memory, MiB | Folder, MiB | Places | merged | searched | Keyframes | \
         Experiences | Recognised, % | ms a frame |\n|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
    );
    let since = frames / SAMPLES;
    let mut counts: Vec<Memory> = Vec::new();
    let mut started = Instant::now();
    for index in 0..frames {
        soak.drive(index);
        if (index + 1) % FRAMES_A_COUNT == 0 {
            counts.push(Memory::after(index + 1));
        }
        if (index + 1) % since == 0 {
            let ms_a_frame = started.elapsed().as_secs_f64() * 1e3 / since as f64;
            let latest = counts.len() - (since / FRAMES_A_COUNT) as usize;
            soak.sample(index + 1, since, &counts[latest..], ms_a_frame);
            started = Instant::now();
        }
    }
    let second_half = &counts[counts.len() / 2..];
    let kib_per_100_000 = held_kib_a_frame(second_half) * 1e5;
    println!("held in the second half: {kib_per_100_000:+.1} KiB per 100,000 frames");
    assert!(kib_per_100_000 < FLAT_KIB, "memory grows by {kib_per_100_000} KiB per 100,000 frames");
    let latest = &counts[counts.len() / 4 * 3..];
    let private_of_held = mean(latest.iter().map(|count| count.private_kib / count.held_kib));
    println!("private memory in the last quarter: {private_of_held:.2} times what is held");
    assert!(private_of_held < MOST_PRIVATE, "{private_of_held} times what is held");
}
