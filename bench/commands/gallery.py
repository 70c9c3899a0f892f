"""The command ``bench gallery``: every kind of figure that there is, from generated captures."""

from __future__ import annotations

import contextlib
import os
import shlex
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from bench.arguments import parse
from bench.commands.printing import led, writable

CORPUS = ("data=synth", "data.subjects=6", "data.variants=normal", "data.repetitions=2")
STEPS = (
    ("run", *CORPUS, "model=bayes,svm,rf,xgb"),
    ("run", *CORPUS, "model=cnn85", "model.frames=20,40,85", "model.epochs=5"),
    ("stress", *CORPUS, "model=svm,rf", "train_subjects=2,4"),
    ("stream", *CORPUS, "model=svm,rf", "out=stream"),
    ("report",),
)


def gallery(arguments: list[str]) -> int:
    """Run a few systems in a store inside ``out=`` and draw everything; goes on where it was interrupted.

    Raises:
        InputError: the arguments cannot be used, or the folder cannot be written.
    """
    out = Path(parse(arguments, {"out"}).get("out", "gallery"))
    if code := done(out, STEPS):
        return code
    print(f"report/ is the page with its figures, stress/ and stream/ have the rest, all in {out}")
    print(f"open: {(out / 'report' / 'index.html').resolve().as_uri()}")
    return 0


def done(out: Path, steps: Iterable[Sequence[str]]) -> int:
    """Do commands inside a folder, with a store of their own there, until one fails; its exit code, else 0.

    Args:
        out: the folder.
        steps: commands with their arguments; each is asked for when the one before is done.

    Raises:
        InputError: the folder cannot be written.
    """
    from bench.cli import main

    writable(out)
    with inside(out):
        for step in steps:
            print(f"\n$ bench {shlex.join(step)}", flush=True)
            with led():
                code = main([*step])
            if code:
                return code
            os.environ.pop("MLFLOW_TRACKING_URI", None)  # MLflow sets it
    return 0


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
