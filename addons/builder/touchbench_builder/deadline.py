"""Comparisons that end when they would not be ready in time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Self

from bench.ground.progress import format_estimate
from bench.running.workers import FoldExecutor
from bench.values.result import format_count

if TYPE_CHECKING:
    from bench.plan.plan import Fold, Plan
    from bench.running.results import FoldResult
    from touchbench_builder.progress import Progress


class OutOfTime(KeyboardInterrupt):
    """The rest of a comparison would take too long; its finished folds are stored.

    Attributes:
        seconds: of all folds of the comparison.
    """

    def __init__(self, message: str, seconds: float) -> None:
        super().__init__(message)
        self.seconds = seconds


class LimitedExecutor(FoldExecutor):
    """Another executor, which ends a comparison that would not be ready in time.

    Args:
        executor: the other one.
        progress: has the seconds left.
        later_seconds: of what comes after a comparison, given its plan and its seconds.
    """

    def __init__(
        self,
        executor: FoldExecutor,
        progress: Progress,
        later_seconds: Callable[[Plan, float], tuple[float, ...]],
    ) -> None:
        super().__init__(executor.jobs)
        self.executor, self.progress, self.later_seconds = executor, progress, later_seconds

    def __enter__(self) -> Self:
        self.threads = self.executor.__enter__().threads
        return self

    def __exit__(self, *error: Any) -> None:
        self.executor.__exit__(*error)

    def run_folds(self, plan: Plan, missing: Sequence[Fold]) -> Iterator[FoldResult]:
        """Run folds; raise `OutOfTime` once a fold of each worker shows that time is too short."""
        left = self.progress.seconds_left
        for done, result in enumerate(self.executor.run_folds(plan, missing), 1):
            yield result
            each = (left - self.progress.seconds_left) / done
            seconds = each * len(plan.folds)
            needed = each * (len(missing) - done) + sum(self.later_seconds(plan, seconds))
            if plan.workers <= done < len(missing) and self.progress.seconds_left < needed:
                more = f"it would take {format_estimate(needed)} more with its tests and last fit"
                raise OutOfTime(f"after {format_count(done, 'fold')}, {more}", seconds)
