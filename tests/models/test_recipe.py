"""Any system behind windows, repair, scaling and faults: what it decides, what it learns from, and what stays."""

import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.pipeline import Pipeline

from bench import contract, source
from bench.cli import main
from bench.corpora.corpus import COPY, Corpus, origin
from bench.corpora.faults import FAULTS, Fault
from bench.corpora.folder import open_folder, write_folder
from bench.corpora.steps import Faulted, Repair, Scale, Windows
from bench.errors import InputError
from bench.plan.cells import cells
from bench.plan.plan import checked, planned
from bench.registry import load, parameters
from bench.work.evaluation import Evaluation
from bench.work.fold import decisions
from bench.work.workers import fill_cache
from features import PARTS
from features import cache as kept
from features.cache import cache_key
from features.jung28 import Jung28
from features.touch import TouchFeatures
from models.classic.lda import lda
from models.classic.rf import rf
from models.classic.svm import svm
from models.classic.xgb import xgb
from models.nets.cnn85 import CNN85
from models.nets.hughes2017 import Hughes2017CNN
from models.recipe import Recipe, mean_of, rows_of, taken
from models.rocket import Rocket
from models.sizes import sizes
from tests.conftest import random_corpus, with_other_values

SYSTEMS = {
    "svm": lambda: svm(Jung28()),
    "rf": lambda: rf(Jung28(), trees=10),
    "xgb": lambda: xgb(Jung28(), trees=5),
    "lda": lambda: lda(TouchFeatures()),
    "rocket": lambda: Rocket(kernels=84),
}
NETWORK = lambda: CNN85(frames=10, epochs=1, batch=16)  # noqa: E731
HARSH = {"repair": ("stuck", "dead", "offset"), "scale": "peak", "faults": ("all",), "copies": 1}
OPTIONS = set(parameters(Recipe))


def fitted(system, captures, **options):
    return Recipe(system, **options).fit(captures, captures.gestures)


# Without options


@pytest.mark.parametrize("name", ["svm", "rf", "lda", "rocket"])
def test_without_options_nothing_changes(name, corpus):
    bare = SYSTEMS[name]().fit(corpus, corpus.gestures)
    probe = random_corpus(seed=9)
    model = fitted(SYSTEMS[name](), corpus)
    assert np.array_equal(model.predict_proba(probe), bare.predict_proba(probe))
    assert np.array_equal(model.predict(probe), bare.predict(probe)) and list(model.classes_) == list(bare.classes_)
    table, proba = model.decide(probe)
    assert table.equals(contract.decide(bare, probe)[0]) and np.array_equal(proba, bare.predict_proba(probe))
    assert sizes(model, 64, 40) == sizes(bare, 64, 40)


def test_a_cell_without_options_is_what_it_was(corpus, monkeypatch):
    asked = {"model": "svm", "features": "jung28"}
    (bare,) = cells(asked)
    assert bare.title() == "svm · jung28 | synth | loso" and not OPTIONS & set(bare.model.parameters)
    assert bare.model.parameters == parameters(svm)
    usual = {"window": 0.0, "hop": 0.0, "scale": "none", "copies": 3}
    (same,) = cells(asked | {f"model.{k}": v for k, v in usual.items()})
    assert same == bare and same.identity() == bare.identity() and same.arguments() == bare.arguments()
    system = checked(bare)
    assert type(system) is type(svm(Jung28())) and system.get_params().keys() == svm(Jung28()).get_params().keys()
    found = system.fit(corpus, corpus.gestures).predict_proba(corpus)
    assert np.array_equal(found, svm(Jung28()).fit(corpus, corpus.gestures).predict_proba(corpus))
    # its run key is not that of one with options, which alone depends on the code of the steps
    (cut,) = cells(asked | {"model.window": "0.5"})
    before = bare.identity(), cut.identity()
    assert cut.title() == "svm[window=0.5] · jung28 | synth | loso" and before[0] != before[1]
    original = source.meaning

    def changed(path, at):
        code, imported = original(path, at)
        return code + path.endswith(("recipe.py", "steps.py", "faults.py")) * b"changed", imported

    with monkeypatch.context() as patch:
        patch.setattr(source, "meaning", changed)
        assert bare.identity() == before[0] and cut.identity() != before[1]


