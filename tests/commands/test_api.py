"""The Python API: the names of the command line, tables that show what the store holds."""

import inspect
import pydoc
import re

import numpy as np
import pandas as pd
import pytest
from sklearn.model_selection import LeaveOneGroupOut
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

import bench
from bench.features.jung28 import Jung28
from bench.grammar.options import typed_settings
from tests.conftest import predictions, runs
from tests.reports.store import predictions_with_hits, tracked_run

TINY = {"data__subjects": 3, "data__variants": ("normal",), "data__repetitions": 1, "jobs": 1}


def test_a_corpus_can_be_looked_at():
    corpus = bench.corpus(
        "synth", where="gesture == 'pat'", subjects=2, variants=("normal",), repetitions=1
    )
    assert set(corpus.gestures) == {"pat"} and len(corpus) == 2
    figure = corpus.plot(1)
    grid, course, *_ = figure.axes
    np.testing.assert_allclose(grid.images[0].get_array(), corpus[1].mean(axis=0))
    np.testing.assert_allclose(course.lines[0].get_ydata(), corpus[1].sum(axis=(1, 2)))
    assert "(synthetic)" in figure.get_suptitle() and "pat" in figure.get_suptitle()


def test_results_and_run_show_what_is_tracked(in_net, capsys):
    on = {"data": "people", "where": "all", "target": "gesture", "protocol": "loso"}
    same = {"model": ["tree", "bayes"], "features": "jung28", "seed": None, "data": "people"}
    table = bench.run(**same, jobs=1)
    assert "already stored" in capsys.readouterr().err
    assert table["system"].tolist() == ["tree · jung28", "bayes · jung28"]
    tracked = {run.info.run_id: run.data for run in runs("cell")[1]}
    for row in table.to_dict("records"):
        metrics = tracked[row["run_id"]].metrics
        assert row["accuracy"] == pytest.approx(100 * metrics["accuracy"])
        assert row["macro_f1"] == pytest.approx(100 * metrics["macro_f1"])
        assert row["flash_bytes"] == metrics["flash_bytes"]
        known = {"corpus_digest", "threads", "cpu", "version.scikit-learn", "protocol"}
        assert known <= {*tracked[row["run_id"]].params}
    accuracies = bench.runs(model="bayes", **on).set_index("run_id")["accuracy"]
    assert accuracies[table["run_id"][1]] == table["accuracy"][1]
    stored = bench.runs()
    for printed in (table, stored):
        head = printed.to_string(max_cols=8).splitlines()[0].split()
        assert head[:4] == ["name", "accuracy", "low", "high"] and head[-2:] == ["data", "protocol"]
    assert {*tracked} <= {*stored["run_id"]}
    assert not stored[["name", "data", "subset", "protocol"]].duplicated().any()
    with pytest.raises(bench.InputError):
        bench.runs(model="svm")
    assert bench.choose(max_flash="1B", model="bayes", **on).system is None


def test_what_cannot_be_compared_is_refused(store):
    rough = {"subset": "variant == 'rough'"}
    tracked_run(store, "a", predictions_with_hits([15] * 6))
    tracked_run(store, "b", predictions_with_hits([14] * 6), **rough)
    for pair, fact in {("a", "b"): "'rough'", ("a", "none"): "'none'", ("a", "a"): "two"}.items():
        with pytest.raises(bench.InputError, match=fact):
            bench.compare(*pair)
    tracked_run(store, "a", predictions_with_hits([15] * 6), **rough)
    tracked_run(store, "b", predictions_with_hits([14] * 6))
    with pytest.raises(bench.InputError, match="where="):
        bench.compare("a", "b")
    assert bench.compare("a", "b", where="variant == 'rough'").difference == pytest.approx(5)


def test_objects_give_what_their_names_give():
    own = lambda C=5: make_pipeline(Jung28(), StandardScaler(), SVC(C=C))  # noqa: E731
    table = bench.run(
        model=[own(), SVC(C=5)], features=Jung28(), protocol=LeaveOneGroupOut(), **TINY
    )
    assert table["system"].tolist() == [
        "Jung28() > StandardScaler() > SVC(C=5)",
        "SVC(C=5) · Jung28()",
    ]
    assert (table["protocol"] == "LeaveOneGroupOut").all() and (table["folds"] == "3/3").all()
    corpus = bench.corpus("synth", subjects=3, variants=("normal",), repetitions=1)
    expected = []
    for name in "123":
        test = corpus.subjects == name
        expected += [*own().fit(corpus[~test], corpus.gestures[~test]).predict(corpus[test])]
    store, (first, _) = runs("cell")
    labels = predictions(store, first).filter(like="p_").idxmax(axis=1).str[2:]
    assert labels.tolist() == expected
    ids = [
        bench.run(model=own(C), protocol=LeaveOneGroupOut(), **TINY)["run_id"][0] for C in (5, 6)
    ]
    assert ids[0] == table["run_id"][0] and ids[1] != ids[0]  # an equal object is the same run


