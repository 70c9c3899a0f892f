"""The Python API: the names of the command line, tables that say what the store says."""

import itertools
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from sklearn.model_selection import LeaveOneGroupOut
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

import bench
from bench.arguments import KEYS
from bench.cli import main
from bench.commands import choose, fit, stream, stress, tune
from bench.leaderboard.tasks import HAART
from bench.outcomes.comparable import BATCH, MARKED
from features.jung28 import Jung28
from tests.conftest import predictions, runs
from tests.reports.store import tracked_run, with_hits

SMALL = {"data__subjects": 4, "data__variants": ("normal",)}
TYPED = ["data.subjects=4", "data.variants=normal"]


def test_importing_it_takes_no_time_and_loads_nothing_heavy():
    code = "import time; t = time.perf_counter(); import bench, sys; print(time.perf_counter() - t);"
    code += "assert not {'numpy', 'pandas', 'sklearn', 'mlflow', 'torch'} & set(sys.modules); print(*dir(bench))"
    root = str(Path(bench.__file__).parent.parent)
    said = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True).stdout
    assert float(said.split()[0]) < 0.2 and {"run", "choose", "corpus", "results"} <= set(said.split())


def test_a_corpus_is_short_to_print_and_can_be_looked_at():
    corpus = bench.corpus("synth", subjects=2, variants=("normal",))
    counts = f"28 captures of 2 subjects, 14 gestures, {len(corpus.frames)} frames of 8x8 at 135 Hz"
    assert repr(corpus) == f"<synthetic Corpus synth: {counts}>"
    assert list(corpus.captures) == ["subject", "variant", "gesture", "repetition"]
    grid, course, *_ = corpus.plot(3).axes
    np.testing.assert_allclose(grid.images[0].get_array(), corpus[3].mean(axis=0))
    np.testing.assert_allclose(course.lines[0].get_ydata(), corpus[3].sum(axis=(1, 2)))
    title = corpus.plot(3).get_suptitle()
    assert "(synthetic)" in title and corpus.captures["gesture"][3] in title
    some = bench.corpus("synth", where="gesture == 'pat'", subjects=2)
    assert set(some.gestures) == {"pat"}
    with pytest.raises(bench.InputError, match="no parameter 'subject'; did you mean subjects"):
        bench.corpus("synth", subject=2)


def test_run_is_the_command_and_results_are_what_is_tracked(capsys):
    table = bench.run(model=["svm", "bayes"], seed=0, **SMALL)
    assert table["system"].tolist() == ["svm · jung54", "bayes · jung54"] and (table["folds"] == "4/4").all()
    assert (table["data"] == "synth (synthetic)").all()
    store, tracked = runs("cell")
    assert [100 * r.data.metrics["accuracy"] for r in tracked] == pytest.approx(table["accuracy"])
    assert table["flash_bytes"].tolist() == [r.data.metrics["flash_bytes"] for r in tracked]
    assert main(["run", "model=svm,bayes", *TYPED]) == 0  # the same cells
    assert len(runs("cell")[1]) == 2 and "stored before" in capsys.readouterr().err
    found = bench.results(model="svm")
    assert found["accuracy"].tolist() == pytest.approx([table["accuracy"][0]]) and "published" in found
    with pytest.raises(bench.InputError, match="no run is tracked for these values"):
        bench.results(model="rf")


def test_what_run_and_results_print_shows_the_accuracy():
    table = bench.run(model=["svm", "bayes"], seed=0, **SMALL)
    assert len(table.columns) <= 15
    for shown in (table, bench.results()):
        head = shown.to_string(max_cols=8).splitlines()[0].split()
        assert head[:4] == ["system", "accuracy", "low", "high"] and head[-2:] == ["data", "protocol"]
    everything = bench.results(full=True)
    assert {"search_seconds", "accuracy_low", "git"} & set(everything) and len(everything.columns) > 40
    store, tracked = runs("cell")
    found = everything.set_index("run_id")["accuracy"]
    assert all(found[r.info.run_id] == r.data.metrics["accuracy"] for r in tracked)


@pytest.mark.parametrize(
    ("function", "keys"),
    [(bench.run, KEYS), (bench.tune, tune.KEYS), (bench.stress, stress.KEYS), (bench.fit, fit.KEYS)]
    + [(bench.choose, choose.KEYS), (bench.stream, stream.KEYS - {"source", "window_ms"})],
)
def test_help_names_every_key(function, keys):
    text = function.__doc__ + ("" if function is bench.run else bench.run.__doc__)
    assert [key for key in keys if not re.search(rf"\b{key}\b", text)] == []


def hits_of(store, name, hits, **about):
    tracked_run(store, name, with_hits(hits), **about)


