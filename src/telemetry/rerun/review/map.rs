//! A recording of a whole map, for people who look it over: place by place on the timeline `place`, and all experiences
//! in the order in which they were made on `experience`.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use ::rerun::time::Timestamp;
use ::rerun::{
    Color, RecordingStream, Scalars, SeriesLines, SeriesPoints, TextDocument, TextLog, TextLogLevel, TimeCell,
};

use super::super::answer::{escaped, escaped_sentence};
use super::super::clock::{EARLIEST_DATE_NANOS, TIME_TIMELINE};
use super::super::gallery::{self, Gallery, Picture};
use super::super::pictures::{Area, Pictures};
use super::super::place_graph::PlaceGraph;
use super::super::{blueprint, style};
use super::{Failure, ReviewError, learn_map, readable, recorded, settle};
use crate::place_map::{Experience, ExperienceId, Origin, Place, PlaceId, PlaceMap};
use crate::recognition::PlaceSketch;

/// The timeline of places.
pub(in super::super) const PLACE_TIMELINE: &str = "place";
/// The timeline of experiences.
const EXPERIENCE_TIMELINE: &str = "experience";
/// Names of other places that turned out to be this one, and places next to it, that are listed.
const LISTED: usize = 8;

/// What makes a place worth a look.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The place.
    pub place: PlaceId,
    /// What is odd about it, in a sentence.
    pub what: String,
}

/// What was shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reviewed {
    /// Places.
    pub places: usize,
    /// Their experiences, as far as they could be read.
    pub experiences: usize,
    /// Experiences that could not be read, and are missing.
    pub unreadable: usize,
}

/// Writes a recording of `map` to `file`, which is replaced if it is there, with what was found about its places.
/// Experiences that are damaged are left out and counted.
///
/// # Errors
/// If the file cannot be written, the map's medium fails, or `stop` is set meanwhile.
pub fn review_map(
    map: &PlaceMap,
    findings: &[Finding],
    file: &Path,
    stop: &AtomicBool,
) -> Result<Reviewed, ReviewError> {
    recorded(file, |stream| {
        let mut merged: BTreeMap<PlaceId, Vec<u32>> = BTreeMap::new();
        for other in map.places().filter(|place| place.merged_into.is_some()) {
            map.place(other.id)
                .into_iter()
                .for_each(|now| merged.entry(now.id).or_default().push(other.id.0));
        }
        let mut review = Review {
            map,
            findings,
            stream,
            graph: PlaceGraph::default(),
            gallery: Gallery::new(),
            experience: Pictures::new(style::EXPERIENCE_IMAGE),
            merged,
            reviewed: Reviewed::default(),
        };
        review.write(stop)?;
        Ok(review.reviewed)
    })
}

/// An experience as it is shown.
struct Seen {
    experience: Experience,
    origin: Origin,
    thumbnail_jpeg: Vec<u8>,
}

struct Review<'a> {
    map: &'a PlaceMap,
    findings: &'a [Finding],
    stream: RecordingStream,
    graph: PlaceGraph,
    gallery: Gallery,
    experience: Pictures,
    /// What turned out to be each place.
    merged: BTreeMap<PlaceId, Vec<u32>>,
    reviewed: Reviewed,
}

