//! Correspondences between the features of two images.
//!
//! The paper pairs all features of the same visual word. Words flip at their borders, so that two
//! views of one place share few of them; this pairs features under the same vocabulary node near the
//! root instead (DBoW2's direct index) and keeps only the distinctive ones: nearest in Hamming
//! distance both ways, and clearly nearer than the second (Lowe's ratio test).

use crate::feature::{Descriptor, Features};
use crate::geometry::{OrientedPoint, Similarity};

/// The features of one image with the group (a vocabulary node) of each; only features of the same
/// group are compared.
#[derive(Clone, Copy)]
pub struct MatchingView<'a> {
    /// The features.
    pub features: &'a Features,
    /// Their groups, as long as the features.
    pub groups: &'a [u32],
}

/// Two features, one an image, taken for the same point of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correspondence {
    /// Index of the feature in the query image.
    pub query: u32,
    /// Index of the feature in the keyframe.
    pub keyframe: u32,
    /// Where it is in the query image.
    pub query_point: OrientedPoint,
    /// Where it is in the keyframe.
    pub keyframe_point: OrientedPoint,
}

impl Correspondence {
    /// The transform from the query image to the keyframe that it alone speaks for.
    #[must_use]
    pub fn transform(&self) -> Similarity {
        Similarity::between(self.query_point, self.keyframe_point)
    }
}

/// When two descriptors are taken for the same point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchingOptions {
    /// Largest Hamming distance in bits; default 64.
    pub max_distance_bits: u32,
    /// Largest ratio of the nearest distance to the second nearest; default 0.85.
    pub max_ratio: f32,
}

impl Default for MatchingOptions {
    fn default() -> Self {
        Self { max_distance_bits: 64, max_ratio: 0.85 }
    }
}

/// Pairs the features of two images after those of two others, and keeps its memory.
#[derive(Debug, Default)]
pub(super) struct Matcher {
    query_order: Vec<Member>,
    keyframe_order: Vec<Member>,
    pairs: Vec<(u32, u32)>,
}

/// A feature of a group. The number of the group has the higher bits, so that those of one stand side by side when they
/// are sorted, and that of the feature the lower ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Member(u64);

impl Member {
    fn new(group: u32, feature: u32) -> Self {
        Self(u64::from(group) << u32::BITS | u64::from(feature))
    }

    fn group(self) -> u32 {
        (self.0 >> u32::BITS) as u32
    }

    fn feature(self) -> u32 {
        self.0 as u32
    }
}

impl Matcher {
    /// Writes the one-to-one correspondences from `query` to `keyframe` over what is in `found`, in the order of the
    /// query's features.
    pub(super) fn pair(
        &mut self,
        (query, keyframe): (MatchingView<'_>, MatchingView<'_>),
        options: &MatchingOptions,
        found: &mut Vec<Correspondence>,
    ) {
        let Self { query_order, keyframe_order, pairs } = self;
        order_by_group(query.groups, query_order);
        order_by_group(keyframe.groups, keyframe_order);
        pairs.clear();
        for run in query_order.chunk_by(|a, b| a.group() == b.group()) {
            let candidates = run_of(keyframe_order, run[0].group());
            pairs.extend(run.iter().filter_map(|member| {
                let index = member.feature();
                let descriptor = &query.features.descriptors[index as usize];
                let found = distinctive_nearest(descriptor, candidates, keyframe.features, options)?;
                // The nearest the other way must lead back.
                let found_descriptor = &keyframe.features.descriptors[found as usize];
                let back = distinctive_nearest(found_descriptor, run, query.features, options)?;
                (back == index).then_some((index, found))
            }));
        }
        pairs.sort_unstable();
        found.clear();
        // As many as there can be, so that no later pair of such images needs more.
        found.reserve(query.groups.len().min(keyframe.groups.len()));
        found.extend(pairs.iter().map(|&(query_index, keyframe_index)| Correspondence {
            query: query_index,
            keyframe: keyframe_index,
            query_point: query.features.keypoints[query_index as usize].oriented_point(),
            keyframe_point: keyframe.features.keypoints[keyframe_index as usize].oriented_point(),
        }));
    }
}

