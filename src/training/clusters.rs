//! The classes: places of one or more maps that have enough experiences (the paper's section III.B), each parted by
//! time into what is learnt and what is held out.

use std::collections::{BTreeMap, BTreeSet};

use crate::frame::Pose;
use crate::place_map::{Experience, ExperienceId, MapError, Place, PlaceId, PlaceMap};

/// Captures further apart than this belong to two visits.
const VISIT_GAP_NANOS: i64 = 5_000_000_000;
/// Experiences that differ by no more in light, in grey levels, and not at all in view tell nothing new.
const SAME_LIGHT: f32 = 1.0;
/// Views that far apart, in radians, do not show the same however near the robot stands: half a right angle.
const MOST_TURN: f64 = std::f64::consts::FRAC_PI_4;

/// What makes a place a class.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClusterRules {
    /// Fewest experiences; the paper leaves smaller clusters out.
    pub min_samples: usize,
    /// Share of a class's experiences, the latest ones, that are held out, between 0 and 1.
    pub held_out_share: f64,
    /// How near to a keyframe of a class an experience of a place that is none must have been to join it, in metres,
    /// where both know their pose (the paper's section III.C.2).
    pub pose_radius_metres: f64,
}

impl Default for ClusterRules {
    fn default() -> Self {
        Self { min_samples: 20, held_out_share: 0.2, pose_radius_metres: 1.0 }
    }
}

/// An experience of a class.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Its number in the map.
    pub experience: ExperienceId,
    /// When it was seen.
    pub capture_nanos: i64,
    /// Difference hash of the frame; 0 if it has none.
    pub view: u64,
    /// Mean luminance of the frame, 0 to 255, where it is known.
    pub mean_luminance: Option<f32>,
    /// Whether it is of another place of the map, and joined since it was seen where the class is.
    pub is_joined: bool,
}

/// A place to be learnt.
#[derive(Clone, Debug, PartialEq)]
pub struct Class {
    /// Which of the maps it is of.
    pub map: usize,
    /// Its number there.
    pub place: PlaceId,
    /// Its name, if it has one.
    pub name: Option<String>,
    /// Numbers of the places next to it along the way, which may show the same at their borders.
    pub neighbours: Vec<PlaceId>,
    /// What is learnt, in the order of time.
    pub learnt: Vec<Sample>,
    /// What is not, later than all that is.
    pub held_out: Vec<Sample>,
}

/// A place with too few experiences to be learnt: a model is not to take it for any class.
#[derive(Clone, Debug, PartialEq)]
pub struct Stranger {
    /// Which of the maps it is of.
    pub map: usize,
    /// Numbers of the places within two steps along the way: it may have been founded where one of them was not
    /// recognised.
    pub near: Vec<PlaceId>,
    /// Its experiences that joined no class, in the order of time.
    pub samples: Vec<Sample>,
}

/// The classes that maps hold, and what was left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Clusters {
    /// The classes, by map and number.
    pub classes: Vec<Class>,
    /// Places with too few experiences.
    pub strangers: Vec<Stranger>,
    /// Experiences of every place that has any, the largest first: the paper's Fig. 2.
    pub sizes: Vec<usize>,
    /// Experiences that tell nothing that another one of their place does not.
    pub duplicates: usize,
    /// Experiences of small places that joined a class since they were seen where it is.
    pub joined_by_pose: usize,
    /// Experiences that cannot be read.
    pub unreadable: Vec<Unreadable>,
    /// Experiences whose map has no image of them any more: it was given up for damage.
    pub without_image: usize,
}

/// An experience that cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Unreadable {
    /// Which of the maps it is in.
    pub map: usize,
    /// Its number there.
    pub experience: ExperienceId,
}

/// A place's experiences that differ, in the order of time.
struct Cluster<'a> {
    place: &'a Place,
    samples: Vec<Sample>,
}

