"""A plan's run in the store, resumed if it exists.

A finished fold is one file of the run, ``folds/N.zip`` by its index in the protocol, and its scores
are metrics of the run at this step. The comment of the zip file is a digest of all before it, so
that a fold is complete or missing; a damaged one is run again, with a warning. When all folds are
done, their tables become those of the run, and their files go. A fold that fails leaves
``folds/N.txt``.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import BadZipFile, ZipFile

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.library import compared_digest
from bench.errors import InputError
from bench.ground.digests import DIGITS, append_digest, split_digest
from bench.ground.machine import Machine
from bench.ground.progress import warn
from bench.ground.source import git_revisions, package_versions
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan
from bench.running.evaluation import measure_run
from bench.running.results import FoldResult, combine_costs
from bench.store.client import FOLD_PREFIX, Store, run_attributes
from bench.store.tables import CSV_TABLES, as_stored, read_table, table_file, write_table
from bench.values.result import FAILED_TAG, GRIDS_TAG, Failure, Result

if TYPE_CHECKING:
    from mlflow.entities import Run, RunInfo

TABLES = ("predictions", "trials", "tables")  # fields of a fold stored as tables; others as text
FOLDS = "folds"  # folder of a run with its folds; later the name of their table


def identity_tags(plan: Plan) -> dict[str, str]:
    """Tags that identify a run's data and system in tables."""
    cell, corpus = plan.cell, plan.corpus
    optional = {
        "touchbench.conditions": ",".join(contract.required_conditions(cell.untrained_system)),
        "touchbench.changes": str(corpus.info.get("changes", "")),
    }
    return {name: text for name, text in optional.items() if text} | {
        "data": cell.data,
        "synthetic": str(corpus.synthetic).lower(),
        "subset": cell.where or "all",
        "target": cell.target,
        "features": ", ".join(cell.feature_sets()) or "raw frames",
        "model": str(cell.model),
        "system": cell.system_name(),
        "seed": "none" if cell.seed is None else str(cell.seed),
    }


def run_params(plan: Plan) -> dict[str, str]:
    """Parameters that a run depends on, and versions; of the protocol, if there are folds."""
    cell = plan.cell
    params: dict[str, object] = {
        "data": cell.data,
        "where": cell.where or "all",
        "target": cell.target,
        "corpus_digest": compared_digest(plan.corpus),
    }
    params |= {"also": cell.also} if cell.also else {}
    params |= _with_prefix("data", cell.data_parameters)
    for name, part in (("skin", cell.skin), ("features", cell.features), ("model", cell.model)):
        if part:
            params |= {name: part.name} | _with_prefix(name, part.parameters)
        if part and part.module:
            content = Path(part.name.rpartition(":")[0]).read_bytes()
            params[f"{name}_file"] = hashlib.sha256(content).hexdigest()
    params |= _with_prefix("tuning", cell.tuning or {})
    own_files = [part.name.rpartition(":")[0] for part in cell.parts if part.module]
    params |= {"threads": plan.threads, "git": git_revisions(*own_files)}
    params |= _with_prefix("version", package_versions(cell.model.packages()))
    if plan.folds:
        options = cell.protocol.parameters | cell.protocol.changed_parameters()
        params |= {"protocol": cell.protocol.name} | _with_prefix("protocol", options)
    for extension in cell.extensions:
        params |= extension.params()
    return {name: str(value) for name, value in params.items()}


def _with_prefix(group: str, values: Mapping[str, object]) -> dict[str, object]:
    return {f"{group}.{name}": value for name, value in values.items()}


