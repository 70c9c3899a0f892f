"""Captures with the same wrong label from all systems, on tables made by hand."""

import pandas as pd
import pytest

from bench.outcomes.same_wrong import agreement, agreements
from bench.outcomes.store import connect, exists
from tests.results import evaluated

TRUE = {7: "pat", 3: "pat", 5: "rub", 9: "rub"}


def table(pats, folds=("a",), captures=TRUE):
    """Predictions of one system: ``pats`` has the probabilities of pat of each capture's windows."""
    rows = [
        {"fold": fold, "capture": c, "start": w, "frames": 2, "true": TRUE[c], "subject": f"s{c}", "cover": f"c{c}"}
        | {"p_pat": p, "p_rub": 1 - p}
        for fold in folds
        for c, each in zip(captures, pats, strict=True)
        for w, p in enumerate(each)
    ]
    return pd.DataFrame(rows)


# Captures 7 and 3 are pats, 5 and 9 are rubs. The first system has two windows: their mean decides.
FIVE = [
    table([[0.4, 0.2], [0.9, 0.3], [0.1, 0.3], [0.9, 0.7]]),
    *(table([[0.1], [0.6], [0.2], [0.6]]) for _ in range(3)),
    table([[0.4], [0.2], [0.2], [0.9]], folds=("a", "b")),
]


def test_agreement_by_hand():
    found = agreement(FIVE)
    assert found["capture"].tolist() == [3, 5, 7, 9] and found["subject"].tolist() == ["s3", "s5", "s7", "s9"]
    assert found["cover"].tolist() == ["c3", "c5", "c7", "c9"]
    assert found["predicted"].fillna("differ").tolist() == ["differ", "rub", "rub", "pat"]
    assert found["right"].tolist() == [4, 5, 0, 0]
    mean = [(0.6 + 3 * 0.6 + 0.8) / 5, (0.8 * 5) / 5, (0.7 + 3 * 0.9 + 0.6) / 5, (0.8 + 3 * 0.6 + 0.9) / 5]
    assert found["mean probability"].tolist() == pytest.approx(mean)
    abstaining = [one.assign(p_pat=one["p_pat"] * 0, p_rub=one["p_rub"] * 0) for one in FIVE]
    assert agreement(abstaining)["predicted"].isna().all()  # which is no label
    assert agreement([*FIVE, table([[0.9], [0.9], [0.2]], captures=[7, 3, 5])])["capture"].tolist() == [3, 5, 7]


def kept(tables):
    """A result of each table, of models m0, m1, ..."""
    return [evaluated(f"m{i}", each) for i, each in enumerate(tables)]


def listed(results):
    return [(each.systems, each.same_wrong["capture"].tolist()) for each in agreements({"all": results})]


def test_five_models_list_and_one_that_differs_removes():
    results = kept(FIVE[:4])
    results.append(evaluated("m0[x=1]", FIVE[4]))  # another system, but no other model
    assert listed(results) == []
    results.append(evaluated("m4", FIVE[4]))
    ((systems, captures),) = listed(results)
    assert captures == [7, 9] and sorted(systems) == ["m0", "m1", "m2", "m3", "m4"]
    for seed, pats in ((1, [[0.1]] * 4), (0, [[0.9], [0.9], [0.1], [0.9]])):  # the first seed counts
        results.append(evaluated("m5", table(pats), seed=seed))
    ((systems, captures),) = listed(results)
    assert captures == [9] and systems[0] == "m5"


def test_a_more_accurate_system_of_a_model_and_incomplete_or_batch_runs():
    right = table([[0.9], [0.9], [0.1], [0.1]])
    results = [*kept(FIVE), evaluated("cut", right, failed=1)]
    results.append(evaluated("batch", right, **{"touchbench.depends_on_batch": "true"}))
    assert [captures for _, captures in listed(results)] == [[7, 9]]
    assert [captures for _, captures in listed([*results, evaluated("m0[x=1]", right)])] == [[]]


def test_a_system_that_uses_conditions_is_listed_with_them():
    ((systems, _),) = listed([*kept(FIVE[:4]), evaluated("m4", FIVE[4], **{"touchbench.conditions": "cover"})])
    assert "m4 (uses cover)" in systems and "m4" not in systems


def test_a_store_is_found_and_not_made(tmp_path, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.chdir(tmp_path)
    assert not exists() and not [*tmp_path.iterdir()]
    connect()
    assert exists()
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:9")
    assert exists()