impl Clusters {
    /// The classes that `maps` hold by `rules`.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn of(maps: &[&PlaceMap], rules: &ClusterRules) -> Result<Self, MapError> {
        let mut clusters = Self::default();
        for (index, map) in maps.iter().enumerate() {
            clusters.add(index, map, rules)?;
        }
        clusters.sizes.sort_unstable_by_key(|&size| std::cmp::Reverse(size));
        Ok(clusters)
    }

    fn add(&mut self, index: usize, map: &PlaceMap, rules: &ClusterRules) -> Result<(), MapError> {
        let mut found = Vec::new();
        for place in map.places().filter(|place| !place.experiences.is_empty()) {
            self.sizes.push(place.experiences.len());
            found.push(Cluster { place, samples: self.samples((index, map), place)? });
        }
        let is_large = |cluster: &Cluster<'_>| cluster.samples.len() >= rules.min_samples.max(3);
        let (mut large, small): (Vec<_>, Vec<_>) = found.into_iter().partition(is_large);
        let joined = join_by_pose(map, &mut large, &small, rules.pose_radius_metres)?;
        self.joined_by_pose += joined.len();
        let ways = Ways::of(map);
        self.strangers.extend(small.into_iter().map(|Cluster { place, mut samples }| {
            samples.retain(|sample| !joined.contains(&sample.experience));
            Stranger { map: index, near: ways.within_two_steps(place.id), samples }
        }));
        self.classes.extend(large.into_iter().map(|Cluster { place, samples }| {
            let (learnt, held_out) = samples.split_at(border(&samples, rules.held_out_share));
            let (learnt, held_out) = (learnt.to_vec(), held_out.to_vec());
            let neighbours = ways.next_to(place.id).collect();
            let name = place.name.as_deref().map(str::to_owned);
            Class { map: index, place: place.id, name, neighbours, learnt, held_out }
        }));
        Ok(())
    }

    /// The experiences of a place that differ.
    fn samples(&mut self, (index, map): (usize, &PlaceMap), place: &Place) -> Result<Vec<Sample>, MapError> {
        let mut samples: Vec<Sample> = Vec::new();
        for experience in place.experiences.iter().filter_map(|&id| map.experience(id)) {
            match map.origin(experience.id) {
                Ok(origin) => samples.push(Sample::new(experience, origin.capture_nanos)),
                Err(error) if error.is_damage() => {
                    self.unreadable.push(Unreadable { map: index, experience: experience.id });
                }
                Err(error) => return Err(error),
            }
        }
        samples.sort_by_key(|sample| (sample.capture_nanos, sample.experience));
        let all = samples.len();
        let mut different: Vec<Sample> = Vec::new();
        for sample in samples {
            if !different.iter().any(|known| known.is_like(&sample)) {
                different.push(sample);
            }
        }
        self.duplicates += all - different.len();
        Ok(different)
    }
}

impl Clusters {
    /// Number of experiences of strangers.
    #[must_use]
    pub fn stranger_count(&self) -> usize {
        self.strangers.iter().map(|stranger| stranger.samples.len()).sum()
    }

    /// Whether a class, or a stranger, may show the same as a class, since they are one or near each other. Strangers
    /// are counted on from the last class.
    #[must_use]
    pub fn is_near(&self, one: usize, class: usize) -> bool {
        let Some(class) = self.classes.get(class) else { return false };
        match self.classes.get(one) {
            Some(one) => one.is_near(class),
            None => self.strangers.get(one - self.classes.len()).is_some_and(|one| one.is_near(class)),
        }
    }
}

impl Class {
    /// Whether `other` may show the same as this one, since they are one or next to each other.
    fn is_near(&self, other: &Self) -> bool {
        self.map == other.map && (self.place == other.place || self.neighbours.contains(&other.place))
    }
}

impl Stranger {
    /// Whether it may show the same as `class`.
    fn is_near(&self, class: &Class) -> bool {
        self.map == class.map && self.near.contains(&class.place)
    }
}

impl Sample {
    fn new(experience: &Experience, capture_nanos: i64) -> Self {
        let &Experience { id, view, mean_luminance, .. } = experience;
        Self { experience: id, capture_nanos, view, mean_luminance, is_joined: false }
    }

    /// Whether nothing can be learnt from the one that the other does not teach.
    fn is_like(&self, other: &Self) -> bool {
        let is_same_light = match (self.mean_luminance, other.mean_luminance) {
            (Some(one), Some(other)) => (one - other).abs() <= SAME_LIGHT,
            _ => false,
        };
        self.view != 0 && self.view == other.view && is_same_light
    }
}

