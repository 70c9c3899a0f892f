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

    ``todo`` has the missing folds of each of the runs that are not ``stored``, and the seconds that they are expected
    to take, None if unknown.
    """

    def __init__(
        self, runs: int, stored: int = 0, todo: Sequence[tuple[int, float | None]] = ()
    ) -> None:
        self.runs, self.begun, self.todo = runs, stored, [*todo]
        self.title, self.missing = "", list[str]()
        self.now: tuple[int, float | None] = (0, None)  # of the run that goes on
        self.done, self.seconds = 0, 0.0  # folds of earlier runs, and how long they took
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

    def begin_run(self, title: str, folds: int, missing: Sequence[str]) -> None:
        """Add the bar of a run, of which some folds are missing; they are done in this order."""
        self.begun += 1
        self.title, self.missing = title, [*missing]
        self.now = self.todo.pop(0) if self.todo else (len(missing), None)
        self.add_task(title, total=folds, completed=folds - len(missing), now="")
        self._refresh(self.left)

    def _refresh(self, left: float | None, done: int = 0) -> None:
        """Show the run, its number among several, the time left for all of these, and the first fold under way."""
        time = f", {format_estimate(left)} left" if left and left >= 1 else ""
        words = (
            f"run {self.begun} of {self.runs}{time}: {self.title}" if self.runs > 1 else self.title
        )
        now = fold_title(self.missing[0]) if self.missing else ""
        self.update(self.run.id, advance=done, description=words, now=now)

    @property
    def left(self) -> float | None:
        """Seconds until all runs are done; None as long as nothing is known of one of them.

        A run goes on as fast as so far. One that waits takes its expected time, or as long as other folds on average.
        """
        (folds, usual), spent, missing = self.now, self.run.elapsed or 0.0, len(self.missing)
        done = folds - missing
        paces = [(self.seconds + spent) / (self.done + done)] if self.done + done else []
        here = (
            spent / done * missing if done else None if usual is None else max(0.0, usual - spent)
        )
        waiting = [(folds, time) for folds, time in ((missing, here), *self.todo)]
        if not paces and any(time is None for _, time in waiting):
            return None
        return sum(count * paces[0] if time is None else time for count, time in waiting)

    def end_fold(self, result: FoldResult) -> None:
        """Count a fold that is stored; where no bar is seen before the end (a log), print a line."""
        run = self.run
        self.missing.remove(result.name)
        self._refresh(self.left, 1)
        lines = [f"{fold_title(result.name)} failed: {result.reason}"] if result.error else []
        lines += [
            f"{fold_title(result.name)}, {key}= failed: {one_line_reason(error)}"
            for key, error in result.failed.items()
        ]
        for line in lines:
            self.console.print(line, style="red", markup=False, soft_wrap=True)
        if not self.console.is_terminal:
            how = "failed" if result.error else "done"
            left = (
                f", {format_seconds(run.time_remaining)} left"
                if run.time_remaining and self.runs == 1
                else ""
            )
            done = f"{how} after {format_seconds(result.seconds)}, {run.completed:.0f} of {run.total:.0f} folds{left}"
            line = f"{run.description}: {fold_title(result.name)} {done}"
            self.console.print(line, markup=False, highlight=False, soft_wrap=True)

    def end_run(self) -> None:
        """Print the bar of a run that has ended for good."""
        self.done, self.seconds = (
            self.done + self.now[0] - len(self.missing),
            self.seconds + (self.run.elapsed or 0.0),
        )
        self.missing.clear()
        self._refresh(None)
        self.console.print(self.make_tasks_table([self.run]))
        self.remove_task(self.run.id)

    def stop(self) -> None:
        """Leave the bar of a run that is cut off where it is."""
        if self.tasks:
            self.end_run()
        super().stop()


def fold_title(fold: str) -> str:
    """Name of a fold in a line; some protocols call their folds fold01."""
    return fold if fold.startswith("fold") else f"fold {fold}"
