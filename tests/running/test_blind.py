"""Systems see frames and grid alone in prediction, and in training no test capture."""

import pickle
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from sklearn.pipeline import Pipeline

from bench import contract
from bench.corpora.faults import FAULTS
from bench.corpora.folder import open_folder, write_folder
from bench.corpora.windows import Windows
from bench.errors import HiddenError, InputError, PredictionError
from bench.features.base import FeatureSet
from bench.features.jung28 import Jung28
from bench.models.classic.lda import Discriminants
from bench.models.steps import DamagedCopies, Repair, Scale
from bench.plan.grid import make_cells
from bench.plan.plan import Fold, make_plans
from bench.running.circumstances.faults import Faults
from bench.running.circumstances.instants import Instants
from bench.running.circumstances.subjects import Subjects
from bench.running.evaluation import evaluate_fold, fit_and_predict
from bench.running.fold import find_batch_effects
from bench.running.replay import first_frames
from tests.conftest import random_corpus
from tests.running.fakes import Level, fake_cell

pytestmark = pytest.mark.measured
HIDDEN = (
    "captures",
    "gestures",
    "subjects",
    "index",
    "name",
    "digest",
    "info",
    "path",
    "target",
    "steps",
    "piece",
)
FEW = random_corpus(subjects=3, per_class=2, grid=(4, 4))
TRAIN, TEST = np.flatnonzero(FEW.subjects != "1"), np.flatnonzero(FEW.subjects == "1")


class Mean(Level):
    """Nearest class mean of the pressure; it looks at each corpus that it is given."""

    def fit(self, X, y):
        assert not X.is_blind and len(X.frames) == X.lengths.sum()
        return super().fit(X, y)

    def predict_proba(self, X):
        assert X.is_blind and len(X.frames) == X.lengths.sum()
        return super().predict_proba(X)


class Reads(Mean):
    """Predicts the true label."""

    def predict_proba(self, X):
        return X.captures["gesture"].to_numpy()[:, None] == self.classes_


class Centred(Mean):
    """Measures pressure from the mean of the captures that it is given together."""

    def measure_levels(self, X):
        return super().measure_levels(X) - super().measure_levels(X).mean()


class Cover(Mean):
    """Needs the column cover."""

    conditions = ("cover",)

    def predict_proba(self, X):
        assert list(X.captures) == ["cover"]
        return super().predict_proba(X)


def test_a_blind_corpus_hides_everything_but_frames_and_grid():
    blind = FEW.blind()
    hidden = [lambda name=name: getattr(blind, name) for name in (*HIDDEN, "synthetic")]
    hidden += [
        lambda: blind.select("subject == '1'"),
        lambda: blind.with_target("subject"),
        blind.plot,
    ]
    for call in hidden:
        with pytest.raises(HiddenError, match="hidden in prediction"):
            call()
    assert blind.grid == FEW.grid and (blind.rate_hz, blind.full_scale) == (
        FEW.rate_hz,
        FEW.full_scale,
    )
    assert np.array_equal(blind.lengths, FEW.lengths) and all(map(np.array_equal, blind, FEW))
    with pytest.raises(AttributeError, match="does not change"):
        blind.visible = ("subject",)
    with pytest.raises(TypeError, match="blind"):
        blind.with_fields(visible=None)


def test_what_is_made_of_a_blind_corpus_is_blind(stored):
    blind, mapped = FEW.blind(), stored.blind()
    steps = (
        Windows(0.05),
        Repair(("stuck",)),
        Scale("log"),
        DamagedCopies((next(iter(FAULTS)),), 1),
    )
    made = [
        blind[:3],
        blind[np.array([2, 0])],
        blind.detach(),
        first_frames(blind, 2),
        blind.with_fields(full_scale=9.0),
    ]
    made += [pickle.loads(pickle.dumps(one)) for one in (blind, mapped)] + [
        step(blind) for step in steps
    ]
    assert all(one.is_blind for one in (*made, blind.blind(("cover",)))) and not FEW.is_blind
    assert "3 subjects" not in repr(blind)


CIRCUMSTANCES = (Faults(("noise",)), Subjects((1,)), Instants(hop_ms=200.0, stopping=True))


