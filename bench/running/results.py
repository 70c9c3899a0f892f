"""The result of a fold, and the costs of its run."""

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
from bench.ground.registry import is_own
from bench.store.tables import uniform
from bench.values import scores

Combine = Callable[[list[float]], SupportsFloat]
# How numbers of folds combine; of seconds the mean counts, of any other, such as a size, the largest.
COMBINED: dict[str, Combine] = dict.fromkeys(
    ("reference_ms", "quiet_ms", "slowdown", "predict_relative"), np.median
)


@dataclass
class FoldResult:
    """The result of a fold."""

    name: str
    predictions: pd.DataFrame | None = (
        None  # one row per decision, with the columns that its kind of run describes
    )
    metrics: dict[str, float] = field(default_factory=dict)
    predict_ms: list[float] = field(
        default_factory=list
    )  # from raw frames to the label, one per timed capture
    decide_ms: list[float] = field(
        default_factory=list
    )  # the same for no more of a capture than one decision needs
    history: list[dict[str, float]] = field(default_factory=list)  # numbers by epoch
    chosen: dict[str, object] = field(
        default_factory=dict
    )  # values chosen on the training part, by name
    trials: pd.DataFrame | None = None  # that were compared, a row each
    batch_effects: list[str] = field(
        default_factory=list
    )  # captures whose prediction depends on others, in sentences
    error: str = ""  # traceback of a fold that failed
    failed: dict[str, str] = field(
        default_factory=dict
    )  # traceback of each circumstance that failed, by its key
    tables: dict[str, pd.DataFrame] = field(
        default_factory=dict
    )  # further ones, such as the labels in circumstances
    times: dict[str, list[float]] = field(
        default_factory=dict
    )  # further milliseconds, one per timed decision
    scored: dict[str, float] = field(
        default_factory=dict
    )  # tracked values, as its kind of run measures them
    seconds: float = 0.0  # of the whole fold
    machine: Machine | None = None  # that did it; None if that is unknown

    @property
    def reason(self) -> str:
        """The exception of a fold that failed, or of the first circumstance that did, in one line."""
        return reason_of(self.error or next(iter(self.failed.values())))

    @property
    def table(self) -> pd.DataFrame:
        """The predictions of a fold that went well."""
        if self.predictions is None:
            raise ValueError(f"fold {self.name} has no predictions")
        return self.predictions


def failure() -> str:
    """The traceback of the exception that is handled, as text that every file takes."""
    return traceback.format_exc().encode(errors="backslashreplace").decode()


def reason_of(error: str) -> str:
    """The exception of a traceback in one line, with the last place in the user's own code."""
    lines = error.strip().splitlines()
    last = max((i for i, line in enumerate(lines) if line.startswith('  File "')), default=-1)
    line = next((line for line in lines[last + 1 :] if line and not line[0].isspace()), lines[-1])
    places = re.findall(r'^  File "(.+)", line ([0-9]+)', error, flags=re.MULTILINE)
    own = [f" ({Path(file).name}, line {number})" for file, number in places if is_own(file)]
    return line.removeprefix("bench.errors.") + (own[-1] if own else "")


def table_of(results: list[FoldResult]) -> pd.DataFrame:
    """The tables of all folds, one behind the other."""
    return pd.concat([r.table for r in results], ignore_index=True)


def tables_of(results: Sequence[FoldResult]) -> dict[str, pd.DataFrame]:
    """The further tables of all folds, one behind the other, by name."""
    names = dict.fromkeys(name for r in results for name in r.tables)
    return {
        n: pd.concat([r.tables[n] for r in results if n in r.tables], ignore_index=True)
        for n in names
    }


def measured(
    folds: list[FoldResult], rate_hz: float, spent: Iterable[str] = ()
) -> tuple[dict[str, float], dict[str, pd.DataFrame], str]:
    """Scores and costs of a run; its predictions, confusions, subjects and classes; the unit of its decisions.

    ``decision_ms`` is the touch that the label of a whole capture sees plus its computing time, ``window_decision_ms``
    the same of a single window where there are windows; both are medians.
    """
    predictions = table_of(folds)
    labelled, classes = scores.captures(predictions), scores.classes_of(predictions)
    counts = scores.confusion(labelled, classes)
    tables = {
        "predictions": predictions,
        "confusion": uniform(
            counts.rename_axis("true").reset_index(allow_duplicates=True)
        ),  # a class may be "true"
        "per_subject": scores.per_subject(labelled),
        "per_class": scores.per_class(labelled, classes),
    }
    numbers = scores.summary(predictions, rate_hz) | costs(folds, spent)
    return numbers, tables, "window" if "windows" in numbers else "capture"


def costs(results: list[FoldResult], spent: Iterable[str] = ()) -> dict[str, float]:
    """Numbers of a run from those of its folds (`COMBINED`); milliseconds are quantiles over all timed captures.

    All times but those with wall in their name are of the quiet machine (`bench.ground.timing`). ``spent`` names seconds in
    circumstances: the run has their mean.
    """
    every: dict[str, list[float]] = {}  # a fold may have one that another has not
    times: dict[str, list[float]] = {}
    for r in results:
        for name, value in r.metrics.items():
            every.setdefault(name, []).append(value)
        for name, ms in {"predict_ms": r.predict_ms, "decide_ms": r.decide_ms, **r.times}.items():
            times.setdefault(name, []).extend(ms)
    seconds = {name for name in every if name.endswith("_seconds")}
    combined = COMBINED | dict.fromkeys({*spent, *seconds}, np.mean)
    numbers = {name: float(combined.get(name, max)(values)) for name, values in every.items()}
    for name, ms in times.items():
        numbers |= {f"{name}_p{p}": float(np.quantile(ms, p / 100)) for p in (50, 95, 99) if ms}
    return numbers
