//! A recording of a run, made from the log that it wrote: what was answered and why, and the graph of the places that
//! it came to. Where its map is at hand, with pictures of what was matched.

use std::collections::VecDeque;
use std::io::{BufRead, Seek};
use std::mem;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use ::rerun::{RecordingStream, TextLog, TextLogLevel};

use super::log::Log;
use super::succession::{Stray, Succession};
use super::{Failure, ReviewError, learn_map, readable, recorded, settle};
use crate::place_map::{ExperienceId, PlaceMap};
use crate::recognition::Insight;
use crate::telemetry::rerun::clock::Clock;
use crate::telemetry::rerun::pictures::{Area, Pictures};
use crate::telemetry::rerun::place_graph::PlaceGraph;
use crate::telemetry::rerun::told::Told;
use crate::telemetry::rerun::{answer, blueprint, style};

/// What was shown of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReviewedRun {
    /// Frames.
    pub frames: usize,
    /// Places that it came to.
    pub places: usize,
    /// Frames that were alone in their answer, where the robot never went from there to there at other times.
    pub stray: usize,
    /// Lines that could not be read, and pictures of the map.
    pub unreadable: usize,
}

/// Writes a recording of the run that wrote `log` to `file`, which is replaced if it is there. With the run's `map`, it
/// has the pictures of what was seen and matched. Lines that are damaged are passed over and counted. Of a log that
/// several runs were appended to, the frames are counted on.
///
/// # Errors
/// If the file cannot be written, the log is none or cannot be read twice, the map's medium fails, or `stop` is set
/// meanwhile.
pub fn review_run(
    mut log: impl BufRead + Seek,
    map: Option<&PlaceMap>,
    file: &Path,
    stop: &AtomicBool,
) -> Result<ReviewedRun, ReviewError> {
    recorded(file, |stream| {
        let mut succession = Succession::default();
        let unreadable = read(&mut log, stop, |frame, told, is_anew| {
            if is_anew {
                succession.begin_anew();
            }
            succession.add(frame, told.place.map(|place| (place, told.name)), told.experience.is_some());
            Ok(())
        })?;
        log.rewind().map_err(|error| {
            let reason = format!("it is read twice, so it must be a file: {error}");
            Failure::Review(ReviewError::Log { line: 1, reason })
        })?;
        blueprint::send(&stream, |layout| layout.logged(map.is_some()))?;
        answer::dress(&stream)?;
        let mut run = Run::new(stream, map, &succession)?;
        read(&mut log, stop, |frame, told, _| run.show(frame, told))?;
        run.reviewed.unreadable += unreadable;
        Ok(run.reviewed)
    })
}

/// Has `take` take every frame, as if all runs were one, and whether it is the first one of another run. Counts the
/// lines that could not be read.
fn read(
    log: impl BufRead,
    stop: &AtomicBool,
    mut take: impl FnMut(u64, Told<'_>, bool) -> Result<(), Failure>,
) -> Result<usize, Failure> {
    let mut log = Log::new(log);
    let (mut last, mut counted_before, mut unknown) = (None, 0_u64, 0);
    while let Some(line) = log.next().map_err(Failure::Review)? {
        if stop.load(Ordering::Relaxed) {
            return Err(Failure::Review(ReviewError::Interrupted));
        }
        let Some(told) = Told::of_line(&line) else {
            unknown += 1;
            continue;
        };
        let ended = last.replace(line.frame).filter(|last| line.frame <= *last);
        counted_before =
            ended.map_or(counted_before, |ended| counted_before.saturating_add(ended).saturating_add(1));
        take(counted_before.saturating_add(line.frame), told, ended.is_some())?;
    }
    Ok(log.unreadable + unknown)
}

struct Run<'a> {
    map: Option<&'a PlaceMap>,
    stream: RecordingStream,
    clock: Clock,
    graph: PlaceGraph,
    /// The picture of the frame and that of the matched keyframe, and which experiences they are of.
    seen: (Pictures, Option<ExperienceId>),
    matched: (Pictures, Option<ExperienceId>),
    /// Frames that strayed and have not come yet.
    strays: VecDeque<Stray>,
    reviewed: ReviewedRun,
}