@pytest.mark.parametrize("how", [{}, {"model.window": 0.3}])
def test_every_kind_of_run_predicts_blind(how, tmp_path, monkeypatch):
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *_: FEW)
    path = tmp_path / "my.py"
    path.write_text("from tests.running.test_blind import Mean as Good, Reads as Bad\n")
    (good,), (bad,) = (
        make_plans(make_cells({"model": f"{path}:{name}"} | how), 1) for name in ("Good", "Bad")
    )
    result = evaluate_fold(replace(good.cell, circumstances=CIRCUMSTANCES), FEW, good.folds[0], 1)
    assert len(result.table) and not result.batch_effects and not result.failed
    assert {"labels", "replay", "rules"} < {*result.tables} and all(
        len(table) for table in result.tables.values()
    )
    with pytest.raises(HiddenError, match="X.captures is hidden"):
        evaluate_fold(bad.cell, FEW, bad.folds[0], 1)


def test_features_of_the_whole_corpus_do_not_hide_that_they_depend_on_the_batch(tmp_path):
    """Kept features are computed of all captures at once; alone, a capture has others."""

    class Ranks(FeatureSet):
        def extract(self, corpus):
            table = Jung28().extract(corpus)
            return table - table.mean()

    write_folder(FEW, tmp_path / "c")
    stored = open_folder(tmp_path / "c")
    for features, effects in ((Jung28(), False), (Ranks(), True)):
        system = Pipeline([("features", features), ("classifier", Discriminants())])
        system.fit(stored[TRAIN], stored.gestures[TRAIN])
        assert bool(find_batch_effects(system, stored, TEST)) is effects


def test_declared_conditions_are_visible_and_no_others():
    covered = FEW.with_fields(captures=FEW.captures.assign(cover="fur"))
    system = Pipeline([("all", Cover())]).fit(covered, covered.gestures)
    assert contract.required_conditions(system) == ("cover",)
    contract.check_conditions(system, covered)
    assert contract.predict_probabilities(system, covered).shape == (len(FEW), 3)
    two = covered[np.flatnonzero(covered.gestures != "pat")]
    telling = two.with_fields(
        captures=two.captures.assign(
            number=two.gestures == "tap", who=two.captures["subject"] + "!"
        )
    )
    system = Cover()
    for name, corpus, fact in (
        ("cover", FEW, "no column 'cover'"),
        ("number", telling, "tells the class"),
        ("who", telling, "tells the subject"),
        *(
            (name, covered.with_target("cover"), "must not use")
            for name in ("gesture", "subject", "cover")
        ),
    ):
        system.conditions = (name,)
        with pytest.raises(InputError, match=fact):
            contract.check_conditions(system, corpus)
    system.conditions = "cover"
    with pytest.raises(InputError, match="tuple"):
        contract.required_conditions(system)


class Swapped(Mean):
    """Has the columns of its probabilities in another order than its classes."""

    def predict(self, X):
        return self.classes_[super().predict_proba(X).argmax(axis=1)]

    def predict_proba(self, X):
        return np.roll(super().predict_proba(X), 1, axis=1)


class Votes(Mean):
    """Decides three times; most decisions name its label, the mean probability names another."""

    def decide(self, X):
        proba = np.tile([[0.6, 0.4, 0], [0.6, 0.4, 0], [0.0, 1.0, 0]], (len(X), 1))
        return pd.DataFrame(
            {"capture": np.repeat(np.arange(len(X)), 3), "start": 0, "frames": 1}
        ), proba

    def predict(self, X):
        return np.full(len(X), self.classes_[0])


def test_a_fold_fails_where_predict_and_the_probabilities_disagree():
    fold = Fold("x", TRAIN, TEST)
    with pytest.raises(
        PredictionError, match=r"disagree on 6 of 6 captures; .* the order of classes_"
    ):
        fit_and_predict(fake_cell(Swapped), FEW, fold, 1)
    assert not fit_and_predict(fake_cell(Votes), FEW, fold, 1)[1].batch_effects
    assert fit_and_predict(fake_cell(Centred), FEW, fold, 1)[
        1
    ].batch_effects  # other labels in each batch: marked, not failed
