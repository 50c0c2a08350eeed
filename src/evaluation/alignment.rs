//! Does the ground truth fit the frames? A ground truth that is off by a frame or more still gives
//! figures, only worse ones; it fits better once it is moved back.

use super::answer::Answer;
use super::ground_truth::Relation;
use super::judgement::Search;
use crate::proportion::Proportion;

/// Largest shift that is tried, in frames.
const MAX_SHIFT: i64 = 5;

/// A warning, if the given answers fit the ground truth clearly better once it is moved by a few frames.
/// Tolerances wider than the shift hide it.
#[must_use]
pub fn misalignment(search: &Search<'_>, answers: &[Answer]) -> Option<String> {
    let right = |frames: i64| -> Option<Proportion> {
        let (mut n, mut right) = (0, 0);
        for (query, answer) in answers.iter().enumerate().filter(|(_, answer)| answer.is_given) {
            let Some(best) = answer.candidates.first() else { continue };
            let shifted = i64::try_from(best.reference).ok().and_then(|frame| frame.checked_add(frames));
            let shifted = shifted.and_then(|frame| usize::try_from(frame).ok());
            // What comes too late to be found would agree with itself.
            let Some(shifted) = shifted.filter(|&frame| frame < search.horizon(query)) else { continue };
            match search.truth.relation(query, shifted) {
                Relation::Same => (n, right) = (n + 1, right + 1),
                Relation::Different => n += 1,
                Relation::Unsaid => {}
            }
        }
        Proportion::new(right, n)
    };
    let as_is = right(0)?;
    let shifts = (-MAX_SHIFT..=MAX_SHIFT).filter(|&frames| frames != 0);
    let best = shifts
        .filter_map(|frames| Some((frames, right(frames)?)))
        .max_by(|a, b| a.1.rate.total_cmp(&b.1.rate).then(b.0.abs().cmp(&a.0.abs())))?;
    (best.1.low > as_is.high).then(|| {
        format!(
            "the ground truth looks shifted: {:.0} % of the answers agree with it as it is, {:.0} % if reference \
             frames are counted {:+} further; check how it numbers frames",
            100.0 * as_is.rate,
            100.0 * best.1.rate,
            best.0
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::answer::Candidate;
    use crate::evaluation::ground_truth::{GroundTruth, Rule};

    fn truth(offset: u32) -> GroundTruth {
        let matches = (0..60).map(|query| Some(vec![query + offset])).collect();
        let rule = Rule::Pairs { matches, unsaid: Vec::new() };
        GroundTruth { definition: String::new(), sha256: None, rule }
    }

    /// Answers that name, for every query frame, the reference frame of the same number.
    fn answers() -> Vec<Answer> {
        let answer = |reference| Answer {
            candidates: vec![Candidate { reference, place: None, probability: 0.9, reason: String::new() }],
            confidence: 0.9,
            is_given: true,
        };
        (0..60).map(answer).collect()
    }

    #[test]
    fn a_ground_truth_that_is_off_by_one_is_noticed_and_a_right_one_is_not() {
        let warning = |offset| {
            let truth = truth(offset);
            misalignment(&Search { truth: &truth, horizons: &[70; 60] }, &answers())
        };
        assert_eq!(warning(0), None);
        let off_by_one = warning(1).expect("off by one");
        assert!(off_by_one.contains("counted +1 further"), "{off_by_one}");
    }
}
