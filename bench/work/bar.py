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

from bench import progress
from bench.progress import span
from bench.work.results import FoldResult, reason_of

ALWAYS = 1e9  # seconds that rich looks back to estimate the time left


class Bar(Progress):
    """A bar for each run, one after the other; in a notebook too, where it needs ipywidgets.

    Args:
        runs: number of runs of the command.
    """

    def __init__(self, runs: int) -> None:
        self.runs, self.begun = runs, 0
        self.missing: list[str] = []
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
        """The run that goes on."""
        return self.tasks[0]

    def begin(self, title: str, folds: int, missing: Sequence[str]) -> None:
        """Add the bar of a run, of which some folds are missing; they are done in this order."""
        self.begun += 1
        title = f"run {self.begun} of {self.runs}: {title}" if self.runs > 1 else title
        self.missing = [*missing]
        self.add_task(title, total=folds, completed=folds - len(missing), now=self._now())

    def _now(self) -> str:
        """The fold that is under way, or the first of several."""
        return named(self.missing[0]) if self.missing else ""

    def end_fold(self, result: FoldResult) -> None:
        """Count a fold that is stored; where no bar is seen before the end (a log), print a line."""
        run = self.run
        self.missing.remove(result.name)
        self.update(run.id, advance=1, now=self._now())
        if result.error:
            self.console.print(f"{named(result.name)} failed: {result.reason}", style="red", markup=False)
        for name, error in result.failed.items():
            words = f"{named(result.name)}, {name}= failed: {reason_of(error)}"
            self.console.print(words, style="red", markup=False, soft_wrap=True)
        if not self.console.is_terminal:
            how = "failed" if result.error else "done"
            left = f", {span(run.time_remaining)} left" if run.time_remaining else ""
            done = f"{how} after {span(result.seconds)}, {run.completed:.0f} of {run.total:.0f} folds{left}"
            line = f"{run.description}: {named(result.name)} {done}"
            self.console.print(line, markup=False, highlight=False, soft_wrap=True)

    def end(self) -> None:
        """Print the bar of a run that has ended for good."""
        self.update(self.run.id, now="")
        self.console.print(self.make_tasks_table([self.run]))
        self.remove_task(self.run.id)

    def stop(self) -> None:
        """Leave the bar of a run that is cut off where it is."""
        if self.tasks:
            self.end()
        super().stop()


def named(fold: str) -> str:
    """Name of a fold in a line; some protocols call their folds fold01."""
    return fold if fold.startswith("fold") else f"fold {fold}"
