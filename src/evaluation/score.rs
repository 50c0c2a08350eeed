//! Figures, counted from judged answers. What each means stands in
//! [`DEFINITIONS`](super::definitions::DEFINITIONS).

use super::ground_truth::Relation;
use super::judgement::{Asked, Judged};
use super::metrics::{self, Calibration, Guess, PrecisionRecall};
use super::results::{Confusion, Figures};
use crate::proportion::Proportion;

/// The figures of one method on one query traverse, with the curves behind them.
pub struct Score {
    /// The figures.
    pub figures: Figures,
    /// Precision and recall at every threshold.
    pub precision_recall: PrecisionRecall,
    /// Confidence against how often the answer is right.
    pub calibration: Calibration,
}

fn share(
    judged: &[Judged],
    of: impl Fn(&Judged) -> bool,
    which: impl Fn(&Judged) -> bool,
) -> Option<Proportion> {
    let whole = judged.iter().filter(|judged| of(judged));
    let (mut n, mut successes) = (0, 0);
    for judged in whole {
        n += 1;
        successes += u64::from(which(judged));
    }
    Proportion::new(successes, n)
}

fn is_right(judged: &Judged) -> bool {
    judged.is_given && judged.best == Relation::Same
}

/// Scores judged answers.
#[must_use]
pub fn score(judged: &[Judged]) -> Score {
    let known = |judged: &Judged| judged.is_known;
    // Where nothing is said of the best candidate, it is neither right nor wrong; not to answer is still right
    // for an unknown frame and wrong for a known one.
    let is_unjudged = |judged: &&Judged| judged.is_given && judged.best == Relation::Unsaid;
    let said: Vec<&Judged> = judged.iter().filter(|judged| judged.best != Relation::Unsaid).collect();
    let guesses: Vec<Guess> = said
        .iter()
        .filter(|judged| judged.confidence > 0.0)
        .map(|judged| Guess { score: judged.confidence, is_right: judged.best == Relation::Same })
        .collect();
    let known_count = judged.iter().filter(|judged| judged.is_known).count() as u64;
    let confidences: Vec<(f64, bool)> = guesses.iter().map(|guess| (guess.score, guess.is_right)).collect();
    let probabilities = |of_known: bool| -> Vec<f64> {
        let judged = judged.iter().filter(|judged| !is_unjudged(judged) && judged.is_known == of_known);
        judged.map(|judged| judged.confidence).collect()
    };
    let ranks: Vec<Option<usize>> =
        judged.iter().filter(|judged| judged.is_known).map(|judged| judged.rank).collect();
    // Where no frame is known no answer can be right: shares of right answers would measure nothing.
    let can_be_right = known_count > 0;
    let figures = Figures {
        recognition_rate: share(
            judged,
            |judged| can_be_right && matches!(judged.asked, Asked::Query(_)),
            is_right,
        ),
        precision: share(
            judged,
            |judged| can_be_right && judged.is_given && judged.best != Relation::Unsaid,
            is_right,
        ),
        recall: share(judged, known, is_right),
        keyframe_precision: share(
            judged,
            |judged| can_be_right && judged.is_given && judged.best_keyframe != Relation::Unsaid,
            |judged| judged.best_keyframe == Relation::Same,
        ),
        recall_at_1: metrics::recall_at(&ranks, 1),
        recall_at_5: metrics::recall_at(&ranks, 5),
        recall_at_10: metrics::recall_at(&ranks, 10),
        auc: metrics::average_precision(&guesses, known_count),
        recall_at_full_precision: metrics::recall_at_full_precision(&guesses, known_count),
        false_accepts: share(
            judged,
            |judged| !judged.is_known && !is_unjudged(&judged),
            |judged| judged.is_given,
        ),
        unjudged_answers: Some(judged.iter().filter(is_unjudged).count() as u64),
        auroc: metrics::auroc(&probabilities(true), &probabilities(false)),
        expected_calibration_error: metrics::expected_calibration_error(&confidences)
            .filter(|_| can_be_right),
        ..Figures::default()
    };
    Score {
        figures,
        precision_recall: PrecisionRecall::new(&guesses, known_count),
        calibration: Calibration::new(&confidences),
    }
}

