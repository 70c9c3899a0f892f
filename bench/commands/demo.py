"""The command ``bench demo``: the way from captures to a verdict, on generated ones, in under two minutes."""

from __future__ import annotations

import contextlib
import json
import os
import shlex
from collections.abc import Iterator
from pathlib import Path

from bench.arguments import parse, settings
from bench.commands.printing import led, writable
from bench.options import keys
from bench.words import SMALL

SYNTH = ("data=synth", "data.subjects=6", "data.variants=normal", "data.repetitions=2", "protocol=loso")
RUNS = (
    ("run", *SYNTH, "model=tree,bayes,lda,svm", "features=jung28"),
    ("run", *SYNTH, "model=lda", "features=touch", "model.window=0.5"),
)
BUDGETS = ("max_flash=64kB", "max_decision=300ms")
VERDICTS = (
    ("choose", "data=synth", "protocol=loso"),
    ("choose", "data=synth", "protocol=loso", *BUDGETS),
)
FAULTS = "faults=dead_taxels,noise"
REPLAYED = 2  # of the most accurate systems
NEXT = (
    "bench data import table my.csv name=mine grid=8x8 rate_hz=54 full_scale=1023",
    "bench run data=mine protocol=loso model=rf features=jung54",
    f"bench run data=mine protocol=loso {SMALL}",
    "bench choose data=mine protocol=loso max_flash=64kB",
)


def demo(arguments: list[str]) -> int:
    """Compare five systems in a store inside ``out=`` and choose one; goes on where it was interrupted.

    Raises:
        InputError: the arguments cannot be used, or the folder cannot be written.
    """
    from bench.cli import main

    out = writable(Path(settings("demo", parse(arguments, keys("demo")))["out"]))
    print("synthetic: all captures are generated; the results say nothing about people")
    with inside(out), led():
        for step in _steps():
            print(f"\n$ bench {shlex.join(step)}", flush=True)
            if code := main([*step]):
                return code
            os.environ.pop("MLFLOW_TRACKING_URI", None)  # MLflow sets it
    print(f"\nThe page with all results (synthetic): {(out / 'report' / 'index.html').resolve().as_uri()}")
    print("For your own captures, in a table with the columns subject, gesture, frame and one per taxel:")
    print(*(f"  {step}" for step in NEXT), sep="\n", flush=True)
    return 0


def _steps() -> Iterator[tuple[str, ...]]:
    """The commands; which systems are replayed and stressed depends on what the first ones find."""
    yield from RUNS
    best = _best()
    for number, arguments in enumerate(best, 1):
        yield ("stream", *arguments, f"out=stream/{number}")
    yield ("stress", *best[0], FAULTS)
    yield ("report", *BUDGETS)  # so that the page says what the last verdict says
    yield from VERDICTS


def _best() -> list[list[str]]:
    """Arguments of the most accurate systems of this folder's store."""
    from bench.outcomes.candidates import candidates
    from bench.outcomes.runs import every_result
    from bench.outcomes.store import connect

    table = candidates(every_result(connect()), {}).table.sort_values("accuracy", ascending=False, kind="stable")
    best = [json.loads(text) for text in table["arguments"][:REPLAYED]]
    return [[f"{key}={value}" for key, value in arguments.items()] for arguments in best]


@contextlib.contextmanager
def inside(folder: Path) -> Iterator[None]:
    """Work in a folder with a store of its own there."""
    before = os.environ.pop("MLFLOW_TRACKING_URI", None)
    try:
        with contextlib.chdir(folder):
            yield
    finally:
        os.environ.pop("MLFLOW_TRACKING_URI", None)
        if before is not None:
            os.environ["MLFLOW_TRACKING_URI"] = before
