//! The map as a graph: places are nodes, the larger the more often they were seen; edges join places that follow each
//! other. Where a robot knows its position, places lie where they were seen, and its way is drawn.
//!
//! Of a large map, what is around the robot is shown.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::mem;

use ::rerun::{
    AnnotationContext, AnnotationInfo, Clear, Color, LineStrips2D, Points2D, Radius, RecordingStream,
    RecordingStreamResult,
};

use super::layout::Layout;
use super::style;
use super::target::one_line;
use super::trajectory::Trajectory;
use crate::frame::Pose;
use crate::place_map::PlaceId;
use crate::recognition::{Insight, PlaceSketch};
use crate::telemetry::FrameRecord;

/// Places that are shown at most.
const MOST_SHOWN: usize = 150;
/// Up to so many places, every one has its number written on it; among more, only those that have a name.
const MOST_NUMBERED: usize = 60;
/// Steps after which places that only grew are drawn anew.
const PATIENCE_STEPS: u64 = 30;
/// Steps after which the graph is drawn anew in any case: whoever comes late may have nothing of what is older.
const MOST_STEPS: u64 = 300;
/// Places that have their colour from the beginning, besides those with a name.
const ANNOTATED: u32 = 1024;
/// Longest name that is written, in characters.
const MAX_NAME: usize = 24;

/// The map, as far as it was told.
#[derive(Default)]
pub(super) struct PlaceGraph {
    places: BTreeMap<PlaceId, PlaceSketch>,
    /// Where places were seen first in this run, in metres to the right and down.
    seen_at: BTreeMap<PlaceId, [f32; 2]>,
    layout: Layout,
    trajectory: Trajectory,
    here: Option<PlaceId>,
    /// The places that are drawn.
    shown: Vec<PlaceId>,
    /// Whether nodes or edges came or went since the graph was drawn, and whether nodes grew.
    is_new: bool,
    has_grown: bool,
    drawn_at: u64,
    is_annotated: bool,
    /// Whether a place is marked.
    is_marked: bool,
}

impl PlaceGraph {
    /// Takes in what a record says of the map, whether it is shown or not.
    pub(super) fn learn(&mut self, record: &FrameRecord) {
        if let Some(insight) = &record.insight {
            self.learn_places(insight);
        }
        let Some(pose) = record.frame.pose else { return };
        self.trajectory.add(&pose);
        if let Some(place) = record.recognition.place
            && !self.seen_at.contains_key(&place)
        {
            self.put(place, &pose);
        }
    }

    /// The place lies there.
    pub(super) fn put(&mut self, place: PlaceId, pose: &Pose) {
        self.seen_at.insert(place, self.trajectory.in_plane(pose));
        self.is_new = true;
    }

    /// Takes in what is new of the map.
    pub(super) fn learn_places(&mut self, insight: &Insight) {
        if insight.is_whole_map {
            self.places.clear();
            self.is_new = true;
        }
        for place in &insight.places {
            let before = self.places.insert(place.id, place.clone());
            self.is_new |= before.is_none_or(|before| before.neighbours != place.neighbours);
            self.has_grown = true;
        }
    }

    /// Nothing of the graph is on show any more.
    pub(super) fn begin_anew(&mut self) {
        (self.is_new, self.is_annotated) = (true, false);
    }

    /// Draws the map with the robot in it.
    pub(super) fn show(
        &mut self,
        stream: &RecordingStream,
        record: &FrameRecord,
    ) -> RecordingStreamResult<()> {
        let here = record.recognition.place.map(|place| (place, style::colour(record.recognition.decision)));
        self.show_at(stream, record.frame.index, here)?;
        record.frame.pose.map_or(Ok(()), |pose| self.trajectory.show(stream, &pose))
    }

    /// Draws the map, at this step, with a disc of that colour behind a place.
    pub(super) fn show_at(
        &mut self,
        stream: &RecordingStream,
        step: u64,
        marked: Option<(PlaceId, Color)>,
    ) -> RecordingStreamResult<()> {
        let here = marked.map(|(place, _)| place).or(self.here).filter(|here| self.is_drawable(here));
        let steps = step.saturating_sub(self.drawn_at);
        let is_due = self.has_grown && steps >= PATIENCE_STEPS || steps >= MOST_STEPS;
        let is_out_of_sight = here.is_some_and(|here| self.shown.binary_search(&here).is_err());
        if !self.is_annotated && !self.places.is_empty() {
            self.is_annotated = true;
            self.annotate(stream)?;
        }
        if self.is_new || is_due || is_out_of_sight {
            self.draw(stream, here)?;
            (self.is_new, self.has_grown, self.drawn_at) = (false, false, step);
        }
        self.here = here;
        let marked = marked.and_then(|(place, colour)| Some((self.position(place)?, colour)));
        let Some((position, colour)) = marked else {
            return if mem::take(&mut self.is_marked) {
                stream.log(style::HERE, &Clear::flat())
            } else {
                Ok(())
            };
        };
        self.is_marked = true;
        let disc = Points2D::new([position])
            .with_radii([Radius::new_ui_points(9.0)])
            .with_colors([colour])
            .with_draw_order(style::BELOW_PLACES);
        stream.log(style::HERE, &disc)
    }

