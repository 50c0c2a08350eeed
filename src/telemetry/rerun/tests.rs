//! What a recording shows, read back with rerun's own decoder.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::rerun::external::re_log_encoding::DecoderApp;
use ::rerun::log::{Chunk, LogMsg};

use super::clock::{FRAME_TIMELINE, TIME_TIMELINE};
use super::*;
use crate::feature::{Features, Keypoint};
use crate::frame::{Frame, Pose};
use crate::geometry::{OrientedPoint, Point};
use crate::kernel::luma;
use crate::place_map::{ExperienceId, PlaceId};
use crate::raster::RgbImage;
use crate::recognition::{
    Candidate, Candidates, Decision, Evidence, Grounds, Insight, Look, MatchedKeyframe, PlaceSketch,
    Recognition, Rejection,
};
use crate::telemetry::{CnnStatus, Flow, Losses, StageLatency};
use crate::verification::{Correspondence, Verification};

/// The header of a JPEG of 64×48 pixels, which is all that the sink looks at.
const JPEG: [u8; 13] = [0xFF, 0xD8, 0xFF, 0xC0, 0, 17, 8, 0, 48, 0, 64, 3, 1];

/// Time of the first frame; from one to the next it is a tenth of a second.
const FIRST_NANOS: i64 = 1_723_456_789_000_000_000;
const TENTH_NANOS: i64 = 100_000_000;

fn keypoint(x: f32, y: f32) -> Keypoint {
    Keypoint { point: Point { x, y }, scale: 1.0, angle_radians: 0.0, response: 30 }
}

pub(super) fn record(index: u64, decision: Decision) -> FrameRecord {
    let colour = RgbImage::new(64, 48);
    let frame = Frame {
        index,
        capture_nanos: FIRST_NANOS + index as i64 * TENTH_NANOS,
        name: format!("{index}.jpg"),
        grey: luma(&colour),
        colour,
        jpeg: Some(JPEG.to_vec()),
        pose: None,
        true_place: None,
    };
    let features = Features {
        width_px: 64,
        height_px: 48,
        keypoints: vec![keypoint(10.0, 20.0), keypoint(30.0, 40.0)],
        descriptors: Vec::new(),
    };
    let rejected = Candidate {
        place: PlaceId(9),
        keyframe: ExperienceId(80),
        by: Evidence::BowHv,
        score: 0.041,
        votes: Some(9.5),
        inliers: Some(6),
        probability: 0.5,
        rejected: Some(Rejection::Unlikely { got: 0.25, needed: 0.8 }),
    };
    let recognition = Recognition {
        decision,
        by: None,
        place: (decision != Decision::Unknown).then_some(PlaceId(17)),
        name: Some("dock|*3*\n# x".into()),
        keyframe: None,
        experience: None,
        confidence: 0.993,
        inliers: None,
        candidates: Candidates::from_iter([rejected]),
        verification: None,
        grounds: Grounds::default(),
    };
    FrameRecord {
        frame: Arc::new(frame),
        look: Look { features, ..Look::default() },
        recognition,
        matched: None,
        insight: None,
        cnn: CnnStatus::Available,
        model: None,
        latency: StageLatency { total_us: 2600, ..StageLatency::default() },
        flow: Flow { losses: Losses { dropped: 3, ..Losses::default() }, ..Flow::default() },
    }
}

/// A record of a frame that was matched with a keyframe by two inliers and an outlier.
pub(super) fn matched(index: u64) -> FrameRecord {
    let at = |x, y| OrientedPoint { point: Point { x, y }, scale: 1.0, angle_radians: 0.0 };
    let pair = |index: u32| Correspondence {
        query: index,
        keyframe: index,
        query_point: at(10.0, 20.0),
        keyframe_point: at(12.0, 21.0),
    };
    let mut record = record(index, Decision::Revisited);
    record.recognition.by = Some(Evidence::BowHv);
    record.recognition.inliers = Some(2);
    record.recognition.verification = Some(Verification {
        correspondences: (0..3).map(pair).collect(),
        inliers: vec![0, 2],
        effective_inliers: 2,
        votes: 1.5,
        keyframe_from_query: None,
    });
    record.matched = Some(MatchedKeyframe {
        experience: ExperienceId(3),
        frame_name: "3.jpg".to_owned(),
        width_px: 128,
        height_px: 96,
        thumbnail_jpeg: JPEG.to_vec(),
    });
    record
}

/// A single file.
pub(super) fn save(file: impl Into<PathBuf>) -> RerunTarget {
    RerunTarget::Save(file.into(), Rotation::default())
}

/// Records to a file and answers the chunks it holds, by entity path.
fn recorded(records: &[FrameRecord]) -> BTreeMap<String, Vec<Chunk>> {
    recorded_in(RerunDetail::Normal, records)
}

