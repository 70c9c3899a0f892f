"""Accuracy in each case of a circumstance, and where recognisers fail. Every function is pure.

The table ``labels`` of a run has a row per tested capture and case: ``fold``, ``capture``, ``length`` (frames, as it
is), ``circumstance`` (its key; empty for the captures as they are), ``case`` (such as the name of a fault), ``level``
(how much of it), ``amount`` (that in words), ``train_subjects`` (how many subjects the system was fitted on), ``true``,
``predicted``, ``p_true`` (probability of the true class), and the columns of the corpus's captures (``subject`` and
conditions). Here it also has ``hit``, whether the label is right.

A *unit* is one tested capture of one fold. A *slice* is a part of the units (of one subject, class, condition or
length), all units in one case of a circumstance, such as a fault at one severity, or what two of these have in common.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench.values import few, scores

if TYPE_CHECKING:
    from bench.values.result import Result

COLUMNS = frozenset(
    "length circumstance case level amount train_subjects predicted p_true hit".split()
)
CAPTURE = ["fold", "capture"]
NOT_CONDITIONS = {*scores.RESERVED, *COLUMNS, "split"}
ALPHA = 0.05
SINGLE, PAIRS = "single slices", "pairs"
FEWEST = 10  # units of a slice
EXACT_SUBJECTS = 16
FAMILIES = 4  # of slices, each with its own correction of p
FLIPS = 2**EXACT_SUBJECTS
LENGTH_BINS = 5


def unharmed(labels: pd.DataFrame) -> pd.DataFrame:
    """The captures as they are, labelled by the systems that were fitted on all training subjects of their fold."""
    return labels[labels["circumstance"] == ""].reset_index(drop=True)


def curve(labels: pd.DataFrame, key: str) -> pd.DataFrame:
    """Accuracy by case and level of a circumstance, a row each.

    Columns: ``case``, ``level``, ``amount``, ``captures``, ``subjects``, ``accuracy`` (mean over subjects) with its
    95 % t-interval (``low``, ``high``) and SD (``subject_sd``), ``loss`` (clean accuracy minus this), and how many
    captures went from a right label to a wrong one (``broken``) and back (``mended``). Where a system abstains in a
    case, ``abstained`` is the share of the captures on which it does.
    """
    hits = labels.assign(hit=labels["true"] == labels["predicted"])
    clean = unharmed(hits).set_index(CAPTURE)["hit"]
    rows = []
    for (case, level), part in hits[hits["circumstance"] == key].groupby(
        ["case", "level"], sort=False
    ):
        before = clean.loc[pd.MultiIndex.from_frame(part[CAPTURE])].to_numpy()
        now = part["hit"].to_numpy()
        scored = scores.over_people(part)
        usual = pd.Series(before).groupby(part["subject"].to_numpy()).mean().mean()
        about = {"case": case, "level": level, "amount": part["amount"].iloc[0]}
        about |= {"captures": len(part), "subjects": part["subject"].nunique()}
        changed = {"broken": int((before & ~now).sum()), "mended": int((~before & now).sum())}
        shares = {
            "loss": usual - scored["accuracy"],
            "abstained": (part["predicted"] == scores.ABSTAINED).mean(),
        }
        rows.append(about | scored | shares | changed)
    names = [
        "case",
        "level",
        "amount",
        "captures",
        "subjects",
        "accuracy",
        "low",
        "high",
        "subject_sd",
    ]
    table = pd.DataFrame(rows, columns=[*names, "loss", "broken", "mended", "abstained"])
    return table if table["abstained"].any() else table.drop(columns="abstained")


def loss(table: pd.DataFrame) -> dict[str, float]:
    """Mean loss over the levels of each case."""
    return {
        str(case): float(part.mean()) for case, part in table.groupby("case", sort=False)["loss"]
    }


def joined(
    results: Sequence[Result], name: str, make: Callable[[Result], pd.DataFrame] | None = None
) -> pd.DataFrame:
    """A table of the results that have it, below each other, with data, subset, protocol, system and seed."""
    parts = []
    for r in results:
        about = dict(zip(("data", "subset", "protocol"), r.context, strict=True)) | {
            "system": r.system,
            "seed": r["seed"],
        }
        if (table := make(r) if make else r.tables.get(name)) is None:
            continue
        parts.append(table.assign(**about)[[*about, *table.columns]])
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def sliced(
    labels: pd.DataFrame, words: Mapping[str, str], target: str
) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
    """Where a system fails: numbers, and the tables ``conditions`` and ``slices``.

    Each circumstance is tested as if it were the only one. ``failing_slices.<key>`` counts the groups of captures as
    they are, and those in the circumstance; ``failing_slices`` counts all.
    """
    labels = labels.assign(
        hit=labels["true"] == labels["predicted"], subject=labels["subject"].astype(str)
    )
    units = unharmed(labels)
    parts = {
        key: slices(labels[labels["circumstance"].isin(["", key])], {key: word}, target)
        for key, word in words.items()
    } or {"": slices(units, {}, target)}
    first, *others = parts.values()
    every = pd.concat([first, *(part[part["fault"] != ""] for part in others)], ignore_index=True)
    tables = {"conditions": conditions(units, target), "slices": every}
    numbers: dict[str, float] = {"chance": chance_of(units)}
    for name in ("failing", "tested"):
        numbers |= {f"{name}_slices": int(every[name].sum())}
        numbers |= {
            f"{name}_slices.{key}": int(part[name].sum()) for key, part in parts.items() if key
        }
    worst = tables["conditions"].groupby("factor", sort=False)["accuracy"].min()
    return numbers | {
        f"worst.{_plain(str(factor))}": accuracy for factor, accuracy in worst.items()
    }, tables


def chance_of(units: pd.DataFrame) -> float:
    """Accuracy of always naming the most frequent class."""
    return float(units["true"].value_counts(normalize=True).max())


def fault_tables(labels: pd.DataFrame, key: str) -> dict[str, pd.DataFrame]:
    """Tables ``faults`` (accuracy under each at each severity) and ``margins`` (`half_margins`)."""
    table = (
        curve(labels, key)
        .rename(columns={"case": "fault", "level": "severity"})
        .astype({"severity": int})
    )
    units = unharmed(labels)
    names = [
        "fault",
        "severity",
        "amount",
        "captures",
        "accuracy",
        "low",
        "high",
        "loss",
        "broken",
        "mended",
    ]
    names += [name for name in ("abstained",) if name in table]
    return {
        "faults": table[names],
        "margins": half_margins(table, scores.over_people(units)["accuracy"], chance_of(units)),
    }


def fault_metrics(tables: Mapping[str, pd.DataFrame]) -> dict[str, float]:
    """Tracked metrics of `fault_tables`; ``half_margin.<fault>`` is left out if it is never reached."""
    numbers: dict[str, float] = {}
    for fault, severity, accuracy in tables["faults"][["fault", "severity", "accuracy"]].itertuples(
        index=False
    ):
        numbers[f"accuracy.{fault}.{severity}"] = accuracy
    for fault, loss, half_margin in tables["margins"][["fault", "loss", "half_margin"]].itertuples(
        index=False
    ):
        numbers |= {f"loss.{fault}": loss} | (
            {f"half_margin.{fault}": half_margin} if np.isfinite(half_margin) else {}
        )
    return numbers


def _plain(name: str) -> str:
    """A column's name with nothing that MLflow refuses in the name of a metric."""
    return "".join(c if c.isalnum() and c.isascii() else "_" for c in name)