@dataclass(eq=False)
class TrackedRun:
    """The run of a plan in the store."""

    store: Store
    plan: Plan
    info: RunInfo  # of MLflow
    params: dict[str, str]
    tags: dict[str, str]
    finished_folds: dict[str, FoldResult] = field(default_factory=dict)  # by name, as stored
    errors: dict[str, Failure] = field(default_factory=dict)  # by fold, with failed circumstances
    reasons: dict[str, str] = field(default_factory=dict)  # of the same, in a line, by fold name

    @property
    def missing_folds(self) -> list[Fold]:
        """Folds that were neither stored before nor run by now, in the order of the protocol."""
        tried = self.finished_folds.keys() | self.errors.keys()
        return [fold for fold in self.plan.folds if fold.name not in tried]

    def store_fold(self, result: FoldResult) -> None:
        """Store one fold, completely or not at all."""
        run_id, artifacts = self.info.run_id, self.info.artifact_uri
        if result.machine and "cpu" not in self.params:
            self.params |= result.machine._asdict()
            self.store.log_values(run_id, params=result.machine._asdict())
        index = [fold.name for fold in self.plan.folds].index(result.name)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{index}.txt"
            if result.error or result.failed:
                path.write_text(result.error or "\n".join(result.failed.values()), encoding="utf-8")
                self.store.log_artifact(artifacts, path, FOLDS)
                name = ", ".join([result.name, *(f"{key}=" for key in result.failed)])
                where = self.store.describe_artifact(artifacts, f"{FOLDS}/{path.name}")
                self.errors[name] = Failure(result.reason, where)
                self.reasons[result.name] = result.reason
            if result.error:
                return
            result = _as_read_back(result)
            path = path.with_suffix(".zip")
            _write_fold(result, path)
            tracked, costs = result.tracked_metrics, combine_costs([result])
            metrics = {FOLD_PREFIX + k: value for k, value in tracked.items() if k not in costs}
            self.store.log_values(run_id, metrics, step=index)
            self.store.log_artifact(artifacts, path, FOLDS)
        self.finished_folds[result.name] = result

    def store_result(self) -> Result:
        """Measure the run from its folds, and end it.

        Returns:
            The result, which reads its tables from the store.
        """
        run_id, artifacts = self.info.run_id, self.info.artifact_uri
        done = self.finished_folds
        folds = [done[fold.name] for fold in self.plan.folds if fold.name in done]
        failed_folds = len(self.plan.folds) - len(folds)
        self.tags |= _batch_effect_tags(folds) | self._machine_tags()
        if failed := dict.fromkeys(key for fold in folds for key in fold.failed):
            self.tags[FAILED_TAG] = ", ".join(failed)
        status = "FAILED" if failed_folds else "FINISHED"
        about = run_attributes(self.info, self.params, self.tags) | {"status": status}
        result = measure_run(self.plan, about, folds) if folds else Result(about, {}, {})
        own_tags = {k: text for k, text in result.attributes.items() if k not in about}
        tables = dict(result.tables) | _training_tables(folds) | {FOLDS: self._folds_table()}
        metrics = result.metrics | {"folds": len(folds), "folds_failed": failed_folds}
        step = self.store.next_step(run_id, "folds")
        self.store.log_values(run_id, metrics, tags=own_tags | self.tags, step=step)
        with tempfile.TemporaryDirectory() as folder:
            for name, table in tables.items():
                write_table(table, Path(folder) / table_file(name))
                if name in CSV_TABLES:
                    table.to_csv(Path(folder) / f"{name}.csv", index=False)
            self.store.log_artifact(artifacts, Path(folder))
        self.store.set_status(run_id, status)
        if not failed_folds and not failed:
            self.store.delete_artifact(artifacts, FOLDS)
        stored = self.store.tables_of_run(run_id, artifacts, result.system, [*tables])
        return Result(result.attributes, metrics, stored, self.errors)

    def _machine_tags(self) -> dict[str, str]:
        """Tags with all machines of the folds; they hide the parameters with one machine."""
        machines = {fold.machine for fold in self.finished_folds.values() if fold.machine}
        if all(machine._asdict().items() <= self.params.items() for machine in machines):
            return {}
        columns = zip(Machine._fields, zip(*machines, strict=True), strict=True)
        return {name: "; ".join(sorted({*values})) for name, values in columns}

    def _folds_table(self) -> pd.DataFrame:
        """A row for each fold: status, seconds, numbers and machine, and why it failed."""
        rows: list[dict[str, object]] = []
        for fold in self.plan.folds:
            result, reason = self.finished_folds.get(fold.name), self.reasons.get(fold.name, "")
            status = "FAILED" if result is None or reason else "FINISHED"
            row: dict[str, object] = {"fold": fold.name, "status": status}
            row |= {"seconds": float("nan")} | dict.fromkeys(Machine._fields)  # columns in any case
            if result:
                row |= result.tracked_metrics | {"seconds": result.seconds}
                row |= result.machine._asdict() if result.machine else {}
            rows.append(row | {"error": reason})
        return as_stored(pd.DataFrame(rows))


