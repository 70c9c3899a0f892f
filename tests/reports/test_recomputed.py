"""The papers' own tables, against sums that are done by hand here or printed in the papers."""

import csv
from importlib.resources import files

import numpy as np
import pytest

from reports import published_tables as recomputed
from reports.comparison import published


def rows_of(name):
    with (files("reports") / name).open() as f:
        return list(csv.reader(f))[1:]


def test_the_headline_of_cnn85_is_a_macro_precision():
    rows = [[int(v) for v in row[1:]] for row in rows_of("albawi2018_table3.csv")]
    right = sum(row[i] for i, row in enumerate(rows))
    total = sum(map(sum, rows))
    assert (right, total) == (6650, 10742)
    columns = [row[i] / sum(r[i] for r in rows) for i, row in enumerate(rows)]
    found = recomputed.measures(recomputed.albawi_counts())
    assert found["pooled"] == pytest.approx(100 * 6650 / 10742) and round(found["pooled"], 2) == 61.91
    assert (
        found["macro_precision"] == pytest.approx(100 * sum(columns) / 14)
        and round(found["macro_precision"], 2) == 63.71
    )
    assert round(found["macro_recall"], 2) == 61.91


def test_printed_totals_and_rates_of_cnn85():
    counts = recomputed.albawi_counts()
    assert list(counts.sum(axis=1)) == [808, 289, 1666, 388, 596, 424, 665, 1208, 969, 349, 715, 931, 362, 1372]
    assert list(counts.sum()) == [806, 261, 1706, 342, 637, 409, 687, 994, 1045, 310, 730, 895, 302, 1618]
    rates = 100 * np.diag(counts) / counts.sum()
    printed = [68.5, 75.86, 63.89, 64.33, 61.54, 72.37, 67.1, 58.35, 50.05, 74.19, 47.26, 66.03, 61.6, 60.93]
    assert rates.to_numpy() == pytest.approx(printed, abs=0.015)  # 66.03 is printed as 66.3


def test_squeeze_and_stroke_are_exchanged():
    found = recomputed.swaps(recomputed.albawi_counts(), recomputed.jung_counts())
    assert len(found) == 1 + 14 * 13 // 2
    assert set(found.iloc[0][["first", "second"]]) == {"squeeze", "stroke"}
    assert found.iloc[0]["correlation"] > 0.8 and found[found["first"] == ""]["correlation"].item() < 0.5


def test_swaps_undo_an_exchange_that_was_made():
    counts = recomputed.jung_counts()
    names = {"pat": "rub", "rub": "pat"}
    best = recomputed.swaps(counts.rename(index=names, columns=names), counts).iloc[0]
    assert {best["first"], best["second"]} == {"pat", "rub"} and best["correlation"] == pytest.approx(1)


def test_jung_2017_agrees_with_itself():
    counts = recomputed.jung_counts()
    assert recomputed.measures(counts)["right"] == 4687 and counts.to_numpy().sum() == 7805
    assert sorted(counts.sum(axis=1).unique()) == [556, 557, 558]  # captures of a gesture in CoST
    subjects = recomputed.subjects_of_jung()
    assert subjects.shape == (5, 31)
    assert subjects.mean(axis=1).round().to_dict() == {
        "Bayesian": 57,
        "Decision tree": 48,
        "SVM linear": 59,
        "SVM RBF": 60,
        "Neural network": 59,
    }
    assert subjects.std(axis=1, ddof=1).round().to_list() == [11, 10, 11, 11, 12]


def test_tables_of_hughes_2017_against_its_summary():
    rows = recomputed.recomputed(published()).set_index("source")
    agrees = {s.split("Table ")[1].split(" ")[0]: r for s, r in rows["agrees"].items() if s.startswith("Hughes")}
    assert agrees == {"II": "yes", "III": "yes", "IV": "no", "V": "-", "VI": "no", "VII": "no"}
    whole = {"III": (154, 251), "IV": (137, 251), "VI": (895, 1803), "VII": (771, 2208)}
    for number, (right, of) in whole.items():
        row = rows[rows.index.str.contains(f"Table {number} ")].iloc[0]
        assert (row["right"], row["of"]) == (right, of)
    assert rows.loc["Hughes et al. 2017, Table V (CoST)", "macro_recall"] == pytest.approx(37.94, abs=0.005)


def test_counts_behind_percentages():
    counts, total = recomputed.implied_counts(np.array([50.0, 33.3, 16.7]), 6)
    assert total == 6 and list(counts) == [3, 2, 1]
    counts, total = recomputed.implied_counts(np.array([91.9, 2.4, 2.4, 0.8]), 120)  # a row of 97.5 %
    assert total == 123 and counts.sum() == 120
    with pytest.raises(ValueError, match="no total from 6 to 17"):
        recomputed.implied_counts(np.array([96.3, 3.7]), 6)


@pytest.mark.parametrize("seed", range(5))
def test_implied_counts_give_the_printed_percentages(seed):
    rng = np.random.default_rng(seed)
    true = rng.multinomial(rng.integers(120, 300), rng.dirichlet(np.ones(14)))
    printed = np.round(100 * true / true.sum(), 1)
    counts, total = recomputed.implied_counts(printed, 120)
    assert total <= true.sum() and np.abs(100 * counts / total - printed).max() <= 0.1001


def test_sentences_tell_the_numbers():
    said = " ".join(recomputed.findings(published()))
    for number in ("63.7 %", "6650 of 10742", "61.91 %", "137 of 251", "895 of 1803", "771 of 2208"):
        assert number in said
