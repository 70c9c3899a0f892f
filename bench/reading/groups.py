"""Groups of gestures that a system can tell apart: which to merge, and the accuracy gained.

A capture is labelled with the group whose gestures have the highest summed mean probability. The
next pair of groups to merge is the one with the most mutual confusions per pair of captures. Random
labels give every pair the same value, so large groups have no advantage; the gain of accuracy would
favour them. Equally confused pairs are compared by the probability that they give to each other,
then by their order.
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
    """Accuracy by number of groups; each person's groups are chosen on the predictions for others.

    Returns:
        A row for each number of ``groups``, from one per gesture down to 2: ``grouping`` (chosen on
        all subjects, as names), ``accuracy`` (mean over subjects, in percent, each with the groups
        chosen without that subject) with its 95 % t-interval (``low``, ``high``), ``largest``
        (accuracy of always naming the group that is largest among the others), ``same`` (subjects
        without whom the same grouping is chosen) and ``subjects``.

    Raises:
        InputError: there is only one subject.
    """
    classes = scores.classes_of(predictions)
    columns = [scores.PREFIX + c for c in classes]
    keys = [k for k in ("seed", "fold", "capture") if k in predictions]
    captures = predictions.groupby(keys, sort=False)
    proba, rows = captures[columns].mean().to_numpy(), captures.first()
    true = pd.Index(classes).get_indexer(pd.Index(rows["true"]))
    people, person = np.unique(rows["subject"].astype(str), return_inverse=True)
    if len(people) < 2:
        raise InputError(
            "groups are chosen on the other subjects, and only one subject was tested; "
            "run protocol=loso"
        )
    steps = merge_groups(proba, true)
    steps_of_others = [
        merge_groups(proba[person != i], true[person != i]) for i in range(len(people))
    ]
    table = []
    for step, group in enumerate(steps[:-1]):
        correct, largest, same = [], [], 0
        for i, others in enumerate(steps_of_others):
            tested, actual = person == i, others[step][true]
            predicted = predict_groups(proba[tested], others[step])
            correct.append(100 * (predicted == actual[tested]).mean())
            most = np.bincount(actual[~tested]).argmax()
            largest.append(100 * (most == actual[tested]).mean())
            same += np.array_equal(others[step], group)
        low, high = np.clip(mean_interval(np.array(correct)), 0, 100)
        names = np.array(classes, dtype=object)
        grouping = tuple(tuple(names[group == number]) for number in np.unique(group))
        row = {"groups": len(grouping), "grouping": grouping, "accuracy": np.mean(correct)}
        row |= {"low": low, "high": high, "largest": np.mean(largest), "same": same}
        table.append(row | {"subjects": len(people)})
    return pd.DataFrame(table)


def merge_groups(proba: np.ndarray, true: np.ndarray) -> list[np.ndarray]:
    """Merge the most confused pair of groups until one is left.

    Args:
        proba: probabilities [captures, classes].
        true: number of the true class [captures].

    Returns:
        The group of each class in every step, the first with every class alone; a group has the
        number of its first class.
    """
    sums = np.array([proba[true == c].sum(axis=0) for c in range(proba.shape[1])])
    captures = np.bincount(true, minlength=len(sums))
    group = np.arange(len(sums))
    steps = [group]
    while group.any():
        counts, predicted = np.zeros_like(sums), predict_groups(proba, group)
        np.add.at(counts, (true[predicted >= 0], predicted[predicted >= 0]), 1)
        numbers = np.unique(group)
        member = (group[:, None] == numbers).astype(float)
        sizes = np.maximum(captures @ member, 1)  # 0 if only the left-out person has shown it
        first, second = np.triu_indices(len(numbers), 1)
        rates = []
        for confusions in (sums, counts):  # the last key of lexsort counts first
            mutual = member.T @ confusions @ member
            rates.append(-((mutual + mutual.T) / np.outer(sizes, sizes))[first, second].round(12))
        pair = np.lexsort(rates)[0]
        group = np.where(group == numbers[second[pair]], numbers[first[pair]], group)
        steps.append(group)
    return steps


def predict_groups(proba: np.ndarray, group: np.ndarray) -> np.ndarray:
    """The group of each capture with the highest summed probability, -1 where a system abstains."""
    numbers = np.unique(group)
    best = numbers[np.argmax(proba @ (group[:, None] == numbers).astype(float), axis=1)]
    return np.where(proba.any(axis=1), best, -1)


def reactions_table(grouping: Grouping) -> str:
    """The groups of several gestures as the table ``[reactions]`` of a scene file."""
    lines = ["[reactions]"]
    for gestures in grouping:
        if len(gestures) > 1:
            name = "_".join(gestures)
            key = name if re.fullmatch("[A-Za-z0-9_-]+", name) else _quote_toml(name)
            lines.append(f"{key} = [{', '.join(map(_quote_toml, gestures))}]")
    return "\n".join(lines)


def _quote_toml(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # TOML's basic strings have the same escapes
