"""Statistical tests against scipy, sums by hand and published tables."""

import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bench.reading import statistics
from studies.published_tables import read_table

RNG = np.random.default_rng(0)


def signed_rank_by_hand(differences):
    """Two-sided p by going through every way to give signs to the ranks."""
    moved = differences[differences != 0]
    ranks = stats.rankdata(np.abs(moved))
    own = (ranks * np.sign(moved)).sum()
    all_ = [np.dot(signs, ranks) for signs in itertools.product((-1, 1), repeat=len(moved))]
    return min(
        1,
        2 * min(np.mean([s <= own + 1e-9 for s in all_]), np.mean([s >= own - 1e-9 for s in all_])),
    )


@pytest.mark.parametrize("n", [6, 7, 9])
def test_signed_ranks_are_exact_with_and_without_ties(n):
    untied = RNG.normal(1, 2, n)
    assert statistics.wilcoxon(untied) == pytest.approx(
        stats.wilcoxon(untied, method="exact").pvalue
    )
    tied = RNG.integers(-2, 4, n).astype(float)
    assert statistics.wilcoxon(tied) == pytest.approx(signed_rank_by_hand(tied))


def test_signed_ranks_of_many_subjects_and_of_none_that_differ():
    many = RNG.normal(0.3, 1, 40)
    assert statistics.wilcoxon(many) == pytest.approx(stats.wilcoxon(many).pvalue)
    assert statistics.wilcoxon(np.zeros(8)) == 1 and np.isnan(statistics.wilcoxon(np.ones(5)))
    assert statistics.wilcoxon(np.array([0, 0, 0.1, 0, 0, 0])) == 1
    assert statistics.wilcoxon(np.array([0.0, 0, 1, 2, 3, -4])) == 14 / 16  # zeros take no rank
    tied = RNG.integers(-3, 5, 15).astype(float)
    assert statistics.wilcoxon(tied) == pytest.approx(signed_rank_by_hand(tied))


@pytest.mark.parametrize("n", [6, 8, 10, 12])
def test_the_interval_of_a_difference_has_the_shifts_that_the_test_does_not_reject(n):
    d = RNG.normal(1, 2, n)
    low, high = statistics.wilcoxon_interval(d)
    for end, inwards in ((low, 1e-6), (high, -1e-6)):
        assert (
            signed_rank_by_hand(d - end - inwards) > 0.05 >= signed_rank_by_hand(d - end + inwards)
        )
    assert statistics.wilcoxon_interval(np.array([3.0, -1, 4, 1, 5, 9])) == (
        -1,
        9,
    )  # of six, the whole range
    assert np.isnan(statistics.wilcoxon_interval(d[:5])).all()
    test = statistics.paired_test(pd.Series(d), pd.Series(np.zeros(n)))
    assert (test["p"] < 0.05) == (test["low"] > 0 or test["high"] < 0)


def test_places_by_hand():
    """Eight people: b loses a point with each (p = 2 / 2 ** 8), c with four (1 / 8), d and e three.

    In tests of one system against the four others, the least p after Holm is 4 / 128. d and e are
    below a, b and c. b is below a, c is not below a or b.
    """
    rows = {
        "a": [70.0] * 8,
        "c": [70.0, 69.0] * 4,
        "b": [69.0] * 8,
        "d": [66.0] * 8,
        "e": [66.0, 65.9] * 4,
    }
    subjects = pd.DataFrame.from_dict(rows, orient="index")
    places = statistics.rank_ranges(subjects)
    assert places.agg(tuple, axis=1).to_dict() == {
        "a": (1, 2),
        "c": (1, 3),
        "b": (2, 3),
        "d": (4, 5),
        "e": (4, 5),
    }
    assert (
        statistics.rank_ranges(subjects.iloc[:, :5]).agg(tuple, axis=1).tolist() == [(1, 5)] * 5
    )  # nobody is tested


