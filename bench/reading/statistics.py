"""Tests of differences between systems, paired by subject: people differ more than systems do.

Accuracies are of captures, in percent [systems, subjects], means over seeds, the best system first.
One procedure decides every sentence and table: two-sided Wilcoxon tests of each system against the
best one, with Holm's correction. With 10 subjects the smallest p is 0.002, so that from 8 systems
on a correction for all 28 pairs leaves nothing below 0.05.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import special, stats

from bench.values import few
from bench.values.intervals import mean_interval as mean_interval
from bench.values.result import MIXED_NOTE
from bench.values.sentences import render_sentences

RANKED = 30  # systems that are compared in one table and diagram
PAIRED = 12  # systems whose pairs are in one matrix


def friedman(subjects: pd.DataFrame) -> tuple[pd.Series, float]:
    """Mean rank of three or more systems, best (1) first, and p of Friedman's test, NaN without."""
    subjects, p = subjects.round(9), np.nan
    if subjects.shape[1] >= few.FEWEST_FOR_TEST:
        # NaN if all systems are equal on every subject.
        with np.errstate(invalid="ignore", divide="ignore"):
            p = float(stats.friedmanchisquare(*subjects.to_numpy()).pvalue)
    ranks = subjects.rank(axis=0, ascending=False).mean(axis=1)
    return ranks.sort_values(kind="stable"), p


def base_system(subjects: pd.DataFrame, against: str = "") -> str:
    """The system with which others are compared: ``against`` if it is there, else the best one."""
    return against if against in subjects.index else str(subjects.index[0])


def compared_systems(subjects: pd.DataFrame, against: str = "") -> pd.DataFrame:
    """The `RANKED` most accurate systems of a table, and the one they are compared with."""
    first = np.arange(len(subjects)) < RANKED
    return subjects[first | (subjects.index == base_system(subjects, against))]


def compare_with_base(
    subjects: pd.DataFrame,
    folds: pd.DataFrame | None = None,
    test_over_train: float | None = None,
    against: str = "",
) -> pd.DataFrame:
    """Compare every system with the best one, or another (`base_system`), within subjects.

    Args:
        subjects: accuracies [systems, subjects].
        folds: accuracies [systems, folds], if folds are not subjects.
        test_over_train: number of tested by that of training captures of a fold, if folds share
            training captures.
        against: the system with which the others are compared; empty for the best.

    Returns:
        A row per system: `paired_test`, ``p_holm`` (corrected for all systems of the table),
        `nadeau_bengio` (``nb_low``, ``nb_high``, ``nb_p``), `cohen_dz` and `rank_biserial`; NaN if
        a number is not defined.
    """
    base = base_system(subjects, against)
    columns, people = subjects.T, subjects.shape[1]  # a column for each system
    by_fold = (subjects if folds is None else folds).T
    rows = []
    for system, accuracy in subjects.iterrows():
        row = {"system": system, "accuracy": accuracy.mean(), "difference": 0.0}
        rows.append(row)
        if system == base:
            continue
        row |= paired_test(accuracy, columns[base])
        gained = subject_differences(accuracy, columns[base])
        if test_over_train is not None:
            by_folds = subject_differences(by_fold[system], by_fold[base])
            low, high, p = nadeau_bengio(by_folds, test_over_train)
            row |= {"nb_low": low, "nb_high": high} if people >= few.FEWEST_FOR_INTERVAL else {}
            row |= {"nb_p": p} if people >= few.FEWEST_FOR_TEST else {}
        row["dz"], row["dz_low"], row["dz_high"] = cohen_dz(gained)
        row["rank_biserial"] = rank_biserial(gained)
    names = (
        "system accuracy difference low high nb_low nb_high nb_p p dz dz_low dz_high rank_biserial"
    )
    table = pd.DataFrame(rows, columns=names.split())
    return table.assign(p_holm=correct_holm(table["p"].to_numpy()))


def subject_differences(first: pd.Series, second: pd.Series) -> np.ndarray:
    """Points that the first system gains on each subject; equal sums in another order are ties."""
    return (first - second).to_numpy(dtype=float).round(9)


def paired_test(first: pd.Series, second: pd.Series) -> dict[str, float]:
    """Test two systems on the same subjects.

    Returns:
        ``difference`` (one minus other, mean over subjects, in points) with the ends of its 95 %
        interval (``low``, ``high``), ``p`` of the two-sided Wilcoxon test, and the numbers of
        subjects for whom the first system is more (``gain``) and less accurate (``lose``).
    """
    gained = subject_differences(first, second)
    low, high = wilcoxon_interval(gained)
    test = {"difference": float(gained.mean()), "low": low, "high": high, "p": wilcoxon(gained)}
    return test | {"gain": int((gained > 0).sum()), "lose": int((gained < 0).sum())}


def paired_tests(subjects: pd.DataFrame) -> pd.DataFrame:
    """Test every pair of systems: a row per pair, with ``system``, ``other`` and ``p_holm``."""
    rows = []
    for first, second in combinations(subjects.index, 2):
        test = paired_test(subjects.loc[first], subjects.loc[second])
        rows.append({"system": first, "other": second} | test)
    table = pd.DataFrame(rows)
    return table.assign(p_holm=correct_holm(table["p"].to_numpy())) if rows else table


