//! How high the true matches rank among the candidates: recall at N, no threshold.

use crate::proportion::Proportion;

/// Share of the known queries with a true match among their `depth` best candidates.
///
/// `ranks` holds, for each known query, the position from 0 of its first true match among the
/// candidates; `None` where none of them is one. `None` is returned where there are no known queries.
#[must_use]
pub fn recall_at(ranks: &[Option<usize>], depth: usize) -> Option<Proportion> {
    let found = ranks.iter().flatten().filter(|&&rank| rank < depth).count();
    Proportion::new(found as u64, ranks.len() as u64)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn successes(ranks: &[Option<usize>], depth: usize) -> (u64, u64) {
        let recall = recall_at(ranks, depth).unwrap();
        (recall.successes, recall.n)
    }

    #[test]
    fn an_off_by_one_in_the_depth_changes_recall() {
        // First true matches at positions 0, 4, 4, 5, 5, 5 and nowhere.
        let ranks = [Some(0), Some(4), Some(4), Some(5), Some(5), Some(5), None];
        assert_eq!(successes(&ranks, 4), (1, 7));
        assert_eq!(successes(&ranks, 5), (3, 7));
        assert_eq!(successes(&ranks, 6), (6, 7));
    }

    #[test]
    fn the_best_candidate_alone_counts_at_1() {
        let ranks = [Some(0), Some(1), Some(0), None];
        assert_eq!(successes(&ranks, 0), (0, 4));
        assert_eq!(successes(&ranks, 1), (2, 4));
        assert_eq!(recall_at(&ranks, 1).unwrap().rate, 0.5);
    }

    #[test]
    fn recall_of_no_known_queries_is_none() {
        assert_eq!(recall_at(&[], 1), None);
    }

    proptest! {
        #[test]
        fn recall_counts_the_queries_whose_list_holds_a_true_match(
            lists in prop::collection::vec(prop::collection::vec(any::<bool>(), 0..12), 1..20),
            depth in 0_usize..14,
        ) {
            let ranks: Vec<_> = lists.iter().map(|list| list.iter().position(|&is_true| is_true)).collect();
            let found = lists.iter().filter(|list| list.iter().take(depth).any(|&is_true| is_true)).count();
            prop_assert_eq!(successes(&ranks, depth), (found as u64, lists.len() as u64));
        }
    }
}
