"""Folds on the workers of a Dask scheduler, which repeats a fold once if its worker dies."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Self

from bench.corpora.corpus import Corpus
from bench.errors import ClusterError, InputError
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan
from bench.running.results import FoldResult
from bench.running.workers import FoldExecutor, fill_cache, run_fold

ANSWER_TIMEOUT_S = 10.0  # that a scheduler has to answer
WORKER_TIMEOUT_S = 30.0  # for the first worker to come
_filled_caches: set[str] = set()  # of a worker's process: systems whose features are kept


class Cluster(FoldExecutor):
    """The workers of a Dask scheduler.

    Args:
        address: address of the scheduler, or the file that it has written.
    """

    is_remote = True

    def __init__(self, address: str) -> None:
        super().__init__()
        self.address = address

    def __enter__(self) -> Self:
        """Connect, and wait for the first worker.

        Raises:
            InputError: no scheduler answers, or it has no worker.
        """
        from distributed import Client

        for name in ("distributed.client", "distributed.core"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # we report lost connections
        file, address = Path(self.address), self.address
        try:
            if file.is_file():
                address = json.loads(file.read_text())["address"]
            self.client = Client(address, timeout=ANSWER_TIMEOUT_S, set_as_default=False)
        except Exception as e:  # Dask has many
            why = " ".join(str(e).split()) or f"{type(e).__name__} after {ANSWER_TIMEOUT_S:g} s"
            raise InputError(
                f"cluster={self.address}: no scheduler answers ({why[:80]}); give "
                "tcp://HOST:8786 of one that runs, or the file that it was started with "
                "(--scheduler-file)"
            ) from e
        try:
            self.client.wait_for_workers(1, timeout=WORKER_TIMEOUT_S)
        except Exception as e:
            self.client.close()
            start = f"start some, such as: dask worker {self.address} --nworkers 4 --nthreads 1"
            raise InputError(f"cluster={self.address}: it has no worker; {start}") from e
        self.threads = min(self.client.nthreads().values())
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Disconnect; the scheduler then drops the waiting folds."""
        self.client.close(timeout=5)

    def run_folds(self, plan: Plan, missing: Sequence[Fold]) -> Iterator[FoldResult]:
        """Run folds of a plan; yield each result as soon as it is there."""
        from distributed import as_completed

        identity = plan.cell.identity()
        folds = {}
        for fold in missing:
            inputs = plan.cell, plan.corpus, fold, self.threads, identity
            task = self.client.submit(run_fold_remotely, *inputs, pure=False, retries=1)
            folds[task] = fold
        for future in as_completed(folds, loop=self.client.loop):
            try:
                yield future.result()
            except Exception as e:  # its worker has died twice, or differs from this machine
                if future.cancelled():
                    raise ClusterError(
                        f"cluster={self.address}: the scheduler is gone; every finished fold is "
                        "stored, and the same command continues from there"
                    ) from e
                yield FoldResult(folds[future].name, error=f"{type(e).__name__}: {e}")


def run_fold_remotely(
    cell: Cell, corpus: Corpus, fold: Fold, threads: int, identity: dict[str, object]
) -> FoldResult:
    """Run a fold in a worker.

    Raises:
        InputError: the worker has other code or packages than the machine of the command.
    """
    for name, value in cell.identity().items():
        if value != identity[name]:
            difference = f"{name}: {value} here, {identity[name]} there"[:200]
            raise InputError(f"this worker differs from the machine of the command: {difference}")
    parts = repr((cell.features, cell.model, cell.tuning, corpus.digest))
    if parts not in _filled_caches:
        fill_cache(cell, corpus)
        _filled_caches.add(parts)
    return run_fold(cell, corpus, fold, threads)