def test_nadeau_and_bengio_widen_the_variance_by_hand():
    d = np.array([1.0, 3.0, 2.0, 6.0])  # mean 3, variance 14 / 3
    low, high, p = statistics.nadeau_bengio(d, 1 / 3)
    error = np.sqrt((1 / 4 + 1 / 3) * 14 / 3)
    half = 3.182446305 * error  # t of 3 degrees of freedom
    assert (low, high) == pytest.approx((3 - half, 3 + half), rel=1e-6)
    assert p == pytest.approx(2 * stats.t.sf(3 / error, 3))
    plain = stats.ttest_1samp(d, 0)
    assert statistics.nadeau_bengio(d, 0.0)[2] == pytest.approx(plain.pvalue) and p > plain.pvalue
    assert statistics.nadeau_bengio(np.zeros(4), 1 / 3) == (0, 0, 1)


def test_friedman_of_jung_2017():
    subjects = 100 * read_table("jung2017_table7").T
    ranks, p = statistics.friedman(subjects)
    by_subject = [stats.rankdata(-column) for column in subjects.to_numpy().T]
    assert ranks[subjects.index].tolist() == pytest.approx(np.mean(by_subject, axis=0))
    chi2 = 12 * 31 * ((ranks - 3) ** 2).sum() / (5 * 6)  # Friedman's; equal ranks make it larger
    assert ranks.index[0] == "SVM RBF" and p <= stats.chi2.sf(chi2, 4) < 10 * p
    assert np.isnan(statistics.friedman(0 * subjects)[1])  # systems that never differ


@given(st.lists(st.integers(-5, 5), min_size=1, max_size=8))
def test_rank_biserial_by_pairs(values):
    d = np.array(values, dtype=float)
    ranks = stats.rankdata(np.abs(d[d != 0])) if d.any() else np.array([])
    won = sum(r for r, v in zip(ranks, d[d != 0], strict=True) if v > 0)
    expected = (2 * won - ranks.sum()) / ranks.sum() if len(ranks) else 0
    assert statistics.rank_biserial(d) == pytest.approx(expected)


def test_cohens_dz_and_its_interval():
    d = RNG.normal(2, 3, 10)
    dz, low, high = statistics.cohen_dz(d)
    assert dz == pytest.approx(d.mean() / d.std(ddof=1))
    t = stats.ttest_1samp(d, 0).statistic
    assert stats.nct.cdf(t, 9, low * np.sqrt(10)) == pytest.approx(0.975, abs=1e-4)
    assert stats.nct.cdf(t, 9, high * np.sqrt(10)) == pytest.approx(0.025, abs=1e-4)
    assert all(np.isnan(statistics.cohen_dz(np.full(5, 2.0)))) and all(
        np.isnan(statistics.cohen_dz(np.array([1.0])))
    )


def test_holm_by_hand_and_without_tests():
    p = np.array([np.nan, 0.01, 0.04, 0.03, np.nan])
    assert statistics.correct_holm(p)[1:4] == pytest.approx([0.03, 0.06, 0.06])
    assert (
        np.isnan(statistics.correct_holm(p)[[0, 4]]).all()
        and np.isnan(statistics.correct_holm(np.array([np.nan]))).all()
    )


def test_differences_are_from_the_best_and_equal_sums_are_ties():
    rows = [[60.0, 70, 80] * 2, [30 + 30.0, 70, 80 + 1e-13] * 2, [50.0, 60, 75] * 2]
    subjects = pd.DataFrame(rows, index=["a", "b", "c"])
    rows = statistics.compare_with_base(subjects, None, 0.5).set_index("system")
    assert (
        np.isnan(rows.loc["a", "p"])
        and rows.loc["b", "difference"] == 0
        and rows.loc["b", "p"] == 1
    )
    assert (
        rows.loc["c", "difference"] == pytest.approx(-25 / 3)
        and rows.loc["c", "rank_biserial"] == -1
    )
    assert rows.loc["c", "nb_low"] < rows.loc["c", "low"]


def test_folds_that_are_not_subjects_are_corrected_as_folds():
    subjects = pd.DataFrame(
        [[60.0, 70, 80, 60, 50, 50], [50.0, 60, 75, 58, 49, 45]], index=["a", "b"]
    )
    folds = pd.DataFrame([[65.0, 70], [55.0, 66]], index=["a", "b"])
    row = statistics.compare_with_base(subjects, folds, 1.0).set_index("system").loc["b"]
    assert (row["nb_low"], row["nb_high"], row["nb_p"]) == statistics.nadeau_bengio(
        np.array([-10.0, -4]), 1.0
    )
