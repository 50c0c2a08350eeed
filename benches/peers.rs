//! Loci's side of `benches/peers.py`: does with what lies in a file what its peers do, and says how long it took.
//!
//! `peers frames OUT COUNT` renders frames of a synthetic street as 640×480 RGB bytes, one after the other. `peers orb IN
//! FEATURES [OUT]` finds features in such frames of grey bytes and writes them: of a frame their number (u32, little
//! endian), then x, y (f32) and 32 bytes of each. `peers stages JPEGS` decodes images that lie behind their lengths (u32),
//! and makes grey images and inputs of the CNN of them. `peers pairs OUT TRUE COUNT` makes up correspondences, each x, y in
//! one image and in the other (f32), and `peers verify TRUE COUNT` verifies them.

mod made_up;

use std::error::Error;
use std::fs;
use std::path::Path;
use std::time::Instant;

use loci::cnn::{ModelCard, Preprocessor};
use loci::feature::{Features, OrbExtractor, OrbOptions};
use loci::kernel;
use loci::raster::GreyImage;
use loci::source;
use loci::verification::{Verification, VerificationOptions, Verifier};

const SIZE_PX: (usize, usize) = (640, 480);
/// How often all frames are looked at, once they were; the median counts.
const PASSES: usize = 3;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    match &arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["frames", out, count] => render(out, count.parse()?),
        ["orb", frames, features] => orb(frames, features.parse()?, None),
        ["orb", frames, features, out] => orb(frames, features.parse()?, Some(out)),
        ["stages", jpegs] => stages(&fs::read(jpegs)?),
        ["pairs", out, moved, count] => pairs(out, moved.parse()?, count.parse()?),
        ["verify", moved, count] => verify(moved.parse()?, count.parse()?),
        _ => {
            println!("compared with its peers by: python3 benches/peers.py");
            Ok(())
        }
    }
}

fn render(out: &str, count: usize) -> Result<(), Box<dyn Error>> {
    let mut street =
        source::open(&format!("synthetic:street?laps=1&light=noon&frames={count}&seed=7"), None)?;
    let mut pixels = Vec::with_capacity(3 * count * SIZE_PX.0 * SIZE_PX.1);
    while let Some(frame) = street.next_frame() {
        pixels.extend_from_slice(frame?.colour.pixels());
    }
    Ok(fs::write(out, pixels)?)
}

/// Median time of a pass through `items`, in milliseconds for each of them.
fn median_ms<T>(items: &[T], mut work: impl FnMut(&T)) -> f64 {
    items.iter().for_each(&mut work);
    let mut passes_ms: Vec<f64> = (0..PASSES)
        .map(|_| {
            let started = Instant::now();
            items.iter().for_each(&mut work);
            started.elapsed().as_secs_f64() * 1e3 / items.len() as f64
        })
        .collect();
    passes_ms.sort_by(f64::total_cmp);
    passes_ms[PASSES / 2]
}

fn orb(frames: &str, max_features: usize, out: Option<&str>) -> Result<(), Box<dyn Error>> {
    let pixels = fs::read(frames)?;
    let frames = pixels.chunks_exact(SIZE_PX.0 * SIZE_PX.1);
    let frames = frames.filter_map(|pixels| GreyImage::from_pixels(SIZE_PX.0, SIZE_PX.1, pixels.to_vec()));
    let frames: Vec<GreyImage> = frames.collect();
    let mut extractor = OrbExtractor::new(OrbOptions { max_features, ..OrbOptions::default() });
    println!("{}", median_ms(&frames, |frame| drop(std::hint::black_box(extractor.extract(frame)))));
    match out {
        Some(out) => {
            let features = frames.iter().flat_map(|frame| bytes(&extractor.extract(frame)));
            Ok(fs::write(out, features.collect::<Vec<u8>>())?)
        }
        None => Ok(()),
    }
}

fn bytes(features: &Features) -> Vec<u8> {
    let mut bytes = (features.len() as u32).to_le_bytes().to_vec();
    for (keypoint, descriptor) in features.keypoints.iter().zip(&features.descriptors) {
        bytes.extend(keypoint.point.x.to_le_bytes());
        bytes.extend(keypoint.point.y.to_le_bytes());
        bytes.extend(descriptor.0);
    }
    bytes
}

fn stages(mut file: &[u8]) -> Result<(), Box<dyn Error>> {
    let mut jpegs = Vec::new();
    while let Some((length, rest)) = file.split_first_chunk() {
        let cut = rest.split_at_checked(u32::from_le_bytes(*length) as usize);
        let (jpeg, rest) = cut.ok_or("the file ends within an image")?;
        jpegs.push(jpeg);
        file = rest;
    }
    let decoding_ms = median_ms(&jpegs, |jpeg| drop(std::hint::black_box(source::decode(jpeg, "frame"))));
    let images = jpegs.iter().map(|jpeg| source::decode(jpeg, "frame")).collect::<Result<Vec<_>, _>>()?;
    let luma_ms = median_ms(&images, |image| drop(std::hint::black_box(kernel::luma(image))));
    let card = ModelCard::read(Path::new("models/efficientnet-lite0/card.toml"))?;
    let mut preprocessor = Preprocessor::new(&card.input);
    let input_ms = median_ms(&images, |image| {
        std::hint::black_box(preprocessor.tensor(image).map(<[f32]>::len).ok());
    });
    println!("{decoding_ms} {luma_ms} {input_ms}");
    Ok(())
}

fn pairs(out: &str, moved: usize, count: u64) -> Result<(), Box<dyn Error>> {
    let pairs = (0..count).flat_map(|seed| made_up::correspondences(moved, seed));
    let points = pairs.flat_map(|pair| [pair.query_point.point, pair.keyframe_point.point]);
    let bytes: Vec<u8> = points.flat_map(|point| [point.x, point.y]).flat_map(f32::to_le_bytes).collect();
    Ok(fs::write(out, bytes)?)
}

/// Says the median time in microseconds, and the fewest and the most inliers.
fn verify(moved: usize, count: u64) -> Result<(), Box<dyn Error>> {
    let options = VerificationOptions::default();
    let (mut inliers, mut times_us) = (Vec::new(), Vec::new());
    let (mut verifier, mut found) = (Verifier::default(), Verification::default());
    for seed in 0..count {
        found.correspondences = made_up::correspondences(moved, seed);
        let started = Instant::now();
        verifier.vote_and_verify([made_up::DIAGONAL_PX; 2], &options, &mut found);
        times_us.push(started.elapsed().as_secs_f64() * 1e6);
        inliers.push(found.inliers.len());
    }
    times_us.sort_by(f64::total_cmp);
    inliers.sort_unstable();
    println!("{} {} {}", times_us[times_us.len() / 2], inliers[0], inliers[inliers.len() - 1]);
    Ok(())
}
