"""Objects, classes and files of one's own: what tells two apart, and what is handed features."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.ensemble import VotingClassifier
from sklearn.model_selection import GridSearchCV, PredefinedSplit, StratifiedShuffleSplit
from sklearn.naive_bayes import GaussianNB
from sklearn.pipeline import FeatureUnion, make_pipeline
from sklearn.svm import SVC

from bench import contract
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.features.jung54 import Jung54
from bench.plan import objects
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.running import loop
from tests.running.fakes import MemoryStore

SMALL = {"data.subjects": 3, "data.variants": ("normal",)}


def keys(**values):
    return [plan.key for plan in make_plans(make_cells(SMALL | values), None)]


def test_folds_are_part_of_what_a_run_is():
    splits = [PredefinedSplit(np.repeat(folds, 14)) for folds in ([0, 1, 1], [0, 1, 1], [0, 1, 0])]
    first, again, other = keys(model="bayes", protocol=splits)
    assert first == again != other
    for seed in (None, 0):  # without a seed there are other folds each time, so it is never resumed
        drawn = StratifiedShuffleSplit(2, test_size=14, random_state=seed)
        assert (keys(model="bayes", protocol=drawn) == keys(model="bayes", protocol=drawn)) is (
            seed == 0
        )


def test_a_file_that_changes_while_it_is_used_is_refused():
    Path("my.py").write_text("from sklearn.svm import SVC\n\n\ndef mine():\n    return SVC()\n")
    (cell,) = make_cells({"model": "my.py:mine"})
    cell.estimator()
    Path("my.py").write_text("from sklearn.svm import SVC\n\n\ndef mine():\n    return SVC(C=2)\n")
    with pytest.raises(InputError, match="was changed while it was in use"):
        cell.estimator()


class OwnSVC(SVC):
    pass


class Raw(ClassifierMixin, BaseEstimator):
    def __init__(self, made=None):
        self.made = made


def test_what_stands_first_decides_whether_captures_or_a_table_is_read():
    tables = [
        SVC(),
        OwnSVC(),
        make_pipeline(OwnSVC()),
        VotingClassifier([("a", SVC()), ("b", GaussianNB())]),
    ]
    tables += [partial(SVC, C=8), SVC, OwnSVC, GridSearchCV(SVC(), {"C": [1]})]
    assert [contract.reads_tables(part) for part in tables] == [True] * len(tables)
    union = FeatureUnion([("a", Jung28()), ("b", Jung54())])
    captures = [Raw(), Raw, make_pipeline(Jung28(), SVC()), make_pipeline(union, SVC())]
    captures += [GridSearchCV(make_pipeline(Jung28(), SVC()), {"svc__C": [1]})]
    assert [contract.reads_tables(part) for part in captures] == [False] * len(captures)


def test_searches_and_unions_over_captures_run(monkeypatch):
    monkeypatch.setattr(loop, "connect", lambda writes: MemoryStore())
    union = make_pipeline(FeatureUnion([("a", Jung28()), ("b", Jung28())]), SVC())
    search = GridSearchCV(make_pipeline(Jung28(), SVC()), {"svc__C": [1, 2]}, cv=2)
    for outcome in loop.run_plans(
        make_plans(make_cells(SMALL | {"data.repetitions": 1, "model": [union, search]}), 1)
    ):
        assert outcome.folds == "3/3" and outcome["features"] == "raw frames"
        assert "touchbench.arguments" not in outcome  # an object cannot be typed
    assert list(contract.feature_sets(make_pipeline(Jung28(), SVC()))) == ["jung28"]


def test_settings_are_told_in_full_and_code_by_its_name():
    long = np.arange(5000)
    assert objects.settings_text(Raw(long)) != objects.settings_text(
        Raw(np.where(long == 2500, 0, long))
    )
    assert objects.settings_text(Raw(SVC)) == "{'made': 'sklearn.svm._classes.SVC'}"
    assert objects.own_code(Raw(OwnSVC)) == [OwnSVC, Raw] and objects.own_code(Raw(len)) == [Raw]


@pytest.mark.parametrize(
    ("values", "facts"),
    [
        ({"model": SVC}, r"model=SVC: .* fit.*SVC\(\)"),
        ({"data": 3}, "data= takes the name of a corpus"),
        ({"model": "bad.py:boom"}, "model=boom: .*ValueError: no weights file"),
    ],
)
def test_an_object_that_cannot_be_used_is_one_line(values, facts):
    Path("bad.py").write_text("def boom():\n    raise ValueError('no weights file')\n")
    with pytest.raises(InputError, match=facts):
        make_cells(values)


@pytest.mark.parametrize("key", ["model", "features", "protocol"])
def test_a_file_without_a_name_is_one_clear_line(key):
    with pytest.raises(InputError, match=f"^{key}=my.py: give what it .* {key}=my.py:Name"):
        make_cells({key: "my.py"})
