"""Checkpoints of training: the state of a network after its last epoch, kept in the data folder.

A training that took longer than a minute stays when it is done, so that ``bench stress`` need not
train what ``bench run`` has trained. What nobody has touched for a month goes.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import torch
from sklearn.base import BaseEstimator

from bench.corpora.corpus import Corpus
from bench.models.search.identity import identity, study_name
from bench.scratch import home, replacing

OFTEN_S = 1.0
LONG_S = 60.0  # what trains in less is trained again
SHARE = 50  # of the time that is spent on training, writing takes at most one part in so many
MONTH_S = 30 * 86400


class Checkpoint:
    """The state of one training; nothing is kept of captures that are not of a stored corpus.

    Args:
        path: the file, or None.

    Attributes:
        resumed: True if training continued from a stored state, or was already done.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._due = time.perf_counter() + OFTEN_S
        self.begin_anew()

    def begin_anew(self) -> None:
        """Count from now: the stored state is of no use."""
        self.resumed = False
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def read(self) -> dict | None:
        """The state as it was written; None if there is none, or none that can be read."""
        if self.path is None:
            return None
        try:
            kept = torch.load(self.path, weights_only=True)
            state, (wall, cpu) = kept["state"], map(float, kept["seconds"])
            if not np.isfinite([wall, cpu]).all():
                raise ValueError("seconds")
            self.path.touch()
        except Exception:  # not there, cut off or another's: training begins anew
            return None
        self._wall -= wall
        self._cpu -= cpu
        self.resumed = True
        return state

    def write(self, state: dict) -> None:
        """Keep a state, unless the last one is so new that writing would cost more than training again."""
        if (began := time.perf_counter()) >= self._due:
            self._write(state)
            ended = time.perf_counter()
            self._due = ended + max(OFTEN_S, SHARE * (ended - began))

    def done(self, state: dict) -> None:
        """Keep the last state of a long training, and delete that of a short one."""
        if self.seconds()[0] > LONG_S:
            self._write(state)
        elif self.path is not None:
            with suppress(OSError):
                self.path.unlink(missing_ok=True)

    def _write(self, state: dict) -> None:
        if self.path is None:
            return
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            _sweep(self.path.parent)
            with replacing(self.path) as beside:
                torch.save({"state": state, "seconds": self.seconds()}, beside)
        except (OSError, RuntimeError):  # a folder that cannot be written or is full only costs the resuming
            self.path = None

    def seconds(self) -> tuple[float, float]:
        """Seconds of the clock and of the processor for training, those before a kill included."""
        return time.perf_counter() - self._wall, time.process_time() - self._cpu


def _sweep(folder: Path) -> None:
    """Remove states that nobody has written or read for a month."""
    for path in folder.glob("*.pt"):
        with suppress(OSError):  # another process was first
            if time.time() - path.stat().st_mtime > MONTH_S:
                path.unlink()


def checkpoint(estimator: BaseEstimator, X: Corpus, y: np.ndarray) -> Checkpoint:
    """Checkpoint of a training, named by all that its result depends on: system, parameters, code, captures and labels.

    Nothing is kept where that has no name: of parameters that are objects, or functions made by others.
    """
    params = estimator.get_params(deep=False)
    if not X.digest or not _named(type(estimator)) or not all(map(_named, params.values())):
        return Checkpoint(None)
    params = {k: identity(v) if callable(v) else v for k, v in params.items()}
    system = {"system": identity(type(estimator)), "parameters": params}
    return Checkpoint(home() / "training" / f"{study_name(system, X, y)}.pt")


def _named(part: object) -> bool:
    """Whether a value, or a function or class with its source, is the same wherever it has the same name."""
    if isinstance(part, tuple):
        return all(map(_named, part))
    if isinstance(part, partial):
        return _named(part.func) and all(map(_named, (*part.args, *part.keywords.values())))
    if isinstance(part, Callable):
        plain = inspect.isclass(part) or (inspect.isfunction(part) and part.__closure__ is None)
        return plain and "<" not in part.__qualname__
    return part is None or isinstance(part, bool | int | float | str)