def is_finished(run: Run) -> bool:
    """True if a run is stored with all its folds and circumstances."""
    return run.info.status == "FINISHED" and not run.data.tags.get(FAILED_TAG)


def has_fold_files(store: Store, run: Run) -> bool:
    """True if a run still has files of folds: it was cut off, or some failed."""
    return bool(store.artifact_names(run.info.run_id, run.info.artifact_uri, FOLDS))


def load_finished_folds(store: Store, run: Run) -> dict[str, FoldResult]:
    """Load the finished folds of an unfinished run, by name."""
    return _finished_by_name(_read_fold_files(store, run))


def _read_fold_files(store: Store, run: Run) -> dict[str, FoldResult | None]:
    """Read the files of a run's folds, by their names; None if one is damaged."""
    run_id, artifacts = run.info.run_id, run.info.artifact_uri
    names = store.artifact_names(run_id, artifacts, FOLDS)
    files = [f"{FOLDS}/{name}" for name in names if name.endswith(".zip")]
    return {file: _read_fold(store.artifact_path(run_id, artifacts, file)) for file in files}


def _finished_by_name(results: Mapping[str, FoldResult | None]) -> dict[str, FoldResult]:
    return {each.name: each for each in results.values() if each and not each.failed}


def load_finished_run(store: Store, run: Run, grid: str = "") -> Result:
    """Load the result of a finished run, and track the digest of a file that names it."""
    if grid:
        store.log_values(run.info.run_id, tags=_grids_tag(run, grid))
    return store.load_result(run)


def open_run(store: Store, plan: Plan, run: Run | None, grid: str = "") -> TrackedRun:
    """Open the stored run of a plan, to go on with it, or create one."""
    cell = plan.cell
    tags = identity_tags(plan) | plan.facts
    tags |= {
        "protocol": str(cell.protocol),
        "protocol_label": plan.label,
        "touchbench.kind": cell.kind,
        "touchbench.cell": plan.key,
        "touchbench.command": cell.command,
    }
    if not cell.objects:  # an object cannot be typed
        tags["touchbench.arguments"] = json.dumps(cell.arguments())
    if grid:
        tags |= _grids_tag(run, grid)
    if run and not run.data.params:  # it was cut off while it was created
        store.delete_run(run.info.run_id)
        run = None
    if run is None:
        params = run_params(plan)
        new_tags = {"mlflow.source.name": "bench"} | tags
        info = store.create_run(_run_name(cell), new_tags, params).info
        return TrackedRun(store, plan, info, params, tags)
    if FAILED_TAG in run.data.tags:
        tags[FAILED_TAG] = ""
    store.set_status(run.info.run_id, "RUNNING")
    for file, result in (results := _read_fold_files(store, run)).items():
        if result is None:
            where = store.describe_artifact(run.info.artifact_uri, file)
            warn(f"warning: {cell.system_name()}: {where} is damaged; its fold is run again")
    folds = _finished_by_name(results)
    return TrackedRun(store, plan, run.info, dict(run.data.params), tags, folds)


def _grids_tag(run: Run | None, grid: str) -> dict[str, str]:
    """The tag with the digests of the files that name a run, and a new one."""
    digests = run.data.tags.get(GRIDS_TAG, "").split(", ") if run else []
    return {GRIDS_TAG: ", ".join(dict.fromkeys([*filter(None, digests), grid]))}


