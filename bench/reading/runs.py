"""Stored runs as results, and which of them were asked for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Never, TypeVar

from bench.errors import InputError
from bench.ground.progress import warn
from bench.ground.registry import PART_GROUPS, load_views, registered_parts, views_of_runs
from bench.ground.typed import Values, parse_value, split_values
from bench.store.client import Store
from bench.values.result import COMPARISON_TAGS, REPETITION_TAGS, Result

SAME_RUN = (
    *COMPARISON_TAGS,
    *REPETITION_TAGS,
    "features_name",
    "model_name",
)  # what makes two runs repetitions of one
COLUMN_OF_KEY = {"where": "subset", "run": "run_id"} | {
    part: f"{part}_name" for part in PART_GROUPS
}  # names in a result of keys
SELECTING_KEYS = (
    "data",
    "where",
    "target",
    "protocol",
    "model",
    "features",
    "run",
    "latest",
)  # keys of stored runs
KIND_TAGS = ("touchbench.kind", "touchbench.command")  # tags
SETTING = (
    *KIND_TAGS,
    "data",
    "subset",
    "target",
    "protocol",
    "model_name",
    "features_name",
)  # of which `_latest_runs` is
NEWEST = (
    "corpus_digest",
    "protocol_label",
    "system",
)  # what results of a setting share with the newest of them
Row = TypeVar("Row", bound=Mapping[str, Any])  # a result, or what has the same names


class NothingTracked(InputError):
    """No run of a kind is there."""


def load_all_runs(store: Store) -> list[Result]:
    """Every run of all kinds, also failed and interrupted ones and older runs of a system."""
    return [store.load_result(run) for run in store.runs_of_kind(*views_of_runs())]


def load_results(
    store: Store, selection: Mapping[str, Sequence[object]] | None = None
) -> list[Result]:
    """Every scored run of all kinds, oldest first: the newest of equal ones, complete ones first.

    If one corpus is asked for, and has runs, others are left out.
    """
    data = [str(value) for value in (selection or {}).get("data", ())]
    scores = {tag: view.score for tag, view in views_of_runs().items()}
    runs = store.runs_of_kind(*scores, data=data[0]) if len(data) == 1 else []
    results = [store.load_result(run) for run in runs or store.runs_of_kind(*scores)]
    scored = [r for r in results if scores[r.kind] in r.metrics]
    return _last_of_equals(
        sorted(scored, key=lambda r: (r.is_complete, r["started"])),
        (*SAME_RUN, *_tracked_parameters()),
    )


def _last_of_equals(results: Iterable[Result], names: Sequence[str]) -> list[Result]:
    """The last result of each that share what these names stand for, oldest first."""
    last = {_values_as_text(r, names): r for r in results}
    return sorted(last.values(), key=lambda r: r["started"])


def _values_as_text(r: Mapping[str, Any], names: Iterable[str]) -> tuple[str, ...]:
    """What some names stand for in a result, as text."""
    return tuple(str(r.get(name)) for name in names)


def load_results_on_captures(store: Store) -> list[Result]:
    """The results of `one_run_per_system` of the first kind, of captures."""
    return results_on_captures(load_results(store)) or _fail_without_runs()


def load_clean_runs(
    store: Store, selection: Mapping[str, Sequence[object]] | None = None
) -> list[Result]:
    """Complete runs on captures as they are, whatever code made them, oldest first."""
    results = map(store.load_result, store.runs_of_kind(load_views()["run"].tag))
    kept = [r for r in results if r.is_complete and not _tracked_parameters() & r.attributes.keys()]
    return sorted(select_runs(kept, selection or {}), key=lambda r: r["started"])


def _tracked_parameters() -> set[str]:
    """Names of the parameters of all circumstances and studies."""
    return {name for view in load_views().values() for name in view.tracked}


def results_on_captures(results: Iterable[Result]) -> list[Result]:
    """The results of `one_run_per_system` of the first kind, of captures."""
    return one_run_per_system(r for r in results if r.kind == load_views()["run"].tag)


def _fail_without_runs() -> Never:
    raise NothingTracked(
        "no scored run is stored here; make one first, for example: bench run model=svm"
    )


def one_run_per_system(results: Iterable[Result]) -> list[Result]:
    """One result for each system, seed, captures and protocol: the newest of those in the fewest circumstances.

    Whatever a circumstance changes, the labels of the captures as they are stay the same.
    """
    tracked = _tracked_parameters()
    ranked = sorted(
        results, key=lambda r: (r.is_complete, -len(tracked & r.attributes.keys()), r["started"])
    )
    return _last_of_equals(ranked, (KIND_TAGS[0], *SAME_RUN))


def parse_selection(values: Values) -> dict[str, list]:
    """The typed keys that select stored runs, with their values, as `select_runs` takes them."""
    for key in values:
        if "." in key and not key.startswith("protocol."):
            raise InputError(
                f"{key}= is a parameter of new runs; leave it out to select stored runs"
            )
    asked = {
        k: split_values(k, v)
        for k, v in values.items()
        if k in SELECTING_KEYS or k.startswith("protocol.")
    }
    if "latest" in asked and not parse_value("latest", values["latest"], False):
        del asked["latest"]
    return asked


def select_or_fail(
    results: Sequence[Result], selection: Mapping[str, Iterable[object]]
) -> list[Result]:
    """The selected results, with a warning for each value without a run."""
    if not results:
        _fail_without_runs()
    warn_of_missing_runs(results, selection)
    kept = select_runs(results, selection)
    if not kept:
        words = " ".join(
            f"{k}={','.join(map(str, v))}" for k, v in selection.items() if k != "latest"
        )
        raise NothingTracked(
            f"no run is stored for {words}; leave a key out, or make such a run with bench run"
        )
    return kept


def select_runs(results: Sequence[Row], selection: Mapping[str, Iterable[object]]) -> list[Row]:
    """The results that have one of the values of each key.

    A part of a file goes by ``file.py:Name`` from wherever it is asked for, and by the name that tables show. A run
    goes by the first eight characters of its id, too.
    """
    kept = [*results]
    for key, values in selection.items():
        if key == "latest":
            continue
        name = COLUMN_OF_KEY.get(key, key)
        if key in PART_GROUPS:
            wanted = {
                goes_by for value in values for goes_by in (str(value), _absolute_name(str(value)))
            }
            kept = [r for r in kept if _names_of_part(PART_GROUPS[key], r[name]) & wanted]
        else:
            texts = {str(v) for v in values}
            kept = [
                r
                for r in kept
                if {r.get(name), f"{r.get(name)!s:.8}" if key == "run" else None} & texts
            ]
    return _latest_runs(kept) if "latest" in selection else kept


def _latest_runs(results: Sequence[Row]) -> list[Row]:
    """The newest parameters and captures of each model and feature set, with all seeds; complete runs come first."""
    ordered = sorted(results, key=lambda r: (r["status"] == "FINISHED", r["started"]))
    newest = {_values_as_text(r, SETTING): _values_as_text(r, NEWEST) for r in ordered}
    return [r for r in results if _values_as_text(r, NEWEST) == newest[_values_as_text(r, SETTING)]]


def warn_of_missing_runs(
    results: Sequence[Result], selection: Mapping[str, Iterable[object]]
) -> list[str]:
    """Warn of the requested models, feature sets and runs without a result; these, as ``key=value``."""
    parts = [
        (key, value) for key in ("features", "model", "run") for value in selection.get(key, ())
    ]
    lacking = [f"{key}={v}" for key, v in parts if not select_runs(results, {key: [v]})]
    for part in lacking:
        warn(f"warning: {part}: no run is stored")
    return lacking


def _names_of_part(room: str, name: str) -> set[str]:
    """What a part goes by: as it was tracked, as tables show it, and its file without the folder."""
    file, _, factory = name.rpartition(":")
    if not file.endswith(".py"):
        return {name}
    short = f"{Path(file).stem}.{factory}" if factory in registered_parts(room) else factory
    return {name, short, f"{Path(file).name}:{factory}"}


def _absolute_name(name: str) -> str:
    file, _, factory = name.rpartition(":")
    return f"{Path(file).resolve()}:{factory}" if file.endswith(".py") else name
