"""Folds on a cluster of dask.distributed: dask decides who does which, and does it again where a worker is gone.

This is the side of the command; `bench.on_cluster.worker` is what workers do.
"""

from __future__ import annotations

import asyncio
import json
import logging
import pickle
import queue
import secrets
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from bench.errors import ClusterError, InputError
from bench.on_cluster.worker import answer, check_of, packed
from bench.plan.plan import Plan
from bench.progress import Message, forget, note
from bench.work.results import FoldResult
from bench.work.workers import Done, Task, Todo

if TYPE_CHECKING:
    from distributed import Client, Future

LOOK_S = 1.0  # between two looks at who is there
FIRST_S = 30.0  # for the first worker to come, and for all that are there to answer
ANSWER_S = 10.0  # that a scheduler has to answer at first


class Cluster:
    """Workers of dask (`bench.work.workers.Workers`).

    Args:
        address: the address of the scheduler, or the file that it has written.
        todo: all that is to be run.
        say: function that prints a line.
        folder: folder for progress messages of folds (`bench.progress`).

    Attributes:
        threads: threads of each fold, the least number that a worker was started with.

    Raises:
        InputError: there is no such cluster, or none of its workers can be used.
    """

    overlap = True

    def __init__(self, address: str, todo: Todo, say: Callable[[str], None], folder: Path) -> None:
        self.address, self.say, self.folder = address, say, folder
        self.name = secrets.token_hex(8)
        self.check = check_of([plan.cell for plan in todo])
        self.checks: dict[str, Future] = {}  # what each worker was asked first, by its address
        self.refusals: dict[str, str] = {}  # why one cannot be used; empty for one that can
        self.good: list[str] = []
        self.useless = ""  # what to say if all workers that are there were refused
        self.running: dict[Future, Task] = {}
        self.over: queue.Queue[Future] = queue.Queue()
        self.threads, self.seen, self.alone = 0, time.monotonic(), False
        self.client = connected(address)
        try:
            self.client.subscribe_topic(self.name, lambda event: self._hear(*event[1]))
            self._wait()
        except BaseException:
            self.client.close()
            raise

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, kind: type[BaseException] | None, e: BaseException | None, at: TracebackType | None) -> None:
        """Disconnect from the cluster, whose workers then end their tasks for this command."""
        self.client.close(timeout=5)

    def count(self, plan: Plan) -> int:
        """The number of folds done at a time."""
        return max(1, len(self.good))

    def room(self, plan: Plan) -> bool:
        """Return True to submit a fold now: twice the number that can run, so that workers never wait for storing."""
        ahead = 2 if self.threads == 1 else 1  # dask takes a worker with more threads for one that does more at a time
        return len(self.running) < ahead * self.count(plan)

    def begin(self, plan: Plan) -> None:
        """Do nothing: each machine computes its own features."""

    def submit(self, task: Task) -> None:
        """Have a fold done by any good worker, or if all of them are gone by a new one."""
        fold = packed(task.plan.cell, task.plan.corpus, task.fold, self.threads, task.key)
        future = self._ask(fold, workers=self.good or None, allow_other_workers=bool(self.good), retries=1)
        self.running[future] = task
        future.add_done_callback(self.over.put)

    def finished(self) -> Done:
        """Wait until a fold that was submitted is done.

        Raises:
            ClusterError: the scheduler is gone, or no worker that is left can be used.
        """
        while True:
            self._look()
            if self.useless and time.monotonic() - self.seen > FIRST_S:
                raise ClusterError(self.useless)
            try:
                future = self.over.get(timeout=LOOK_S)
            except queue.Empty:
                continue
            if done := self._done(future, self.running.pop(future)):
                return done

    def _done(self, future: Future, task: Task) -> Done | None:
        """What came of a fold; None if the worker that had it differs from this machine, so that another has to do it.

        Raises:
            ClusterError: the scheduler is gone.
        """
        machine = None
        try:
            worker, refusal, content = future.result()
            result, machine = (None, None) if refusal else pickle.loads(content)
        except Exception as e:  # the process has died twice, or workers four times; or the result cannot be read
            if future.cancelled():
                raise self._gone() from e
            error = str(e) if future.status == "error" else traceback.format_exc()
            result = FoldResult(task.fold.name, error=error)
        forget(self.folder, task.key, task.fold.name)
        if result is not None:
            return Done(task, result, machine)
        self._judge(worker, refusal)
        self._look()
        if not self.good:
            time.sleep(LOOK_S)
        self.submit(task)
        return None

    def _wait(self) -> None:
        """Wait until all workers that are there have answered, or after a while one of them.

        Raises:
            InputError: none comes, or none can be used.
        """
        began = time.monotonic()
        while not self.good or (len(self.refusals) < len(self.checks) and time.monotonic() - began < FIRST_S):
            self._look()
            if self.useless:
                raise InputError(self.useless)
            if not self.checks and time.monotonic() - began > FIRST_S:
                start = f"start some, such as: dask worker {self.address} --nworkers 4 --nthreads 1"
                raise InputError(f"cluster={self.address}: it has no worker; {start}")
            time.sleep(0.1)

    def _look(self) -> None:
        """See who has come and who is gone.

        Raises:
            ClusterError: the scheduler is gone.
        """
        try:
            there = self.client.nthreads()
        except Exception as e:  # dask has several
            raise self._gone() from e
        self.threads = self.threads or min(there.values(), default=0)
        for worker in there:
            if worker not in self.checks:
                self.checks[worker] = self._ask(workers=[worker])
            elif worker not in self.refusals and self.checks[worker].done():
                self._judge(worker, self._refusal(self.checks[worker]))
        self.good = [worker for worker in there if self.refusals.get(worker) == ""]
        refused = [self.refusals[worker] for worker in there if self.refusals.get(worker)]
        all_refused = f"cluster={self.address}: none of {len(there)} workers can be used; {min(refused, default='')}"
        self.useless = all_refused if refused and len(refused) == len(there) else ""
        if self.good:
            self.seen, self.alone = time.monotonic(), False
        elif not self.alone and time.monotonic() - self.seen > FIRST_S:
            self.say(f"warning: cluster={self.address}: no worker answers; waiting for one, Ctrl-C ends it")
            self.alone = True

    def _refusal(self, check: Future) -> str:
        try:
            return check.result()[1]
        except Exception as e:  # dask raises what it likes
            why = " ".join(f"{type(e).__name__}: {e}".split())
            return f"{why}; is touchbench installed there, and was it restarted after an upgrade?"

    def _judge(self, worker: str, refusal: str) -> None:
        line = f"worker {worker} is left out: {refusal}" if refusal else ""
        if line and self.refusals.get(worker) != line:
            self.say(f"warning: {line}")
        self.refusals[worker] = line

    def _ask(self, fold: bytes = b"", **how: Any) -> Future:
        """Have a worker asked whether it gives the results of this machine, and then for a fold if there is one."""
        try:
            return self.client.submit(answer, self.name, self.threads, self.check, fold, pure=False, **how)
        except Exception as e:  # dask has several
            raise self._gone() from e

    def _hear(self, key: str, name: str, words: str, left: float | None, elapsed: float, since: float) -> None:
        """Note what a fold of this command says, by the clock of this machine; called in a thread of dask's."""
        if any((task.key, task.fold.name) == (key, name) for task in list(self.running.values())):
            now = time.time()
            note(self.folder, Message(key, name, words, left, now - elapsed, now - since))

    def _gone(self) -> ClusterError:
        return ClusterError(
            f"cluster={self.address}: the scheduler is gone; every finished fold is stored, and the same command "
            "continues from there"
        )


