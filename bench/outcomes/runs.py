"""Stored runs as results, and which of them were asked for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import pandas as pd

from bench.comparable import COMPARABLE, SAME_SYSTEM, context_of
from bench.errors import InputError
from bench.outcomes.store import Store
from bench.outcomes.tables import read_table
from bench.registry import KEYS as PARTS
from bench.registry import names
from bench.result import Result, Tables

if TYPE_CHECKING:
    from mlflow.entities import Run

ROOMS = {key: room for room, key in PARTS.items() if room != "corpora"}  # of the key of a part
COLUMNS = {"where": "subset", "shots": "protocol.shots"}  # of a result, where it is not called as it is asked for
COLUMNS |= {part: f"{part}_name" for part in ROOMS}
SCORES = {"watch": "end_correct"}  # of a kind of run, its main metric where that is not accuracy


class NothingTracked(InputError):
    """No run of a kind is there."""


def result_of(store: Store, run: Run) -> Result:
    """A run of MLflow as a result; its tables are read when they are asked for."""
    data, info = run.data, run.info
    about = data.params | data.tags | {"run_id": info.run_id, "status": info.status, "started": info.start_time}
    about |= {f"{part}_name": data.params.get(part, "") for part in ROOMS} | {"artifacts": info.artifact_uri}

    def read(name: str) -> pd.DataFrame | None:
        return read_table(lambda file: store.path(info.run_id, info.artifact_uri, file), name)

    def names() -> list[str]:
        files = map(PurePosixPath, store.names(info.run_id, info.artifact_uri))
        return [*dict.fromkeys(file.stem for file in files if file.suffix in (".csv", ".parquet"))]

    missing = (
        f"{about.get('system', 'this system')} (run {info.run_id}) is missing in the store; restore it, or delete "
    )
    missing += "the run in bench ui and run it again"
    return Result(about, data.metrics, Tables({}, read, missing, names))


def stored(store: Store, kind: str = "cell") -> list[Result]:
    """Every scored run of a kind, oldest first: the newest of equal ones, complete ones first.

    Raises:
        NothingTracked: there is none.
    """
    scored = [result_of(store, run) for run in store.of_kind(kind) if SCORES.get(kind, "accuracy") in run.data.metrics]
    if not scored:
        command = "run" if kind == "cell" else kind
        raise NothingTracked(f"no scored run is stored here; make one first, for example: bench {command} model=svm")
    options = {k for r in scored for k in r.about if k.startswith(("stream.", f"{kind}."))} | {
        "faults",
        "train_subjects",
    }
    same = [*COMPARABLE, *SAME_SYSTEM, "features_name", "model_name", *sorted(options)]
    newest = {
        tuple(str(r.about.get(name)) for name in same): r
        for r in sorted(scored, key=lambda r: (r.complete, r["started"]))
    }
    return sorted(newest.values(), key=lambda r: r["started"])


def of_kinds(store: Store, kinds: Iterable[str]) -> dict[str, list[Result]]:
    """`stored` of each kind that there is a run of."""
    results = {}
    for kind in kinds:
        try:
            results[kind] = stored(store, kind)
        except NothingTracked:
            continue
    return results


def selected(results: Sequence[Result], asked: Mapping[str, Iterable[object]]) -> list[Result]:
    """The results that have one of the values of each key.

    A part of a file goes by ``file.py:Name`` from wherever it is asked for, and by the name that tables show.

    Args:
        results: results.
        asked: values of ``data``, ``where``, ``target``, ``protocol``, ``features``, ``model``, or of a name in them.
    """
    kept = [*results]
    for key, values in asked.items():
        name = COLUMNS.get(key, key)
        if key in ROOMS:
            wanted = {goes_by for value in values for goes_by in (str(value), _absolute(str(value)))}
            kept = [r for r in kept if _names(ROOMS[key], r[name]) & wanted]
        else:
            texts = {str(v) for v in values}
            kept = [r for r in kept if r.get(name) in texts]
    return kept


def without_runs(results: Iterable[Sequence[Result]], asked: Mapping[str, Iterable[object]]) -> list[str]:
    """The requested models and feature sets without a result among any, as ``key=value``."""
    parts = [(key, value) for key in ("features", "model") for value in asked.get(key, ())]
    every = [*results]
    return [f"{key}={v}" for key, v in parts if not any(selected(each, {key: [v]}) for each in every)]


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


def grouped(results: Sequence[Result]) -> dict[str, list[Result]]:
    """The results by captures and protocol in words; only results of one group are compared.

    Generated captures say so; where several corpora go by one name, the digest tells them apart.
    """
    words = {r: ", ".join(context_of(r)) for r in results}
    digests: dict[str, set[str]] = {}
    for r in results:
        digests.setdefault(words[r], set()).add(str(r["corpus_digest"]))
    groups: dict[str, list[Result]] = {}
    for r in results:
        several = len(digests[words[r]]) > 1
        groups.setdefault(words[r] + f", corpus {str(r['corpus_digest'])[:8]}" * several, []).append(r)
    return groups


def frame_of(results: Sequence[Result]) -> pd.DataFrame:
    """A row for each result with every tag, parameter and number."""
    return pd.DataFrame([dict(r) for r in results])


def subject_accuracy(result: Result) -> dict[str, float]:
    """Accuracy of the captures of each subject, in percent, as the run stored it; empty if it is not there."""
    table = result.tables.get("per_subject")
    return {} if table is None else dict(zip(table["subject"], 100 * table["accuracy"], strict=True))


def by_subject(results: Sequence[Result]) -> tuple[pd.DataFrame, pd.Series]:
    """Accuracy in percent [systems, subjects] of the complete results of one group, best mean first.

    Systems that were not tested on all subjects of the group are left out.

    Args:
        results: results of one group; those that depend on the batch are not comparable.

    Returns:
        The table, and the number of seeds behind each row.
    """
    complete = [r for r in results if r.complete]
    table = pd.DataFrame(
        [subject_accuracy(r) for r in complete], index=pd.Index([r.system for r in complete], name="system")
    )
    table = table.dropna() if len(table.columns) else table.iloc[:0]
    means = table.groupby(level=0).mean()
    order = means.mean(axis=1).sort_values(ascending=False, kind="stable").index
    return means.loc[order], table.groupby(level=0).size().loc[order]
