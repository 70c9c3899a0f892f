"""A fold in C: an exported system labels the test captures, and its bytes and instructions are measured."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.running.fitted import FittedFold
from bench.running.fold import limit_threads
from bench.running.replay import STATE, Calibration, Stopping, Waiting
from bench.running.results import FoldResult
from bench.running.saved import Recogniser
from bench.values import scores
from touchbench_chip.circumstance import find_watch_learners, make_watch_learner
from touchbench_chip.measure import (
    compile_labeller,
    measure_footprint,
    measure_watching,
    missing_programs,
)
from touchbench_chip.tables import check_exportable
from touchbench_chip.write import write_c_sources

if TYPE_CHECKING:
    from bench.plan.plan import Plan

# As large as what `bench fit` teaches, which takes three more fits; it changes no probability.
UNTAUGHT = Stopping(Calibration(1.0, 1.0, 1.0, 1.0), Waiting((0.0,) * len(STATE)), 1.0)


def refuse(plan: Plan, detector: str) -> None:
    """Refuse a system that has no C, a detector that is none, and a machine without the programs."""
    watches = check_exportable(plan.cell.untrained_system)
    if detector and not watches:
        raise InputError(
            f"detector={detector}: only the C of systems on touch with model.window= watches; leave it out"
        )
    if missing := missing_programs():
        which = "which is" if len(missing) == 1 else "which are"
        raise InputError(
            f"form=c needs {', '.join(missing)}, {which} not installed; on Debian, install gcc make "
            "gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
        )


def watching_warnings(plan: Plan) -> list[str]:
    """Warn where the folds cannot teach a watcher."""
    why = ""
    if not check_exportable(plan.cell.untrained_system) or not find_watch_learners():
        return []
    if any(len(set(plan.corpus.subjects[fold.train])) < 2 for fold in plan.folds):
        why = "a fold trains on one subject"
    else:
        try:
            make_watch_learner("").check(plan.corpus)
        except InputError as e:
            why = str(e)
    return [f"warning: costs of watching an endless stream are not measured: {why}"] if why else []


def label_in_c(at: FittedFold, bits: int, detector: str) -> FoldResult:
    """Labels of the test captures by the C; bytes and instructions.

    The table ``c`` has a row per capture: the columns of the predictions, with probabilities of the C, and the label of
    Python (``python``).
    """
    train, test = at.train, at.corpus[at.fold.test]
    table = scores.label_captures(at.predictions).rename(columns={"predicted": "python"})
    table = table.assign(start=0, frames=test.lengths)
    recogniser = Recogniser(at.system, train, UNTAUGHT)
    with tempfile.TemporaryDirectory() as name:
        folder = _write_c_files(recogniser, bits, Path(name))
        in_c = compile_labeller(folder, len(recogniser.classes))
        proba = np.array([in_c(frames)[0] for frames in test])
        metrics = measure_footprint(folder)
    if check_exportable(at.cell.untrained_system) and find_watch_learners():
        with limit_threads(at.threads):
            metrics |= _measure_watching(at, recogniser, bits, detector)
    table[[f"p_{name}" for name in scores.classes_of(at.predictions)]] = np.float32(0)
    table[[f"p_{name}" for name in recogniser.classes]] = proba
    return FoldResult(at.fold.name, metrics=metrics, tables={"c": table})


def _write_c_files(recogniser: Recogniser, bits: int, folder: Path) -> Path:
    """The folder, with the C of a system."""
    for file, text in write_c_sources(recogniser, bits, "a fold of bench run form=c").items():
        (folder / file).write_text(text, encoding="utf-8")
    return folder


def _measure_watching(
    at: FittedFold, recogniser: Recogniser, bits: int, detector: str
) -> dict[str, float]:
    """Costs of the system with a watcher; none where the captures cannot teach one.

    All training subjects teach the watcher, because the choice of the detector depends on them. Of recordings, their
    background does, too, and it also watches the beginning of one of a test subject.
    """
    learner = make_watch_learner(detector)
    train, recording = learner.sides(at.cell, at.corpus, at.fold)
    try:
        recogniser.watcher = learner.learned(at.cell.estimator, recogniser.estimator, train)
    except InputError:
        return {}
    with tempfile.TemporaryDirectory() as name:
        return measure_watching(_write_c_files(recogniser, bits, Path(name)), recording)


def compare_with_python(table: pd.DataFrame) -> dict[str, float]:
    """Accuracy in C, and the number of captures that it labels otherwise than Python."""
    labelled = scores.label_captures(table)
    in_c, python = (labelled[name].to_numpy() for name in ("predicted", "python"))
    return {
        "c_accuracy": scores.mean_over_subjects(labelled)["accuracy"],
        "other_labels": int((in_c != python).sum()),
    }


def summarise_c(table: pd.DataFrame, rate_hz: float) -> dict[str, float]:
    """Scores of the C over all folds, under ``c_`` and their usual names."""
    numbers = scores.run_scores(table, rate_hz)
    return {
        f"c_{k}": v
        for k, v in numbers.items()
        if "accuracy" in k or k.startswith(("macro_", "subject_sd"))
    }