def connected(address: str) -> Client:
    """Dask's client of a scheduler.

    Args:
        address: address of the scheduler, or the file that holds it.

    Raises:
        InputError: dask is not installed, or no scheduler answers there.
    """
    try:
        from distributed import Client
    except ImportError as e:
        raise InputError(f"cluster={address}: dask is not installed; pip install 'touchbench[cluster]'") from e
    for name in ("distributed.client", "distributed.core"):  # what they say of lost connections, we say
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        where = json.loads(Path(address).read_text())["address"] if Path(address).is_file() else address
        with ThreadPoolExecutor(1) as thread:  # in a notebook, a loop runs in this one
            thread.submit(asyncio.run, _greeted(where)).result()
        return Client(where, timeout=ANSWER_S, set_as_default=False)
    except Exception as e:  # dask has many
        why = " ".join(str(e).split()) or f"{type(e).__name__} after {ANSWER_S:g} s"
        raise InputError(
            f"cluster={address}: no scheduler answers ({why[:80]}); give tcp://HOST:8786 of one that runs, or the file "
            "that it was started with (--scheduler-file)"
        ) from e


async def _greeted(where: str) -> None:
    """Ask a scheduler for its name: dask's client waits for ever for what answers otherwise, and ends badly."""
    from distributed import Security
    from distributed.core import rpc

    async with rpc(where, connection_args=Security().get_connection_args("client")) as scheduler:
        await asyncio.wait_for(scheduler.identity(n_workers=0), ANSWER_S)