def test_tables_of_runs(in_net):
    stored = bench.runs(model="bayes", data="people")
    found = stored[stored["loss.noise"].notna()]
    assert {"none", "noise", "dead_taxels"} < {*bench.predictions(found, "labels")["case"]}
    labels = bench.predictions(found)
    assert {*labels["name"]} == {"bayes · jung28"}
    people = bench.predictions(found, "per_subject")
    assert people.groupby("run_id")["accuracy"].mean().tolist() == pytest.approx(
        found["accuracy"].tolist()
    )
    cases = bench.runs(cases=True, run=[*found["run_id"]])
    assert {*cases.loc[cases["case"] == "noise", "level"]} == {1, 2, 3, 4, 5}
    assert {"accuracy", "loss"} < {*cases}
    with pytest.raises(bench.InputError, match="did you mean faults"):
        bench.predictions(found, "fault")


def test_predictions_are_labels_of_captures_that_compare_reads(store, tmp_path):
    table = predictions_with_hits([15, 12, 18, 9, 14, 16])
    other = predictions_with_hits([12] * 6)
    windows = pd.concat([table, other.assign(start=10)]).sort_values("capture", kind="stable")
    chances = [f"p_{gesture}" for gesture in ("pat", "rub", "tap")]
    windows.loc[windows["capture"] == 100, chances] = 0.0  # abstains
    windows = windows.assign(id="a condition").reset_index(drop=True)
    tracked_run(store, "a", windows)
    tracked_run(store, "b", other)
    stored = bench.runs(model="a")
    labels = bench.predictions(stored)
    assert [*labels][:5] == ["id", "subject", "truth", "prediction", "fold"]
    assert [*labels][-5:] == [*chances, "name", "run_id"] and {*labels["id_"]} == {"a condition"}
    assert len(labels) == 120 and labels["id"].is_unique
    assert labels.set_index("id").loc[100, "prediction"] == ""
    right = (labels["truth"] == labels["prediction"]).groupby(labels["subject"]).mean()
    assert 100 * right.mean() == pytest.approx(stored["accuracy"][0])
    assert stored["unit"].tolist() == ["capture"]
    assert len(bench.predictions(stored, "decisions")) == 240
    labels.to_csv(tmp_path / "mine.csv", index=False)
    for one in (labels, str(tmp_path / "mine.csv"), "a"):
        compared = bench.compare(one, "b")
        assert compared.difference == pytest.approx(stored["accuracy"][0] - 60)


def test_a_fitted_and_a_tuned_system(in_net):
    fitted = bench.fit(stopping=False, model="bayes", features="jung28", data="people")
    assert len(fitted.recogniser.label(bench.corpus("people"))) == 32
    assert fitted.uri in repr(fitted)
    tree = {"model": "tree", "features": "jung28", "model__level": [1, 9]}
    tuned = bench.tune(**tree, inner="2", data="people", jobs=1)
    assert tuned["system"][0].startswith("tuned tree[level=1|9")


def test_signatures_have_the_keys_that_the_functions_take():
    """For help() and completion; a function refuses what its signature does not have."""
    for name in ("run", "stress", "tune", "fit", "audit", "extract", "choose", "runs", "ledger"):
        function = getattr(bench, name)
        parameters = inspect.signature(function).parameters
        assert {"features", "values"} < {*parameters}, name
        with pytest.raises(bench.InputError) as refused:
            function(no_such_key=1)
        known = re.findall(r"\w+", str(refused.value).partition("known: ")[2])
        assert {*known} <= {*parameters}, name
        assert f"{name}(" in pydoc.plain(pydoc.render_doc(function))
    run = inspect.signature(bench.run)
    assert run.bind(model="svm", model__window=0.5).arguments["model__window"] == 0.5
    assert run.parameters["protocol"].default == "loso" and "under" in run.parameters
    stored = inspect.signature(bench.predictions).parameters
    assert [*stored][:2] == ["runs", "table"] and stored["data"].default is None


@pytest.mark.parametrize(
    ("values", "fact"),
    [
        ({"modle": "svm"}, "did you mean model"),
        ({"model": []}, "model="),
        ({"model": SVC(), "model__C": 3}, "'C'"),
        ({"data__subjects": [2, "x"]}, "subjects=x"),
    ],
)
def test_mistakes_raise_with_the_key(values, fact):
    with pytest.raises(bench.InputError, match=fact):
        bench.run(**{"data__subjects": 2, **values})


def test_options_take_numbers_of_numpy_and_none():
    given = {"margin": np.float64(3), "why": np.True_, "run": None}
    typed = typed_settings("choose", given)
    assert [typed[key] for key in given] == [3.0, True, ""] and typed["unit"] == "capture"
    assert typed_settings("check", {"error": np.int64(3)})["error"] == 3
