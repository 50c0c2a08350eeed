//! Loci's side of `benches/peers.py`: finds features in frames that lie in a file, and says how long it took.
//!
//! `peers frames OUT COUNT` renders frames of a synthetic street; `peers orb IN FEATURES [OUT]` times the extractor on
//! frames and writes what it found. Frames are 640×480 grey bytes, one after the other. A feature is x, y (f32, little
//! endian) and 32 bytes, a frame the number of its features (u32) and these.

use std::error::Error;
use std::fs;
use std::time::Instant;

use loci::feature::{Features, OrbExtractor, OrbOptions};
use loci::raster::GreyImage;
use loci::source;

const SIZE_PX: (usize, usize) = (640, 480);
/// How often all frames are looked at, once they were; the median counts.
const PASSES: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    match &arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["frames", out, count] => render(out, count.parse()?),
        ["orb", frames, features] => orb(frames, features.parse()?, None),
        ["orb", frames, features, out] => orb(frames, features.parse()?, Some(out)),
        _ => {
            println!("compared with its peers by: python3 benches/peers.py");
            Ok(())
        }
    }
}

fn render(out: &str, count: usize) -> Result<(), Box<dyn Error>> {
    let mut street =
        source::open(&format!("synthetic:street?laps=1&light=noon&frames={count}&seed=7"), None)?;
    let mut pixels = Vec::with_capacity(count * SIZE_PX.0 * SIZE_PX.1);
    while let Some(frame) = street.next_frame() {
        pixels.extend_from_slice(frame?.grey.pixels());
    }
    Ok(fs::write(out, pixels)?)
}

fn orb(frames: &str, max_features: usize, out: Option<&str>) -> Result<(), Box<dyn Error>> {
    let pixels = fs::read(frames)?;
    let frames = pixels.chunks_exact(SIZE_PX.0 * SIZE_PX.1);
    let frames = frames.filter_map(|pixels| GreyImage::from_pixels(SIZE_PX.0, SIZE_PX.1, pixels.to_vec()));
    let frames: Vec<GreyImage> = frames.collect();
    let mut extractor = OrbExtractor::new(OrbOptions { max_features, ..OrbOptions::default() });
    let found: Vec<Features> = frames.iter().map(|frame| extractor.extract(frame)).collect();
    let mut passes_ms: Vec<f64> = (0..PASSES)
        .map(|_| {
            let started = Instant::now();
            frames.iter().for_each(|frame| drop(std::hint::black_box(extractor.extract(frame))));
            started.elapsed().as_secs_f64() * 1e3 / frames.len() as f64
        })
        .collect();
    passes_ms.sort_by(f64::total_cmp);
    println!("{}", passes_ms[PASSES / 2]);
    match out {
        Some(out) => Ok(fs::write(out, found.iter().flat_map(bytes).collect::<Vec<u8>>())?),
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
