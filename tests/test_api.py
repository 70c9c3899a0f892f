"""The Python API: the names of the command line, tables that show what the store holds."""

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from sklearn.model_selection import LeaveOneGroupOut
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

import bench
from bench.features.jung28 import Jung28
from bench.options import settings
from bench.result import BATCH, MARKED
from tests.conftest import predictions, runs
from tests.reports.store import tracked_run, with_hits

TINY = {"data__subjects": 3, "data__variants": ("normal",), "data__repetitions": 1, "jobs": 1}


def test_a_corpus_is_short_to_print_and_can_be_looked_at():
    corpus = bench.corpus("synth", subjects=2, variants=("normal",), repetitions=1)
    assert "28 captures of 2 subjects" in repr(corpus) and f"{len(corpus.frames)} frames of 8x8" in repr(corpus)
    figure = corpus.plot(3)
    grid, course, *_ = figure.axes
    np.testing.assert_allclose(grid.images[0].get_array(), corpus[3].mean(axis=0))
    np.testing.assert_allclose(course.lines[0].get_ydata(), corpus[3].sum(axis=(1, 2)))
    assert "(synthetic)" in figure.get_suptitle() and corpus.captures["gesture"][3] in figure.get_suptitle()
    assert set(bench.corpus("synth", where="gesture == 'pat'", subjects=2).gestures) == {"pat"}


def test_results_and_run_show_what_is_tracked(in_net, capsys):
    on = {"data": "people", "where": "all", "target": "gesture", "protocol": "loso"}
    table = bench.run(model=["tree", "bayes"], features="jung28", seed=None, data="people", jobs=1)  # the same cells
    assert "already stored" in capsys.readouterr().err
    tracked = {run.info.run_id: run.data.metrics for run in runs("cell")[1]}
    assert (table["folds"] == "4/4").all()
    shown = {"accuracy": "accuracy", "macro_f1": "macro_f1", "flash_bytes": "flash_bytes"}
    assert table[["low", "high"]].isna().all(axis=None)  # of four subjects
    for row in table.to_dict("records"):
        scale = {name: 1 if name == "flash_bytes" else 100 for name in shown}
        expected = {name: scale[name] * tracked[row["run_id"]][metric] for name, metric in shown.items()}
        assert {name: row[name] for name in shown} == pytest.approx(expected)
    assert table["system"].tolist() == ["tree · jung28", "bayes · jung28"]
    assert set(table["data"]) == {"people"}
    stored = bench.runs(model="bayes", **on).set_index("run_id")
    assert stored["accuracy"][table["run_id"][1]] == table["accuracy"][1]
    every = bench.runs()
    for printed in (table, every):
        head = printed.to_string(max_cols=8).splitlines()[0].split()
        assert head[:4] == ["name", "accuracy", "low", "high"] and head[-2:] == ["data", "protocol"]
    named = every[["name", "data", "subset", "protocol"]]
    assert set(tracked) <= set(every["run_id"]) and not named.duplicated().any()
    with pytest.raises(bench.InputError):
        bench.runs(model="svm")
    choice = bench.choose(max_flash="64kB", **on)
    assert choice.system == "tree · jung28" and "0.156 kB" in str(choice)
    assert bench.choose(max_flash="1B", model="bayes", **on).system is None
    assert len(bench.tune(model="bayes", features="jung28", smallest="features", inner=2, **TINY)) == 2


def hits_of(store, name, hits, **tags):
    tracked_run(store, name, with_hits(hits), **tags)


def test_two_systems_are_compared_person_by_person(store):
    # Seven of ten gain one or two captures of 20, two lose one, one is equal.
    hits_of(store, "svm · jung54", [18, 18, 18, 17, 17, 17, 17, 15, 15, 16])
    hits_of(store, "bayes · jung54", [16, 16, 16, 16, 16, 16, 16, 16, 16, 16], **{BATCH: "true"})
    found = bench.compare("svm · jung54", {"model": "bayes"}, data="synth")
    gained = np.array([10, 10, 10, 5, 5, 5, 5, -5, -5, 0])
    assert found.difference == pytest.approx(gained.mean()) and found.subjects == 10
    # Of ten people, the test rejects a sum of ranks of 8 (tables of the test, 5 %): the ninth of the 55 means of two
    means = sorted((one + other) / 2 for i, one in enumerate(gained) for other in gained[i:])
    assert (found.low, found.high) == pytest.approx((means[8], means[-9])) and len(means) == 55
    # Nine differ: six by 5 points, rank 3.5, of which two are negative; three by 10, rank 8: the negative sum is 7
    ranks = stats.rankdata(np.abs(gained[gained != 0]))
    sums = [np.dot(signs, ranks) for signs in itertools.product((0, 1), repeat=9)]
    assert found.p == pytest.approx(2 * np.mean([s <= 7 for s in sums]))
    assert found.gain == ["1", "2", "3", "4", "5", "6", "7"] and found.lose == ["8", "9"]
    assert "4.0 points" in repr(found) and "†" in repr(found) and MARKED in repr(found)
    back = bench.compare("bayes · jung54 †", "svm · jung54")
    assert back.difference == pytest.approx(-found.difference) and back.gain == found.lose