def test_options_are_for_every_model_and_told_as_they_are_typed():
    found = cells({"model": "svm,cnn85", "model.repair": "stuck+dead", "model.copies": 3, "model.epochs": 2})
    assert [c.title().split(" | ")[0] for c in found] == [
        "svm[repair=stuck+dead] · jung54",
        "cnn85[epochs=2, repair=stuck+dead]",
    ]
    assert found[0].arguments()["model.repair"] == "stuck+dead"
    assert cells(found[0].arguments())[0].identity() == found[0].identity()
    grid = cells({"model": "lda", "model.window": "0.5,1.0", "model.faults": "all,noise+shift"})
    assert [(c.model.parameters["window"], c.model.parameters["faults"]) for c in grid] == [
        (w, f) for w in (0.5, 1.0) for f in (("all",), ("noise", "shift"))
    ]
    own = cells({"model": "reflex", "model.window": "1.0"})[0]  # a parameter of its own
    assert own.model.parameters == parameters(own.model.factory) and not isinstance(own.estimator(), Recipe)


@pytest.mark.parametrize("name", ["svm", "cnn85", "rf"])
def test_the_harness_builds_what_is_asked(name, corpus):
    options = {"model.repair": "dead", "model.scale": "peak", "model.faults": "noise", "model.copies": "1"}
    (cell,) = cells({"model": name, "features": "jung28", **options} if name != "cnn85" else {"model": name, **options})
    model = checked(cell)
    given = {k: v for k, v in model.get_params(deep=False).items() if k != "system"}
    asked = {"repair": ("dead",), "scale": "peak", "faults": ("noise",), "copies": 1}
    assert isinstance(model, Recipe) and given == parameters(Recipe) | asked
    assert clone(model).get_params().keys() == model.get_params().keys()
    assert (list(cell.feature_sets()) == ["jung28"]) == (name != "cnn85")
    assert model.steps() == [Repair(("dead",)), Scale("peak")]
    assert model.training_steps() == [Faulted(("noise",), 1), *model.steps()]


# Windows


def naive_windows(corpus, frames, hop):
    """Capture, start and frames of each window, by counting."""
    found = []
    for i, capture in enumerate(corpus):
        found.append((i, 0, min(len(capture), frames)))
        start = hop
        while start + frames <= len(capture):
            found.append((i, start, frames))
            start += hop
    return found


@pytest.mark.parametrize("name", SYSTEMS)
def test_decisions_are_those_on_each_window_alone(name, corpus):
    train, test = corpus[corpus.subjects != "4"], corpus[corpus.subjects == "4"][::-1]
    model = fitted(SYSTEMS[name](), train, window=0.1, hop=0.07)
    table, proba = model.decide(test)
    expected = naive_windows(test, 10, 7)
    assert table.to_numpy().tolist() == [list(row) for row in expected] and len(expected) > len(test)
    pieces = [test[i][start : start + frames] for i, start, frames in expected]
    about = test.captures.iloc[[i for i, *_ in expected]]
    alone = Corpus.from_captures(pieces, about, test.rate_hz)
    np.testing.assert_allclose(proba, model.system_.predict_proba(alone), rtol=1e-6, atol=1e-12)
    which = np.array([i for i, *_ in expected])
    mean = np.array([proba[which == i].mean(axis=0) for i in range(len(test))])
    np.testing.assert_allclose(model.predict_proba(test), mean, rtol=1e-6, atol=1e-12)
    assert np.array_equal(model.predict(test), model.classes_[mean.argmax(axis=1)])
    # and what it learnt from are windows too, each with its capture's label
    seen = naive_windows(train, 10, 7)
    cut = [train[i][start : start + frames] for i, start, frames in seen]
    rows = np.array([i for i, *_ in seen])
    own = Corpus.from_captures(cut, train.captures.iloc[rows], train.rate_hz)
    again = SYSTEMS[name]().fit(own, own.gestures).predict_proba(alone)
    np.testing.assert_allclose(proba, again, rtol=1e-5, atol=1e-7)


