"""Processes of loky that do folds and stay for the next one: importing torch takes seconds.

Whoever imports this module gets little with it: a worker of a cluster does.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import ParamSpec, Protocol, TypeVar

from joblib.externals.loky import get_reusable_executor

Given = ParamSpec("Given")
Result = TypeVar("Result")


class Executor(Protocol):
    """The used part of loky, which has no types."""

    def submit(self, work: Callable[Given, Result], *args: Given.args, **kwargs: Given.kwargs) -> Future[Result]:
        """Have something done in a process."""

    def shutdown(self, wait: bool, kill_workers: bool) -> None:
        """End the processes."""


def pool(jobs: int, threads: int) -> Executor:
    """So many processes that compute with so many threads each; those of the last call, if they are like that."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return get_reusable_executor(
        max_workers=jobs,
        timeout=60,
        initializer=_begin,
        initargs=(os.getpid(),),
        env=dict.fromkeys(names, str(threads)),
    )


def _begin(parent: int) -> None:
    """Ctrl-C reaches the whole process group, only the parent acts on it; a parent that is killed cannot."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process, in the middle of a fold, once its parent is gone: nobody would take the result."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)
