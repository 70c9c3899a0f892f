"""The bar of the folds of each run, with the time left, and lines below it that tell what is running."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path

from rich.console import RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

from bench import progress
from bench.progress import Message, about, messages, seconds_left, smoothed, span
from bench.work.results import FoldResult, reason_of

NAMED = 3  # running folds that a line names


class Bar(Progress):
    """A bar for each run that goes on; in a notebook too, where it needs ipywidgets.

    Args:
        folder: folder with the messages of folds (`bench.progress`).
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.shown: dict[tuple[str, str], tuple[float, float]] = {}  # by run and fold: seconds left, and when shown
        super().__init__(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("folds"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}", style="progress.remaining", markup=False),
            console=progress.console,
            transient=True,
        )

    def begin(self, key: str, title: str, folds: int, stored: int, workers: Callable[[], int]) -> None:
        """Add the bar of a run.

        Args:
            key: key of the run.
            title: text before the bar.
            folds: number of folds of the run.
            stored: number of folds that are stored already.
            workers: function that returns how many folds of the run are done at a time.
        """
        self.add_task(title, total=folds, completed=stored, key=key, left="", seconds=[], workers=workers)

    def advance_fold(self, key: str, result: FoldResult) -> None:
        """Count a fold that is stored; where no bar is seen before the end (a log), print a line."""
        run = self._of(key)
        self.advance(run.id)
        if result.error:
            self.console.print(f"{named(result.name)} failed: {result.reason}", style="red", markup=False)
        else:  # what failed at once says nothing of the others
            run.fields["seconds"].append(result.seconds)
        for name, error in result.failed.items():
            words = f"{named(result.name)}, {name}= failed: {reason_of(error)}"
            self.console.print(words, style="red", markup=False, soft_wrap=True)
        if not self.console.is_terminal:
            self._estimate(messages(self.folder))
            how = "failed" if result.error else "done"
            after = f" after {span(result.seconds)}" if result.seconds else ""
            left = f", {run.fields['left']}" if run.fields["left"] else ""
            done = f"{run.completed:.0f} of {run.total:.0f} folds"
            line = f"{run.description}: {named(result.name)} {how}{after}, {done}{left}"
            self.console.print(line, markup=False, highlight=False, soft_wrap=True)

    def end(self, key: str) -> None:
        """Print the bar of a run that has ended for good; others may go on."""
        run = self._of(key)
        self._estimate(messages(self.folder))
        self.console.print(self.make_tasks_table([run]))
        self.remove_task(run.id)

    def stop(self) -> None:
        """Leave the bars of runs that are cut off where they are."""
        for run in self.tasks:
            self.end(run.fields["key"])
        super().stop()

    def get_renderables(self) -> Iterable[RenderableType]:
        """The bars and the lines."""
        now, spoken = time.time(), messages(self.folder)
        self._estimate(spoken)
        yield self.make_tasks_table(self.tasks)
        titles = {run.fields["key"]: f"{run.description}: " for run in self.tasks if len(self.tasks) > 1}
        keys = {run.fields["key"] for run in self.tasks}
        silent: dict[str, list[str]] = {}  # by run: folds that run without a message
        for message in spoken:
            if message.words:
                left = ""
                if message.left is not None:
                    left = f", {about(self._smoothed(message[:2], message.left - (now - message.at)))} left"
                name = named(message.fold) if message.run else message.fold
                yield _line(f"{titles.get(message.run, '')}{name}: {message.words}{left}")
            elif message.run in keys:
                silent.setdefault(message.run, []).append(message.fold)
        for key, names in silent.items():
            more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
            words = ", ".join([named(names[0]), *names[1:NAMED]])
            yield _line(f"{titles.get(key, '')}running: {words}{more}")

    def _of(self, key: str) -> Task:
        return next(run for run in self.tasks if run.fields["key"] == key)

    def _estimate(self, spoken: list[Message]) -> None:
        """Note at each bar how long its folds still take; nothing before one of them is done."""
        now = time.time()
        for run in self.tasks:
            going = [
                (now - message.began, None if message.left is None else message.left - (now - message.at))
                for message in spoken
                if message.run == run.fields["key"]
            ]
            remaining = int(run.remaining or 0)
            waiting = max(remaining - len(going), 0)
            left = seconds_left(run.fields["seconds"], going, waiting, run.fields["workers"]())
            run.fields["left"] = ""
            if remaining and left is not None:
                run.fields["left"] = f"{about(self._smoothed((run.fields['key'], ''), left))} left"

    def _smoothed(self, of: tuple[str, str], estimate: float) -> float:
        """The time left to show of a run, or of one of its folds."""
        now = time.time()
        before, at = self.shown.get(of, (None, now))
        self.shown[of] = smoothed(before, max(estimate, 0.0), now - at), now
        return self.shown[of][0]


def named(fold: str) -> str:
    """Name of a fold in a line; some protocols call their folds fold01."""
    return fold if fold.startswith("fold") else f"fold {fold}"


def _line(words: str) -> Text:
    return Text(f"  {words}", overflow="ellipsis", no_wrap=True)