def test_two_systems_are_compared_person_by_person(store):
    # Seven of ten gain one or two captures of 20, two lose one, one is equal.
    hits_of(store, "svm · jung54", [18, 18, 18, 17, 17, 17, 17, 15, 15, 16])
    hits_of(store, "bayes · jung54", [16, 16, 16, 16, 16, 16, 16, 16, 16, 16], **{BATCH: "true"})
    found = bench.compare("svm · jung54", {"model": "bayes"}, data="synth")
    gained = np.array([10, 10, 10, 5, 5, 5, 5, -5, -5, 0])
    assert found.difference == pytest.approx(gained.mean()) and found.subjects == 10
    expected = stats.ttest_1samp(gained, 0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))
    # Nine differ: six by 5 points, rank 3.5, of which two are negative; three by 10, rank 8: the negative sum is 7
    ranks = stats.rankdata(np.abs(gained[gained != 0]))
    sums = [np.dot(signs, ranks) for signs in itertools.product((0, 1), repeat=9)]
    assert found.p == pytest.approx(2 * np.mean([s <= 7 for s in sums]))
    assert found.gain == ["1", "2", "3", "4", "5", "6", "7"] and found.lose == ["8", "9"]
    text = repr(found)
    assert "svm · jung54 is 4.0 points more accurate than bayes · jung54 †" in text and MARKED in text
    assert "10 subjects: 7 gain (1, 2, 3, 4, 5, 6, 7), 2 lose (8, 9)" in text
    back = bench.compare("bayes · jung54 †", "svm · jung54")
    assert back.difference == pytest.approx(-found.difference) and back.gain == found.lose


def test_what_cannot_be_compared_is_refused_in_one_line(store):
    hits_of(store, "a", [15] * 6)
    hits_of(store, "b", [14] * 6, subset="variant == 'rough'")
    with pytest.raises(bench.InputError, match=r"a and b share no data, subset and protocol: .*, all, .*'rough'"):
        bench.compare("a", "b")
    with pytest.raises(bench.InputError, match="no complete run of 'c' is tracked; .*a, b"):
        bench.compare("a", "c")
    with pytest.raises(bench.InputError, match="give two systems"):
        bench.compare("a", "a")
    hits_of(store, "a", [15] * 6, subset="variant == 'rough'")
    hits_of(store, "b", [14] * 6)
    with pytest.raises(
        bench.InputError, match="both have runs on .*; name one with data=, where=, target= or protocol="
    ):
        bench.compare("a", "b")
    assert bench.compare("a", "b", where="variant == 'rough'").difference == pytest.approx(5)


def test_a_run_is_compared_with_a_reference_result(store):
    about = {"data": "haart", "synthetic": "false", "corpus_digest": HAART, "protocol_label": "LOSO (10 subjects)"}
    hits_of(store, "mine", [18] * 10, **about)
    found = bench.compare("mine", "reflex (reference)")
    reference = bench.results("reference")["haart-loso-v1/reflex"]
    own = (reference["true"] == reference["predicted"]).groupby(reference["subject"]).mean().mean()
    assert found.difference == pytest.approx(90 - 100 * own)


def test_objects_give_what_their_names_give():
    own = make_pipeline(Jung28(), StandardScaler(), SVC(C=5))
    table = bench.run(model=[own, SVC(C=5)], features=Jung28(), protocol=LeaveOneGroupOut(), **SMALL)
    assert table["system"].tolist() == ["Jung28() > StandardScaler() > SVC(C=5)", "SVC(C=5) · Jung28()"]
    assert (table["protocol"] == "LeaveOneGroupOut").all() and (table["folds"] == "4/4").all()
    corpus = bench.corpus("synth", subjects=4, variants=("normal",))
    expected = []
    for name in "1234":
        test = corpus.subjects == name
        fitted = make_pipeline(Jung28(), StandardScaler(), SVC(C=5)).fit(corpus[~test], corpus.gestures[~test])
        expected.append(fitted.predict(corpus[test]))
    store, (first, _) = runs("cell")
    labels = predictions(store, first).filter(like="p_").idxmax(axis=1).str[2:]
    assert labels.tolist() == np.concatenate(expected).tolist()
    again = bench.run(model=make_pipeline(Jung28(), StandardScaler(), SVC(C=5)), protocol=LeaveOneGroupOut(), **SMALL)
    assert again["run_id"][0] == table["run_id"][0]  # an equal object is the same run
    other = bench.run(model=make_pipeline(Jung28(), StandardScaler(), SVC(C=6)), protocol=LeaveOneGroupOut(), **SMALL)
    assert other["run_id"][0] != table["run_id"][0]


