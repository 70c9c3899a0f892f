"""Folds of one plan in processes, without tracking; and folds that do nothing."""

from dataclasses import dataclass
from typing import ClassVar

from bench.work.experiment import Experiment
from bench.work.results import FoldResult
from bench.work.workers import Processes, Task


def folds_done(plan, experiment, folds):
    """Results in the order in which folds finish."""
    waiting, left = list(folds), len(folds)
    with Processes() as workers:
        while left:
            while waiting and workers.room(plan):
                workers.submit(Task(plan, experiment, waiting.pop(0), "key"))
            yield workers.finished().result
            left -= 1


@dataclass(frozen=True)
class Nothing(Experiment):
    """Does nothing."""

    tag: ClassVar[str] = "nothing"

    def fold(self, cell, corpus, fold, threads):
        """Hand back nothing."""
        return FoldResult(fold.name)
