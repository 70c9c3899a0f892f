"""Where a killed training goes on: the state of a network after its last epoch, kept in the data folder.

A training that took longer than a minute stays when it is done, so that ``bench stream`` and ``bench stress`` need not
train what ``bench run`` has trained.
"""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
from sklearn.base import BaseEstimator

from bench.corpora.corpus import Corpus
from bench.scratch import home, replacing
from bench.source import source_digest
from models.study import identity, study_name

OFTEN_S = 1.0
LONG_S = 60.0  # what trains in less is trained again
SHARE = 50  # of the time that is spent on training, writing takes at most one part in so many


class Checkpoint:
    """The state of one training; nothing is kept of captures that are not of a stored corpus.

    Args:
        path: the file, or None.

    Attributes:
        resumed: whether training went on from a state, or was done before.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.resumed = False
        self._wall, self._cpu = time.perf_counter(), time.process_time()
        self._due = time.perf_counter() + OFTEN_S

    def read(self) -> dict | None:
        """The state as it was written; None if there is none, or none that can be read."""
        if self.path is None:
            return None
        try:
            kept = torch.load(self.path, weights_only=True)
            state, (wall, cpu) = kept["state"], kept["seconds"]
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
        """Keep the last state of what took long, and forget that of what did not."""
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
            with replacing(self.path) as beside:
                torch.save({"state": state, "seconds": self.seconds()}, beside)
        except OSError:  # a folder that cannot be written only costs the resuming
            self.path = None

    def seconds(self) -> tuple[float, float]:
        """Of the clock and of the processor that training took, those before a kill included."""
        return time.perf_counter() - self._wall, time.process_time() - self._cpu


def checkpoint(estimator: BaseEstimator, X: Corpus, y: np.ndarray) -> Checkpoint:
    """Of a training, named by all that its result depends on: system, parameters, code, captures and labels."""
    if not X.digest:
        return Checkpoint(None)
    given = {k: identity(v) if callable(v) else v for k, v in estimator.get_params(deep=False).items()}
    code = source_digest(*(part for step in X.steps for part in step.code())) if X.steps else ""
    what = {"system": identity(type(estimator)), "parameters": given, "steps": [repr(X.steps), code, X.piece.tolist()]}
    return Checkpoint(home() / "training" / f"{study_name(what, X, y)}.pt")
