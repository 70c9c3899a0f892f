"""Folds on a cluster of dask.distributed: which worker does which, and what happens when one is gone.

Each worker gets one fold at a time, by name, and the fold of one that is gone goes to another.
"""

from __future__ import annotations

import logging
import pickle
import queue
import threading
import time
import traceback
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from bench.corpora.folder import address
from bench.errors import ClusterError
from bench.outcomes.results import FoldResult
from bench.plan.arguments import Backend
from bench.plan.plan import Plan
from bench.progress import Said, forget, note
from bench.work import remote
from bench.work.alike import representatives
from bench.work.crew import GOES_ON, LOOK_S, SILENT_S, Crew, Remote, packed
from bench.work.remote import Answer
from bench.work.workers import Done, Task, Todo

if TYPE_CHECKING:
    from bench.work.machine import Machine

NEXT_S = 600.0  # for another worker, after the last is gone
TRIES = {"died": 2, "lost": 3}  # of a fold whose process died, and of one whose worker is gone


@dataclass(eq=False)
class Waiting:
    """A fold that is to be done.

    Attributes:
        task: it.
        question: as it is sent.
        tried: on which workers it came to no end, by how.
        by: the worker that has it, None while it waits.
        given: when that one got it, of `time.monotonic`.
    """

    task: Task
    question: bytes
    tried: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    by: Remote | None = None
    given: float = 0.0


