"""The command ``bench gallery``: every kind of figure that there is, from generated captures."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from bench.commands.printing import writable
from bench.plan.arguments import parse

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
    from bench.cli import main

    out = Path(parse(arguments, {"out"}).get("out", "gallery"))
    writable(out)
    before = os.environ.pop("MLFLOW_TRACKING_URI", None)
    try:
        with contextlib.chdir(out):
            for step in STEPS:
                if code := main([*step]):
                    return code
    finally:
        os.environ.pop("MLFLOW_TRACKING_URI", None)  # MLflow sets it
        if before is not None:
            os.environ["MLFLOW_TRACKING_URI"] = before
    print(f"report/ is the page with its figures, stress/ and stream/ have the rest, all in {out}")
    return 0
