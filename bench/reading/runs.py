"""Stored runs as results, and which of them were asked for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Never, TypeVar

from bench.errors import InputError
from bench.ground.progress import warn
from bench.ground.registry import names, run_views, views
from bench.ground.words import PARTS, Values, convert, items
from bench.store.client import Store
from bench.values.result import COMPARABLE, SAME_SYSTEM, Result

SAME = (
    *COMPARABLE,
    *SAME_SYSTEM,
    "features_name",
    "model_name",
)  # what makes two runs repetitions of one
COLUMNS = {"where": "subset", "run": "run_id"} | {
    part: f"{part}_name" for part in PARTS
}  # names in a result of keys
SELECTING = (
    "data",
    "where",
    "target",
    "protocol",
    "model",
    "features",
    "run",
    "latest",
)  # keys of stored runs
OF_RUN = ("touchbench.kind", "touchbench.command")  # tags
SETTING = (
    *OF_RUN,
    "data",
    "subset",
    "target",
    "protocol",
    "model_name",
    "features_name",
)  # of which `_latest` is
NEWEST = (
    "corpus_digest",
    "protocol_label",
    "system",
)  # what results of a setting share with the newest of them
Row = TypeVar("Row", bound=Mapping[str, Any])  # a result, or what has the same names


class NothingTracked(InputError):
    """No run of a kind is there."""


def every_result(store: Store, asked: Mapping[str, Sequence[object]] | None = None) -> list[Result]:
    """Every scored run of all kinds, oldest first: the newest of equal ones, complete ones first.

    If one corpus is asked for, and has runs, others are left out.
    """
    data = [str(value) for value in (asked or {}).get("data", ())]
    scores = {tag: view.score for tag, view in run_views().items()}
    runs = store.of_kind(*scores, data=data[0]) if len(data) == 1 else []
    results = [store.result(run) for run in runs or store.of_kind(*scores)]
    scored = [r for r in results if scores[r.kind] in r.metrics]
    return _last(sorted(scored, key=lambda r: (r.complete, r["started"])), (*SAME, *_tracked()))


def _last(results: Iterable[Result], names: Sequence[str]) -> list[Result]:
    """The last result of each that share what these names stand for, oldest first."""
    last = {_named(r, names): r for r in results}
    return sorted(last.values(), key=lambda r: r["started"])


def _named(r: Mapping[str, Any], names: Iterable[str]) -> tuple[str, ...]:
    """What some names stand for in a result, as text."""
    return tuple(str(r.get(name)) for name in names)


def stored(store: Store) -> list[Result]:
    """The results of `plain` of the first kind, of captures."""
    return of_captures(every_result(store)) or _none_stored()


def every_run(store: Store, asked: Mapping[str, Sequence[object]] | None = None) -> list[Result]:
    """Complete runs on captures as they are, whatever code made them, oldest first."""
    results = map(store.result, store.of_kind(views()["run"].tag))
    kept = [r for r in results if r.complete and not _tracked() & r.about.keys()]
    return sorted(selected(kept, asked or {}), key=lambda r: r["started"])


def _tracked() -> set[str]:
    """Names of the parameters of all circumstances and studies."""
    return {name for view in views().values() for name in view.tracked}


def of_captures(results: Iterable[Result]) -> list[Result]:
    """The results of `plain` of the first kind, of captures."""
    return plain(r for r in results if r.kind == views()["run"].tag)


def _none_stored() -> Never:
    raise NothingTracked(
        "no scored run is stored here; make one first, for example: bench run model=svm"
    )


def plain(results: Iterable[Result]) -> list[Result]:
    """One result for each system, seed, captures and protocol: the newest of those in the fewest circumstances.

    Whatever a circumstance changes, the labels of the captures as they are stay the same.
    """
    tracked = _tracked()
    ranked = sorted(
        results, key=lambda r: (r.complete, -len(tracked & r.about.keys()), r["started"])
    )
    return _last(ranked, (OF_RUN[0], *SAME))


def asked_of(values: Values) -> dict[str, list]:
    """The typed keys that select stored runs, with their values, as `selected` takes them."""
    for key in values:
        if "." in key and not key.startswith("protocol."):
            raise InputError(
                f"{key}= is a parameter of new runs; leave it out to select stored runs"
            )
    asked = {
        k: items(k, v) for k, v in values.items() if k in SELECTING or k.startswith("protocol.")
    }
    if "latest" in asked and not convert("latest", values["latest"], False):
        del asked["latest"]
    return asked


def wanted(results: Sequence[Result], asked: Mapping[str, Iterable[object]]) -> list[Result]:
    """The selected results, with a warning for each value without a run."""
    if not results:
        _none_stored()
    without_runs(results, asked)
    kept = selected(results, asked)
    if not kept:
        words = " ".join(f"{k}={','.join(map(str, v))}" for k, v in asked.items() if k != "latest")
        raise NothingTracked(
            f"no run is stored for {words}; leave a key out, or make such a run with bench run"
        )
    return kept


def selected(results: Sequence[Row], asked: Mapping[str, Iterable[object]]) -> list[Row]:
    """The results that have one of the values of each key.

    A part of a file goes by ``file.py:Name`` from wherever it is asked for, and by the name that tables show. A run
    goes by the first eight characters of its id, too.
    """
    kept = [*results]
    for key, values in asked.items():
        if key == "latest":
            continue
        name = COLUMNS.get(key, key)
        if key in PARTS:
            wanted = {
                goes_by for value in values for goes_by in (str(value), _absolute(str(value)))
            }
            kept = [r for r in kept if _names(PARTS[key], r[name]) & wanted]
        else:
            texts = {str(v) for v in values}
            kept = [
                r
                for r in kept
                if {r.get(name), f"{r.get(name)!s:.8}" if key == "run" else None} & texts
            ]
    return _latest(kept) if "latest" in asked else kept


def _latest(results: Sequence[Row]) -> list[Row]:
    """The newest parameters and captures of each model and feature set, with all seeds; complete runs come first."""
    ordered = sorted(results, key=lambda r: (r["status"] == "FINISHED", r["started"]))
    newest = {_named(r, SETTING): _named(r, NEWEST) for r in ordered}
    return [r for r in results if _named(r, NEWEST) == newest[_named(r, SETTING)]]


def without_runs(results: Sequence[Result], asked: Mapping[str, Iterable[object]]) -> list[str]:
    """Warn of the requested models, feature sets and runs without a result; these, as ``key=value``."""
    parts = [(key, value) for key in ("features", "model", "run") for value in asked.get(key, ())]
    lacking = [f"{key}={v}" for key, v in parts if not selected(results, {key: [v]})]
    for part in lacking:
        warn(f"warning: {part}: no run is stored")
    return lacking


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
