//! Synthetic worlds: a street and a corridor, drawn frame by frame, the same on every run.
//!
//! A camera follows a closed circuit, so every lap shows the same places again: from a little to the
//! side, in another light, with other people in the way. Some house fronts and bays are exact copies of
//! others, which is what makes place recognition hard. Each frame knows its true place: the circuit is
//! cut into stations of about 6 m in the street and 3 m in the corridor, numbered from 0, the same
//! number on every lap. Frames are drawn independently of each other, so any may be asked for first.
//!
//! ```
//! use loci::source::synthetic::{SyntheticSource, SyntheticSpec};
//!
//! let spec: SyntheticSpec = "corridor?laps=1&frames=4&size=160x160".parse()?;
//! let source = SyntheticSource::open(spec, 1);
//! let frame = source.render(2).unwrap();
//! assert_eq!(frame.name, "synthetic:corridor#0002");
//! assert!(frame.true_place.is_some());
//! # Ok::<(), loci::source::SourceError>(())
//! ```

mod camera;
mod canvas;
mod cars;
mod corridor;
mod facade;
mod figures;
mod film;
mod fittings;
mod lettering;
mod light;
mod masonry;
mod noise;
mod openings;
mod parse;
mod passers;
mod pavement;
mod plan;
mod render;
mod sky;
mod sprites;
mod street;
mod texture;
mod world;

pub use parse::{Light, SyntheticSpec, WorldKind};

use std::f32::consts::TAU;

use self::camera::View;
use self::film::{Film, motion_blur};
use self::light::Illumination;
use self::noise::{folded, mix, unit};
use self::render::{Scene, render_walls};
use self::sky::Sky;
use self::world::World;
use super::{FrameSource, SourceError};
use crate::frame::{Frame, Pose};
use crate::kernel::luma;
use crate::raster::RgbImage;

/// Nominal time between two frames: ten a second.
const FRAME_PERIOD_NANOS: i64 = 100_000_000;

/// A synthetic drive, ready to be drawn.
pub struct SyntheticSource {
    spec: SyntheticSpec,
    world: World,
    /// What each light of the drive does, once for each light that occurs.
    atmospheres: Vec<(Light, Illumination, Sky)>,
    film: Film,
    sample_interval: u64,
    next: u64,
}

impl SyntheticSource {
    /// Builds the world of `spec` and works out its light; takes a fraction of a second and some tens of
    /// megabytes. Every `sample_interval`-th frame is handed out; 0 counts as 1.
    #[must_use]
    pub fn open(spec: SyntheticSpec, sample_interval: u64) -> Self {
        let seed = folded(spec.seed);
        let world = match spec.world {
            WorldKind::Street => street::street(seed),
            WorldKind::Corridor => corridor::corridor(seed),
        };
        let atmospheres = [Light::Noon, Light::Dusk, Light::Night]
            .into_iter()
            .filter(|light| spec.lights.contains(light))
            .map(|light| (light, Illumination::of(&world, light), Sky::of(light, seed)))
            .collect();
        let film = Film::new(seed);
        Self { spec, world, atmospheres, film, sample_interval: sample_interval.max(1), next: 0 }
    }

    /// Number of frames of the whole drive, sampled or not.
    #[must_use]
    pub fn drive_length(&self) -> u64 {
        self.spec.drive_length()
    }

    /// Number of places on the circuit; true places count from 0 to one less.
    #[must_use]
    pub fn place_count(&self) -> u32 {
        self.world.place_count()
    }

    /// Draws frame `index` of the drive, or `None` past its end.
    #[must_use]
    pub fn render(&self, index: u64) -> Option<Frame> {
        if index >= self.drive_length() {
            return None;
        }
        let frames = self.spec.frames_per_lap;
        // Both fit: a drive has at most 1000 laps of 10 000 frames.
        let (lap, i) = ((index / u64::from(frames)) as u32, (index % u64::from(frames)) as u32);
        let view = camera::view(&self.world, &self.spec, (lap, i));
        let colour = self.draw(&view, lap, i);
        Some(Frame {
            index,
            capture_nanos: index as i64 * FRAME_PERIOD_NANOS,
            name: format!("synthetic:{}#{index:04}", self.spec.world.name()),
            grey: luma(&colour),
            colour,
            jpeg: None,
            pose: Some(pose(&view)),
            true_place: Some(self.world.place_at(camera::nominal_distance(&self.world, i, frames))),
        })
    }

