"""Where folds are done."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Backend:
    """The workers that do folds.

    Attributes:
        jobs: processes of this machine, None for one per core.
        workers: class of other workers, ``module:object``; empty for processes of this machine.
        address: the place where they are found.
    """

    jobs: int | None = None
    workers: str = ""
    address: str = ""


HERE = Backend()