impl Review<'_> {
    fn write(&mut self, stop: &AtomicBool) -> Result<(), Failure> {
        blueprint::send(&self.stream, |layout| layout.review())?;
        self.dress()?;
        learn_map(&mut self.graph, self.map)?;
        let living = self.map.living_places();
        for place in living.map(|place| place.id).collect::<Vec<_>>() {
            if stop.load(Ordering::Relaxed) {
                return Err(Failure::Review(ReviewError::Interrupted));
            }
            self.show_place(place)?;
        }
        self.show_experiences(stop)
    }

    fn dress(&self) -> Result<(), Failure> {
        let line = |path: &str, name: &str, colour: Color| {
            let dress = SeriesLines::new().with_names([name]).with_colors([colour]).with_widths([1.2]);
            self.stream.log_static(path, &dress)
        };
        line(style::SIZE, "experiences", style::WHITE)?;
        line(style::KEYFRAMES, "keyframes", style::BLUE)?;
        line(style::DARKEST, "darkest", style::PURPLE)?;
        line(style::BRIGHTEST, "brightest", style::YELLOW)?;
        let points =
            SeriesPoints::new().with_names(["place"]).with_colors([style::BLUE]).with_marker_sizes([2.0]);
        Ok(self.stream.log_static(style::EXPERIENCE_PLACE, &points)?)
    }

    fn seen(&self, id: ExperienceId) -> Result<Option<Seen>, Failure> {
        let Some(&experience) = self.map.experience(id) else { return Ok(None) };
        let origin = readable(self.map.origin(id))?;
        let thumbnail = readable(self.map.thumbnail_jpeg(id))?;
        Ok(origin.zip(thumbnail).map(|(origin, thumbnail_jpeg)| Seen { experience, origin, thumbnail_jpeg }))
    }

    fn show_place(&mut self, id: PlaceId) -> Result<(), Failure> {
        let map = self.map;
        let Some(place) = map.place(id) else { return Ok(()) };
        self.reviewed.places += 1;
        settle(&self.stream, self.reviewed.places)?;
        self.stream.reset_time();
        self.stream.set_time(PLACE_TIMELINE, TimeCell::from_sequence(i64::from(id.0)));
        let experiences: Vec<Experience> =
            place.experiences.iter().filter_map(|&id| map.experience(id).copied()).collect();
        let mut pictures = Vec::new();
        for id in chosen(&experiences) {
            pictures.extend(self.seen(id)?.map(picture));
        }
        self.gallery.show(&self.stream, &pictures)?;
        self.graph.show_at(&self.stream, id.0.into(), Some((id, style::WHITE)))?;
        let page = self.page(place, &experiences)?;
        self.stream.log(style::NOW, &TextDocument::from_markdown(page))?;
        self.show_measures(&experiences)?;
        self.show_log(place)
    }

    fn show_measures(&self, experiences: &[Experience]) -> Result<(), Failure> {
        let keyframes = experiences.iter().filter(|experience| experience.is_keyframe).count();
        self.stream.log(style::SIZE, &Scalars::single(experiences.len() as f64))?;
        self.stream.log(style::KEYFRAMES, &Scalars::single(keyframes as f64))?;
        if let Some([darkest, brightest]) = light(experiences) {
            self.stream.log(style::DARKEST, &Scalars::single(f64::from(darkest)))?;
            self.stream.log(style::BRIGHTEST, &Scalars::single(f64::from(brightest)))?;
        }
        Ok(())
    }

    fn show_log(&self, place: &Place) -> Result<(), Failure> {
        for finding in self.findings.iter().filter(|finding| finding.place == place.id) {
            let line = TextLog::new(format!("place {}: {}", place.id.0, finding.what));
            self.stream.log(style::LOG, &line.with_level(TextLogLevel::WARN).with_color(style::ORANGE))?;
        }
        for merged in self.merged_into(place.id) {
            let line = TextLog::new(format!("place {merged} turned out to be place {}", place.id.0));
            self.stream.log(style::LOG, &line.with_level(TextLogLevel::INFO).with_color(style::BLUE))?;
        }
        Ok(())
    }

    /// The numbers of places that turned out to be this one.
    fn merged_into(&self, place: PlaceId) -> &[u32] {
        self.merged.get(&place).map_or(&[], Vec::as_slice)
    }

    /// What is known of a place, in words.
    fn page(&self, place: &Place, experiences: &[Experience]) -> Result<String, Failure> {
        let mut page = format!("# Place {}", place.id.0);
        if let Some(name) = &place.name {
            let _ = write!(page, " · {}", escaped(name));
        }
        let keyframes = experiences.iter().filter(|experience| experience.is_keyframe).count();
        let _ = write!(page, "\n\nexperiences: {}, of which keyframes: {keyframes}", experiences.len());
        for finding in self.findings.iter().filter(|finding| finding.place == place.id) {
            let _ = write!(page, "\n\n**{}**", escaped_sentence(&finding.what));
        }
        page.push_str("\n\n| | |\n|---|---|\n");
        for (word, experience) in [("first seen", experiences.first()), ("last seen", experiences.last())] {
            let Some(experience) = experience else { continue };
            let origin = readable(self.map.origin(experience.id))?;
            let seen = origin.map_or("unreadable".to_owned(), |origin| {
                format!("{} {}", date(origin.capture_nanos), escaped(&origin.frame_name))
            });
            let _ = writeln!(page, "| {word} | {seen} |");
        }
        if let Some([darkest, brightest]) = light(experiences) {
            let _ = writeln!(page, "| mean luminance | {darkest:.0} to {brightest:.0} of 255 |");
        }
        let next = PlaceSketch::of(place, self.map).neighbours;
        let next: Vec<u32> = next.iter().map(|place| place.0).collect();
        push_list(&mut page, "next to it", &next);
        push_list(&mut page, "known before as", self.merged_into(place.id));
        Ok(page)
    }

    fn show_experiences(&mut self, stop: &AtomicBool) -> Result<(), Failure> {
        let map = self.map;
        for experience in map.experiences() {
            if stop.load(Ordering::Relaxed) {
                return Err(Failure::Review(ReviewError::Interrupted));
            }
            let Some(seen) = self.seen(experience.id)? else {
                self.reviewed.unreadable += 1;
                continue;
            };
            self.reviewed.experiences += 1;
            settle(&self.stream, self.reviewed.experiences)?;
            self.stream.reset_time();
            self.stream.set_time(EXPERIENCE_TIMELINE, TimeCell::from_sequence(i64::from(experience.id.0)));
            if seen.origin.capture_nanos >= EARLIEST_DATE_NANOS {
                let time = TimeCell::from_timestamp_nanos_since_epoch(seen.origin.capture_nanos);
                self.stream.set_time(TIME_TIMELINE, time);
            }
            self.experience.show_jpeg(&self.stream, &seen.thumbnail_jpeg, Area::PLAIN)?;
            if let Some(place) = map.place(experience.learnt_as) {
                self.stream.log(style::EXPERIENCE_PLACE, &Scalars::single(f64::from(place.id.0)))?;
            }
        }
        Ok(())
    }
}

