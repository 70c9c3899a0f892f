"""Published numbers, and ours beside them with a verdict."""

import numpy as np
import pandas as pd
import pytest

from bench.reading.frame import group_results
from bench.reports import papers as reproduction
from bench.reports.comparison import comparison_table, load_published, score_rows
from bench.reports.details import macro_interval, recall_interval
from bench.values import scores
from tests.reading.results import make_predictions, make_run

CHALLENGE = {"data": "haart", "synthetic": "false", "protocol": "challenge"}


def beside(*runs):
    """Results of systems on HAART, and the published numbers beside them."""
    results = [
        make_run(system, predictions, **CHALLENGE | about) for system, predictions, about in runs
    ]
    return results, reproduction.compare_with_published(results).set_index("id")


def test_which_run_stands_beside_which_number():
    results, table = beside(
        ("ta2015_rf", make_predictions(3, seed=2), {"seed": 2}),
        ("ta2015_rf", make_predictions(3), {"seed": 0}),
        ("ta2015_rf", make_predictions(8), {"synthetic": "true", "data": "synth"}),
        ("hughes2017_cnn[epochs=3]", make_predictions(windows=3), {}),
        ("gaus2015_rf", make_predictions(8), {"failed": 2}),
        ("hughes2015_softmax", make_predictions(1), {"official_split": "false"}),
        ("hughes2017_ae_rnn", make_predictions(8), {}),
    )
    assert set(table.index) == set(load_published()["id"])
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
    assert np.isfinite(
        table.loc["hughes2017-haart-ae-rnn", "ours"]
    )  # a vote where there is one decision a capture
    section = reproduction.published_section(table.reset_index())
    rows = [row for row in section["here"].texts if row["system"].startswith("Ta et al. 2015")]
    printed = [row["ours % [95 %]"] for row in rows]
    assert [*filter("-".__ne__, printed)] == [
        f"{each:.1f}" for each in ours["ours"]
    ]  # of three subjects
    assert "3 subjects: too few for an interval" in {row["verdict"] for row in rows}
    assert sum(section["counts"].values()) == table["ours"].notna().sum()
    assert len(section["here"]) + len(section["away"]) == len(table)
    beside_ours = comparison_table(score_rows(group_results(results))).groupby(["data", "system"])[
        "published"
    ]
    shown = beside_ours.agg(lambda each: {*each.dropna()})
    assert shown[("haart", "ta2015_rf")] == {"70.91 (capture, ta2015-haart-test)"}
    assert (
        shown[("synth (synthetic)", "ta2015_rf")]
        == set()
        == shown[("haart", "hughes2017_cnn[epochs=3]")]
    )


@pytest.mark.parametrize(
    "mark", [{"touchbench.depends_on_batch": "true"}, {"touchbench.conditions": "subject"}]
)
def test_a_run_on_the_batch_or_on_conditions_is_no_published_system(mark):
    results, table = beside(("ta2015_rf", make_predictions(3), mark))
    (shown,) = comparison_table(score_rows(group_results(results))).itertuples()
    assert shown.system == results[0].system != "ta2015_rf" and pd.isna(shown.published)
    row = table.loc["ta2015-haart-test"]
    assert row["verdict"] == "not run" and results[0].system in row["note"]


def test_units_and_their_intervals():
    predictions = make_predictions(6, windows=3, skill=0.5)
    _, table = beside(("cnn85", predictions, {"data": "cost", "protocol": "loso"}))
    decided = scores.label_windows(predictions)
    per_class = scores.scores_by_class(decided, scores.classes_of(predictions))
    low, high = scores.pooled_accuracy_interval(decided)
    pooled, headline = table.loc["albawi2018-pooled"], table.loc["albawi2018-headline"]
    hit = (decided["true"] == decided["predicted"]).mean()
    assert pooled[["ours", "low", "high"]].tolist() == pytest.approx(
        [100 * hit, 100 * low, 100 * high]
    )
    assert headline["ours"] == pytest.approx(100 * per_class["precision"].mean())
    assert (
        headline["low"] < headline["ours"] < headline["high"]
        and "macro precision" in headline["note"]
    )


def test_intervals_of_classes_by_a_plain_loop():
    labelled, classes = (
        scores.label_captures(make_predictions(5, skill=0.4, seed=3)),
        ["pat", "rub", "tap"],
    )
    labelled.loc[labelled["subject"] == "2", "predicted"] = [
        "",
        *labelled["predicted"][labelled["subject"] == "2"][1:],
    ]
    parts = [part for _, part in labelled.groupby("subject", sort=True)]
    draws = []
    for times in np.random.default_rng(0).multinomial(5, np.full(5, 0.2), 20):
        drawn = [part for part, k in zip(parts, times, strict=True) for _ in range(k)]
        draws.append(scores.scores_by_class(pd.concat(drawn), classes))
    for metric in ("precision", "recall"):
        ends = np.quantile([table[metric].mean() for table in draws], [0.025, 0.975])
        assert macro_interval(labelled, classes, f"macro_{metric}", draws=20) == pytest.approx(
            tuple(ends)
        )
    recalls = np.array([100 * table["recall"].to_numpy() for table in draws])
    ours = recall_interval(labelled, classes, draws=20)
    assert ours[["low", "high"]].to_numpy().T == pytest.approx(
        np.quantile(recalls, [0.025, 0.975], axis=0)
    )
    assert np.isnan(macro_interval(parts[0], classes, "macro_recall")).all()
    rows = {
        "subject": list("aabbccddee"),
        "true": ["x", "y", *"xxxxxxxx"],
        "predicted": [*"xxyxxxxxxx"],
    }
    table = recall_interval(pd.DataFrame(rows), ["x", "y", "z"])
    assert table.loc["x", "recall"] == pytest.approx(800 / 9) and table.loc["y", "recall"] == 0
    assert table.loc["z"].isna().all()
