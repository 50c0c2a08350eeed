//! Writes the frames of a synthetic drive as JPEGs, `LAP-NUMBER.jpg`, for the camera of tests/camera to show.

use std::path::Path;

use loci::source::{self, synthetic::SyntheticSpec};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [world, folder] = arguments.as_slice() else {
        return Err("usage: camera_frames WORLD FOLDER, such as corridor?laps=2 frames".into());
    };
    let lap_length = u64::from(world.parse::<SyntheticSpec>()?.frames_per_lap());
    let mut frames = source::open(&format!("synthetic:{world}"), None)?;
    while let Some(frame) = frames.next_frame().transpose()? {
        let lap = frame.index / lap_length + 1;
        let name = format!("{lap}-{:03}.jpg", frame.index);
        std::fs::write(Path::new(folder).join(name), source::jpeg(&frame.colour))?;
    }
    Ok(())
}
