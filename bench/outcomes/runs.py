"""Tracked runs as a table, with their stored files."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd

from bench.arguments import PARTS
from bench.errors import InputError
from bench.outcomes.comparable import COMPARABLE, SAME_SYSTEM, Row, context_of, depends_on_batch, system_of
from bench.outcomes.store import Store
from bench.registry import names

COLUMNS = {"where": "subset", "shots": "protocol.shots"}  # of a table of runs, where it is not called as it is asked
COLUMNS |= {part: f"{part}_name" for part in PARTS}
SCORES = {"watch": "end_correct"}  # of a kind of run, its main metric where that is not accuracy


class NothingTracked(InputError):
    """No run of a kind is there."""


def tracked(store: Store, kind: str = "cell") -> pd.DataFrame:
    """Tags, parameters and metrics of every scored parent run of a kind, the newest of equal ones, complete ones first.

    Raises:
        InputError: there is none.
    """
    rows = [
        r.data.params
        | r.data.tags
        | r.data.metrics
        | {"run_id": r.info.run_id, "status": r.info.status, "started": r.info.start_time}
        | {"artifacts": r.info.artifact_uri}
        | {f"{part}_name": r.data.params.get(part, "") for part in PARTS}
        for r in store.of_kind(kind)
        if SCORES.get(kind, "accuracy") in r.data.metrics
    ]
    if not rows:
        command = "run" if kind == "cell" else kind
        raise NothingTracked(f"no scored run is stored here; make one first, for example: bench {command} model=svm")
    runs = pd.DataFrame(rows)
    runs = runs.assign(complete=runs["status"] == "FINISHED").sort_values(["complete", "started"])
    options = [c for c in runs.columns if c.startswith(("stream.", f"{kind}.")) or c in ("faults", "train_subjects")]
    same = [*COMPARABLE, *SAME_SYSTEM, "features_name", "model_name", *options]
    return runs.drop(columns="complete").drop_duplicates(same, keep="last").sort_values("started")


def of_kinds(store: Store, kinds: Iterable[str]) -> dict[str, pd.DataFrame]:
    """`tracked` of each kind that there is a run of."""
    runs = {}
    for kind in kinds:
        with suppress(NothingTracked):
            runs[kind] = tracked(store, kind)
    return runs


def selected(runs: pd.DataFrame, asked: Mapping[str, Iterable[object]]) -> pd.DataFrame:
    """The runs that have one of the values of each key.

    A part of a file goes by ``file.py:Name`` from wherever it is asked for, and by the name that tables show.

    Args:
        runs: table of `tracked`.
        asked: values of ``data``, ``where``, ``target``, ``protocol``, ``features``, ``model``, or of a column.
    """
    for key, values in asked.items():
        column = runs[COLUMNS.get(key, key)]
        if key in PARTS:
            wanted = {goes_by for value in values for goes_by in (str(value), _absolute(str(value)))}
            runs = runs[np.array([bool(_names(PARTS[key], name) & wanted) for name in column], dtype=bool)]
        else:
            runs = runs[column.isin([str(v) for v in values])]
    return runs


def without_runs(tables: Iterable[pd.DataFrame], asked: Mapping[str, Iterable[object]]) -> list[str]:
    """The requested models and feature sets without a run in any table, as ``key=value``."""
    parts = [(key, value) for key in ("features", "model") for value in asked.get(key, ())]
    return [f"{key}={v}" for key, v in parts if not any(len(selected(runs, {key: [v]})) for runs in tables)]


def _names(room: str, name: str) -> set[str]:
    """What a part goes by: as it was tracked, as tables show it, and its file without the folder."""
    file, _, factory = name.rpartition(":")
    if not file.endswith(".py"):
        return {name}
    short = f"{Path(file).stem}.{factory}" if factory in names(room) else factory
    return {name, short, f"{Path(file).name}:{factory}"}


def _absolute(name: str) -> str:
    file, _, factory = name.rpartition(":")
    return f"{Path(file).resolve()}:{factory}" if file.endswith(".py") else name


def rows_of(runs: pd.DataFrame) -> list[Row]:
    """The rows of such a table."""
    return [{str(name): value for name, value in row.items()} for row in runs.to_dict("records")]


def with_groups(runs: pd.DataFrame) -> pd.DataFrame:
    """The runs with a column ``group``: in words, the captures and the protocol that make runs comparable.

    Generated captures say so; where several corpora go by one name, the digest tells them apart. ``system`` gets the
    marks of `bench.outcomes.comparable.system_of`. Runs that have a group stay as they are.
    """
    if "group" in runs:
        return runs
    tags = rows_of(runs[["data", "synthetic", "subset", "target", "protocol_label"]])
    words = pd.Series([", ".join(context_of(run)) for run in tags], runs.index)
    digests = runs.groupby(words)["corpus_digest"].transform("nunique")
    runs = runs.assign(system=[system_of(run) for run in rows_of(runs)])
    return runs.assign(group=words + np.where(digests > 1, ", corpus " + runs["corpus_digest"].str[:8], ""))


def artifact(store: Store, run: Row, name: str) -> Path | None:
    """The path of a run's artifact, None where it has none; ``run`` is a row of `tracked`."""
    return store.path(str(run["run_id"]), str(run["artifacts"]), name)


def needed(store: Store, run: Row, name: str) -> Path:
    """Path of a required artifact of a run.

    Raises:
        InputError: it is gone.
    """
    path = artifact(store, run, name)
    if path is None:
        raise InputError(
            f"{name} of {run['system']} (run {run['run_id']}) is missing in the store; restore it, or delete the run "
            "in bench ui and run it again"
        )
    return path


def predictions(store: Store, run: Row) -> pd.DataFrame | None:
    """The predictions table of a run, None if it is not there."""
    path = artifact(store, run, "predictions.parquet")
    return None if path is None else pd.read_parquet(path)


def subject_accuracy(store: Store, run: Row) -> dict[str, float]:
    """Accuracy of the captures of each subject, in percent, as the run stored it; empty if it is not there."""
    path = artifact(store, run, "per_subject.csv")
    if path is None:
        return {}
    with path.open(newline="", encoding="utf-8") as f:  # pandas takes twenty times as long for ten lines
        return {row["subject"]: 100 * float(row["accuracy"]) for row in csv.DictReader(f)}


def independent(runs: pd.DataFrame) -> pd.DataFrame:
    """The runs whose predictions of a capture do not depend on the other captures predicted together."""
    return runs[np.array([not depends_on_batch(run) for run in rows_of(runs)], dtype=bool)]


def by_subject(store: Store, runs: pd.DataFrame) -> tuple[pd.DataFrame, pd.Series]:
    """Accuracy in percent [systems, subjects] of the complete runs of one group, best mean first.

    Systems that were not tested on all subjects of the group are left out.

    Args:
        store: store of the runs.
        runs: runs of one group, from `with_groups`; `independent` leaves out those that are not comparable.

    Returns:
        The table, and the number of seeds behind each row.
    """
    complete = runs[runs["status"] == "FINISHED"]
    rows = [subject_accuracy(store, run) for run in rows_of(complete)]
    table = pd.DataFrame(rows, index=pd.Index(complete["system"], name="system"))
    table = table.dropna() if len(table.columns) else table.iloc[:0]
    means = table.groupby(level=0).mean()
    order = means.mean(axis=1).sort_values(ascending=False, kind="stable").index
    return means.loc[order], table.groupby(level=0).size().loc[order]
