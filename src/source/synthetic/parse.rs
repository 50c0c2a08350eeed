//! What is asked for: the text after `synthetic:`, read and bounded.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

use crate::source::SourceError;

/// Which world to drive through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorldKind {
    /// House fronts, shops, trees and parked cars along a road under the open sky.
    Street,
    /// Doors, posters and notice boards along a corridor inside a building.
    Corridor,
}

impl WorldKind {
    /// The name as written in a source.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Street => "street",
            Self::Corridor => "corridor",
        }
    }
}

/// The light of one lap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// High sun and hard shadows; in the corridor all lights on.
    Noon,
    /// Low warm light, lamps and the first windows lit; in the corridor dimmed lights.
    Dusk,
    /// Lamps and lit windows only, with sensor noise; in the corridor the emergency lights.
    Night,
}

/// Keys that a source may carry, as named in errors.
const KEYS: &str = "laps, light, seed, frames, size, offset, yaw, blur, passers";

/// A synthetic drive, checked: `street?laps=2&light=noon,dusk&seed=7`.
///
/// Every key has a default; the bounds below keep a drive finite and a frame small.
#[derive(Clone, Debug, PartialEq)]
pub struct SyntheticSpec {
    pub(super) world: WorldKind,
    /// Laps, 1 to 1000; default 2, or as many as lights are named.
    pub(super) laps: u32,
    /// One light a lap, the last one repeats; default noon, dusk.
    pub(super) lights: Vec<Light>,
    /// Seed of all textures and of all variation between laps; default 7.
    pub(super) seed: u64,
    /// Frames a lap, 1 to 10 000; default 60.
    pub(super) frames_per_lap: u32,
    /// Width and height in pixels, each 160 to 1920; default 640 × 480.
    pub(super) size_px: (usize, usize),
    /// How far apart sideways two laps may run, 0 to 1.5 metres; default 0.3.
    pub(super) offset_metres: f32,
    /// Largest turn of the camera away from the circuit, 0 to 15 degrees; default 3.
    pub(super) yaw_degrees: f32,
    /// Strength of motion blur, 0 (none) to 3; default 1.
    pub(super) blur: f32,
    /// Passers-by on the circuit, 0 to 200; default 24 in the street, 6 in the corridor.
    pub(super) passers: u32,
}

impl SyntheticSpec {
    /// Number of frames of the whole drive.
    #[must_use]
    pub fn drive_length(&self) -> u64 {
        u64::from(self.laps) * u64::from(self.frames_per_lap)
    }

    /// The drive through `world` with every key at its default.
    #[must_use]
    pub fn new(world: WorldKind) -> Self {
        let passers = match world {
            WorldKind::Street => 24,
            WorldKind::Corridor => 6,
        };
        Self {
            world,
            laps: 2,
            lights: vec![Light::Noon, Light::Dusk],
            seed: 7,
            frames_per_lap: 60,
            size_px: (640, 480),
            offset_metres: 0.3,
            yaw_degrees: 3.0,
            blur: 1.0,
            passers,
        }
    }

    /// Number of laps.
    #[must_use]
    pub fn laps(&self) -> u32 {
        self.laps
    }

    /// Frames of one lap.
    #[must_use]
    pub fn frames_per_lap(&self) -> u32 {
        self.frames_per_lap
    }

    /// The light of `lap`, counted from 0.
    #[must_use]
    pub fn light_of_lap(&self, lap: u32) -> Light {
        let last = self.lights.len() - 1;
        self.lights[usize::try_from(lap).map_or(last, |lap| lap.min(last))]
    }

    fn set(&mut self, key: &str, value: &str) -> Result<(), String> {
        match key {
            "laps" => self.laps = bounded(key, value, 1..=1000)?,
            "light" => self.lights = lights(value)?,
            "seed" => self.seed = bounded(key, value, 0..=u64::MAX)?,
            "frames" => self.frames_per_lap = bounded(key, value, 1..=10_000)?,
            "size" => self.size_px = size_px(value)?,
            "offset" => self.offset_metres = bounded(key, value, 0.0..=1.5)?,
            "yaw" => self.yaw_degrees = bounded(key, value, 0.0..=15.0)?,
            "blur" => self.blur = bounded(key, value, 0.0..=3.0)?,
            "passers" => self.passers = bounded(key, value, 0..=200)?,
            _ => return Err(format!("there is no key '{key}'; allowed are {KEYS}")),
        }
        Ok(())
    }

    fn parse(text: &str) -> Result<Self, String> {
        let (world, query) = text.split_once('?').unwrap_or((text, ""));
        let mut spec = match world {
            "street" => Self::new(WorldKind::Street),
            "corridor" => Self::new(WorldKind::Corridor),
            _ => return Err(format!("there is no world '{world}'; allowed are street and corridor")),
        };
        let mut seen: Vec<&str> = Vec::new();
        for pair in query.split('&').filter(|pair| !pair.is_empty()) {
            let (key, value) =
                pair.split_once('=').ok_or_else(|| format!("'{pair}' has no value; write {pair}=…"))?;
            spec.set(key, value)?;
            if seen.contains(&key) {
                return Err(format!("key '{key}' is given twice; once is allowed"));
            }
            seen.push(key);
        }
        let named = spec.lights.len();
        if !seen.contains(&"laps") {
            spec.laps = named.max(2) as u32;
        } else if seen.contains(&"light") && named > spec.laps as usize {
            return Err(format!("light names {named} laps, but laps={} are asked for", spec.laps));
        }
        Ok(spec)
    }
}