def test_predictions_of_a_run_have_a_row_per_window(corpus):
    test = np.flatnonzero(corpus.subjects == "3")
    model = fitted(svm(Jung28()), corpus[corpus.subjects != "3"], window=0.2)
    table = decisions(model, corpus, "3", test)
    assert table[["capture", "start", "frames"]].to_numpy().tolist() == [
        [test[i], start, frames] for i, start, frames in naive_windows(corpus[test], 20, 10)
    ]
    assert (table["true"] == corpus.gestures[table["capture"]]).all()


@given(st.lists(st.integers(1, 6), min_size=1, max_size=8), st.integers(0, 99))
def test_mean_of_decisions(counts, seed):
    capture = np.repeat(np.arange(len(counts)), counts)
    proba = np.random.default_rng(seed).random((len(capture), 3))
    expected = [sum(proba[capture == i]) / counts[i] for i in range(len(counts))]
    np.testing.assert_allclose(mean_of(proba, capture), expected)


def test_a_window_longer_than_all_captures_changes_nothing(corpus):
    model, bare = fitted(svm(Jung28()), corpus, window=60.0), svm(Jung28()).fit(corpus, corpus.gestures)
    np.testing.assert_allclose(model.predict_proba(corpus), bare.predict_proba(corpus), rtol=1e-9)


@pytest.mark.parametrize("features", PARTS)
def test_every_feature_set_works_on_windows_of_damaged_copies(features):
    corpus = random_corpus(subjects=2, per_class=2, longest=20)
    quick = {"features.states": 2, "features.iterations": 2, "features.epochs": 2} if features == "hughes36" else {}
    (cell,) = cells({"model": "lda", "features": features, "model.window": 0.1, "model.faults": "all", **quick})
    model = checked(cell).fit(corpus, corpus.gestures)
    assert (model.predict(corpus) == corpus.gestures).mean() > 0.5 and np.isfinite(model.predict_proba(corpus)).all()


# What is learnt from


def test_steps_are_taken_one_after_the_other(corpus):
    steps = [Faulted(("noise",), 2), Repair(("offset",)), Scale("peak"), Windows(0.1)]
    seen, row = taken(corpus, steps)
    by_hand = corpus
    for step in steps:
        by_hand = step(by_hand)
    assert np.array_equal(seen.frames, by_hand.frames) and seen.steps == tuple(steps)
    assert np.array_equal(corpus.index[row], seen.index) and np.array_equal(corpus.gestures[row], seen.gestures)
    assert seen.piece.max() // COPY == 2
    model = Recipe(svm(Jung28()), window=0.1, repair=("offset",), scale="peak", faults=("noise",), copies=2)
    assert model.training_steps() == steps and model.steps() == steps[1:]
    learnt = clone(model).fit(corpus, corpus.gestures).system_
    again = svm(Jung28()).fit(seen, seen.gestures)
    assert np.array_equal(learnt.predict_proba(corpus), again.predict_proba(corpus))


def test_faults_are_for_training_alone(corpus):
    model = fitted(svm(Jung28()), corpus, faults=("all",))
    assert np.array_equal(model.predict_proba(corpus), model.system_.predict_proba(corpus))
    assert len(model.decide(corpus)[0]) == 36
    usual = svm(Jung28()).fit(corpus, corpus.gestures)
    assert not np.array_equal(model.predict_proba(corpus), usual.predict_proba(corpus))


@pytest.mark.parametrize("name", [*SYSTEMS, "cnn85"])
def test_test_subjects_change_nothing_that_is_learned(name, corpus):
    """Other values and other labels of the test captures, and the fitted system still decides the same way."""
    make = SYSTEMS.get(name, NETWORK)
    train, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    other = with_other_values(corpus, test)
    other.captures.loc[test, "gesture"] = "tap"
    probe = random_corpus(seed=9)
    model = Recipe(make(), **HARSH) if name == "cnn85" else Recipe(make(), window=0.1, **HARSH)

    def learned(captures):
        return clone(model).fit(captures[train], captures.gestures[train]).predict_proba(probe)

    before = learned(corpus)
    assert np.array_equal(learned(other), before)
    assert not np.array_equal(learned(with_other_values(corpus, train[:9])), before)  # while training captures do


