"""Where a search keeps what it has tried: an Optuna study in the data folder, under all that its scores depend on."""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from filelock import FileLock

from bench.corpora.corpus import Corpus
from bench.scratch import home
from bench.source import source_digest, versions

if TYPE_CHECKING:
    from optuna import Study


@contextmanager
def open_study(
    what: dict[str, object], X: Corpus, y: np.ndarray, directions: list[str], worse: float
) -> Iterator[Study]:
    """The study of one search on these captures; stored, and held against other processes, if the corpus is.

    Args:
        what: what is searched, and how.
        X: the training captures.
        y: their class names.
        directions: of Optuna, one per objective.
        worse: p-value below which a trial is given up.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        pruner = optuna.pruners.WilcoxonPruner(p_threshold=worse)
        path = home() / "studies" / f"{study_name(what, X, y)}.journal"
        lock = FileLock(path.with_suffix(".lock"))
        stored = bool(X.digest)
        if stored:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                lock.acquire()
            except OSError:  # a folder that cannot be written only costs the resuming
                stored = False
        try:
            yield optuna.create_study(
                storage=_journal(path) if stored else None,
                study_name="search",
                directions=directions,
                pruner=pruner,
                load_if_exists=True,
            )
        finally:
            lock.release()


def in_memory(worse: float) -> Study:
    """A study of one objective that nothing is kept of."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        return optuna.create_study(direction="maximize", pruner=optuna.pruners.WilcoxonPruner(p_threshold=worse))


def _journal(path: Path) -> object:
    """Storage in a file that only this process has open; a last line that was cut off is dropped."""
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock

    class Held(JournalFileOpenLock):
        """Nothing to do: the study is locked already. Optuna's own lock outlives a killed process by 30 s."""

        def acquire(self) -> bool:
            return True

        def release(self) -> None:
            pass

    if path.exists():
        content = path.read_bytes()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            os.truncate(path, whole)
    return JournalStorage(JournalFileBackend(str(path), Held(str(path))))


def study_name(what: dict[str, object], X: Corpus, y: np.ndarray) -> str:
    """Hash of the captures, the labels, what is searched and the versions of libraries."""
    parts = {
        "captures": [X.digest, hashlib.sha256(X.index.tobytes()).hexdigest()],
        "labels": hashlib.sha256("\n".join(map(str, y)).encode()).hexdigest(),
        "what": what,
        "versions": versions(),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:32]


def identity(part: Callable) -> list:
    """Name and source of a factory or class; of a partial one also what it was given."""
    if isinstance(part, partial):
        return [*identity(part.func), repr((part.args, sorted(part.keywords.items())))]
    return [part.__module__, part.__qualname__, source_digest(part)]
