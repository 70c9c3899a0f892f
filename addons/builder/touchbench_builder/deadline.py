"""Comparisons that end when they would not be ready in time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Self

from bench.ground.progress import format_estimate
from bench.running.workers import FoldExecutor
from bench.values.result import format_count

if TYPE_CHECKING:
    from bench.plan.plan import Fold, Plan
    from bench.running.results import FoldResult


class OutOfTime(KeyboardInterrupt):
    """The rest of a comparison would take too long; its finished folds are stored."""


class LimitedExecutor(FoldExecutor):
    """Another executor, which ends a comparison that would not be ready in time.

    Args:
        executor: the other one.
        is_in_time: of a plan, with the seconds of all its folds, and of those that are missing.
    """

    def __init__(
        self, executor: FoldExecutor, is_in_time: Callable[[Plan, float, float], bool]
    ) -> None:
        super().__init__(executor.jobs)
        self.executor, self.is_in_time = executor, is_in_time

    def __enter__(self) -> Self:
        self.threads = self.executor.__enter__().threads
        return self

    def __exit__(self, *error: Any) -> None:
        self.executor.__exit__(*error)

    def run_folds(self, plan: Plan, missing: Sequence[Fold]) -> Iterator[FoldResult]:
        """Run folds; raise `OutOfTime` once a fold of each worker shows that time is too short."""
        began = time.monotonic()
        for done, result in enumerate(self.executor.run_folds(plan, missing), 1):
            yield result
            each = (time.monotonic() - began) / done
            seconds = each * len(plan.folds), each * (len(missing) - done)
            is_known = plan.workers <= done < len(missing)
            if is_known and not self.is_in_time(plan, *seconds):
                estimate = f"its comparison would take {format_estimate(seconds[0])}"
                raise OutOfTime(f"after {format_count(done, 'fold')}, {estimate}")
