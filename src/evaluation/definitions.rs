//! What each figure means, in the words that reports print.

/// Names and meanings of the [`Figures`](super::results::Figures). "Known" frames are the scored query
/// frames whose place the reference shows, "unknown" ones the rest; an answer is "given" at the shipped
/// threshold.
pub const DEFINITIONS: [(&str, &str); 17] = [
    (
        "recognition_rate",
        "scored query frames, known or not, whose place is named rightly / all scored query frames; \
         at the shipped threshold",
    ),
    ("precision", "right answers / answers given; at the shipped threshold"),
    ("recall", "known frames whose place is named rightly / known frames; at the shipped threshold"),
    (
        "keyframe_precision",
        "answers whose matched keyframe itself shows the same place / answers given; stricter than \
         precision where a place holds several keyframes",
    ),
    (
        "recall_at_1",
        "known frames whose best candidate (the accepted one, else the likeliest) shows the same place / known frames; \
         no threshold",
    ),
    (
        "recall_at_5",
        "known frames with a true match among the 5 best candidates / known frames; no threshold",
    ),
    (
        "recall_at_10",
        "known frames with a true match among the 10 best candidates / known frames; no threshold",
    ),
    (
        "auc",
        "area under the precision-recall curve by steps (average precision), best candidates ranked by \
         reported confidence, known and unknown frames together; 95 % bootstrap interval",
    ),
    (
        "recall_at_full_precision",
        "largest recall at a threshold without a wrong answer; the threshold is chosen with the answers \
         in hand",
    ),
    ("false_accepts", "unknown frames that were given an answer / unknown frames; at the shipped threshold"),
    (
        "unjudged_answers",
        "answers given of which the ground truth says nothing; they count in no share of right answers, and \
         those to unknown frames not in false accepts",
    ),
    (
        "auroc",
        "probability that a known frame's best candidate gets a higher confidence than an unknown \
         frame's; 95 % bootstrap interval",
    ),
    (
        "expected_calibration_error",
        "mean distance between the reported confidence that the best candidate is right and how often it is, \
         over ten bins weighted by their frames, known and unknown together; 95 % bootstrap interval",
    ),
    (
        "purity",
        "experiences of the reference that show the same place as the most typical one of their place / \
         experiences; not known where the ground truth lists pairs",
    ),
    (
        "false_merges",
        "experiences of the reference that are known to show another place than all before them in the place they \
         joined / experiences that joined a place and are placed by the ground truth; what follows the first of them \
         counts as right, so purity says how much is mixed",
    ),
    ("places_founded", "places that Loci founded on the reference"),
    (
        "true_places",
        "places that the reference truly shows: frames, walked in order, that are not the same place as \
         one chosen before; not known where the ground truth lists pairs",
    ),
];
