"""Scores of a run, all computed from its table of predictions.

The table has one row per decision: ``fold``, ``capture``, ``start`` (first frame), ``frames``
(frames seen), ``true``, one column ``p_<class>`` per class, and columns of the corpus's captures
(``subject`` and conditions). If a system abstains, all probabilities are 0, and the label is
`ABSTAINED`, which is wrong.

*Labelled* tables have a row per capture or window, with its label in ``predicted``.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.corpora.corpus import PROBABILITY as PREFIX
from bench.corpora.corpus import RESERVED as RESERVED
from bench.values.intervals import ratio_interval, t_interval

ABSTAINED = ""  # label of a system that abstains; no gesture has this name


def classes_of(predictions: pd.DataFrame) -> list[str]:
    """Class names, in the order of the probability columns."""
    return [c.removeprefix(PREFIX) for c in predictions.columns if c.startswith(PREFIX)]


def most_probable_labels(proba: np.ndarray, classes: list[str]) -> np.ndarray:
    """Label of each row of probabilities [decisions, classes]; `ABSTAINED` if all are 0."""
    return np.where(
        proba.max(axis=1) > 0, np.asarray(classes, dtype=object)[proba.argmax(axis=1)], ABSTAINED
    )


def label_windows(predictions: pd.DataFrame) -> pd.DataFrame:
    """Label each decision by its probabilities."""
    classes = classes_of(predictions)
    proba = predictions[[PREFIX + c for c in classes]].to_numpy()
    return predictions.assign(predicted=most_probable_labels(proba, classes))


def label_captures(predictions: pd.DataFrame, vote: bool = False) -> pd.DataFrame:
    """Label each tested capture by the mean probability or the majority vote of its decisions.

    Of classes with equal votes, the one with the highest mean probability wins.
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
        counts = ballots.groupby(keys, sort=False)[columns].sum().to_numpy()
        score = score + 2 * counts  # mean probabilities, at most 1, decide ties
    rows = predictions.drop(columns=columns).drop_duplicates(keys, ignore_index=True)
    return rows.assign(predicted=most_probable_labels(score.to_numpy(), classes))


def label_by_prefix(predictions: pd.DataFrame, prefix: str) -> pd.DataFrame:
    """Label windows for ``window_``, else captures, by majority vote for ``vote_``."""
    if prefix == "window_":
        return label_windows(predictions)
    return label_captures(predictions, vote=prefix == "vote_")


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
    """Counts of true classes (rows) and predicted ones, with ``(abstained)`` if there are any."""
    true, predicted = (
        pd.Index(classes).get_indexer(pd.Index(labelled[name])) for name in ("true", "predicted")
    )
    counts = np.zeros((len(classes), len(classes)), dtype=np.int64)
    known = (true >= 0) & (predicted >= 0)
    np.add.at(counts, (true[known], predicted[known]), 1)
    table = pd.DataFrame(counts, index=classes, columns=classes)
    if not (abstained := labelled["predicted"] == ABSTAINED).any():
        return table
    counts = labelled["true"][abstained].value_counts().reindex(classes, fill_value=0)
    return pd.concat([table, counts.rename("(abstained)")], axis=1)


def pooled_accuracy_interval(labelled: pd.DataFrame) -> tuple[float, float]:
    """95 % bootstrap interval of pooled accuracy over subjects; NaN for too few of them."""
    hits = (labelled["true"] == labelled["predicted"]).groupby(labelled["subject"])
    return ratio_interval(hits.agg(["sum", "size"]).to_numpy())


def mean_over_subjects(labelled: pd.DataFrame) -> dict[str, float]:
    """Mean accuracy over subjects, its 95 % t-interval (``low``, ``high``), ``subject_sd``."""
    accuracies = accuracy_by_subject(labelled)["accuracy"]
    mean, sd = float(accuracies.mean()), float(accuracies.std(ddof=1))
    low, high = np.clip(t_interval(mean, sd, len(accuracies)), 0, 1)
    return {"accuracy": mean, "low": float(low), "high": float(high), "subject_sd": sd}


def fold_accuracies(predictions: pd.DataFrame) -> dict[str, float]:
    """Accuracy of the captures of a fold, and of windows if there are more of them."""
    labelled = label_captures(predictions)
    shares = {"accuracy": mean_over_subjects(labelled)["accuracy"]}
    if len(predictions) > len(labelled):
        shares["window_accuracy"] = mean_over_subjects(label_windows(predictions))["accuracy"]
    return shares


def run_scores(predictions: pd.DataFrame, rate_hz: float) -> dict[str, float]:
    """Tracked scores of a run; undefined ones, such as the SD of one subject, are left out."""
    classes = classes_of(predictions)
    capture = label_captures(predictions)
    scores = _scores_with_prefix("", capture, classes)
    if (abstained := capture["predicted"] == ABSTAINED).any():
        scores["abstained"] = abstained.mean()
    low, high = pooled_accuracy_interval(capture)
    keys = [predictions["fold"], predictions["capture"]]
    ends = (predictions["start"] + predictions["frames"]).groupby(keys)
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
        scores |= _scores_with_prefix("window_", label_windows(predictions), classes)
        scores["windows"] = len(predictions)
    return {name: float(value) for name, value in scores.items() if np.isfinite(value)}


def _scores_with_prefix(
    prefix: str, labelled: pd.DataFrame, classes: list[str]
) -> dict[str, float]:
    table, people = scores_by_class(labelled, classes), mean_over_subjects(labelled)
    names = ("accuracy", "accuracy_low", "accuracy_high", "subject_sd")
    scores = dict(zip(names, people.values(), strict=True))
    scores["pooled_accuracy"] = (labelled["true"] == labelled["predicted"]).mean()
    scores |= {f"macro_{name}": table[name].mean() for name in ("f1", "recall", "precision")}
    return {prefix + name: value for name, value in scores.items()}