def half_margins(by_fault: pd.DataFrame, clean: float, chance: float) -> pd.DataFrame:
    """Mean ``loss`` over severities of each fault, and the severity at which half of the margin over chance is lost.

    ``half_margin`` is the first severity, linear between two, at which accuracy is halfway from clean to chance: inf
    where it stays above, NaN for a method that is no better than chance. ``where`` says it in amounts.
    """
    rows = []
    for fault, part in by_fault.groupby("fault", sort=False):
        part = part.sort_values("severity")
        level = np.append(0, part["severity"])
        accuracy = np.append(clean, part["accuracy"])
        amount = ["nothing", *part["amount"]]
        half, where = np.inf, f"beyond {amount[-1]}"
        below = np.flatnonzero(accuracy <= (clean + chance) / 2)
        if clean <= chance:
            half, where = np.nan, "no margin"
        elif len(below):
            i = below[0]
            share = (accuracy[i - 1] - (clean + chance) / 2) / (accuracy[i - 1] - accuracy[i])
            half = level[i - 1] + share * (level[i] - level[i - 1])
            where = (
                f"{amount[i - 1].split(' ')[0]} to {amount[i]}" if i > 1 else f"below {amount[i]}"
            )
        rows.append([fault, part["loss"].mean(), half, where])
    return pd.DataFrame(rows, columns=["fault", "loss", "half_margin", "where"])


