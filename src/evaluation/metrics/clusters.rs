//! How well the places that were founded match the places that are there.
//!
//! The ground truth says of two frames whether they show the same place: yes, no, or (`None`) nothing. That
//! relation need not be transitive: along a road each frame may show the place of the next.

use crate::proportion::Proportion;

/// Share of the members of `clusters` that show the same place as the most typical member of theirs: the
/// one with which most, itself included, show the same place.
///
/// Members of whom the ground truth knows nothing (`same_place(m, m)` is `None`), or nothing about them and
/// the typical one, are left out; of equally typical members the one with more left in is taken. `None`
/// where nobody is left.
#[must_use]
pub fn purity(
    clusters: &[Vec<usize>],
    same_place: impl Fn(usize, usize) -> Option<bool>,
) -> Option<Proportion> {
    let (mut pure, mut related) = (0, 0);
    for cluster in clusters {
        let members: Vec<usize> =
            cluster.iter().copied().filter(|&member| same_place(member, member).is_some()).collect();
        let around = |&centre: &usize| {
            let relations = members.iter().filter_map(|&member| same_place(centre, member));
            relations.fold((0, 0), |(same, all), is_same| (same + u64::from(is_same), all + 1))
        };
        let (same, all) = members.iter().map(around).max().unwrap_or((0, 0));
        pure += same;
        related += all;
    }
    Proportion::new(pure, related)
}

/// Share of the members of `clusters`, but for those that founded them, that are `apart` from every member before them:
/// places that were merged though they are two.
///
/// Only members count of whom and of one before them the ground truth says whether they are. `None` where there are
/// none.
#[must_use]
pub fn false_merges(
    clusters: &[Vec<usize>],
    apart: impl Fn(usize, usize) -> Option<bool>,
) -> Option<Proportion> {
    let (mut wrong, mut joined) = (0, 0);
    for cluster in clusters {
        for (position, &member) in cluster.iter().enumerate() {
            let said = cluster[..position].iter().filter_map(|&before| apart(member, before));
            let is_apart = said.reduce(|all, is_apart| all && is_apart);
            joined += u64::from(is_apart.is_some());
            wrong += u64::from(is_apart == Some(true));
        }
    }
    Proportion::new(wrong, joined)
}

