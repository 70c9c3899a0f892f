"""Early stopping of replayed captures: the label at an instant, and the end of useful waiting.

Pure functions of the replay table, which `bench.running.replay` describes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from bench.values.intervals import mean_and_error, within_one_standard_error
from bench.values.scores import over_people, windows

THRESHOLDS = (
    *np.round(np.arange(0.05, 0.96, 0.05), 2).tolist(),
    0.97,
    0.98,
    0.99,
    0.995,
    0.999,
    np.inf,
)
NO_SAVING = "no saving found by deciding early"


def standing(table: pd.DataFrame, frames: int) -> pd.DataFrame:
    """The latest decision of each capture within ``frames`` frames, with its label."""
    return windows(
        table[table["instant"] <= frames].groupby(["fold", "capture"], sort=False).tail(1)
    )


def stopped(table: pd.DataFrame, threshold: float) -> pd.DataFrame:
    """The first decision of each capture that is settled enough, else its last, with its label."""
    keys = [table["fold"], table["capture"]]
    reached = (table["settled"] >= threshold).astype(int)
    before = reached.groupby(keys, sort=False).cumsum() - reached
    return windows(table[before == 0].groupby(["fold", "capture"], sort=False).tail(1))


def learn_stopping(table: pd.DataFrame, rate_hz: float) -> tuple[float, pd.DataFrame]:
    """The threshold that saves most time without loss on training subjects, and what each of the series gives.

    It has the smallest mean observed time whose accuracy, as a mean over subjects, is not below that of whole captures
    by more than one standard error of the difference.
    """
    at_the_end = _hits(stopped(table, np.inf))
    rows = []
    for threshold in THRESHOLDS:
        labelled = stopped(table, threshold)
        losses = (at_the_end - _hits(labelled)).to_numpy()
        lost, error = mean_and_error(losses)
        rows.append(
            {
                "threshold": threshold,
                "accuracy": (labelled["true"] == labelled["predicted"]).mean(),
                "lost": lost,
                "error": error,
                "allowed": within_one_standard_error(losses),
                "mean_ms": 1000 / rate_hz * labelled["frames"].mean(),
            }
        )
    series = pd.DataFrame(rows)
    allowed = series[series["allowed"]]
    best = allowed.sort_values(
        ["mean_ms", "threshold"], ascending=[True, False], kind="stable"
    ).iloc[0]
    return float(best["threshold"]), series


def _hits(labelled: pd.DataFrame) -> pd.Series:
    """Accuracy of each subject."""
    return (labelled["true"] == labelled["predicted"]).groupby(labelled["subject"]).mean()


def by_instant(table: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Accuracy of the standing decisions at every instant, with ``ms`` and ``mean_ms``, as shorter captures end."""
    instants = np.sort(table["instant"].unique())
    return pd.DataFrame(
        {"ms": 1000 / rate_hz * frames} | _scored(standing(table, frames), rate_hz)
        for frames in instants
    )


def by_threshold(table: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Accuracy and mean observed time of stopping at every threshold of the series."""
    return pd.DataFrame({"threshold": t} | _scored(stopped(table, t), rate_hz) for t in THRESHOLDS)


def learned_point(
    table: pd.DataFrame, thresholds: dict[str, float], rate_hz: float
) -> dict[str, float]:
    """Accuracy and mean observed time where each fold stops at the threshold that its training part gave."""
    parts = [
        stopped(rows, thresholds[str(fold)]) for fold, rows in table.groupby("fold", sort=False)
    ]
    return _scored(pd.concat(parts, ignore_index=True), rate_hz)


def _scored(labelled: pd.DataFrame, rate_hz: float) -> dict[str, float]:
    return {"mean_ms": 1000 / rate_hz * labelled["frames"].mean()} | over_people(labelled)


def after(table: pd.DataFrame, times: Iterable[float], rate_hz: float) -> dict[float, float]:
    """Accuracy of the latest decisions after some milliseconds, of those with any decisions."""
    accuracy = {}
    for ms in times:
        frames = int(ms * rate_hz / 1000 + 1e-6)
        if table["instant"].min() <= frames <= table["instant"].max():
            labelled = standing(table, frames)
            accuracy[ms] = over_people(labelled)["accuracy"]
    return accuracy


def standing_labels(
    table: pd.DataFrame, times: Iterable[float], key: str, rate_hz: float
) -> pd.DataFrame:
    """The label that stands after each time, in the columns of ``labels`` (`bench.values.stability`)."""
    parts = []
    for ms in times:
        rows = standing(table, int(ms * rate_hz / 1000 + 1e-6))[
            ["fold", "capture", "subject", "true", "predicted"]
        ]
        parts.append(rows.assign(circumstance=key, case=key, level=ms, amount=f"{ms:g} ms"))
    return pd.concat(parts, ignore_index=True)


def _thresholds(tables: Mapping[str, pd.DataFrame]) -> dict[str, float]:
    """Thresholds of settledness, learned from the training part of each fold."""
    rules = tables["rules"]
    return {
        str(fold): float(value)
        for fold, value in zip(rules["fold"], rules["threshold"], strict=True)
    }


def fold_numbers(tables: Mapping[str, pd.DataFrame], rate_hz: float) -> dict[str, float]:
    """Accuracy of whole captures, and of stopping at the learned threshold where one was learned."""
    table = tables["replay"]
    labelled = standing(table, int(table["instant"].max()))
    numbers = {"replay_accuracy": over_people(labelled)["accuracy"]}
    if "rules" in tables:
        point = learned_point(table, _thresholds(tables), rate_hz)
        numbers |= {"adaptive_accuracy": point["accuracy"], "adaptive_ms": point["mean_ms"]}
    return numbers


def replay_numbers(
    tables: Mapping[str, pd.DataFrame], times: Iterable[float], spent_p95: float, rate_hz: float
) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
    """Numbers and curves of a replay: accuracy by instant, and of adaptive stopping where it was learned."""
    table = tables["replay"]
    instants = by_instant(table, rate_hz)
    end = instants.iloc[-1]
    numbers = {
        "replay_accuracy": end["accuracy"],
        "mean_ms": end["mean_ms"],
        "decisions_per_second": 1000 / spent_p95,
    }
    numbers |= {f"replay_accuracy_{side}": end[side] for side in ("low", "high")}
    numbers |= {
        f"accuracy_at_{ms:g}_ms": value for ms, value in after(table, times, rate_hz).items()
    }
    made = {"instants": instants}
    if "rules" in tables:
        point = learned_point(table, _thresholds(tables), rate_hz)
        numbers |= {"adaptive_ms": point["mean_ms"]} | {
            f"adaptive_{k}": point[k] for k in ("accuracy", "low", "high")
        }
        made["stopping"] = by_threshold(table, rate_hz)
    return {k: float(v) for k, v in numbers.items() if v == v}, made