@pytest.mark.parametrize("name", ["cnn85", "rocket"])
@pytest.mark.parametrize("options", [{"repair": ("stuck", "dead")}, {"scale": "peak"}, {"faults": ("noise", "shift")}])
def test_options_for_systems_that_read_frames(name, options, corpus):
    make = SYSTEMS.get(name, NETWORK)
    train = corpus[corpus.subjects != "4"]
    model = fitted(make(), train, **options)
    bare = make().fit(train, train.gestures)
    table, proba = model.decide(corpus)
    assert table.equals(contract.decide(bare, corpus)[0]) and proba.shape == (len(table), 3)
    np.testing.assert_allclose(mean_of(proba, table["capture"].to_numpy()), model.predict_proba(corpus))
    np.testing.assert_allclose(model.predict_proba(corpus).sum(axis=1), 1, rtol=1e-5)
    expected = bare.predict_proba(corpus)
    sound = options == {"repair": ("stuck", "dead")}  # random frames have nothing to repair
    assert np.allclose(model.predict_proba(corpus), expected, rtol=1e-5) == sound
    assert contract.window(model, 100.0) == contract.window(bare, 100.0)
    repairs = 4 * 5 * 64 if {"stuck", "dead"} & set(options.get("repair", ())) else 0
    assert sizes(model, 64, 40)["ram_bytes"] == sizes(bare, 64, 40)["ram_bytes"] + repairs


# Kept tables


@pytest.mark.parametrize("options", [{"window": 0.1}, {"window": 0.1, **HARSH}, HARSH, {"scale": "peak"}])
def test_kept_tables_equal_computed_ones(options, corpus, tmp_path, monkeypatch):
    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    expected = fitted(svm(Jung28()), corpus, **options).predict_proba(corpus)
    assert np.array_equal(fitted(svm(Jung28()), stored, **options).predict_proba(stored), expected)
    model = Recipe(svm(Jung28()), **options)
    tables = len(list((tmp_path / "home" / "features").iterdir()))
    assert tables == (2 if model.faults else 1)
    monkeypatch.setattr(Jung28, "extract", lambda *_: pytest.fail("computed again"))
    part = np.array([30, 4, 17, 5])
    for steps in (model.steps(), model.training_steps()):
        found = Jung28().transform(taken(stored[part], steps)[0])
        monkeypatch.undo()
        monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "home"))
        direct = Jung28().transform(taken(corpus[part], steps)[0])
        assert np.array_equal(found, direct) and found.index.equals(direct.index)
        monkeypatch.setattr(Jung28, "extract", lambda *_: pytest.fail("computed again"))


def test_other_steps_never_meet_each_others_tables():
    steps = [
        (),
        (Windows(1.0),),
        (Windows(1.0, 0.4),),
        (Repair(("dead",)), Windows(1.0)),
        (Windows(1.0), Repair(("dead",))),
        (Faulted(("noise",)),),
        (Faulted(("noise",), 2),),
        (Faulted(("noise", "shift")),),
        (Scale("peak"),),
    ]
    assert len({kept.cache_key(Jung28(), "a", each) for each in steps}) == len(steps)
    assert kept.cache_key(Jung28(), "a", ()) == kept.cache_key(Jung28(), "a")


def test_a_table_of_steps_is_of_all_captures_whoever_asks_first(corpus, tmp_path, monkeypatch):
    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    steps = [Faulted(("noise", "early_end"), 2), Windows(0.1)]
    chosen = stored.select("subject == '3'")
    first = Jung28().transform(taken(chosen, steps)[0])
    monkeypatch.setattr(Jung28, "extract", lambda *_: pytest.fail("computed again"))
    whole = Jung28().transform(taken(stored, steps)[0])
    assert first.equals(whole.loc[chosen.index]) and len(whole) > len(first)


# Costs