    fn draw(&self, view: &View, lap: u32, i: u32) -> RgbImage {
        let light = self.spec.light_of_lap(lap);
        let known = self.atmospheres.iter().position(|atmosphere| atmosphere.0 == light);
        let (_, illumination, sky) = &self.atmospheres[known.unwrap_or(0)];
        let seed = mix(mix(folded(self.spec.seed), 0xF1), lap);
        // Clouds move on between laps; the sunset and its clouds stay in the west.
        let sky_turn = if light == Light::Noon { TAU * unit(seed) } else { 0.0 };
        let scene = Scene { world: &self.world, illumination, sky, sky_turn };
        let (mut picture, occlusion) = render_walls(scene, view);
        let seconds =
            camera::nominal_distance(&self.world, i, self.spec.frames_per_lap) / self.world.measures.speed;
        let mut billboards = passers::passers(&self.world, &self.spec, lap, seconds);
        billboards.extend(&self.world.billboards);
        sprites::render_sprites(scene, view, &billboards, (&mut picture, &occlusion));
        motion_blur(&mut picture, view, illumination.lighting.shutter_seconds, self.spec.blur);
        self.film.develop(&picture, &illumination.lighting, mix(seed, i))
    }
}

/// The camera's pose: x east, y north, z up; the orientation turns the x axis into the viewing direction.
fn pose(view: &View) -> Pose {
    let (sin, cos) = (f64::from(view.heading_radians) / 2.0).sin_cos();
    Pose {
        position_metres: [f64::from(view.eye.x), f64::from(view.eye.y), f64::from(view.eye_height)],
        orientation: [0.0, 0.0, sin, cos],
    }
}