def factors(units: pd.DataFrame, target: str) -> dict[str, pd.Series]:
    """Factors of a unit with their values: subject, class, every condition, length."""
    values_of = {"subject": units["subject"], target: units["true"]}
    values_of |= {
        c: units[c] for c in units.columns if c not in NOT_CONDITIONS and c not in values_of
    }
    if units["length"].nunique() > 1:
        bins = pd.qcut(units["length"], LENGTH_BINS, duplicates="drop")
        ends = units["length"].groupby(bins, observed=True).agg(["min", "max"])
        values_of["frames"] = bins.map({b: f"{r['min']} to {r['max']}" for b, r in ends.iterrows()})
    named = {
        name: values.astype(str).where(values.notna(), "unknown")
        for name, values in values_of.items()
    }
    return {name: values for name, values in named.items() if values.nunique() > 1}


def conditions(units: pd.DataFrame, target: str) -> pd.DataFrame:
    """Clean accuracy of every subject, class, condition and length: mean over subjects with its 95 % t-interval."""
    rows = []
    for factor, values in factors(units, target).items():
        for value, part in units.groupby(values, sort=False):
            about = {
                "factor": factor,
                "value": value,
                "captures": len(part),
                "subjects": part["subject"].nunique(),
            }
            rows.append(about | scores.over_people(part))
    names = ["factor", "value", "captures", "subjects", "accuracy", "low", "high"]
    return pd.DataFrame(rows, columns=names)


def learning(labels: pd.DataFrame) -> pd.DataFrame:
    """Clean accuracy by the number of training subjects; the last row is the method itself (a mean if folds differ)."""
    numbers = labels["train_subjects"].astype(float)
    most = numbers.groupby(labels["fold"]).transform("max")
    clean = (labels["circumstance"] == "") | (numbers < most)
    numbers = numbers.where(numbers < most, most[clean & (numbers == most)].mean()).round(1)
    rows = []
    for number, part in labels[clean].groupby(numbers[clean]):
        rows.append({"train_subjects": number, "captures": len(part)} | scores.over_people(part))
    return pd.DataFrame(
        rows, columns=["train_subjects", "captures", "accuracy", "low", "high", "subject_sd"]
    )


def slices(table: pd.DataFrame, words: Mapping[str, str], target: str) -> pd.DataFrame:
    """Every slice with its accuracy, tested for being below the method's own clean accuracy.

    Captures of one subject are not independent. A slice with several subjects gets the larger of two one-sided
    p-values. One flips the signs of the subjects' differences between the slice and all their clean captures (would
    other people show it too; all flips up to 16 subjects, else 65 535 drawn ones). The other is binomial: how likely so
    few right labels are if each subject had their own clean accuracy in the slice (are these captures enough). The
    first alone would call small slices of weak methods failing, whose counts are skewed; the second one subject's
    habit. Within one subject only the binomial test against the method's accuracy is left; it speaks of that subject.

    ``p_corrected`` is by Benjamini and Hochberg over all slices that are ``tested``, in four families (`families`) with
    a quarter of the error rate each: the many pairs do not hide a fault as such, and faults, most of which fail, do not
    let others pass. Tested are slices of at least 10 units with
    counts with which p could be 0.05 or less at all (``floor``: the smallest p that the slice can have); this choice
    does not look at labels. ``failing`` is p_corrected of at most 0.05. Runs with fewer than `bench.values.few.TEST` subjects
    have no p.
    """
    units = unharmed(table)
    right_under = [units["hit"].to_numpy(float)]
    cases: list[tuple[str, Any, str, str]] = [("", 0, "", "")]
    order = pd.MultiIndex.from_frame(units[CAPTURE])
    changed = table[table["circumstance"].isin([*words])]
    for (key, case, level), part in changed.groupby(["circumstance", "case", "level"], sort=False):
        right_under.append(part.set_index(CAPTURE)["hit"].reindex(order).to_numpy(float))
        cases.append((str(case), level, part["amount"].iloc[0], words[str(key)]))
    hits = np.column_stack(right_under)  # [units, faults]
    codes, _ = pd.factorize(units["subject"])
    member = np.eye(codes.max() + 1)[codes].T  # [subjects, units]
    rows, counts, right = [], [], []
    for names, inside, alone in _parts(factors(units, target)):
        subjects = member[:, inside]
        sums = subjects @ hits[inside][:, : len(cases) if alone else 1]
        for case, of_subject in zip(cases, sums.T, strict=False):
            if names or case[0]:
                rows.append((*_named(names, case), *case))
                counts.append(subjects.sum(axis=1))
                right.append(of_subject)
    tests = pd.DataFrame(
        rows, columns=["kind", "slice", "fault", "severity", "amount", "circumstance"]
    )
    shape = len(rows), len(member)
    counted = np.reshape(counts, shape), np.reshape(right, shape)
    return _tested(tests, *counted, member.sum(axis=1), member @ hits[:, 0])