    /// Names and colours of places, for good: places are named between runs.
    fn annotate(&self, stream: &RecordingStream) -> RecordingStreamResult<()> {
        let named = self.places.values().filter(|place| place.name.is_some()).map(|place| place.id.0);
        let annotated: BTreeSet<u32> = (0..ANNOTATED).chain(named).collect();
        let annotations = annotated.into_iter().filter_map(|id| u16::try_from(id).ok()).map(|id| {
            let name = self.places.get(&PlaceId(id.into())).and_then(|place| place.name.as_deref());
            let label = name.map_or_else(|| format!("place {id}"), written);
            AnnotationInfo { id, label: Some(label.into()), color: Some(style::place_colour(id).0) }
        });
        stream.log_static(style::MAP, &AnnotationContext::new(annotations.collect::<Vec<_>>()))
    }

    /// Whether a place may be drawn. Where positions are known, places that have none do not lie in the same plane.
    fn is_drawable(&self, place: &PlaceId) -> bool {
        self.places.contains_key(place) && (self.seen_at.is_empty() || self.seen_at.contains_key(place))
    }

    /// Where a place is drawn, if it is.
    fn position(&self, place: PlaceId) -> Option<[f32; 2]> {
        if self.seen_at.is_empty() { self.layout.position(place) } else { self.seen_at.get(&place).copied() }
    }

    fn draw(&mut self, stream: &RecordingStream, here: Option<PlaceId>) -> RecordingStreamResult<()> {
        let shown: Vec<PlaceId> = self.around(here).into_iter().collect();
        let edges = self.edges(&shown);
        if self.seen_at.is_empty() {
            self.layout.settle(&shown, &edges);
        }
        let sketches = || shown.iter().filter_map(|place| self.places.get(place));
        let at = |place: PlaceId| self.position(place).unwrap_or_default();
        let nodes = Points2D::new(sketches().map(|place| at(place.id)))
            .with_radii(sketches().map(radius))
            .with_class_ids(sketches().map(class))
            .with_labels(sketches().map(|place| label(place, shown.len())))
            .with_show_labels(true)
            .with_draw_order(style::PLACES_ORDER);
        stream.log(style::PLACES, &nodes)?;
        for (path, is_succession, colour) in
            [(style::SUCCESSIONS, true, style::GREY), (style::REVISITS, false, style::ORANGE)]
        {
            let of_kind = edges.iter().filter(|(a, b)| (a.0.abs_diff(b.0) == 1) == is_succession);
            let lines = LineStrips2D::new(of_kind.map(|&(a, b)| [at(a), at(b)]))
                .with_radii([Radius::new_ui_points(0.8)])
                .with_colors([colour])
                .with_draw_order(style::BELOW_PLACES - 1.0);
            stream.log(path, &lines)?;
        }
        self.shown = shown;
        Ok(())
    }

    /// The places that are fewest steps from `here`; where that is nowhere, those that are newest.
    fn around(&self, here: Option<PlaceId>) -> BTreeSet<PlaceId> {
        let mut found = BTreeSet::new();
        let mut next: VecDeque<PlaceId> = here.into_iter().filter(|here| self.is_drawable(here)).collect();
        let mut newest = self.places.keys().rev().filter(|place| self.is_drawable(place));
        while found.len() < MOST_SHOWN {
            let Some(place) = next.pop_front().or_else(|| newest.next().copied()) else { break };
            if found.insert(place) {
                let neighbours = self.places.get(&place).into_iter().flat_map(|place| &place.neighbours);
                next.extend(neighbours.filter(|neighbour| self.is_drawable(neighbour)));
            }
        }
        found
    }

