"""What a system may use: in prediction frames and grid of its captures alone, in training no other capture."""

import pickle

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.pipeline import Pipeline

from bench import contract
from bench.corpora.faults import all_faults
from bench.corpora.folder import open_folder, write_folder
from bench.corpora.steps import Faulted, Repair, Scale, Windows
from bench.errors import HiddenError, InputError
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.work.evaluation import Evaluation
from bench.work.fold import batch_effects, decisions
from bench.work.replay import prefix
from bench.work.stream import Stream
from bench.work.stress import Stress
from features.base import FeatureSet
from features.jung28 import Jung28
from models.classic.lda import Discriminants
from tests.conftest import random_corpus, runs

HIDDEN = ("captures", "gestures", "subjects", "index", "name", "digest", "info", "path", "target", "steps", "piece")
SMALL = {"data.subjects": 3, "data.variants": "normal", "data.repetitions": 1}


class Mean(ClassifierMixin, BaseEstimator):
    """Nearest class mean of the pressure; it looks at each corpus that it is given."""

    def fit(self, X, y):
        assert not X.is_blind and len(X.frames) == X.lengths.sum()
        self.classes_ = np.unique(y)
        level = self.level(X)
        self.means_ = np.array([level[y == c].mean() for c in self.classes_])
        return self

    def level(self, X):
        return np.array([frames.mean() for frames in X])

    def predict_proba(self, X):
        assert X.is_blind and len(X.frames) == X.lengths.sum()
        near = np.exp(-np.abs(self.level(X)[:, None] - self.means_) / 10) + 1e-9
        return near / near.sum(axis=1, keepdims=True)

    def predict(self, X):
        return self.classes_[self.predict_proba(X).argmax(axis=1)]


class Reads(Mean):
    """Predicts the true label."""

    def predict_proba(self, X):
        return X.captures["gesture"].to_numpy()[:, None] == self.classes_


class Centred(Mean):
    """Measures pressure from the mean of the captures that it is given together."""

    def level(self, X):
        level = super().level(X)
        return level - level.mean()


class Cover(Mean):
    """Needs to know what lies on the skin."""

    conditions = ("cover",)

    def predict_proba(self, X):
        assert list(X.captures) == ["cover"]
        return super().predict_proba(X)


def plan_of(**values):
    (plan,) = planned(cells(SMALL | values), 1)
    return plan


@pytest.mark.parametrize("name", [*HIDDEN, "synthetic"])
def test_a_blind_corpus_hides_everything_but_frames_and_grid(corpus, name):
    blind = corpus.blind()
    with pytest.raises(HiddenError, match="hidden in prediction"):
        getattr(blind, name)
    for call in (lambda: blind.select("subject == '1'"), lambda: blind.with_target("subject"), blind.plot):
        with pytest.raises(HiddenError):
            call()
    assert blind.grid == corpus.grid and (blind.rate_hz, blind.full_scale) == (corpus.rate_hz, corpus.full_scale)
    assert np.array_equal(blind.lengths, corpus.lengths) and all(map(np.array_equal, blind, corpus))
    with pytest.raises(AttributeError, match="does not change"):
        blind.visible = ("subject",)
    with pytest.raises(TypeError, match="blind"):
        blind.changed(visible=None)


def test_what_is_made_of_a_blind_corpus_is_blind(corpus, tmp_path):
    blind = corpus.blind()
    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c").blind()
    steps = (Windows(0.05), Repair(("stuck",)), Scale("log"), Faulted((next(iter(all_faults())),), 1))
    made = [blind[:3], blind[np.array([2, 0])], blind.detached(), prefix(blind, 2), blind.changed(full_scale=9.0)]
    made += [pickle.loads(pickle.dumps(one)) for one in (blind, stored)] + [step(blind) for step in steps]
    assert all(one.is_blind for one in made) and "3 subjects" not in repr(blind)
    assert blind.blind(("cover",)).is_blind and not corpus.is_blind
    with pytest.raises(HiddenError):
        _ = blind.blind(("cover",)).captures