def test_choose_stress_stream_fit_and_tune():
    bench.run(model=["svm", "bayes"], features="jung28", **SMALL)
    choice = bench.choose(data="synth", protocol="loso", max_flash="256kB")
    assert choice.system in ("svm · jung28", "bayes · jung28") and f"Choose {choice.system}" in str(choice)
    assert bench.choose(max_flash="1B", model="bayes").system is None
    found = bench.stress(model="bayes", features="jung28", faults=["noise", "shift"], **SMALL)
    assert set(found["faults"]["fault"]) == {"noise", "shift"} and "loss.noise" in found.table
    assert set(found["labels"]["fault"]) == {"none", "noise", "shift"}
    assert "more tables: 'faults'" in repr(found) and "<table" in found._repr_html_()
    with pytest.raises(KeyError, match="did you mean faults"):
        found["fault"]
    replayed = bench.stream(model="bayes", features="jung28", hop_ms=600, **SMALL)
    assert replayed["instants"]["accuracy"].iloc[-1] == pytest.approx(replayed.table["accuracy"][0] / 100)
    fitted = bench.fit(model="bayes", features="jung28", **SMALL)
    captures = bench.corpus("synth", subjects=1, variants=("normal",), seed=5)
    assert len(fitted.recogniser.label(captures)) == 14 and fitted.uri in repr(fitted)
    tuned = bench.tune(model="bayes", features="jung28", model__ridge=[0.01, 1.0], inner=2, **SMALL)
    assert tuned["system"][0].startswith("tuned bayes[ridge=0.01|1.0") and isinstance(tuned, pd.DataFrame)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"modle": "svm"}, "no key is called 'modle'; did you mean model"),
        ({"model": "svn"}, "model=svn: not known; did you mean svm"),
        ({"model": []}, "model=.*: give at least one value"),
        ({"model": SVC(), "model__C": 3}, "has no parameter 'C'"),
        ({"jobs": "two"}, "jobs=two: give a whole number"),
    ],
)
def test_mistakes_are_told_as_on_the_command_line(values, told):
    with pytest.raises(bench.InputError, match=told):
        bench.run(**SMALL, **values)


def test_what_does_not_exist_is_no_attribute():
    with pytest.raises(AttributeError, match="no attribute 'rnu'"):
        _ = bench.rnu
    started = time.perf_counter()
    assert callable(bench.run) and time.perf_counter() - started < 5


@pytest.mark.parametrize("kind", ["package", "file"])
def test_a_strangers_room_is_found_out_in_one_line(kind, tmp_path):
    """As in a notebook, whose folder stands first on the path."""
    place = tmp_path / ("models.py" if kind == "file" else "models")
    if kind == "file":
        place.write_text("MINE = 1\n")
    else:
        place.mkdir()
        (place / "__init__.py").write_text("")
    root = str(Path(bench.__file__).parent.parent)
    # an installed touchbench stands behind the notebook's folder
    code = f"import sys; sys.path[:0] = ['']; sys.path.append({root!r}); "
    for ask in ("import bench; bench.run", "from bench.cli import main; sys.exit(main(['run']))"):
        done = subprocess.run([sys.executable, "-P", "-c", code + ask], cwd=tmp_path, capture_output=True, text=True)
        last = done.stderr.strip().splitlines()[-1]
        assert done.returncode and "hides touchbench's own package 'models'; rename it" in last and str(place) in last


def test_values_of_other_types_than_text_are_taken_or_refused():
    with pytest.raises(bench.InputError, match="by=3"):
        bench.choose(by=3)
    small = {"data__subjects": 3, "data__variants": ("normal",)}
    found = bench.choose(model="bayes", over="features", inner=2, **small)
    assert found is not None
    usual, none = (bench.run(model="bayes", protocol="challenge", **SMALL, **s) for s in ({}, {"protocol__seed": None}))
    assert usual["run_id"].tolist() == none["run_id"].tolist()


def test_a_system_that_tells_what_it_chose_and_not_among_what_is_tracked(tmp_path):
    Path("own.py").write_text(
        "from sklearn.pipeline import Pipeline\n\nfrom models.classic.svm import svm\n\n\n"
        "class Level(Pipeline):\n"
        "    @property\n"
        "    def chosen_(self):\n"
        "        return {'level': 3}\n\n\n"
        "def level(features):\n"
        "    return Level(svm(features).steps)\n"
    )
    table = bench.run(model="own.py:level", features="jung28", **SMALL)
    assert (table["folds"] == "4/4").all()
    store, (run,) = runs("cell")
    assert pd.read_csv(store.fetched(run.info.run_id, "chosen.csv"))["level"].tolist() == [3] * 4


def test_a_part_behind_a_link_is_found(tmp_path):
    Path("real.py").write_text("from sklearn.svm import SVC\n\n\ndef mine():\n    return SVC()\n")
    Path("link.py").symlink_to("real.py")
    table = bench.run(model="link.py:mine", features="jung28", **SMALL)
    assert (table["folds"] == "4/4").all()


def test_a_lost_artifact_is_named_in_one_line(capsys):
    bench.run(model=["svm", "bayes"], features="jung28", **SMALL)
    store, found = runs("cell")
    store.path(found[0].info.run_id, found[0].info.artifact_uri, "predictions.parquet").unlink()
    with pytest.raises(bench.InputError, match=r"predictions\.parquet of svm .* is gone from the store"):
        bench.choose()
