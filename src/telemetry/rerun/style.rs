//! Entity paths and colours: the names that scene, answer and blueprint share.
//!
//! The colours are those of Okabe and Ito (*Color Universal Design*, 2008), which all kinds of colour
//! vision tell apart.

use ::rerun::{Color, Rgba32};

use crate::recognition::Decision;

/// The frame as it came from the camera.
pub(super) const CAMERA_IMAGE: &str = "camera/image";
/// Its ORB keypoints.
pub(super) const KEYPOINTS: &str = "camera/image/keypoints";

/// Inliers in the frame.
pub(super) const FRAME_INLIERS: &str = "match/now/frame_inliers";
/// From each inlier of the frame to its counterpart in the keyframe.
pub(super) const LINES: &str = "match/now/lines";
/// The keyframe's space: pixels of the keyframe, moved to the right of the frame.
pub(super) const KEYFRAME: &str = "match/now/keyframe";
/// The keyframe's thumbnail.
pub(super) const KEYFRAME_IMAGE: &str = "match/now/keyframe/image";
/// Inliers in the keyframe.
pub(super) const KEYFRAME_INLIERS: &str = "match/now/keyframe/inliers";
/// The outlines of frame and keyframe, so that a missing match is seen as such.
pub(super) const OUTLINES: &str = "match/outlines";

/// The place over time.
pub(super) const PLACE: &str = "recognition/place";
/// Probability that the decision is right.
pub(super) const CONFIDENCE: &str = "recognition/confidence";
/// Effective inliers of verified matches.
pub(super) const INLIERS: &str = "recognition/inliers";
/// How like each keyframe each frame was, as a picture.
pub(super) const SIMILARITY: &str = "recognition/similarity";
/// Where the robot is believed to be.
pub(super) const BELIEF: &str = "recognition/belief";
/// The answer, in words.
pub(super) const NOW: &str = "recognition/now";
/// The answers so far, a line each.
pub(super) const LOG: &str = "recognition/log";

/// All that lies in the map's plane.
pub(super) const MAP: &str = "map";
/// The places.
pub(super) const PLACES: &str = "map/places";
/// Between places whose numbers follow each other: they were founded one after the other.
pub(super) const SUCCESSIONS: &str = "map/successions";
/// Between other places that follow each other on a way: mostly where the robot came back.
pub(super) const REVISITS: &str = "map/revisits";
/// The place that the robot is in.
pub(super) const HERE: &str = "map/here";
/// Where the robot is, where something tells.
pub(super) const ROBOT: &str = "map/robot";
/// Where the robot was, where something told.
pub(super) const TRAJECTORY: &str = "map/trajectory";
/// The pictures of a place, in a review.
pub(super) const GALLERY: &str = "gallery";
/// What is counted of places, in a review.
pub(super) const COUNTS: &str = "counts";
/// Experiences of a place.
pub(super) const SIZE: &str = "counts/experiences";
/// Keyframes of a place.
pub(super) const KEYFRAMES: &str = "counts/keyframes";
/// In which light places are known, in a review.
pub(super) const LIGHT: &str = "light";
/// The least mean luminance of a place.
pub(super) const DARKEST: &str = "light/darkest";
/// The greatest mean luminance of a place.
pub(super) const BRIGHTEST: &str = "light/brightest";
/// All of an experience, in a review.
pub(super) const EXPERIENCE: &str = "experience";
/// Its picture.
pub(super) const EXPERIENCE_IMAGE: &str = "experience/image";
/// Its place.
pub(super) const EXPERIENCE_PLACE: &str = "experience/place";

/// Outlines lie above pictures, and below all else that is drawn on them.
pub(super) const OUTLINES_ORDER: f32 = -10.0;
/// Places lie above the edges between them.
pub(super) const PLACES_ORDER: f32 = 40.0;
/// The robot's place has a disc behind it.
pub(super) const BELOW_PLACES: f32 = 39.0;

/// Stages with the paths of their latencies and colours.
pub(super) const LATENCIES: [(&str, &str, Color); 7] = [
    ("latency/answer", "capture to answer", ORANGE),
    ("latency/total", "total", WHITE),
    ("latency/decode", "decode", GREY),
    ("latency/features", "features", GREEN),
    ("latency/cnn", "CNN", BLUE),
    ("latency/retrieval", "retrieval", YELLOW),
    ("latency/verification", "verification", PURPLE),
];

/// What waits before which stage, and what was lost so far, with paths and colours.
pub(super) const FLOW: [(&str, &str, Color); 9] = [
    ("flow/waiting/features", "wait for features", GREEN),
    ("flow/waiting/cnn", "wait for the CNN", BLUE),
    ("flow/waiting/recognition", "wait for recognition", YELLOW),
    ("flow/waiting/sinks", "wait for a sink", PURPLE),
    ("flow/unreadable", "unreadable", VERMILION),
    ("flow/lost", "lost by the device", GREY),
    ("flow/dropped", "dropped", ORANGE),
    ("flow/spared", "spared for the budget", FAINT),
    ("flow/missed", "missed by a sink", WHITE),
];

const fn rgb(hex: u32) -> Color {
    Color(Rgba32(hex << 8 | 0xFF))
}

pub(super) const WHITE: Color = rgb(0xE6E6E6);
pub(super) const GREY: Color = rgb(0x8C8C8C);
pub(super) const FAINT: Color = rgb(0x404040);
pub(super) const BLUE: Color = rgb(0x56B4E9);
pub(super) const GREEN: Color = rgb(0x009E73);
pub(super) const YELLOW: Color = rgb(0xF0E442);
pub(super) const ORANGE: Color = rgb(0xE69F00);
pub(super) const PURPLE: Color = rgb(0xCC79A7);
pub(super) const VERMILION: Color = rgb(0xD55E00);

/// All decisions.
pub(super) const DECISIONS: [Decision; 5] =
    [Decision::Recognised, Decision::Revisited, Decision::SamePlace, Decision::NewPlace, Decision::Unknown];

/// A decision as people read it.
pub(super) fn words(decision: Decision) -> &'static str {
    match decision {
        Decision::Recognised => "recognised",
        Decision::Revisited => "revisited",
        Decision::SamePlace => "same place",
        Decision::NewPlace => "new place",
        Decision::Unknown => "unknown",
    }
}

/// The colour of a decision.
pub(super) fn colour(decision: Decision) -> Color {
    match decision {
        Decision::Recognised => BLUE,
        Decision::Revisited => GREEN,
        Decision::SamePlace => GREY,
        Decision::NewPlace => ORANGE,
        Decision::Unknown => PURPLE,
    }
}

/// Colours that places have in turn.
pub(super) const PLACE_COLOURS: u32 = 7;

/// The colour of a place; few of them are to be told apart at a time.
pub(super) fn place_colour(place: u16) -> Color {
    let colours: [Color; PLACE_COLOURS as usize] = [BLUE, GREEN, YELLOW, ORANGE, PURPLE, VERMILION, GREY];
    colours[usize::from(place) % colours.len()]
}

/// Where the answers of frames with this decision lie in the picture of similarities.
pub(super) fn similarity_path(decision: Decision) -> String {
    format!("{SIMILARITY}/{}", decision.as_str())
}

/// Where the places of frames with this decision are plotted.
pub(super) fn place_path(decision: Decision) -> String {
    format!("{PLACE}/{}", decision.as_str())
}