/// Which true place was taken for which. `answered` has, for every answer given, the label of the query's
/// true place (`None` if the reference does not show it), that of the place named, and whether it is right.
#[must_use]
pub fn confusion(
    true_places: u32,
    answered: impl IntoIterator<Item = (Option<u32>, u32, bool)>,
) -> Confusion {
    let mut counts = std::collections::BTreeMap::new();
    let (mut of_unknown, mut near_misses) = (0, 0);
    for (row, column, is_right) in answered {
        match row {
            None => of_unknown += 1,
            Some(row) if row == column && !is_right => near_misses += 1,
            Some(row) => *counts.entry((row, column)).or_insert(0) += 1,
        }
    }
    let cells = counts.into_iter().map(|((row, column), n)| (row, column, n)).collect();
    Confusion { true_places, cells, of_unknown, near_misses }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(
        is_known: bool,
        is_given: bool,
        confidence: f64,
        best: Relation,
        rank: Option<usize>,
    ) -> Judged {
        Judged { asked: Asked::Query(0), is_known, is_given, confidence, best, best_keyframe: best, rank }
    }

    /// Six frames, four of them known: two named rightly, one named wrongly, one not named; of the two
    /// unknown ones one is named.
    fn worked_case() -> Vec<Judged> {
        use Relation::{Different, Same};
        vec![
            judged(true, true, 0.95, Same, Some(0)),
            judged(true, true, 0.90, Same, Some(0)),
            judged(true, true, 0.92, Different, Some(3)),
            judged(true, false, 0.30, Same, Some(0)),
            judged(false, true, 0.91, Different, None),
            judged(false, false, 0.10, Different, None),
        ]
    }

    fn rate(proportion: Option<Proportion>) -> (u64, u64) {
        let proportion = proportion.unwrap();
        (proportion.successes, proportion.n)
    }

    #[test]
    fn every_figure_of_a_hand_worked_case_is_as_counted_by_hand() {
        let figures = score(&worked_case()).figures;
        assert_eq!(rate(figures.recognition_rate), (2, 6));
        assert_eq!(rate(figures.precision), (2, 4));
        assert_eq!(rate(figures.recall), (2, 4));
        assert_eq!(rate(figures.recall_at_1), (3, 4));
        assert_eq!(rate(figures.recall_at_5), (4, 4));
        assert_eq!(rate(figures.false_accepts), (1, 2));
        // Only 0.95 stands above the best wrong one, 0.92.
        assert_eq!(rate(figures.recall_at_full_precision), (1, 4));
        // Pairs (known, unknown): 0.95, 0.90, 0.92, 0.30 against 0.91 and 0.10: 2 + 4 of 8.
        assert!((figures.auroc.unwrap().value - 6.0 / 8.0).abs() < 1e-12);
        // Ranked: 0.95 right, 0.92 wrong, 0.91 wrong, 0.90 right, 0.30 right, 0.10 wrong; over 4 known:
        // (1/1 + 2/4 + 3/5) / 4.
        assert!((figures.auc.unwrap().value - (1.0 + 0.5 + 0.6) / 4.0).abs() < 1e-12);
    }

    #[test]
    fn an_answer_of_which_nothing_is_said_is_neither_right_nor_wrong() {
        let mut case = worked_case();
        case.push(judged(true, true, 0.99, Relation::Unsaid, None));
        let figures = score(&case).figures;
        assert_eq!(rate(figures.precision), (2, 4));
        assert_eq!(rate(figures.recall), (2, 5), "but the frame is known, and its place was not named");
        assert_eq!(rate(figures.recall_at_full_precision), (1, 5));
        assert_eq!(figures.unjudged_answers, Some(1));
    }

    #[test]
    fn an_unknown_frame_without_an_answer_was_refused_rightly_whatever_its_best_candidate() {
        let unknown = |is_given, best| judged(false, is_given, 0.4, best, None);
        let mut case = worked_case();
        case.extend([unknown(false, Relation::Unsaid), unknown(true, Relation::Unsaid)]);
        let figures = score(&case).figures;
        assert_eq!(rate(figures.false_accepts), (1, 3), "of an answer that cannot be judged nothing is said");
        assert_eq!(figures.unjudged_answers, Some(1));
        // The pairs of the worked case and 0.95, 0.90, 0.92 > 0.4 > 0.30: 6 + 3 of 12.
        assert!((figures.auroc.unwrap().value - 9.0 / 12.0).abs() < 1e-12);
    }

    #[test]
    fn where_no_frame_is_known_only_false_accepts_are_counted() {
        let unknown = |is_given| judged(false, is_given, 0.5, Relation::Different, None);
        let figures = score(&[unknown(true), unknown(false)]).figures;
        assert_eq!(rate(figures.false_accepts), (1, 2));
        assert!(figures.recognition_rate.is_none() && figures.precision.is_none());
        assert!(figures.keyframe_precision.is_none() && figures.recall.is_none());
        assert!(figures.expected_calibration_error.is_none());
    }

    #[test]
    fn without_answers_there_are_no_figures_rather_than_zeros() {
        let figures = score(&[]).figures;
        assert!(figures.precision.is_none() && figures.recall.is_none() && figures.auroc.is_none());
    }

    #[test]
    fn confusions_are_counted_a_cell() {
        let right = (Some(0), 0, true);
        let answered = [right, (Some(0), 2, false), (None, 1, false), right, (Some(1), 1, false)];
        let confusion = confusion(3, answered);
        assert_eq!(confusion.cells, [(0, 0, 2), (0, 2, 1)]);
        assert_eq!(
            (confusion.of_unknown, confusion.near_misses),
            (1, 1),
            "of unknown places, and too far off"
        );
    }
}