def _parts(
    values_of: dict[str, pd.Series],
) -> Iterator[tuple[tuple[tuple[str, str], ...], np.ndarray, bool]]:
    """All units, each value of each factor, and pairs of values; whether they are tested in circumstances, too."""
    first = next(iter(values_of.values()), None)
    if first is None:
        return
    yield (), np.ones(len(first), dtype=bool), True
    single = {}
    for factor, values in values_of.items():
        counted = values.value_counts(sort=False)
        for value, count in zip(counted.index, counted, strict=True):
            if count >= FEWEST:
                single[factor, value] = (values == value).to_numpy()
                yield ((factor, value),), single[factor, value], True
    for one, other in combinations(single, 2):
        both = single[one] & single[other]
        if one[0] != other[0] and both.sum() >= FEWEST:
            yield (one, other), both, False


def _named(names: tuple[tuple[str, str], ...], case: tuple[str, Any, str, str]) -> tuple[str, str]:
    """The kind of a slice and its name."""
    kind, name = [factor for factor, _ in names], [f"{factor} {value}" for factor, value in names]
    if case[0]:
        kind, name = [*kind, case[3]], [*name, f"{case[0]} {case[2]}"]
    return " x ".join(kind), ", ".join(name)


def _tested(
    tests: pd.DataFrame, counts: np.ndarray, right: np.ndarray, units: np.ndarray, clean: np.ndarray
) -> pd.DataFrame:
    """Accuracies and p-values; ``counts`` and ``right`` [slices, subjects], ``units`` and ``clean`` [subjects]."""
    from scipy.stats import (  # heavy, and bench choose needs none of it
        binom,
        false_discovery_control,
    )

    total, sums = counts.sum(axis=1), right.sum(axis=1)
    overall, usual = clean.sum() / units.sum(), clean / units
    there = counts > 0
    single = there.sum(axis=1) == 1
    expected = np.where(single, overall, counts @ usual / total)
    by_count = binom.cdf(sums, total, expected)
    difference = np.where(there, right / np.where(there, counts, 1) - usual, 0)
    # A subject who is only inside the slice, or only outside, says nothing on the difference.
    compared = (there & ((counts < units) | (tests["fault"] != "").to_numpy()[:, None])).sum(axis=1)
    lowest = np.maximum(binom.cdf(0, total, expected), 1 / FLIPS)
    floor = np.where(single, binom.cdf(0, total, overall), np.maximum(0.5**compared, lowest))
    p = np.where(single, by_count, np.maximum(by_count, flipped(difference)))
    enough = len(units) >= few.TEST
    p, floor = (each if enough else np.full(len(each), np.nan) for each in (p, floor))
    tested = (total >= FEWEST) & (floor <= ALPHA)
    corrected = np.full(len(p), np.nan)
    family = families(tests)
    for name in family.unique():
        if (group := tested & (family == name).to_numpy()).any():
            corrected[group] = np.minimum(FAMILIES * false_discovery_control(p[group]), 1)
    return tests.assign(
        captures=total.astype(int),
        subjects=there.sum(axis=1),
        right=sums.astype(int),
        accuracy=sums / total,
        gap=overall - sums / total,
        p=p,
        floor=floor,
        tested=tested,
        p_corrected=corrected,
        failing=corrected <= ALPHA,
    )


def families(tests: pd.DataFrame) -> pd.Series:
    """Families of slices for correction of p: single ones and pairs, of clean captures and in a circumstance."""
    pair = tests["kind"].astype(str).str.contains(" x ").map({True: PAIRS, False: SINGLE})
    return pair.where(
        tests["fault"] == "", pair + " under " + tests["circumstance"].astype(str) + "s"
    )


def flipped(difference: np.ndarray) -> np.ndarray:
    """One-sided sign-flip p-values: share of random signs with a sum at or below the observed one."""
    tests, subjects = difference.shape
    if subjects <= EXACT_SUBJECTS:
        signs = 1 - 2 * ((np.arange(2**subjects)[:, None] >> np.arange(subjects)) & 1).astype(float)
    else:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (FLIPS, subjects))
        signs[0] = 1  # what was seen is one of the ways
    p = np.empty(tests)
    for i in range(0, tests, 64):
        part = difference[i : i + 64]
        p[i : i + 64] = (signs @ part.T <= part.sum(axis=1) + 1e-9).mean(axis=0)
    return p
