"""What runs left behind as files: read where it lies if the store is on this machine, fetched otherwise."""

from __future__ import annotations

import csv
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np
import pandas as pd

from bench.tracking import folds_of


def path_of(client: object, run: dict, name: str) -> Path | None:
    """A run's artifact as a local file, None where it has none of that name.

    Args:
        client: an `mlflow.MlflowClient` on the store.
        run: a row of `reports.comparison.tracked`.
        name: of the artifact.
    """
    uri = urlparse(run["artifacts"])
    if uri.scheme in ("", "file") or (len(uri.scheme) == 1):  # a drive letter is no scheme
        folder = Path(run["artifacts"]) if uri.scheme != "file" else Path(unquote(uri.path))
        return folder / name if (folder / name).is_file() else None
    from mlflow.exceptions import MlflowException

    try:
        return Path(client.download_artifacts(run["run_id"], name))
    except (OSError, MlflowException):
        return None


def subject_accuracy(client: object, run: dict) -> dict[str, float]:
    """Accuracy of the captures of each subject, in percent, as the run stored it; empty if it is not there."""
    path = path_of(client, run, "per_subject.csv")
    if path is None:
        return {}
    with path.open(newline="", encoding="utf-8") as f:  # pandas takes twenty times as long for ten lines
        return {row["subject"]: 100 * float(row["accuracy"]) for row in csv.DictReader(f)}


def predictions(client: object, run: dict) -> pd.DataFrame | None:
    """The predictions table of a run, None if it is not there."""
    path = path_of(client, run, "predictions.parquet")
    return None if path is None else pd.read_parquet(path)


def folds(client: object, run: dict) -> list[object]:
    """The finished child runs, in the order in which they were stored."""
    found = folds_of(client, run["run_id"])
    return sorted((f for f in found if f.info.status == "FINISHED"), key=lambda f: f.info.start_time)


def fold_accuracy(client: object, run: dict) -> dict[str, float]:
    """Accuracy of the captures of each fold, in percent."""
    return {
        f.data.tags["touchbench.fold"]: 100 * f.data.metrics["accuracy"]
        for f in folds(client, run)
        if "accuracy" in f.data.metrics
    }


def history(client: object, fold: object, metric: str) -> np.ndarray:
    """Values of a metric of a child run by epoch, [epochs, 2]: epoch and value."""
    points = client.get_metric_history(fold.info.run_id, metric)
    return np.array(sorted((m.step, m.value) for m in points if m.step > 0), dtype=float).reshape(-1, 2)
