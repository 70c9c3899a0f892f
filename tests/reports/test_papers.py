"""Published numbers: the papers' own tables against sums done by hand, and ours beside them with a verdict."""

import csv
from importlib.resources import files

import numpy as np
import pandas as pd
import pytest

from bench.outcomes import scores
from bench.outcomes.runs import grouped
from reports import published_tables, reproduction
from reports.bootstrap import macro_interval, recall_interval
from reports.comparison import comparison, published
from reports.papers import published_section
from tests.results import evaluated, made_up

CHALLENGE = {"data": "haart", "synthetic": "false", "protocol": "challenge"}


def beside(*runs):
    """Results of systems on HAART, and the published numbers beside them."""
    results = [evaluated(system, predictions, **CHALLENGE | about) for system, predictions, about in runs]
    return results, reproduction.against(published(), results).set_index("id")


def test_the_headline_of_cnn85_is_a_macro_precision():
    with (files("reports") / "albawi2018_table3.csv").open() as f:
        rows = [[int(v) for v in row[1:]] for row in list(csv.reader(f))[1:]]
    right, total = sum(row[i] for i, row in enumerate(rows)), sum(map(sum, rows))
    columns = [row[i] / sum(r[i] for r in rows) for i, row in enumerate(rows)]
    measured = published_tables.measures(published_tables.albawi_counts())
    assert (right, total) == (6650, 10742) == (measured["right"], measured["of"])
    assert measured["macro_precision"] == pytest.approx(100 * sum(columns) / 14) == pytest.approx(63.71, abs=0.005)
    assert measured["pooled"] == pytest.approx(61.91, abs=0.005) == pytest.approx(measured["macro_recall"], abs=0.01)


def test_jung_and_hughes_against_their_own_claims():
    jung = published_tables.jung_counts()
    assert published_tables.measures(jung)["right"] == 4687 and jung.to_numpy().sum() == 7805
    assert sorted(jung.sum(axis=1).unique()) == [556, 557, 558]  # captures of a gesture in CoST
    assert published_tables.subjects_of_jung().shape == (5, 31)
    rows = published_tables.recomputed(published()).set_index("source")
    rows.index = rows.index.str.extract(r"Table (\w+)")[0]
    agrees = {"3": "no", "8": "yes", "II": "yes", "III": "yes", "IV": "no", "V": "-", "VI": "no", "VII": "no"}
    assert rows["agrees"].to_dict() == agrees and rows.loc["V", "macro_recall"] == pytest.approx(37.94, abs=0.005)
    whole = {"III": (154, 251), "IV": (137, 251), "VI": (895, 1803), "VII": (771, 2208)}
    assert {n: tuple(rows.loc[n, ["right", "of"]]) for n in whole} == whole


def test_counts_behind_percentages():
    counts, total = published_tables.implied_counts(np.array([50.0, 33.3, 16.7]), 6)
    assert total == 6 and list(counts) == [3, 2, 1]
    counts, total = published_tables.implied_counts(np.array([91.9, 2.4, 2.4, 0.8]), 120)  # a row of 97.5 %
    assert total == 123 and counts.sum() == 120
    with pytest.raises(ValueError, match="6 to 17"):
        published_tables.implied_counts(np.array([96.3, 3.7]), 6)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        true = rng.multinomial(rng.integers(120, 300), rng.dirichlet(np.ones(14)))
        printed = np.round(100 * true / true.sum(), 1)
        counts, total = published_tables.implied_counts(printed, 120)
        assert total <= true.sum() and np.abs(100 * counts / total - printed).max() <= 0.1001


