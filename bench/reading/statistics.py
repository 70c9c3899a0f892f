"""Tests of differences between systems, paired by subject, because people differ far more than systems do.

Accuracies are of captures, in percent [systems, subjects], means over seeds, the best system first. One procedure
decides every sentence and table: two-sided Wilcoxon tests of each system against the best one, with Holm's correction.
With 10 subjects the smallest p is 0.002, so that from 8 systems on a correction for all 28 pairs leaves nothing below
0.05.
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
PAIRED = 12  # systems whose pairs stand in one matrix


def friedman(subjects: pd.DataFrame) -> tuple[pd.Series, float]:
    """Mean rank of three systems or more, best (1) first, and p of Friedman's test; NaN if that is not defined."""
    subjects = subjects.round(9)
    with np.errstate(
        invalid="ignore", divide="ignore"
    ):  # NaN where all systems are equal on every subject
        p = (
            stats.friedmanchisquare(*subjects.to_numpy()).pvalue
            if subjects.shape[1] >= few.FEWEST_FOR_TEST
            else np.nan
        )
    return subjects.rank(axis=0, ascending=False).mean(axis=1).sort_values(kind="stable"), float(p)


def base_system(subjects: pd.DataFrame, against: str = "") -> str:
    """The system that others are compared with: the one that was asked for where it is there, else the best one."""
    return against if against in subjects.index else str(subjects.index[0])


def compared_systems(subjects: pd.DataFrame, against: str = "") -> pd.DataFrame:
    """The `RANKED` most accurate systems of a table, and the one that others are compared with."""
    return subjects[
        (np.arange(len(subjects)) < RANKED) | (subjects.index == base_system(subjects, against))
    ]


def compare_with_base(
    subjects: pd.DataFrame,
    folds: pd.DataFrame | None = None,
    test_over_train: float | None = None,
    against: str = "",
) -> pd.DataFrame:
    """Every system against the best one, or against another one (`base_system`), by differences within subjects.

    ``folds`` are accuracies by fold, if folds are not subjects; ``test_over_train`` is the number of tested by that of
    training captures of a fold, if folds share training captures. A row per system: `paired_test`, ``p_holm`` (corrected for
    all systems of the table), `nadeau_bengio` (``nb_low``, ``nb_high``, ``nb_p``), `cohen_dz` and `rank_biserial`. NaN
    where something is not defined.
    """
    base = base_system(subjects, against)
    best = subjects.T[base]
    by_system = (subjects if folds is None else folds).T
    rows = []
    for system, accuracy in subjects.iterrows():
        row = {"system": system, "accuracy": accuracy.mean(), "difference": 0.0}
        if system != base:
            row |= paired_test(accuracy, best)
            lost, people = subject_differences(accuracy, best), len(best)
            if test_over_train is not None:
                low, high, p = nadeau_bengio(
                    subject_differences(by_system[system], by_system[base]), test_over_train
                )
                row |= {"nb_low": low, "nb_high": high} if people >= few.FEWEST_FOR_INTERVAL else {}
                row |= {"nb_p": p} if people >= few.FEWEST_FOR_TEST else {}
            row |= dict(zip(("dz", "dz_low", "dz_high"), cohen_dz(lost), strict=True))
            row |= {"rank_biserial": rank_biserial(lost)}
        rows.append(row)
    columns = (
        "system accuracy difference low high nb_low nb_high nb_p p dz dz_low dz_high rank_biserial"
    )
    table = pd.DataFrame(rows, columns=columns.split())
    return table.assign(p_holm=correct_holm(table["p"].to_numpy()))


def subject_differences(one: pd.Series, other: pd.Series) -> np.ndarray:
    """Points that the first system gains on each subject or fold; equal sums in another order are ties."""
    return (one - other).to_numpy(dtype=float).round(9)


def paired_test(one: pd.Series, other: pd.Series) -> dict[str, float]:
    """Two systems over the same subjects: ``difference`` (one minus other, mean over subjects, in points) and its test.

    ``low`` and ``high`` end its 95 % interval, ``p`` is of the two-sided Wilcoxon test, ``gain`` and ``lose`` are the
    numbers of subjects for whom the first system is more and less accurate.
    """
    gained = subject_differences(one, other)
    low, high = wilcoxon_interval(gained)
    counts = {"gain": int((gained > 0).sum()), "lose": int((gained < 0).sum())}
    return {
        "difference": float(gained.mean()),
        "low": low,
        "high": high,
        "p": wilcoxon(gained),
        **counts,
    }


def paired_tests(subjects: pd.DataFrame) -> pd.DataFrame:
    """`paired_test` of every pair of systems: a row per pair, with ``system``, ``other`` and ``p_holm`` over all pairs."""
    every = combinations(subjects.index, 2)
    table = pd.DataFrame(
        [
            {"system": a, "other": b} | paired_test(subjects.loc[a], subjects.loc[b])
            for a, b in every
        ]
    )
    return table.assign(p_holm=correct_holm(table["p"].to_numpy())) if len(table) else table


