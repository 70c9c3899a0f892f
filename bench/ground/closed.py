"""Close corpora to the code of systems, which get their captures as X."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from bench.errors import InputError

CLOSED = "TOUCHBENCH_CORPORA_CLOSED"  # in the environment, so threads and child processes have it


@contextmanager
def close_corpora() -> Iterator[None]:
    """Close corpora to this process and those that it starts, while a user's code runs."""
    before = os.environ.get(CLOSED)
    os.environ[CLOSED] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[CLOSED]


def refuse_closed(name: str) -> None:
    """Refuse to open a corpus inside a fold, or while a file of the user's is imported."""
    if os.environ.get(CLOSED):
        raise InputError(
            f"data={name[:60]}: inside a fold a system gets its captures as X; open no corpus in "
            "fit, in predict, or where its file is imported"
        )