impl FromStr for SyntheticSpec {
    type Err = SourceError;

    fn from_str(text: &str) -> Result<Self, SourceError> {
        Self::parse(text).map_err(|reason| SourceError::Synthetic { given: text.to_owned(), reason })
    }
}

fn bounded<T>(key: &str, value: &str, allowed: RangeInclusive<T>) -> Result<T, String>
where
    T: FromStr + PartialOrd + Display,
{
    let number = value.parse::<T>().ok().filter(|number| allowed.contains(number));
    number.ok_or_else(|| {
        format!("{key}={value} is not allowed; {key} takes {} to {}", allowed.start(), allowed.end())
    })
}

fn lights(value: &str) -> Result<Vec<Light>, String> {
    let light = |name: &str| match name {
        "noon" => Ok(Light::Noon),
        "dusk" => Ok(Light::Dusk),
        "night" => Ok(Light::Night),
        _ => Err(format!("light={value} is not allowed; light takes noon, dusk and night, split by commas")),
    };
    if value.split(',').nth(1000).is_some() {
        return Err("light names more than 1000 laps; at most 1000 are allowed".to_owned());
    }
    value.split(',').map(light).collect()
}

fn size_px(value: &str) -> Result<(usize, usize), String> {
    let refused =
        || format!("size={value} is not allowed; size takes WIDTHxHEIGHT, each 160 to 1920, such as 640x480");
    let (width, height) = value.split_once('x').ok_or_else(refused)?;
    let side = |text: &str| text.parse().ok().filter(|side| (160..=1920).contains(side)).ok_or_else(refused);
    Ok((side(width)?, side(height)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn reason(text: &str) -> String {
        match text.parse::<SyntheticSpec>() {
            Err(SourceError::Synthetic { given, reason }) => {
                assert_eq!(given, text);
                reason
            }
            other => panic!("{text} gave {other:?}"),
        }
    }

    #[test]
    fn a_bare_world_has_every_default() {
        assert_eq!("street".parse::<SyntheticSpec>().unwrap(), SyntheticSpec::new(WorldKind::Street));
        assert_eq!("corridor?".parse::<SyntheticSpec>().unwrap(), SyntheticSpec::new(WorldKind::Corridor));
    }

    #[test]
    fn every_key_is_read() {
        let text = "corridor?laps=3&light=night,noon&seed=9&frames=20&size=320x240&offset=0.5&yaw=1&blur=0&passers=2";
        let expected = SyntheticSpec {
            world: WorldKind::Corridor,
            laps: 3,
            lights: vec![Light::Night, Light::Noon],
            seed: 9,
            frames_per_lap: 20,
            size_px: (320, 240),
            offset_metres: 0.5,
            yaw_degrees: 1.0,
            blur: 0.0,
            passers: 2,
        };
        assert_eq!(text.parse::<SyntheticSpec>().unwrap(), expected);
    }

    #[test]
    fn a_refusal_names_the_key_and_what_it_takes() {
        let cases = [
            ("laps=0", "laps takes 1 to 1000"),
            ("laps=1001", "laps takes 1 to 1000"),
            ("frames=10001", "frames takes 1 to 10000"),
            ("seed=-1", "seed takes 0 to 18446744073709551615"),
            ("size=100x480", "size takes WIDTHxHEIGHT, each 160 to 1920"),
            ("size=640", "size takes WIDTHxHEIGHT"),
            ("offset=nan", "offset takes 0 to 1.5"),
            ("yaw=inf", "yaw takes 0 to 15"),
            ("blur=-1", "blur takes 0 to 3"),
            ("passers=many", "passers takes 0 to 200"),
            ("light=dawn", "light takes noon, dusk and night"),
            ("light=", "light takes noon, dusk and night"),
            ("fog=1", "no key 'fog'; allowed are laps, light"),
            ("laps", "'laps' has no value"),
            ("seed=1&seed=2", "key 'seed' is given twice"),
            ("laps=1&light=noon,night", "light names 2 laps, but laps=1"),
        ];
        for (query, expected) in cases {
            let reason = reason(&format!("street?{query}"));
            assert!(reason.contains(expected), "{query}: {reason}");
        }
        assert!(reason("forest?laps=2").contains("no world 'forest'; allowed are street and corridor"));
        assert!(reason("").contains("no world ''"));
    }

    #[test]
    fn naming_three_lights_asks_for_three_laps() {
        let spec: SyntheticSpec = "street?light=noon,dusk,night".parse().unwrap();
        assert_eq!(spec.laps(), 3);
        assert_eq!(spec.light_of_lap(2), Light::Night);
    }

    #[test]
    fn the_last_light_repeats() {
        let spec: SyntheticSpec = "street?laps=4&light=noon,night".parse().unwrap();
        assert_eq!((0..4).map(|lap| spec.light_of_lap(lap)).collect::<Vec<_>>()[1..], [Light::Night; 3]);
    }

    proptest! {
        #[test]
        fn no_text_makes_the_parser_panic(text in ".{0,80}") {
            let _ = text.parse::<SyntheticSpec>();
            let _ = format!("street?{text}").parse::<SyntheticSpec>();
        }
    }
}