fn recorded_in(detail: RerunDetail, records: &[FrameRecord]) -> BTreeMap<String, Vec<Chunk>> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.rrd");
    let mut sink = RerunSink::open(&save(file.clone()), detail).unwrap();
    for record in records {
        sink.record(record).unwrap();
    }
    sink.finish().unwrap();
    chunks_of(&file)
}

pub(super) fn chunks_of(file: &Path) -> BTreeMap<String, Vec<Chunk>> {
    let mut chunks: BTreeMap<String, Vec<Chunk>> = BTreeMap::new();
    for message in DecoderApp::decode_eager(BufReader::new(File::open(file).unwrap())).unwrap() {
        if let LogMsg::ArrowMsg(store, message) = message.unwrap()
            && store.is_recording()
        {
            let chunk = Chunk::from_arrow_msg(&message).unwrap();
            chunks.entry(chunk.entity_path().to_string()).or_default().push(chunk);
        }
    }
    chunks
}

pub(super) fn rows(chunks: &BTreeMap<String, Vec<Chunk>>, path: &str) -> usize {
    chunks
        .get(&format!("/{path}"))
        .into_iter()
        .flatten()
        .filter(|chunk| !chunk.is_static())
        .map(Chunk::num_rows)
        .sum()
}

/// All values of a component of `path`, as text.
pub(super) fn values(chunks: &BTreeMap<String, Vec<Chunk>>, path: &str, component: &str) -> String {
    let of_path = chunks.get(&format!("/{path}")).into_iter().flatten();
    let columns = of_path.flat_map(|chunk| chunk.components().iter());
    columns
        .filter(|(_, column)| column.descriptor.component.as_str() == component)
        .map(|(_, column)| format!("{:?}", column.list_array))
        .collect()
}

#[test]
fn a_recording_holds_every_frame_and_is_complete() {
    let records = [record(0, Decision::NewPlace), record(1, Decision::SamePlace), matched(2)];
    let chunks = recorded(&records);
    for path in
        [style::CAMERA_IMAGE, style::KEYPOINTS, style::PLACE, style::CONFIDENCE, style::NOW, style::LOG]
    {
        assert_eq!(rows(&chunks, path), 3, "{path}");
    }
    for (path, ..) in style::LATENCIES {
        assert_eq!(rows(&chunks, path), 3, "{path}");
    }
    assert_eq!(rows(&chunks, style::INLIERS), 1);
    for decision in [Decision::NewPlace, Decision::SamePlace, Decision::Revisited] {
        assert_eq!(rows(&chunks, &style::place_path(decision)), 1);
    }
}

#[test]
fn frames_are_on_their_own_timelines_and_no_clock_of_ours_is() {
    let chunks = recorded(&[record(7, Decision::NewPlace)]);
    let mut timelines: Vec<String> =
        chunks["/camera/image"][0].timelines().keys().map(|timeline| timeline.to_string()).collect();
    timelines.sort();
    assert_eq!(timelines, [TIME_TIMELINE, FRAME_TIMELINE]);
    let times = |chunks: &BTreeMap<String, Vec<Chunk>>| {
        let time = chunks["/camera/image"][0].timelines()[&TIME_TIMELINE.into()].clone();
        (time.timeline().typ(), time.times_raw().to_vec())
    };
    let date = times(&chunks);
    assert_eq!(date, (::rerun::time::TimeType::TimestampNs, vec![FIRST_NANOS + 7 * TENTH_NANOS]));
    let mut early = record(7, Decision::NewPlace);
    Arc::get_mut(&mut early.frame).unwrap().capture_nanos = 40_000_000;
    assert_eq!(times(&recorded(&[early])), (::rerun::time::TimeType::DurationNs, vec![40_000_000]));
}

#[test]
fn only_inliers_are_joined_and_the_lines_end_in_the_keyframe() {
    let chunks = recorded(&[matched(0)]);
    let strips = values(&chunks, style::LINES, "LineStrips2D:strips");
    // The keyframe is twice the frame's size, so it is halved, and stands at 64 × 1.03 px.
    assert_eq!(strips.matches("10.0").count(), 2, "{strips}");
    assert_eq!(strips.matches("71.92").count(), 2, "{strips}");
    assert_eq!(strips.matches("10.5").count(), 2, "{strips}");
}

#[test]
fn a_match_is_cleared_when_the_next_frame_has_none_and_only_then() {
    let chunks = recorded(&[
        record(0, Decision::NewPlace),
        matched(1),
        matched(2),
        record(3, Decision::Unknown),
        record(4, Decision::Unknown),
    ]);
    let times = |path: &str| {
        let of_chunk = |chunk: &Chunk| chunk.timelines()[&FRAME_TIMELINE.into()].times_raw().to_vec();
        chunks[&format!("/{path}")].iter().flat_map(of_chunk).collect::<BTreeSet<_>>()
    };
    assert_eq!(times(style::KEYFRAME_IMAGE), BTreeSet::from([1, 2]));
    assert_eq!(times("match/now/keyframe/images/cover"), BTreeSet::from([3]));
    for drawn in [style::LINES, style::FRAME_INLIERS, style::KEYFRAME_INLIERS] {
        assert_eq!(times(drawn), BTreeSet::from([1, 2, 3]), "{drawn}");
    }
}

