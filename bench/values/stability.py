"""Accuracy in each case of a circumstance, and where recognisers fail. Every function is pure.

The table ``labels`` of a run has a row per tested capture and case: ``fold``, ``capture``,
``length`` (frames, unchanged), ``circumstance`` (its key; empty for unchanged captures), ``case``
(such as the name of a fault), ``level`` (size of the change), ``amount`` (that in words),
``train_subjects`` (number of subjects that the system was fitted on), ``true``, ``predicted``,
``p_true`` (probability of the true class), and the columns of the corpus's captures (``subject``
and conditions). Here it also has ``hit``, whether the label is right.

A *unit* is one tested capture of one fold. A *slice* is a part of the units (of one subject, class,
condition or length), all units in one case of a circumstance, such as a fault at one severity, or
what two of these have in common.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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
SCORES = ["accuracy", "low", "high"]
ALPHA = 0.05
SINGLE, PAIRS = "single slices", "pairs"
FEWEST = 10  # units of a slice
EXACT_SUBJECTS = 16
FAMILIES = 4  # of slices, each with its own correction of p
FLIPS = 2**EXACT_SUBJECTS
LENGTH_BINS = 5


def clean_labels(labels: pd.DataFrame) -> pd.DataFrame:
    """Labels of unchanged captures by the systems that were fitted on all training subjects."""
    return labels[labels["circumstance"] == ""].reset_index(drop=True)


def accuracy_curve(labels: pd.DataFrame, key: str) -> pd.DataFrame:
    """Accuracy by case and level of a circumstance, a row each.

    Columns: ``case``, ``level``, ``amount``, ``captures``, ``subjects``, ``accuracy`` (mean over
    subjects) with its 95 % t-interval (``low``, ``high``) and SD (``subject_sd``), ``loss`` (clean
    accuracy minus this), and how many captures went from a right label to a wrong one (``broken``)
    and back (``mended``). Where a system abstains in a case, ``abstained`` is the share of the
    captures on which it does.
    """
    hits = labels.assign(hit=labels["true"] == labels["predicted"])
    clean = clean_labels(hits).set_index(CAPTURE)["hit"]
    rows = []
    cases = hits[hits["circumstance"] == key].groupby(["case", "level"], sort=False)
    for (case, level), part in cases:
        before = clean.loc[pd.MultiIndex.from_frame(part[CAPTURE])].to_numpy()
        now = part["hit"].to_numpy()
        accuracy = scores.mean_over_subjects(part)
        clean_accuracy = pd.Series(before).groupby(part["subject"].to_numpy()).mean().mean()
        rows.append(
            {
                "case": case,
                "level": level,
                "amount": part["amount"].iloc[0],
                "captures": len(part),
                "subjects": part["subject"].nunique(),
                **accuracy,
                "loss": clean_accuracy - accuracy["accuracy"],
                "broken": int((before & ~now).sum()),
                "mended": int((~before & now).sum()),
                "abstained": (part["predicted"] == scores.ABSTAINED).mean(),
            }
        )
    names = ["case", "level", "amount", "captures", "subjects", *SCORES, "subject_sd"]
    table = pd.DataFrame(rows, columns=[*names, "loss", "broken", "mended", "abstained"])
    return table if table["abstained"].any() else table.drop(columns="abstained")


def mean_losses(curve: pd.DataFrame) -> dict[str, float]:
    """Mean loss over the levels of each case."""
    losses = curve.groupby("case", sort=False)["loss"]
    return {str(case): float(part.mean()) for case, part in losses}


def concat_tables(results: Sequence[Result], name: str) -> pd.DataFrame:
    """Concatenate a table of the results that have it, with their data, system and seed."""
    parts = []
    for result in results:
        if (table := result.tables.get(name)) is None:
            continue
        columns = dict(zip(("data", "subset", "protocol"), result.context, strict=True))
        columns |= {"system": result.system, "seed": result["seed"]}
        parts.append(table.assign(**columns)[[*columns, *table.columns]])
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def find_failing_slices(
    labels: pd.DataFrame, case_nouns: Mapping[str, str], target: str
) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
    """Find where a system fails.

    Each circumstance is tested as if it were the only one. ``failing_slices.<key>`` counts the
    groups of unchanged captures, and those in the circumstance; ``failing_slices`` counts all.

    Args:
        labels: table of labels.
        case_nouns: noun for a case of each circumstance, by its key.
        target: name of the classes.

    Returns:
        Numbers, and the tables ``conditions`` and ``slices``.
    """
    hits = labels["true"] == labels["predicted"]
    labels = labels.assign(hit=hits, subject=labels["subject"].astype(str))
    units, parts = clean_labels(labels), {}
    for key, noun in (case_nouns or {"": ""}).items():
        rows = labels[labels["circumstance"].isin(["", key])]
        parts[key] = score_slices(rows, {key: noun} if key else {}, target)
    first, *others = parts.values()
    changed = [part[part["fault"] != ""] for part in others]
    slices = pd.concat([first, *changed], ignore_index=True)
    conditions = accuracy_by_condition(units, target)
    numbers: dict[str, float] = {"chance": chance_accuracy(units)}
    for name in ("failing", "tested"):
        numbers[f"{name}_slices"] = int(slices[name].sum())
        for key in case_nouns:
            numbers[f"{name}_slices.{key}"] = int(parts[key][name].sum())
    for factor, accuracy in conditions.groupby("factor", sort=False)["accuracy"].min().items():
        numbers[f"worst.{_metric_name(str(factor))}"] = accuracy
    return numbers, {"conditions": conditions, "slices": slices}


def chance_accuracy(units: pd.DataFrame) -> float:
    """Accuracy of always predicting the most frequent class."""
    return float(units["true"].value_counts(normalize=True).max())


def fault_tables(labels: pd.DataFrame, key: str) -> dict[str, pd.DataFrame]:
    """Tables ``faults`` (accuracy under each at each severity) and ``margins`` (`half_margins`)."""
    curve = accuracy_curve(labels, key).rename(columns={"case": "fault", "level": "severity"})
    curve = curve.astype({"severity": int})
    units = clean_labels(labels)
    accuracy = scores.mean_over_subjects(units)["accuracy"]
    return {
        "faults": curve.drop(columns=["subjects", "subject_sd"]),
        "margins": half_margins(curve, accuracy, chance_accuracy(units)),
    }


def fault_metrics(tables: Mapping[str, pd.DataFrame]) -> dict[str, float]:
    """Tracked metrics of `fault_tables`; without ``half_margin.<fault>`` if it is not reached."""
    metrics: dict[str, float] = {}
    for row in tables["faults"].itertuples():
        metrics[f"accuracy.{row.fault}.{row.severity}"] = row.accuracy
    for row in tables["margins"].itertuples():
        metrics[f"loss.{row.fault}"] = row.loss
        if np.isfinite(row.half_margin):
            metrics[f"half_margin.{row.fault}"] = row.half_margin
    return metrics


def _metric_name(column: str) -> str:
    """Name of a column without characters that MLflow refuses in the name of a metric."""
    return "".join(c if c.isalnum() and c.isascii() else "_" for c in column)


def half_margins(curve: pd.DataFrame, clean: float, chance: float) -> pd.DataFrame:
    """Mean ``loss`` of each fault, and the severity that costs half of the margin over chance.

    ``half_margin`` is the first severity, linear between two, at which accuracy is halfway from
    clean to chance: inf where it stays above, NaN for a method that is no better than chance.
    ``where`` says it in amounts.
    """
    rows = []
    for fault, part in curve.groupby("fault", sort=False):
        part = part.sort_values("severity")
        level = np.append(0, part["severity"])
        accuracy = np.append(clean, part["accuracy"])
        amounts = ["nothing", *part["amount"]]
        half, where = np.inf, f"beyond {amounts[-1]}"
        halfway = (clean + chance) / 2
        below = np.flatnonzero(accuracy <= halfway)
        if clean <= chance:
            half, where = np.nan, "no margin"
        elif len(below):
            i = below[0]
            share = (accuracy[i - 1] - halfway) / (accuracy[i - 1] - accuracy[i])
            half = level[i - 1] + share * (level[i] - level[i - 1])
            where = f"below {amounts[i]}"
            if i > 1:
                where = f"{amounts[i - 1].split(' ')[0]} to {amounts[i]}"
        rows.append([fault, part["loss"].mean(), half, where])
    return pd.DataFrame(rows, columns=["fault", "loss", "half_margin", "where"])


def factor_values(units: pd.DataFrame, target: str) -> dict[str, pd.Series]:
    """Values of each factor of units: subject, class, every condition, length."""
    factors = {"subject": units["subject"], target: units["true"]}
    names = [name for name in units.columns if name not in NOT_CONDITIONS and name not in factors]
    factors |= {name: units[name] for name in names}
    if units["length"].nunique() > 1:
        bins = pd.qcut(units["length"], LENGTH_BINS, duplicates="drop")
        ends = units["length"].groupby(bins, observed=True).agg(["min", "max"])
        factors["frames"] = bins.map({b: f"{r['min']} to {r['max']}" for b, r in ends.iterrows()})
    texts = {}
    for name, values in factors.items():
        texts[name] = values.astype(str).where(values.notna(), "unknown")
    return {name: values for name, values in texts.items() if values.nunique() > 1}


def accuracy_by_condition(units: pd.DataFrame, target: str) -> pd.DataFrame:
    """Clean accuracy of every subject, class, condition and length.

    The accuracy is the mean over subjects, with its 95 % t-interval.
    """
    rows = []
    for factor, values in factor_values(units, target).items():
        for value, part in units.groupby(values, sort=False):
            row = {"factor": factor, "value": value, "captures": len(part)}
            row |= {"subjects": part["subject"].nunique()}
            rows.append(row | scores.mean_over_subjects(part))
    return pd.DataFrame(rows, columns=["factor", "value", "captures", "subjects", *SCORES])


def learning_curve(labels: pd.DataFrame) -> pd.DataFrame:
    """Clean accuracy by the number of training subjects.

    The last row is the system itself, with the mean of its numbers if folds differ.
    """
    counts = labels["train_subjects"].astype(float)
    most = counts.groupby(labels["fold"]).transform("max")
    clean = (labels["circumstance"] == "") | (counts < most)
    counts = counts.where(counts < most, most[clean & (counts == most)].mean()).round(1)
    rows = []
    for count, part in labels[clean].groupby(counts[clean]):
        row = {"train_subjects": count, "captures": len(part)}
        rows.append(row | scores.mean_over_subjects(part))
    return pd.DataFrame(rows, columns=["train_subjects", "captures", *SCORES, "subject_sd"])


def score_slices(table: pd.DataFrame, case_nouns: Mapping[str, str], target: str) -> pd.DataFrame:
    """Every slice with its accuracy, tested for being below the method's own clean accuracy.

    Captures of one subject are not independent. A slice with several subjects gets the larger of
    two one-sided p-values. One flips the signs of the subjects' differences between the slice and
    all their clean captures (would other people show it too; all flips up to 16 subjects, else
    65 535 drawn ones). The other is binomial: how likely so few right labels are if each subject
    had their own clean accuracy in the slice (are these captures enough). The first alone would
    call small slices of weak methods failing, whose counts are skewed; the second one subject's
    habit. Within one subject only the binomial test against the method's accuracy is left; it
    speaks of that subject.

    ``p_corrected`` is by Benjamini and Hochberg over all slices that are ``tested``, in four
    families (`correction_families`) with a quarter of the error rate each: the many pairs do not
    hide a fault as such, and faults, most of which fail, do not let others pass. Tested are slices
    of at least 10 units with counts with which p could be 0.05 or less at all (``floor``: the
    smallest p that the slice can have); this choice does not look at labels. ``failing`` is
    p_corrected of at most 0.05. Runs with fewer than `bench.values.few.FEWEST_FOR_TEST` subjects
    have no p.
    """
    units = clean_labels(table)
    hits_of_cases = [units["hit"].to_numpy(float)]
    cases: list[tuple[str, Any, str, str]] = [("", 0, "", "")]
    order = pd.MultiIndex.from_frame(units[CAPTURE])
    changed = table[table["circumstance"].isin([*case_nouns])]
    for (key, case, level), part in changed.groupby(["circumstance", "case", "level"], sort=False):
        hits_of_cases.append(part.set_index(CAPTURE)["hit"].reindex(order).to_numpy(float))
        cases.append((str(case), level, part["amount"].iloc[0], case_nouns[str(key)]))
    hits = np.column_stack(hits_of_cases)  # [units, cases]
    codes, _ = pd.factorize(units["subject"])
    member = np.eye(codes.max() + 1)[codes].T  # [subjects, units]
    rows, counts, right = [], [], []
    for values, inside, in_cases in _slice_masks(factor_values(units, target)):
        subjects = member[:, inside]
        sums = subjects @ hits[inside][:, : len(cases) if in_cases else 1]
        for case, of_subject in zip(cases, sums.T, strict=False):
            if values or case[0]:
                rows.append((*_slice_name(values, case), *case))
                counts.append(subjects.sum(axis=1))
                right.append(of_subject)
    slices = pd.DataFrame(
        rows, columns=["kind", "slice", "fault", "severity", "amount", "circumstance"]
    )
    shape = len(rows), len(member)
    of_slices = np.reshape(counts, shape), np.reshape(right, shape)
    return _test_slices(slices, *of_slices, member.sum(axis=1), member @ hits[:, 0])


def _slice_masks(
    factors: dict[str, pd.Series],
) -> Iterator[tuple[tuple[tuple[str, str], ...], np.ndarray, bool]]:
    """Yield all units, each value of each factor, and pairs of values.

    The last item is True for slices that are tested in circumstances, too.
    """
    first = next(iter(factors.values()), None)
    if first is None:
        return
    yield (), np.ones(len(first), dtype=bool), True
    masks = {}
    for factor, values in factors.items():
        counts = values.value_counts(sort=False)
        for value in counts.index[counts >= FEWEST]:
            masks[factor, value] = (values == value).to_numpy()
            yield ((factor, value),), masks[factor, value], True
    for one, other in combinations(masks, 2):
        both = masks[one] & masks[other]
        if one[0] != other[0] and both.sum() >= FEWEST:
            yield (one, other), both, False


def _slice_name(
    values: tuple[tuple[str, str], ...], case: tuple[str, Any, str, str]
) -> tuple[str, str]:
    """The kind of a slice and its name."""
    kinds, names = [factor for factor, _ in values], [" ".join(pair) for pair in values]
    name, _, amount, noun = case
    if name:
        kinds, names = [*kinds, noun], [*names, f"{name} {amount}"]
    return " x ".join(kinds), ", ".join(names)


def _test_slices(
    slices: pd.DataFrame,
    counts: np.ndarray,
    right: np.ndarray,
    units: np.ndarray,
    clean: np.ndarray,
) -> pd.DataFrame:
    """Add accuracies and p-values to slices.

    Args:
        slices: a row each.
        counts: units [slices, subjects].
        right: right labels [slices, subjects].
        units: clean units [subjects].
        clean: right labels of clean units [subjects].
    """
    from scipy.stats import binom, false_discovery_control  # heavy, and bench choose needs none

    total, sums = counts.sum(axis=1), right.sum(axis=1)
    overall, usual = clean.sum() / units.sum(), clean / units
    has_units = counts > 0
    single = has_units.sum(axis=1) == 1
    expected = np.where(single, overall, counts @ usual / total)
    by_count = binom.cdf(sums, total, expected)
    difference = np.where(has_units, right / np.where(has_units, counts, 1) - usual, 0)
    # A subject who is only inside the slice, or only outside, says nothing on the difference.
    in_case = (slices["fault"] != "").to_numpy()[:, None]
    compared = (has_units & ((counts < units) | in_case)).sum(axis=1)
    lowest = np.maximum(binom.cdf(0, total, expected), 1 / FLIPS)
    floor = np.where(single, binom.cdf(0, total, overall), np.maximum(0.5**compared, lowest))
    p = np.where(single, by_count, np.maximum(by_count, sign_flip_p_values(difference)))
    if len(units) < few.FEWEST_FOR_TEST:
        p, floor = np.full(len(p), np.nan), np.full(len(p), np.nan)
    tested = (total >= FEWEST) & (floor <= ALPHA)
    corrected = np.full(len(p), np.nan)
    family = correction_families(slices)
    for name in family.unique():
        if (group := tested & (family == name).to_numpy()).any():
            corrected[group] = np.minimum(FAMILIES * false_discovery_control(p[group]), 1)
    return slices.assign(
        captures=total.astype(int),
        subjects=has_units.sum(axis=1),
        right=sums.astype(int),
        accuracy=sums / total,
        gap=overall - sums / total,
        p=p,
        floor=floor,
        tested=tested,
        p_corrected=corrected,
        failing=corrected <= ALPHA,
    )


def correction_families(slices: pd.DataFrame) -> pd.Series:
    """Families for the correction of p: single slices and pairs, clean and in a circumstance."""
    is_pair = slices["kind"].astype(str).str.contains(" x ")
    family = is_pair.map({True: PAIRS, False: SINGLE})
    in_case = family + " under " + slices["circumstance"].astype(str) + "s"
    return family.where(slices["fault"] == "", in_case)


def sign_flip_p_values(difference: np.ndarray) -> np.ndarray:
    """One-sided sign-flip p-values [tests] of differences [tests, subjects].

    p is the share of sign flips whose sum is at or below the observed one.
    """
    tests, subjects = difference.shape
    if subjects <= EXACT_SUBJECTS:
        bits = (np.arange(2**subjects)[:, None] >> np.arange(subjects)) & 1
        signs = 1 - 2 * bits.astype(float)
    else:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (FLIPS, subjects))
        signs[0] = 1  # the observed signs are one of the flips
    p = np.empty(tests)
    for i in range(0, tests, 64):
        part = difference[i : i + 64]
        p[i : i + 64] = (signs @ part.T <= part.sum(axis=1) + 1e-9).mean(axis=0)
    return p