def test_sizes_of_a_windowed_system_are_those_of_a_window(corpus):
    model = fitted(svm(Jung28()), corpus, window=0.1)
    found = sizes(model, 64, 40)
    machine = model.system_.named_steps["classifier"]
    n = machine.support_vectors_.shape[0]
    # summed pressure of a window, two frames, features, kernels, scores
    assert found["ram_bytes"] == 4 * (10 + 2 * 64 + 28 + n + 3)
    assert found["flash_bytes"] == 4 * (found["parameters"] + 2 * 28) > 4 * n * 28
    assert sizes(model, 64, 7)["ram_bytes"] == 4 * (7 + 2 * 64 + 28 + n + 3)  # where no capture is as long
    whole = fitted(svm(Jung28()), corpus, scale="peak")
    n = len(whole.system_.named_steps["classifier"].support_)
    assert sizes(whole, 64, 40)["ram_bytes"] == 4 * (40 + 2 * 64 + 28 + n + 3)
    touch = fitted(lda(TouchFeatures()), corpus, window=0.2)
    assert sizes(touch, 64, 40)["ram_bytes"] == 4 * (20 * (19 + 3) + 9 * 64 + 160 + 427 + 3)
    assert sizes(touch, 64, 40)["flash_bytes"] == 4 * (427 * 3 + 3 + 2 * 427)  # mean and SD as well
    series = fitted(Rocket(kernels=84), corpus, window=0.1)
    inner = contract.inside(series)
    assert sizes(series, 64, 40)["ram_bytes"] == 4 * inner.activations_