def nadeau_bengio(differences: np.ndarray, test_over_train: float) -> tuple[float, float, float]:
    """Corrected t-interval and p of a mean difference over folds that share training captures.

    The variance is (1 / folds + tested / training captures) times that of the differences (Nadeau
    and Bengio 2003). NaN for one fold.
    """
    n = len(differences)
    if n < 2:
        return np.nan, np.nan, np.nan
    mean = differences.mean()
    # The usual error is that of bench.values.intervals.mean_interval.
    error = np.sqrt((1 / n + test_over_train) * differences.var(ddof=1))
    half = stats.t.ppf(0.975, n - 1) * error
    p = float(mean == 0)
    if error > 0:
        p = 2 * stats.t.sf(abs(mean) / error, n - 1)
    return float(mean - half), float(mean + half), float(p)


def wilcoxon(differences: np.ndarray) -> float:
    """Two-sided exact p of the signed rank test; NaN for too few subjects for a test.

    Equal differences share their mean rank, zeros are left out.
    """
    if len(differences) < few.FEWEST_FOR_TEST:
        return np.nan
    nonzero = differences[differences != 0]
    if len(nonzero) < 2:  # a single difference has either sign with equal odds
        return 1.0
    halves = np.rint(2 * stats.rankdata(np.abs(nonzero))).astype(int)  # mean ranks are halves
    gained = halves[nonzero > 0].sum()
    smaller = min(gained, halves.sum() - gained)
    probabilities = _rank_sum_probabilities(tuple(sorted(halves)))
    return float(min(1, 2 * probabilities[: smaller + 1].sum()))


@lru_cache(maxsize=256)  # without ties, all pairs of systems have the same ranks
def _rank_sum_probabilities(ranks: tuple[int, ...]) -> np.ndarray:
    """Probability of each sum of ranks, from 0, if each rank counts or not with equal odds."""
    odds = np.zeros(sum(ranks) + 1)
    odds[0] = 1
    for rank in ranks:
        odds[rank:] += odds[:-rank].copy()
        odds /= 2
    return odds


def wilcoxon_interval(differences: np.ndarray) -> tuple[float, float]:
    """95 % interval of a difference by `wilcoxon`: every shift that the test does not reject.

    Its ends are means of two differences, or one of these (Walsh averages; Hodges and Lehmann
    1963). NaN if `wilcoxon` has no p.
    """
    n = len(differences)
    if n < few.FEWEST_FOR_TEST:
        return np.nan, np.nan
    means = np.sort(((differences[:, None] + differences) / 2)[np.triu_indices(n)])
    probabilities = _rank_sum_probabilities(tuple(range(1, n + 1)))
    rejected = int((2 * probabilities.cumsum() <= 0.05).sum())
    return float(means[rejected - 1]), float(means[-rejected])


def rank_ranges(subjects: pd.DataFrame) -> pd.DataFrame:
    """The ranks that each system may have, ``best`` to ``worst``, by tests against all others."""
    values, n = subjects.to_numpy(float), len(subjects)
    p = np.full((n, n), np.nan)
    for i, j in combinations(range(n), 2):
        p[i, j] = p[j, i] = wilcoxon((values[j] - values[i]).round(9))
    worse = np.triu([correct_holm(row) < 0.05 for row in p], 1)
    ranks = {"best": 1 + worse.sum(axis=0), "worst": n - worse.sum(axis=1)}
    return pd.DataFrame(ranks, index=subjects.index)


def correct_holm(p: np.ndarray) -> np.ndarray:
    """Holm's correction of p-values; NaN are not tests and stay."""
    corrected, tests = np.full(len(p), np.nan), int(np.isfinite(p).sum())
    order = np.argsort(p)[:tests]
    multiplied = np.minimum(1, p[order] * np.arange(tests, 0, -1))
    corrected[order] = np.maximum.accumulate(multiplied)
    return corrected


def cohen_dz(differences: np.ndarray) -> tuple[float, float, float]:
    """Mean difference over its SD, with a 95 % interval from the noncentral t distribution."""
    n = len(differences)
    sd = differences.std(ddof=1) if n > 1 else 0.0
    if sd < 1e-9:
        return np.nan, np.nan, np.nan
    d = differences.mean() / sd
    if n < few.FEWEST_FOR_INTERVAL:
        return float(d), np.nan, np.nan
    low, high = special.nctdtrinc(n - 1, np.array([0.975, 0.025]), d * np.sqrt(n)) / np.sqrt(n)
    return float(d), float(low), float(high)


def rank_biserial(differences: np.ndarray) -> float:
    """Matched-pairs rank-biserial correlation: 1 if all subjects gain, -1 if all lose."""
    nonzero = differences[differences != 0]
    if not len(nonzero):
        return 0.0
    ranks = stats.rankdata(np.abs(nonzero))
    return float((ranks * np.sign(nonzero)).sum() / ranks.sum())


def smallest_p(subjects: int, comparisons: int) -> float:
    """Smallest p of the signed rank test after Holm's correction of so many comparisons."""
    return min(1.0, 2.0 ** (1 - subjects) * comparisons)


def limits_of_conclusions(
    subjects: int, systems: int, folds: int, mixed: bool, selected: bool = True
) -> list[str]:
    """Limits of the conclusions, in sentences; ``selected``: the base is the best system."""
    return render_sentences(
        *("bench.reading", "choice", "limits"),
        few=few.too_few_sentence(subjects),
        least=smallest_p(subjects, systems - 1),
        alone=smallest_p(subjects, 1),
        subjects=subjects,
        systems=systems,
        folds=folds,
        mixed=MIXED_NOTE if mixed else "",
        selected=selected,
    )