    /// The edges between places that are shown, each once, the smaller number first.
    fn edges(&self, shown: &[PlaceId]) -> Vec<(PlaceId, PlaceId)> {
        let mut edges = BTreeSet::new();
        for place in shown.iter().filter_map(|place| self.places.get(place)) {
            let seen = place.neighbours.iter().filter(|other| shown.binary_search(other).is_ok());
            edges.extend(seen.map(|&other| (place.id.min(other), place.id.max(other))));
        }
        edges.retain(|(a, b)| a != b);
        edges.into_iter().collect()
    }
}

/// Its area grows with the number of experiences, up to a hundred.
fn radius(place: &PlaceSketch) -> Radius {
    Radius::new_ui_points(2.0 + 0.6 * (place.experiences.min(100) as f32).sqrt())
}

/// The class by which a place has its colour: its own, or beyond those that have one, that of a place of the same
/// colour.
fn class(place: &PlaceSketch) -> u16 {
    let has_own = place.id.0 < ANNOTATED || place.name.is_some();
    let own = u16::try_from(place.id.0).ok().filter(|_| has_own);
    own.unwrap_or((place.id.0 % style::PLACE_COLOURS) as u16)
}

/// Its name, or its number where there is room for it.
fn label(place: &PlaceSketch, shown: usize) -> String {
    match &place.name {
        Some(name) => written(name),
        None if shown <= MOST_NUMBERED => place.id.0.to_string(),
        None => String::new(),
    }
}

/// A name from outside, as it is written on a place.
fn written(name: &str) -> String {
    one_line(name).chars().take(MAX_NAME).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sketch(id: u32, neighbours: &[u32]) -> PlaceSketch {
        let neighbours = neighbours.iter().copied().map(PlaceId).collect();
        PlaceSketch { id: PlaceId(id), name: None, experiences: 1, neighbours }
    }

    fn told(places: impl IntoIterator<Item = PlaceSketch>, is_whole_map: bool) -> Insight {
        Insight { places: places.into_iter().collect(), is_whole_map, ..Insight::default() }
    }

    /// A way of so many places.
    fn way(places: u32) -> PlaceGraph {
        let mut graph = PlaceGraph::default();
        graph.learn_places(&told((0..places).map(|id| sketch(id, &[id.saturating_sub(1)])), true));
        graph
    }

    #[test]
    fn of_a_large_map_the_places_around_the_robot_are_shown() {
        let mut graph = way(1000);
        assert_eq!(graph.around(None).first(), Some(&PlaceId(850)));
        graph.learn_places(&told([sketch(10, &[9, 999])], false));
        let around = graph.around(Some(PlaceId(10)));
        assert_eq!(around.len(), MOST_SHOWN);
        assert!(around.contains(&PlaceId(0)) && around.contains(&PlaceId(999)));
        assert!(!around.contains(&PlaceId(500)), "{around:?}");
    }

    #[test]
    fn where_positions_are_known_only_places_that_have_one_are_drawn() {
        let mut graph = way(5);
        let pose = |x| Pose { position_metres: [x, 5e6, 0.0], orientation: Pose::UPRIGHT };
        graph.put(PlaceId(1), &pose(100.0));
        graph.put(PlaceId(3), &pose(130.0));
        assert_eq!(graph.around(Some(PlaceId(4))), BTreeSet::from([1, 3].map(PlaceId)));
        assert_eq!(graph.position(PlaceId(3)), Some([30.0, 0.0]));
        assert_eq!(graph.position(PlaceId(4)), None);
    }

    #[test]
    fn every_place_has_a_colour_of_ours() {
        let named = PlaceSketch { name: Some("dock".into()), ..sketch(3000, &[]) };
        let classes =
            [sketch(7, &[]), sketch(3000, &[]), named, sketch(70_000, &[])].map(|place| class(&place));
        assert_eq!(classes, [7, 4, 3000, 0]);
    }

    #[test]
    fn an_edge_is_drawn_once_and_none_leads_out_of_sight_or_to_itself() {
        let mut graph = way(3);
        graph.learn_places(&told([sketch(0, &[1, 2, 7])], false));
        let shown = [0, 1, 2].map(PlaceId);
        let edges = [(0, 1), (0, 2), (1, 2)].map(|(a, b)| (PlaceId(a), PlaceId(b)));
        assert_eq!(graph.edges(&shown), edges);
    }

    #[test]
    fn a_map_that_is_told_anew_takes_the_place_of_the_old_one() {
        let mut graph = way(5);
        graph.learn_places(&told([sketch(1, &[])], true));
        assert_eq!(graph.around(None), BTreeSet::from([PlaceId(1)]));
    }
}
