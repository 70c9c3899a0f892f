"""Folds whose systems are fitted at once give what folds give that are run alone."""

from pathlib import Path

import pandas as pd
import pytest

from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.running.loop import run_plans
from bench.running.workers import FoldExecutor, ProcessExecutor

NETWORK = """
from pathlib import Path
from bench.models.nets.cnn85 import CNN85

class Card(CNN85):
    frames: int = 10
    width: float = 0.1
    batch: int = 200
    epochs: int = 1
    on_card = True

    def prepare(self, net, samples):
        if Path("broken").exists() and len(samples) == 910:  # in fold 2
            raise ValueError("a sensor is broken")
        return super().prepare(net, samples)

    @staticmethod
    def fit_together(systems, parts):
        # A worker of an earlier run has another working folder
        with Path(__file__).with_name("together").open("a") as file:
            file.write(f"{len(systems)} ")
        return CNN85.fit_together(systems, parts)
"""
ALONE = NETWORK + "\n    trains_together = False\n"
FEW = {"data": "synth", "where": "subject != '1' or variant == 'normal'"}
FEW |= {"data.subjects": 3, "data.repetitions": 1, "model": "net.py:Card"}


def run_network(text, executor=None):
    Path("net.py").write_text(text)
    (plan,) = make_plans(make_cells(FEW), 2)
    (result,) = run_plans([plan], executor or FoldExecutor(1))
    return result


@pytest.mark.pool
def test_folds_at_once_in_a_worker_equal_folds_alone():
    alone = run_network(ALONE)
    assert not Path("together").exists()
    together = run_network(NETWORK, executor=ProcessExecutor(2))
    assert Path("together").read_text() == "3 " and together["run_id"] != alone["run_id"]
    tables = [result.tables["predictions"] for result in (alone, together)]
    pd.testing.assert_frame_equal(*tables, rtol=1e-2, atol=1e-3)
    seconds = together.tables["folds"]["seconds"]
    assert (seconds > together["fit_wall_seconds"]).all()


def test_a_fold_that_fails_leaves_the_others_and_is_tried_again():
    Path("broken").touch()
    result = run_network(NETWORK)
    assert result.folds == "2/3" and {*result.errors} == {"2"}
    assert "a sensor is broken" in Path(result.errors["2"].where).read_text()
    before = result.tables["predictions"]
    Path("broken").unlink()
    result = run_network(NETWORK)
    assert result.folds == "3/3" and Path("together").read_text() == "3 "
    after = result.tables["predictions"]
    kept = after[after["fold"] != "2"].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, before)
