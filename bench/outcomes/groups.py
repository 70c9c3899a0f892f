"""Groups of gestures that a system can tell apart: which gestures to merge, and the accuracy that this gives.

A capture is labelled with the group whose gestures have the highest summed mean probability. Groups are merged in
pairs, beginning with every gesture alone. The next pair is the one with the most mutual confusions per pair of
captures: (captures of a labelled b + captures of b labelled a) / (captures of a times captures of b). Labels drawn at
random would give every pair of groups the same value, so large groups have no advantage. The gain of accuracy would
favour them: random labels, too, are correct more often in a large group. On equally balanced gestures this is average
linkage, with labels counted again after each merge, since summed probabilities may change them. Equally confused pairs
are compared by the probability that they give to each other, then by their order.
"""

from __future__ import annotations

import json
import re

import numpy as np
import pandas as pd

from bench import scores
from bench.errors import InputError
from bench.paired import interval

LEVELS = (90, 95, 99)  # percent
Grouping = tuple[tuple[str, ...], ...]  # names of the gestures of each group


def groupings(predictions: pd.DataFrame) -> pd.DataFrame:
    """Accuracy against the number of groups, each person's groups chosen on the predictions for the others.

    Args:
        predictions: table of `bench.scores`, of one or more seeds (then with a column ``seed``).

    Returns:
        A row for each number of ``groups``, from one per gesture down to 2: ``grouping`` (chosen on all subjects, as
        names), ``accuracy`` (mean over subjects, in percent, each with the groups chosen without that subject) with
        its 95 % t-interval over subjects (``low``, ``high``), ``largest`` (accuracy of always naming the group
        that is largest among the others, in percent), ``same`` (subjects without whom the same grouping is chosen) and
        ``subjects``.

    Raises:
        InputError: there is only one subject.
    """
    classes = scores.classes_of(predictions)
    columns = [scores.PREFIX + c for c in classes]
    captures = predictions.groupby([k for k in ("seed", "fold", "capture") if k in predictions], sort=False)
    proba, rows = captures[columns].mean().to_numpy(), captures.first()
    true = pd.Index(classes).get_indexer(pd.Index(rows["true"]))
    people, person = np.unique(rows["subject"].astype(str), return_inverse=True)
    if len(people) < 2:
        raise InputError("groups are chosen on the other subjects, and only one subject was tested; run protocol=loso")
    chosen = merges(proba, true)
    own = [merges(proba[person != i], true[person != i]) for i in range(len(people))]
    table = []
    for k, group in enumerate(chosen[:-1]):
        correct, largest = [], []
        for i, chain in enumerate(own):
            tested, actual = person == i, chain[k][true]
            correct.append(100 * (labels(proba[tested], chain[k]) == actual[tested]).mean())
            largest.append(100 * (np.bincount(actual[~tested]).argmax() == actual[tested]).mean())
        low, high = np.clip(interval(np.array(correct)), 0, 100)
        row = {"groups": len(classes) - k, "grouping": named(group, classes), "accuracy": np.mean(correct)}
        row |= {"low": low, "high": high, "largest": np.mean(largest)}
        table.append(row | {"same": sum(np.array_equal(chain[k], group) for chain in own), "subjects": len(people)})
    return pd.DataFrame(table)


def merges(proba: np.ndarray, true: np.ndarray) -> list[np.ndarray]:
    """The group of each class, from every class alone to one group; a group is numbered by its first class.

    Args:
        proba: mean probabilities [captures, classes].
        true: class of each capture [captures].
    """
    given = np.array([proba[true == c].sum(axis=0) for c in range(proba.shape[1])])
    captures = np.bincount(true, minlength=len(given))
    group = np.arange(len(given))
    chain = [group]
    while group.any():
        counts = np.zeros_like(given)
        label = labels(proba, group)
        np.add.at(counts, (true[label >= 0], label[label >= 0]), 1)
        a, b = _most_confused(counts, given, captures, group)
        group = np.where(group == b, a, group)
        chain.append(group)
    return chain


def labels(proba: np.ndarray, group: np.ndarray) -> np.ndarray:
    """The group of each capture with the highest summed probability, -1 where a system abstains.

    Arguments are those of `merges` and its result.
    """
    numbers = np.unique(group)
    best = numbers[np.argmax(proba @ (group[:, None] == numbers).astype(float), axis=1)]
    return np.where(proba.any(axis=1), best, -1)


def _most_confused(counts: np.ndarray, given: np.ndarray, captures: np.ndarray, group: np.ndarray) -> tuple[int, int]:
    """The two groups with the most mutual confusions per pair of captures.

    Args:
        counts: captures of each class that are labelled with each group [classes, classes].
        given: summed probabilities that the captures of each class give to each class [classes, classes].
        captures: number of them of each class.
        group: group of each class.
    """
    numbers = np.unique(group)
    member = (group[:, None] == numbers).astype(float)
    sizes = np.maximum(captures @ member, 1)  # 0 if only the left-out person has shown a gesture
    first, second = np.triu_indices(len(numbers), 1)
    rates = []
    for each in (given, counts):  # the last key of lexsort counts first
        mutual = member.T @ each @ member
        rates.append(-((mutual + mutual.T) / np.outer(sizes, sizes))[first, second].round(12))
    pair = np.lexsort(rates)[0]
    return int(numbers[first[pair]]), int(numbers[second[pair]])


def named(group: np.ndarray, classes: list[str]) -> Grouping:
    """Names of the classes of each group."""
    return tuple(tuple(np.array(classes, dtype=object)[group == number]) for number in np.unique(group))


def enough(table: pd.DataFrame, level: float) -> int | None:
    """Index of the row with the most groups whose accuracy reaches a level in percent, None if there is none."""
    reached = table.index[table["accuracy"].round(9) >= level]
    return int(reached[0]) if len(reached) else None


def reactions(grouping: Grouping) -> str:
    """The groups of several gestures as the table ``[reactions]`` of a scene file."""
    lines = ["[reactions]"]
    for gestures in (g for g in grouping if len(g) > 1):
        name = "_".join(gestures)
        key = name if re.fullmatch("[A-Za-z0-9_-]+", name) else _quoted(name)
        lines.append(f"{key} = [{', '.join(map(_quoted, gestures))}]")
    return "\n".join(lines)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # TOML's basic strings have the same escapes