@given(st.lists(st.integers(0, 35), min_size=1, max_size=30))
def test_frames_of_a_slice_are_those_of_its_captures(chosen):
    whole = random_corpus()
    part = whole[np.array(chosen)]
    naive = [whole[i] for i in chosen]
    assert np.array_equal(part.frames, np.concatenate(naive))
    assert all(
        np.array_equal(part.frames[s : s + n], f) for s, n, f in zip(part.starts, part.lengths, naive, strict=True)
    )


WINDOWS = {"model.window": 0.3}
UNLABELLED = {"protocol": "personal", "protocol.unlabelled": "true"}
KINDS = (Evaluation(), Stress((next(iter(all_faults().values())),), ()), Stream())


@pytest.mark.parametrize(
    ("experiment", "how"), [*((kind, how) for kind in KINDS for how in ({}, WINDOWS)), (Evaluation(), UNLABELLED)]
)
def test_every_kind_of_run_predicts_blind(experiment, how, tmp_path):
    path = tmp_path / "my.py"
    path.write_text("from tests.work.test_blind import Mean as Good, Reads as Bad\n")
    good, bad = (plan_of(model=f"{path}:{name}", **how) for name in ("Good", "Bad"))
    result = experiment.fold(good.cell, good.corpus, good.folds[0], 1)
    assert len(result.table) and not result.batch_effects
    with pytest.raises(HiddenError, match="X.captures is hidden"):
        experiment.fold(bad.cell, bad.corpus, bad.folds[0], 1)


def test_a_prediction_that_depends_on_the_batch_is_found_and_tagged(tmp_path):
    from bench.work.loop import execute, prepared

    path = tmp_path / "my.py"
    path.write_text(
        "from tests.work.test_blind import Centred, Mean\n\nclass Batch(Centred): pass\nclass One(Mean): pass\n"
    )
    execute(prepared(cells(SMALL | {"model": f"{path}:Batch,{path}:One"}), [Evaluation()], 1))
    tags = {run.data.tags["system"]: run.data.tags for run in runs("cell")[1]}
    assert (
        tags["Batch"]["touchbench.depends_on_batch"] == "true" and "capture" in tags["Batch"]["touchbench.batch_effect"]
    )
    assert tags["One"]["touchbench.depends_on_batch"] == "false" and "touchbench.batch_effect" not in tags["One"]