def nadeau_bengio(differences: np.ndarray, test_over_train: float) -> tuple[float, float, float]:
    """Corrected t-interval and p of a mean difference over folds that share training captures; NaN for one fold.

    The variance is (1 / folds + tested / training captures) times that of the differences (Nadeau and Bengio 2003).
    """
    n = len(differences)
    if n < 2:
        return np.nan, np.nan, np.nan
    mean = differences.mean()
    error = np.sqrt((1 / n + test_over_train) * differences.var(ddof=1))
    half = (
        stats.t.ppf(0.975, n - 1) * error
    )  # bench.values.intervals.mean_interval has the usual error, not this one
    p = 2 * stats.t.sf(abs(mean) / error, n - 1) if error > 0 else (1.0 if mean == 0 else 0.0)
    return float(mean - half), float(mean + half), float(p)


def wilcoxon(differences: np.ndarray) -> float:
    """Two-sided exact p of the signed rank test; NaN for fewer than `bench.values.few.FEWEST_FOR_TEST` subjects.

    Equal differences share their mean rank, zeros are left out.
    """
    if len(differences) < few.FEWEST_FOR_TEST:
        return np.nan
    moved = differences[differences != 0]
    if len(moved) < 2:  # whatever its sign, one alone is as likely
        return 1.0
    halves = np.rint(2 * stats.rankdata(np.abs(moved))).astype(int)  # mean ranks are halves
    gained = halves[moved > 0].sum()
    return float(
        min(
            1,
            2
            * _rank_sum_probabilities(tuple(sorted(halves)))[
                : min(gained, halves.sum() - gained) + 1
            ].sum(),
        )
    )


@lru_cache(maxsize=256)  # where no differences are equal, of all pairs of systems the same
def _rank_sum_probabilities(ranks: tuple[int, ...]) -> np.ndarray:
    """Probability of each sum of ranks, from 0, if each of them counts or not with equal odds."""
    odds = np.zeros(sum(ranks) + 1)
    odds[0] = 1
    for rank in ranks:
        odds[rank:] += odds[:-rank].copy()
        odds /= 2
    return odds


def wilcoxon_interval(differences: np.ndarray) -> tuple[float, float]:
    """95 % interval of a difference by the same test: every shift of the differences that it does not reject.

    Its ends are means of two differences, or one of these (Walsh averages; Hodges and Lehmann 1963). NaN where
    `wilcoxon` has no p.
    """
    n = len(differences)
    if n < few.FEWEST_FOR_TEST:
        return np.nan, np.nan
    means = np.sort(((differences[:, None] + differences) / 2)[np.triu_indices(n)])
    rejected = int((2 * _rank_sum_probabilities(tuple(range(1, n + 1))).cumsum() <= 0.05).sum())
    return float(means[rejected - 1]), float(means[-rejected])


def rank_ranges(subjects: pd.DataFrame) -> pd.DataFrame:
    """The places that each system may have among all, ``best`` to ``worst``: each is tested against all others."""
    values, n = subjects.to_numpy(float), len(subjects)
    p = np.full((n, n), np.nan)
    for i, j in combinations(range(n), 2):
        p[i, j] = p[j, i] = wilcoxon((values[j] - values[i]).round(9))
    worse = np.triu([correct_holm(row) < 0.05 for row in p], 1)
    return pd.DataFrame(
        {"best": 1 + worse.sum(axis=0), "worst": n - worse.sum(axis=1)}, index=subjects.index
    )


def correct_holm(p: np.ndarray) -> np.ndarray:
    """Holm's correction of p-values; NaN are not tests and stay."""
    corrected = np.full(len(p), np.nan)
    order = np.argsort(p)[: int(np.isfinite(p).sum())]
    corrected[order] = np.maximum.accumulate(np.minimum(1, p[order] * np.arange(len(order), 0, -1)))
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
    low, high = (
        special.nctdtrinc(n - 1, level, d * np.sqrt(n)) / np.sqrt(n) for level in (0.975, 0.025)
    )
    return float(d), float(low), float(high)


def rank_biserial(differences: np.ndarray) -> float:
    """Matched-pairs rank-biserial correlation: 1 if all subjects gain, -1 if all lose; 0 where nothing differs."""
    moved = differences[differences != 0]
    if not len(moved):
        return 0.0
    ranks = stats.rankdata(np.abs(moved))
    return float((ranks * np.sign(moved)).sum() / ranks.sum())


def smallest_p(subjects: int, comparisons: int) -> float:
    """Smallest p that the two-sided signed rank test can reach after Holm's correction of so many comparisons."""
    return min(1.0, 2.0 ** (1 - subjects) * comparisons)


def limits_of_conclusions(
    subjects: int, systems: int, folds: int, mixed: bool, selected: bool = True
) -> list[str]:
    """Limits of the conclusions, in sentences; systems are compared with the best one where that was ``selected``."""
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
