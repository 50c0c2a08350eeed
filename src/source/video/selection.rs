//! Which frames of a video are handed out, said to ffmpeg and to ourselves.
//!
//! ffmpeg sends the frames `first, first + step, … ≤ last`; turning others into RGB would be for nothing.
//! A list of frames rarely is such a progression, and a list as long as a video does not fit into an
//! argument: the tightest progression around it is sent, and what was not asked for is dropped here.

/// A choice of frames by index.
#[derive(Debug)]
pub(super) struct Selection {
    first: u64,
    last: u64,
    step: u64,
    /// Exactly these, ascending; without them everything that is sent.
    wanted: Option<Vec<u64>>,
}

impl Selection {
    /// Every `interval`-th frame.
    pub(super) fn every(interval: u64) -> Self {
        Self { first: 0, last: u64::MAX, step: interval.max(1), wanted: None }
    }

    /// Exactly `frames`; `None` unless they ascend.
    pub(super) fn exactly(frames: Vec<u64>) -> Option<Self> {
        let ascends = frames.windows(2).all(|pair| pair[0] < pair[1]);
        let first = frames.first().copied().unwrap_or_default();
        let last = frames.last().copied().unwrap_or_default();
        let step = frames.iter().fold(0, |step, frame| greatest_common_divisor(step, frame.abs_diff(first)));
        ascends.then_some(Self { first, last, step: step.max(1), wanted: Some(frames) })
    }

    /// The expression for ffmpeg's filter `select`, true for the frames that are sent.
    pub(super) fn expression(&self) -> String {
        let Self { first, last, step, .. } = self;
        format!("between(n,{first},{last})*not(mod(n-{first},{step}))")
    }

    /// Whether ffmpeg sends the frame `index`.
    pub(super) fn is_sent(&self, index: u64) -> bool {
        (self.first..=self.last).contains(&index) && (index - self.first).is_multiple_of(self.step)
    }

    /// Whether the frame `index`, which was sent, is handed out.
    pub(super) fn is_wanted(&self, index: u64) -> bool {
        self.wanted.as_ref().is_none_or(|wanted| wanted.binary_search(&index).is_ok())
    }

    /// How many of `frame_count` frames are handed out.
    pub(super) fn count(&self, frame_count: Option<u64>) -> Option<u64> {
        match &self.wanted {
            Some(wanted) => Some(wanted.len() as u64),
            None => frame_count.map(|count| count.div_ceil(self.step)),
        }
    }

    /// Whether nothing is wanted from `index` on.
    pub(super) fn is_over(&self, index: u64) -> bool {
        self.wanted.as_ref().is_some_and(|wanted| wanted.last().is_none_or(|&last| last < index))
    }

    /// The first frame that was asked for and that a video of `frame_count` frames lacks.
    pub(super) fn first_missing(&self, frame_count: u64) -> Option<u64> {
        self.wanted.as_ref()?.iter().copied().find(|&frame| frame >= frame_count)
    }
}

fn greatest_common_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn all_frames_of_a_list_and_no_others_are_handed_out(
            frames in prop::collection::btree_set(0_u64..300, 0..20),
        ) {
            let frames: Vec<u64> = frames.into_iter().collect();
            let selection = Selection::exactly(frames.clone()).unwrap();
            let handed_out: Vec<u64> =
                (0..300).filter(|&index| selection.is_sent(index) && selection.is_wanted(index)).collect();
            prop_assert_eq!(handed_out, frames);
        }
    }

    #[test]
    fn an_even_list_is_sent_without_waste() {
        let selection = Selection::exactly(vec![3, 10, 24]).unwrap();
        assert_eq!(selection.expression(), "between(n,3,24)*not(mod(n-3,7))");
        assert_eq!((0..40).filter(|&index| selection.is_sent(index)).collect::<Vec<_>>(), [3, 10, 17, 24]);
        assert_eq!((selection.is_over(24), selection.is_over(25)), (false, true));
        assert_eq!((selection.first_missing(25), selection.first_missing(20)), (None, Some(24)));
    }

    #[test]
    fn a_list_that_does_not_ascend_is_refused() {
        assert!(Selection::exactly(vec![3, 3]).is_none());
        assert!(Selection::exactly(vec![3, 2]).is_none());
        assert!(Selection::exactly(vec![]).unwrap().is_over(0));
    }

    #[test]
    fn every_third_of_ten_frames_makes_four() {
        let selection = Selection::every(3);
        assert_eq!((0..10).filter(|&index| selection.is_sent(index)).collect::<Vec<_>>(), [0, 3, 6, 9]);
        assert_eq!((selection.count(Some(10)), selection.count(None)), (Some(4), None));
        assert_eq!(Selection::every(0).step, 1);
    }
}