/// Which experiences are on the sheet of a place, in their order: keyframes before others.
fn chosen(experiences: &[Experience]) -> Vec<ExperienceId> {
    let of_kind = |is_keyframe: bool| {
        let of_kind = experiences.iter().filter(|experience| experience.is_keyframe == is_keyframe);
        of_kind.map(|experience| experience.id).collect::<Vec<_>>()
    };
    let (keyframes, others) = (of_kind(true), of_kind(false));
    let left = gallery::MOST - keyframes.len().min(gallery::MOST);
    let keyframes = gallery::evenly(keyframes.len(), gallery::MOST).map(|index| keyframes[index]);
    let others = gallery::evenly(others.len(), left).map(|index| others[index]);
    let mut chosen: Vec<ExperienceId> = keyframes.chain(others).collect();
    chosen.sort_unstable();
    chosen
}

fn picture(Seen { experience, origin, thumbnail_jpeg }: Seen) -> Picture {
    let label = format!("{} · {}", experience.id.0, date(origin.capture_nanos));
    Picture { jpeg: thumbnail_jpeg, label, is_keyframe: experience.is_keyframe }
}

/// Least and greatest mean luminance.
fn light(experiences: &[Experience]) -> Option<[f32; 2]> {
    let light = || experiences.iter().filter_map(|experience| experience.mean_luminance);
    Some([light().min_by(f32::total_cmp)?, light().max_by(f32::total_cmp)?])
}

/// A date, or where the source has no clock, seconds since its beginning.
fn date(capture_nanos: i64) -> String {
    if capture_nanos < EARLIEST_DATE_NANOS {
        return format!("{:.1} s", capture_nanos as f64 / 1e9);
    }
    let date = Timestamp::from_nanos_since_epoch(capture_nanos).format_iso();
    date.chars().take("2024-08-12T09:59:49".len()).map(|c| if c == 'T' { ' ' } else { c }).collect()
}

