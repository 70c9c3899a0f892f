"""Folds of one plan in processes, without tracking."""

from bench.work.workers import Processes, Task


def folds_done(plan, experiment, folds):
    """Results in the order in which folds finish."""
    waiting, left = list(folds), len(folds)
    with Processes(plan) as workers:
        while left:
            while waiting and workers.room(plan):
                workers.submit(Task(plan, experiment, waiting.pop(0)))
            yield workers.finished().result
            left -= 1
