"""Where folds are done."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Backend:
    """The workers that do folds.

    Attributes:
        jobs: processes of this machine, None for one per core.
        cluster: the address of dask's scheduler, or the file that holds it; empty for this machine.
    """

    jobs: int | None = None
    cluster: str = ""


HERE = Backend()