/// Labels each of `frames` frames with its true place, counted from 0 in order of first appearance; `None`
/// where the ground truth knows nothing of it (`same_place(i, i)` is `None`).
///
/// A greedy cover: walked in order, a frame belongs to the first centre that shows the same place, and is a
/// new centre if none does.
#[must_use]
pub fn true_places(frames: usize, same_place: impl Fn(usize, usize) -> Option<bool>) -> Vec<Option<u32>> {
    let mut centres: Vec<usize> = Vec::new();
    let mut place_of = |frame: usize| {
        same_place(frame, frame)?;
        let known = centres.iter().position(|&centre| same_place(frame, centre) == Some(true));
        let place = known.unwrap_or_else(|| {
            centres.push(frame);
            centres.len() - 1
        });
        u32::try_from(place).ok()
    };
    (0..frames).map(&mut place_of).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Frames on a road at whole metres; those at most 2 m apart show the same place.
    fn within_2_m(metres: &[Option<i32>]) -> impl Fn(usize, usize) -> Option<bool> + '_ {
        |a, b| Some((metres[a]? - metres[b]?).abs() <= 2)
    }

    #[test]
    fn a_frame_is_merged_falsely_if_none_before_it_in_its_place_shows_what_it_shows() {
        let metres = [Some(0), Some(1), Some(3), Some(40), Some(41), None];
        let apart = |a, b| within_2_m(&metres)(a, b).map(|is_same| !is_same);
        let of = |clusters: &[Vec<usize>]| counts(false_merges(clusters, apart));
        assert_eq!(of(&[vec![0, 1, 2]]), (0, 2), "a place may reach farther than two frames see");
        assert_eq!(of(&[vec![0, 3, 4, 1]]), (1, 3), "the first brought the other place in");
        assert_eq!(
            of(&[vec![0, 5], vec![3, 5, 4]]),
            (0, 1),
            "nothing is known of the frame without a position"
        );
        assert_eq!(false_merges(&[vec![0], vec![]], apart), None);
    }

    fn counts(proportion: Option<Proportion>) -> (u64, u64) {
        proportion.map(|proportion| (proportion.successes, proportion.n)).unwrap()
    }

    /// By scoring every member on its own.
    fn purity_oracle(clusters: &[Vec<usize>], metres: &[Option<i32>]) -> (u64, u64) {
        let (mut pure, mut all) = (0, 0);
        for cluster in clusters {
            let road: Vec<i32> = cluster.iter().filter_map(|&member| metres[member]).collect();
            let near = |x: i32| road.iter().filter(|&&other| (x - other).abs() <= 2).count() as u64;
            pure += road.iter().map(|&x| near(x)).max().unwrap_or(0);
            all += road.len() as u64;
        }
        (pure, all)
    }

    fn road() -> impl Strategy<Value = Vec<Option<i32>>> {
        prop::collection::vec(prop::option::weighted(0.9, 0..20_i32), 1..30)
    }

    #[test]
    fn the_most_typical_member_speaks_for_its_cluster() {
        // First cluster: around 4 m are 2, 4, 6 m; around 2 or 6 m only two of them; 20 m is a stranger: 3 of
        // 4. Second: 30 and 33 m are apart: 1 of 2.
        let metres = [2, 4, 6, 20, 30, 33].map(Some);
        let clusters = [vec![0, 1, 2, 3], vec![4, 5]];
        assert_eq!(counts(purity(&clusters, within_2_m(&metres))), (4, 6));
    }

    #[test]
    fn members_of_whom_nothing_is_known_are_left_out() {
        let metres = [Some(0), None, Some(1), None];
        assert_eq!(counts(purity(&[vec![0, 1, 2], vec![3]], within_2_m(&metres))), (2, 2));
        assert_eq!(purity(&[vec![1, 3]], within_2_m(&metres)), None);
        assert_eq!(purity(&[], within_2_m(&metres)), None);
    }

    #[test]
    fn a_member_without_truth_of_its_own_is_left_out_whatever_others_say_of_it() {
        let relation = |a: usize, b: usize| (a != 1 || b != 1).then_some(a == b);
        assert_eq!(counts(purity(&[vec![0, 1]], relation)), (1, 1));
    }

    #[test]
    fn pairs_of_whom_nothing_is_known_are_left_out() {
        // Nothing is known of 0 and 2. Around 0: itself and 1. Around 1: all three. Around 2: itself and 1.
        let relation = |a: usize, b: usize| (a.abs_diff(b) < 2).then_some(true);
        assert_eq!(counts(purity(&[vec![0, 1, 2]], relation)), (3, 3));
        // Each shows a place of its own: around 0 and 2 there is one stranger, around 1 there are two.
        let apart = |a: usize, b: usize| (a.abs_diff(b) < 2).then_some(a == b);
        assert_eq!(counts(purity(&[vec![0, 1, 2]], apart)), (1, 3));
    }

    #[test]
    fn a_frame_belongs_to_the_first_centre_that_matches() {
        // Centres: 0 m, 3 m (3 m from 0), 10 m. The frame at 2 m matches 0 and 3 m; that at 5 m only 3 m.
        let metres = [0, 1, 3, 2, 5, 10, 0].map(Some);
        let places = true_places(7, within_2_m(&metres));
        assert_eq!(places, [0, 0, 1, 0, 1, 2, 0].map(Some));
    }

    #[test]
    fn a_frame_next_to_a_centre_founds_none_though_its_neighbour_may() {
        // 2 m joins 0 m; 4 m is near 2 m, which is no centre, and founds a place.
        assert_eq!(true_places(3, within_2_m(&[0, 2, 4].map(Some))), [Some(0), Some(0), Some(1)]);
    }

    #[test]
    fn frames_of_which_nothing_is_known_have_no_place() {
        let metres = [None, Some(0), None, Some(9)];
        assert_eq!(true_places(4, within_2_m(&metres)), [None, Some(0), None, Some(1)]);
        assert_eq!(true_places(0, within_2_m(&metres)), []);
    }

    #[test]
    fn a_frame_of_which_nothing_is_known_beside_a_centre_is_a_new_centre() {
        let relation = |a: usize, b: usize| (a == b).then_some(true);
        assert_eq!(true_places(2, relation), [Some(0), Some(1)]);
    }

    proptest! {
        #[test]
        fn purity_is_what_its_definition_says(road in road(), cut in 0_usize..30) {
            let cut = cut.min(road.len());
            let clusters = [(0..cut).collect(), (cut..road.len()).collect()];
            let expected = purity_oracle(&clusters, &road);
            let found = purity(&clusters, within_2_m(&road)).map_or((0, 0), |found| counts(Some(found)));
            prop_assert_eq!(found, expected);
        }

        #[test]
        fn the_order_of_members_does_not_matter(
            (road, members) in road().prop_flat_map(|road| {
                let members = Just((0..road.len()).collect::<Vec<_>>()).prop_shuffle();
                (Just(road), members)
            }),
        ) {
            let in_order = vec![(0..road.len()).collect()];
            prop_assert_eq!(purity(&in_order, within_2_m(&road)), purity(&[members], within_2_m(&road)));
        }

        #[test]
        fn every_frame_shows_the_place_of_its_centre_and_centres_differ(road in road()) {
            let places = true_places(road.len(), within_2_m(&road));
            let centre = |place: u32| places.iter().position(|&other| other == Some(place)).unwrap();
            let same = within_2_m(&road);
            for (frame, place) in places.iter().enumerate() {
                prop_assert_eq!(place.is_some(), road[frame].is_some());
                let Some(place) = *place else { continue };
                prop_assert_eq!(same(frame, centre(place)), Some(true));
                for earlier in 0..place {
                    prop_assert!(centre(earlier) < centre(place));
                    prop_assert_eq!(same(frame, centre(earlier)), Some(false));
                }
            }
        }
    }
}
