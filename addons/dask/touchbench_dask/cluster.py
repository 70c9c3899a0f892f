"""Folds on the workers of a Dask scheduler, which repeats a fold once if its worker dies."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType

from bench.corpora.corpus import Corpus
from bench.errors import ClusterError, InputError
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan
from bench.running.results import FoldResult
from bench.running.workers import do_fold, fill_cache

ANSWER_S = 10.0  # that a scheduler has to answer
FIRST_S = 30.0  # for the first worker to come
_filled: set[str] = set()  # of a worker's process: systems whose features are kept


class Cluster:
    """The workers of a scheduler (as `bench.running.workers.Here`).

    Args:
        address: address of the scheduler, or the file that it has written.
        plans: all that is to be run.
        say: prints a line.
    """

    def __init__(self, address: str, plans: Sequence[Plan], say: Callable[[str], None]) -> None:
        from distributed import Client

        for name in (
            "distributed.client",
            "distributed.core",
        ):  # what they say of lost connections, we say
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.address = address
        try:
            where = (
                json.loads(Path(address).read_text())["address"]
                if Path(address).is_file()
                else address
            )
            self.client = Client(where, timeout=ANSWER_S, set_as_default=False)
        except Exception as e:  # Dask has many
            why = " ".join(str(e).split()) or f"{type(e).__name__} after {ANSWER_S:g} s"
            raise InputError(
                f"cluster={address}: no scheduler answers ({why[:80]}); give tcp://HOST:8786 of one that runs, or the "
                "file that it was started with (--scheduler-file)"
            ) from e
        try:
            self.client.wait_for_workers(1, timeout=FIRST_S)
        except Exception as e:
            self.client.close()
            start = f"start some, such as: dask worker {address} --nworkers 4 --nthreads 1"
            raise InputError(f"cluster={address}: it has no worker; {start}") from e
        self.threads = min(self.client.nthreads().values())

    def __enter__(self) -> Cluster:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, e: BaseException | None, at: TracebackType | None
    ) -> None:
        """Disconnect; the scheduler then drops the folds that wait."""
        self.client.close(timeout=5)

    def folds(self, plan: Plan, missing: Sequence[Fold]) -> Iterator[FoldResult]:
        """Do folds of a plan; each result as soon as it is there."""
        from distributed import as_completed

        expected = plan.cell.identity()
        folds = {}
        for fold in missing:
            task = self.client.submit(
                there, plan.cell, plan.corpus, fold, self.threads, expected, pure=False, retries=1
            )
            folds[task] = fold
        for future in as_completed(folds, loop=self.client.loop):
            try:
                yield future.result()
            except Exception as e:  # its worker has died twice, or differs from this machine
                if future.cancelled():
                    raise ClusterError(
                        f"cluster={self.address}: the scheduler is gone; every finished fold is stored, and the same "
                        "command continues from there"
                    ) from e
                yield FoldResult(folds[future].name, error=f"{type(e).__name__}: {e}")


def there(
    cell: Cell, corpus: Corpus, fold: Fold, threads: int, expected: dict[str, object]
) -> FoldResult:
    """Do a fold, in a worker."""
    here = cell.identity()
    if differs := [
        f"{name}: {here[name]} here, {expected[name]} there"
        for name in here
        if here[name] != expected[name]
    ]:
        raise InputError(f"this worker differs from the machine of the command: {differs[0][:200]}")
    parts = repr((cell.features, cell.model, cell.tuning, corpus.digest))
    if parts not in _filled:
        fill_cache(cell, corpus)
        _filled.add(parts)
    return do_fold(cell, corpus, fold, threads)
