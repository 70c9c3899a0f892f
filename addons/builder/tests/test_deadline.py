"""A comparison ends as soon as its folds show that it would not be ready in time."""

import pytest

from bench.running.loop import find_stored_runs, run_plans
from bench.running.workers import FoldExecutor
from bench.store.client import connect
from touchbench_builder import systems
from touchbench_builder.deadline import LimitedExecutor, OutOfTime

KEYS = {"data": "synth", "data.subjects": "4", "data.variants": "normal", "protocol": "loso"}
KEYS |= {"data.repetitions": "1", "model": "tree", "features": "jung28", "jobs": "1"}


class Clock:
    """Seconds left; seven pass with each look."""

    left = 100.0

    @property
    def seconds_left(self):
        self.left -= 7
        return self.left


def test_a_comparison_that_would_be_late_ends_after_a_fold_and_goes_on_from_there():
    plan, executor = systems.make_plan(KEYS)
    asked, clock = [], Clock()

    def later_seconds(plan, seconds):
        asked.append(seconds)
        return (10, 20) if len(asked) < 2 else (20, 40)

    with pytest.raises(KeyboardInterrupt) as error:
        run_plans([plan], LimitedExecutor(executor, clock, later_seconds))
    late = error.value.__cause__  # two folds in 21 of 93 seconds, two more, and 60 after them
    assert isinstance(late, OutOfTime) and late.seconds == asked[-1] == 4 * 21 / 2
    assert str(late).startswith("after 2 folds, it would take about 80 s more with its tests")
    assert find_stored_runs(connect(), [plan])[1] == [(plan, 2)]
    (result,) = run_plans([plan], LimitedExecutor(FoldExecutor(1), Clock(), lambda *_: ()))
    assert result.is_complete