impl FrameSource for SyntheticSource {
    fn next_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        let frame = self.render(self.next)?;
        self.next += self.sample_interval.min(self.drive_length());
        Some(Ok(frame))
    }

    fn frame_count(&self) -> Option<u64> {
        Some(self.drive_length().div_ceil(self.sample_interval))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::{OrbExtractor, OrbOptions};

    fn open(text: &str) -> SyntheticSource {
        SyntheticSource::open(text.parse().unwrap(), 1)
    }

    fn mean_grey(frame: &Frame) -> f64 {
        let pixels = frame.grey.pixels();
        pixels.iter().map(|&pixel| f64::from(pixel)).sum::<f64>() / pixels.len() as f64
    }

    fn mean_difference(a: &Frame, b: &Frame) -> f64 {
        let pairs = a.grey.pixels().iter().zip(b.grey.pixels());
        pairs.map(|(&a, &b)| f64::from(a.abs_diff(b))).sum::<f64>() / a.grey.pixels().len() as f64
    }

    #[test]
    fn one_seed_gives_the_same_frames_bit_for_bit_and_another_does_not() {
        let frame = |seed: u64| open(&format!("corridor?size=160x160&seed={seed}")).render(31).unwrap();
        let first = frame(1);
        assert_eq!(first.colour, frame(1).colour);
        assert_ne!(first.colour, frame(2).colour);
        assert_ne!(first.colour, frame(1 + (1 << 32)).colour, "the upper half of the seed counts too");
    }

    #[test]
    fn a_frame_is_the_same_whether_asked_for_alone_or_in_turn() {
        let mut source = open("corridor?size=160x160&laps=1&frames=5");
        let alone = source.render(3).unwrap();
        let in_turn = std::iter::from_fn(|| source.next_frame()).nth(3).unwrap().unwrap();
        assert_eq!(alone.colour, in_turn.colour);
        assert_eq!(alone.name, "synthetic:corridor#0003");
        assert_eq!(alone.capture_nanos, 300_000_000);
    }

    #[test]
    fn every_lap_passes_all_places_in_the_same_order() {
        for (world, places) in [("street", 39), ("corridor", 36)] {
            let source = open(&format!("{world}?size=160x160&light=noon&laps=2&frames=60"));
            assert_eq!(source.place_count(), places);
            let seen: Vec<u32> = (0..120).map(|i| source.render(i).unwrap().true_place.unwrap()).collect();
            assert_eq!(seen[..60], seen[60..]);
            let mut distinct = seen[..60].to_vec();
            assert!(distinct.is_sorted());
            distinct.dedup();
            assert_eq!(distinct, (0..places).collect::<Vec<_>>());
        }
    }

    #[test]
    fn night_is_darker_than_dusk_and_dusk_darker_than_noon() {
        for world in ["street", "corridor"] {
            let source = open(&format!("{world}?size=160x160&light=noon,dusk,night&frames=8&passers=0"));
            let lap =
                |lap: u64| (0..8).map(|i| mean_grey(&source.render(lap * 8 + i).unwrap())).sum::<f64>() / 8.0;
            let (noon, dusk, night) = (lap(0), lap(1), lap(2));
            assert!(noon > dusk && dusk > 1.2 * night, "{world}: {noon} {dusk} {night}");
        }
    }

    #[test]
    fn a_place_looks_more_like_itself_a_lap_later_than_like_other_places() {
        let source = open("street?size=320x240&light=noon&laps=2&frames=20&passers=0&yaw=1");
        for i in 0..20 {
            let frame = source.render(i).unwrap();
            let again = mean_difference(&frame, &source.render(20 + i).unwrap());
            let other = mean_difference(&frame, &source.render(20 + (i + 7) % 20).unwrap());
            assert!(again > 0.5 && again < other, "frame {i}: itself {again}, another place {other}");
        }
    }

    #[test]
    fn passers_by_are_elsewhere_on_the_next_lap() {
        let spec: SyntheticSpec = "street?size=160x160".parse().unwrap();
        let source = SyntheticSource::open(spec.clone(), 1);
        let [first, second] = [0, 1].map(|lap| passers::passers(&source.world, &spec, lap, 0.0));
        assert_eq!(first.len(), 24);
        assert!(first.iter().zip(&second).all(|(a, b)| (a.at - b.at).length() > 0.01));
    }

    #[test]
    fn noon_frames_are_full_of_features() {
        let mut extractor = OrbExtractor::new(OrbOptions::default());
        for world in ["street", "corridor"] {
            let source = open(&format!("{world}?light=noon&laps=1&frames=9"));
            for i in 0..9 {
                let count = extractor.extract(&source.render(i).unwrap().grey).len();
                assert!(count >= 500, "{world} frame {i}: {count} features");
            }
        }
    }

    #[test]
    fn frames_have_the_size_that_was_asked_for() {
        for (width, height) in [(160, 160), (161, 243), (1920, 160), (160, 1920)] {
            let source = open(&format!("corridor?size={width}x{height}&laps=1&frames=3&blur=3"));
            for i in 0..3 {
                let frame = source.render(i).unwrap();
                assert_eq!((frame.colour.width(), frame.colour.height()), (width, height));
                assert_eq!((frame.grey.width(), frame.grey.height()), (width, height));
            }
        }
    }

    #[test]
    fn sampling_hands_out_every_nth_frame_and_counts_them_beforehand() {
        for (interval, expected) in [(0, 10), (1, 10), (3, 4), (9, 2), (10, 1), (u64::MAX, 1)] {
            let spec = "corridor?size=160x160&laps=2&frames=5".parse().unwrap();
            let mut source = SyntheticSource::open(spec, interval);
            assert_eq!(source.frame_count(), Some(expected), "interval {interval}");
            let indices: Vec<u64> =
                std::iter::from_fn(|| source.next_frame()).map(|frame| frame.unwrap().index).collect();
            assert_eq!(indices.len() as u64, expected, "interval {interval}");
            assert!(indices.iter().enumerate().all(|(i, &index)| index == i as u64 * interval.max(1)));
        }
    }

    #[test]
    fn past_the_end_there_is_nothing() {
        let source = open("corridor?size=160x160&laps=2&frames=5");
        assert!(source.render(9).is_some());
        assert!(source.render(10).is_none());
        assert!(source.render(u64::MAX).is_none());
    }

    #[test]
    fn the_pose_lies_near_the_circuit_and_turns_by_a_unit_quaternion() {
        let source = open("street?size=160x160&frames=7&offset=1.5");
        for i in 0..14 {
            let pose = source.render(i).unwrap().pose.unwrap();
            let norm: f64 = pose.orientation.iter().map(|part| part * part).sum();
            assert!((norm - 1.0).abs() < 1e-9);
            let [x, y, _] = pose.position_metres;
            let eye = plan::Vector::new(x as f32, y as f32);
            let steps =
                (0..5000).map(|k| source.world.circuit.at(source.world.circuit.length() * k as f32 / 5000.0));
            let off = steps.map(|way| (way.position - eye).length()).fold(f32::INFINITY, f32::min);
            assert!(off < 0.75 + 0.05, "frame {i} is {off} m off the circuit");
        }
    }
}
