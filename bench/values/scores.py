"""Scores and units, all computed from the predictions table of a run.

The table has one row per decision: ``fold``, ``capture``, ``start`` (first frame), ``frames`` (frames seen), ``true``,
one column ``p_<class>`` per class, and the columns of the corpus's captures (``subject`` and conditions). A system that
abstains gives 0 to every class. A capture without a probability is labelled `ABSTAINED`, which is wrong.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.corpora.corpus import PROBABILITY as PREFIX
from bench.corpora.corpus import RESERVED as RESERVED
from bench.values.intervals import ratio_interval, share_interval

ABSTAINED = ""  # the label of a system that abstains; no gesture is called so


def classes_of(predictions: pd.DataFrame) -> list[str]:
    """Class names, in the order of the probability columns."""
    return [c.removeprefix(PREFIX) for c in predictions.columns if c.startswith(PREFIX)]


def most_probable_labels(proba: np.ndarray, classes: list[str]) -> np.ndarray:
    """The label of each row of probabilities [decisions, classes]: a class, or `ABSTAINED` where all are 0."""
    return np.where(
        proba.max(axis=1) > 0, np.asarray(classes, dtype=object)[proba.argmax(axis=1)], ABSTAINED
    )


def label_windows(predictions: pd.DataFrame) -> pd.DataFrame:
    """The decisions themselves with their label in ``predicted``."""
    classes = classes_of(predictions)
    proba = predictions[[PREFIX + c for c in classes]].to_numpy()
    return predictions.assign(predicted=most_probable_labels(proba, classes))


def label_captures(predictions: pd.DataFrame, vote: bool = False) -> pd.DataFrame:
    """Score each tested capture: a row each, labelled by mean probability or by majority vote.

    A tied vote goes to the tied class with the highest mean probability.
    """
    classes = classes_of(predictions)
    columns = [PREFIX + c for c in classes]
    keys = ["fold", "capture"]
    score = predictions.groupby(keys, sort=False)[columns].mean()
    if vote:
        proba = predictions[columns].to_numpy()
        votes = np.eye(len(classes))[proba.argmax(axis=1)] * (proba.max(axis=1, keepdims=True) > 0)
        ballots = pd.DataFrame(votes, columns=columns)
        ballots[keys] = predictions[keys].to_numpy()
        score = (
            score + ballots.groupby(keys, sort=False)[columns].sum().to_numpy() * 2
        )  # means are at most 1
    rows = predictions.drop(columns=columns).drop_duplicates(keys, ignore_index=True)
    return rows.assign(predicted=most_probable_labels(score.to_numpy(), classes))


def accuracy_by_subject(labelled: pd.DataFrame) -> pd.DataFrame:
    """Accuracy and number of captures (or windows) of each subject."""
    hit = labelled["true"] == labelled["predicted"]
    return hit.groupby(labelled["subject"]).agg(accuracy="mean", n="size").reset_index()


def scores_by_class(labelled: pd.DataFrame, classes: list[str]) -> pd.DataFrame:
    """Precision, recall, F1 and support of each class; a class never predicted has precision 0."""
    from sklearn.metrics import precision_recall_fscore_support

    columns = precision_recall_fscore_support(
        labelled["true"], labelled["predicted"], labels=classes, zero_division=0
    )
    names = ("precision", "recall", "f1", "support")
    return pd.DataFrame({"gesture": classes} | dict(zip(names, columns, strict=True)))


def confusion_table(labelled: pd.DataFrame, classes: list[str]) -> pd.DataFrame:
    """Counts, rows are the true classes, columns the predicted ones, and ``(abstained)`` where a system did."""
    true, predicted = (
        pd.Index(classes).get_indexer(pd.Index(labelled[name])) for name in ("true", "predicted")
    )
    counts = np.zeros((len(classes), len(classes)), dtype=np.int64)
    known = (true >= 0) & (predicted >= 0)
    np.add.at(counts, (true[known], predicted[known]), 1)
    table = pd.DataFrame(counts, index=classes, columns=classes)
    if not (gone := labelled["predicted"] == ABSTAINED).any():
        return table
    without = labelled["true"][gone].value_counts().reindex(classes, fill_value=0)
    return pd.concat([table, without.rename("(abstained)")], axis=1)


def pooled_accuracy_interval(labelled: pd.DataFrame) -> tuple[float, float]:
    """95 % bootstrap interval of pooled accuracy over subjects; NaN for fewer than `bench.values.few.FEWEST_FOR_INTERVAL` of them."""
    hits = (
        (labelled["true"] == labelled["predicted"])
        .groupby(labelled["subject"])
        .agg(["sum", "size"])
        .to_numpy()
    )
    return ratio_interval(hits)


def mean_over_subjects(labelled: pd.DataFrame) -> dict[str, float]:
    """Mean over subjects of their accuracies, its 95 % t-interval (``low``, ``high``) and SD (``subject_sd``)."""
    each = accuracy_by_subject(labelled)["accuracy"]
    mean, sd = float(each.mean()), float(each.std(ddof=1))
    low, high = share_interval(mean, sd, len(each))
    return {"accuracy": mean, "low": low, "high": high, "subject_sd": sd}


def fold_accuracies(predictions: pd.DataFrame) -> dict[str, float]:
    """Accuracy of captures, and of windows where there are more decisions than captures, in one fold."""
    labelled = label_captures(predictions)
    shares = {"accuracy": mean_over_subjects(labelled)["accuracy"]}
    if len(predictions) > len(labelled):
        shares["window_accuracy"] = mean_over_subjects(label_windows(predictions))["accuracy"]
    return shares


def run_scores(predictions: pd.DataFrame, rate_hz: float) -> dict[str, float]:
    """The tracked scores of a run, from its predictions; one that is not defined (SD of one subject) is left out."""
    classes = classes_of(predictions)
    capture = label_captures(predictions)
    scores = _scores_with_prefix("", capture, classes)
    if (gone := capture["predicted"] == ABSTAINED).any():
        scores["abstained"] = gone.mean()
    low, high = pooled_accuracy_interval(capture)
    ends = (predictions["start"] + predictions["frames"]).groupby(
        [predictions["fold"], predictions["capture"]]
    )
    scores |= {
        "pooled_accuracy_low": low,
        "pooled_accuracy_high": high,
        "captures": len(capture),
        "subjects": capture["subject"].nunique(),
        "observed_ms": 1000 / rate_hz * predictions["frames"].median(),
        "capture_ms": 1000 / rate_hz * ends.max().median(),
    }
    if len(predictions) > len(capture):
        scores |= _scores_with_prefix("vote_", label_captures(predictions, vote=True), classes)
        scores |= _scores_with_prefix("window_", label_windows(predictions), classes) | {
            "windows": len(predictions)
        }
    return {name: float(value) for name, value in scores.items() if np.isfinite(value)}


def _scores_with_prefix(
    prefix: str, labelled: pd.DataFrame, classes: list[str]
) -> dict[str, float]:
    table, people = scores_by_class(labelled, classes), mean_over_subjects(labelled)
    scores = dict(
        zip(
            ("accuracy", "accuracy_low", "accuracy_high", "subject_sd"),
            people.values(),
            strict=True,
        )
    )
    scores["pooled_accuracy"] = (labelled["true"] == labelled["predicted"]).mean()
    scores |= {f"macro_{name}": table[name].mean() for name in ("f1", "recall", "precision")}
    return {prefix + name: value for name, value in scores.items()}
