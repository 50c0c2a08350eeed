//! A map for tests: places that were seen so often, and what each time looked like.

use crate::feature::Features;
use crate::frame::Frame;
use crate::place_map::{MapOptions, NewExperience, PlaceId, PlaceMap, Traits};

/// A map of one place after the other that was seen so many times; every image is what `jpeg_of` says of the place.
pub(super) fn scripted_map(sizes: &[usize], mut jpeg_of: impl FnMut(usize) -> Vec<u8>) -> PlaceMap {
    let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
    let (features, traits) = (Features::default(), Traits::default());
    for (index, &size) in sizes.iter().enumerate() {
        let mut place: Option<PlaceId> = None;
        for time in 0..size {
            let frame = Frame { capture_nanos: time as i64, ..Frame::numbered(0) };
            let new = NewExperience {
                frame: &frame,
                view: 0,
                mean_luminance: 100.0,
                thumbnail_jpeg: &jpeg_of(index),
                keyframe: place.is_none().then_some((&features, &traits)),
            };
            place = Some(map.learn(place, &new).unwrap().place);
        }
    }
    map
}
