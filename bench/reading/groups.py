"""Groups of gestures that a system can tell apart: which gestures to merge, and the accuracy that this gives.

A capture is labelled with the group whose gestures have the highest summed mean probability. The next pair of groups to
merge is the one with the most mutual confusions per pair of captures. Random labels give every pair the same value, so
large groups have no advantage; the gain of accuracy would favour them. Equally confused pairs are compared by the
probability that they give to each other, then by their order.
"""

from __future__ import annotations

import json
import re

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.values import scores
from bench.values.intervals import mean_interval

Grouping = tuple[tuple[str, ...], ...]  # names of the gestures of each group


def accuracy_by_grouping(predictions: pd.DataFrame) -> pd.DataFrame:
    """Accuracy against the number of groups, each person's groups chosen on the predictions for the others.

    Returns:
        A row for each number of ``groups``, from one per gesture down to 2: ``grouping`` (chosen on all subjects, as
        names), ``accuracy`` (mean over subjects, in percent, each with the groups chosen without that subject) with
        its 95 % t-interval (``low``, ``high``), ``largest`` (accuracy of always naming the group that is largest among
        the others), ``same`` (subjects without whom the same grouping is chosen) and ``subjects``.
    """
    classes = scores.classes_of(predictions)
    columns = [scores.PREFIX + c for c in classes]
    captures = predictions.groupby(
        [k for k in ("seed", "fold", "capture") if k in predictions], sort=False
    )
    proba, rows = captures[columns].mean().to_numpy(), captures.first()
    true = pd.Index(classes).get_indexer(pd.Index(rows["true"]))
    people, person = np.unique(rows["subject"].astype(str), return_inverse=True)
    if len(people) < 2:
        raise InputError(
            "groups are chosen on the other subjects, and only one subject was tested; run protocol=loso"
        )
    chosen = merge_groups(proba, true)
    own = [merge_groups(proba[person != i], true[person != i]) for i in range(len(people))]
    table = []
    for k, group in enumerate(chosen[:-1]):
        correct, largest = [], []
        for i, chain in enumerate(own):
            tested, actual = person == i, chain[k][true]
            correct.append(100 * (predict_groups(proba[tested], chain[k]) == actual[tested]).mean())
            largest.append(100 * (np.bincount(actual[~tested]).argmax() == actual[tested]).mean())
        low, high = np.clip(mean_interval(np.array(correct)), 0, 100)
        names = tuple(
            tuple(np.array(classes, dtype=object)[group == number]) for number in np.unique(group)
        )
        row = {
            "groups": len(names),
            "grouping": names,
            "accuracy": np.mean(correct),
            "low": low,
            "high": high,
        }
        row |= {
            "largest": np.mean(largest),
            "same": sum(np.array_equal(chain[k], group) for chain in own),
        }
        table.append(row | {"subjects": len(people)})
    return pd.DataFrame(table)


def merge_groups(proba: np.ndarray, true: np.ndarray) -> list[np.ndarray]:
    """The group of each class, from every class alone to one group; a group is numbered by its first class."""
    given = np.array([proba[true == c].sum(axis=0) for c in range(proba.shape[1])])
    captures = np.bincount(true, minlength=len(given))
    group = np.arange(len(given))
    chain = [group]
    while group.any():
        counts, label = np.zeros_like(given), predict_groups(proba, group)
        np.add.at(counts, (true[label >= 0], label[label >= 0]), 1)
        numbers = np.unique(group)
        member = (group[:, None] == numbers).astype(float)
        sizes = np.maximum(
            captures @ member, 1
        )  # 0 if only the left-out person has shown a gesture
        first, second = np.triu_indices(len(numbers), 1)
        rates = []
        for each in (given, counts):  # the last key of lexsort counts first
            mutual = member.T @ each @ member
            rates.append(-((mutual + mutual.T) / np.outer(sizes, sizes))[first, second].round(12))
        pair = np.lexsort(rates)[0]
        group = np.where(group == numbers[second[pair]], numbers[first[pair]], group)
        chain.append(group)
    return chain


def predict_groups(proba: np.ndarray, group: np.ndarray) -> np.ndarray:
    """The group of each capture with the highest summed probability, -1 where a system abstains."""
    numbers = np.unique(group)
    best = numbers[np.argmax(proba @ (group[:, None] == numbers).astype(float), axis=1)]
    return np.where(proba.any(axis=1), best, -1)


def reactions_table(grouping: Grouping) -> str:
    """The groups of several gestures as the table ``[reactions]`` of a scene file."""
    quoted = lambda text: json.dumps(text, ensure_ascii=False)  # noqa: E731 (TOML's basic strings have these escapes)
    lines = ["[reactions]"]
    for gestures in (g for g in grouping if len(g) > 1):
        name = "_".join(gestures)
        key = name if re.fullmatch("[A-Za-z0-9_-]+", name) else quoted(name)
        lines.append(f"{key} = [{', '.join(map(quoted, gestures))}]")
    return "\n".join(lines)
