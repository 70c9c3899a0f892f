"""A comparison ends as soon as its folds show that it would not be ready in time."""

import pytest

from bench.running.loop import find_stored_runs, run_plans
from bench.running.workers import FoldExecutor
from bench.store.client import connect
from touchbench_builder import deadline, systems
from touchbench_builder.deadline import LimitedExecutor, OutOfTime

KEYS = {"data": "synth", "data.subjects": "4", "data.variants": "normal", "protocol": "loso"}
KEYS |= {"data.repetitions": "1", "model": "tree", "features": "jung28", "jobs": "1"}


def test_a_comparison_that_would_be_late_ends_after_a_fold_and_goes_on_from_there(monkeypatch):
    clock = iter(range(0, 1000, 7))
    monkeypatch.setattr(deadline.time, "monotonic", lambda: next(clock))
    plan, executor = systems.make_plan(KEYS)
    asked = []

    def is_in_time(plan, all_folds, rest):
        asked.append((all_folds, rest))
        return len(asked) < 2

    with pytest.raises(KeyboardInterrupt) as error:
        run_plans([plan], LimitedExecutor(executor, is_in_time))
    cause = error.value.__cause__
    assert isinstance(cause, OutOfTime) and str(cause).startswith("after 2 folds, its comparison")
    assert asked == [(4 * 7, 3 * 7), (4 * 7, 2 * 7)]  # a fold takes 7 seconds
    assert find_stored_runs(connect(), [plan])[1] == [(plan, 2)]
    (result,) = run_plans([plan], LimitedExecutor(FoldExecutor(1), lambda *_: True))
    assert result.is_complete and len(asked) == 2
