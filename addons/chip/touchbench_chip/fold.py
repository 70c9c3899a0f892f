"""A fold in C: an exported system labels the test captures, and its bytes and instructions are measured."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.running.fitted import Fitted
from bench.running.fold import computing
from bench.running.replay import STATE, Calibration, Stopping, Waiting
from bench.running.results import FoldResult
from bench.running.saved import Recogniser
from bench.values import scores
from touchbench_chip.circumstance import watchers, watching
from touchbench_chip.measure import compiled, lacking, measured, measured_watching
from touchbench_chip.tables import check
from touchbench_chip.write import files_of

if TYPE_CHECKING:
    from bench.plan.plan import Plan

# As large as what `bench fit` teaches, which takes three more fits; it changes no probability.
UNTAUGHT = Stopping(Calibration(1.0, 1.0, 1.0, 1.0), Waiting((0.0,) * len(STATE)), 1.0)


def refuse(plan: Plan, detector: str) -> None:
    """Refuse a system that has no C, a detector that is none, and a machine without the programs."""
    watches = check(plan.cell.untrained)
    if detector and not watches:
        raise InputError(
            f"detector={detector}: only the C of systems on touch with model.window= watches; leave it out"
        )
    if missing := lacking():
        which = "which is" if len(missing) == 1 else "which are"
        raise InputError(
            f"form=c needs {', '.join(missing)}, {which} not installed; on Debian, install gcc make "
            "gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
        )


def warnings(plan: Plan) -> list[str]:
    """Warn where the folds cannot teach a watcher."""
    why = ""
    if not check(plan.cell.untrained) or not watchers():
        return []
    if any(len(set(plan.corpus.subjects[fold.train])) < 2 for fold in plan.folds):
        why = "a fold trains on one subject"
    else:
        try:
            watching("").check(plan.corpus)
        except InputError as e:
            why = str(e)
    return [f"warning: costs of watching an endless stream are not measured: {why}"] if why else []


def fold(at: Fitted, bits: int, detector: str) -> FoldResult:
    """Labels of the test captures by the C; bytes and instructions.

    The table ``c`` has a row per capture: the columns of the predictions, with probabilities of the C, and the label of
    Python (``python``).
    """
    train, test = at.train, at.corpus[at.fold.test]
    table = scores.captures(at.predictions).rename(columns={"predicted": "python"})
    table = table.assign(start=0, frames=test.lengths)
    recogniser = Recogniser(at.system, train, UNTAUGHT)
    with tempfile.TemporaryDirectory() as name:
        folder = _written(recogniser, bits, Path(name))
        in_c = compiled(folder, len(recogniser.classes))
        proba = np.array([in_c(frames)[0] for frames in test])
        metrics = measured(folder)
    if check(at.cell.untrained) and watchers():
        with computing(at.threads):
            metrics |= _watching(at, recogniser, bits, detector)
    table[[f"p_{name}" for name in scores.classes_of(at.predictions)]] = np.float32(0)
    table[[f"p_{name}" for name in recogniser.classes]] = proba
    return FoldResult(at.fold.name, metrics=metrics, tables={"c": table})


def _written(recogniser: Recogniser, bits: int, folder: Path) -> Path:
    """The folder, with the C of a system."""
    for file, text in files_of(recogniser, bits, "a fold of bench run form=c").items():
        (folder / file).write_text(text, encoding="utf-8")
    return folder


def _watching(at: Fitted, recogniser: Recogniser, bits: int, detector: str) -> dict[str, float]:
    """Costs of the system with a watcher; none where the captures cannot teach one.

    All training subjects teach the watcher, because the choice of the detector depends on them. Of recordings, their
    background does, too, and it also watches the beginning of one of a test subject.
    """
    learner = watching(detector)
    train, recording = learner.sides(at.cell, at.corpus, at.fold)
    try:
        recogniser.watcher = learner.learned(at.cell.estimator, recogniser.estimator, train)
    except InputError:
        return {}
    with tempfile.TemporaryDirectory() as name:
        return measured_watching(_written(recogniser, bits, Path(name)), recording)


def compared(table: pd.DataFrame) -> dict[str, float]:
    """Accuracy in C, and the number of captures that it labels otherwise than Python."""
    labelled = scores.captures(table)
    in_c, python = (labelled[name].to_numpy() for name in ("predicted", "python"))
    return {
        "c_accuracy": scores.over_people(labelled)["accuracy"],
        "other_labels": int((in_c != python).sum()),
    }


def scored(table: pd.DataFrame, rate_hz: float) -> dict[str, float]:
    """Scores of the C over all folds, under ``c_`` and their usual names."""
    numbers = scores.summary(table, rate_hz)
    return {
        f"c_{k}": v
        for k, v in numbers.items()
        if "accuracy" in k or k.startswith(("macro_", "subject_sd"))
    }