def test_what_cannot_be_compared_is_refused(store):
    hits_of(store, "a", [15] * 6)
    hits_of(store, "b", [14] * 6, subset="variant == 'rough'")
    for pair, fact in {("a", "b"): "'rough'", ("a", "c"): "'c'", ("a", "a"): "two"}.items():
        with pytest.raises(bench.InputError, match=fact):
            bench.compare(*pair)
    hits_of(store, "a", [15] * 6, subset="variant == 'rough'")
    hits_of(store, "b", [14] * 6)
    with pytest.raises(bench.InputError, match="where="):
        bench.compare("a", "b")
    assert bench.compare("a", "b", where="variant == 'rough'").difference == pytest.approx(5)


def test_objects_give_what_their_names_give():
    own = lambda C=5: make_pipeline(Jung28(), StandardScaler(), SVC(C=C))  # noqa: E731
    table = bench.run(model=[own(), SVC(C=5)], features=Jung28(), protocol=LeaveOneGroupOut(), **TINY)
    assert table["system"].tolist() == ["Jung28() > StandardScaler() > SVC(C=5)", "SVC(C=5) · Jung28()"]
    assert (table["protocol"] == "LeaveOneGroupOut").all() and (table["folds"] == "3/3").all()
    corpus = bench.corpus("synth", subjects=3, variants=("normal",), repetitions=1)
    expected = []
    for name in "123":
        test = corpus.subjects == name
        expected += [*own().fit(corpus[~test], corpus.gestures[~test]).predict(corpus[test])]
    store, (first, _) = runs("cell")
    labels = predictions(store, first).filter(like="p_").idxmax(axis=1).str[2:]
    assert labels.tolist() == expected
    ids = [bench.run(model=own(C), protocol=LeaveOneGroupOut(), **TINY)["run_id"][0] for C in (5, 6)]
    assert ids[0] == table["run_id"][0] and ids[1] != ids[0]  # an equal object is the same run


def test_stress_replay_fit_and_tune():
    bayes = {"model": "bayes", "features": "jung28"} | TINY
    found = bench.stress(faults=["noise", "shift"], **bayes)
    assert set(bench.predictions(found, "faults")["fault"]) == {"noise", "shift"} and "loss.noise" in found
    assert set(bench.predictions(found, "labels")["case"]) == {"none", "noise", "shift"}
    assert set(bench.predictions(found)["name"]) == {*found["name"]}
    cases = bench.runs(cases=True, run=[*found["run_id"]])
    assert cases[["case", "level"]].drop_duplicates().shape == (10, 2) and {"accuracy", "loss"} < {*cases}
    with pytest.raises(bench.InputError, match="did you mean faults"):
        bench.predictions(found, "fault")
    replayed = bench.run(after="each", stopping=True, hop_ms=600, **bayes)
    assert bench.predictions(replayed, "instants")["ms"].is_monotonic_increasing
    assert 0 < replayed["adaptive_accuracy"][0] <= 100
    fitted = bench.fit(stopping=False, **{key: value for key, value in bayes.items() if key != "jobs"})
    captures = bench.corpus("synth", subjects=1, variants=("normal",), seed=5)
    assert len(fitted.recogniser.label(captures)) == 14 and fitted.uri in repr(fitted)
    tuned = bench.tune(model__ridge=[0.01, 1.0], inner=2, **bayes)
    assert tuned["system"][0].startswith("tuned bayes[ridge=0.01|1.0") and isinstance(tuned, pd.DataFrame)


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
    typed = settings("choose", given)
    assert [typed[key] for key in given] == [3.0, True, ""] and typed["unit"] == "capture"
    assert settings("check", {"error": np.int64(3)})["error"] == 3