impl<'a> Run<'a> {
    fn new(
        stream: RecordingStream,
        map: Option<&'a PlaceMap>,
        succession: &Succession,
    ) -> Result<Self, Failure> {
        let (mut graph, places) = (PlaceGraph::default(), succession.sketches());
        let strays: VecDeque<Stray> = succession.strays().into();
        let reviewed = ReviewedRun { places: places.len(), stray: strays.len(), ..ReviewedRun::default() };
        match map {
            Some(map) => learn_map(&mut graph, map)?,
            None => graph.learn_places(&Insight { places, ..Insight::default() }),
        }
        let seen = (Pictures::new(style::EXPERIENCE_IMAGE), None);
        let matched = (Pictures::new(style::KEYFRAME_IMAGE), None);
        Ok(Self { map, stream, clock: Clock::default(), graph, seen, matched, strays, reviewed })
    }

    fn show(&mut self, frame: u64, mut told: Told<'_>) -> Result<(), Failure> {
        self.reviewed.frames += 1;
        self.clock.set(&self.stream, frame, told.capture_nanos);
        if let Some(map) = self.map {
            self.show_pictures(map, &mut told)?;
        }
        settle(&self.stream, self.reviewed.frames)?;
        // By now it may have turned out to be another one.
        let by_now = |place| self.map.and_then(|map| map.place(place)).map_or(place, |place| place.id);
        let here = told.place.map(|place| (by_now(place), style::colour(told.decision)));
        self.graph.show_at(&self.stream, frame, here)?;
        answer::show(&self.stream, &told)?;
        if let Some(stray) = self.strays.pop_front_if(|stray| stray.frame == frame) {
            let line = TextLog::new(in_words(stray)).with_level(TextLogLevel::WARN).with_color(style::ORANGE);
            self.stream.log(style::LOG, &line)?;
        }
        Ok(())
    }

    /// Shows what the frame became in the map and what it was matched with, and tells the latter's name.
    fn show_pictures(&mut self, map: &PlaceMap, told: &mut Told<'_>) -> Result<(), Failure> {
        let matched = told.matched.as_ref().map(|(id, _)| *id);
        for ((pictures, shown), id) in [(&mut self.seen, told.experience), (&mut self.matched, matched)] {
            // It may have been given up since then.
            let id = id.filter(|&id| map.experience(id).is_some());
            if mem::replace(shown, id) == id {
                continue;
            }
            let jpeg = id.map(|id| readable(map.thumbnail_jpeg(id))).transpose()?;
            self.reviewed.unreadable += usize::from(jpeg == Some(None));
            match jpeg.flatten() {
                Some(jpeg) => pictures.show_jpeg(&self.stream, &jpeg, Area::PLAIN)?,
                None => pictures.hide(&self.stream)?,
            }
        }
        if let Some((id, name)) = &mut told.matched
            && map.experience(*id).is_some()
        {
            *name = readable(map.origin(*id))?.map(|origin| origin.frame_name.into());
        }
        Ok(())
    }
}

