"""Writes scikit_learn.json: what scikit-learn (and SciPy, for Wilson's interval) say of a few small cases.

    pip install scikit-learn==1.9.1 && python make.py

The unit tests of src/evaluation/metrics compare themselves with it.
"""

import json
import pathlib
import warnings

import numpy as np
import scipy
import sklearn
from scipy.stats import binomtest
from sklearn.calibration import calibration_curve
from sklearn.metrics import average_precision_score, precision_recall_curve, roc_auc_score

BINS = 10
# Successes and trials.
SHARES = [(0, 1), (1, 1), (8, 10), (0, 10), (37, 400), (1999, 2000)]


def drawn(seed, count, digits):
    """Labels, and scores that tell something about them, rounded so that some are equal."""
    random = np.random.default_rng(seed)
    labels = random.random(count) < 0.6
    scores = np.clip(random.normal(0.35 + 0.3 * labels, 0.2), 0, 1).round(digits)
    return labels, scores


def cases():
    yield "no ties", *drawn(1, 60, 6)
    yield "many ties", *drawn(2, 60, 1)
    yield "some ties", *drawn(3, 60, 2)
    yield "every border", np.arange(22) % 3 > 0, np.repeat(np.arange(11) / 10, 2)
    yield "next to every border", np.arange(18) % 4 > 0, np.repeat(np.arange(1, 10) / 10, 2) + np.tile([-1e-9, 1e-9], 9)
    yield "all equal", np.arange(8) % 2 > 0, np.full(8, 0.5)
    labels, scores = drawn(4, 12, 2)
    yield "all right", np.ones_like(labels), scores
    yield "wrong way round", ~labels, scores
    yield "one", np.array([True]), np.array([0.7])
    yield "one of each", np.array([True, False]), np.array([0.4, 0.4])


def calibration(labels, scores):
    """The curve, and from it the expected calibration error; the curve itself leaves out how full bins are."""
    accuracies, confidences = calibration_curve(labels, scores, n_bins=BINS)
    # The bins of scikit-learn's own source.
    bins = np.searchsorted(np.linspace(0, 1, BINS + 1)[1:-1], scores)
    counts = np.bincount(bins, minlength=BINS)
    filled = counts[counts > 0]
    assert np.isclose((filled * accuracies).sum(), labels.sum())
    assert np.isclose((filled * confidences).sum(), scores.sum())
    error = (filled / filled.sum() * np.abs(accuracies - confidences)).sum()
    return {
        "calibration_curve": {"prob_true": accuracies.tolist(), "prob_pred": confidences.tolist()},
        "bin_counts": counts.tolist(),
        "expected_calibration_error": float(error),
    }


def case(name, labels, scores):
    precisions, recalls, thresholds = precision_recall_curve(labels, scores)
    has_both = labels.any() and not labels.all()
    return {
        "name": name,
        "labels": labels.tolist(),
        "scores": scores.tolist(),
        "average_precision_score": float(average_precision_score(labels, scores)),
        "roc_auc_score": float(roc_auc_score(labels, scores)) if has_both else None,
        "precision_recall_curve": {
            "precision": precisions.tolist(),
            "recall": recalls.tolist(),
            "thresholds": thresholds.tolist(),
        },
        **calibration(labels, scores),
    }


def wilson(successes, n):
    interval = binomtest(successes, n).proportion_ci(confidence_level=0.95, method="wilson")
    return {"successes": successes, "n": n, "low": float(interval.low), "high": float(interval.high)}


def main():
    warnings.simplefilter("error")
    header = {
        "command": "python make.py",
        "scikit_learn": sklearn.__version__,
        "scipy": scipy.__version__,
        "numpy": np.__version__,
    }
    lists = {"cases": [case(*values) for values in cases()], "wilson": [wilson(*of) for of in SHARES]}
    # One case a line, so that a change of one shows as such.
    lines = [f'"{key}": {json.dumps(value)},' for key, value in header.items()]
    for key, entries in lists.items():
        lines.append(f'"{key}": [\n  ' + ",\n  ".join(map(json.dumps, entries)) + "\n ],")
    text = "{\n " + "\n ".join(lines).removesuffix(",") + "\n}\n"
    json.loads(text)
    pathlib.Path(__file__).with_name("scikit_learn.json").write_text(text)


if __name__ == "__main__":
    main()