fn push_list(page: &mut String, what: &str, places: &[u32]) {
    if places.is_empty() {
        return;
    }
    let listed: Vec<String> = places.iter().take(LISTED).map(ToString::to_string).collect();
    let more = match places.len().saturating_sub(LISTED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let _ = writeln!(page, "| {what} | {}{more} |", listed.join(", "));
}

#[cfg(test)]
mod tests {
    use super::super::super::tests::{chunks_of, rows, values};
    use super::*;
    use crate::codec;
    use crate::feature::Features;
    use crate::frame::{Frame, Pose};
    use crate::place_map::{MapOptions, NewExperience, Traits};
    use crate::raster::RgbImage;

    const NOON: i64 = 1_723_456_789_000_000_000;

    /// Learns an experience, by day unless it is odd.
    fn learn(map: &mut PlaceMap, place: Option<u32>, index: u64, is_keyframe: bool) {
        let pose = Pose { position_metres: [index as f64, 3.0, 0.0], orientation: Pose::UPRIGHT };
        let name = format!("{index}.jpg");
        let frame = Frame { capture_nanos: NOON, name, pose: Some(pose), ..Frame::numbered(index) };
        let (features, traits) = (Features::default(), Traits::default());
        let new = NewExperience {
            frame: &frame,
            view: index,
            mean_luminance: if index.is_multiple_of(2) { 120.0 } else { 40.0 },
            thumbnail_jpeg: &codec::jpeg(&RgbImage::new(64, 48)),
            keyframe: is_keyframe.then_some((&features, &traits)),
        };
        map.learn(place.map(PlaceId), &new).unwrap();
    }

    /// Two places, and a third that turned out to be the first.
    fn map() -> PlaceMap {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        learn(&mut map, None, 0, true);
        (1..40).for_each(|index| learn(&mut map, Some(0), index, index < 4));
        learn(&mut map, None, 40, true);
        learn(&mut map, None, 41, true);
        map.merge_places(PlaceId(2), PlaceId(0)).unwrap();
        map.name_place(PlaceId(1), "dock").unwrap();
        map
    }

    #[test]
    fn every_place_has_its_sheet_and_every_experience_its_picture() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("map.rrd");
        let findings = [Finding { place: PlaceId(1), what: "falls into 2 parts".to_owned() }];
        let reviewed = review_map(&map(), &findings, &file, &AtomicBool::new(false)).unwrap();
        assert_eq!(reviewed, Reviewed { places: 2, experiences: 42, unreadable: 0 });
        let chunks = chunks_of(&file);
        assert_eq!(
            (rows(&chunks, style::NOW), rows(&chunks, style::SIZE), rows(&chunks, style::HERE)),
            (2, 2, 2)
        );
        assert_eq!(
            (rows(&chunks, style::EXPERIENCE_IMAGE), rows(&chunks, style::EXPERIENCE_PLACE)),
            (42, 42)
        );
        // The first sheet is full, the second has one picture.
        assert_eq!(rows(&chunks, &format!("{}/23/image", style::GALLERY)), 1);
        assert_eq!(rows(&chunks, &format!("{}/00/image", style::GALLERY)), 2);
        let page = values(&chunks, style::NOW, "TextDocument:text");
        for expected in [
            "Place 1 · dock",
            "falls into 2 parts",
            "known before as | 2",
            "2024-08-12 09:59:49",
            "40 to 120",
        ] {
            assert!(page.contains(expected), "{expected}: {page}");
        }
        let log = values(&chunks, style::LOG, "TextLog:text");
        assert!(
            log.contains("place 1: falls into 2 parts") && log.contains("place 2 turned out to be place 0")
        );
    }

    #[test]
    fn keyframes_come_before_others_and_all_in_their_order() {
        let map = map();
        let experiences: Vec<Experience> = map.experiences().copied().collect();
        let shown = chosen(&experiences);
        assert_eq!(shown.len(), gallery::MOST);
        assert!(shown.is_sorted());
        assert!([0, 1, 2, 3, 40, 41].iter().all(|keyframe| shown.contains(&ExperienceId(*keyframe))));
    }

    #[test]
    fn whoever_stops_it_gets_no_recording() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("map.rrd");
        let stopped = review_map(&map(), &[], &file, &AtomicBool::new(true));
        assert!(matches!(stopped, Err(ReviewError::Interrupted)));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_source_without_a_clock_counts_from_its_beginning() {
        assert_eq!(date(1_500_000_000), "1.5 s");
        assert_eq!(date(NOON), "2024-08-12 09:59:49");
    }
}