# Commands


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["model=cnn85", "model.window=1"], "model.window=1: the system cuts its own windows; leave it out"),
        (["model=svm", "model.window=-1"], "model.window=-1, model.hop=0: give seconds from 0 to 3600"),
        (["model=svm", "model.window=nan"], "model.window=nan, model.hop=0: give seconds"),
        (["model=svm", "model.window=inf"], "model.window=inf, model.hop=0: give seconds from 0 to 3600"),
        (["model=svm", "model.window=1", "model.hop=1e300"], "model.window=1, model.hop=1e+300: give seconds"),
        (["model=svm", "model.hop=0.5"], "model.hop=0.5 needs model.window="),
        (["model=svm", "model.repair=stuck+bent"], "model.repair=stuck+bent: give stuck or dead or offset"),
        (["model=rocket", "model.scale=mean"], "model.scale=mean: give none or peak or log"),
        (["model=cnn85", "model.faults=nois"], "model.faults=nois: 'nois' is no fault; did you mean noise?"),
        (["model=rf", "model.faults=all", "model.copies=0"], "model.copies=0: give 1 to 1048575"),
        (["model=rf", "model.turns=-1"], "model.turns=-1: give 1 to 7, or 0 for none"),
        (["model=svm", "model.windw=1"], "model=svm has no parameter 'windw'; did you mean window?"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(arguments, message, capsys):
    assert main(["run", *arguments, "data.subjects=2", "data.repetitions=1"]) == 2
    said = capsys.readouterr().err.strip()
    assert re.search(re.escape(message), said) and "\n" not in said


def test_parameters_of_the_system_inside_are_checked():
    with pytest.raises(InputError, match=r"model\.epochs=0"):
        Recipe(CNN85(epochs=0), scale="peak").check()
    one = random_corpus(subjects=1)
    with pytest.raises(InputError):
        Recipe(Rocket(), window=0.1).check_training(one, one.gestures)


def test_a_fold_of_a_run(monkeypatch):
    """What the harness does with it: tables kept beforehand, a row per window, the costs of one window."""
    options = {"model.window": 0.5, "model.repair": "stuck+dead", "model.faults": "noise+stuck_taxels"}
    small = {"data.subjects": 2, "data.variants": "normal", "data.repetitions": 1}
    (plan,) = planned(cells({"model": "svm", "features": "jung28", "model.copies": 1, **options, **small}), 1)
    fill_cache(plan.cell, plan.corpus)
    stored = []
    extract = Jung28.extract
    monkeypatch.setattr(
        Jung28, "extract", lambda self, c: (stored.append(bool(origin(c).digest) * len(c)), extract(self, c))[1]
    )
    result = Evaluation().fold(plan.cell, plan.corpus, plan.folds[0], 1)
    assert max(stored) == 1  # for the names; captures whose labels are timed are not stored ones
    tested = plan.corpus[plan.folds[0].test]
    expected = naive_windows(tested, 68, 34)  # half a second of 135 Hz, to the even number
    found = result.table[["capture", "start", "frames"]].to_numpy().tolist()
    assert found == [[tested.index[i], start, frames] for i, start, frames in expected]
    assert len(expected) > len(tested) and len(result.predict_ms) == len(tested)
    repair = 5 * 64
    n = result.metrics["ram_bytes"] / 4 - (repair + 68 + 2 * 64 + 28 + 14)  # kernels, one for each support vector
    assert 0 < n == (result.metrics["parameters"] - 91) / (28 + 13)  # each with its coefficients; 91 pairs have a bias


def test_what_a_fault_of_another_package_does_is_part_of_a_run(monkeypatch, tmp_path):
    file = tmp_path / "theirs.py"
    asked = {"model": "bayes", "features": "jung28"}

    def identities(text):
        file.write_text(text)
        fault = load("models", f"{file}:theirs")  # any function of a file
        monkeypatch.setitem(FAULTS, "theirs", Fault("theirs", fault, "%", (1, 2, 3, 4, 5), False))
        named, every, none = (
            cells(asked | how)[0].identity() for how in ({"model.faults": "theirs"}, {"model.faults": "all"}, {})
        )
        return named, every, none, cache_key(Jung28(), "digest", (Faulted(("theirs",)),))

    one = identities("def theirs(frames, amount, rng):\n    return frames\n")
    other = identities("def theirs(frames, amount, rng):\n    return frames / 2\n")
    assert [a != b for a, b in zip(one, other, strict=True)] == [True, True, False, True]


def test_kept_features_of_copies_are_those_of_copies_made_again(corpus, tmp_path, monkeypatch):
    """Of captures in another order, one of them twice, what is kept gives the same rows and the same system."""
    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    given = stored[np.array([7, 2, 2, 20, 11, 30, 25, 0, 33, 15])]
    options = {"window": 0.1, "repair": ("stuck",), "faults": ("noise", "dropped_frames"), "copies": 2}
    recipe = Recipe(lda(TouchFeatures()), **options)
    steps = tuple(recipe.training_steps())
    assert kept.after(TouchFeatures(), given, steps) is None  # nothing is kept yet
    made, row = taken(given, list(steps))
    expected = TouchFeatures().transform(made)  # which keeps them
    found, rows = rows_of(kept.after(TouchFeatures(), given, steps), given.index)
    pd.testing.assert_frame_equal(found, expected)
    assert np.array_equal(rows, row)
    monkeypatch.setattr(Faulted, "__call__", lambda *_: pytest.fail("a copy was damaged again"))
    quick = clone(recipe).fit(given, given.gestures)
    monkeypatch.undo()
    slow = clone(recipe).fit(given.detached(), given.gestures)
    assert quick.system_.named_steps["features"].names_.equals(expected.columns)
    assert type(quick.system_) is type(slow.system_) and quick.system_.steps[0][0] == slow.system_.steps[0][0]
    again = Pipeline(quick.system_.steps[1:]).fit(expected, given.gestures[row])
    assert np.array_equal(quick.system_.named_steps["classifier"].coef_, again.named_steps["classifier"].coef_)


class Halved(TouchFeatures):
    """A set with a transform of its own."""

    def transform(self, X):
        return super().transform(X) / 2


class Own(Pipeline):
    """A pipeline that answers in its own way."""

    def predict_proba(self, X):
        return np.eye(len(self.classes_))[np.zeros(len(X), dtype=int)]


@pytest.mark.parametrize("make", [lambda: lda(Halved()), lambda: Own(lda(TouchFeatures()).steps)])
def test_what_is_kept_is_no_short_cut_around_parts_of_ones_own(make, corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    first, second = (fitted(make(), stored, window=0.1) for _ in range(2))  # the second finds features kept
    assert type(second.system_) is type(first.system_)
    np.testing.assert_allclose(first.predict_proba(stored), second.predict_proba(stored), atol=1e-9)
    expected = fitted(make(), stored.detached(), window=0.1)
    np.testing.assert_allclose(second.predict_proba(stored), expected.predict_proba(stored.detached()), atol=1e-6)


def test_a_system_with_windows_of_its_own_keeps_them_behind_steps(corpus):
    assert contract.frames_at_once(fitted(NETWORK(), corpus, repair=("stuck",)), 600) == 10
    assert contract.frames_at_once(fitted(SYSTEMS["svm"](), corpus, repair=("stuck",)), 600) == 600


def test_a_network_without_windows_decides_on_all_of_a_capture(corpus):
    system = Hughes2017CNN(epochs=1, batch=8).fit(corpus, corpus.gestures)
    assert contract.frames_at_once(system, 30) == 30
    assert sizes(system, 64, 30)["ram_bytes"] > 0