/// How many of `samples`, in the order of time, are learnt: the others are a `share` of them at least, and begin with a
/// visit, so that no frame is held out whose neighbour is learnt; unless that would be most of them.
pub(super) fn border(samples: &[Sample], share: f64) -> usize {
    let count = samples.len();
    if count < 2 {
        return count;
    }
    let held_out = ((count as f64 * share.clamp(0.0, 1.0)).ceil() as usize).clamp(1, count - 1);
    let wanted = count - held_out;
    let begins_visit = |&at: &usize| {
        samples[at].capture_nanos.saturating_sub(samples[at - 1].capture_nanos) > VISIT_GAP_NANOS
    };
    (count.div_ceil(2)..=wanted).rev().find(begins_visit).unwrap_or(wanted)
}

/// Which places are next to each other along the way, whichever of them knows of it: a place remembers few.
struct Ways(BTreeMap<PlaceId, BTreeSet<PlaceId>>);

impl Ways {
    fn of(map: &PlaceMap) -> Self {
        let mut ways: BTreeMap<PlaceId, BTreeSet<PlaceId>> = BTreeMap::new();
        // Those that were merged into others remember their neighbours, too.
        for place in map.places() {
            let Some(here) = map.place(place.id).map(|place| place.id) else { continue };
            let neighbours = place.neighbours.iter().filter_map(|&id| Some(map.place(id)?.id));
            for there in neighbours.filter(|&there| there != here) {
                ways.entry(here).or_default().insert(there);
                ways.entry(there).or_default().insert(here);
            }
        }
        Self(ways)
    }

    fn next_to(&self, place: PlaceId) -> impl Iterator<Item = PlaceId> + use<'_> {
        self.0.get(&place).into_iter().flatten().copied()
    }

    fn within_two_steps(&self, place: PlaceId) -> Vec<PlaceId> {
        let near: BTreeSet<PlaceId> = self.next_to(place).collect();
        let beyond = near.iter().flat_map(|&next| self.next_to(next));
        near.iter().copied().chain(beyond).collect::<BTreeSet<_>>().into_iter().collect()
    }
}

