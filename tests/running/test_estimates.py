"""Rough times of runs that have no similar stored one."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.models import PARTS
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.running import estimates
from bench.running.estimates import FOLD_WORK, estimate_from_work

SMALL = {"data.subjects": 4, "data.variants": "normal", "data.repetitions": 1}


def plan_of(**values):
    (plan,) = make_plans(make_cells({**SMALL, **values}), 1)
    return plan


def test_each_model_but_the_search_has_a_figure():
    table = pd.read_csv(Path(estimates.__file__).with_name("work.csv"), index_col="model")
    assert {*table.index} == {*PARTS} - {"auto"}
    assert (table.sum(axis=1) > 0).all() and (table.min(axis=1) == 0).all()


def test_the_time_by_hand(monkeypatch):
    """Of 4 people with 14 captures each, 42 are in training."""
    monkeypatch.setattr(estimates, "_seconds_of_workload", lambda: 0.002)
    monkeypatch.setattr(estimates, "_work_by_model", lambda: {"rf": (3.0, 0.0), "cnn85": (0, 0.5)})
    forest = plan_of(model="rf", **{"model.trees": 50})
    trees = 50 / forest.cell.model.factory.__defaults__[0]
    assert estimate_from_work(forest) == pytest.approx((FOLD_WORK + 42 * 3 * trees) * 0.002)
    network = plan_of(model="cnn85")
    frames = 42 * np.mean([len(frames) for frames in network.corpus])
    assert estimate_from_work(network) == pytest.approx((FOLD_WORK + 0.5 * frames) * 0.002)
    assert estimate_from_work(plan_of(model="svm")) is None


def test_the_work_of_this_machine_is_between_a_tenth_and_ten_times_a_usual_one():
    """Measured anew: what a quick test with a smaller workload has measured is kept."""
    assert 0.0002 < estimates._seconds_of_workload.__wrapped__() < 0.02