fn order_by_group(groups: &[u32], order: &mut Vec<Member>) {
    order.clear();
    order.extend(groups.iter().zip(0..).map(|(&group, feature)| Member::new(group, feature)));
    order.sort_unstable();
}

fn run_of(order: &[Member], group: u32) -> &[Member] {
    let start = order.partition_point(|member| member.group() < group);
    let end = order.partition_point(|member| member.group() <= group);
    &order[start..end]
}

/// The candidate nearest to `descriptor`, if it is near enough and the second is clearly farther.
fn distinctive_nearest(
    descriptor: &Descriptor,
    candidates: &[Member],
    features: &Features,
    options: &MatchingOptions,
) -> Option<u32> {
    let (mut nearest, mut second) = ((u32::MAX, 0), u32::MAX);
    for index in candidates.iter().map(|member| member.feature()) {
        let distance = descriptor.distance(&features.descriptors[index as usize]);
        if distance < nearest.0 {
            second = nearest.0;
            nearest = (distance, index);
        } else {
            second = second.min(distance);
        }
    }
    let near = nearest.0 <= options.max_distance_bits;
    let distinctive = (nearest.0 as f32) < options.max_ratio * second as f32;
    (near && distinctive).then_some(nearest.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::Keypoint;
    use crate::geometry::Point;

    fn features(descriptors: &[[u8; 32]]) -> Features {
        let keypoint = Keypoint { point: Point::default(), scale: 1.0, angle_radians: 0.0, response: 9 };
        Features {
            width_px: 640,
            height_px: 480,
            keypoints: vec![keypoint; descriptors.len()],
            descriptors: descriptors.iter().copied().map(Descriptor).collect(),
        }
    }

    fn pairs(query: (&Features, &[u32]), keyframe: (&Features, &[u32])) -> Vec<(u32, u32)> {
        let view = |(features, groups)| MatchingView { features, groups };
        let mut found = Vec::new();
        let views = (view(query), view(keyframe));
        Matcher::default().pair(views, &MatchingOptions::default(), &mut found);
        found.iter().map(|pair| (pair.query, pair.keyframe)).collect()
    }

    #[test]
    fn alike_features_of_one_group_correspond_and_those_of_others_do_not() {
        let (zeros, ones) = ([0; 32], [255; 32]);
        let query = features(&[zeros, ones]);
        let keyframe = features(&[ones, zeros]);
        assert_eq!(pairs((&query, &[5, 5]), (&keyframe, &[5, 5])), [(0, 1), (1, 0)]);
        assert_eq!(pairs((&query, &[5, 6]), (&keyframe, &[5, 5])), [(0, 1)]);
        assert_eq!(pairs((&query, &[1, 1]), (&keyframe, &[2, 2])), []);
    }

    #[test]
    fn ambiguous_and_far_features_are_left_out() {
        let far: [u8; 32] = std::array::from_fn(|index| if index < 9 { 255 } else { 0 });
        let query = features(&[[0; 32]]);
        assert_eq!(pairs((&query, &[0]), (&features(&[[0; 32], [0; 32]]), &[0, 0])), [], "equal to both");
        let mut near = [0; 32];
        near[0] = 0b1111;
        let mut also_near = [0; 32];
        also_near[1] = 0b1111;
        assert_eq!(pairs((&query, &[0]), (&features(&[near, also_near]), &[0, 0])), [], "ambiguous");
        assert_eq!(pairs((&query, &[0]), (&features(&[far]), &[0])), [], "72 bits away");
    }

    #[test]
    fn no_feature_is_used_twice() {
        let (query, keyframe) = (features(&[[0; 32], [1; 32]]), features(&[[0; 32]]));
        assert_eq!(pairs((&query, &[0, 0]), (&keyframe, &[0])), [(0, 0)]);
    }
}