/// Puts what was seen near a keyframe of a large cluster from the small ones there, too; answers what that is.
fn join_by_pose(
    map: &PlaceMap,
    large: &mut [Cluster<'_>],
    small: &[Cluster<'_>],
    radius_metres: f64,
) -> Result<BTreeSet<ExperienceId>, MapError> {
    let mut poses = Vec::new();
    for (index, cluster) in large.iter().enumerate() {
        for &id in &cluster.place.experiences {
            let is_keyframe = map.experience(id).is_some_and(|experience| experience.is_keyframe);
            if let Some(pose) = pose_of(map, id)?.filter(|_| is_keyframe) {
                poses.push((index, pose));
            }
        }
    }
    let (mut grown, mut joined) = (BTreeSet::new(), BTreeSet::new());
    if poses.is_empty() {
        return Ok(joined);
    }
    for sample in small.iter().flat_map(|cluster| &cluster.samples) {
        let Some(pose) = pose_of(map, sample.experience)? else { continue };
        let near = poses.iter().filter(|(_, known)| is_same_view(known, &pose, radius_metres));
        let nearest = near.min_by(|(_, a), (_, b)| distance(a, &pose).total_cmp(&distance(b, &pose)));
        if let Some(&(index, _)) = nearest {
            large[index].samples.push(Sample { is_joined: true, ..*sample });
            grown.insert(index);
            joined.insert(sample.experience);
        }
    }
    for index in grown {
        large[index].samples.sort_by_key(|sample| (sample.capture_nanos, sample.experience));
    }
    Ok(joined)
}

/// Where an experience was seen from; nothing if it does not know or cannot be read.
fn pose_of(map: &PlaceMap, id: ExperienceId) -> Result<Option<Pose>, MapError> {
    match map.origin(id) {
        Ok(origin) => Ok(origin.pose),
        Err(error) if error.is_damage() => Ok(None),
        Err(error) => Err(error),
    }
}

fn is_same_view(one: &Pose, other: &Pose, radius_metres: f64) -> bool {
    let cosine: f64 = one.orientation.iter().zip(other.orientation).map(|(a, b)| a * b).sum();
    let turn = 2.0 * cosine.abs().min(1.0).acos();
    distance(one, other) <= radius_metres && turn <= MOST_TURN
}

fn distance(one: &Pose, other: &Pose) -> f64 {
    one.position_metres.iter().zip(other.position_metres).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::Features;
    use crate::frame::Frame;
    use crate::place_map::{MapOptions, NewExperience, Traits};

    const SECOND: i64 = 1_000_000_000;

    /// What is learnt of a place: when, how it looks, and where it was seen.
    struct Look {
        seconds: i64,
        view: u64,
        position_metres: Option<[f64; 3]>,
    }

    fn learn(map: &mut PlaceMap, place: Option<PlaceId>, look: &Look) -> PlaceId {
        let orientation = [0.0, 0.0, 0.0, 1.0];
        let frame = Frame {
            capture_nanos: look.seconds * SECOND,
            pose: look.position_metres.map(|position_metres| Pose { position_metres, orientation }),
            ..Frame::numbered(0)
        };
        let (features, traits) = (Features::default(), Traits::default());
        let new = NewExperience {
            frame: &frame,
            view: look.view,
            mean_luminance: 100.0,
            thumbnail_jpeg: b"jpeg",
            keyframe: place.is_none().then_some((&features, &traits)),
        };
        map.learn(place, &new).unwrap().place
    }

    /// A place seen every second from `begin` on, so many times, each time differently.
    fn visited(map: &mut PlaceMap, place: Option<PlaceId>, begin: i64, count: i64) -> PlaceId {
        let look = |seconds| Look { seconds, view: 1 + seconds as u64, position_metres: None };
        let place = learn(map, place, &look(begin));
        (begin + 1..begin + count)
            .for_each(|seconds| assert_eq!(learn(map, Some(place), &look(seconds)), place));
        place
    }

    fn clusters(maps: &[&PlaceMap], min_samples: usize) -> Clusters {
        Clusters::of(maps, &ClusterRules { min_samples, ..ClusterRules::default() }).unwrap()
    }

    #[test]
    fn places_with_enough_experiences_are_the_classes_of_all_maps() {
        let [mut one, mut other] = [(); 2].map(|()| PlaceMap::in_memory(MapOptions::default()).unwrap());
        visited(&mut one, None, 0, 9);
        let hall = visited(&mut one, None, 100, 30);
        one.name_place(hall, "hall").unwrap();
        visited(&mut other, None, 0, 20);
        let found = clusters(&[&one, &other], 20);
        let classes: Vec<_> = found.classes.iter().map(|class| (class.map, class.place.0)).collect();
        assert_eq!(classes, [(0, 1), (1, 0)]);
        assert_eq!(found.classes[0].name.as_deref(), Some("hall"));
        assert_eq!((found.sizes, found.strangers.len()), (vec![30, 20, 9], 1));
    }

    #[test]
    fn the_latest_fifth_is_held_out_never_a_frame_from_among_those_that_are_learnt() {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        visited(&mut map, None, 0, 20);
        let found = clusters(&[&map], 20);
        let [class] = &found.classes[..] else { panic!("{found:?}") };
        assert_eq!((class.learnt.len(), class.held_out.len()), (16, 4));
        let latest_learnt = class.learnt.iter().map(|sample| sample.capture_nanos).max();
        assert!(class.held_out.iter().all(|sample| Some(sample.capture_nanos) > latest_learnt));
    }

    #[test]
    fn two_experiences_are_too_few_to_part_them_twice() {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        visited(&mut map, None, 0, 2);
        visited(&mut map, None, 100, 3);
        let found = clusters(&[&map], 1);
        let [class] = &found.classes[..] else { panic!("{found:?}") };
        assert_eq!((border(&class.learnt, 0.2), class.learnt.len(), class.held_out.len()), (1, 2, 1));
        assert_eq!((border(&class.held_out, 0.2), border(&[], 0.2)), (1, 0));
    }

    #[test]
    fn a_visit_is_held_out_whole_unless_it_is_most_of_the_place() {
        for (visits, learnt) in [(&[12, 8][..], 12), (&[14, 3, 3], 14), (&[4, 16], 16), (&[10, 5, 5], 15)] {
            let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
            let mut place = None;
            for (index, &count) in visits.iter().enumerate() {
                place = Some(visited(&mut map, place, 1000 * index as i64, count));
            }
            assert_eq!(clusters(&[&map], 20).classes[0].learnt.len(), learnt, "{visits:?}");
        }
    }

    #[test]
    fn what_looks_the_same_counts_once() {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        let place = visited(&mut map, None, 0, 20);
        for seconds in 0..10 {
            learn(&mut map, Some(place), &Look { seconds: 50 + seconds, view: 3, position_metres: None });
        }
        let found = clusters(&[&map], 20);
        assert_eq!((found.duplicates, found.classes[0].learnt.len()), (10, 16));
        assert!(clusters(&[&map], 21).classes.is_empty());
    }

    #[test]
    fn poses_pull_experiences_of_small_places_into_the_class_that_is_there() {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        let at = |x: f64, seconds: i64| Look {
            seconds,
            view: 1 + seconds as u64,
            position_metres: Some([x, 0.0, 0.0]),
        };
        let dock = learn(&mut map, None, &at(0.0, 0));
        (1..20).for_each(|seconds| assert_eq!(learn(&mut map, Some(dock), &at(0.0, seconds)), dock));
        for (x, seconds) in [(0.5, 100), (0.9, 101), (3.0, 102)] {
            learn(&mut map, None, &at(x, seconds));
        }
        let found = clusters(&[&map], 20);
        assert_eq!((found.joined_by_pose, found.strangers.len(), found.classes.len()), (2, 3, 1));
        let strange: Vec<usize> = found.strangers.iter().map(|one| one.samples.len()).collect();
        assert_eq!(strange, [0, 0, 1], "what joined a class is no stranger to it");
        assert_eq!(found.classes[0].learnt.len() + found.classes[0].held_out.len(), 22);
        let rules = ClusterRules { pose_radius_metres: 0.6, ..ClusterRules::default() };
        assert_eq!(Clusters::of(&[&map], &rules).unwrap().joined_by_pose, 1);
    }

    #[test]
    fn places_two_steps_along_the_way_are_near_to_a_stranger_and_only_the_next_ones_to_a_class() {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        // One after the other along the way; the fourth and the last are small.
        for (index, count) in [20, 20, 20, 2, 20, 2].into_iter().enumerate() {
            visited(&mut map, None, 100 * index as i64, count);
        }
        let found = clusters(&[&map, &map], 20);
        assert_eq!((found.classes.len(), found.strangers.len()), (8, 4));
        let near_to =
            |number: usize| -> Vec<usize> { (0..8).filter(|&class| found.is_near(number, class)).collect() };
        assert_eq!([0, 1, 2, 3].map(near_to), [vec![0, 1], vec![0, 1, 2], vec![1, 2], vec![3]]);
        assert_eq!([8, 9, 10].map(near_to), [vec![1, 2, 3], vec![3], vec![5, 6, 7]]);
        assert!(!found.is_near(0, 8) && !found.is_near(99, 0));
    }

    #[test]
    fn a_place_is_next_to_what_was_next_to_those_that_became_part_of_it() {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        let places: Vec<PlaceId> = (0..4).map(|index| visited(&mut map, None, 100 * index, 20)).collect();
        map.merge_places(places[1], places[3]).unwrap();
        let found = clusters(&[&map], 20);
        let next: Vec<_> =
            found.classes.iter().map(|class| (class.place.0, class.neighbours.clone())).collect();
        let [first, _, third, last] = places[..] else { panic!("{places:?}") };
        assert_eq!(next, [(0, vec![last]), (2, vec![last]), (3, vec![first, third])]);
    }

    #[test]
    fn a_view_to_the_other_side_is_another_view() {
        let pose = |orientation| Pose { position_metres: [0.0; 3], orientation };
        let ahead = pose([0.0, 0.0, 0.0, 1.0]);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!(is_same_view(&ahead, &pose([0.0, 0.0, 0.2, 0.98]), 1.0));
        assert!(is_same_view(&ahead, &pose([0.0, 0.0, 0.0, -1.0]), 1.0), "the same turn written otherwise");
        assert!(!is_same_view(&ahead, &pose([0.0, 0.0, half, half]), 1.0));
        assert!(!is_same_view(&ahead, &pose([0.0, 0.0, 1.0, 0.0]), 1.0));
    }
}