#[test]
fn a_jpeg_is_passed_on_untouched() {
    let chunks = recorded(&[record(0, Decision::NewPlace)]);
    let bytes = JPEG.map(|byte| byte.to_string()).join(", ");
    let blob = one_line(&values(&chunks, style::CAMERA_IMAGE, "EncodedImage:blob"));
    assert!(blob.contains(&bytes), "{blob}");
}

#[test]
fn names_from_outside_cannot_break_out_of_the_answer() {
    let chunks = recorded(&[record(0, Decision::Recognised)]);
    let page = values(&chunks, style::NOW, "TextDocument:text");
    assert!(page.contains(r"dock\\|\\*3\\* \\# x") || page.contains(r"dock\|\*3\* \# x"), "{page}");
    assert!(page.contains("probability 0.250 < 0.800"), "{page}");
    let log = values(&chunks, style::LOG, "TextLog:text");
    assert!(
        log.contains("recognised place 17 (dock|*3* # x), 0.993; not 9: probability 0.250 < 0.800"),
        "{log}"
    );
}

/// A record of a frame in `place`, with what its answer went by; the place is new.
pub(super) fn insightful(index: u64, place: u32) -> FrameRecord {
    let neighbours = place.checked_sub(1).map(PlaceId).into_iter().collect();
    let sketch = PlaceSketch { id: PlaceId(place), name: Some("dock".into()), experiences: 4, neighbours };
    let insight = Insight {
        similarities: vec![(ExperienceId(1), 0.25), (ExperienceId(index as u32 + 2), 1.0)],
        belief: vec![(PlaceId(place), 0.75)],
        elsewhere: 0.25,
        places: vec![sketch],
        is_whole_map: index == 0,
    };
    let mut record = record(index, Decision::NewPlace);
    record.recognition.place = Some(PlaceId(place));
    record.insight = Some(Box::new(insight));
    record
}

#[test]
fn map_belief_and_similarities_are_shown_and_places_have_their_colours_for_good() {
    let chunks = recorded(&[insightful(0, 0), insightful(1, 1), insightful(2, 1)]);
    assert_eq!(rows(&chunks, style::BELIEF), 3);
    let bars = values(&chunks, style::BELIEF, "BarChart:abscissa");
    assert!(bars.contains("-2") && bars.contains("-1") && bars.contains('1'), "{bars}");
    assert_eq!(rows(&chunks, style::SIMILARITY), 3);
    // The third frame brings neither a place nor an edge.
    assert_eq!((rows(&chunks, style::PLACES), rows(&chunks, style::HERE)), (2, 3));
    assert!(values(&chunks, style::PLACES, "Points2D:labels").contains("dock"));
    let annotations = &chunks[&format!("/{}", style::MAP)];
    assert!(annotations.iter().all(Chunk::is_static) && annotations.len() == 1);
    assert!(!chunks.contains_key(&format!("/{}", style::TRAJECTORY)), "nothing tells where it is");
}

#[test]
fn where_something_tells_the_position_the_way_is_drawn_and_places_lie_on_it() {
    let posed = |index: u64, x: f64| {
        let mut record = insightful(index, index as u32);
        let pose = Pose { position_metres: [x, 5.0, 0.0], orientation: Pose::UPRIGHT };
        Arc::get_mut(&mut record.frame).unwrap().pose = Some(pose);
        record
    };
    let chunks = recorded(&[posed(0, 250.0), posed(1, 260.0)]);
    assert_eq!((rows(&chunks, style::ROBOT), rows(&chunks, style::TRAJECTORY)), (2, 1));
    let places = values(&chunks, style::PLACES, "Points2D:positions");
    assert!(places.contains("0.0") && places.contains("10.0") && !places.contains("250"), "{places}");
}

#[test]
fn lean_shows_answers_of_all_frames_and_a_small_picture_a_second() {
    let records: Vec<FrameRecord> = (0..25).map(|index| insightful(index, 0)).collect();
    let lean = recorded_in(RerunDetail::Lean, &records);
    assert_eq!((rows(&lean, style::LOG), rows(&lean, style::BELIEF)), (25, 25));
    assert_eq!(rows(&lean, style::CAMERA_IMAGE), 3);
    assert_eq!((rows(&lean, style::KEYPOINTS), rows(&lean, style::SIMILARITY)), (0, 0));
    let full = recorded_in(RerunDetail::Full, &records);
    assert_eq!((rows(&full, style::CAMERA_IMAGE), rows(&full, style::KEYPOINTS)), (25, 25));
}
