"""The result of a fold, and how folds combine to a run."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import SupportsFloat

import numpy as np
import pandas as pd

from bench.ground.machine import Machine
from bench.ground.source import is_user_code
from bench.store.tables import as_stored
from bench.values import scores

Combine = Callable[[list[float]], SupportsFloat]
# How metrics of folds combine: seconds by their mean, any other, such as a size, by the largest.
COMBINED: dict[str, Combine] = dict.fromkeys(
    ("reference_ms", "quiet_ms", "slowdown", "predict_relative"), np.median
)


@dataclass
class FoldResult:
    """The result of a fold."""

    name: str
    predictions: pd.DataFrame | None = None  # a row per decision; columns as of its kind of run
    metrics: dict[str, float] = field(default_factory=dict)
    history: list[dict[str, float]] = field(default_factory=list)  # numbers by epoch
    chosen: dict[str, object] = field(default_factory=dict)  # values chosen in training, by name
    trials: pd.DataFrame | None = None  # compared in training, a row each
    batch_effects: list[str] = field(default_factory=list)  # sentences of `find_batch_effects`
    error: str = ""  # traceback of a fold that failed
    failed: dict[str, str] = field(default_factory=dict)  # traceback of each failed circumstance
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)  # further ones, such as labels
    times: dict[str, list[float]] = field(
        default_factory=dict
    )  # ms of each timed decision, by name
    tracked_metrics: dict[str, float] = field(default_factory=dict)  # as its kind of run measures
    printed: str = ""  # by its system: number of lines, and the first
    seconds: float = 0.0  # of the whole fold
    machine: Machine | None = None  # None if unknown

    @property
    def reason(self) -> str:
        """The exception of a failed fold, or of its first failed circumstance, in one line."""
        return one_line_reason(self.error or next(iter(self.failed.values())))

    @property
    def table(self) -> pd.DataFrame:
        """The predictions of a fold that went well."""
        if self.predictions is None:
            raise ValueError(f"fold {self.name} has no predictions")
        return self.predictions


def format_traceback() -> str:
    """Return the traceback of the handled exception, as text that every file takes."""
    return traceback.format_exc().encode(errors="backslashreplace").decode()


def one_line_reason(error: str) -> str:
    """Return the exception of a traceback, with the last line of the user's own code."""
    lines = error.strip().splitlines()
    last = max((i for i, line in enumerate(lines) if line.startswith('  File "')), default=-1)
    line = next((line for line in lines[last + 1 :] if line and not line[0].isspace()), lines[-1])
    line = line.removeprefix("bench.errors.")
    places = re.findall(r'^  File "(.+)", line ([0-9]+)', error, flags=re.MULTILINE)
    for file, number in reversed(places):
        if is_user_code(file):
            return f"{line} ({Path(file).name}, line {number})"
    return line


def concat_predictions(folds: Sequence[FoldResult]) -> pd.DataFrame:
    """Concatenate the predictions of folds."""
    return pd.concat([fold.table for fold in folds], ignore_index=True)


def concat_fold_tables(folds: Sequence[FoldResult]) -> dict[str, pd.DataFrame]:
    """Concatenate the further tables of folds, by name."""
    parts: dict[str, list[pd.DataFrame]] = {}
    for fold in folds:
        for name, table in fold.tables.items():
            parts.setdefault(name, []).append(table)
    return {name: pd.concat(tables, ignore_index=True) for name, tables in parts.items()}


def score_run(
    folds: Sequence[FoldResult], rate_hz: float, mean_metrics: Iterable[str] = ()
) -> tuple[dict[str, float], dict[str, pd.DataFrame], str]:
    """Score a run.

    ``decision_ms`` is the touch that the label of a whole capture sees plus its computing time,
    ``window_decision_ms`` the same of a single window where there are windows; both are medians.

    Returns:
        Scores and costs; tables of predictions, confusions, subjects and classes; the unit of
        decisions: window or capture.
    """
    predictions = concat_predictions(folds)
    labelled, classes = scores.label_captures(predictions), scores.classes_of(predictions)
    confusion = scores.confusion_table(labelled, classes).rename_axis("true")
    tables = {
        "predictions": predictions,
        "confusion": as_stored(confusion.reset_index(allow_duplicates=True)),  # of a class "true"
        "per_subject": scores.accuracy_by_subject(labelled),
        "per_class": scores.scores_by_class(labelled, classes),
    }
    numbers = scores.run_scores(predictions, rate_hz) | combine_costs(folds, mean_metrics)
    return numbers, tables, "window" if "windows" in numbers else "capture"


def combine_costs(
    folds: Sequence[FoldResult], mean_metrics: Iterable[str] = ()
) -> dict[str, float]:
    """Combine the metrics of folds, and their milliseconds as quantiles over timed captures.

    All times but those with wall in their name are of the quiet machine (`bench.ground.timing`).

    Args:
        folds: results of folds; a fold may lack a number of another.
        mean_metrics: names of seconds in circumstances, of which the run has the mean.
    """
    values: dict[str, list[float]] = {}
    times: dict[str, list[float]] = {}
    for fold in folds:
        for name, value in fold.metrics.items():
            values.setdefault(name, []).append(value)
        for name, ms in fold.times.items():
            times.setdefault(name, []).extend(ms)
    seconds = {name for name in values if name.endswith("_seconds")}
    combine = COMBINED | dict.fromkeys({*mean_metrics, *seconds}, np.mean)
    numbers = {name: float(combine.get(name, max)(each)) for name, each in values.items()}
    for name, ms in times.items():
        for percent in (50, 95, 99) if ms else ():
            numbers[f"{name}_p{percent}"] = float(np.quantile(ms, percent / 100))
    return numbers
