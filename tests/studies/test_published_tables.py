"""Published numbers recomputed: the papers' own tables against sums done by hand."""

import csv

import numpy as np
import pytest

from bench.reports.comparison import load_published
from studies import published_tables


def test_the_headline_of_cnn85_is_a_macro_precision():
    with (published_tables.FOLDER / "albawi2018_table3.csv").open() as f:
        rows = [[int(v) for v in row[1:]] for row in list(csv.reader(f))[1:]]
    right, total = sum(row[i] for i, row in enumerate(rows)), sum(map(sum, rows))
    columns = [row[i] / sum(r[i] for r in rows) for i, row in enumerate(rows)]
    measured = published_tables.score_counts(published_tables.albawi_counts())
    assert (right, total) == (6650, 10742) == (measured["right"], measured["of"])
    assert (
        measured["macro_precision"]
        == pytest.approx(100 * sum(columns) / 14)
        == pytest.approx(63.71, abs=0.005)
    )
    assert (
        measured["pooled"]
        == pytest.approx(61.91, abs=0.005)
        == pytest.approx(measured["macro_recall"], abs=0.01)
    )


def test_jung_and_hughes_against_their_own_claims():
    jung = published_tables.jung_counts()
    assert published_tables.score_counts(jung)["right"] == 4687 and jung.to_numpy().sum() == 7805
    assert sorted(jung.sum(axis=1).unique()) == [556, 557, 558]  # captures of a gesture in CoST
    rows = published_tables.recompute_accuracies(load_published()).set_index("source")
    rows.index = rows.index.str.extract(r"Table (\w+)")[0]
    agrees = {
        "3": "no",
        "8": "yes",
        "II": "yes",
        "III": "yes",
        "IV": "no",
        "V": "-",
        "VI": "no",
        "VII": "no",
    }
    assert rows["agrees"].to_dict() == agrees and rows.loc["V", "macro_recall"] == pytest.approx(
        37.94, abs=0.005
    )
    whole = {"III": (154, 251), "IV": (137, 251), "VI": (895, 1803), "VII": (771, 2208)}
    assert {n: tuple(rows.loc[n, ["right", "of"]]) for n in whole} == whole


def test_counts_behind_percentages():
    counts, total = published_tables.implied_counts(np.array([50.0, 33.3, 16.7]), 6)
    assert total == 6 and list(counts) == [3, 2, 1]
    counts, total = published_tables.implied_counts(
        np.array([91.9, 2.4, 2.4, 0.8]), 120
    )  # a row of 97.5 %
    assert total == 123 and counts.sum() == 120
    with pytest.raises(ValueError, match="6 to 17"):
        published_tables.implied_counts(np.array([96.3, 3.7]), 6)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        true = rng.multinomial(rng.integers(120, 300), rng.dirichlet(np.ones(14)))
        printed = np.round(100 * true / true.sum(), 1)
        counts, total = published_tables.implied_counts(printed, 120)
        assert total <= true.sum() and np.abs(100 * counts / total - printed).max() <= 0.1001