fn in_words(stray: Stray) -> String {
    let Stray { place, before, after, .. } = stray;
    if before == after {
        let around = before.0;
        return format!(
            "place {} for this frame alone, amid place {around}; nothing else joins the two",
            place.0
        );
    }
    let (before, after) = (before.0, after.0);
    format!(
        "place {} for this frame alone, between {before} and {after}, which else follow each other",
        place.0
    )
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::io::Cursor;

    use ::rerun::log::Chunk;

    use super::*;
    use crate::codec;
    use crate::feature::Features;
    use crate::frame::Frame;
    use crate::place_map::{MapOptions, NewExperience, PlaceId, Traits};
    use crate::raster::RgbImage;
    use crate::telemetry::rerun::tests::{chunks_of, rows, values};

    /// A line of a frame at that place, which matched the map's first keyframe and became an experience of this number.
    fn line(frame: u64, place: u32) -> String {
        format!(
            concat!(
                r#"{{"frame":{},"capture_nanos":{},"decision":"revisited","by":"bow_hv","place":{},"#,
                r#""keyframe":0,"experience":{},"confidence":0.9,"inliers":31,"candidates":["#,
                r#"{{"place":9,"by":"cnn","score":0.5,"probability":0.004,"rejected":"probability 0.004 < 0.500"}}],"#,
                r#""latency_us":{{"cnn":12800}}}}"#,
                "\n"
            ),
            frame,
            1_723_456_789_000_000_000_u64 + frame * 100_000_000,
            place,
            frame % 2,
        )
    }

    fn review(log: &str, map: Option<&PlaceMap>) -> (ReviewedRun, BTreeMap<String, Vec<Chunk>>) {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("run.rrd");
        let reviewed = review_run(Cursor::new(log), map, &file, &AtomicBool::new(false)).unwrap();
        (reviewed, chunks_of(&file))
    }

    #[test]
    fn every_line_is_shown_and_what_strayed_is_marked_at_its_frame() {
        let places = [3, 3, 3, 7, 3, 3, 4, 4];
        let log: String = (0..).zip(places).map(|(frame, place)| line(frame, place)).collect();
        let (reviewed, chunks) = review(&log, None);
        assert_eq!(reviewed, ReviewedRun { frames: 8, places: 3, stray: 1, unreadable: 0 });
        assert_eq!((rows(&chunks, style::NOW), rows(&chunks, style::CONFIDENCE)), (8, 8));
        assert_eq!(rows(&chunks, style::LOG), 9);
        assert_eq!((rows(&chunks, style::HERE), rows(&chunks, style::KEYFRAME_IMAGE)), (8, 0));
        let told = values(&chunks, style::LOG, "TextLog:text");
        assert!(told.contains("place 7 for this frame alone, amid place 3; nothing else"), "{told}");
        assert!(
            told.contains("revisited place 4 by BoW+HV, 0.900; not 9: probability 0.004 < 0.500"),
            "{told}"
        );
        assert!(values(&chunks, "latency/cnn", "Scalars:scalars").contains("12.8"));
    }

    #[test]
    fn with_the_map_there_are_pictures_of_what_it_still_has() {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        let frame = Frame { name: "first.jpg".to_owned(), ..Frame::numbered(0) };
        let (features, traits) = (Features::default(), Traits::default());
        let thumbnail_jpeg = codec::jpeg(&RgbImage::new(64, 48));
        let keyframe = Some((&features, &traits));
        let new = NewExperience {
            frame: &frame,
            view: 0,
            mean_luminance: 1.0,
            thumbnail_jpeg: &thumbnail_jpeg,
            keyframe,
        };
        map.learn(None, &new).unwrap();
        map.name_place(PlaceId(0), "dock").unwrap();
        let (reviewed, chunks) = review(&(line(0, 0) + &line(1, 0)), Some(&map));
        assert_eq!(reviewed, ReviewedRun { frames: 2, places: 1, stray: 0, unreadable: 0 });
        let blobs = |path| values(&chunks, path, "EncodedImage:blob").matches("255,\n  216").count();
        // Both frames matched the same keyframe, and what the second one became is not in the map.
        assert_eq!(blobs(style::KEYFRAME_IMAGE), 1);
        assert_eq!(blobs(style::EXPERIENCE_IMAGE), 1);
        assert_eq!(rows(&chunks, "experience/images/cover"), 1);
        assert!(values(&chunks, style::NOW, "TextDocument:text").contains("keyframe 0 from first.jpg"));
        assert!(values(&chunks, style::PLACES, "Points2D:labels").contains("dock"));
    }

    #[test]
    fn runs_that_follow_each_other_in_a_log_are_counted_on() {
        let log = line(0, 3) + &line(1, 3) + &line(0, 8) + "{\"frame\":";
        let (reviewed, chunks) = review(&log, None);
        assert_eq!(reviewed, ReviewedRun { frames: 3, places: 2, stray: 0, unreadable: 1 });
        let frames = chunks[&format!("/{}", style::NOW)].iter().flat_map(|chunk| {
            chunk.timelines()[&crate::telemetry::rerun::clock::FRAME_TIMELINE.into()].times_raw().to_vec()
        });
        assert_eq!(frames.collect::<Vec<_>>(), [0, 1, 2]);
    }

    #[test]
    fn a_word_that_nobody_knows_is_no_answer() {
        let (reviewed, _) = review(&(line(0, 3) + &line(1, 3).replace("revisited", "guessed")), None);
        assert_eq!((reviewed.frames, reviewed.unreadable), (1, 1));
    }
}
