"""Load stored runs as results, and select among them by keys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Never, TypeVar

from bench.errors import InputError
from bench.ground.progress import warn
from bench.ground.registry import PART_GROUPS, load_views, registered_parts, views_of_runs
from bench.ground.typed import Values, parse_value, split_values
from bench.reading.captures import mark_captures, runs_on_subsets
from bench.store.client import Store
from bench.values.result import COMPARISON_TAGS, NAME_TAG, REPETITION_TAGS, SINCE_TAG, Result

# Columns of a result by key.
COLUMN_OF_KEY = {"where": "subset", "run": "run_id"} | {key: f"{key}_name" for key in PART_GROUPS}
SELECTING_KEYS = ("data", "where", "target", "protocol", "model", "features", "run", "latest")
KIND, COMMAND = "touchbench.kind", "touchbench.command"  # tags
REPEATED = (*COMPARISON_TAGS, *REPETITION_TAGS, "features_name", "model_name")  # by repetitions
SETTING = (KIND, COMMAND, "data", "subset", "target", "protocol", "model_name", "features_name")
NEWEST = ("corpus_digest", "protocol_label", "system")  # of a setting, as `latest` selects
Row = TypeVar("Row", bound=Mapping[str, Any])  # a result, or a mapping with the same names


class NothingTracked(InputError):
    """No such run is stored."""


def load_all_runs(store: Store) -> list[Result]:
    """Every run of all kinds, also failed and interrupted ones and older runs of a system."""
    return _load_marked(store, store.runs_of_kind(*views_of_runs()))


def _load_marked(store: Store, runs: Iterable[Any]) -> list[Result]:
    """Load runs as results, with marks on their captures."""
    results = [store.load_result(run) for run in runs]
    mark_captures(results)
    _name_files_apart(results)
    named = sorted((r for r in results if r.get(NAME_TAG)), key=lambda r: r["started"])
    names = {r["system"]: r[NAME_TAG] for r in named}
    for r in results:  # later seeds of a named system have its name
        r.attributes |= {NAME_TAG: names[r["system"]]} if r.get("system") in names else {}
    return results


def _name_files_apart(results: Iterable[Result]) -> None:
    """Add its file to the name of an own system, if an earlier one of another file has that name.

    Else tables would take them for seeds of one system.
    """
    owners: dict[str, tuple[str, ...]] = {}
    for r in sorted(results, key=lambda r: r["started"]):
        names = (str(r.get(f"{key}_name", "")) for key in PART_GROUPS)
        files = tuple(name.rpartition(":")[0] for name in names if ".py:" in name)
        if not files or (owner := owners.setdefault(r["system"], files)) == files:
            continue
        paths = [Path(file) for file in files if file not in owner]
        taken = {Path(file).name for file in owner}
        short = [p.name if p.name not in taken else f"{p.parent.name}/{p.name}" for p in paths]
        r.attributes["system"] += f" ({', '.join(short)})"


def load_results(
    store: Store, selection: Mapping[str, Sequence[object]] | None = None
) -> list[Result]:
    """The newest of equal scored runs of all kinds, complete ones first; sorted, the oldest first.

    If the selection has one corpus, and this one has runs, others are not loaded.
    """
    data = [str(value) for value in (selection or {}).get("data", ())]
    scores = {tag: view.score for tag, view in views_of_runs().items()}
    runs = store.runs_of_kind(*scores, data=data[0]) if len(data) == 1 else []
    results = _load_marked(store, runs or store.runs_of_kind(*scores))
    scored = [r for r in results if scores[r.kind] in r.metrics]
    scored.sort(key=lambda r: (r.is_complete, r["started"]))
    return _last_of_equals(scored, (*REPEATED, *_tracked_parameters()))


def load_results_on_captures(store: Store) -> list[Result]:
    """The stored results on captures, one for each system and seed."""
    return results_on_captures(load_results(store)) or _fail_without_runs()


def load_clean_runs(
    store: Store, selection: Mapping[str, Sequence[object]] | None = None
) -> list[Result]:
    """Complete runs on captures without any circumstance, of all code; sorted, the oldest first."""
    runs = store.runs_of_kind(load_views()["run"].tag)
    complete = [r for r in _load_marked(store, runs) if r.is_complete]
    clean = [r for r in complete if not _tracked_parameters() & r.attributes.keys()]
    return sorted(select_runs(clean, selection or {}), key=lambda r: r["started"])


def results_on_captures(results: Iterable[Result]) -> list[Result]:
    """The results of runs on captures, one for each system and seed."""
    return one_run_per_system(r for r in results if r.kind == load_views()["run"].tag)


def one_run_per_system(results: Iterable[Result]) -> list[Result]:
    """One result for each system, seed, captures and protocol.

    It is the newest of those in the fewest circumstances; complete ones come first. No circumstance
    changes the labels of clean captures.
    """
    tracked = _tracked_parameters()

    def rank(r: Result) -> tuple:
        return r.is_complete, -len(tracked & r.attributes.keys()), r["started"]

    return _last_of_equals(sorted(results, key=rank), (KIND, *REPEATED))


def _last_of_equals(results: Iterable[Result], names: Sequence[str]) -> list[Result]:
    """The last of the results with equal values of these names; sorted, the oldest first."""
    last = {_values_as_text(r, names): r for r in results}
    return sorted(last.values(), key=lambda r: r["started"])


def _values_as_text(r: Mapping[str, Any], names: Iterable[str]) -> tuple[str, ...]:
    return tuple(str(r.get(name)) for name in names)


def _tracked_parameters() -> set[str]:
    """Names of the parameters of all circumstances and kinds of run."""
    return {name for view in load_views().values() for name in view.tracked}


def _fail_without_runs() -> Never:
    raise NothingTracked(
        "no scored run is stored here; make one first, for example: bench run model=svm"
    )


def parse_selection(values: Values) -> dict[str, list]:
    """The typed keys that select stored runs, with their values, for `select_runs`."""
    selection = {}
    for key, value in values.items():
        if "." in key and not key.startswith("protocol."):
            raise InputError(
                f"{key}= is a parameter of new runs; leave it out to select stored runs"
            )
        if key in SELECTING_KEYS or "." in key:
            selection[key] = split_values(key, value)
    if "latest" in selection and not parse_value("latest", values["latest"], False):
        del selection["latest"]
    return selection


def select_or_fail(
    results: Sequence[Result], selection: Mapping[str, Iterable[object]]
) -> list[Result]:
    """The selected results, with a warning for each value without a run.

    Raises:
        NothingTracked: none is selected.
    """
    if not results:
        _fail_without_runs()
    warn_of_missing_runs(results, selection)
    selected = select_runs(results, selection)
    if not selected:
        keys = {key: values for key, values in selection.items() if key != "latest"}
        words = " ".join(f"{key}={','.join(map(str, values))}" for key, values in keys.items())
        raise NothingTracked(
            f"no run is stored for {words}; leave a key out, or make such a run with bench run"
        )
    return selected


def select_runs(results: Sequence[Row], selection: Mapping[str, Iterable[object]]) -> list[Row]:
    """The results that have one of the values of each key.

    ``file.py:Name``, from any folder, and the name in tables select a part of a file. The first
    eight characters of its id also select a run.
    """
    selected = [*results]
    for key, values in selection.items():
        texts, column = {str(value) for value in values}, COLUMN_OF_KEY.get(key, key)
        if key in PART_GROUPS:
            texts |= {_absolute_name(text) for text in texts}
            group = PART_GROUPS[key]
            selected = [r for r in selected if _names_of_part(group, r[column]) & texts]
        elif key == "run":
            ids = [str(r.get("run_id")) for r in selected]
            pairs = zip(selected, ids, strict=True)
            selected = [r for r, run_id in pairs if {run_id, run_id[:8]} & texts]
        elif key == "where":
            selected = runs_on_subsets(selected, texts)
        elif key != "latest":
            selected = [r for r in selected if r.get(column) in texts]
    if "latest" not in selection:
        return selected
    # The newest parameters of each model and feature set, on the captures as they are imported now;
    # complete runs come first.
    ordered = sorted(
        selected, key=lambda r: (not r.get(SINCE_TAG), r["status"] == "FINISHED", r["started"])
    )
    newest = {_values_as_text(r, SETTING): _values_as_text(r, NEWEST) for r in ordered}
    return [
        r for r in selected if _values_as_text(r, NEWEST) == newest[_values_as_text(r, SETTING)]
    ]


def warn_of_missing_runs(
    results: Sequence[Result], selection: Mapping[str, Iterable[object]]
) -> list[str]:
    """Warn of selected models, feature sets and runs without a result; these, as ``key=value``."""
    missing = []
    for key in ("features", "model", "run"):
        values = selection.get(key, ())
        missing += [f"{key}={v}" for v in values if not select_runs(results, {key: [v]})]
    for argument in missing:
        warn(f"warning: {argument}: no run is stored")
    return missing


def _names_of_part(group: str, name: str) -> set[str]:
    """All names that select a part: as tracked, as tables show it, and its file without folder."""
    file, _, factory = name.rpartition(":")
    if not file.endswith(".py"):
        return {name}
    short = f"{Path(file).stem}.{factory}" if factory in registered_parts(group) else factory
    return {name, short, f"{Path(file).name}:{factory}"}


def _absolute_name(name: str) -> str:
    file, _, factory = name.rpartition(":")
    return f"{Path(file).resolve()}:{factory}" if file.endswith(".py") else name