class Cluster:
    """Workers of dask (`bench.work.workers.Workers`).

    Args:
        backend: where its scheduler is, and how long a fold may take.
        todo: all that is to be run.
        say: tells the user a line.
        told: folder where folds say how far they are (`bench.progress`).

    Attributes:
        threads: of each fold, as the workers were started.

    Raises:
        InputError: there is no such cluster, or none of its workers can be used.
    """

    overlap = True

    def __init__(self, backend: Backend, todo: Todo, say: Callable[[str], None], told: Path) -> None:
        self.place, self.limit, self.say, self.told = backend.cluster, backend.limit, say, told
        self.waiting: deque[Waiting] = deque()
        self.running: dict[tuple[str, str], Waiting] = {}  # by key of the run and name of the fold
        self.answers: queue.Queue[tuple[Remote, Waiting, Answer]] = queue.Queue()
        self.seen, self.alone = time.monotonic(), False  # when a worker was there, and whether it was said that none is
        corpora = {plan.corpus.digest: address(plan.corpus) for plan, _ in todo}
        cells = representatives((plan.cell, experiment) for plan, experiment in todo)
        self.crew = Crew(self.place, *cells, corpora, say)
        self.changing = self.crew.changing
        self.crew.freed = self._dispatch
        try:
            self.crew.client.subscribe_topic(remote.TOPIC, lambda event: self._hear(event[1]))
            self.crew.wait()
        except BaseException:
            self.crew.client.close()
            raise
        self.threads = self.crew.threads

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, kind: type[BaseException] | None, e: BaseException | None, at: TracebackType | None) -> None:
        """Part from the cluster, whose workers then end what they do for this command."""
        with self.changing:
            self.waiting.clear()
        self.crew.client.close(timeout=5)
        self.crew.tell()

    def count(self, plan: Plan) -> int:
        """How many folds are done at a time."""
        with self.changing:
            return max(1, sum(r.ready for r in self.crew.remotes.values()))

    def room(self, plan: Plan) -> bool:
        """Whether to submit a fold now: twice as many as can run, so that no worker waits while results are stored."""
        with self.changing:
            return len(self.running) < 2 * self.count(plan)

    def begin(self, plan: Plan) -> None:
        """Nothing: each machine computes its own features."""

    def submit(self, task: Task) -> None:
        """Have a fold done."""
        plan = task.plan
        given = (task.experiment, plan.cell, plan.corpus, task.fold, self.threads, task.key)
        question = packed(remote.fold, self.crew.name, *given)
        with self.changing:
            waiting = self.running[task.key, task.fold.name] = Waiting(task, question)
            self.waiting.append(waiting)
        self._dispatch()

    def finished(self) -> Done:
        """Wait until a fold that was submitted is done.

        Raises:
            ClusterError: the scheduler is gone, or all workers for too long.
        """
        while True:
            self._look()
            try:
                found = self._done(*self.answers.get(timeout=LOOK_S / 2))
            except queue.Empty:
                continue
            if found:
                return found

    def _look(self) -> None:
        """See who is there, and say so when nobody is.

        Raises:
            ClusterError: the scheduler is gone, or all workers for too long.
        """
        now = time.monotonic()
        if self.crew.look():
            self.seen, self.alone = now, False
        elif not self.alone:
            self.say(f"warning: cluster={self.place}: no worker is left; waiting for another one")
            self.alone = True
        elif now - self.seen > NEXT_S:
            raise ClusterError(f"cluster={self.place}: all workers are gone; {GOES_ON}")

    def _hear(self, said: list) -> None:
        """Note what a worker says of a fold of this command; called in a thread of dask's."""
        command, by, of, name, *rest = said
        with self.changing:
            fold = self.running.get((of, name)) if command == self.crew.name else None
            if fold is not None and fold.by is not None and fold.by.address == by:  # not one that has lost it
                hear(self.told, [of, name, *rest])

    def _dispatch(self) -> None:
        """Give folds that wait to workers that do nothing; one that ended badly goes to another if there is one."""
        with self.changing:
            ready = [r for r in self.crew.remotes.values() if r.ready]
            idle = [r for r in ready if not r.asked]
            for waiting in list(self.waiting):
                bad = {name for names in waiting.tried.values() for name in names}
                fresh = [r for r in idle if r.name not in bad]
                if not fresh and any(r.name not in bad for r in ready):
                    continue
                if not (able := fresh or idle):
                    return
                one = able[0]
                idle.remove(one)
                self.waiting.remove(waiting)
                waiting.by, waiting.given = one, time.monotonic()
                asked = (waiting.question, self.crew.name, self.crew.threads, self.limit)
                self.crew.begin(one, remote.answer, *asked).add_done_callback(partial(self._over, one, waiting))

    def _over(self, one: Remote, waiting: Waiting, asked: Any) -> None:
        """Called in a thread of dask's, of which there is but one."""
        threading.Thread(target=self._fetch, args=(one, waiting, asked), daemon=True).start()

    def _fetch(self, one: Remote, waiting: Waiting, asked: Any) -> None:
        """Bring an answer here, in a thread: where a worker has gone with it, dask waits for it.

        The worker gets the next fold, unless its process has to be examined first.
        """
        found = Answer("lost")
        try:
            if asked.status == "finished":
                found = asked.result(timeout=SILENT_S)
            elif asked.status == "error":
                self.crew.refuse(one, f"it failed: {asked.exception()!r}")
        except Exception as e:  # dask raises what it likes
            logging.getLogger(__name__).debug("no answer of %s: %r", one.address, e)
        with self.changing:
            one.asked.discard(asked)
            if found.status == "unknown":
                self.crew.examine(one)
        self.answers.put((one, waiting, found))
        try:
            self._dispatch()
        except ClusterError:  # or the command has ended
            pass

    def _done(self, one: Remote, waiting: Waiting, found: Answer) -> Done | None:
        """What came of a fold, None if it has to be done again."""
        task = waiting.task
        status = "lost" if found.status == "unwanted" else found.status
        if status == "done":
            try:
                result, machine = pickle.loads(found.content)
            except Exception:  # whatever a system's own objects raise is this fold's result
                status, found = "raised", Answer("raised", traceback.format_exc().encode())
            else:
                return self._ended(waiting, result, machine)
        if status == "unknown":  # its process is another than the one that was examined
            self._again(waiting)
            return None
        if status in TRIES:
            waiting.tried[status].append(one.name)
            if len(waiting.tried[status]) < TRIES[status]:
                self._again(waiting)
                return None
        late = f"The fold took longer than limit={self.limit:g} seconds" if self.limit else ""
        if not found.content:
            late = f"The fold had not begun after {remote.READY_S / 60:g} minutes: imports, or features of all captures"
        said = {
            "died": "The worker process died twice; out of memory?",
            "lost": f"Its worker was gone {TRIES['lost']} times; does the fold bring the machine down?",
            "late": late,
            "raised": found.content.decode(),
        }[status]
        result = FoldResult(task.fold.name, error=said, seconds=time.monotonic() - waiting.given)
        return self._ended(waiting, result, None)

    def _again(self, waiting: Waiting) -> None:
        with self.changing:
            waiting.by = None
            forget(self.told, waiting.task.key, waiting.task.fold.name)
            self.waiting.appendleft(waiting)
        self._dispatch()

    def _ended(self, waiting: Waiting, result: FoldResult, machine: Machine | None) -> Done:
        task = waiting.task
        with self.changing:
            forget(self.told, task.key, task.fold.name)  # of a worker that is gone, nobody else would
            del self.running[task.key, task.fold.name]
        return Done(task, result, machine)


def hear(folder: Path, heard: list) -> None:
    """Note what a fold says that is done elsewhere, by the clock of this machine, or that it says nothing any longer.

    Args:
        folder: of `bench.progress`.
        heard: as `bench.work.remote.report` says it.
    """
    of, name, *rest = heard
    if not rest:
        forget(folder, of, name)
        return
    words, left, elapsed, since = rest
    now = time.time()
    note(folder, Said(of, name, words, left, now - elapsed, now - since))