def test_features_of_the_whole_corpus_do_not_hide_that_they_depend_on_the_batch(corpus, tmp_path):
    """Kept features are computed of all captures at once; alone, a capture has others."""

    class Ranks(FeatureSet):
        def extract(self, corpus):
            table = Jung28().extract(corpus)
            return table - table.mean()

    write_folder(corpus, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    train, test = np.flatnonzero(stored.subjects != "1"), np.flatnonzero(stored.subjects == "1")
    for features, effects in ((Jung28(), False), (Ranks(), True)):
        system = Pipeline([("features", features), ("classifier", Discriminants())]).fit(
            stored[train], stored.gestures[train]
        )
        assert bool(batch_effects(system, stored, test)) is effects


class Neighbours(Mean):
    """Remembers the captures of a person in itself, as much code of others does."""

    def adapt(self, X, y):
        self.near_ = dict(zip((frames.tobytes() for frames in X), y, strict=True)) | getattr(self, "near_", {})
        return self

    def predict_proba(self, X):
        proba = super().predict_proba(X)
        for place, frames in enumerate(X):
            if (label := getattr(self, "near_", {}).get(frames.tobytes())) is not None:
                proba[place] = self.classes_ == label
        return proba


def test_what_adapts_in_place_carries_nothing_into_other_tests(corpus):
    part = corpus.subjects == "1"
    system = Neighbours().fit(corpus[~part], corpus.gestures[~part])
    before = system.predict(corpus[part].blind()).tolist()
    assert contract.adapted(system, corpus[part], corpus.gestures[part]).predict(corpus[part].blind()).tolist() == (
        corpus.gestures[part].tolist()
    )
    assert system.predict(corpus[part].blind()).tolist() == before


class Noisy(Mean):
    """Predicts at random, without a seed."""

    def predict_proba(self, X):
        noise = np.random.default_rng().random((len(X), len(self.classes_)))
        return noise / noise.sum(axis=1, keepdims=True)


class Lists(Mean):
    """Gives lists in place of arrays, and skips a capture if it is told so."""

    skips = False

    def decide(self, X):
        some = range(len(X) - self.skips)
        return pd.DataFrame({"capture": some, "start": 0, "frames": 1}), self.predict_proba(X)[: len(some)].tolist()


def test_random_predictions_lists_and_skipped_captures_are_told_apart(corpus):
    train, test = np.flatnonzero(corpus.subjects != "1"), np.flatnonzero(corpus.subjects == "1")
    noisy, lists = (system.fit(corpus[train], corpus.gestures[train]) for system in (Noisy(), Lists()))
    assert "is predicted differently each time" in batch_effects(noisy, corpus, test)[0]
    assert batch_effects(lists, corpus, test) == []
    lists.skips = True
    with pytest.raises(ValueError, match=f"no decision on capture {test[-1]}"):
        decisions(lists, corpus, "", test)


def test_the_effect_names_capture_and_both_labels(corpus):
    test = np.flatnonzero(corpus.subjects == "1")
    system = Mean().fit(corpus[corpus.subjects != "1"], corpus.gestures[corpus.subjects != "1"])
    table = decisions(system, corpus, "", test)
    assert batch_effects(system, corpus, test, table) == []
    one = table.index[4]
    table.loc[one, [f"p_{c}" for c in system.classes_]] = [0.0, 0.0, 0.0]
    table.loc[one, f"p_{(label := 'tap' if system.predict(corpus[[test[4]]].blind())[0] != 'tap' else 'pat')}"] = 1.0
    (effect,) = batch_effects(system, corpus, test, table)
    assert effect.startswith(f"capture {corpus.index[test[4]]} has label ")
    assert effect.endswith(f" alone, label {label} among {len(test)} test captures")


def test_declared_conditions_are_visible_and_no_others(corpus):
    covered = corpus.changed(captures=corpus.captures.assign(cover="fur"))
    system = Pipeline([("all", Cover())]).fit(covered, covered.gestures)
    assert contract.conditions(system) == ("cover",)
    contract.check_conditions(system, covered)
    assert contract.probabilities(system, covered).shape == (len(corpus), 3)
    with pytest.raises(InputError, match="no column 'cover'"):
        contract.check_conditions(system, corpus)
    for wrong, why in (("number", "so it tells the class"), ("who", "so it tells the subject")):
        known = {"number": covered.gestures == "tap", "who": covered.captures["subject"] + "!"}
        system = Cover()
        system.conditions = (wrong,)
        two = covered[np.flatnonzero(covered.gestures != "pat")] if wrong == "number" else covered
        telling = two.changed(captures=two.captures.assign(**{wrong: np.asarray(known[wrong])[two.index]}))
        with pytest.raises(InputError, match=why):
            contract.check_conditions(system, telling)
    system.conditions = "cover"
    with pytest.raises(InputError, match="give a tuple of names"):
        contract.conditions(system)
    for wrong in ("gesture", "subject", "cover"):
        system = Cover()
        system.conditions = (wrong,)
        with pytest.raises(InputError, match="must not use"):
            contract.check_conditions(system, covered.with_target("cover"))


def test_fit_of_a_system_that_reads_labels_is_one_line(tmp_path, capsys):
    from bench.cli import main

    path = tmp_path / "my.py"
    path.write_text("from tests.work.test_blind import Reads\n")
    assert main(["fit", f"model={path}:Reads", "stopping=no", *(f"{k}={v}" for k, v in SMALL.items())]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("bench: X.captures is hidden in prediction")


def test_a_system_that_needs_a_condition_is_not_saved(tmp_path):
    from bench.work.fit import fit

    path = tmp_path / "my.py"
    path.write_text("from tests.work.test_blind import Mean\n\nclass My(Mean):\n    conditions = ('variant',)\n")
    (cell,) = cells(SMALL | {"model": f"{path}:My"})
    with pytest.raises(InputError, match="it needs variant to predict"):
        fit(cell)