def test_which_run_stands_beside_which_number():
    papers = published()
    results, table = beside(
        ("ta2015_rf", made_up(3, seed=2), {"seed": 2}),
        ("ta2015_rf", made_up(3), {"seed": 0}),
        ("ta2015_rf", made_up(8), {"synthetic": "true", "data": "synth"}),
        ("hughes2017_cnn[epochs=3]", made_up(windows=3), {}),
        ("gaus2015_rf", made_up(8), {"failed": 2}),
        ("hughes2015_softmax", made_up(1), {"official_split": "false"}),
        ("hughes2017_ae_rnn", made_up(8), {}),
    )
    assert set(table.index) == set(papers["id"]) >= set(reproduction.corrections().index)
    assert (table.loc[table["data"] == "cost", "verdict"] == "data not here").all()
    ours = table.loc["ta2015-haart-test"]
    assert list(ours["seed"]) == ["0", "2"] and list(ours["subjects"]) == [3, 3]
    assert (ours["difference"] - ours["ours"]).tolist() == pytest.approx([-70.91] * 2)
    expected = {
        "hughes2017-haart-cnn": ("not run", "hughes2017_cnn[epochs=3]"),
        "gaus2015-haart-test": ("not run", "8 of 10"),
        "hughes2015-haart-test": ("no interval", "not the official"),
        "almashhadani2021-haart": ("not run", "not published"),
        "zhou2016-haart-3dcnn": ("not run", ""),
    }
    for name, (verdict, note) in expected.items():
        assert table.loc[name, "verdict"] == verdict and note in table.loc[name, "note"], name
    assert np.isfinite(table.loc["hughes2017-haart-ae-rnn", "ours"])  # a vote where there is one decision a capture
    section = published_section(table.reset_index())
    printed = [row["ours % [95 %]"] for row in section["table"].texts if row["system"].startswith("Ta et al. 2015")]
    assert [*filter("-".__ne__, printed)] == [f"{r.ours:.1f} [{r.low:.1f}, {r.high:.1f}]" for r in ours.itertuples()]
    assert sum(section["counts"].values()) == table["ours"].notna().sum() and section["few"] == 3 and section["haart"]
    shown = comparison(grouped(results), papers).groupby(["data", "system"])["published"].agg(set)
    assert shown[("haart", "ta2015_rf")] == {"70.91 (capture, ta2015-haart-test)"}
    assert shown[("synth (synthetic)", "ta2015_rf")] == {""} == shown[("haart", "hughes2017_cnn[epochs=3]")]


def test_units_and_their_intervals():
    predictions = made_up(6, windows=3, skill=0.5)
    _, table = beside(("cnn85", predictions, {"data": "cost", "protocol": "loso"}))
    decided = scores.windows(predictions)
    per_class = scores.per_class(decided, scores.classes_of(predictions))
    low, high = scores.subject_interval(decided)
    pooled, headline = table.loc["albawi2018-pooled"], table.loc["albawi2018-headline"]
    hit = (decided["true"] == decided["predicted"]).mean()
    assert pooled[["ours", "low", "high"]].tolist() == pytest.approx([100 * hit, 100 * low, 100 * high])
    assert headline["ours"] == pytest.approx(100 * per_class["precision"].mean())
    assert headline["low"] < headline["ours"] < headline["high"] and "macro precision" in headline["note"]


def test_intervals_of_classes_by_a_plain_loop():
    labelled = scores.captures(made_up(5, skill=0.4, seed=3))
    classes = ["pat", "rub", "tap"]
    names = sorted(labelled["subject"].unique())
    draws = [
        scores.per_class(
            pd.concat(
                [labelled[labelled["subject"] == n] for n, k in zip(names, times, strict=True) for _ in range(k)]
            ),
            classes,
        )
        for times in np.random.default_rng(0).multinomial(5, np.full(5, 0.2), 20)
    ]
    for metric in ("precision", "recall"):
        ends = np.quantile([table[metric].mean() for table in draws], [0.025, 0.975])
        assert macro_interval(labelled, classes, f"macro_{metric}", draws=20) == pytest.approx(tuple(ends))
    recalls = np.array([100 * table["recall"].to_numpy() for table in draws])
    ours = recall_interval(labelled, classes, draws=20)
    assert ours[["low", "high"]].to_numpy().T == pytest.approx(np.quantile(recalls, [0.025, 0.975], axis=0))
    one = labelled[labelled["subject"] == "1"]
    assert (
        np.isnan(macro_interval(one, classes, "macro_recall")).all()
        and recall_interval(one, classes)["low"].isna().all()
    )
    labelled = pd.DataFrame({"subject": list("aabb"), "true": ["x", "y", "x", "x"], "predicted": ["x", "x", "y", "x"]})
    table = recall_interval(labelled, ["x", "y", "z"])
    assert table.loc["x"].tolist() == pytest.approx([200 / 3, 50, 100]) and table.loc["y", "recall"] == 0
    assert table.loc["z"].isna().all()
