"""A fold in C: labels of the test captures, bytes and instructions."""

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
from touchbench_chip.measure import (
    compile_labeller,
    measure_footprint,
    measure_watching,
    missing_programs,
)
from touchbench_chip.tables import check_exportable
from touchbench_chip.watching import find_watch_learner, make_watch_learner
from touchbench_chip.write import write_c_sources

if TYPE_CHECKING:
    from bench.plan.plan import Plan

# As large as the rule that `bench fit` learns with three more fits; it changes no probability.
PLACEHOLDER_RULE = Stopping(
    Calibration(1.0, 1.0, 1.0, 1.0), Waiting((0.0,) * len(STATE)), threshold=1.0
)


def check_plan(plan: Plan, detector: str) -> None:
    """Refuse a system that has no C, an unused detector, and a machine without compilers."""
    can_watch = check_exportable(plan.cell.untrained_system)
    if detector and not can_watch:
        raise InputError(
            f"detector={detector}: only systems on touch with model.window= can watch a stream in "
            "C; leave it out"
        )
    if missing := missing_programs():
        verb = "is" if len(missing) == 1 else "are"
        raise InputError(
            f"form=c needs {', '.join(missing)}, which {verb} not installed; on Debian, install "
            "gcc make gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
        )


def why_watching_is_unmeasured(plan: Plan) -> str:
    """Why the folds cannot teach a watcher whose costs a system could have; empty if they can."""
    if not check_exportable(plan.cell.untrained_system) or find_watch_learner() is None:
        return ""
    if any(len(set(plan.corpus.subjects[fold.train])) < 2 for fold in plan.folds):
        return "a fold trains on one subject"
    try:
        make_watch_learner("").check_captures(plan.corpus)
    except InputError as e:
        return str(e)
    return ""


def label_in_c(fitted: FittedFold, bits: int, detector: str) -> FoldResult:
    """Label the test captures of a fold in C; measure bytes and instructions.

    The table ``c`` has a row per capture: the columns of the predictions, with the probabilities
    of the C, and ``python``, the label in Python.
    """
    train, test = fitted.train, fitted.corpus[fitted.fold.test]
    recogniser = Recogniser(fitted.system, train, PLACEHOLDER_RULE)
    with tempfile.TemporaryDirectory() as name:
        folder = _write_c_files(recogniser, bits, Path(name))
        predict_in_c = compile_labeller(folder, len(recogniser.classes))
        proba = np.array([predict_in_c(frames)[0] for frames in test])
        metrics = measure_footprint(folder)
    if check_exportable(fitted.cell.untrained_system) and find_watch_learner() is not None:
        with limit_threads(fitted.threads):
            metrics |= _measure_watching(fitted, recogniser, bits, detector)
    table = scores.label_captures(fitted.predictions).rename(columns={"predicted": "python"})
    table = table.assign(start=0, frames=test.lengths)
    table[[f"p_{name}" for name in scores.classes_of(fitted.predictions)]] = np.float32(0)
    table[[f"p_{name}" for name in recogniser.classes]] = proba
    return FoldResult(fitted.fold.name, metrics=metrics, tables={"c": table})


def _write_c_files(recogniser: Recogniser, bits: int, folder: Path) -> Path:
    """Write the C of a system into a folder, which is returned."""
    for file, text in write_c_sources(recogniser, bits, "a fold of bench run form=c").items():
        (folder / file).write_text(text, encoding="utf-8")
    return folder


def _measure_watching(
    fitted: FittedFold, recogniser: Recogniser, bits: int, detector: str
) -> dict[str, float]:
    """Costs of the system with a watcher; empty if the captures cannot teach one.

    The watcher learns from all training subjects, because the choice of the detector depends on
    them. From recordings it also learns their background, and it watches the beginning of a
    recording of a test subject.
    """
    learner = make_watch_learner(detector)
    train, recording = learner.split_fold(fitted.cell, fitted.corpus, fitted.fold)
    try:
        recogniser.watcher = learner.learn_watcher(
            fitted.cell.estimator, recogniser.estimator, train
        )
    except InputError:
        return {}
    with tempfile.TemporaryDirectory() as name:
        return measure_watching(_write_c_files(recogniser, bits, Path(name)), recording)


def compare_with_python(table: pd.DataFrame) -> dict[str, float]:
    """Accuracy in C, and the number of captures whose label in Python differs."""
    labelled = scores.label_captures(table)
    in_c, python = (labelled[name].to_numpy() for name in ("predicted", "python"))
    return {
        "c_accuracy": scores.mean_over_subjects(labelled)["accuracy"],
        "other_labels": int((in_c != python).sum()),
    }


def summarise_c(table: pd.DataFrame, rate_hz: float) -> dict[str, float]:
    """Scores of the C over all folds, their usual names behind ``c_``."""
    numbers = scores.run_scores(table, rate_hz)
    kept = [n for n in numbers if "accuracy" in n or n.startswith(("macro_", "subject_sd"))]
    return {f"c_{name}": numbers[name] for name in kept}