def _run_name(cell: Cell) -> str:
    """Name of a run on MLflow's page: command, title, and what tells it from similar runs."""
    target = cell.target if cell.target != "gesture" else ""
    words = [f"{cell.command} {cell.title()}", cell.where, target]
    for extension in cell.extensions:
        words += [f"{key}={value}" for key, value in extension.typed_arguments().items()]
    seed = "" if cell.seed is None else f"seed {cell.seed}"
    return " | ".join(filter(None, [*words, seed]))


def _as_read_back(result: FoldResult) -> FoldResult:
    """Return a fold as it is read from its file."""
    return replace(
        result,
        predictions=as_stored(result.table),
        tables={name: as_stored(table) for name, table in result.tables.items()},
        trials=None if result.trials is None else as_stored(result.trials),
        chosen={str(name): _json_value(value) for name, value in result.chosen.items()},
    )


def _write_fold(result: FoldResult, path: Path) -> None:
    """Write a finished fold as a file."""
    names = [each.name for each in fields(result) if each.name not in TABLES]
    values = {name: getattr(result, name) for name in names}
    tables = {f"tables/{name}": table for name, table in result.tables.items()}
    tables["predictions"] = result.table
    if result.trials is not None:  # a system may tell its choice, but not its trials
        tables["trials"] = result.trials
    with ZipFile(buffer := BytesIO(), "w") as file:
        file.comment = b"0" * DIGITS
        file.writestr("fold.json", json.dumps(values | {"tables": [*tables]}, default=_json_value))
        for name, table in tables.items():
            write_table(table, content := BytesIO())
            file.writestr(table_file(name), content.getvalue())
    path.write_bytes(append_digest(buffer.getvalue()[:-DIGITS]))


def _read_fold(path: Path | None) -> FoldResult | None:
    """Read a finished fold; None if the file is gone, was cut off or is damaged."""
    try:
        content = path.read_bytes() if path else b""
        split_digest(content)
        with ZipFile(BytesIO(content)) as file:
            values, tables = json.loads(file.read("fold.json")), {}
            for name in values["tables"]:
                tables[name] = read_table(BytesIO(file.read(table_file(name))), name)
            values["machine"] = Machine(*values["machine"]) if values["machine"] else None
    except (BadZipFile, KeyError, ValueError, OSError, InputError):
        return None
    values |= {name: tables.pop(name, None) for name in ("predictions", "trials")}
    values["tables"] = {name.removeprefix("tables/"): table for name, table in tables.items()}
    return FoldResult(**values)


def _json_value(value: object) -> object:
    """Return a text, number, truth or None as JSON gives it back; anything else as text."""
    if isinstance(value, np.generic):
        value = value.item()
    return value if value is None or type(value) in (str, int, float, bool) else str(value)


def _batch_effect_tags(folds: list[FoldResult]) -> dict[str, str]:
    """Tags: whether predictions depend on other captures of the batch, and the first sentence."""
    effects = [f"fold {fold.name}: {fold.batch_effects[0]}" for fold in folds if fold.batch_effects]
    tags = {"touchbench.depends_on_batch": str(bool(effects)).lower()}
    return tags | ({"touchbench.batch_effect": effects[0]} if effects else {})


def _training_tables(folds: list[FoldResult]) -> dict[str, pd.DataFrame]:
    """Tables of choices and trials in training, and of numbers by epoch, if there are any."""
    tables: dict[str, pd.DataFrame] = {}
    if any(fold.chosen for fold in folds):
        rows = [{"fold": fold.name} | fold.chosen for fold in folds]
        tables["chosen"] = as_stored(pd.DataFrame(rows, dtype=object))
    trials = [fold.trials.assign(fold=fold.name) for fold in folds if fold.trials is not None]
    if trials:
        tables["trials"] = as_stored(pd.concat(trials, ignore_index=True))
    epochs = []
    for fold in folds:
        for epoch, numbers in enumerate(fold.history, 1):
            epochs.append({"fold": fold.name, "epoch": epoch} | numbers)
    if epochs:
        tables["history"] = pd.DataFrame(epochs)
    return tables
