"""The bar of the run that goes on: its folds that are done, and the time left."""

from __future__ import annotations

from collections.abc import Sequence

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from bench.ground import progress
from bench.ground.progress import format_estimate, format_seconds
from bench.running.results import FoldResult, one_line_reason

ALWAYS = 1e9  # seconds that rich looks back to estimate the time left


class Bar(Progress):
    """A bar for each run, one after the other; in a notebook too, where it needs ipywidgets.

    Args:
        runs: number of runs.
        stored: number of runs that are stored.
        waiting: of each other run, the number of missing folds and their expected seconds, None if
            unknown.
    """

    def __init__(
        self, runs: int, stored: int = 0, waiting: Sequence[tuple[int, float | None]] = ()
    ) -> None:
        self.runs, self.started, self.waiting = runs, stored, [*waiting]
        self.title, self.missing = "", list[str]()
        self.expected: tuple[int, float | None] = (0, None)  # folds and seconds of the present run
        self.past_folds, self.past_seconds = 0, 0.0  # of earlier runs
        super().__init__(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("folds"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[now]}", markup=False),
            console=progress.console,
            transient=True,
            speed_estimate_period=ALWAYS,
        )

    @property
    def run(self) -> Task:
        """The present run."""
        return self.tasks[0]

    def begin_run(self, title: str, folds: int, missing: Sequence[str]) -> None:
        """Add the bar of a run, whose missing folds are run in this order."""
        self.started += 1
        self.title, self.missing = title, [*missing]
        self.expected = self.waiting.pop(0) if self.waiting else (len(missing), None)
        self.add_task(title, total=folds, completed=folds - len(missing), now="")
        self._refresh(self.seconds_left)

    def _refresh(self, seconds: float | None, new_folds: int = 0) -> None:
        """Show the run, its number among several, the time left for all, and the present fold."""
        words = self.title
        if self.runs > 1:
            time = f", {format_estimate(seconds)} left" if seconds and seconds >= 1 else ""
            words = f"run {self.started} of {self.runs}{time}: {self.title}"
        now = fold_title(self.missing[0]) if self.missing else ""
        self.update(self.run.id, advance=new_folds, description=words, now=now)

    @property
    def seconds_left(self) -> float | None:
        """Seconds until all runs are done; None if nothing is known of one of them.

        The present run goes on as fast as so far. A waiting one takes its expected time, or as long
        as other folds on average.
        """
        (folds, expected), missing = self.expected, len(self.missing)
        spent, done = self.run.elapsed or 0.0, folds - missing
        left = None if expected is None else max(0.0, expected - spent)
        if done:
            left = spent / done * missing
        times = [(missing, left), *self.waiting]
        if self.past_folds + done == 0:
            known = [seconds for _, seconds in times if seconds is not None]
            return sum(known) if len(known) == len(times) else None
        pace = (self.past_seconds + spent) / (self.past_folds + done)
        return sum(count * pace if seconds is None else seconds for count, seconds in times)

    def end_fold(self, result: FoldResult) -> None:
        """Count a stored fold; print a line where no bar is visible before the end (a log)."""
        run, title = self.run, fold_title(result.name)
        self.missing.remove(result.name)
        self._refresh(self.seconds_left, 1)
        lines = [f"{title} failed: {result.reason}"] if result.error else []
        for key, error in result.failed.items():
            lines.append(f"{title}, {key}= failed: {one_line_reason(error)}")
        for line in lines:
            self.console.print(line, style="red", markup=False, soft_wrap=True)
        if not self.console.is_terminal:
            status = "failed" if result.error else "done"
            line = f"{run.description}: {title} {status} after {format_seconds(result.seconds)}, "
            line += f"{run.completed:.0f} of {run.total:.0f} folds"
            if self.runs == 1 and self.missing and (seconds := self.seconds_left):
                line += f", {format_seconds(seconds)} left"
            self.console.print(line, markup=False, highlight=False, soft_wrap=True)

    def end_run(self) -> None:
        """Print the final bar of a run."""
        self.past_folds += self.expected[0] - len(self.missing)
        self.past_seconds += self.run.elapsed or 0.0
        self.missing.clear()
        self._refresh(None)
        self.console.print(self.make_tasks_table([self.run]))
        self.remove_task(self.run.id)

    def stop(self) -> None:
        """Leave the bar of a run that is cut off as it is."""
        if self.tasks:
            self.end_run()
        super().stop()


def fold_title(fold: str) -> str:
    """Name of a fold in a line; some protocols call their folds fold01."""
    return fold if fold.startswith("fold") else f"fold {fold}"
